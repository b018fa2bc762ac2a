"""Times of the stages of a real-time frame."""

import numpy as np

from benchmarks.speed.figures import Figure, Part
from benchmarks.speed.running import Running, later_pose
from benchmarks.speed.timing import TIME_COLUMNS, TIMES_NOTE, GpuRun, frame_times, in_ms
from benchmarks.speed.workload import HEAD_POSE, Workload
from wlr_render.draw.gl_raster import GlRaster
from wlr_render.draw.pyrender_drawing import PyrenderView
from wlr_render.report.blocks import Cell, ReportTable
from wlr_render.warp.gl_ray_maps import GlNodeSolver, GlPlanarSolver
from wlr_render.warp.ray_map import RayMapPlan, choose_plan

LARGE_PX = 2048, 2048
FRAME_GOAL_MS, LARGE_FRAME_GOAL_MS = 2.0, 4.0
"""Longest wanted times of a whole frame of both eyes on a GPU, at the workload's size and at `LARGE_PX` per eye."""


def one_eye(work: Workload, context: str) -> Part:
    """Time the stages of one eye's frame; needs OpenGL."""
    return Part(tables=[_one_eye(work.one_eye, context)])


def _one_eye(work: Workload, context: str) -> ReportTable:
    with Running.of(work, context) as on, Running.of(work, on.gl_context, channels=3) as three:
        runs = _pictures(on) | _ray_maps(on) | _composing(on)
        runs |= {
            "whole frame, three colours": three.of_round(three.frame),
            "warp, three colours": three.same(three.compositor.compose),
        }
        rows = _rows(runs, work.rounds)
        title = f"One eye in real time, {_by(on.compositor.size_px)}, {work.scene.triangle_count} triangles"
    notes = (
        "The program waits for the end of each stage, and of a whole frame once.",
        "Newer pose, and a pose for each row: the same picture is composed again along the same rays. Newer pose and "
        "pupil: along new ones. Three colours: a ray map for each channel, of one model thrice.",
        TIMES_NOTE,
    )
    return ReportTable(title, ("stage", *TIME_COLUMNS), rows, notes)


def _rows(runs: dict[str, GpuRun], rounds: int) -> list[list[Cell]]:
    times = frame_times(*runs.values(), rounds=rounds)
    return [[name, *each.cells()] for name, each in zip(runs, times, strict=True)]


def _pictures(on: Running) -> dict[str, GpuRun]:
    """Return runs of the drawing that an engine does, with two engines."""
    raster = GlRaster(on.gl_context, on.work.scene)
    pyrender = PyrenderView(on.gl_context, on.work.scene)
    (camera,) = on.begin(0).values()
    width, height = camera.size_px
    return {
        "begin_frame": on.of_round(on.begin),
        f"intermediate view, {width} x {height}": on.same(lambda: raster.draw_on_gpu(camera.view)),
        "the same with glTF's materials, by pyrender": on.same(lambda: pyrender.draw_on_gpu(camera.view)),
    }


def _ray_maps(on: Running) -> dict[str, GpuRun]:
    """Return runs of two ways to compute the ray map of a new viewpoint."""
    context, mappings, plan = on.gl_context, on.work.mappings, on.compositor.plan("right")
    axes, coarse, viewpoints = plan.device_from_camera, plan.warp_grid.grid, on.work.viewpoints
    count = choose_plan(mappings).node_count
    points = GlPlanarSolver(context, mappings, coarse, axes)
    nodes = GlNodeSolver(context, mappings, RayMapPlan.onto_grid(coarse, count, axes))
    return {
        f"ray map, {_by(coarse.size)} points, shader": on.of_round(lambda turn: points.solve(viewpoints[turn])),
        f"ray map, {_by(coarse.size)} points from {count} x {count} nodes, any optics": on.of_round(
            lambda turn: nodes.solve(viewpoints[turn])
        ),
    }


def _composing(on: Running) -> dict[str, GpuRun]:
    """Return runs of the whole frame and its repetitions, in this order, because a pupil that moves costs a ray map."""
    compositor, work, later = on.compositor, on.work, later_pose(HEAD_POSE)
    return {
        "whole frame": on.of_round(on.frame),
        "warp": on.same(compositor.compose),
        "newer pose": on.same(lambda: compositor.compose(pose=later)),
        "a pose for each row": on.same(lambda: compositor.compose(pose=HEAD_POSE, pose_at_last_row=later)),
        "warp and read-back": on.same(lambda: compositor.compose().read()),
        "newer pose and pupil": on.of_round(
            lambda turn: compositor.compose(pose=later, viewpoint=work.viewpoints[turn - 1])
        ),
    }


def both_eyes(work: Workload, context: str, large_px: tuple[int, int] = LARGE_PX) -> Part:
    """Time whole frames of both eyes, with a new viewpoint in each; needs OpenGL."""
    with Running.of(work, context) as usual, Running.of(work, usual.gl_context, large_px) as large:
        times = frame_times(*(each.of_round(each.frame) for each in (usual, large)), rounds=work.rounds)
        sizes = usual.compositor.size_px, large.compositor.size_px
        is_software = usual.gl_context.is_software
    figures = []
    for size, each, goal in zip(sizes, times, (FRAME_GOAL_MS, LARGE_FRAME_GOAL_MS), strict=True):
        gpu, cpu, seen = each.cells()
        figures.append(
            Figure(
                f"whole frame of both eyes, {_by(size)} each, {work.scene.triangle_count} triangles",
                str(seen),
                f"{gpu} of GPU work, {cpu} of CPU",
                goal=f"<= {in_ms(goal)}" + (" on a GPU: not measured" if is_software else ""),
                is_reached=None if is_software else float(np.median(each.seen)) <= goal,
            )
        )
    return Part(figures)


def _by(size: tuple[int, int]) -> str:
    return f"{size[0]} x {size[1]}"

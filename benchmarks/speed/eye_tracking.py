"""What it costs that the map follows the eye: a new field in every frame, and where its solve starts."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from benchmarks.speed.running import Running
from benchmarks.speed.timing import in_ms, ratio, times_ms
from benchmarks.speed.workload import Workload
from wlr_render.mappings import EyeBox
from wlr_render.numerics.arrays import FloatArray
from wlr_render.rendering.gl_ray_maps import GlNodeSolver, GlPlanarSolver
from wlr_render.rendering.ray_map import RayMapPlan, choose_plan
from wlr_render.rendering.warp_grid import WarpGrid
from wlr_render.report.blocks import Cell, ReportTable

SOLVES = "nodes", "pixels"
PRICE_GOAL_SOFTWARE, PRICE_GOAL_GPU = 1.3, 1.1
STEPS_M = (0.0001, 0.001, 0.003)
"""How far the pupil moves between two frames: while it follows something, in a saccade, and after a blink."""
WARM_GOAL = 0.5
_JUDGED = 6


def price_table(work: Workload, context: str) -> ReportTable:
    """A frame with a map for a new viewpoint against the same frame with the map that is there already."""
    rows, name = [], ""
    for solve in SOLVES:
        with Running.of(work, context, solve=solve) as on:
            rows.append(price_row(solve, on.frame, on.gl_context.is_software, work.rounds))
            name = on.compositor.renderer
    notes = (
        f"{len(work.eyes)} eyes on {name}. Each round draws the frame of a viewpoint that is new, and then the same "
        "frame again, when its field is there already; the ratio is the median of the rounds'.",
        "Nodes: a warp grid as coarse as a measured bound allows. Pixels: every display pixel is solved.",
    )
    return ReportTable("The price of eye tracking", ("solve", "new map", "map kept", "price", "goal"), rows, notes)


def price_row(solve: str, frame: Callable[[int], object], software: bool, rounds: int) -> list[Cell]:
    """Its row, of a frame that solves its field only when it is called with another round."""
    times = times_ms(frame, frame, rounds=rounds)
    tracked, kept = np.median(times, axis=0)
    goal = PRICE_GOAL_SOFTWARE if software else PRICE_GOAL_GPU
    return [solve, in_ms(tracked), in_ms(kept), str(ratio(times[:, 0], times[:, 1])), f"<= {goal}"]


@dataclass(frozen=True)
class Iterations:
    """Evaluations of the display polynomial, over the points of some solves: mean and largest."""

    mean: float
    largest: int

    def __str__(self) -> str:
        return f"{self.mean:.2f} / {self.largest}"


def warm_start_table(work: Workload, context: str) -> ReportTable:
    """Cold against warm start: iterations and time, for pupils that have moved by `STEPS_M`."""
    with Running.of(work.one_eye, context) as on:
        rows = [*_shader_rows(on), *_node_rows(on)]
    columns = (
        "solve, step of the pupil",
        "cold: mean / max",
        "warm: mean / max",
        "warm / cold",
        "cold",
        "warm",
        "goal",
    )
    notes = (
        f"Iterations: evaluations of the display polynomial per point, over {_JUDGED} viewpoints. The goal is for the "
        "mean number of iterations. Nodes are solved on the CPU, where iterations are not counted.",
    )
    return ReportTable("Cold and warm start", columns, rows, notes)


def _shader_rows(on: Running) -> Iterator[list[Cell]]:
    plan, mappings = on.compositor.plan("right"), on.work.mappings
    warp_grid = WarpGrid.of_pixels(mappings.display.panel, plan.size_px)
    solve = GlPlanarSolver(on.gl_context, mappings, warp_grid, plan.device_from_camera)
    for step_m in STEPS_M:
        viewpoints = on.work.viewpoints[:_JUDGED]
        cold, warm = iterations(solve, viewpoints, _beside(viewpoints, mappings.eye_box, step_m))
        name = f"every pixel, shader, {step_m * 1e3:g} mm"
        goal = f"<= {WARM_GOAL}"
        yield [name, str(cold), str(warm), f"{warm.mean / cold.mean:.2f}", *_times(on, solve, step_m), goal]


def _node_rows(on: Running) -> Iterator[list[Cell]]:
    plan, mappings = on.compositor.plan("right"), on.work.mappings
    count = choose_plan(mappings).node_count
    nodes = GlNodeSolver(
        on.gl_context, mappings, RayMapPlan.onto_grid(plan.warp_grid.grid, count, plan.device_from_camera)
    )
    for step_m in STEPS_M:
        yield [f"{count} x {count} nodes, CPU, {step_m * 1e3:g} mm", None, None, None, *_times(on, nodes, step_m), None]


def iterations(solve: GlPlanarSolver, viewpoints: FloatArray, before: FloatArray) -> tuple[Iterations, Iterations]:
    """Cold at viewpoints (n, 3), and warm there from the solutions at those before, (n, 3)."""
    cold, warm = [], []
    for last, viewpoint in zip(before, viewpoints, strict=True):
        solve.forget()
        cold.append(solve.solve(viewpoint).read_iterations())
        solve.solve(last)
        warm.append(solve.solve(viewpoint).read_iterations())
    first, second = (Iterations(float(np.mean(found)), int(np.max(found))) for found in (cold, warm))
    return first, second


def _times(on: Running, solve: GlPlanarSolver | GlNodeSolver, step_m: float) -> tuple[str, str]:
    """Cold, and warm from there a step aside."""
    viewpoints = on.work.viewpoints
    beside = _beside(viewpoints, on.work.mappings.eye_box, step_m)

    def cold(turn: int) -> None:
        solve.forget()
        solve.solve(viewpoints[turn])
        on.compositor.finish()

    def warm(turn: int) -> None:
        solve.solve(beside[turn])
        on.compositor.finish()

    first, second = np.median(times_ms(cold, warm, rounds=on.work.rounds), axis=0)
    return in_ms(first), in_ms(second)


def _beside(viewpoints: FloatArray, eye_box: EyeBox, step_m: float) -> FloatArray:
    """A step from each viewpoint (n, 3) towards the eye box's centre, beyond which it may lead."""
    inwards = eye_box.centre - viewpoints
    return np.asarray(viewpoints + step_m * inwards / np.linalg.norm(inwards, axis=-1, keepdims=True))

"""Scaling of the stages with display pixels, polynomial terms and triangles."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass

from benchmarks.speed.running import Running
from benchmarks.speed.scaling import Scaling, scaling_table, time_over
from benchmarks.speed.timing import Run
from benchmarks.speed.workload import Workload, bench_model, bench_scene
from wlr_render.mappings import EyeMappings, require_planar
from wlr_render.numerics.polynomial import term_count
from wlr_render.rendering.gl_raster import GlRaster
from wlr_render.rendering.gl_ray_maps import GlNodeSolver, GlPlanarSolver
from wlr_render.rendering.ray_map import RayMapPlan, choose_plan
from wlr_render.rendering.warp_grid import WarpGrid
from wlr_render.report.blocks import ReportTable


@dataclass(frozen=True)
class Sizes:
    """What is varied.

    Attributes:
        widths_px: of square displays.
        degrees: of the display polynomial, each fitted anew.
        triangles: of the scene, about.
    """

    widths_px: tuple[int, ...] = (512, 1024, 1536, 2048)
    degrees: tuple[int, ...] = (3, 4, 5, 6, 7)
    triangles: tuple[int, ...] = (12_500, 50_000, 200_000, 800_000)


def growth_table(work: Workload, context: str, sizes: Sizes) -> ReportTable:
    """Exponents of the times of one eye's stages; needs OpenGL."""
    work = work.one_eye.with_rounds(max(3, work.rounds // 2))
    found = [*_over_pixels(work, context, sizes.widths_px), *_over_terms(work, context, sizes.degrees)]
    return scaling_table([*found, _over_triangles(work, context, sizes.triangles)])


def _over_pixels(work: Workload, context: str, widths: Sequence[int]) -> Iterator[Scaling]:
    with ExitStack() as opened:
        running = {
            width**2: opened.enter_context(Running.of(work, context, (width, width), solve="pixels"))
            for width in widths
        }

        def field(pixels: int) -> Run:
            on = running[pixels]
            plan = on.compositor.plan("right")
            warp_grid = WarpGrid.of_pixels(work.mappings.display.panel, plan.size_px)
            solve = GlPlanarSolver(on.gl_context, work.mappings, warp_grid, plan.device_from_camera)
            return on.then_finished(lambda turn: solve.solve(work.viewpoints[turn]))

        def warp(pixels: int) -> Run:
            on = running[pixels]
            on.frame(0)
            return on.finished(on.compositor.compose)

        jobs: dict[str, Callable[[int], Run]] = {
            "field of every pixel": field,
            "warp": warp,
            "whole frame, every pixel solved": lambda pixels: running[pixels].frame,
        }
        for name, prepare in jobs.items():
            yield time_over(name, "pixels", list(running), prepare, work.rounds)


def _over_terms(work: Workload, context: str, degrees: Sequence[int]) -> Iterator[Scaling]:
    """Fits of one calibration by polynomials of several degrees."""
    panel = work.mappings.display.panel
    models = {}
    for degree in degrees:
        model = bench_model(panel, display_degree=degree)
        forward = require_planar(model)[0].forward
        models[term_count(len(forward.box.low), degree)] = model
    with Running.of(work, context) as on:
        plan = on.compositor.plan("right")
        axes, pixels = plan.device_from_camera, WarpGrid.of_pixels(panel, plan.size_px)

        def shader(terms: int) -> Run:
            solve = GlPlanarSolver(on.gl_context, models[terms], pixels, axes)
            return on.then_finished(lambda turn: solve.solve(work.viewpoints[turn]))

        def nodes(terms: int) -> Run:
            model: EyeMappings = models[terms]
            solve = GlNodeSolver(
                on.gl_context,
                model,
                RayMapPlan.onto_grid(plan.warp_grid.grid, choose_plan(model).node_count, axes),
            )
            return on.then_finished(lambda turn: solve.solve(work.viewpoints[turn]))

        yield time_over("field of every pixel", "terms", list(models), shader, work.rounds)
        yield time_over("field from nodes (CPU)", "terms", list(models), nodes, work.rounds)


def _over_triangles(work: Workload, context: str, triangles: Sequence[int]) -> Scaling:
    scenes = {scene.triangle_count: scene for scene in map(bench_scene, triangles)}
    with Running.of(work, context) as on:
        (camera,) = on.begin(0).values()

        def picture(count: int) -> Run:
            raster = GlRaster(on.gl_context, scenes[count])
            return on.finished(lambda: raster.draw_on_gpu(camera.view))

        return time_over("intermediate view", "triangles", list(scenes), picture, work.rounds)

"""How fast, as ratios against what a user would run otherwise, in one process; how exact the fast map is; how big.

Each pair is timed alternately, so that a busy machine slows both sides alike; figures are medians.
"""

import multiprocessing
import platform
import resource
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from wlr_render.calibration.fit_eye import fit_eye
from wlr_render.captures.correspondences import EyeCaptures
from wlr_render.evaluation.report import Cell, ReportTable, tables_as_json
from wlr_render.files import output_folder, write_text
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.mappings import EyeMappings, FloatArray, Panel
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.rendering.painters import Painter, TracedPainter, WarpedPainter
from wlr_render.rendering.rasteriser import open_rasteriser
from wlr_render.rendering.ray_field import NEAREST_M, choose_plan, exact_field, ray_field
from wlr_render.rendering.ray_render import RayRenderer
from wlr_render.rendering.scene import Instance, Light, Mesh, Scene, world_normals, world_positions
from wlr_render.rendering.shapes.sculpture import sculpture
from wlr_render.rendering.view import View
from wlr_render.rendering.workers import worker_count
from wlr_render.studies.alignment_demo import simulated_captures
from wlr_render.studies.bench_baselines import bare_gl_frame, raw_embree
from wlr_render.studies.progress import Progress, silent

HEAD_POSE = np.eye(4)
_ROUNDS = 15
_MODEL_SEED = 1


@dataclass(frozen=True)
class Options:
    """What to measure: the backend of the raster path, and where the table goes."""

    backend: str = "auto"
    out: Path = Path("out/bench")


@dataclass(frozen=True, eq=False)
class _Workload:
    """One headset model, one mesh of about 100,000 triangles, one light, 1440 x 1600."""

    mappings: EyeMappings
    scene: Scene
    viewpoints: FloatArray


def run(options: Options, progress: Progress = silent) -> list[ReportTable]:
    """Measure; writes bench.md and bench.json into `options.out`."""
    folder = output_folder(options.out)
    work = _workload()
    parts: list[Callable[[], list[list[Cell]]]] = [
        partial(_ray_rows, work),
        partial(_raster_rows, work, options.backend),
        partial(_map_rows, work),
        partial(_memory_rows, options.backend),
    ]
    rows = [row for part in progress(iter(parts), len(parts), "benchmarks") for row in part()]
    notes = (f"{worker_count()} processors, {platform.machine()}, Python {platform.python_version()}.", *_NOTES)
    title = f"Speed at 1440 x 1600, {work.scene.triangle_count} triangles"
    table = ReportTable(title, ("what", "ours", "baseline", "ours / baseline", "goal"), rows, notes)
    write_text(folder / "bench.md", table.markdown())
    write_text(folder / "bench.json", tables_as_json([table]))
    return [table]


_NOTES = (
    "Ray path baseline: embreex's own query of the same rays, shared out over the same threads.",
    "Raster path baseline: a bare ModernGL pass of the same mesh, warped by a map uploaded once, read back.",
)


def _workload() -> _Workload:
    mappings = bench_model(Panel(1440, 1600))
    rng = np.random.default_rng(3)
    return _Workload(mappings, bench_scene(), mappings.eye_box.at(rng.uniform(-1, 1, (_ROUNDS + 1, 3))))


def bench_model(panel: Panel) -> EyeMappings:
    """A planar model of northstar whose panel has been given another number of pixels."""
    truth = traced_eye(load_device("northstar"), "right")
    captures = simulated_captures(truth, _MODEL_SEED)
    pixel = captures.display.pixel / captures.display.panel.size_px * panel.size_px
    scaled = EyeCaptures(replace(captures.display, panel=panel, pixel=pixel), captures.see_through)
    return fit_eye(scaled, "planar", 5, 3).mappings


def bench_scene() -> Scene:
    """The sculpture alone, large in the field, one directional light."""
    mesh = sculpture(height_m=0.5, around=64, along=782)
    placed = np.eye(4)
    placed[:3, 3] = [0.03, -0.45, -0.8]
    light = Light("directional", np.array([-0.36, -0.8, -0.48]), np.full(3, 0.9, np.float32))
    return Scene("bench", (mesh,), (Instance("sculpture", 0, placed),), (light,))


def _alternately(*runs: Callable[[int], object]) -> list[float]:
    """Median milliseconds of each, run in turn; the first round warms up and is dropped."""
    times = np.empty((_ROUNDS + 1, len(runs)))
    for turn in range(_ROUNDS + 1):
        for number, each in enumerate(runs):
            start = time.perf_counter()
            each(turn)
            times[turn, number] = time.perf_counter() - start
    return [float(x) for x in np.median(times[1:], axis=0) * 1e3]


def _ms(value: float) -> str:
    return f"{value:.1f} ms"


def _ray_rows(work: _Workload) -> list[list[Cell]]:
    renderer = RayRenderer(work.scene)
    painter = TracedPainter(work.mappings, renderer)
    field = ray_field(work.mappings, work.viewpoints[0], choose_plan(work.mappings))
    origin, direction = field.world_rays(HEAD_POSE)
    raw = raw_embree(work.scene, origin, direction)
    raw_ms, ours_ms, frame_ms = _alternately(
        lambda _: raw(),
        lambda _: renderer.tracer.intersect(origin, direction),
        lambda turn: painter.paint(work.viewpoints[turn], HEAD_POSE),
    )
    rays = len(direction) / 1e3
    return [
        [
            "intersections (rate)",
            f"{rays / ours_ms:.1f} Mrays/s",
            f"{rays / raw_ms:.1f} Mrays/s",
            raw_ms / ours_ms,
            ">= 0.8",
        ],
        ["whole ray-traced frame", _ms(frame_ms), _ms(raw_ms), frame_ms / raw_ms, "< 4"],
    ]


def _raster_rows(work: _Workload, backend: str) -> list[list[Cell]]:
    rasteriser = open_rasteriser(work.scene, backend)
    painter = WarpedPainter(work.mappings, rasteriser)
    name = f"whole raster frame ({rasteriser.backend})"
    if rasteriser.backend != "egl":
        (frame_ms,) = _alternately(lambda turn: painter.paint(work.viewpoints[turn], HEAD_POSE))
        return [[name, _ms(frame_ms), None, None, "needs EGL for its baseline"]]
    panel, centre = work.mappings.display.panel, work.mappings.eye_box.centre
    axes = choose_plan(work.mappings).device_from_camera
    view = View(_at_display_size(painter.camera, panel), centre, HEAD_POSE, axes)
    fixed = painter.paint(centre, HEAD_POSE, with_geometry=True).source
    assert fixed is not None
    source_uv = np.nan_to_num(fixed[..., :2] / [painter.camera.width_px, painter.camera.height_px])
    bare = bare_gl_frame(_in_world(work.scene), view, source_uv.astype(np.float32))
    bare_ms, frame_ms = _alternately(lambda _: bare(), lambda turn: painter.paint(work.viewpoints[turn], HEAD_POSE))
    return [[name, _ms(frame_ms), _ms(bare_ms), frame_ms / bare_ms, "<= 2.5"]]


def _at_display_size(camera: Pinhole, panel: Panel) -> Pinhole:
    return Pinhole(panel.width_px, panel.height_px, camera.tangent_min, camera.tangent_max)


def _in_world(scene: Scene) -> Mesh:
    """The scene's one mesh, placed."""
    (instance,) = scene.instances
    mesh = scene.mesh_of(instance)
    return replace(
        mesh,
        position=world_positions(mesh, instance).astype(np.float32),
        normal=world_normals(mesh, instance).astype(np.float32),
    )


def _map_rows(work: _Workload) -> list[list[Cell]]:
    plan = choose_plan(work.mappings)
    (map_ms,) = _alternately(lambda turn: ray_field(work.mappings, work.viewpoints[turn], plan))
    error = map_error_px(work.mappings, work.viewpoints[1])
    nodes = plan.node_pixel.shape[0]
    return [
        [f"map for a new viewpoint ({nodes} x {nodes} nodes)", _ms(map_ms), None, None, "<= 30 ms"],
        ["its error at the worst pixel", f"{error:.4f} px", "exact solve", None, "<= 0.02 px"],
    ]


def map_error_px(mappings: EyeMappings, viewpoint: FloatArray) -> float:
    """Largest difference between the fast field and the exact solve of every pixel, in display pixels.

    Differences of the tangents at infinity and at the nearest depth, over the size of the pixel.
    """
    plan = choose_plan(mappings)
    fast = ray_field(mappings, viewpoint, plan).bend
    exact = exact_field(mappings, viewpoint, plan.device_from_camera).bend
    pixel_size = np.minimum(*(np.hypot(*np.gradient(exact[:2], axis=axis)) for axis in (1, 2)))
    difference = fast - exact
    at_depths = (np.hypot(*(difference[:2] + difference[2:] / depth)) for depth in (NEAREST_M, np.inf))
    return float(max((moved / pixel_size).max() for moved in at_depths))


def _memory_rows(backend: str) -> list[list[Cell]]:
    rows: list[list[Cell]] = []
    for method in ("raster", "raytrace"):
        # A process of its own, so that nothing else counts; spawned, because forking after OpenGL hangs.
        with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
            peak = pool.submit(peak_memory_gb, method, backend).result()
        rows.append([f"peak memory, one 2048 x 2048 frame ({method})", f"{peak:.2f} GB", None, None, "< 1.5 GB"])
    return rows


def peak_memory_gb(method: str, backend: str) -> float:
    """Peak resident memory of this process after making one 2048 x 2048 frame."""
    mappings, scene = bench_model(Panel(2048, 2048)), bench_scene()
    painter: Painter
    if method == "raytrace":
        painter = TracedPainter(mappings, RayRenderer(scene))
    else:
        painter = WarpedPainter(mappings, open_rasteriser(scene, backend))
    painter.paint(mappings.eye_box.centre, HEAD_POSE)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1e9 if sys.platform == "darwin" else 1e6)  # macOS counts bytes, Linux kilobytes

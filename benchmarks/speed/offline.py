"""Times of the stages of an offline frame (rays, raster and warp with read-back, map of a new viewpoint), and memory.

Both sides of a comparison are timed alternately, so that a busy machine slows both equally; figures are medians.
"""

import multiprocessing
import resource
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.speed.baselines import bare_gl_frame, raw_embree, shaded_gl_frame
from benchmarks.speed.figures import Figure, Part, ratio_figure
from benchmarks.speed.timing import alternately, in_ms, ratio, times_ms
from benchmarks.speed.workload import HEAD_POSE, Workload, bench_model, bench_scene
from wlr_render.draw.painters import Painter, TracedPainter
from wlr_render.draw.raster_painter import WarpedPainter
from wlr_render.draw.ray_tracing import RayRenderer
from wlr_render.draw.scene_raster import SceneRaster, open_scene_raster
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.gl.gl import open_context
from wlr_render.jobs.frame_drawing import FrameDrawing, OpenedFiles
from wlr_render.jobs.frame_plan import PlannedFrame
from wlr_render.jobs.render_options import RenderOptions
from wlr_render.mappings import Eye, Panel
from wlr_render.numerics.arrays import FloatArray
from wlr_render.report.blocks import Cell
from wlr_render.warp.ray_map import NEAREST_M, choose_plan, ray_map, solve_every_pixel

RASTER_GOAL = 1.6
_SEQUENCES = 2  # timed sequences of frames, each with a frame for every place of the workload


def ray_rows(work: Workload) -> list[list[Cell]]:
    """Tabulate the speed of intersections and of the whole ray-traced frame against raw Embree."""
    renderer = RayRenderer(work.scene)
    painter = TracedPainter(work.mappings, renderer)
    field = ray_map(work.mappings, work.viewpoints[0], choose_plan(work.mappings))
    origin, direction = field.world_rays(HEAD_POSE)
    raw = raw_embree(work.scene, origin, direction)
    raw_ms, ours_ms, frame_ms = alternately(
        lambda _: raw(),
        lambda _: renderer.tracer.intersect(origin, direction),
        lambda turn: painter.paint(work.viewpoints[turn], HEAD_POSE).colour,
        rounds=work.rounds,
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
        ["whole ray-traced frame", in_ms(frame_ms), in_ms(raw_ms), frame_ms / raw_ms, "< 4"],
    ]


def raster_part(work: Workload, backend: str, resolution: float = 1.0) -> Part:
    """Time the whole raster frame against bare OpenGL passes of the same resolution with a fixed map."""
    raster = open_scene_raster(work.scene, backend)
    if raster is None:
        return Part()
    painter = WarpedPainter(work.mappings, raster, resolution)
    name = "offline raster frame: new map, picture, warp, read-back"
    if raster.backend != "egl":
        (frame_ms,) = alternately(
            lambda turn: painter.paint(work.viewpoints[turn], HEAD_POSE).colour, rounds=work.rounds
        )
        return Part([Figure(name, in_ms(frame_ms), "its baseline needs EGL")])
    panel, centre = work.mappings.display.panel, work.mappings.eye_box.centre
    drawn_from = painter.view(centre, HEAD_POSE)
    view = replace(drawn_from, camera=_at_display_size(drawn_from.camera, panel, resolution))
    fixed = painter.paint(centre, HEAD_POSE, with_geometry=True).source
    assert fixed is not None
    source_uv = np.nan_to_num(fixed[..., :2] / [drawn_from.camera.width_px, drawn_from.camera.height_px])
    of_scene = work.scene, view, source_uv.astype(np.float32)
    shaded, plain = shaded_gl_frame(*of_scene), bare_gl_frame(*of_scene)
    ours, same, bare = times_ms(
        lambda turn: painter.paint(work.viewpoints[turn], HEAD_POSE).colour,
        lambda _: shaded(),
        lambda _: plain(),
        rounds=work.rounds,
    ).T
    ours_ms, same_ms, bare_ms = (in_ms(np.median(each)) for each in (ours, same, bare))
    return Part(
        [
            ratio_figure(
                name, ours_ms, f"{same_ms} (bare ModernGL, same shading, fixed map)", ratio(ours, same), RASTER_GOAL
            ),
            ratio_figure(
                "the same",
                ours_ms,
                f"{bare_ms} (bare ModernGL, plain shading, sRGB codes, fixed map)",
                ratio(ours, bare),
            ),
        ]
    )


def _at_display_size(camera: Pinhole, panel: Panel, resolution: float = 1.0) -> Pinhole:
    width, height = (round(resolution * count) for count in (panel.width_px, panel.height_px))
    return Pinhole(width, height, camera.tangent_min, camera.tangent_max)


def written_rows(work: Workload, backend: str) -> list[list[Cell]]:
    """Tabulate the frame rate of `render` with PNG files at resolution 1, and of mere drawing and read-back."""
    raster = open_scene_raster(work.scene, backend)
    if raster is None:
        return []
    plan = [PlannedFrame(index, 0.0, "right", place, HEAD_POSE) for index, place in enumerate(work.viewpoints)]
    opened = OpenedFiles({"right": (work.mappings,)}, {}, work.scene, {})
    painter = WarpedPainter(work.mappings, raster, resolution=1.0)
    with raster.context, tempfile.TemporaryDirectory() as folder:
        options = RenderOptions("", "", resolution=1.0, out=Path(folder))
        drawing = FrameDrawing(options, opened, raster)
        written_ms, drawn_ms = alternately(
            lambda _: list(drawing.frames(plan)),
            lambda _: [painter.paint(frame.viewpoint, frame.world_from_device).colour for frame in plan],
            rounds=_SEQUENCES,
        )
    rates = [f"{1e3 * len(plan) / ms:.1f} frames/s" for ms in (written_ms, drawn_ms)]
    return [["frames of `render` with their PNG; drawn alone", *rates, written_ms / drawn_ms, ">= 50 frames/s"]]


def map_rows(work: Workload) -> list[list[Cell]]:
    """Tabulate the time and the error of the map for a new viewpoint."""
    plan = choose_plan(work.mappings)
    (map_ms,) = alternately(lambda turn: ray_map(work.mappings, work.viewpoints[turn], plan), rounds=work.rounds)
    error = map_error_px(work.mappings, work.viewpoints[1])
    nodes = plan.node_pixel.shape[0]
    return [
        [f"map for a new viewpoint ({nodes} x {nodes} nodes)", in_ms(map_ms), None, None, "<= 30 ms"],
        ["its error at the worst pixel", f"{error:.4f} px", "exact solve", None, "<= 0.02 px"],
    ]


def map_error_px(mappings: Eye, viewpoint: FloatArray) -> float:
    """Return the largest difference between the fast field and the exact solution of every pixel, in display pixels.

    The tangents at infinity and at the nearest depth are compared, and the differences divided by the pixel's size.
    """
    plan = choose_plan(mappings)
    fast = ray_map(mappings, viewpoint, plan).slope_offset
    exact = solve_every_pixel(mappings, viewpoint, plan.device_from_camera).slope_offset
    pixel_size = np.minimum(*(np.hypot(*np.gradient(exact[:2], axis=axis)) for axis in (1, 2)))
    difference = fast - exact
    at_depths = (np.hypot(*(difference[:2] + difference[2:] / depth)) for depth in (NEAREST_M, np.inf))
    return float(max((moved / pixel_size).max() for moved in at_depths))


def memory_rows(backend: str) -> list[list[Cell]]:
    """Tabulate the peak memory of one frame for both drawing methods."""
    rows: list[list[Cell]] = []
    for method in ("raster", "raytrace") if backend != "cpu" else ("raytrace",):
        # A separate process counts only its own memory; it is spawned, because forking after OpenGL hangs.
        with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
            peak = pool.submit(peak_memory_gb, method, backend).result()
        rows.append([f"peak memory, one 2048 x 2048 frame ({method})", f"{peak:.2f} GB", None, None, "< 1.5 GB"])
    return rows


def peak_memory_gb(method: str, backend: str) -> float:
    """Return the peak resident memory of this process, in GB, after it has drawn one 2048 x 2048 frame."""
    mappings, scene = bench_model(Panel(2048, 2048)), bench_scene()
    painter: Painter
    if method == "raytrace":
        painter = TracedPainter(mappings, RayRenderer(scene))
    else:
        painter = WarpedPainter(mappings, SceneRaster(open_context(backend), scene))
    _ = painter.paint(mappings.eye_box.centre, HEAD_POSE).colour
    return _peak_resident_gb()


def _peak_resident_gb() -> float:
    """Return the peak of this process. On Linux, getrusage's peak starts at the size of the parent process."""
    if sys.platform == "darwin":
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e9
    status = Path("/proc/self/status").read_text(encoding="utf-8")
    return next(float(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM:")) / 1e6

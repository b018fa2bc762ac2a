"""Compare our warp with warps by a fixed map on the same picture: Monado's two schemes, and cv2.remap."""

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager

import numpy as np
from numpy.typing import NDArray

from benchmarks.speed.baselines_warp import image_maps_warp, mesh_warp, remap_warp, timewarp
from benchmarks.speed.frozen_map import IMAGE_MAPS, MESH, Scheme, frozen_map
from benchmarks.speed.running import Running
from benchmarks.speed.timing import Run, in_ms, ratio, times_ms
from benchmarks.speed.workload import Workload
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.rendering.ray_map import middle_axes
from wlr_render.report.blocks import Cell, ReportTable

OURS = "ours"


def warp_table(work: Workload, context: str) -> ReportTable:
    """Times of warps of one picture; those of Monado where there is EGL."""
    work = work.one_eye
    with ExitStack() as opened:
        on = opened.enter_context(Running.of(work, context))
        (camera,) = on.begin(0).values()
        on.source.submit(camera)
        picture, source = on.source.read(camera.view).colour, on.compositor.compose(with_source=True).source()
        remap, three = remap_warp(picture, source), opened.enter_context(Running.of(work, context, channels=3))
        three.frame(0)
        runs: dict[str, Run] = {
            OURS: on.finished(on.compositor.compose),
            "ours, a field for each colour": three.finished(three.compositor.compose),
            "cv2.remap by a map of every pixel (CPU)": lambda _: remap(),
        }
        if on.gl_context.backend == "egl":
            for scheme in (MESH, IMAGE_MAPS):
                runs[f"Monado: {scheme.name}"] = opened.enter_context(_monado(on, scheme, picture, camera.view.camera))
        rows, samples_per_axis = warp_rows(runs, work.rounds), on.compositor.plan("right").samples_per_axis
    notes = (
        f"Ours follows every ray to the picture's depth and takes {samples_per_axis**2} samples a pixel; the others "
        "look each colour up once. Each time includes the wait for the end.",
        "Monado's schemes need EGL. What they get wrong is in the table on maps that are computed once.",
    )
    return ReportTable("Warps of one picture", ("warp", "time", "ours / this"), rows, notes)


def warp_rows(runs: Mapping[str, Run], rounds: int) -> list[list[Cell]]:
    """Times of all, and how many times longer `OURS` takes."""
    times = times_ms(*runs.values(), rounds=rounds).T
    ours = times[list(runs).index(OURS)]
    return [[name, in_ms(np.median(each)), str(ratio(ours, each))] for name, each in zip(runs, times, strict=True)]


@contextmanager
def _monado(on: Running, scheme: Scheme, picture: NDArray[np.uint8], camera: Pinhole) -> Iterator[Run]:
    """A scheme with the map for the eye box's centre, the same for all colours."""
    mappings = on.work.mappings
    shown = frozen_map(mappings, scheme, mappings.eye_box.centre, middle_axes(mappings))
    channel_uv = np.stack([shown.texture_uv(camera)] * 3)
    if scheme is MESH:
        warp = mesh_warp(picture, channel_uv, on.compositor.size_px)
    else:
        warp = image_maps_warp(picture, channel_uv, on.compositor.size_px, timewarp(camera, np.eye(3)))

    def run(_: int) -> None:
        warp.draw()
        warp.finish()

    try:
        yield run
    finally:
        warp.release()

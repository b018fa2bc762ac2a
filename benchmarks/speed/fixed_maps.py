"""Compare our warp with warps by a fixed map on the same picture: Monado's two schemes, and cv2.remap."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import numpy as np
from numpy.typing import NDArray

from benchmarks.speed.baselines_warp import image_maps_warp, mesh_warp, remap_warp, timewarp
from benchmarks.speed.figures import Part, frame_ratio_figures
from benchmarks.speed.frozen_map import IMAGE_MAPS, MESH, Scheme, frozen_map
from benchmarks.speed.running import Running
from benchmarks.speed.timing import TIME_COLUMNS, TIMES_NOTE, GpuRun, frame_times, ratio
from benchmarks.speed.workload import Workload
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.report.blocks import ReportTable
from wlr_render.warp.ray_map import middle_axes

OURS, WARP_GOAL = "ours", 0.9


def warps(work: Workload, context: str) -> Part:
    """Time warps of one picture, including Monado's if EGL is available."""
    work = work.one_eye
    with ExitStack() as opened:
        on = opened.enter_context(Running.of(work, context))
        (camera,) = on.begin(0).values()
        on.source.submit(camera)
        picture, source = on.source.read(camera.view).colour, on.compositor.compose(with_source=True).source()
        remap, three = remap_warp(picture, source), opened.enter_context(Running.of(work, context, channels=3))
        runs = {
            OURS: on.warp_of_a_new_picture(),
            "ours, a ray map for each colour": three.warp_of_a_new_picture(),
            "cv2.remap by a map of every pixel (CPU)": GpuRun(lambda _: remap(), None),
        }
        if on.gl_context.backend == "egl":
            for scheme in (MESH, IMAGE_MAPS):
                runs[f"Monado: {scheme.name}"] = opened.enter_context(_monado(on, scheme, picture, camera.view.camera))
        times = dict(zip(runs, frame_times(*runs.values(), rounds=work.rounds), strict=True))
        samples_per_axis = on.compositor.plan("right").samples_per_axis
    notes = (
        "Ours begins a frame with a new picture, composes it into a framebuffer of the host, follows every ray to its "
        f"depth, and takes up to {samples_per_axis**2} samples a pixel where the map minifies; the others look each "
        "colour up once.",
        "Monado's schemes need EGL. What they get wrong is in the table on maps that are computed once.",
        TIMES_NOTE,
    )
    rows = [[name, *each.cells(), str(ratio(times[OURS].seen, each.seen))] for name, each in times.items()]
    table = ReportTable("Warps of one picture", ("warp", *TIME_COLUMNS, "ours / this, as seen"), rows, notes)
    name, maps = f"Monado: {IMAGE_MAPS.name}", f"Monado's three maps of {IMAGE_MAPS.points} x {IMAGE_MAPS.points}"
    if name not in times:
        return Part(tables=[table])
    return Part(
        frame_ratio_figures("warp that follows depth", times[OURS], times[name], maps, WARP_GOAL), tables=[table]
    )


@contextmanager
def _monado(on: Running, scheme: Scheme, picture: NDArray[np.uint8], camera: Pinhole) -> Iterator[GpuRun]:
    """Open a scheme with the eye box centre's map, the same for all colours."""
    mappings = on.work.mappings
    shown = frozen_map(mappings, scheme, mappings.eye_box.centre, middle_axes(mappings))
    channel_uv = np.stack([shown.texture_uv(camera)] * 3)
    if scheme is MESH:
        warp = mesh_warp(picture, channel_uv, on.compositor.size_px)
    else:
        warp = image_maps_warp(picture, channel_uv, on.compositor.size_px, timewarp(camera, np.eye(3)))

    try:
        yield GpuRun(lambda _: warp.draw(), lambda: warp.context)
    finally:
        warp.release()

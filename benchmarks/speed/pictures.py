"""Pictures that are hard to warp: a near object while the head moves, and minified stripes of one pixel."""

from contextlib import ExitStack
from functools import partial

import numpy as np
from numpy.typing import NDArray

from benchmarks.speed.figures import Figure, Part, frame_ratio_figures
from benchmarks.speed.running import Running
from benchmarks.speed.timing import frame_times
from benchmarks.speed.workload import HEAD_POSE, Workload
from wlr_render.geometry import transforms
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.numerics.arrays import Float32Array
from wlr_render.numerics.srgb import decode_srgb
from wlr_render.warp.compositor import Compositor
from wlr_render.warp.stored_picture import DepthKind, StoredDepth

NEAR_M, MOVED_M = 0.1, 0.020
NEAR_GOAL, LIGHT_GOAL = 1.3, 0.01
OBJECTS_M = {"a fingertip of 5 mm": 0.005, "a hand of 80 mm": 0.080}
"""Widths of the near object, by name."""
_INVERSE = StoredDepth(DepthKind.INVERSE)


def near_object(work: Workload, context: str) -> Part:
    """Compare the times of warping a picture with a near object and the same picture without it."""
    work = work.one_eye
    moved = HEAD_POSE @ transforms.rigid(np.eye(3), np.array([MOVED_M, 0.0, 0.0]))
    with ExitStack() as opened:
        first = opened.enter_context(Running.of(work, context))
        others = [opened.enter_context(Running.of(work, first.gl_context)) for _ in OBJECTS_M]
        runs = []
        for on, width_m in zip([first, *others], [0.0, *OBJECTS_M.values()], strict=True):
            (camera,) = on.begin(0).values()
            picture = on.source.read(camera.view)
            colour, inverse_depth = picture.colour.copy(), picture.inverse_depth.copy()
            corner = near_pixels(camera.view.camera, width_m)
            colour[corner], inverse_depth[corner] = 200, 1.0 / NEAR_M
            on.compositor.submit(colour, inverse_depth, stored=_INVERSE)
            runs.append(on.same(partial(on.compositor.compose, pose=moved)))
        without, *times = frame_times(*runs, rounds=work.rounds)
    moved_by = f"{NEAR_M:g} m away, head moved by {MOVED_M * 1e3:g} mm"
    return Part(
        [
            figure
            for name, each in zip(OBJECTS_M, times, strict=True)
            for figure in frame_ratio_figures(f"warp with {name} {moved_by}", each, without, "nothing near", NEAR_GOAL)
        ]
    )


def near_pixels(camera: Pinhole, width_m: float) -> tuple[slice, slice]:
    """Return a square of that width at `NEAR_M`, near the upper left corner of a camera's picture."""
    across, down = (max(1, round(float(focal) * width_m / NEAR_M)) if width_m else 0 for focal in camera.focal_px)
    return slice(down // 2, down // 2 + down), slice(across // 2, across // 2 + across)


def linear_light(work: Workload, context: str) -> Part:
    """Measure the mean displayed light of black and white stripes of one pixel, minified two times."""
    shown = stripes_light(work, context)
    return Part(
        [
            Figure(
                "mean linear light of 1 px stripes, minified 2 times",
                f"{shown:.3f}",
                "0.500 (the stripes' mean)",
                f"{shown / 0.5:.2f}",
                f"0.50 +- {LIGHT_GOAL:g}",
                abs(shown - 0.5) <= LIGHT_GOAL,
            )
        ]
    )


def stripes_light(work: Workload, context: str) -> float:
    """Return the mean linear light over the middle half of the display, 0 to 1."""
    panel = work.mappings.display.panel
    size = panel.width_px, panel.height_px
    with Compositor(work.mappings, size, context=context, resolution=2.0) as compositor:
        (camera,) = compositor.begin_frame(HEAD_POSE, work.mappings.eye_box.centre).values()
        compositor.submit(*striped(*camera.size_px))
        shown = compositor.compose().read()
    quarter = panel.height_px // 4, panel.width_px // 4
    return float(decode_srgb(shown[quarter[0] : -quarter[0], quarter[1] : -quarter[1]]).mean())


def striped(width: int, height: int) -> tuple[NDArray[np.uint8], Float32Array]:
    """Return the colour (height, width, 3) of vertical stripes, and the depth (height, width) of a wall at 1 m."""
    columns = (255 * (np.arange(width) % 2)).astype(np.uint8)
    return np.broadcast_to(columns[:, None], (height, width, 3)).copy(), np.ones((height, width), np.float32)

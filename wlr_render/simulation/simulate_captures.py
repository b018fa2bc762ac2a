"""What the bench would measure: captures of the panel and of targets, from exact mappings plus noise."""

from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.correspondences import DisplayCaptures, SeeThroughCaptures, concatenate
from wlr_render.geometry.directions import ARCMIN, normalised
from wlr_render.simulation.bench import Bench

FloatArray = NDArray[np.float64]
AnyCaptures = TypeVar("AnyCaptures", DisplayCaptures, SeeThroughCaptures)


def simulate_display(bench: Bench, viewpoint: FloatArray, rng: np.random.Generator) -> DisplayCaptures:
    """Decode the panel from camera positions; what is not seen from there is left out.

    Args:
        bench: the bench.
        viewpoint: (m, 3) positions that the stage reports; the true ones differ by the stage error.
        rng: source of the stage error and the camera noise.

    Raises:
        BadInputError: nothing is seen from anywhere.
    """
    actual = _actual_positions(bench, viewpoint, rng)
    position, pixel, view_dir = _decoded(bench, actual)
    captures = DisplayCaptures(
        device=bench.truth.name,
        eye=bench.truth.eye,
        eye_box=bench.truth.eye_box,
        panel=bench.truth.display.panel,
        viewpoint=viewpoint[position],
        view_dir=view_dir,
        pixel=pixel,
        capture=position,
        sigma_arcmin=np.zeros(len(position)),
    )
    return with_camera_noise(captures, bench.camera_noise_arcmin, rng)


def _decoded(bench: Bench, actual: FloatArray) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
    """Which position (n,) saw which panel pixel (n, 2) in which direction (n, 3)."""
    if bench.camera_field is None:
        pixel = bench.pixels()
        seen = bench.truth.display.view_dir_of_pixel(pixel[None], actual[:, None])
        position, column = np.nonzero(seen.usable)
        return position, pixel[column], seen.value[position, column]
    view_dir = bench.camera_dirs()
    shown = bench.truth.display.pixel_of_view_dir(view_dir[None], actual[:, None])
    position, column = np.nonzero(shown.usable)
    return position, shown.value[position, column], view_dir[column]


def simulate_see_through(bench: Bench, viewpoint: FloatArray, rng: np.random.Generator) -> SeeThroughCaptures:
    """Photograph the dots of every target through the optics; the camera's field is the display's.

    Args:
        bench: the bench.
        viewpoint: (m, 3) positions that the stage reports; it is driven anew for each target.
        rng: source of the stage error and the camera noise.

    Raises:
        BadInputError: nothing is seen from anywhere.
    """
    parts = [_one_target(bench, number, viewpoint, rng) for number in range(len(bench.target_depths_m))]
    return with_camera_noise(concatenate(parts), bench.camera_noise_arcmin, rng)


def _one_target(bench: Bench, number: int, viewpoint: FloatArray, rng: np.random.Generator) -> SeeThroughCaptures:
    actual = _actual_positions(bench, viewpoint, rng)
    dot = bench.dots(bench.target_depths_m[number], viewpoint)
    seen = bench.truth.see_through.view_dir_of_real_point(dot[None], actual[:, None])
    position, column = np.nonzero(seen.usable & bench.field.contains(seen.value))
    return SeeThroughCaptures(
        device=bench.truth.name,
        eye=bench.truth.eye,
        eye_box=bench.truth.eye_box,
        viewpoint=viewpoint[position],
        view_dir=seen.value[position, column],
        point=dot[column],
        capture=position,
        target_pose=np.full(len(position), number),
        sigma_arcmin=np.zeros(len(position)),
    )


def with_camera_noise(captures: AnyCaptures, sigma_arcmin: float, rng: np.random.Generator) -> AnyCaptures:
    """Turn every measured direction by Gaussian angles about two transverse axes, and record their sigma.

    The noise is equal in all directions at every place in the field, as of a camera that is turned towards the dot.
    """
    if sigma_arcmin == 0.0:
        return captures
    kick = rng.normal(0.0, sigma_arcmin * ARCMIN, captures.view_dir.shape)
    along = np.sum(kick * captures.view_dir, axis=-1, keepdims=True)
    noisy = normalised(captures.view_dir + kick - along * captures.view_dir)
    return replace(captures, view_dir=noisy, sigma_arcmin=np.full(len(captures), sigma_arcmin))


def _actual_positions(bench: Bench, viewpoint: FloatArray, rng: np.random.Generator) -> FloatArray:
    return np.asarray(viewpoint + rng.normal(0.0, bench.stage_error_m, viewpoint.shape))

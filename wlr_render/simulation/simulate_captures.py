"""What a bench would measure: captures of the panel and of targets, from exact mappings plus noise."""

from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.correspondences import DisplayCaptures, SeeThroughCaptures, concatenate
from wlr_render.geometry.directions import ARCMIN, normalised
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.capture_setup import CaptureSetup

AnyCaptures = TypeVar("AnyCaptures", DisplayCaptures, SeeThroughCaptures)


def simulate_display(setup: CaptureSetup, viewpoint: FloatArray, rng: np.random.Generator) -> DisplayCaptures:
    """Decode the panel from camera positions; what is not seen from there is left out.

    Args:
        setup: what stands on the bench, and its errors.
        viewpoint: (m, 3) positions that the stage reports; the true ones differ by the stage error.
        rng: source of the stage error and the camera noise.

    Raises:
        BadInputError: nothing is seen from anywhere.
    """
    actual = _actual_positions(setup, viewpoint, rng)
    position, pixel, view_dir = _decoded(setup, actual)
    captures = DisplayCaptures(
        device=setup.truth.name,
        eye=setup.truth.eye,
        eye_box=setup.truth.eye_box,
        panel=setup.truth.display.panel,
        viewpoint=viewpoint[position],
        view_dir=view_dir,
        pixel=pixel,
        capture=position,
        sigma_arcmin=np.zeros(len(position)),
    )
    return with_camera_noise(captures, setup.camera_noise_arcmin, rng)


def _decoded(setup: CaptureSetup, actual: FloatArray) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
    """Which position (n,) saw which panel pixel (n, 2) in which direction (n, 3)."""
    if setup.camera_field is None:
        pixel = setup.pixels()
        seen = setup.truth.display.view_dir_of_pixel(pixel[None], actual[:, None])
        position, column = np.nonzero(seen.usable)
        return position, pixel[column], seen.value[position, column]
    view_dir = setup.camera_dirs()
    shown = setup.truth.display.pixel_of_view_dir(view_dir[None], actual[:, None])
    position, column = np.nonzero(shown.usable)
    return position, shown.value[position, column], view_dir[column]


def simulate_see_through(setup: CaptureSetup, viewpoint: FloatArray, rng: np.random.Generator) -> SeeThroughCaptures:
    """Photograph the dots of every target through the optics; the camera's field is the display's.

    Args:
        setup: what stands on the bench, and its errors.
        viewpoint: (m, 3) positions that the stage reports; it is driven anew for each target.
        rng: source of the stage error and the camera noise.

    Raises:
        BadInputError: nothing is seen from anywhere.
    """
    parts = [_one_target(setup, number, viewpoint, rng) for number in range(len(setup.target_depths_m))]
    return with_camera_noise(concatenate(parts), setup.camera_noise_arcmin, rng)


def _one_target(
    setup: CaptureSetup, number: int, viewpoint: FloatArray, rng: np.random.Generator
) -> SeeThroughCaptures:
    actual = _actual_positions(setup, viewpoint, rng)
    dot = setup.dots(setup.target_depths_m[number], viewpoint)
    seen = setup.truth.see_through.view_dir_of_real_point(dot[None], actual[:, None])
    position, column = np.nonzero(seen.usable & setup.field.contains(seen.value))
    return SeeThroughCaptures(
        device=setup.truth.name,
        eye=setup.truth.eye,
        eye_box=setup.truth.eye_box,
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


def _actual_positions(setup: CaptureSetup, viewpoint: FloatArray, rng: np.random.Generator) -> FloatArray:
    return np.asarray(viewpoint + rng.normal(0.0, setup.stage_error_m, viewpoint.shape))

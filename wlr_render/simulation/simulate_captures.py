"""Simulation of captures of the panel and of targets from exact mappings, with noise and position errors."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.correspondences import AnyCaptures, Captures, DisplayCaptures, SeeThroughCaptures, concatenate
from wlr_render.errors import BadInputError
from wlr_render.geometry import rays
from wlr_render.geometry.directions import ARCMIN, normalised
from wlr_render.geometry.transforms import rotations_of_vectors
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.capture_setup import CaptureSampling, CaptureSetup


def simulate(
    eye: Eye,
    positions: int = 25,
    noise_arcmin: float = 0.25,
    seed: int | Sequence[int] = 1,
    *,
    sampling: CaptureSampling = "planar",
    grid: tuple[int, int] = (25, 21),
    stage_error_m: float = 0.0,
    stage_turn_rad: float = 0.0,
) -> Captures:
    """Simulate a camera's captures of an eye's display and, through the optics, of targets at two depths.

    Args:
        eye: exact optics from `open_eye` of a device.
        positions: number of camera positions in the eye box.
        noise_arcmin: standard deviation of a measured direction about each of its transverse axes.
        seed: seed of all random numbers.
        sampling: region of the camera positions: "planar" for the plane through the centre of the eye box, "volumetric"
            for the whole eye box, "static" for one position at its centre, for any `positions`.
        grid: columns and rows of the panel pixels decoded at each position, and of the dots on each target.
        stage_error_m: standard deviation of the camera's position about the reported one, per axis.
        stage_turn_rad: standard deviation of the camera's rotation about each axis.

    Returns:
        Captures of the display and of the world, device frame, metres; `Captures.save` writes them to a file.

    Raises:
        BadInputError: the sampling is unknown, an error is negative, the grid is empty, or the panel is not visible
            from the eye box.

    Example:
        >>> import wlr_render as wlr
        >>> captures = wlr.simulate(wlr.open_eye("birdbath28"), positions=16)
    """
    setup = CaptureSetup(eye, noise_arcmin, stage_error_m, grid=grid, stage_turn_rad=stage_turn_rad)
    if sampling not in get_args(CaptureSampling):
        raise BadInputError(f"sampling is '{sampling}'; choose from {', '.join(get_args(CaptureSampling))}.")
    viewpoint, rng = setup.camera_positions(sampling, positions), np.random.default_rng(seed)
    return Captures(simulate_display(setup, viewpoint, rng), simulate_see_through(setup, viewpoint, rng))


def simulate_display(setup: CaptureSetup, viewpoint: FloatArray, rng: np.random.Generator) -> DisplayCaptures:
    """Simulate decoding of the panel from camera positions; invisible pixels are left out.

    Args:
        setup: the bench and its errors.
        viewpoint: (m, 3) positions that the stage reports; the true ones differ by the stage errors.
        rng: source of the stage errors and the camera noise.

    Raises:
        BadInputError: nothing is visible from any position.
    """
    position, pixel, view_dir = _decoded(setup, _visited(setup, viewpoint, rng))
    captures = DisplayCaptures(
        device=setup.truth.name,
        eye=setup.truth.eye,
        eye_box=setup.truth.eye_box,
        panel=setup.truth.display.panel,
        viewpoint=viewpoint[position],
        view_dir=view_dir,
        pixel=pixel,
        capture=position,
        sigma_arcmin=np.full(len(position), setup.stated_sigma_arcmin),
    )
    return with_camera_noise(captures, setup.camera_noise_arcmin, rng)


@dataclass(frozen=True)
class _Visits:
    """True camera poses at m visits of the stage.

    Attributes:
        position: (m, 3) true positions.
        turned: (m, 3, 3) rotations from measured to true directions; None for a stage without rotation errors.
    """

    position: FloatArray
    turned: FloatArray | None

    def measured(self, view_dir: FloatArray) -> FloatArray:
        """Return the measured directions (m, n, 3) of true directions (m, n, 3)."""
        return view_dir if self.turned is None else np.asarray(view_dir @ self.turned)

    def true(self, measured: FloatArray) -> FloatArray:
        """Return the true directions (m, n, 3) of measured directions (1, n, 3)."""
        return measured if self.turned is None else np.asarray(measured @ np.swapaxes(self.turned, -1, -2))


_Readings = tuple[NDArray[np.int64], FloatArray, FloatArray]
"""Position number (n,), measured direction (n, 3) and real point (n, 3) of each reading."""


def _visited(setup: CaptureSetup, viewpoint: FloatArray, rng: np.random.Generator) -> _Visits:
    position = np.asarray(viewpoint + rng.normal(0.0, setup.stage_error_m, viewpoint.shape))
    if setup.stage_turn_rad == 0.0 and setup.stage_curve is None:
        return _Visits(position, None)
    turn = rng.normal(0.0, setup.stage_turn_rad, viewpoint.shape)
    if setup.stage_curve is not None:
        curve = setup.stage_curve(viewpoint)
        turn, position = turn + curve[:, :3], position + curve[:, 3:]
    return _Visits(position, rotations_of_vectors(turn))


def _decoded(setup: CaptureSetup, visits: _Visits) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
    """Return the position number (n,), panel pixel (n, 2) and measured direction (n, 3) of each reading."""
    if setup.camera_field is None:
        pixel = setup.truth.display.panel.grid(*setup.grid).reshape(-1, 2)
        view = setup.truth.display.view_dir_of_pixel(pixel[None], visits.position[:, None])
        position, column = np.nonzero(view.usable)
        return position, pixel[column], visits.measured(view.value)[position, column]
    view_dir = setup.camera_dirs()
    shown = setup.truth.display.pixel_of_view_dir(visits.true(view_dir[None]), visits.position[:, None])
    position, column = np.nonzero(shown.usable)
    return position, shown.value[position, column], view_dir[column]


def simulate_see_through(setup: CaptureSetup, viewpoint: FloatArray, rng: np.random.Generator) -> SeeThroughCaptures:
    """Simulate photographs of every target through the optics, with the display's field as the camera's field.

    Args:
        setup: the bench and its errors.
        viewpoint: (m, 3) positions that the stage reports; the stage moves again for each target.
        rng: source of the stage errors and the camera noise.

    Raises:
        BadInputError: nothing is visible from any position.
    """
    parts = [_one_target(setup, number, viewpoint, rng) for number in range(len(setup.target_depths_m))]
    return with_camera_noise(concatenate(parts), setup.camera_noise_arcmin, rng)


def _one_target(
    setup: CaptureSetup, number: int, viewpoint: FloatArray, rng: np.random.Generator
) -> SeeThroughCaptures:
    readings_of = _met_by_camera_pixels if setup.see_through_rays == "forward" else _seen_dots
    position, view_dir, point = readings_of(
        setup, setup.target_depths_m[number], viewpoint, _visited(setup, viewpoint, rng)
    )
    return SeeThroughCaptures(
        device=setup.truth.name,
        eye=setup.truth.eye,
        eye_box=setup.truth.eye_box,
        viewpoint=viewpoint[position],
        view_dir=view_dir,
        point=point,
        capture=position,
        target_pose=np.full(len(position), number),
        sigma_arcmin=np.full(len(position), setup.stated_sigma_arcmin),
    )


def _seen_dots(setup: CaptureSetup, depth_m: float, viewpoint: FloatArray, visits: _Visits) -> _Readings:
    """Return the readings of a target's dots, with directions solved for."""
    dot = setup.dots(depth_m, viewpoint)
    view = setup.truth.see_through.view_dir_of_real_point(dot[None], visits.position[:, None])
    view_dir = visits.measured(view.value)
    position, column = np.nonzero(view.usable & setup.field.contains(view_dir))
    return position, view_dir[position, column], dot[column]


def _met_by_camera_pixels(setup: CaptureSetup, depth_m: float, viewpoint: FloatArray, visits: _Visits) -> _Readings:
    """Return the readings where world rays of camera pixels meet a target's plane; rays that miss it are left out."""
    view_dir = setup.camera_dirs()
    world = setup.truth.see_through.real_ray_of_view_dir(visits.true(view_dir[None]), visits.position[:, None])
    position, column = np.nonzero(world.usable & (world.value[..., 5] < 0.0))
    ray = world.value[position, column]
    point = rays.split(rays.at_z(ray, setup.truth.eye_box.centre[2] - depth_m))[0]
    # For a plane within the optics, the world ray begins behind the plane.
    beyond = point[:, 2] <= ray[:, 2]
    return position[beyond], view_dir[column[beyond]], point[beyond]


def with_camera_noise(captures: AnyCaptures, sigma_arcmin: float, rng: np.random.Generator) -> AnyCaptures:
    """Rotate every measured direction by Gaussian angles about two transverse axes, and record their sigma.

    The noise is isotropic everywhere in the field, as with a camera that points at each dot.
    """
    if sigma_arcmin == 0.0:
        return captures
    kick = rng.normal(0.0, sigma_arcmin * ARCMIN, captures.view_dir.shape)
    along = np.sum(kick * captures.view_dir, axis=-1, keepdims=True)
    noisy = normalised(captures.view_dir + kick - along * captures.view_dir)
    return replace(captures, view_dir=noisy, sigma_arcmin=np.full(len(captures), sigma_arcmin))

"""Setup of simulated captures: errors of camera and stage, grids, targets."""

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass
from functools import cached_property
from typing import Literal, get_args

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.geometry import directions
from wlr_render.mappings import Eye, FieldOfView
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation import viewpoints

SeeThroughRays = Literal["backward", "forward"]
CaptureSampling = Literal["planar", "volumetric", "static"]
LEAST_SIGMA_ARCMIN = 1e-3
"""Sigma stated for a noiseless camera on a stage with errors, because 0 would mean exact camera positions."""


@dataclass(frozen=True, eq=False)
class CaptureSetup:
    """Setup of a simulated calibration; errors of zero make it exact.

    Attributes:
        truth: exact mappings of the device, and the eye box to cover.
        camera_noise_arcmin: standard deviation of a measured direction about each transverse axis. One pixel of a
            camera with one pixel per arcminute is 1.
        stage_error_m: standard deviation of the true camera position about the reported one, independent per visit and
            axis.
        stage_turn_rad: standard deviation of the camera's rotation about each axis, likewise independent.
        stage_curve: (reported positions (m, 3)) -> (m, 6) rotation (rad) and displacement (m) of the camera, the same
            in every visit; None for none.
        camera_field: photographed part of the display's field, sampled by a grid of camera pixels; None for the whole
            field, sampled by a grid of panel pixels.
        grid: columns and rows of the pixels decoded at each position, and of the dots on each target.
        target_depths_m: depths of the flat targets in front of the eye box, at least two different ones.
        see_through_rays: "backward" solves for the direction of each dot, as in a photograph of a target.
            "forward" traces a grid of camera pixels through the optics to the target planes (paper: section 4.3):
            one trace per reading and no solve.

    Raises:
        BadInputError: a negative error, an empty grid, target depths that do not determine a ray, or other rays.
    """

    truth: Eye
    camera_noise_arcmin: float = 0.0
    stage_error_m: float = 0.0
    camera_field: FieldOfView | None = None
    grid: tuple[int, int] = (25, 21)
    target_depths_m: tuple[float, ...] = (0.4, 3.0)
    _: KW_ONLY
    stage_turn_rad: float = 0.0
    stage_curve: Callable[[FloatArray], FloatArray] | None = None
    see_through_rays: SeeThroughRays = "backward"

    def __post_init__(self) -> None:
        for name in ("camera_noise_arcmin", "stage_error_m", "stage_turn_rad"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise BadInputError(f"capture setup: '{name}' is {value}; it must be zero or a positive number.")
        if min(self.grid) < 1:
            raise BadInputError(f"capture setup: the grid {self.grid} needs at least one column and one row.")
        if len(set(self.target_depths_m)) < 2 or min(self.target_depths_m) <= 0:
            raise BadInputError(
                f"capture setup: target depths {self.target_depths_m} m give no ray; give two or more, all above 0."
            )
        if self.see_through_rays not in get_args(SeeThroughRays):
            raise BadInputError(
                f"capture setup: 'see_through_rays' is '{self.see_through_rays}'; it must be 'backward' or 'forward'."
            )

    def camera_positions(self, kind: str, count: int) -> FloatArray:
        """Return camera positions (count, 3): "volumetric" in the eye box, "static" one, any other `kind` planar."""
        box = self.truth.eye_box
        if kind == "static":
            return viewpoints.nominal(box)
        return (
            viewpoints.volumetric(box, count)
            if kind == "volumetric"
            else viewpoints.planar(box, self.field.reach, count)
        )

    @property
    def stated_sigma_arcmin(self) -> float:
        """Sigma of measured directions that captures state; 0 only for exact directions."""
        has_stage_errors = self.stage_error_m > 0 or self.stage_turn_rad > 0 or self.stage_curve is not None
        return self.camera_noise_arcmin or (LEAST_SIGMA_ARCMIN if has_stage_errors else 0.0)

    @cached_property
    def field(self) -> FieldOfView:
        """The display's field from the centre and the corners of the eye box.

        Raises:
            BadInputError: no pixel is visible from there.
        """
        if self.camera_field is not None:
            return self.camera_field
        box, panel = self.truth.eye_box, self.truth.display.panel
        corners = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        viewpoint = box.at(np.concatenate([np.zeros((1, 3)), corners]))
        pixel = np.stack(np.meshgrid(*[np.linspace(0.0, 1.0, 9)] * 2), axis=-1).reshape(-1, 2) * panel.size_px
        view = self.truth.display.view_dir_of_pixel(pixel[None], viewpoint[:, None])
        tangents = directions.tangents_of_dir(view.value[view.usable])
        if len(tangents) == 0:
            raise BadInputError(
                f"capture setup: no panel pixel of {self.truth.name} is seen from its eye box; check the device."
            )
        return FieldOfView(np.nanmin(tangents, axis=0), np.nanmax(tangents, axis=0))

    def camera_dirs(self) -> FloatArray:
        """Return the directions (n, 3) of the decoded camera pixels, from edge to edge of the field."""
        return self.field.directions(*self.grid)

    def dots(self, depth_m: float, viewpoint: FloatArray) -> FloatArray:
        """Return the dots (n, 3) of a flat target that fills the field from all viewpoints (m, 3), device frame."""
        low = viewpoint[:, :2].min(axis=0) + depth_m * self.field.low
        high = viewpoint[:, :2].max(axis=0) + depth_m * self.field.high
        x, y = np.meshgrid(*(np.linspace(low[axis], high[axis], self.grid[axis]) for axis in (0, 1)))
        z = np.full_like(x, self.truth.eye_box.centre[2] - depth_m)
        return np.stack([x, y, z], axis=-1).reshape(-1, 3)

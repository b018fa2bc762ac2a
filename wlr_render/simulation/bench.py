"""The calibration bench in simulation: a device, an eyeball camera on a stage, targets, and their errors."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.geometry import directions
from wlr_render.mappings import EyeMappings

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Field:
    """The directions in which the panel is seen, as a box of tangents over all viewpoints of the eye box.

    Attributes:
        low, high: (2,) tangents (tx, ty).
    """

    low: FloatArray
    high: FloatArray

    @property
    def reach(self) -> FloatArray:
        """(2,) largest |tx| and |ty|."""
        return np.maximum(np.abs(self.low), np.abs(self.high))

    def contains(self, view_dir: FloatArray) -> NDArray[np.bool_]:
        """Whether directions (..., 3) lie in the field, (...) bool."""
        tangents = directions.tangents_of_dir(view_dir)
        return np.asarray(np.all((tangents >= self.low) & (tangents <= self.high), axis=-1))


@dataclass(frozen=True, eq=False)
class Bench:
    """What a calibration is simulated with; errors of zero make it exact.

    Attributes:
        truth: the device's own mappings, and the eye box to be covered.
        camera_noise_arcmin: standard deviation of a measured direction about each transverse axis. One pixel of a
            camera with one pixel per arcminute is 1.
        stage_error_m: standard deviation of the true camera position about the reported one, independent per
            position and axis.
        pixel_grid: columns and rows of the panel pixels that are decoded at each position.
        target_depths_m: depths of the flat targets in front of the eye box, at least two different ones.
        dot_grid: columns and rows of the dots on each target.

    Raises:
        BadInputError: a negative error, an empty grid, or target depths that do not determine a ray.
    """

    truth: EyeMappings
    camera_noise_arcmin: float = 0.0
    stage_error_m: float = 0.0
    pixel_grid: tuple[int, int] = (25, 21)
    target_depths_m: tuple[float, ...] = (0.4, 3.0)
    dot_grid: tuple[int, int] = (25, 21)

    def __post_init__(self) -> None:
        for name in ("camera_noise_arcmin", "stage_error_m"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise BadInputError(f"bench: '{name}' is {value}; it must be zero or a positive number.")
        if min(*self.pixel_grid, *self.dot_grid) < 1:
            raise BadInputError(f"bench: grids {self.pixel_grid} and {self.dot_grid} need at least one column and row.")
        if len(set(self.target_depths_m)) < 2 or min(self.target_depths_m) <= 0:
            raise BadInputError(
                f"bench: target depths {self.target_depths_m} m do not determine a ray; give two or more, all positive."
            )

    @cached_property
    def field(self) -> Field:
        """The display's field of view from the centre and the corners of the eye box.

        Raises:
            BadInputError: no pixel is seen from there.
        """
        box, panel = self.truth.eye_box, self.truth.display.panel
        corners = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        viewpoint = box.at(np.concatenate([np.zeros((1, 3)), corners]))
        pixel = np.stack(np.meshgrid(*[np.linspace(0.0, 1.0, 9)] * 2), axis=-1).reshape(-1, 2) * panel.size_px
        seen = self.truth.display.view_dir_of_pixel(pixel[None], viewpoint[:, None])
        tangents = directions.tangents_of_dir(seen.value[seen.usable])
        if len(tangents) == 0:
            raise BadInputError(
                f"bench: no panel pixel of {self.truth.name} is seen from its eye box; check the device."
            )
        return Field(np.nanmin(tangents, axis=0), np.nanmax(tangents, axis=0))

    def pixels(self) -> FloatArray:
        """Panel pixels that are decoded, (n, 2)."""
        return self.truth.display.panel.grid(*self.pixel_grid).reshape(-1, 2)

    def dots(self, depth_m: float, viewpoint: FloatArray) -> FloatArray:
        """Dots of a flat target, (n, 3) device frame, wide enough to fill the field from all viewpoints (m, 3)."""
        low = viewpoint[:, :2].min(axis=0) + depth_m * self.field.low
        high = viewpoint[:, :2].max(axis=0) + depth_m * self.field.high
        columns, rows = self.dot_grid
        x, y = np.meshgrid(np.linspace(low[0], high[0], columns), np.linspace(low[1], high[1], rows))
        z = np.full_like(x, self.truth.eye_box.centre[2] - depth_m)
        return np.stack([x, y, z], axis=-1).reshape(-1, 3)

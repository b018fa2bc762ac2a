"""What a calibration is simulated with: exact mappings, camera positions' errors, decoded pixels, targets."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.geometry import directions
from wlr_render.mappings import EyeMappings, Field
from wlr_render.numerics.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class CaptureSetup:
    """What a calibration is simulated with; errors of zero make it exact.

    Attributes:
        truth: the device's own mappings, and the eye box to be covered.
        camera_noise_arcmin: standard deviation of a measured direction about each transverse axis. One pixel of a
            camera with one pixel per arcminute is 1.
        stage_error_m: standard deviation of the true camera position about the reported one, independent per
            position and axis.
        camera_field: the part of the display's field that is photographed, by a grid of camera pixels; None for all
            of it, by a grid of panel pixels.
        grid: columns and rows of the pixels that are decoded at each position, and of the dots on each target.
        target_depths_m: depths of the flat targets in front of the eye box, at least two different ones.

    Raises:
        BadInputError: a negative error, an empty grid, or target depths that do not determine a ray.
    """

    truth: EyeMappings
    camera_noise_arcmin: float = 0.0
    stage_error_m: float = 0.0
    camera_field: Field | None = None
    grid: tuple[int, int] = (25, 21)
    target_depths_m: tuple[float, ...] = (0.4, 3.0)

    def __post_init__(self) -> None:
        for name in ("camera_noise_arcmin", "stage_error_m"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise BadInputError(f"capture setup: '{name}' is {value}; it must be zero or a positive number.")
        if min(self.grid) < 1:
            raise BadInputError(f"capture setup: the grid {self.grid} needs at least one column and one row.")
        if len(set(self.target_depths_m)) < 2 or min(self.target_depths_m) <= 0:
            raise BadInputError(
                f"capture setup: target depths {self.target_depths_m} m give no ray; give two or more, all above 0."
            )

    @cached_property
    def field(self) -> Field:
        """What the camera sees of the display from the centre and the corners of the eye box.

        Raises:
            BadInputError: no pixel is seen from there.
        """
        if self.camera_field is not None:
            return self.camera_field
        box, panel = self.truth.eye_box, self.truth.display.panel
        corners = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        viewpoint = box.at(np.concatenate([np.zeros((1, 3)), corners]))
        pixel = np.stack(np.meshgrid(*[np.linspace(0.0, 1.0, 9)] * 2), axis=-1).reshape(-1, 2) * panel.size_px
        seen = self.truth.display.view_dir_of_pixel(pixel[None], viewpoint[:, None])
        tangents = directions.tangents_of_dir(seen.value[seen.usable])
        if len(tangents) == 0:
            raise BadInputError(
                f"capture setup: no panel pixel of {self.truth.name} is seen from its eye box; check the device."
            )
        return Field(np.nanmin(tangents, axis=0), np.nanmax(tangents, axis=0))

    def pixels(self) -> FloatArray:
        """Panel pixels that are decoded, (n, 2)."""
        return self.truth.display.panel.grid(*self.grid).reshape(-1, 2)

    def camera_dirs(self) -> FloatArray:
        """Directions of the camera pixels that are decoded, (n, 3), from edge to edge of the field."""
        return self.field.directions(*self.grid)

    def dots(self, depth_m: float, viewpoint: FloatArray) -> FloatArray:
        """Dots of a flat target, (n, 3) device frame, wide enough to fill the field from all viewpoints (m, 3)."""
        low = viewpoint[:, :2].min(axis=0) + depth_m * self.field.low
        high = viewpoint[:, :2].max(axis=0) + depth_m * self.field.high
        x, y = np.meshgrid(*(np.linspace(low[axis], high[axis], self.grid[axis]) for axis in (0, 1)))
        z = np.full_like(x, self.truth.eye_box.centre[2] - depth_m)
        return np.stack([x, y, z], axis=-1).reshape(-1, 3)

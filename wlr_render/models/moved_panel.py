"""A display whose panel has moved since it was calibrated."""

from dataclasses import dataclass, replace

import numpy as np

from wlr_render.geometry.planes import BasePlane
from wlr_render.mappings import DisplayMapping, EyeBox, Panel, QueryResult
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import Box, Polynomial
from wlr_render.numerics.regressor import Regressor


def pixel_at_calibration(
    pixel: FloatArray, panel: Panel, shift_px: FloatArray, growth: FloatArray | float
) -> FloatArray:
    """Return the pixels (..., 2) that at calibration were where pixels (..., 2) of the moved panel are now."""
    return np.asarray(pixel + shift_px + growth * (pixel - 0.5 * panel.size_px))


@dataclass(frozen=True, eq=False)
class MovedPanelDisplay:
    """`DisplayMapping` with the panel shifted and grown about its middle; a `PlanarDisplay` if `still` is one.

    Attributes:
        still: the mapping with the panel where it was calibrated.
        shift_px: (2,) pixel u shows where pixel u + shift_px showed then.
        growth: relative.
    """

    still: DisplayMapping
    shift_px: FloatArray
    growth: float = 0.0

    @property
    def panel(self) -> Panel:
        """See `DisplayMapping`."""
        return self.still.panel

    @property
    def eye_box(self) -> EyeBox:
        """See `PlanarDisplay`."""
        return self.still.eye_box  # type: ignore[attr-defined, no-any-return]  # absent where it is absent there

    @property
    def base_plane(self) -> BasePlane:
        """See `PlanarDisplay`."""
        return self.still.base_plane  # type: ignore[attr-defined, no-any-return]

    @property
    def forward(self) -> Regressor:
        """See `PlanarDisplay`: the same polynomial of inputs in a moved box."""
        forward: Regressor = self.still.forward  # type: ignore[attr-defined]
        if not isinstance(forward, Polynomial):
            return forward
        low, high = (np.r_[self._back(edge[:2]), edge[2:]] for edge in (forward.box.low, forward.box.high))
        return Polynomial(forward.orders, Box(low, high), forward.coefficients)

    def view_dir_of_pixel(
        self, pixel: FloatArray, viewpoint: FloatArray, warm_start: FloatArray | None = None
    ) -> QueryResult:
        """See `DisplayMapping`."""
        return self.still.view_dir_of_pixel(
            pixel_at_calibration(pixel, self.panel, self.shift_px, self.growth), viewpoint, warm_start
        )

    def pixel_of_view_dir(
        self, view_dir: FloatArray, viewpoint: FloatArray, warm_start: FloatArray | None = None
    ) -> QueryResult:
        """See `DisplayMapping`."""
        found = self.still.pixel_of_view_dir(view_dir, viewpoint, warm_start)
        return replace(found, value=self._back(found.value))

    def _back(self, pixel: FloatArray) -> FloatArray:
        """Return the pixels (..., 2) now, from those at calibration."""
        middle = 0.5 * self.panel.size_px
        return np.asarray(middle + (pixel - middle - self.shift_px) / (1.0 + self.growth))

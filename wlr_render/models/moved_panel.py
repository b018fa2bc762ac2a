"""A display whose panel has moved since it was calibrated."""

from dataclasses import dataclass, replace

import numpy as np

from wlr_render.mappings import DisplayMapping, EyeBox, Panel, QueryResult
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import Box, Polynomial


def pixel_at_calibration(
    pixel: FloatArray, panel: Panel, shift_px: FloatArray, growth: FloatArray | float
) -> FloatArray:
    """Return the positions at calibration (..., 2) of pixels (..., 2) of the moved panel."""
    return np.asarray(pixel + shift_px + growth * (pixel - 0.5 * panel.size_px))


@dataclass(frozen=True, eq=False)
class MovedPanelDisplay:
    """A `DisplayMapping` with the panel shifted and scaled about its middle; a `PlanarModel` if `still` is one.

    Attributes:
        still: the mapping with the panel where it was calibrated.
        shift_px: (2,) pixel u is now where pixel u + shift_px was at calibration.
        growth: relative growth of the panel.
    """

    still: DisplayMapping
    shift_px: FloatArray
    growth: float = 0.0

    @property
    def panel(self) -> Panel:
        """The panel; see `DisplayMapping`."""
        return self.still.panel

    @property
    def eye_box(self) -> EyeBox:
        """The eye box; see `PlanarModel`."""
        return self.still.eye_box  # type: ignore[attr-defined, no-any-return]  # missing if `still` has none

    @property
    def place(self) -> object:
        """The base plane; see `PlanarModel`."""
        return getattr(self.still, "place", None)

    @property
    def modelled(self) -> Polynomial | None:
        """The polynomial of `PlanarModel`, with its inputs in a moved box."""
        forward = getattr(self.still, "modelled", None)
        if not isinstance(forward, Polynomial):
            return None
        low, high = (np.r_[self._back(edge[:2]), edge[2:]] for edge in (forward.box.low, forward.box.high))
        return Polynomial(forward.orders, Box(low, high), forward.coefficients)

    def view_dir_of_pixel(
        self, pixel: FloatArray, viewpoint: FloatArray, warm_start: FloatArray | None = None
    ) -> QueryResult:
        """Answer the forward query of `DisplayMapping`."""
        return self.still.view_dir_of_pixel(
            pixel_at_calibration(pixel, self.panel, self.shift_px, self.growth), viewpoint, warm_start
        )

    def pixel_of_view_dir(
        self, view_dir: FloatArray, viewpoint: FloatArray, warm_start: FloatArray | None = None
    ) -> QueryResult:
        """Answer the backward query of `DisplayMapping`."""
        still = self.still.pixel_of_view_dir(view_dir, viewpoint, warm_start)
        return replace(still, value=self._back(still.value))

    def _back(self, pixel: FloatArray) -> FloatArray:
        """Return the present pixels (..., 2) of pixels (..., 2) at calibration."""
        middle = 0.5 * self.panel.size_px
        return np.asarray(middle + (pixel - middle - self.shift_px) / (1.0 + self.growth))

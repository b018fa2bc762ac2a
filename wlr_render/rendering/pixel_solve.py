"""What the solves of every display pixel have in common, on the GPU and without one."""

from typing import Protocol

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.mappings import FloatArray
from wlr_render.rendering.ray_field import RayField


class SolvedField(Protocol):
    """World rays of all pixels at one viewpoint, wherever they lie."""

    def read(self) -> RayField:
        """As numpy arrays; without a warm start, which the solver keeps."""


class PixelSolve(Protocol):
    """Solves every display pixel for one viewpoint after the other, each from the last one's solution."""

    def solve(self, viewpoint: FloatArray) -> SolvedField:
        """The field at a viewpoint (3,), device frame, metres.

        Raises:
            BadInputError: the viewpoint is not three finite numbers; the last solution is kept.
        """

    def forget(self) -> None:
        """Start the next solve cold."""


def checked_viewpoint(viewpoint: FloatArray) -> FloatArray:
    """The viewpoint as (3,) float64.

    Raises:
        BadInputError: it is not three finite numbers.
    """
    checked = np.asarray(viewpoint, dtype=np.float64)
    if checked.shape != (3,) or not np.isfinite(checked).all():
        raise BadInputError(
            f"the viewpoint {checked.tolist()} is not three finite numbers; give the eye's place in the device frame in"
            " metres, and hold the last good one while the eye is not seen."
        )
    return checked


def pixel_centres_on_panel(panel_px: FloatArray, size_px: tuple[int, int]) -> FloatArray:
    """Centres of a picture of (width, height) that covers the panel, in panel pixels: (height, width, 2)."""
    width, height = size_px
    centres = np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), axis=-1)
    return np.asarray(centres * (panel_px / size_px))

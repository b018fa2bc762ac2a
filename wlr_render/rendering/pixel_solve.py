"""What the solves of a field, viewpoint after viewpoint, have in common, on the GPU and without one."""

from typing import Protocol

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.numerics.arrays import FloatArray
from wlr_render.rendering.ray_field import RayField


class SolvedField(Protocol):
    """World rays of all points at one viewpoint, wherever they lie."""

    def read(self) -> RayField:
        """As numpy arrays; without a warm start, which the solver keeps."""


class PixelSolve(Protocol):
    """Solves every point of a lattice for one viewpoint after the other, each from the last one's solution."""

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
    try:
        checked = np.asarray(viewpoint, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise BadInputError(f"the viewpoint {viewpoint!r} is not three finite numbers.") from error
    if checked.shape != (3,) or not np.isfinite(checked).all():
        raise BadInputError(
            f"the viewpoint {checked.tolist()} is not three finite numbers; give the eye's place in the device frame in"
            " metres, and hold the last good one while the eye is not seen."
        )
    return checked

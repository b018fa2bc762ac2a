"""A first guess for the display's forward solve: view tangents of (pixel, viewpoint) to about an arcminute.

It only saves Newton steps; the answer comes from exact traces.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import dir_of_tangents
from wlr_render.mappings import EyeBox, Panel, Status, StatusArray
from wlr_render.numerics import least_squares
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import Box, Polynomial, basis

PixelOfViewDir = Callable[[FloatArray, FloatArray], tuple[FloatArray, StatusArray]]
"""(view_dir, viewpoint) -> pixel (..., 2), not cut off at the panel's edge, and status."""

_DEGREE = 4
_VIEWPOINTS = 60
_SEARCH = np.linspace(-2.0, 2.0, 61)  # tangents in which the panel is looked for: 63 degrees to each side
_GRID = 15  # directions per axis and viewpoint
_MARGIN = 0.1  # of the field, for it moves with the viewpoint


@dataclass(frozen=True)
class DisplayStart:
    """The fitted guess.

    Attributes:
        polynomial: (u, v, x, y, z) -> tangents.
    """

    polynomial: Polynomial

    def __call__(self, pixel: FloatArray, viewpoint: FloatArray) -> FloatArray:
        """Pixels (n, 2), viewpoints (n, 3) -> tangents (n, 2); taken from the nearest fitted inputs if outside."""
        box = self.polynomial.box
        return self.polynomial(np.clip(np.concatenate([pixel, viewpoint], axis=-1), box.low, box.high))


def fit_display_start(pixel_of_view_dir: PixelOfViewDir, panel: Panel, eye_box: EyeBox) -> DisplayStart:
    """Trace a spread of directions from a spread of viewpoints and fit those that reach the panel.

    Raises:
        BadInputError: no direction from the nominal viewpoint reaches the panel.
    """
    search = np.stack(np.meshgrid(_SEARCH, _SEARCH), axis=-1).reshape(-1, 2)
    found = search[_reaches(panel, *pixel_of_view_dir(dir_of_tangents(search), eye_box.centre))]
    if len(found) == 0:
        raise BadInputError("no ray from the middle of the eye box reaches the panel; check the paths and apertures.")
    low, high = found.min(axis=0), found.max(axis=0)
    margin = _MARGIN * (high - low) + (_SEARCH[1] - _SEARCH[0])
    axes = np.linspace(low - margin, high + margin, _GRID)
    tangents = np.stack(np.meshgrid(axes[:, 0], axes[:, 1]), axis=-1).reshape(-1, 2)
    viewpoint = eye_box.at(_spread(_VIEWPOINTS))[:, None, :]
    pixel, status = pixel_of_view_dir(dir_of_tangents(tangents), viewpoint)
    kept = _reaches(panel, pixel, status)
    inputs = np.concatenate([pixel, np.broadcast_to(viewpoint, (*pixel.shape[:-1], 3))], axis=-1)[kept]
    half = 0.5 * eye_box.size
    box = Box(np.r_[0.0, 0.0, eye_box.centre - half], np.r_[panel.size_px, eye_box.centre + half])
    targets = np.broadcast_to(tangents, pixel.shape)[kept]
    try:
        solution = least_squares.solve(basis(inputs, _DEGREE, box), targets)
    except least_squares.RankDeficientError as error:
        raise BadInputError("the panel is not seen from most of the eye box; make 'eye_box' smaller.") from error
    return DisplayStart(Polynomial(_DEGREE, box, solution.coefficients))


def _reaches(panel: Panel, pixel: FloatArray, status: StatusArray) -> NDArray[np.bool_]:
    """Which rays end on the panel or just outside; those outside steady the fit at the panel's edge."""
    inside = np.all(np.abs(pixel / panel.size_px - 0.5) <= 0.55, axis=-1)
    return np.asarray(inside & (status == Status.OK))


def _spread(count: int) -> FloatArray:
    """Points spread evenly over -1..1 in three axes, (count, 3): multiples of the powers of a root, modulo 1.

    The root solves g^4 = g + 1, the generalised golden ratio for three axes.
    """
    powers = 1.2207440846057596 ** -np.arange(1.0, 4.0)
    return np.asarray(2.0 * np.mod(0.5 + np.arange(count)[:, None] * powers, 1.0) - 1.0)

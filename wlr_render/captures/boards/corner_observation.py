"""Observation of a board from rough positions of its corners: sub-pixel fit, and rejection of outliers."""

from collections.abc import Sequence

import cv2
import numpy as np

from wlr_render.captures.boards.board import BoardNotFoundError, BoardObservation
from wlr_render.captures.boards.board_homography import by_homography
from wlr_render.captures.boards.corner_fit import fit_corners
from wlr_render.captures.boards.lattice_shape import lattice_shape, smooth_rows
from wlr_render.captures.photographs import Photograph
from wlr_render.numerics.arrays import FloatArray, IntArray

_LEAST_FOR_OUTLIERS = 9  # fewest corners for a rejection; fewer do not show which corner is wrong
_MOST_DEPARTURE = 0.1  # largest median distance of corners from their neighbours' prediction, in sides of a cell
LEAST_CORNERS = 4  # fewest corners that determine a pose


def observe_corners(
    image: Photograph,
    index: IntArray,
    place: FloatArray,
    starts: Sequence[FloatArray],
    reach: float = 1.0,
    white_margin: float | None = None,
) -> BoardObservation:
    """Refine corners from positions accurate to about a pixel, and reject other shapes.

    Args:
        image: (h, w) grey.
        index: (n, 2) column and row.
        place: (n, 2) positions on the board in cells, x right and y down.
        starts: guesses (n, 2), pixels from the outer corner of the top-left pixel; where one fails, the next is tried.
        reach, white_margin: see `corner_fit.fit_corners`.

    Raises:
        BoardNotFoundError: too few corners are left, or their arrangement differs from the board's.
    """
    if len(index) < LEAST_CORNERS:
        raise _too_few(len(index))
    slope = lattice_shape(place, starts[0]).slope
    pixel, sigma = np.full((len(index), 2), np.nan), np.full(len(index), np.nan)
    for start in starts:
        missing = np.nonzero(~np.isfinite(sigma))[0]
        pixel[missing], sigma[missing] = fit_corners(image, start[missing], slope[missing], reach, white_margin)
    rows = np.nonzero(np.isfinite(sigma))[0]
    if len(rows) >= _LEAST_FOR_OUTLIERS:
        rows = rows[_smooth(place[rows], pixel[rows])]
    if len(rows) < LEAST_CORNERS:
        raise _too_few(len(rows))
    if _departure(place[rows], pixel[rows]) > _MOST_DEPARTURE:
        raise BoardNotFoundError(
            "the detected corners do not lie on a plane as the board's do; correct the numbers of columns "
            "and rows in board.toml, or is it another board?"
        )
    rows = rows[np.lexsort(index[rows].T)]
    return BoardObservation(index[rows], pixel[rows], sigma[rows])


def _smooth(place: FloatArray, pixel: FloatArray) -> IntArray:
    """Return the rows of corners that agree with the prediction from their neighbours.

    Maps of third order cannot describe the perspective of few, large cells: the corners are then compared with the best
    homography, whose residual must be smooth. A very wide lens has no homography.
    """
    tried = [smooth_rows(place, pixel, _LEAST_FOR_OUTLIERS)[0]]
    expected = by_homography(place, pixel, place, cv2.LMEDS)
    if expected is not None:
        cell = np.sqrt(np.prod(np.ptp(expected, axis=0)) / np.prod(np.ptp(place, axis=0)))
        if np.isfinite(expected).all() and cell > 0:
            tried.append(smooth_rows(expected / cell, pixel, _LEAST_FOR_OUTLIERS)[0])
    return max(tried, key=len)


def _departure(place: FloatArray, pixel: FloatArray) -> float:
    """Return the median distance of corners from their neighbours' prediction, in sides of a cell.

    The prediction is a smooth map, because lenses distort the picture of a plane, or a homography for few corners.
    """
    areas = [max(float(np.linalg.det(np.cov(each.T))), 1e-12) for each in (pixel, place)]
    cell = float(np.sqrt(np.sqrt(areas[0] / areas[1])))
    if len(place) >= _LEAST_FOR_OUTLIERS:
        shape = lattice_shape(place, pixel)
        off = np.linalg.norm(pixel - shape.expected, axis=1) / shape.doubt
    else:
        expected = by_homography(place, pixel, place)
        if expected is None:
            return 0.0
        off = np.linalg.norm(expected - pixel, axis=1)
    return float(np.median(off)) / cell


def _too_few(corners: int) -> BoardNotFoundError:
    return BoardNotFoundError(f"only {corners} corners of the board were seen; show more of it.")

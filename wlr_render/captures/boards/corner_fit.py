"""Sub-pixel positions of chessboard corners: a model of two blurred edges that cross, fitted to the grey values.

The model is (b + b_x x + b_y y) + (a + a_x x + a_y y) erf(e_1 / (sqrt(2) s)) erf(e_2 / (sqrt(2) s)), where e_1 and e_2
are the distances from the two edges and s is the blur. It includes uneven light and defocus, so that neither shifts
the corner. Sigma comes from the residual grey values and the derivatives of the model with respect to the position.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from wlr_render.numerics.arrays import BoolArray, FloatArray

_FIRST_BLUR_PX = 0.8  # initial blur of the fit, as in a sharp photograph
_LEAST_BLUR_PX = 0.25  # least blur; the standard deviation of a square pixel is 0.29 px
_REACH_PART = 0.42  # half width of the window, in cells
_LEAST_REACH_PX, _LEAST_REACH_PART = 4.0, 0.7  # least half width; the limit in cells excludes other corners
_MOST_REACH_PX = 8.0  # largest half width; beyond it, edges are curved
_GUARD_BLURS = 2.5  # width of the unused margin around another shape, in blurs
_LEAST_MARGIN = 0.5  # least share of the distance to another shape that is used
_STEPS = 20  # most steps of a fit; features that need more are not corners
_CONVERGED_PX = 1e-4  # last step of a converged fit, a fiftieth of the error without noise
_MOST_SHIFT_PART = 0.5  # largest shift in half widths of the window; a larger one leads to another feature
_LEAST_PIXELS = 20  # fewest pixels of a fit, about twice its 11 unknowns
_LEAST_CONTRAST = 3.0  # least half step from black to white, in standard deviations of a pixel
_QUANTUM_VARIANCE = 1.0 / 12.0  # variance of rounding to whole grey values
_MODEL_ERROR_PX = 0.005  # error without noise, from square pixels and curved edges


def fit_corners(
    image: NDArray[np.generic],
    start: FloatArray,
    slope: FloatArray,
    reach: float = 1.0,
    white_margin: float | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Fit corners from positions that are accurate to about a pixel.

    Args:
        image: (h, w) grey.
        start: (n, 2) initial pixels, from the outer corner of the top-left pixel.
        slope: (n, 2, 2) pixels (rows) per cell (columns); the edges run along the columns.
        reach: distance in cells around a corner within which only its two edges are visible.
        white_margin: distance in cells from the edges into the light quadrants to another shape (the marker of a
            ChArUco board); None without one.

    Returns:
        Positions (n, 2), pixels from the outer corner of the top-left pixel, and their standard deviations per axis
        (n,); NaN without a corner, or if the window lies outside the picture.
    """
    grey = np.ascontiguousarray(image, dtype=np.float32)
    number = len(start)
    pixel, sigma = np.full((number, 2), np.nan), np.full(number, np.nan)
    usable = np.abs(np.linalg.det(slope)) > 1e-3
    usable[usable] &= np.isfinite(start[usable]).all(axis=-1)
    across = np.zeros(number)
    # Distance between opposite edges of a cell, pixels; the smaller of two.
    across[usable] = 1.0 / np.linalg.norm(np.linalg.inv(slope[usable]), axis=2).max(axis=1)
    reach_px = np.minimum(
        np.maximum(_REACH_PART * across, np.minimum(_LEAST_REACH_PX, _LEAST_REACH_PART * across)), _MOST_REACH_PX
    )
    reach_px = np.minimum(reach_px, reach * across)
    half = np.ceil(1.5 * reach_px).astype(np.int64)
    for size in np.unique(half[usable]):
        of = np.nonzero(usable & (half == size))[0]
        window = _Window.around(grey, start[of], slope[of], reach_px[of] / across[of], int(size), white_margin)
        pixel[of], sigma[of] = _fit(window, start[of], slope[of], reach_px[of])
    return pixel, sigma


@dataclass(frozen=True, eq=False)
class _Window:
    """Grey values (m, p) around m corners at x, y (m, p) from the initial position, and a mask of usable values.

    `near_edges` is the distance (m, p) from the nearer edge, `margin_px` (m,) the distance of other shapes from it.
    """

    grey: FloatArray
    x: FloatArray
    y: FloatArray
    read: BoolArray
    near_edges: FloatArray
    margin_px: FloatArray

    @classmethod
    def around(
        cls,
        grey: NDArray[np.float32],
        start: FloatArray,
        slope: FloatArray,
        reach: FloatArray,
        half: int,
        white_margin: float | None,
    ) -> "_Window":
        height, width = grey.shape
        padded = cv2.copyMakeBorder(grey, half, half, half, half, cv2.BORDER_REPLICATE)
        steps = np.arange(-half, half + 1)
        base = np.clip(np.floor(start).astype(np.int64), 0, [width - 1, height - 1])
        shape = (len(start), len(steps), len(steps))
        u = np.broadcast_to((base[:, :1] + steps)[:, None, :], shape).reshape(len(start), -1)
        v = np.broadcast_to((base[:, 1:] + steps)[:, :, None], shape).reshape(len(start), -1)
        x, y = u + 0.5 - start[:, :1], v + 0.5 - start[:, 1:]
        inverse = np.linalg.inv(slope)
        along = inverse[:, :, :1] * x[:, None, :] + inverse[:, :, 1:] * y[:, None, :]  # (m, 2, p) cells
        read = (np.abs(along) <= reach[:, None, None]).all(axis=1)
        read &= (u >= 0) & (v >= 0) & (u < width) & (v < height)
        # Distance, in pixels, from the nearer edge, because a shape deep in a light quadrant may be a marker.
        per_px = np.linalg.norm(inverse, axis=2)[:, :, None]
        near = np.abs(along / per_px).min(axis=1)
        margin = np.full(len(start), np.inf) if white_margin is None else white_margin / per_px[:, :, 0].max(axis=1)
        return cls(padded[v + half, u + half].astype(np.float64), x, y, read, near, margin)


def _fit(window: _Window, start: FloatArray, slope: FloatArray, reach_px: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Fit the positions of m corners by damped Gauss-Newton steps with the light solved for; return also the sigmas."""
    count = len(start)
    # columns: position x, y; angles of the edges along the slope's columns; log of the blur
    state = np.zeros((count, 5))
    state[:, 2] = np.arctan2(slope[:, 1, 0], slope[:, 0, 0])
    state[:, 3] = np.arctan2(slope[:, 1, 1], slope[:, 0, 1])
    state[:, 4] = np.log(_FIRST_BLUR_PX)
    damping = np.full(count, 1e-3)
    read = _readable(window, np.full(count, _FIRST_BLUR_PX))
    now = _Linearised.at(window, read, state)
    for step in range(_STEPS):
        if step in (3, 8):
            read = _readable(window, np.exp(state[:, 4]))
            now = _Linearised.at(window, read, state)
        normal = now.normal + damping[:, None, None] * _diagonal(now.normal)
        change = np.linalg.solve(normal + 1e-12 * np.eye(5), now.gradient[..., None])[..., 0]
        change[:, :2] = np.clip(change[:, :2], -1.0, 1.0)
        change[:, 2:] = np.clip(change[:, 2:], -0.3, 0.3)
        tried = state + change
        tried[:, 4] = np.maximum(tried[:, 4], np.log(_LEAST_BLUR_PX))
        then = _Linearised.at(window, read, tried)
        better = then.cost <= now.cost
        state = np.where(better[:, None], tried, state)
        damping = np.where(better, 0.2 * damping, 10.0 * damping)
        now = then.where(better, now)
        if step > 8 and np.all(~better | (np.abs(change[:, :2]).max(axis=1) < _CONVERGED_PX)):
            break
    used = read.sum(axis=1)
    variance = np.maximum(now.cost / np.maximum(used - 11, 1), _QUANTUM_VARIANCE)
    covariance = np.linalg.inv(now.normal + 1e-12 * _diagonal(now.normal) + 1e-12 * np.eye(5))
    noise = 0.5 * np.trace(covariance[:, :2, :2], axis1=1, axis2=2) * variance
    sigma = np.hypot(np.sqrt(np.maximum(noise, 0.0)), _MODEL_ERROR_PX)
    converged = (used >= _LEAST_PIXELS) & (np.linalg.norm(state[:, :2], axis=1) <= _MOST_SHIFT_PART * reach_px)
    converged &= np.abs(now.contrast) > _LEAST_CONTRAST * np.sqrt(variance)
    converged &= (sigma < 0.25 * reach_px) & (damping < 1e6)
    place = np.where(converged[:, None], start + state[:, :2], np.nan)
    return place, np.where(converged, sigma, np.nan)


def _readable(window: _Window, blur_px: FloatArray) -> BoolArray:
    # Shapes beyond the margin are equal in both light quadrants, so that a little of their blur does no harm.
    allowed = np.maximum(window.margin_px - _GUARD_BLURS * blur_px, _LEAST_MARGIN * window.margin_px)
    return window.read & (window.near_edges < allowed[:, None])


def _diagonal(matrix: FloatArray) -> FloatArray:
    return np.asarray(matrix * np.eye(matrix.shape[-1]))


@dataclass(frozen=True, eq=False)
class _Linearised:
    """Sum of squares (m,), normal matrix (m, 5, 5) and gradient (m, 5) with the light solved for; contrast (m,)."""

    cost: FloatArray
    normal: FloatArray
    gradient: FloatArray
    contrast: FloatArray

    @classmethod
    def at(cls, window: _Window, read: BoolArray, state: FloatArray) -> "_Linearised":
        x, y = window.x - state[:, :1], window.y - state[:, 1:2]
        blur = np.exp(state[:, 4:])
        (cos_1, sin_1), (cos_2, sin_2) = ((np.cos(state[:, k : k + 1]), np.sin(state[:, k : k + 1])) for k in (2, 3))
        # Next to the first edge, the distance from the second edge has one sign, and vice versa.
        side = np.sign(cos_1 * sin_2 - sin_1 * cos_2)
        from_1, from_2 = side * (cos_1 * y - sin_1 * x), side * (sin_2 * x - cos_2 * y)
        edge_1, edge_2 = (scipy.special.erf(each / (np.sqrt(2.0) * blur)) for each in (from_1, from_2))
        steep_1, steep_2 = (
            np.sqrt(2.0 / np.pi) / blur * np.exp(-0.5 * (distance / blur) ** 2) for distance in (from_1, from_2)
        )
        cross = edge_1 * edge_2
        weight = read.astype(np.float64)
        # One column for each unknown of the light: the plane of brightness and the plane of contrast.
        light = np.stack([np.ones_like(x), x, y, cross, x * cross, y * cross], axis=-1) * weight[..., None]
        transposed = np.swapaxes(light, 1, 2)
        normal = transposed @ light
        inverse = np.linalg.inv(normal + 1e-9 * _diagonal(normal) + 1e-9 * np.eye(6))
        grey = (window.grey * weight)[..., None]
        solved = inverse @ (transposed @ grey)
        left = (grey - light @ solved)[..., 0]
        strength = solved[:, 3] + solved[:, 4] * x + solved[:, 5] * y
        by_1, by_2 = strength * steep_1 * edge_2, strength * edge_1 * steep_2  # derivatives by from_1 and from_2
        slopes = (
            np.stack(
                [
                    side * (by_1 * sin_1 - by_2 * sin_2),
                    side * (-by_1 * cos_1 + by_2 * cos_2),
                    by_1 * side * (-sin_1 * y - cos_1 * x),
                    by_2 * side * (cos_2 * x + sin_2 * y),
                    -(by_1 * from_1 + by_2 * from_2),
                ],
                axis=-1,
            )
            * weight[..., None]
        )
        # Project out the illumination parameters (variable projection).
        slopes = slopes - light @ (inverse @ (transposed @ slopes))
        turned = np.swapaxes(slopes, 1, 2)
        return cls((left**2).sum(axis=1), turned @ slopes, (turned @ left[..., None])[..., 0], solved[:, 3, 0])

    def where(self, better: BoolArray, other: "_Linearised") -> "_Linearised":
        both = zip(vars(self).values(), vars(other).values(), strict=True)
        return _Linearised(*(np.where(better.reshape(-1, *[1] * (one.ndim - 1)), one, two) for one, two in both))

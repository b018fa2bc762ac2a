"""Sub-pixel dot centres from moments of the darkness relative to the background, the ground.

Blur does not bias moments of the whole deficit, unlike an edge at a threshold. To reduce noise, only a band along the
edge uses the photograph: inside the band, a dot has the mean darkness of its interior, and outside it is ground.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.boards.dot_lattice import Dots
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray

_SIZE_STEP_PX = 4  # step of half sides of patches, which are rounded up to have few sizes
_OUTSIDE = -1

_PASSES = 4  # number of passes; the last two matter only where blur is as wide as a small dot
_FIRST_BAND_PX, _FIRST_BAND_PART = 2.0, 0.15  # half width of the first band: pixels, and parts of the radius
_BAND_PX, _BAND_BLURS = 1.0, 2.5  # half width of the band once the blur is known: pixels, and blurs
_RING_PX, _RING_PART = 2.0, 0.3  # width of the ring of ground around the band
_LEAST_GROUND_PX = 10  # fewest pixels of ground for a plane of light and its noise
_LEAST_INSIDE_PX = 10  # fewest interior pixels for a noise estimate
_SAMPLING_ERROR_PX = 0.004  # error of a small dot without noise, due to square pixels
_QUANTUM_VARIANCE = 1.0 / 12.0  # variance of rounding to whole grey values


@dataclass(frozen=True, eq=False)
class _Patches:
    """Square patches around m dots, each as a row of p pixels.

    Attributes:
        dot: (m,) numbers of the dots.
        grey: (m, p) grey values.
        x, y: (m, p) pixel centres from the dot's centre.
        foreign: (m, p) mask of pixels in or near another dot.
        outside: (m, p) mask of pixels outside the picture.
    """

    dot: IntArray
    grey: FloatArray
    x: FloatArray
    y: FloatArray
    foreign: BoolArray
    outside: BoolArray


def _patches_around(
    grey: FloatArray, dots: Dots, which: IntArray, near_px: FloatArray, reach_px: FloatArray
) -> Iterator[_Patches]:
    """Yield image patches around the dots that lie in the picture, batched by size.

    Args:
        grey: (h, w) grey values.
        dots: (n) all dark shapes, because a neighbour is not ground; NaN for rejected ones.
        which: (m,) numbers of the dots to cut out.
        near_px: (n,) distance from a dot's edge up to which pixels belong to the dot.
        reach_px: (n,) distance from a dot's edge up to which the patch extends.
    """
    usable = dots.is_valid & np.all((dots.centre > 0) & (dots.centre < np.array(grey.shape)[::-1]), axis=-1)
    which = which[usable[which]]
    if not len(which):
        return
    extent = 2.0 * np.sqrt(np.maximum(dots.spread[which, 0, 0], dots.spread[which, 1, 1])) + reach_px[which] + 1.0
    half = _SIZE_STEP_PX * np.ceil(extent / _SIZE_STEP_PX).astype(np.int64)
    border = int(half.max())
    frame = (border, border, border, border)
    padded = cv2.copyMakeBorder(grey, *frame, cv2.BORDER_REPLICATE)
    owner = cv2.copyMakeBorder(
        _owners(grey, dots, near_px, np.nonzero(usable)[0]), *frame, cv2.BORDER_CONSTANT, value=_OUTSIDE
    )
    for size in np.unique(half):
        yield _of_one_size(which[half == size], dots, int(size), padded, owner, border)


def _of_one_size(
    of: IntArray, dots: Dots, half: int, padded: FloatArray, owner: NDArray[np.int32], border: int
) -> _Patches:
    steps = np.arange(-half, half + 1)
    u, v = (np.floor(dots.centre[of, axis]).astype(np.int64)[:, None] + steps for axis in (0, 1))
    where = v[:, :, None] + border, u[:, None, :] + border
    x = np.broadcast_to((u + 0.5 - dots.centre[of, :1])[:, None, :], where[0].shape[:1] + (len(steps),) * 2)
    y = np.broadcast_to((v + 0.5 - dots.centre[of, 1:])[:, :, None], x.shape)
    theirs = owner[where].reshape(len(of), -1)
    return _Patches(
        dot=of,
        grey=padded[where].reshape(len(of), -1),
        x=x.reshape(len(of), -1),
        y=y.reshape(len(of), -1),
        foreign=(theirs > 0) & (theirs != 1 + of[:, None]),
        outside=theirs == _OUTSIDE,
    )


def _owners(grey: FloatArray, dots: Dots, near_px: FloatArray, which: IntArray) -> NDArray[np.int32]:
    """Return the dot (h, w), counted from 1, in or near which each pixel lies; 0 for ground."""
    owner = np.zeros(grey.shape, np.int32)
    squares, axes = np.linalg.eigh(dots.spread[which])
    angle = np.rad2deg(np.arctan2(axes[:, 1, 0], axes[:, 0, 0])).tolist()
    centre = (dots.centre[which] - 0.5).tolist()
    # Inner parts are drawn last, so that a pixel near two dots belongs to the nearer one.
    for part in (1.0, 0.5, 0.0):
        size = (2.0 * (2.0 * np.sqrt(squares) + part * near_px[which, None])).tolist()
        for place, dot in enumerate(which.tolist()):
            cv2.ellipse(owner, (centre[place], size[place], angle[place]), dot + 1, cv2.FILLED)
    return owner


@dataclass(frozen=True, eq=False)
class MeasuredDots:
    """Measurements of dots; NaN for dots that could not be measured.

    Attributes:
        dots: (n) ellipses, with centres of area as centres and spreads that include the blur.
        darkness_px2: (n,) light that a dot takes away, in pixels of ground: area times contrast.
        contrast: (n,) contrast of the dot's middle: 1 for black, 0 for ground.
        sigma_px: (n,) standard deviation of the centres per axis.
        blur_px: (n,) standard deviation of the edge's blur, pixel integration included.
    """

    dots: Dots
    darkness_px2: FloatArray
    contrast: FloatArray
    sigma_px: FloatArray
    blur_px: FloatArray


@dataclass(frozen=True, eq=False)
class _Regions:
    """Masks (m, p) of patch pixels: `ring` is ground, and `middle` is the darkest part of the interior."""

    edge: BoolArray
    inside: BoolArray
    middle: BoolArray
    ring: BoolArray


def measure_dots(image: NDArray[np.generic], dots: Dots, which: IntArray) -> MeasuredDots:
    """Measure the centres and areas, with sigmas, of dots whose positions are accurate to about a pixel.

    Args:
        image: (h, w) grey.
        dots: (n) all dots nearby, because a neighbour is not ground.
        which: (m,) numbers of the dots to measure.

    Returns:
        Measurements of n dots, NaN for dots that are not in `which`, are cut off by the edge of the picture, or have no
        ground.
    """
    grey = image.astype(np.float64)
    band = _FIRST_BAND_PX + _FIRST_BAND_PART * dots.radius
    measured = _measured_once(grey, dots, which, band)
    for _ in range(_PASSES - 1):
        blurs = measured.blur_px[np.isfinite(measured.blur_px)]
        blur = float(np.median(blurs)) if len(blurs) else 0.0
        dots = _updated(dots, measured.dots, which, blur)
        band = np.full(len(dots), _BAND_PX + _BAND_BLURS * blur)
        measured = _measured_once(grey, dots, which, band)
    return measured


def _updated(dots: Dots, measured: Dots, which: IntArray, blur: float) -> Dots:
    """Return the dots with blur subtracted from the measured ones (at most half the width), the others unchanged."""
    centre, spread = dots.centre.copy(), dots.spread.copy()
    new = measured.spread[which]
    half_least = 0.5 * _determinant(new) / (new[:, 0, 0] + new[:, 1, 1])
    centre[which] = measured.centre[which]
    spread[which] = new - np.minimum(blur**2, half_least)[:, None, None] * np.eye(2)
    return Dots(centre, spread)


def _measured_once(grey: FloatArray, dots: Dots, which: IntArray, band: FloatArray) -> MeasuredDots:
    """Measure in one pass, with windows at the estimated positions of the dots."""
    number = len(dots)
    centre, spread = np.full((number, 2), np.nan), np.full((number, 2, 2), np.nan)
    darkness, contrast, sigma, blur = np.full((4, number), np.nan)
    reach = band + _ring_width(dots)
    for patches in _patches_around(grey, dots, which, band, reach):
        of = patches.dot
        centre[of], spread[of], darkness[of], contrast[of], sigma[of], blur[of] = _moments(patches, dots[of], band[of])
    return MeasuredDots(Dots(centre, spread), darkness, contrast, sigma, blur)


def _ring_width(dots: Dots) -> FloatArray:
    return _RING_PX + _RING_PART * dots.radius


def _moments(patches: _Patches, dots: Dots, band: FloatArray) -> tuple[FloatArray, ...]:
    """Return centre, spread, darkness, contrast, sigma and blur of m dots; NaN if cut off or without ground."""
    regions = _regions(patches, dots, band)
    ground_level, deficit, covariance = _ground(patches, regions.ring)
    x, y = patches.x, patches.y
    depth = _mean(deficit, regions.middle)
    whole = ~(patches.outside & (regions.edge | regions.inside)).any(axis=1)
    usable = whole & (regions.ring.sum(axis=1) >= _LEAST_GROUND_PX) & (ground_level > 0) & (depth > 0)

    taken = np.where(regions.edge, deficit, 0.0)
    taken += np.where(regions.inside, _mean(deficit, regions.inside)[:, None], 0.0)
    area = taken.sum(axis=1)
    usable &= area > 0
    area, depth, level = (np.where(usable, each, 1.0) for each in (area, depth, ground_level))
    shift = np.stack([_dot(taken, x), _dot(taken, y)], axis=-1) / area[:, None]
    second = _symmetric(*(_dot(taken, product) / area for product in (x * x, x * y, y * y)))
    spread = second - shift[:, :, None] * shift[:, None, :]
    usable &= (_determinant(spread) > 0) & (spread[:, 0, 0] > 0)

    variance = np.maximum(_noise_variance(deficit, regions), _QUANTUM_VARIANCE / level**2)
    sigma = np.sqrt(variance * _lever(patches, regions.edge, covariance)) / area
    blur = _blur(deficit / depth[:, None], regions.edge, variance / depth**2, dots)
    results = dots.centre + shift, spread, area, depth, np.hypot(sigma, _SAMPLING_ERROR_PX), blur
    return tuple(np.where(usable.reshape(-1, *[1] * (each.ndim - 1)), each, np.nan) for each in results)


def _regions(patches: _Patches, dots: Dots, band: FloatArray) -> _Regions:
    beyond_edge = _beyond_edge(patches, dots.spread)
    width, interior = band[:, None], ~patches.foreign
    ring = (beyond_edge > width) & (beyond_edge < width + _ring_width(dots)[:, None]) & interior & ~patches.outside
    middle = beyond_edge < np.minimum(-0.5 * dots.radius, -1.0)[:, None]
    return _Regions((np.abs(beyond_edge) <= width) & interior, beyond_edge < -width, middle, ring)


def _beyond_edge(patches: _Patches, spread: FloatArray) -> FloatArray:
    """Return the distance (m, p) of pixels from an ellipse, negative inside, to first order (gradient of a cone)."""
    inverse = np.linalg.inv(spread)[..., None]
    steep_x = inverse[:, 0, 0] * patches.x + inverse[:, 0, 1] * patches.y
    steep_y = inverse[:, 1, 0] * patches.x + inverse[:, 1, 1] * patches.y
    height = np.sqrt(steep_x * patches.x + steep_y * patches.y)  # 2 on the edge
    # A pixel exactly at the centre has no gradient, and is far inside.
    return np.asarray((height - 2.0) * np.maximum(height, 1e-6) / np.maximum(np.hypot(steep_x, steep_y), 1e-9))


def _ground(patches: _Patches, ring: BoolArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Fit a plane of light to each ring.

    Returns:
        The light (m,) at the dot's centre, the missing fraction (m, p) of the ground's light at each pixel, which makes
        centres independent of uneven light, and the covariance (m, 3, 3) of terms 1, x, y for pixels of unit noise.
    """
    basis = np.stack([np.ones_like(patches.x), patches.x, patches.y], axis=-1)
    of_ring = np.swapaxes(np.where(ring[..., None], basis, 0.0), 1, 2)
    # A ring without pixels gives a zero plane, and such a dot is NaN.
    covariance = np.linalg.inv(of_ring @ basis + 1e-6 * np.eye(3))
    plane = covariance @ (of_ring @ patches.grey[..., None])
    light = (basis @ plane)[..., 0]
    deficit = 1.0 - patches.grey / np.where(light > 0, light, np.inf)
    return plane[:, 0, 0], deficit, np.asarray(covariance)


def _lever(patches: _Patches, edge: BoolArray, covariance: FloatArray) -> FloatArray:
    """Return the variance (m,) of first moments per axis, for pixels of unit noise.

    It is the sum of the variances due to the band and due to the ground's plane, which is subtracted everywhere.
    """
    x, y = np.where(edge, patches.x, 0.0), np.where(edge, patches.y, 0.0)
    xx, xy, yy = _dot(x, x), _dot(x, y), _dot(y, y)
    to_plane = np.stack(
        [np.stack([x.sum(axis=1), xx, xy], axis=-1), np.stack([y.sum(axis=1), xy, yy], axis=-1)], axis=1
    )
    by_ground = np.trace(to_plane @ covariance @ np.swapaxes(to_plane, 1, 2), axis1=1, axis2=2)
    return np.asarray(0.5 * (xx + yy + by_ground))


def _noise_variance(deficit: FloatArray, regions: _Regions) -> FloatArray:
    """Return the variance (m,) of an edge pixel: the ground's, or the mean of ground and interior if there is one."""
    ground_px, inside_px = regions.ring.sum(axis=1), regions.inside.sum(axis=1)
    ground = _dot(np.where(regions.ring, deficit, 0.0), deficit) / np.maximum(ground_px - 3, 1)
    off = np.where(regions.inside, deficit - _mean(deficit, regions.inside)[:, None], 0.0)
    dot = _dot(off, off) / np.maximum(inside_px - 1, 1)
    return np.asarray(np.where(inside_px >= _LEAST_INSIDE_PX, 0.5 * (ground + dot), ground))


def _blur(depth: FloatArray, edge: BoolArray, variance: FloatArray, dots: Dots) -> FloatArray:
    """Return the standard deviation (m,) of an edge's blur; across it, depth (1 - depth) sums to blur / sqrt(pi)."""
    mixed = np.where(edge, depth * (1.0 - depth), 0.0).sum(axis=1) + edge.sum(axis=1) * variance
    perimeter = 2.0 * np.pi * np.sqrt(2.0 * (dots.spread[:, 0, 0] + dots.spread[:, 1, 1]))
    return np.asarray(np.sqrt(np.pi) * np.maximum(mixed, 0.0) / perimeter)


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the row-wise scalar products (m,) of (m, p) and (m, p)."""
    return np.asarray((a[:, None, :] @ b[:, :, None])[:, 0, 0])


def _mean(values: FloatArray, where: BoolArray) -> FloatArray:
    return np.asarray(np.where(where, values, 0.0).sum(axis=1) / np.maximum(where.sum(axis=1), 1))


def _symmetric(xx: FloatArray, xy: FloatArray, yy: FloatArray) -> FloatArray:
    return np.stack([np.stack([xx, xy], axis=-1), np.stack([xy, yy], axis=-1)], axis=-2)


def _determinant(spread: FloatArray) -> FloatArray:
    return np.asarray(spread[:, 0, 0] * spread[:, 1, 1] - spread[:, 0, 1] ** 2)

"""Measure dots to a fraction of a pixel: moments of what they take from the light of their ground.

Moments of the whole deficit are not biased by blur, as an edge at a threshold is. To keep noise out, only a band along
the edge counts as photographed; inside the band a dot is as dark as its inside on average, outside it is ground.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.targets.dot_detection import Dots

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_PASSES = 4
_FIRST_BAND_PX, _FIRST_BAND_PART = 2.0, 0.15  # half width of the band: pixels, and parts of the radius
_BAND_PX, _BAND_BLURS = 1.0, 2.5  # once the blur is known
_RING_PX, _RING_PART = 2.0, 0.3  # width of the ring of ground around the band
_LEAST_GROUND_PX = 10
_SAMPLING_ERROR_PX = 0.004  # what squares of a pixel leave of a small dot without any noise
_OUTSIDE = -1  # owner of what lies beyond the edge of the picture
_QUANTUM_VARIANCE = 1.0 / 12.0  # of rounding to whole grey values


@dataclass(frozen=True, eq=False)
class MeasuredDots:
    """Dots with all that a photograph says of them; NaN throughout for those that could not be measured.

    Attributes:
        dots: (n) the ellipses, free of blur; their centres are centres of area.
        deficit: (n,) light that the dot takes, in pixels of ground: its area, times how black it is.
        contrast: (n,) how black the middle of the dot is: 1 for black, 0 for ground.
        sigma_px: (n,) standard deviation of the centres per axis.
    """

    dots: Dots
    deficit: FloatArray
    contrast: FloatArray
    sigma_px: FloatArray


@dataclass(frozen=True, eq=False)
class _Patches:
    """Squares of the picture around m dots, side s.

    Attributes:
        dot: (m,) which dots.
        grey: (m, s, s).
        place: (m, s, s, 2) pixel positions.
        foreign: (m, s, s) claimed by another dot.
        outside: (m, s, s) beyond the edge of the picture.
    """

    dot: NDArray[np.int64]
    grey: FloatArray
    place: FloatArray
    foreign: BoolArray
    outside: BoolArray


def measure_dots(image: NDArray[np.generic], dots: Dots) -> MeasuredDots:
    """Centres, areas and their noise for dots known to about a pixel.

    Args:
        image: (h, w) grey.
        dots: all dots near, since a neighbour is not ground.
    """
    band = _FIRST_BAND_PX + _FIRST_BAND_PART * dots.radius
    grey = image.astype(np.float64)
    for _ in range(_PASSES - 1):
        measured, blur = _measured_once(grey, dots, band)
        usual = float(np.median(blur[np.isfinite(blur)])) if np.isfinite(blur).any() else 0.0
        dots = _without_blur(measured.dots, usual)
        band = np.full(len(dots), _BAND_PX + _BAND_BLURS * usual)
    return _measured_once(grey, dots, band)[0]


def _without_blur(dots: Dots, blur: float) -> Dots:
    """Ellipses as they were before a blur of this standard deviation; at most half of their width is taken."""
    half_least = (
        0.5
        * (dots.spread[:, 0, 0] * dots.spread[:, 1, 1] - dots.spread[:, 0, 1] ** 2)
        / (dots.spread[:, 0, 0] + dots.spread[:, 1, 1])
    )
    taken = np.minimum(blur**2, half_least)
    return Dots(dots.centre, dots.spread - taken[:, None, None] * np.eye(2))


def _measured_once(grey: FloatArray, dots: Dots, band: FloatArray) -> tuple[MeasuredDots, FloatArray]:
    """One pass with the window where the dots were believed to be, and the blur (n,) of their edges."""
    centre, spread = np.full((len(dots), 2), np.nan), np.full((len(dots), 2, 2), np.nan)
    deficit, contrast, sigma, blur = np.full((4, len(dots)), np.nan)
    for patches in _patches(grey, dots, band):
        of = patches.dot
        centre[of], spread[of], deficit[of], contrast[of], sigma[of], blur[of] = _moments(patches, dots[of], band[of])
    return MeasuredDots(Dots(centre, spread), deficit, contrast, sigma), blur


def _patches(grey: FloatArray, dots: Dots, band: FloatArray) -> Iterator[_Patches]:
    """Squares around the dots that still have a place, those of about one size together."""
    sound = np.isfinite(dots.centre).all(axis=-1) & np.isfinite(dots.spread).all(axis=(-1, -2))
    reach = 2.0 * np.sqrt(np.maximum(dots.spread[:, 0, 0], dots.spread[:, 1, 1])) + band + _ring_width(dots)
    half = np.where(sound, 4 * np.ceil((np.nan_to_num(reach) + 1.0) / 4), 0).astype(np.int64)
    sound &= np.all((dots.centre > 0) & (dots.centre < np.array(grey.shape)[::-1]), axis=-1)
    if not sound.any():
        return
    border = int(half.max())
    owner = cv2.copyMakeBorder(
        _owners(grey, dots, band, sound), border, border, border, border, cv2.BORDER_CONSTANT, value=_OUTSIDE
    )
    padded = cv2.copyMakeBorder(grey, border, border, border, border, cv2.BORDER_REPLICATE)
    for size in np.unique(half[sound]):
        of = np.nonzero(sound & (half == size))[0]
        steps = np.arange(-size, size + 1)
        u, v = (np.floor(dots.centre[of, axis]).astype(np.int64)[:, None] + steps for axis in (0, 1))
        where = v[:, :, None] + border, u[:, None, :] + border
        place = np.stack(np.broadcast_arrays(u[:, None, :] + 0.5, v[:, :, None] + 0.5), axis=-1)
        theirs = owner[where]
        foreign = (theirs > 0) & (theirs != 1 + of[:, None, None])
        yield _Patches(of, padded[where], place, foreign, theirs == _OUTSIDE)


def _owners(grey: FloatArray, dots: Dots, band: FloatArray, sound: BoolArray) -> NDArray[np.int32]:
    """(h, w) which dot, counted from 1, has a pixel in its ellipse or band; the nearer one where bands meet."""
    owner = np.zeros(grey.shape, np.int32)
    squares, axes = np.linalg.eigh(np.where(sound[:, None, None], dots.spread, np.eye(2)))
    angle = np.rad2deg(np.arctan2(axes[:, 1, 0], axes[:, 0, 0]))
    half_axes = 2.0 * np.sqrt(squares)
    for part in (1.0, 0.5, 0.0):
        for dot in np.nonzero(sound)[0]:
            centre = tuple(float(x) for x in dots.centre[dot] - 0.5)
            size = tuple(float(x) for x in 2.0 * (half_axes[dot] + part * band[dot]))
            cv2.ellipse(owner, (centre, size, float(angle[dot])), int(dot) + 1, cv2.FILLED)
    return owner


def _ring_width(dots: Dots) -> FloatArray:
    return _RING_PX + _RING_PART * dots.radius


def _moments(patches: _Patches, dots: Dots, band: FloatArray) -> tuple[FloatArray, ...]:
    """Centre, spread, deficit, contrast, sigma and blur of m dots; NaN where a dot is cut off or has no ground."""
    from_centre = patches.place - dots.centre[:, None, None, :]
    beyond_edge = _beyond_edge(from_centre, dots.spread)
    width = band[:, None, None]
    ring = (beyond_edge > width) & (beyond_edge < width + _ring_width(dots)[:, None, None])
    ring &= ~patches.foreign & ~patches.outside
    edge = (np.abs(beyond_edge) <= width) & ~patches.foreign
    inside = beyond_edge < -width
    middle = beyond_edge < np.minimum(-0.5 * dots.radius, -1.0)[:, None, None]

    # Ground is a plane through the ring; the basis is 1, x, y about the believed centre.
    basis = np.concatenate([np.ones((*ring.shape, 1)), from_centre], axis=-1)
    normal = np.einsum("mijk,mijl,mij->mkl", basis, basis, ring.astype(np.float64), optimize=True)
    cut = (patches.outside & (edge | inside)).any(axis=(1, 2)) | (ring.sum(axis=(1, 2)) < _LEAST_GROUND_PX)
    normal[cut] = np.eye(3)
    of_ring = np.linalg.solve(normal, np.einsum("mijk,mij->mk", basis, ring * patches.grey)[..., None])
    below = np.einsum("mijk,mk->mij", basis, of_ring[..., 0]) - patches.grey

    depth = _mean(below, middle)
    cut |= depth <= 0
    depth[cut] = np.nan
    light = np.where(edge, below, 0.0) + np.where(inside, _mean(below, inside)[:, None, None], 0.0)
    total = np.where(cut, np.nan, light.sum(axis=(1, 2)))
    total[~(total > 0)] = np.nan
    shift = np.einsum("mij,mijk->mk", light, from_centre) / total[:, None]
    second = np.einsum("mij,mijk,mijl->mkl", light, from_centre, from_centre, optimize=True)
    spread = second / total[:, None, None] - shift[:, :, None] * shift[:, None, :]

    variance = _noise_variance(below, ring, inside)
    # What the ground's plane is off moves the whole band with it.
    lever = np.einsum("mij,mijk,mijl->mkl", edge.astype(np.float64), from_centre, basis, optimize=True)
    by_ground = np.einsum("mkl,mlp,mkp->m", lever, np.linalg.inv(normal), lever)
    by_band = np.where(edge[..., None], from_centre**2, 0.0).sum(axis=(1, 2, 3))
    sigma = np.hypot(np.sqrt(0.5 * variance * (by_band + by_ground)) / total, _SAMPLING_ERROR_PX)
    ground = of_ring[:, 0, 0]
    blur = _blur(below / depth[:, None, None], edge, variance / depth**2, dots)
    determinant = spread[:, 0, 0] * spread[:, 1, 1] - spread[:, 0, 1] ** 2
    sound = (ground > 0) & (determinant > 0) & (spread[:, 0, 0] > 0)
    results = dots.centre + shift, spread, total / ground, depth / ground, sigma, blur
    return tuple(np.where(sound.reshape(-1, *[1] * (each.ndim - 1)), each, np.nan) for each in results)


def _beyond_edge(from_centre: FloatArray, spread: FloatArray) -> FloatArray:
    """(m, s, s) distance of pixels from the edge of an ellipse, negative inside, to first order."""
    steep = np.einsum("mkl,mijl->mijk", np.linalg.inv(spread), from_centre)
    squared = np.sum(steep * from_centre, axis=-1)  # 4 on the edge
    slope = 2.0 * np.linalg.norm(steep, axis=-1)
    # Of the function sqrt(squared): it is a cone, on which the first order is exact for circles.
    root = np.sqrt(squared)
    return np.asarray((root - 2.0) * 2.0 * root / np.maximum(slope, 1e-9))


def _mean(values: FloatArray, where: BoolArray) -> FloatArray:
    return np.asarray(np.where(where, values, 0.0).sum(axis=(1, 2)) / np.maximum(where.sum(axis=(1, 2)), 1))


def _noise_variance(below: FloatArray, ring: BoolArray, inside: BoolArray) -> FloatArray:
    """(m,) of a pixel of the edge: the mean of the ground's and, where a dot has an inside, the dot's."""
    of_ground = np.where(ring, below, 0.0) ** 2
    ground = of_ground.sum(axis=(1, 2)) / np.maximum(ring.sum(axis=(1, 2)) - 3, 1)
    of_dot = np.where(inside, below - _mean(below, inside)[:, None, None], 0.0) ** 2
    number = inside.sum(axis=(1, 2))
    dot = of_dot.sum(axis=(1, 2)) / np.maximum(number - 1, 1)
    return np.asarray(np.maximum(np.where(number > _LEAST_GROUND_PX, 0.5 * (ground + dot), ground), _QUANTUM_VARIANCE))


def _blur(depth: FloatArray, edge: BoolArray, variance: FloatArray, dots: Dots) -> FloatArray:
    """(m,) standard deviation of the blur of an edge: across it, depth * (1 - depth) sums to that over root pi."""
    mixed = np.where(edge, depth * (1.0 - depth), 0.0).sum(axis=(1, 2)) + edge.sum(axis=(1, 2)) * variance
    perimeter = 2.0 * np.pi * np.sqrt(2.0 * (dots.spread[:, 0, 0] + dots.spread[:, 1, 1]))
    return np.asarray(np.sqrt(np.pi) * np.maximum(mixed, 0.0) / perimeter)

"""Rejection of decoded pixels, and panel positions from the readings of both axes."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.decoded import (
    Decoded,
    DecodeOptions,
    Rejection,
    coarse_variance,
    left_of_wave,
    mean_of_cell_errors,
)
from wlr_render.captures.patterns.photometry import Grey, PanelContrast
from wlr_render.captures.photographs import CodeImage
from wlr_render.errors import BadInputError
from wlr_render.mappings import Panel
from wlr_render.numerics.arrays import FloatArray

Mask = NDArray[np.bool_]
Slices = tuple[slice, slice]

WINDOW = 3
"""Width of the window, camera pixels."""

_FLAT: FloatArray = np.ones(WINDOW)
_RAMP: FloatArray = np.arange(WINDOW, dtype=np.float64) - (WINDOW - 1) / 2
_RIDGE = 1e-9  # ridge for windows of one row, where the slope across is undetermined; without effect on other windows

_CLEAR = 4.0  # least contrast of a lit pixel, in sigmas of a difference of photographs
_SURE = 2.0  # least evidence, in sigmas of a difference of photographs
_EDGE = 0.5  # least contrast relative to the brightest neighbour; a pixel below it sees past an edge
_BESIDE_EDGE = 0.3  # least contrast of the darkest neighbour relative to the pixel; below it, the pixel is at an edge
_OVERHANG_PX = 0.5  # largest distance outside the panel, for noise
# Outlier thresholds, as distances from the neighbours: panel pixels, steps and standard deviations.
_OUTLIER_PX, _OUTLIER_STEPS, _OUTLIER_SIGMAS = 0.75, 0.5, 4.0
_VAGUE_PX = 0.25  # largest standard deviation, in cells; with a larger one, a position could be wrong by a panel pixel
_PIXEL_HARMONICS = (1, 2)
BORDER_WIDTH = 1.596
"""Width, in standard deviations of the blur, of the gap that a blurred border leaves in the strength of its bit."""
_WIDE, _WIDE_FROM = 0.21, 0.76  # slope and start of the rms error of cells that are narrower than the blur, in cells
_LEAST = 0.01  # rms error of counted cells at any blur, in cells
_BOX = 0.048  # rms error of a pixel without blur that is 1.5 cells wide, in cells
_NEEDED = 3  # fewest agreeing neighbours, except at the border of the picture
_FEW = 400  # fewest pairs for a test of the order of photographs


@dataclass(frozen=True, eq=False)
class LocalFit:
    """Weighted least squares with weight 1 where valid, 0 elsewhere.

    Attributes:
        value: (2, h, w) plane at the pixel.
        slope: (2, 2, h, w) change of the plane per camera pixel; slope[i, j] for panel axis i along axis j of the
            picture (x, y).
        gain: (h, w) variance of `value` relative to one position: 1/9 in a full window.
    """

    value: FloatArray
    slope: FloatArray
    gain: FloatArray


def fit_planes(position: FloatArray, valid: NDArray[np.bool_]) -> LocalFit:
    """Fit planes at all pixels at once.

    Args:
        position: (2, h, w), finite everywhere.
        valid: (h, w) mask of used positions; results are meaningful only there.
    """
    inverse = _inverse_moments(valid.astype(np.float64))
    fits = np.array([_solve(inverse, np.where(valid, axis, 0.0)) for axis in position])  # (2, 3, h, w)
    return LocalFit(fits[:, 0], fits[:, 1:], inverse[0])


def _inverse_moments(weight: FloatArray) -> tuple[FloatArray, ...]:
    """Return the upper triangle, row by row, of the inverse of the matrix of moments of (1, x, y)."""
    square = _RAMP * _RAMP
    n, x, y = (_sum(weight, *kernels) for kernels in ((_FLAT, _FLAT), (_RAMP, _FLAT), (_FLAT, _RAMP)))
    xx, yy = _sum(weight, square, _FLAT) + _RIDGE, _sum(weight, _FLAT, square) + _RIDGE
    xy = _sum(weight, _RAMP, _RAMP)
    first = xx * yy - xy * xy, xy * y - x * yy, x * xy - xx * y
    determinant = n * first[0] + x * first[1] + y * first[2]
    scale = 1 / np.where(determinant > 0, determinant, np.inf)
    rest = n * yy - y * y, x * y - n * xy, n * xx - x * x
    return tuple(entry * scale for entry in (*first, *rest))


def _solve(inverse: tuple[FloatArray, ...], value: FloatArray) -> FloatArray:
    i00, i01, i02, i11, i12, i22 = inverse
    s, sx, sy = (_sum(value, *kernels) for kernels in ((_FLAT, _FLAT), (_RAMP, _FLAT), (_FLAT, _RAMP)))
    return np.array([i00 * s + i01 * sx + i02 * sy, i01 * s + i11 * sx + i12 * sy, i02 * s + i12 * sx + i22 * sy])


def _sum(image: FloatArray, along_x: FloatArray, along_y: FloatArray) -> FloatArray:
    return np.asarray(cv2.sepFilter2D(image, -1, along_x, along_y, borderType=cv2.BORDER_CONSTANT))


@dataclass(frozen=True, eq=False)
class AxisReading:
    """Decoded positions along one axis, without use of neighbouring camera pixels; all (h, w).

    Attributes:
        position: panel pixels, finite everywhere.
        noise_gain: variance of the position, panel pixels squared, over the variance of the difference of two
            photographs in units of the contrast.
        evidence: 0 to 1, strength of the weakest bit or fringe used, relative to full contrast.
        weak: `Rejection` of a pixel with too weak evidence.
        contradiction: mask of contradictions between parts of the code.
        cell_px: uint8, width of the cells whose numbers were read, panel pixels: 1, 2, 4 or 8.
        blur_px: standard deviation of the position of a pixel's light along the axis, panel pixels; 0 if unknown.
        is_counted: True if the position comes from a number of cells, not from a phase.
    """

    position: FloatArray
    noise_gain: Grey
    evidence: Grey
    weak: NDArray[np.uint8]
    contradiction: NDArray[np.bool_]
    cell_px: NDArray[np.uint8]
    blur_px: Grey
    is_counted: bool


def combine_axes(
    readings: Sequence[AxisReading],
    light: PanelContrast,
    peak: CodeImage,
    noise_variance: Grey,
    options: DecodeOptions,
    panel: Panel,
) -> Decoded:
    """Combine both axes into panel positions: reject unreliable pixels and fit local planes to the others.

    Args:
        readings: readings of u and v.
        light: light of the set.
        peak: (h, w) brightest value in any photograph.
        noise_variance: (h, w) variance of the difference of two photographs.
        options: thresholds for accepting a pixel.
        panel: the photographed panel.

    Raises:
        BadInputError: most neighbouring pixels contradict each other.
    """
    position = np.array([reading.position for reading in readings])
    relative = noise_variance * light.per_contrast**2
    variance = relative * np.mean([reading.noise_gain for reading in readings], axis=0)
    rejection = _rejected_alone(readings, light, peak, np.sqrt(relative), options, panel)
    alone = rejection == Rejection.ACCEPTED
    step = _typical_step(position, alone)
    cell = np.maximum(*(reading.cell_px for reading in readings))
    valid = alone & _agrees_with_neighbours(position, alone, step, cell)
    outlier = np.maximum(np.maximum(_OUTLIER_PX * cell, _OUTLIER_STEPS * step), _OUTLIER_SIGMAS * np.sqrt(variance))
    valid &= np.all(np.abs(fit_planes(position, valid).value - position) <= outlier, axis=0)
    rejection[alone & ~valid] = Rejection.ISOLATED
    fit = fit_planes(position, valid)
    by_noise = variance * fit.gain
    vague = valid & (by_noise > (_VAGUE_PX * cell) ** 2)
    rejection[vague], valid = readings[0].weak[vague], valid & ~vague
    structure = np.mean([_cell_structure(*both) for both in zip(fit.slope, readings, strict=True)], axis=0)
    return Decoded(
        cell_px=cell,
        pixel=np.where(valid[..., None], np.moveaxis(fit.value, 0, -1), np.nan).astype(np.float32),
        sigma_px=np.where(valid, np.sqrt(by_noise + structure), np.nan).astype(np.float32),
        noise_px=np.where(valid, np.sqrt(by_noise), np.nan).astype(np.float32),
        confidence=np.clip(np.minimum(*(each.evidence for each in readings)), 0, 1) * light.lit,
        rejection=rejection,
    )


def _rejected_alone(
    readings: Sequence[AxisReading],
    light: PanelContrast,
    peak: CodeImage,
    noise: Grey,
    options: DecodeOptions,
    panel: Panel,
) -> NDArray[np.uint8]:
    """Return each pixel's first rejection (h, w) that needs no neighbours; `noise` is relative to the contrast."""
    u, v = readings
    reasons: tuple[tuple[Mask, Any], ...] = (
        (peak >= light.end_of_scale, Rejection.SATURATED),
        (~light.lit | (_CLEAR * noise > 1), Rejection.DARK),
        (_partly_lit(light.contrast), Rejection.PARTLY_LIT),
        *((each.evidence < np.maximum(options.min_confidence, _SURE * noise), each.weak) for each in readings),
        (u.contradiction | v.contradiction, Rejection.CONTRADICTION),
        (_outside(u, panel.width_px) | _outside(v, panel.height_px), Rejection.OUTSIDE_PANEL),
    )
    wheres, names = zip(*reasons, strict=True)
    return np.asarray(np.select(wheres, names, Rejection.ACCEPTED), dtype=np.uint8)


def _partly_lit(contrast: Grey) -> Mask:
    """Return the mask (h, w) of pixels with part of their light missing, which shifts the mean position."""
    around = np.ones((3, 3), dtype=np.uint8)
    brightest, darkest = cv2.dilate(contrast, around), cv2.erode(contrast, around)
    return np.asarray((contrast < _EDGE * brightest) | (darkest < _BESIDE_EDGE * contrast))


def _outside(reading: AxisReading, length_px: int) -> Mask:
    overhang = _OVERHANG_PX * reading.cell_px
    return np.asarray((reading.position < -overhang) | (reading.position > length_px + overhang))


def _cell_structure(slope: FloatArray, reading: AxisReading) -> FloatArray:
    """Return the variance (h, w) in a window's mean due to the panel's cells, panel pixels squared.

    The cell number of a point is its position plus a sawtooth of period 1, whose harmonic n has the amplitude 1 / (pi
    n). The blur of a pixel, here a Gaussian, and the mean over the window reduce the sawtooth. A wide pixel sees more
    than one border; the additional error of counted cells is an empirical fit to blurred Gray codes.

    Args:
        slope: (2, h, w) panel pixels per camera pixel along x and y.
        reading: reading of the axis.
    """
    cell = reading.cell_px.astype(np.float32)
    slope = slope.astype(np.float32)
    per_pixel = slope / cell
    blur = np.maximum(reading.blur_px**2, np.sum(slope**2, axis=0) / 12) / cell**2
    variance = np.zeros(cell.shape, dtype=np.float32)
    for n in _PIXEL_HARMONICS:
        variance += (
            0.5 * (np.exp(-2 * (np.pi * n) ** 2 * blur) / (np.pi * n)) ** 2 * left_of_wave(n * per_pixel, WINDOW)
        )
    if reading.is_counted:
        wide = np.hypot(_WIDE * np.maximum(BORDER_WIDTH * np.sqrt(blur) - _WIDE_FROM, 0), _LEAST)
        # A sharp pixel between one and two cells wide is a box, not a Gaussian.
        width = np.sqrt(np.sum(per_pixel**2, axis=0))
        sharp = np.clip(6 - 5 * np.sqrt(blur) * BORDER_WIDTH / np.maximum(0.5 * width, 1e-6), 0, 1)
        wide = np.hypot(wide, _BOX * sharp * np.abs(np.sin(np.pi * width)) * (width > 1))
        variance += wide**2 * mean_of_cell_errors(per_pixel, WINDOW)
    return np.asarray(cell**2 * variance + coarse_variance(reading.cell_px))


def neighbour_slices(dx: int, dy: int) -> tuple[Slices, Slices]:
    """Return slices of a picture's pixels and of their neighbours at (dx, dy); dx is -1, 0 or 1, dy is 0 or 1."""
    here, there = {0: (slice(None), slice(None)), 1: (slice(None, -1), slice(1, None))}[abs(dx)][
        :: 1 if dx >= 0 else -1
    ]
    above, below = {0: (slice(None), slice(None)), 1: (slice(None, -1), slice(1, None))}[dy]
    return (above, here), (below, there)


def _typical_step(position: FloatArray, valid: Mask) -> float:
    """Return the median distance on the panel of neighbouring pixels, in panel pixels; 0 without neighbours.

    Args:
        position: (2, h, w) positions.
        valid: (h, w) mask of used positions.
    """
    steps = []
    for offset in ((1, 0), (0, 1)):
        here, there = neighbour_slices(*offset)
        apart = np.abs(position[:, *there] - position[:, *here]).max(axis=0)
        steps.append(apart[valid[here] & valid[there]])
    distances = np.concatenate(steps)
    return float(np.median(distances)) if distances.size else 0.0


def _agrees_with_neighbours(position: FloatArray, valid: Mask, step: float, cell_px: NDArray[np.uint8]) -> Mask:
    """Return the mask (h, w) where three neighbours, and half of the valid ones, are within about one step or cell.

    Raises:
        BadInputError: most neighbours of most pixels lie elsewhere.
    """
    tolerance = (cell_px + 3 * step).astype(np.float32)
    there_are, agreeing, present = (np.zeros(valid.shape, dtype=np.uint8) for _ in range(3))
    for offset in ((1, 0), (0, 1), (1, 1), (-1, 1)):  # each pair of neighbours once
        here, there = neighbour_slices(*offset)
        both = valid[here] & valid[there]
        near = np.maximum(tolerance[here], tolerance[there])
        agree = both & np.all(np.abs(position[:, *there] - position[:, *here]) <= near, axis=0)
        for side in (here, there):
            there_are[side] += 1
            present[side] += both
            agreeing[side] += agree
    pairs = int(present.sum())
    share = int(agreeing.sum()) / max(pairs, 1)
    if pairs >= _FEW and share < 0.5:
        raise BadInputError(
            f"Neighbouring pixels contradict each other in {1 - share:.0%} of the decoded pixels: the photographs are "
            "not in the order of showing, the camera moved between them, or they show another code or panel size."
        )
    return (agreeing >= np.minimum(_NEEDED, there_are)) & (2 * agreeing >= present)

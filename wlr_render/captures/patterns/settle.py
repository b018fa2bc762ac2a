"""From raw positions to what is believed: the same rules for every family of codes."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.decoded import Decoded, Rejection
from wlr_render.captures.patterns.local_fit import WINDOW, LocalFit, fit_planes
from wlr_render.captures.patterns.neighbours import fits_neighbours, typical_step
from wlr_render.captures.patterns.pattern import DecodeOptions
from wlr_render.captures.patterns.photometry import Light
from wlr_render.captures.patterns.shots import Grey
from wlr_render.captures.photographs import Photograph
from wlr_render.mappings import Panel
from wlr_render.numerics.arrays import FloatArray

Mask = NDArray[np.bool_]

_CLEAR = 4.0  # contrast over the noise of a difference, below which a pixel is dark
_SURE = 2.0  # evidence over the noise of a difference
_EDGE = 0.5  # of the contrast of the brightest neighbour, below which a pixel sees past an edge,
_BESIDE_EDGE = 0.3  # or it does if its darkest neighbour has less than this of its own contrast
_OVERHANG_PX = 0.5  # noise may carry a position over the panel's edge by this much
_STRAY_PX, _STRAY_STEPS, _STRAY_SIGMAS = 0.75, 0.5, 4.0  # a stray lies off its neighbours by more than all of these
_VAGUE_PX = 0.25  # a larger standard deviation could be wrong by a panel pixel
_PIXEL_HARMONICS = (1, 2)


@dataclass(frozen=True, eq=False)
class AxisReading:
    """What a code says of one axis, each camera pixel by itself; all (h, w).

    Attributes:
        position: panel pixels, finite everywhere.
        noise_gain: variance of the position, panel pixels squared, over that of the difference of two photographs in
            units of the contrast.
        evidence: 0 to 1: the weakest evidence that was needed, as a part of full contrast.
        weak: `Rejection` that is the reason where the evidence is too weak.
        contradiction: where parts of the code exclude each other.
    """

    position: FloatArray
    noise_gain: Grey
    evidence: Grey
    weak: NDArray[np.uint8]
    contradiction: NDArray[np.bool_]


def settle(
    readings: Sequence[AxisReading],
    light: Light,
    peak: Photograph,
    noise_variance: Grey,
    options: DecodeOptions,
    panel: Panel,
) -> Decoded:
    """Reject what cannot be believed, and fit the rest to its neighbours.

    Args:
        readings: of u and v.
        light: of the set.
        peak: (h, w) the brightest value in any photograph.
        noise_variance: (h, w) of the difference of two photographs.
        options: when a pixel is believed.
        panel: that was photographed.

    Raises:
        BadInputError: most neighbouring pixels contradict each other.
    """
    position = np.array([reading.position for reading in readings])
    relative = noise_variance * light.per_contrast**2
    variance = relative * np.mean([reading.noise_gain for reading in readings], axis=0)
    rejection = _rejected_alone(readings, light, peak, np.sqrt(relative), options, panel)
    alone = rejection == Rejection.ACCEPTED
    step = typical_step(position, alone)
    valid = alone & fits_neighbours(position, alone, step)
    stray = np.maximum(max(_STRAY_PX, _STRAY_STEPS * step), _STRAY_SIGMAS * np.sqrt(variance))
    valid &= np.all(np.abs(fit_planes(position, valid).value - position) <= stray, axis=0)
    rejection[alone & ~valid] = Rejection.ISOLATED
    fit = fit_planes(position, valid)
    by_noise = variance * fit.gain
    vague = valid & (by_noise > _VAGUE_PX**2)
    rejection[vague], valid = readings[0].weak[vague], valid & ~vague
    sigma = np.sqrt(by_noise + _pixel_structure(fit))
    return Decoded(
        pixel=np.where(valid[..., None], np.moveaxis(fit.value, 0, -1), np.nan).astype(np.float32),
        sigma_px=np.where(valid, sigma, np.nan).astype(np.float32),
        confidence=np.clip(np.minimum(*(each.evidence for each in readings)), 0, 1) * light.lit,
        rejection=rejection,
    )


def _rejected_alone(
    readings: Sequence[AxisReading], light: Light, peak: Photograph, noise: Grey, options: DecodeOptions, panel: Panel
) -> NDArray[np.uint8]:
    """(h, w) the first reason that applies, without asking the neighbours; `noise` as a part of the contrast."""
    u, v = readings
    reasons: tuple[tuple[Mask, Any], ...] = (
        (peak >= light.end_of_scale, Rejection.SATURATED),
        (~light.lit | (_CLEAR * noise > 1), Rejection.DARK),
        (_partly_lit(light.contrast), Rejection.PARTLY_LIT),
        *((each.evidence < np.maximum(options.min_confidence, _SURE * noise), each.weak) for each in readings),
        (u.contradiction | v.contradiction, Rejection.CONTRADICTION),
        (_outside(u.position, panel.width_px) | _outside(v.position, panel.height_px), Rejection.OUTSIDE_PANEL),
    )
    wheres, names = zip(*reasons, strict=True)
    return np.asarray(np.select(wheres, names, Rejection.ACCEPTED), dtype=np.uint8)


def _partly_lit(contrast: Grey) -> Mask:
    """(h, w) where light is missing: the mean of what is seen is then not what lies in the pixel's middle."""
    around = np.ones((3, 3), dtype=np.uint8)
    brightest, darkest = cv2.dilate(contrast, around), cv2.erode(contrast, around)
    return np.asarray((contrast < _EDGE * brightest) | (darkest < _BESIDE_EDGE * contrast))


def _outside(position: FloatArray, length_px: int) -> Mask:
    return (position < -_OVERHANG_PX) | (position > length_px + _OVERHANG_PX)


def _pixel_structure(fit: LocalFit) -> FloatArray:
    """(h, w) variance that the panel's own pixels leave in a mean over the window, mean of both axes.

    A mean over the light of a window is the mean of pixel centres, and floor(x) + 1/2 - x is a saw-tooth of period 1
    whose harmonic n has the amplitude 1 / (pi n); the window, seen on the panel, is |slope| * WINDOW wide along each
    axis of the picture, which leaves a sinc of each.
    """
    variance = np.zeros(fit.gain.shape)
    for slope in fit.slope:
        for n in _PIXEL_HARMONICS:
            left = np.sinc(n * WINDOW * slope[0]) * np.sinc(n * WINDOW * slope[1])
            variance += 0.25 * (left / (np.pi * n)) ** 2
    return variance

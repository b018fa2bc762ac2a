"""Panel positions decoded from a set of code photographs: per camera pixel, and as samples averaged over windows.

A thousand window averages carry almost as much information as a million neighbouring pixels.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render.io.file_records import ELSEWHERE
from wlr_render.numerics.arrays import FloatArray

_SMOOTHED_PX = 3  # width of the windows that smoothed `Decoded.pixel`
_REACH_PX = 4  # half width of a window, camera pixels
_COARSE_SIGMA = 0.15  # sigma of a position known to a cell of several panel pixels, in cell widths
_SMOOTHING_GAIN = 7.31
"""Variance of the mean of 9 x 9 smoothed pixels relative to independent ones: (73 / 729)**2 of a photographed pixel's
variance, against 1/9 of it in each smoothed pixel, times 81."""
_CELL_HARMONICS = ((0.5, 0.1), (1, 0.46), (2, 0.14), (3, 0.08))  # harmonics of the cells, and variance shares
_HIGHER_HARMONICS = 0.22  # variance share of the other harmonics
_FILLED = 0.6  # share of a window's pixels that must be accepted
_CLIP = 4.0  # rejection threshold: distance of a pixel from its window's plane, in robust standard deviations
_RIM_PX = 2  # width of the unused rim around a rejected pixel, camera pixels
_ROUNDS = 5  # rounds of rejection; outliers tilt the fitted plane, so that the worst are rejected first
_MAD = 1.4826  # factor from median absolute deviation to standard deviation


class Rejection(IntEnum):
    """Reason for rejecting a camera pixel, with its `sentence`."""

    ACCEPTED = 0, "the pixel shows a panel position"
    DARK = 1, "the panel's light is too weak there to be distinguished from noise"
    SATURATED = 2, "a photograph is at the end of its scale there"
    UNSURE_BIT = 3, "a bit of the code is too faint to be read"
    WEAK_FRINGE = 4, "the fringes are too faint for their phase"
    CONTRADICTION = 5, "code and fringes contradict each other"
    OUTSIDE_PANEL = 6, "the decoded position lies outside the panel"
    ISOLATED = 7, "the decoded position does not fit its neighbours"
    PARTLY_LIT = 8, "most of the light that its neighbour gets is missing: the pixel sees past an edge"

    sentence: str

    def __new__(cls, number: int, sentence: str = "") -> "Rejection":
        """Return the reason with this number."""
        reason = int.__new__(cls, number)
        reason._value_, reason.sentence = number, sentence
        return reason


@dataclass(frozen=True, eq=False)
class Decoded:
    """Decoded photographs of one camera position.

    Attributes:
        pixel: (h, w, 2) float32 panel position of each camera pixel, from a plane through it and its eight neighbours;
            NaN where rejected.
        sigma_px: (h, w) float32 estimated standard deviation of `pixel` per axis, panel pixels; NaN where rejected.
        confidence: (h, w) float32, 0 to 1: smallest contrast of the bits and fringes used, as a fraction of full
            contrast.
        rejection: (h, w) uint8, one `Rejection` each.
        noise_px: (h, w) float32 part of `sigma_px` that is noise of the photographs; the rest is the panel's cells.
        cell_px: (h, w) uint8, width of the resolved cells of the panel, panel pixels: 1, or 2, 4 or 8 where the finest
            bits of a Gray code could not be read.
    """

    pixel: NDArray[np.float32]
    sigma_px: NDArray[np.float32]
    confidence: NDArray[np.float32]
    rejection: NDArray[np.uint8]
    noise_px: NDArray[np.float32]
    cell_px: NDArray[np.uint8]

    @property
    def accepted(self) -> NDArray[np.bool_]:
        """Mask (h, w) of pixels with a panel position."""
        return np.asarray(self.rejection == Rejection.ACCEPTED)

    def counts(self) -> dict[Rejection, int]:
        """Return the number of camera pixels per rejection, without zero counts."""
        number = np.bincount(self.rejection.ravel(), minlength=len(Rejection))
        return {reason: int(number[reason]) for reason in Rejection if number[reason]}


@dataclass(frozen=True)
class DecodeOptions:
    """Thresholds for accepting a camera pixel.

    Attributes:
        full_scale: largest value of the camera: 255, 1023, 4095, 65535.
        end_of_scale: value from which a pixel is saturated; None: `full_scale`. Infinite for pictures that no camera
            took, larger than `full_scale` for merged exposures.
        min_contrast: smallest difference of white and black, as a fraction of the full scale; pixels below are dark. A
            pixel is also dark if the difference is not well above the measured noise of the set.
        min_confidence: smallest contrast of a bit or fringe, as a fraction of full contrast.
    """

    full_scale: Annotated[int, ELSEWHERE] = 255
    min_contrast: float = 0.02
    min_confidence: float = 0.1
    end_of_scale: Annotated[float | None, ELSEWHERE] = None


DEFAULT_OPTIONS = DecodeOptions()


@dataclass(frozen=True, eq=False)
class DecodedSamples:
    """Panel positions at camera pixels.

    Attributes:
        camera_pixel: (n, 2) centres of camera pixels.
        panel_pixel: (n, 2) panel positions of these pixels.
        sigma_px: (n,) standard deviation of `panel_pixel` per axis, panel pixels.
        scale: (n,) panel pixels per camera pixel.
    """

    camera_pixel: FloatArray
    panel_pixel: FloatArray
    sigma_px: FloatArray
    scale: FloatArray

    def __len__(self) -> int:
        return len(self.camera_pixel)


def sample(decoded: Decoded, count: int = 1500) -> DecodedSamples:
    """Sample about `count` panel positions over the accepted pixels, each from a plane fitted to its window.

    The sigma follows from the noise of the pixels, which is correlated between neighbours (`_SMOOTHING_GAIN`).
    """
    height, width = decoded.rejection.shape
    every = max(1, int(np.sqrt(np.count_nonzero(decoded.accepted) / count)))
    steps = np.arange(-_REACH_PX, _REACH_PX + 1)
    rows, columns = (np.arange(_REACH_PX, size - _REACH_PX, every) for size in (height, width))
    v, u = (each.ravel() for each in np.meshgrid(rows, columns, indexing="ij"))
    # Near rejected pixels, above all at the panel's edge, part of the blurred light is missing.
    inner = cv2.erode(decoded.accepted.astype(np.uint8), np.ones((2 * _RIM_PX + 1,) * 2, np.uint8)).astype(bool)
    wanted = np.asarray(inner[v, u])
    v, u = v[wanted], u[wanted]
    dv, du = (offset.ravel() for offset in np.meshgrid(steps, steps, indexing="ij"))
    good = np.asarray(inner[v[:, None] + dv, u[:, None] + du])
    enough = np.asarray(good.mean(axis=1) >= _FILLED)
    u, v, good = u[enough], v[enough], good[enough]
    window = v[:, None] + dv, u[:, None] + du
    panel = decoded.pixel[window].astype(np.float64)
    kept = good
    planes, residual = _planes(panel, kept, du, dv)
    for _ in range(_ROUNDS):
        away = np.abs(residual).max(axis=-1)
        scatter = _MAD * np.nanmedian(np.where(kept, away, np.nan), axis=1)
        kept = good & (away <= _CLIP * np.maximum(scatter, 1e-9)[:, None])
        planes, residual = _planes(panel, kept, du, dv)
    number = kept.sum(axis=1)
    noise, total = (
        np.sum(np.where(kept, each[window].astype(np.float64) ** 2, 0.0), axis=1) / number
        for each in (decoded.noise_px, decoded.sigma_px)
    )
    unread = coarse_variance(decoded.cell_px[v, u])
    structure = np.maximum(total - noise - unread, 0) * _structure_left(planes[:, 1:], decoded.cell_px[v, u]) + unread
    return DecodedSamples(
        camera_pixel=np.stack([u, v], axis=-1) + 0.5,
        panel_pixel=planes[:, 0],
        sigma_px=np.sqrt(_SMOOTHING_GAIN * noise / number + structure),
        scale=np.sqrt(np.abs(np.linalg.det(planes[:, 1:]))),
    )


def coarse_variance(cell_px: NDArray[np.uint8]) -> FloatArray:
    """Return the least variance (...) of positions in cells of several panel pixels, panel pixels squared.

    Averaging does not reduce it. Fine bits fade by blur and by indirect light, which shifts the position: measured on
    photographs of a projector, docs/measured-data.md.
    """
    return np.where(cell_px > 1, (_COARSE_SIGMA * cell_px.astype(np.float64)) ** 2, 0.0)


def _structure_left(slope: FloatArray, cell_px: NDArray[np.uint8]) -> FloatArray:
    """Return the ratio (n,) of cell-error variances: mean of a window over smoothed pixel.

    Args:
        slope: (n, 2, 2) change of both panel axes along x (slope[:, 0]) and y, panel pixels per camera pixel.
        cell_px: (n,) width of the cells.
    """
    periods = np.moveaxis(slope / cell_px[:, None, None], 1, 0)
    of_window, of_pixel = (mean_of_cell_errors(periods, width) for width in (2 * _REACH_PX + 1, _SMOOTHED_PX))
    return np.asarray(np.mean(of_window / of_pixel, axis=-1))


def mean_of_cell_errors(periods: FloatArray, width: int) -> FloatArray:
    """Return the fraction (...) of the variance of counted-cell errors left by a mean of width x width pixels.

    The harmonics and their shares belong to a blurred Gray code.

    Args:
        periods: (2, ...) cells per camera pixel in x and y.
        width: camera pixels.
    """
    left = [share * left_of_wave(n * periods, width) for n, share in _CELL_HARMONICS]
    return np.asarray(np.sum(left, axis=0) + _HIGHER_HARMONICS / width**2)


def left_of_wave(frequency: FloatArray, width: int) -> FloatArray:
    """Return the fraction (...) of a wave's variance left by the mean over width x width camera pixels.

    Args:
        frequency: (2, ...) periods per camera pixel in x and y.
        width: camera pixels, an odd number.
    """
    turn = 2 * np.pi * (frequency - np.rint(frequency))
    mean = (1 + 2 * sum(np.cos(step * turn) for step in range(1, width // 2 + 1))) / width
    return np.asarray(np.prod(mean**2, axis=0))


def _planes(
    panel: FloatArray, kept: NDArray[np.bool_], du: NDArray[np.int64], dv: NDArray[np.int64]
) -> tuple[FloatArray, FloatArray]:
    """Return least-squares planes (n, 3, 2), constant first, of windows (n, m, 2), and the residuals (n, m, 2)."""
    basis = np.stack([np.ones(len(du)), du, dv], axis=-1)
    weight = kept.astype(np.float64)
    values = np.where(kept[..., None], panel, 0.0)
    normal = np.einsum("nm,mi,mj->nij", weight, basis, basis)
    planes = np.linalg.solve(normal, np.einsum("mi,nmk->nik", basis, values))
    return planes, panel - basis @ planes

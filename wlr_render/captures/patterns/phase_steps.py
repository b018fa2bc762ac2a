"""Phase-shifted sinusoidal fringes along one axis of a panel: images, decoding and order check.

The phase comes from the synchronous detection of Bruning et al., "Digital wavefront measuring interferometer", Appl.
Opt. 13 (1974): with N equal steps, constant light and harmonics of the fringe up to the order N - 2 do not affect the
phase, so that the gamma of panel and camera matters little from six steps on. If the steps are in order, all pixels
show one waveform, shifted.
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.patterns.photometry import Grey, PanelContrast, PhotographReader, check_range
from wlr_render.errors import BadInputError
from wlr_render.numerics.arrays import FloatArray

_MIN_STEPS, _MIN_PERIOD_PX = 3, 4
_REVERSED = 0.22
"""Contrast up to which blur may have reversed fringes: blur by a disc wider than a period leaves 0.13, by a square at
most 0.217."""
_GAP_NOISE = 2.0  # variance with one calculated step over that with all steps, mean over all phases
_ASKED = 64  # number of pixels along each side of the picture for the test of the order of the steps

_MIN_UNEXPLAINED = 0.02  # least residual mean square relative to the fringe for a test of the order
_MAX_UNEXPLAINED = 0.3  # largest such residual of a fringe; beyond it, a third of its light is from another picture
_FOREIGN = 2.0  # residual of a foreign step over the mean of all steps; noise gives all steps the same residual
_MAX_CONTRADICTING = 0.2  # largest share of lit pixels that contradict the photographs before
_IMPROVED_BELOW = 0.6  # ratio of residuals below which another order of the steps is the true one


@dataclass(frozen=True)
class FringeAxis:
    """The fringes of one period along one axis.

    Attributes:
        axis: "u" or "v".
        length_px: length of the panel along the axis.
        period_px: period of the fringe.
        steps: number of pictures, each shifted by 1 / steps of the period towards larger positions.
    """

    axis: str
    length_px: int
    period_px: float
    steps: int

    def names(self) -> list[str]:
        """Return the names of its pictures."""
        return [f"{self.axis} fringe {self.period_px:.4g} px step {step}" for step in range(self.steps)]

    def line(self, step: int) -> NDArray[np.uint8]:
        """Return the values 0 to 255 of one picture, (length_px,)."""
        phase = 2 * np.pi * ((np.arange(self.length_px) + 0.5) / self.period_px - step / self.steps)
        return np.asarray(np.round(127.5 + 127.5 * np.cos(phase)), dtype=np.uint8)


@dataclass(frozen=True, eq=False)
class FringeReading:
    """Decoded positions of one fringe, all (h, w).

    Attributes:
        position: position, panel pixels, with the measured phase; the nearest one to the approximate position.
        is_far: mask of positions that contradict the approximate ones.
        evidence: amplitude relative to full contrast; 0 where blur may have reversed a faint fringe.
        steady: grey values that are equal for all fringes except for noise, which has the variance of a difference of
            two photographs.
        noise_gain: as in `AxisReading`.
    """

    position: FloatArray
    is_far: NDArray[np.bool_]
    evidence: Grey
    steady: Grey
    noise_gain: Grey


def check_fringe(period_px: float, steps: int) -> None:
    """Refuse a fringe that cannot be shown.

    Raises:
        BadInputError: the period is too short for a panel's pixels, or the steps are too few for a phase.
    """
    if period_px < _MIN_PERIOD_PX:
        raise BadInputError(f"'period_px' is {period_px:g}; fringes need at least {_MIN_PERIOD_PX} panel pixels.")
    if steps < _MIN_STEPS:
        raise BadInputError(f"'steps' is {steps}; a phase needs at least {_MIN_STEPS}, and 6 to be immune to gamma.")


def read_fringe(
    axis: FringeAxis, reader: PhotographReader, light: PanelContrast, about: FloatArray, far: float
) -> FringeReading:
    """Decode the photographs of one fringe.

    Args:
        axis: the fringe.
        reader: reader at the first photograph of the fringe.
        light: light of the set.
        about: (h, w) approximate positions, panel pixels.
        far: distance from `about`, in periods, beyond which a position contradicts the photographs before.

    Raises:
        BadInputError: a photograph is missing, the steps are not in order, or too many pixels contradict the
            photographs before.
    """
    first = reader.taken
    real, imaginary, steady, alternating = (np.zeros(light.contrast.shape, dtype=np.float32) for _ in range(4))
    every = tuple(slice(None, None, max(1, size // _ASKED)) for size in light.contrast.shape)
    asked = np.zeros((axis.steps, np.count_nonzero(light.lit[every])), dtype=np.float32)
    missing: int | None = None

    def add(step: int, value: Grey) -> None:
        nonlocal real, imaginary, steady
        asked[step] = value[every][light.lit[every]]
        angle = 2 * np.pi * step / axis.steps
        real += np.float32(np.cos(angle)) * value
        imaginary += np.float32(np.sin(angle)) * value
        steady += value

    for step in range(axis.steps):
        image = reader.take()
        if image is None:
            _check_gap(axis, missing, step, reader, first)
            missing = step
            continue
        check_range(image, light, reader)
        value = image - light.middle
        add(step, value)
        alternating += np.float32((-1) ** step) * value
    noise = 1.0
    if missing is not None:
        # The alternating sum of all steps is zero if the fringe lacks the harmonic of order steps / 2.
        add(missing, np.float32(-((-1) ** missing)) * alternating)
        noise = _GAP_NOISE
    _check_step_order(asked, reader, first)
    turns = np.arctan2(imaginary, real).astype(np.float64) / (2 * np.pi) % 1
    evidence = np.float32(4 / axis.steps) * np.hypot(real, imaginary) * light.per_contrast
    evidence[evidence < _REVERSED] = 0.0
    position = about + axis.period_px * ((turns - about / axis.period_px + 0.5) % 1 - 0.5)
    is_far = np.abs(position - about) > far * axis.period_px
    _check_agreement(is_far & (evidence > 0), light, reader, first)
    # The variance of an N-step phase is 2 / N of a photograph's variance over the amplitude squared; the amplitude is
    # half of the contrast at full evidence, and a photograph has half the variance of a difference.
    gain = (axis.period_px / (2 * np.pi)) ** 2 * (4 / axis.steps * noise / np.maximum(evidence, 1e-3) ** 2)
    steady *= np.float32(np.sqrt(2 / axis.steps))
    return FringeReading(position, is_far, evidence, steady, np.asarray(gain, dtype=np.float32))


def _check_gap(axis: FringeAxis, missing: int | None, step: int, reader: PhotographReader, first: int) -> None:
    """Refuse a second missing step, and any missing step if the number of steps is odd."""
    if missing is not None:
        raise BadInputError(
            f"{reader.label(first + missing)} and {reader.label(first + step)} are missing; a fringe can do without "
            "one step only."
        )
    if axis.steps % 2:
        raise BadInputError(
            f"{reader.label(first + step)} is missing; a fringe of {axis.steps} steps needs all, one of an even number "
            "can do without one."
        )


def _check_step_order(values: NDArray[np.float32], reader: PhotographReader, first: int) -> None:
    """Refuse steps from photograph `first` on that are not a fringe; `values` (steps, n) are grey values of lit pixels.

    Either an exchange of two steps gives a clearly better fringe, a step does not belong to the others, or the
    photographs show another code. Three steps are a fringe in any order and are not tested.
    """
    steps = len(values)
    varying = values.astype(np.float64) - values.mean(axis=0)
    by_step = _unexplained(varying)
    as_read = float(np.sum(by_step))
    if as_read < _MIN_UNEXPLAINED:
        return
    swaps = list(combinations(range(steps), 2))
    left = [float(np.sum(_unexplained(varying[_swapped(steps, swap)]))) for swap in swaps]
    if min(left) < _IMPROVED_BELOW * as_read:
        # An exchange of steps that are two apart has a twin that gives an equally good, reversed fringe.
        likely = [swap for swap, rest in zip(swaps, left, strict=True) if rest < 1.2 * min(left) + _MIN_UNEXPLAINED]
        named = ", or ".join(" and ".join(reader.label(first + step) for step in swap) for swap in likely)
        raise BadInputError(f"{named} seem to be exchanged: the fringe is consistent only in that order.")
    worst = int(np.argmax(by_step))
    if by_step[worst] > _FOREIGN * as_read / steps:
        raise BadInputError(
            f"{reader.label(first + worst)} does not belong to its fringe: it is out of order, shows something else, "
            "or is of another exposure."
        )
    if as_read > _MAX_UNEXPLAINED:
        raise BadInputError(
            f"{reader.label(first)} to {reader.label(first + steps - 1)} show no fringe shifted step by step: one is "
            "missing, out of order or of another exposure, or the photographs show another code."
        )


def _check_agreement(
    contradicting: NDArray[np.bool_], light: PanelContrast, reader: PhotographReader, first: int
) -> None:
    """Refuse a fringe from photograph `first` on if too many pixels (h, w) contradict the photographs before it."""
    share = float(np.mean(contradicting[light.lit])) if light.lit.any() else 0.0
    if share > _MAX_CONTRADICTING:
        raise BadInputError(
            f"{reader.label(first)} to {reader.label(reader.taken - 1)} contradict those before them in {share:.0%} of "
            "the lit pixels: the set is out of order, or the camera moved."
        )


def _swapped(steps: int, swap: tuple[int, int]) -> list[int]:
    order = list(range(steps))
    order[swap[0]], order[swap[1]] = swap[1], swap[0]
    return order


def _unexplained(varying: FloatArray) -> FloatArray:
    """Return the residual shares (steps,) of a fit of one fundamental with one second harmonic for all pixels."""
    steps = len(varying)
    angle = 2 * np.pi * np.arange(steps)[:, None] / steps
    fundamental = 2 / steps * np.sum(varying * np.exp(1j * angle), axis=0)
    amplitude, phase = np.abs(fundamental), np.angle(fundamental)
    left = varying - amplitude * np.cos(phase - angle)
    harmonic = amplitude * np.cos(2 * (phase - angle))
    left -= np.sum(left * harmonic) / max(np.sum(harmonic**2), 1e-12) * harmonic
    return np.asarray(np.sum(left**2, axis=1) / max(np.sum(varying**2), 1e-12))

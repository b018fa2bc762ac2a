"""Whether the steps of a fringe were photographed in their order: all pixels must show one waveform, shifted."""

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.patterns.shots import Shots
from wlr_render.errors import BadInputError
from wlr_render.numerics.arrays import FloatArray

_SUSPECT = 0.02  # mean square of what no waveform explains, as a part of the fringe's
_HOPELESS = 0.3
_FOREIGN = 2.0  # times the mean of all steps; noise leaves the same in each
_TORN = 0.2  # of the lit pixels
_BETTER = 0.6  # another order that leaves less of it is the true one


def check_steps(values: NDArray[np.float32], shots: Shots, first: int) -> None:
    """See that no exchange of two steps makes a clearly better fringe.

    Three steps make a fringe in any order; there is nothing to see then.

    Args:
        values: (steps, n) grey values of some lit pixels.
        shots: names the photographs.
        first: number of the first step's.

    Raises:
        BadInputError: an exchange does, one does not belong to the others, or they show no fringe at all.
    """
    steps = len(values)
    varying = values.astype(np.float64) - values.mean(axis=0)
    by_step = _unexplained(varying)
    as_read = float(np.sum(by_step))
    if as_read < _SUSPECT:
        return
    swaps = list(combinations(range(steps), 2))
    left = [float(np.sum(_unexplained(varying[_swapped(steps, swap)]))) for swap in swaps]
    if min(left) < _BETTER * as_read:
        # An exchange at two steps' distance has a twin that makes the fringe run backwards, and just as well.
        likely = [swap for swap, rest in zip(swaps, left, strict=True) if rest < 1.2 * min(left) + _SUSPECT]
        named = ", or ".join(" and ".join(shots.label(first + step) for step in swap) for swap in likely)
        raise BadInputError(f"{named} seem to be exchanged: the steps of the fringe fit together if they are.")
    worst = int(np.argmax(by_step))
    if by_step[worst] > _FOREIGN * as_read / steps:
        raise BadInputError(
            f"{shots.label(first + worst)} does not belong to its fringe: it is out of order, shows something else, "
            "or is of another exposure."
        )
    if as_read > _HOPELESS:
        raise BadInputError(
            f"{shots.label(first)} to {shots.label(first + steps - 1)} show no fringe shifted step by step: one is "
            "missing, out of order or of another exposure."
        )


def check_agreement(apart: NDArray[np.bool_], lit: NDArray[np.bool_], shots: Shots, first: int) -> None:
    """See that fringes fit what was read before them.

    Args:
        apart: (h, w) where they do not.
        lit: (h, w) which pixels to ask.
        shots: names the photographs; the last taken is the fringe's last.
        first: number of the fringe's first photograph.

    Raises:
        BadInputError: in too many pixels they do not.
    """
    share = float(np.mean(apart[lit])) if lit.any() else 0.0
    if share > _TORN:
        raise BadInputError(
            f"{shots.label(first)} to {shots.label(shots.taken - 1)} contradict those before them in {share:.0%} of "
            "the lit pixels: the set is out of order, or the camera moved."
        )


def _swapped(steps: int, swap: tuple[int, int]) -> list[int]:
    order = list(range(steps))
    order[swap[0]], order[swap[1]] = swap[1], swap[0]
    return order


def _unexplained(varying: FloatArray) -> FloatArray:
    """(steps,) what no fundamental with one second harmonic for all pixels explains, as parts of the sum of squares."""
    steps = len(varying)
    angle = 2 * np.pi * np.arange(steps)[:, None] / steps
    fundamental = 2 / steps * np.sum(varying * np.exp(1j * angle), axis=0)
    amplitude, phase = np.abs(fundamental), np.angle(fundamental)
    left = varying - amplitude * np.cos(phase - angle)
    harmonic = amplitude * np.cos(2 * (phase - angle))
    left -= np.sum(left * harmonic) / max(np.sum(harmonic**2), 1e-12) * harmonic
    return np.asarray(np.sum(left**2, axis=1) / max(np.sum(varying**2), 1e-12))

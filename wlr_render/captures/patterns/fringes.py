"""Phase-shifted fringes of several periods, unwrapped from long to short."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.decoded import Rejection
from wlr_render.captures.patterns.pattern import AxisCode, Pattern
from wlr_render.captures.patterns.phase_steps import FringeAxis, check_fringe, read_fringe
from wlr_render.captures.patterns.photometry import NoiseMeter, PanelContrast, PhotographReader
from wlr_render.captures.patterns.pixel_rejection import AxisReading

_LONGEST = 1.1  # longest period over the panel's length, with a margin for noise at its ends
_RATIO = 6.0  # largest ratio of successive periods; beyond it the long phase cannot unwrap the short one
_FAR = 0.3  # largest disagreement of two fringes, in periods of the shorter one; beyond it they contradict each other


@dataclass(frozen=True)
class Fringes(Pattern):
    """Multi-frequency phase shifting: fringes from long to short, the longest covering the panel.

    The hierarchy of periods follows Huntley and Saldner, "Temporal phase-unwrapping algorithm for automated
    interferogram analysis", Appl. Opt. 32 (1993), with periods in geometric steps. 1920 x 1080 takes 50 pictures.

    Attributes:
        panel: panel of the pattern.
        period_px: period of the shortest fringe.
        steps: steps of each fringe.

    Raises:
        BadInputError: see `check_fringe`.
    """

    period_px: int = 16
    steps: int = 6

    def __post_init__(self) -> None:
        check_fringe(self.period_px, self.steps)

    def axis(self, name: str, length_px: int) -> AxisCode:
        """Return the steps of the fringes from long to short."""
        longest = max(_LONGEST * length_px, self.period_px)
        count = math.ceil(math.log(longest / self.period_px, _RATIO))
        periods = np.geomspace(longest, self.period_px, count + 1)
        return _Hierarchy(tuple(FringeAxis(name, length_px, float(period), self.steps) for period in periods))


@dataclass(frozen=True)
class _Hierarchy:
    """One axis: its fringes from long to short."""

    fringes: tuple[FringeAxis, ...]

    def names(self) -> list[str]:
        return [name for fringe in self.fringes for name in fringe.names()]

    def line(self, index: int) -> NDArray[np.uint8]:
        number, step = divmod(index, self.fringes[0].steps)
        return self.fringes[number].line(step)

    def read(self, reader: PhotographReader, light: PanelContrast, noise: NoiseMeter) -> AxisReading:
        middle = np.full(light.lit.shape, 0.5 * self.fringes[0].length_px)
        reading = read_fringe(self.fringes[0], reader, light, middle, far=np.inf)
        noise.add(reading.steady, light.lit)
        evidence, contradiction = reading.evidence, reading.is_far
        for fringe in self.fringes[1:]:
            reading = read_fringe(fringe, reader, light, reading.position, _FAR)
            noise.add(reading.steady, light.lit)
            contradiction |= reading.is_far
            evidence = np.minimum(evidence, reading.evidence)
        return AxisReading(
            position=reading.position,
            noise_gain=reading.noise_gain,
            evidence=evidence,
            weak=np.full(light.lit.shape, Rejection.WEAK_FRINGE, dtype=np.uint8),
            contradiction=contradiction,
            cell_px=np.ones(light.lit.shape, dtype=np.uint8),
            blur_px=np.zeros(light.lit.shape, dtype=np.float32),
            is_counted=False,
        )

"""Phase-shifted fringes whose periods are numbered by a Gray code."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.decoded import Rejection
from wlr_render.captures.patterns.gray_bits import GrayAxis, read_gray
from wlr_render.captures.patterns.pattern import AxisCode, Pattern
from wlr_render.captures.patterns.phase_steps import FringeAxis, check_fringe, read_fringe
from wlr_render.captures.patterns.photometry import NoiseMeter, PanelContrast, PhotographReader
from wlr_render.captures.patterns.pixel_rejection import AxisReading
from wlr_render.errors import BadInputError

_FAR = 0.375  # largest distance from the middle of a cell in periods: between the cell's end (1/4) and ambiguity (1/2)


@dataclass(frozen=True)
class GrayFringes(Pattern):
    """Gray code of half periods, then fringes: 46 pictures for 1920 x 1080.

    A code that is wrong by one cell at the border of two cells still gives the right period, since its middle lies less
    than half a period away. The pattern is robust where blur removes the finest stripes of a full Gray code.

    Attributes:
        panel: panel of the pattern.
        period_px: period of the fringe, even.
        steps: steps of the fringe.

    Raises:
        BadInputError: the period is odd, or see `check_fringe`.
    """

    period_px: int = 16
    steps: int = 6

    def __post_init__(self) -> None:
        check_fringe(self.period_px, self.steps)
        if self.period_px % 2:
            raise BadInputError(f"'period_px' is {self.period_px}; it must be even, as the code numbers half periods.")

    def axis(self, name: str, length_px: int) -> AxisCode:
        """Return the code of one axis: bits of the half periods with their inverses, then the fringe's steps."""
        cells = -(-length_px // (self.period_px // 2))
        return _NumberedFringes(GrayAxis(name, cells), FringeAxis(name, length_px, self.period_px, self.steps))


@dataclass(frozen=True)
class _NumberedFringes:
    """Code of one axis; the cells are half periods."""

    gray: GrayAxis
    fringe: FringeAxis

    def names(self) -> list[str]:
        return self.gray.names() + self.fringe.names()

    def line(self, index: int) -> NDArray[np.uint8]:
        bits = len(self.gray.names())
        if index >= bits:
            return self.fringe.line(index - bits)
        return np.repeat(self.gray.line(index), int(self._cell_px))[: self.fringe.length_px]

    @property
    def _cell_px(self) -> float:
        return self.fringe.period_px / 2

    def read(self, reader: PhotographReader, light: PanelContrast, noise: NoiseMeter) -> AxisReading:
        code = read_gray(self.gray, reader, light, noise)
        middle = np.asarray((code.cell + 0.5) * self._cell_px, dtype=np.float64)
        phase = read_fringe(self.fringe, reader, light, middle, _FAR)
        bits_are_weaker = code.evidence < phase.evidence
        return AxisReading(
            position=phase.position,
            noise_gain=phase.noise_gain,
            evidence=np.minimum(code.evidence, phase.evidence),
            weak=np.where(bits_are_weaker, Rejection.UNSURE_BIT, Rejection.WEAK_FRINGE).astype(np.uint8),
            contradiction=phase.is_far,
            cell_px=np.ones(light.lit.shape, dtype=np.uint8),
            blur_px=code.blur * np.float32(self._cell_px),
            is_counted=False,
        )

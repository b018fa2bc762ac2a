"""Codes shown on a panel; to add one, subclass `Pattern` and name it in `PATTERNS`."""

import math
from dataclasses import dataclass, fields

import numpy as np

from wlr_render.captures.patterns.axis_code import AxisCode
from wlr_render.captures.patterns.gray_bits import GrayAxis
from wlr_render.captures.patterns.pattern import Pattern
from wlr_render.captures.patterns.phase_steps import FringeAxis, check_fringe
from wlr_render.errors import BadInputError
from wlr_render.mappings import Panel

_LONGEST = 1.1  # longest period over the panel's length, with a margin for noise at the panel's ends
_RATIO = 6.0  # largest ratio of successive periods; beyond it the long phase cannot unwrap the short one
_FAR_FROM_FRINGE = 0.3  # largest disagreement of successive fringes, in periods of the shorter one
_FAR_FROM_CELL = 0.375
"""Largest distance from the middle of a cell in periods: between the cell's end (1/4) and ambiguity (1/2)."""


@dataclass(frozen=True)
class GrayCode(Pattern):
    """Binary-reflected Gray code of columns and rows, each bit followed by its inverse; 46 pictures for 1920 x 1080.

    Positions are finer than a panel pixel: the grey value of the bit that changes between two panel pixels gives their
    shares in a camera pixel. Where the finest bits cannot be read, the position is known to a cell of 2, 4 or 8 panel
    pixels, with a larger standard deviation. The code works best if a camera pixel is one to two panel pixels wide,
    and the camera's grey values are linear in light.
    """

    def axis(self, name: str, length_px: int) -> AxisCode:
        """Return the code of one axis: bits from coarse to fine, each followed by its inverse."""
        return AxisCode(length_px, GrayAxis(name, length_px))


@dataclass(frozen=True)
class _FringePattern(Pattern):
    """Base of patterns with fringes."""

    period_px: int = 16
    steps: int = 6

    def __post_init__(self) -> None:
        check_fringe(self.period_px, self.steps)


class Fringes(_FringePattern):
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

    def axis(self, name: str, length_px: int) -> AxisCode:
        """Return the steps of the fringes from long to short."""
        longest = max(_LONGEST * length_px, self.period_px)
        count = math.ceil(math.log(longest / self.period_px, _RATIO))
        periods = np.geomspace(longest, self.period_px, count + 1)
        fringes = tuple(FringeAxis(name, length_px, float(period), self.steps) for period in periods)
        return AxisCode(length_px, fringes=fringes, far=_FAR_FROM_FRINGE)


class GrayFringes(_FringePattern):
    """Gray code of half periods, then fringes: 46 pictures for 1920 x 1080.

    A Gray code that is wrong by one cell at a cell border still identifies the right period, because the middle of that
    cell is less than half a period away. The pattern works where blur removes the finest stripes of a full Gray code.

    Attributes:
        panel: panel of the pattern.
        period_px: period of the fringe, even.
        steps: steps of the fringe.

    Raises:
        BadInputError: the period is odd, or see `check_fringe`.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.period_px % 2:
            raise BadInputError(f"'period_px' is {self.period_px}; it must be even, as the code numbers half periods.")

    def axis(self, name: str, length_px: int) -> AxisCode:
        """Return the code of one axis: bits of the half periods with their inverses, then the fringe's steps."""
        cell_px = self.period_px // 2
        fringe = FringeAxis(name, length_px, self.period_px, self.steps)
        return AxisCode(length_px, GrayAxis(name, -(-length_px // cell_px)), cell_px, (fringe,), _FAR_FROM_CELL)


PATTERNS: dict[str, type[Pattern]] = {
    "gray": GrayCode,
    "fringes": Fringes,
    "gray-fringes": GrayFringes,
}


def make_pattern(name: str, panel: Panel, **numbers: int) -> Pattern:
    """Return the pattern `name` for a panel.

    Args:
        name: one of `PATTERNS`.
        panel: panel that shows it.
        **numbers: parameters of the pattern, named in `pattern_keys`; missing ones have their defaults.

    Raises:
        BadInputError: the code or a parameter is unknown, or a parameter is invalid.
    """
    keys = pattern_keys(name)
    for key in numbers:
        if key not in keys:
            choice = f"it has {', '.join(keys)}" if keys else "it has none"
            raise BadInputError(f"The code '{name}' has no number '{key}'; {choice}.")
    return PATTERNS[name](panel, **numbers)


def pattern_keys(name: str) -> tuple[str, ...]:
    """Return the names of the parameters of a pattern.

    Raises:
        BadInputError: the code is unknown.
    """
    if name not in PATTERNS:
        raise BadInputError(f"Unknown code '{name}'; it must be one of {', '.join(PATTERNS)}.")
    return tuple(field.name for field in fields(PATTERNS[name]) if field.name != "panel")

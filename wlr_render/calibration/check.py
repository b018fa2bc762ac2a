"""Checks of a station: value, limit and verdict of one quantity."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from wlr_render.calibration.poses import small_motion
from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.geometry.directions import ARCMIN
from wlr_render.numerics.arrays import FloatArray

NEGLIGIBLE_MM = 0.03
"""A shift that moves a target at half a metre by 0.2 arcminutes; smaller ones are not worth a word."""
NEGLIGIBLE_ARCMIN = 0.3
WARNED_SIGMAS = 5.0
REFUSED_MM = 1.0
REFUSED_ARCMIN = 10.0
REFUSED_SIGMAS = 10.0


@dataclass(frozen=True)
class Check:
    """Result of checking one quantity.

    Attributes:
        step: of the procedure, or the photograph, that it speaks of.
        quantity: with its unit.
        value: found; `sigma`: its standard deviation; `limit`: what would still be right.
        sentence: what is off and what to do, or that it is right.
        ok: whether it is within the limit or within its uncertainty.
        contradictory: whether it is so far off that a calibration from it would be wrong.
    """

    step: str
    quantity: str
    value: float
    sigma: float
    limit: float
    sentence: str
    ok: bool
    contradictory: bool = False


@dataclass(frozen=True)
class Change:
    """Size and significance of a small motion.

    Attributes:
        shift_mm: by how much a point of interest moved.
        turn_arcmin: by how much it turned.
        sigmas: how far it is from no motion, all six numbers together.
    """

    shift_mm: float
    turn_arcmin: float
    sigmas: float

    @classmethod
    def of_motion(cls, motion: FloatArray, covariance: FloatArray, point: FloatArray) -> "Change":
        """Of a small motion (6,) with its covariance (6, 6), at a point (3,)."""
        shift = transforms.apply(small_motion(motion), point) - point
        return cls(
            1e3 * float(np.linalg.norm(shift)),
            float(np.linalg.norm(motion[:3])) / ARCMIN,
            float(np.sqrt(motion @ np.linalg.solve(covariance, motion))),
        )

    @property
    def is_significant(self) -> bool:
        """Whether the motion exceeds noise and the negligible size."""
        large = self.shift_mm > NEGLIGIBLE_MM or self.turn_arcmin > NEGLIGIBLE_ARCMIN
        return large and self.sigmas > WARNED_SIGMAS

    @property
    def is_contradictory(self) -> bool:
        """Whether the motion makes a calibration wrong."""
        large = self.shift_mm > REFUSED_MM or self.turn_arcmin > REFUSED_ARCMIN
        return large and self.sigmas > REFUSED_SIGMAS

    def __str__(self) -> str:
        return f"{self.shift_mm:.3g} mm and {self.turn_arcmin:.2g}' ({self.sigmas:.0f} sigma)"

    def check(self, step: str, sentence: str, right: str) -> Check:
        """The check of a motion that should not be: `sentence` where it is significant, `right` where it is not."""
        turned = self.turn_arcmin / NEGLIGIBLE_ARCMIN > self.shift_mm / NEGLIGIBLE_MM
        value, limit = (self.turn_arcmin, NEGLIGIBLE_ARCMIN) if turned else (self.shift_mm, NEGLIGIBLE_MM)
        quantity = "turn, arcmin" if turned else "shift, mm"
        said = sentence if self.is_significant else right
        return Check(
            step,
            quantity,
            value,
            value / max(self.sigmas, 1e-9),
            limit,
            said,
            not self.is_significant,
            self.is_contradictory,
        )


def refuse_contradictions(checks: Iterable[Check]) -> None:
    """Refuse a station with a contradictory check.

    Raises:
        BadInputError: naming the step.
    """
    off = [check for check in checks if check.contradictory]
    if off:
        more = f" ({len(off) - 1} more checks contradict each other as well)" if len(off) > 1 else ""
        raise BadInputError(f"{off[0].step}: {off[0].sentence}{more}.")

"""The course of a movement from rest to rest."""

from typing import TypeVar

from wlr_render.numerics.arrays import FloatArray

Number = TypeVar("Number", float, FloatArray)


def minimum_jerk(progress: Number) -> Number:
    """Share of the time 0..1 -> share of the way 0..1, at rest and without acceleration at both ends.

    Flash & Hogan (1985): the course with the least integral of the squared jerk.
    """
    return progress**3 * (10 - 15 * progress + 6 * progress * progress)

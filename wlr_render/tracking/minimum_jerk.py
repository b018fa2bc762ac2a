"""Minimum-jerk movement from rest to rest."""

from typing import TypeVar

from wlr_render.numerics.arrays import FloatArray

Number = TypeVar("Number", float, FloatArray)


def minimum_jerk(progress: Number) -> Number:
    """Return the fraction of the distance (0..1) at a fraction of the time (0..1).

    Velocity and acceleration are zero at the ends, and the integral of the squared jerk is least (Flash & Hogan 1985).
    """
    return progress**3 * (10 - 15 * progress + 6 * progress * progress)

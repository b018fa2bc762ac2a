"""Smooth errors of a simulated stage: pitch, yaw, roll and departures from a straight line along each axis."""

from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import legvander

from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.photographs.imperfections import BenchImperfections

_DEGREES = np.arange(1, 4)
_TURN_PARTS = np.array([1.0, 0.5, 0.25])  # weights of linear, quadratic and cubic term in the rms turn
_BEND_PARTS = np.array([0.0, 1.0, 0.5])  # weights in the rms bend; a linear term would be a skew axis


@dataclass(frozen=True, eq=False)
class StageErrors:
    """Cubic error curves of each stage axis, device frame; zero at reading zero.

    Attributes:
        half_travel_m: (3,) half the travel of each axis.
        turn_rad: (3, 3, 3) coefficients by rotation axis, stage axis and degree of the Legendre polynomial.
        bend_m: (3, 3, 3) coefficients of the displacement by direction, stage axis and degree.
        arm_m: (3,) lever arm from the carriage's centre of rotation to the pupil.
    """

    half_travel_m: FloatArray
    turn_rad: FloatArray
    bend_m: FloatArray
    arm_m: FloatArray

    @classmethod
    def draw(cls, sizes: BenchImperfections, half_travel_m: FloatArray, rng: np.random.Generator) -> "StageErrors":
        """Draw curves with random signs and the rms sizes `turn_urad` and `straightness_um`."""
        signs = rng.choice([-1.0, 1.0], (2, 3, 3, 3))
        return cls(
            half_travel_m,
            1e-6 * sizes.turn_urad * signs[0] * _of_unit_rms(_TURN_PARTS),
            1e-6 * sizes.straightness_um * signs[1] * _of_unit_rms(_BEND_PARTS),
            1e-3 * sizes.arm_mm * np.array([0.1, 0.9, 0.4]) / np.linalg.norm([0.1, 0.9, 0.4]),
        )

    def motion(self, position: FloatArray) -> FloatArray:
        """Return the error (6,), rotation vector (rad) then displacement of the pupil (m), at a stage position (3,)."""
        terms = legvander(position / self.half_travel_m, 3)[:, 1:] - legvander(np.zeros(3), 3)[:, 1:]
        turn = np.einsum("rad,ad->r", self.turn_rad, terms)
        return np.concatenate([turn, np.einsum("rad,ad->r", self.bend_m, terms) + np.cross(turn, self.arm_m)])


def _of_unit_rms(parts: FloatArray) -> FloatArray:
    """Return Legendre coefficients, in ratios `parts`, of a curve with standard deviation 1 over -1..1."""
    return np.asarray(parts / np.linalg.norm(parts) * np.sqrt(2.0 * _DEGREES + 1.0))

"""Sine waves in one of several variables."""

from dataclasses import dataclass

import numpy as np

from wlr_render.numerics.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class Wave:
    """A vector-valued function that is a sine wave in one variable and does not depend on the others.

    Attributes:
        axis: number of the variable.
        period: of the wave, in the variable's unit.
        coefficients: (2, outputs) of the sine and of the cosine of 2 pi x / period.
    """

    axis: int
    period: float
    coefficients: FloatArray

    def __call__(self, inputs: FloatArray) -> FloatArray:
        """Return the values (n, outputs) at inputs (n, variables)."""
        return self.with_jacobian(inputs)[0]

    def with_jacobian(self, inputs: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the values (n, outputs) and their derivatives (n, outputs, variables)."""
        per_unit = 2.0 * np.pi / self.period
        sine, cosine = np.sin(per_unit * inputs[:, self.axis]), np.cos(per_unit * inputs[:, self.axis])
        jacobian = np.zeros((len(inputs), self.coefficients.shape[1], inputs.shape[1]))
        jacobian[:, :, self.axis] = per_unit * np.stack([cosine, -sine], axis=1) @ self.coefficients
        return np.stack([sine, cosine], axis=1) @ self.coefficients, jacobian

"""Regressors without analytic derivatives, in place of a model's polynomial: tables, kernels and networks."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.polynomial import Box, Polynomial

_STEP = 1e-5  # step of the finite differences, relative to the box
_CHUNK = 4_096  # number of inputs per block: kernels hold a number for each pair of input and centre


@dataclass(frozen=True, eq=False)
class NumericRegressor:
    """Any function, with derivatives by central differences.

    Attributes:
        function: function of inputs (m, variables) that returns outputs (m, outputs).
        box: box of the inputs.
        outputs: number of outputs.
        numbers: count of the numbers to be stored in a file.
        rounding: rounding error of values of about 1; no solve has a smaller tolerance.
    """

    function: Callable[[FloatArray], FloatArray]
    box: Box
    outputs: int
    numbers: int
    rounding: float = 1e-12

    def __call__(self, inputs: FloatArray) -> FloatArray:
        """Return the values (..., outputs) at inputs (..., variables)."""
        flat = inputs.reshape(-1, inputs.shape[-1])
        starts = range(0, max(len(flat), 1), _CHUNK)
        values = np.concatenate([self.function(flat[start : start + _CHUNK]) for start in starts])
        return values.reshape(*inputs.shape[:-1], self.outputs)

    def with_jacobian(self, inputs: FloatArray, axes: Sequence[int] | None = None) -> tuple[FloatArray, FloatArray]:
        """Return the values (..., outputs) and Jacobian (..., outputs, axes) in the inputs' units."""
        by = range(inputs.shape[-1]) if axes is None else axes
        steps = _STEP * (self.box.high - self.box.low)
        slopes = []
        for axis in by:
            step = np.zeros(inputs.shape[-1])
            step[axis] = steps[axis]
            slopes.append((self(inputs + step) - self(inputs - step)) / (2.0 * steps[axis]))
        return self(inputs), np.stack(slopes, axis=-1)

    def held(self, axes: Sequence[int], inputs: FloatArray) -> "_HeldNumeric":
        """Hold the variables `axes` fixed at values (n, axes)."""
        return _HeldNumeric(self, tuple(axes), inputs)


Regressor = Polynomial | NumericRegressor


@dataclass(frozen=True, eq=False)
class _HeldNumeric:
    whole: NumericRegressor
    axes: tuple[int, ...]
    rows: FloatArray

    def _joined(self, inputs: FloatArray, index: IntArray | None) -> tuple[FloatArray, list[int]]:
        variables = len(self.whole.box.low)
        free = [axis for axis in range(variables) if axis not in self.axes]
        joined = np.empty((len(inputs), variables))
        joined[:, list(self.axes)] = self.rows if index is None else self.rows[index]
        joined[:, free] = inputs
        return joined, free

    def __call__(self, inputs: FloatArray, index: IntArray | None = None) -> FloatArray:
        """Return the values; see `HeldPolynomial`."""
        return self.whole(self._joined(inputs, index)[0])

    def with_jacobian(self, inputs: FloatArray, index: IntArray | None = None) -> tuple[FloatArray, FloatArray]:
        """Return values and Jacobian; see `HeldPolynomial`."""
        joined, free = self._joined(inputs, index)
        return self.whole.with_jacobian(joined, free)

"""Interface of the functions that models are made of: polynomials and other regressors."""

from collections.abc import Sequence
from typing import Protocol

from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.polynomial import Box


class HeldRegressor(Protocol):
    """A function some of whose variables are held, row by row."""

    def __call__(self, inputs: FloatArray, index: IntArray | None = None) -> FloatArray:
        """Values (m, outputs) at the free variables (m, axes ascending) of the held rows `index`; None for all."""

    def with_jacobian(self, inputs: FloatArray, index: IntArray | None = None) -> tuple[FloatArray, FloatArray]:
        """Return the values (m, outputs) and Jacobian (m, outputs, free variables)."""


class Regressor(Protocol):
    """A fitted function of several variables with several outputs: e.g. a `Polynomial`."""

    @property
    def box(self) -> Box:
        """Box of the inputs that it was fitted to."""

    @property
    def outputs(self) -> int:
        """Number of outputs."""

    @property
    def numbers(self) -> int:
        """Number of numbers that a file stores."""

    @property
    def rounding(self) -> float:
        """Rounding error of the values: tolerances of solves are not smaller."""

    def __call__(self, inputs: FloatArray) -> FloatArray:
        """Return the values (..., outputs) at inputs (..., variables)."""

    def with_jacobian(self, inputs: FloatArray, axes: Sequence[int] | None = None) -> tuple[FloatArray, FloatArray]:
        """Return the values (..., outputs) and Jacobian (..., outputs, axes)."""

    def held(self, axes: Sequence[int], inputs: FloatArray) -> HeldRegressor:
        """Hold the variables `axes` at (n, axes)."""

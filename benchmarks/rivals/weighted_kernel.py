"""Covariance of weighted readings, for the Gaussian process of scikit-learn."""

from typing import Any

import numpy as np
from sklearn.gaussian_process.kernels import RBF

from wlr_render.numerics.arrays import FloatArray


class WeightedKernel(RBF):  # type: ignore[misc]  # scikit-learn has no types
    """A Gaussian kernel of the inputs times the products of the multipliers, which are the last `blocks` columns.

    A reading is the sum over blocks of its multiplier times a function of the inputs; all functions have the same
    length scales.
    """

    def __init__(
        self, length_scale: Any = 1.0, length_scale_bounds: tuple[float, float] = (1e-5, 1e5), blocks: int = 1
    ) -> None:
        super().__init__(length_scale, length_scale_bounds)
        self.blocks = blocks

    def __call__(self, X: FloatArray, Y: FloatArray | None = None, eval_gradient: bool = False) -> Any:
        """Return the covariance (n, m), on request with its gradient (n, m, lengths) by logarithms of length scales."""
        first, second = np.hsplit(X, [-self.blocks]), None if Y is None else np.hsplit(Y, [-self.blocks])
        gain = first[1] @ (first if second is None else second)[1].T
        value = super().__call__(first[0], None if second is None else second[0], eval_gradient)
        return (value[0] * gain, value[1] * gain[..., None]) if eval_gradient else value * gain

    def diag(self, X: FloatArray) -> FloatArray:
        """Return the variances (n,)."""
        return np.asarray(np.sum(X[:, -self.blocks :] ** 2, axis=1))

    def is_stationary(self) -> bool:
        """Return False: the covariance does not depend on differences alone."""
        return False

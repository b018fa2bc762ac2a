"""Posterior covariance of a fitted polynomial's coefficients, as low-rank factors.

    coefficient (term, block b, axis k) = mean + apart[term, b] . a_k + joint[term, b, k] . j

a_k and j are independent and standard normal. What noise leaves unknown is the same for both axes, so that `apart`
serves both; what captures share, such as the camera's motions, couples them and is in `joint`. The first `shared` of j
are the same variables in the display and the see-through model of an eye.
"""

from dataclasses import dataclass

import numpy as np

from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import Polynomial

_CHUNK = 1_024  # inputs whose factors are held at once


@dataclass(frozen=True)
class Covariance:
    """Covariance of a polynomial's values.

    Attributes:
        outputs: of the polynomial: block 0 along x and y, then block 1.
        apart: inputs -> (blocks * rank); no outputs where nothing is apart.
        joint: inputs -> (outputs * rank).
        shared: how many of the joint variables the eye's other model shares: the first ones.
    """

    outputs: int
    apart: Polynomial
    joint: Polynomial
    shared: int = 0

    def covariance(self, inputs: FloatArray) -> FloatArray:
        """Covariance (n, outputs, outputs) of the values at inputs (n, variables), in their units squared."""
        blocks = [self._block(inputs[first : first + _CHUNK]) for first in range(0, max(len(inputs), 1), _CHUNK)]
        return np.concatenate(blocks)

    def _block(self, inputs: FloatArray) -> FloatArray:
        joint = self.joint(inputs).reshape(len(inputs), self.outputs, -1)
        covariance = joint @ joint.transpose(0, 2, 1)
        if self.apart.coefficients.shape[1]:
            apart = self.apart(inputs).reshape(len(inputs), self.outputs // 2, -1)
            between = apart @ apart.transpose(0, 2, 1)
            for axis in (0, 1):
                covariance[:, axis::2, axis::2] += between
        return np.asarray(covariance)

    def shared_deviation(self, inputs: FloatArray) -> FloatArray:
        """Values' change (n, outputs, shared) by each shared variable, at inputs (n, variables)."""
        return self.joint(inputs).reshape(len(inputs), self.outputs, -1)[..., : self.shared]

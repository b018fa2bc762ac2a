"""Posterior covariance of a fitted polynomial's coefficients, as low-rank factors.

    coefficient (term, block b, axis k) = mean + apart[term, b] . a_k + joint[term, b, k] . j

a_k and j are independent and standard normal. The uncertainty that noise causes is the same for both axes, so that
`apart` serves both; errors that captures share, such as the camera's motions, couple the axes and are in `joint`. The
first variables of j, one for each of `sources`, are common to the display and see-through models of an eye.
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
        outputs: number of outputs of the polynomial: block 0 along x and y, then block 1.
        apart: inputs -> (blocks * rank) factors of the independent part of both axes; empty without one.
        joint: inputs -> (outputs * rank) factors that couple the axes.
        sources: source of error, e.g. "prescription", of each joint variable that the display and the see-through model
            of an eye have in common; it may change only one of them. These variables come first.
    """

    outputs: int
    apart: Polynomial
    joint: Polynomial
    sources: tuple[str, ...] = ()

    @property
    def shared(self) -> int:
        """Number of joint variables that the eye's other model shares."""
        return len(self.sources)

    def covariance(self, inputs: FloatArray) -> FloatArray:
        """Return covariance (n, outputs, outputs) of the values at inputs (n, variables), in their units squared."""
        unshared, shared = self.unshared_and_shared(inputs)
        return unshared + shared @ shared.transpose(0, 2, 1) if self.sources else unshared

    def unshared_and_shared(self, inputs: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Split the covariance at inputs (n, variables) into the part of this model alone and the shared part.

        Returns:
            Covariance (n, outputs, outputs) without the shared variables, and the values' change
            (n, outputs, shared) by each shared variable.
        """
        blocks = [self._block(inputs[first : first + _CHUNK]) for first in range(0, max(len(inputs), 1), _CHUNK)]
        unshared, shared = (np.concatenate(each) for each in zip(*blocks, strict=True))
        return unshared, shared

    def _factors(self, inputs: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return derivatives (n, blocks, rank) by factors independent for x and y, (n, outputs, rank) by joint ones."""
        count, blocks = len(inputs), self.outputs // 2
        apart = np.zeros((count, blocks, 0))
        if self.apart.outputs:
            apart = self.apart(inputs).reshape(count, blocks, self.apart.outputs // blocks)
        return apart, self.joint(inputs).reshape(count, self.outputs, self.joint.outputs // self.outputs)

    def _block(self, inputs: FloatArray) -> tuple[FloatArray, FloatArray]:
        apart, joint = self._factors(inputs)
        shared, joint = joint[..., : self.shared], joint[..., self.shared :]
        covariance = joint @ joint.transpose(0, 2, 1)
        if apart.shape[2]:
            between = apart @ apart.transpose(0, 2, 1)
            for axis in (0, 1):
                covariance[:, axis::2, axis::2] += between
        return covariance, shared

    def changes(self, inputs: FloatArray) -> FloatArray:
        """Return the derivatives (n, outputs, k) of the values at inputs (n, variables) by each independent variable.

        Shared variables come first. The covariance between the values at two inputs is the sum of the products.
        """
        apart, joint = self._factors(inputs)
        by_axis = np.zeros((*apart.shape[:2], 2, 2, apart.shape[2]))
        by_axis[:, :, [0, 1], [0, 1]] = apart[:, :, None]
        return np.concatenate([joint, by_axis.reshape(len(inputs), self.outputs, 2 * apart.shape[2])], axis=-1)

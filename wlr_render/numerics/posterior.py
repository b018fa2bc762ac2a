"""Posterior of the unknowns of a fit by evidence; the large arrays are made when they are first asked for."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from wlr_render.numerics.arrays import BoolArray, FloatArray


@dataclass(frozen=True)
class Posterior:
    """Posterior of the unknowns at given hyperparameters.

    Attributes:
        hyper: hyperparameters by name, logarithms.
        log_evidence: natural logarithm of the probability density of the readings.
        slope: (hyperparameters,) gradient of `log_evidence`.
        mean: (outputs, columns) of x.
        mixed_mean: (mixed,) of z. group_mean: (groups, grouped) of b.
        determined: effective number of unknowns that the readings determine (MacKay's gamma).
        square: weighted sum of squared residuals.
        sizes: (side + columns,) prior sizes of z and b, then of an output's x.
        features: (side + columns, hyperparameters) derivatives of the logarithms of `sizes`.
        count: number of readings.
        used, side_used: which of an output's x, and of z and b, the readings inform.
        inverse, side_inverse: covariance of the used ones in units of their prior sizes; of x if z and b were known.
        follow: (outputs, side, columns) negative derivative of x by the side unknowns, of the used ones in these units.
    """

    hyper: Mapping[str, float]
    log_evidence: float
    slope: FloatArray
    mean: FloatArray
    mixed_mean: FloatArray
    group_mean: FloatArray
    determined: float
    square: float
    sizes: FloatArray
    features: FloatArray
    count: int
    used: BoolArray
    side_used: BoolArray
    inverse: FloatArray
    side_inverse: FloatArray
    follow: FloatArray

    @property
    def noise(self) -> float:
        """Factor by which the stated sigmas must be multiplied."""
        return float(np.exp(self.hyper["noise"]))

    @cached_property
    def side_covariance(self) -> FloatArray:
        """(side, side) covariance of z and b."""
        return _in_place(self.side_inverse, self.sizes[: len(self.side_used)], self.side_used)

    @cached_property
    def alone(self) -> FloatArray:
        """(columns, columns) covariance of x of each output if the side unknowns were known."""
        return _in_place(self.inverse, self.sizes[len(self.side_used) :], self.used)

    @cached_property
    def by_side(self) -> FloatArray:
        """(outputs, side, columns) derivative of x by the side unknowns."""
        side_scale, scale = np.split(self.sizes, [len(self.side_used)])
        by_side = np.zeros((len(self.follow), len(side_scale), len(scale)))
        every = np.ones(len(self.follow), bool)
        follow = -self.follow * scale[self.used] / side_scale[self.side_used][:, None]
        by_side[np.ix_(every, self.side_used, self.used)] = follow
        return by_side

    @cached_property
    def covariance(self) -> FloatArray:
        """(side + outputs * columns, ...) covariance of z and b, then of x of output 0, output 1 and so on."""
        outputs, side, columns = self.by_side.shape
        follow = self.by_side.transpose(0, 2, 1).reshape(outputs * columns, side)
        whole = follow @ self.side_covariance @ follow.T
        for output in range(outputs):
            block = slice(output * columns, (output + 1) * columns)
            whole[block, block] += self.alone
        cross = follow @ self.side_covariance
        return np.block([[self.side_covariance, cross.T], [cross, whole]])

    @cached_property
    def curvature(self) -> FloatArray:
        """Expected negative second derivatives of `log_evidence` at these hyperparameters, (hyperparameters,).

        This is the diagonal of the Fisher information: trace((C^-1 dC)^2) / 2, where C is the covariance of the
        readings.
        """
        outputs, side, columns = self.by_side.shape
        every = np.concatenate([np.arange(side), np.tile(np.arange(side, side + columns), outputs)])
        sizes, features = self.sizes[every], self.features[every]
        left = self.covariance / sizes / sizes[:, None]  # 1 for unknowns that the readings do not inform
        learned = (np.eye(len(left)) - left) ** 2
        curvature = 2.0 * np.sum(features * (learned @ features), axis=0)
        curvature[list(self.hyper).index("noise")] += 2.0 * (self.count - len(left) + np.sum(left**2))
        return np.asarray(curvature)


def _in_place(inverse: FloatArray, scale: FloatArray, used: BoolArray) -> FloatArray:
    """Return the covariance of all unknowns from the covariance of the used ones in units of their prior sizes."""
    covariance = np.diag(scale**2)
    covariance[np.ix_(used, used)] = scale[used][:, None] * inverse * scale[used]
    return covariance

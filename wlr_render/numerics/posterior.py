"""Posterior of the unknowns of a fit by evidence; the large arrays are computed on first use."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from wlr_render.numerics.arrays import BoolArray, FloatArray


@dataclass(frozen=True)
class Posterior:
    """Posterior of the unknowns at given hyperparameters.

    Attributes:
        hyper: hyperparameters by name, logarithms.
        log_evidence: natural logarithm of the probability density of the readings.
        mean: (outputs, columns) mean of x.
        mixed_mean: (mixed,) mean of z.
        group_mean: (groups, grouped) mean of b.
        square: weighted sum of squared residuals.
        sizes: (side + columns,) prior sizes of z and b, then of an output's x.
        features: (side + columns, hyperparameters) derivatives of the logarithms of `sizes`.
        count: number of readings.
        used, side_used: masks of an output's x, and of z and b, on which the readings have information.
        unit: mean of the used unknowns in units of their prior sizes: of z and b, then of x, output by output.
        lower: Cholesky factor of the normal matrix, in these units, of an output's used x for known z and b.
        side_lower: Cholesky factor of the normal matrix of the used z and b, with x integrated out.
        half_cross: (outputs, columns, side) `lower` times the negative derivative of x by z and b.
    """

    hyper: Mapping[str, float]
    log_evidence: float
    mean: FloatArray
    mixed_mean: FloatArray
    group_mean: FloatArray
    square: float
    sizes: FloatArray
    features: FloatArray
    count: int
    used: BoolArray
    side_used: BoolArray
    unit: FloatArray
    lower: FloatArray
    side_lower: FloatArray
    half_cross: FloatArray

    @property
    def noise(self) -> float:
        """Factor by which to multiply the stated sigmas."""
        return float(np.exp(self.hyper["noise"]))

    @cached_property
    def side_covariance(self) -> FloatArray:
        """(side, side) covariance of z and b."""
        return _in_place(self._side_inverse, self.sizes[: len(self.side_used)], self.side_used)

    @cached_property
    def alone(self) -> FloatArray:
        """(columns, columns) covariance of each output's x for known side unknowns."""
        return _in_place(self._inverse, self.sizes[len(self.side_used) :], self.used)

    def root_of(self, design: FloatArray) -> FloatArray:
        """Return F (n, k): F F' is the covariance of design (n, columns) @ x of an output for known z and b.

        Unknowns without information from the readings are left out.
        """
        width = self.sizes[len(self.side_used) :][self.used]
        return solved(self.lower, (design[:, self.used] * width).T).T

    @cached_property
    def by_side(self) -> FloatArray:
        """(outputs, side, columns) derivative of x by the side unknowns."""
        side_scale, scale = np.split(self.sizes, [len(self.side_used)])
        by_side = np.zeros((len(self.half_cross), len(side_scale), len(scale)))
        every = np.ones(len(by_side), bool)
        follow = -self._follow.transpose(0, 2, 1) * scale[self.used] / side_scale[self.side_used][:, None]
        by_side[np.ix_(every, self.side_used, self.used)] = follow
        return by_side

    @cached_property
    def determined(self) -> float:
        """Effective number of unknowns that the readings determine (MacKay's gamma)."""
        return len(self.unit) - float(self._variance.sum())

    @cached_property
    def slope(self) -> FloatArray:
        """(hyperparameters,) gradient of `log_evidence`."""
        slope = (self.unit**2 + self._variance - 1.0) @ self._features
        slope[self._noise] += self.square / self.noise**2 + self.determined - self.count
        return np.asarray(slope)

    @cached_property
    def second_slope(self) -> FloatArray:
        """(hyperparameters, hyperparameters) second derivatives of `log_evidence`."""
        unit, variance, features, left = self.unit, self._variance, self._features, self._unit_covariance
        squared = left**2
        pulled = left @ (unit[:, None] * np.column_stack([features, np.ones(len(unit))]))
        change = 2.0 * unit[:, None] * pulled[:, :-1] - (unit**2 + variance)[:, None] * features + squared @ features
        second = 2.0 * features.T @ change
        rest = variance - squared.sum(axis=0)
        by_noise = 2.0 * features.T @ (rest - 2.0 * unit * pulled[:, -1])
        second[self._noise] += by_noise
        second[:, self._noise] += by_noise
        of_noise = 2.0 * float(unit @ pulled[:, -1]) - self.square / self.noise**2 - float(rest.sum())
        second[self._noise, self._noise] += 2.0 * of_noise
        return np.asarray(second)

    @cached_property
    def curvature(self) -> FloatArray:
        """Expected negative second derivatives of `log_evidence` at these hyperparameters, (hyperparameters,).

        This is the diagonal of the Fisher information: trace((C^-1 dC)^2) / 2, where C is the covariance of the
        readings.
        """
        left, features = self._unit_covariance, self._features
        learned = (np.eye(len(left)) - left) ** 2
        curvature = 2.0 * np.sum(features * (learned @ features), axis=0)
        curvature[self._noise] += 2.0 * (self.count - len(left) + np.sum(left**2))
        return np.asarray(curvature)

    @property
    def _noise(self) -> int:
        return list(self.hyper).index("noise")

    @cached_property
    def _features(self) -> FloatArray:
        """(unknowns, hyperparameters) features of the used unknowns, in the order of `unit`."""
        side, columns = np.split(self.features, [len(self.side_used)])
        return np.concatenate([side[self.side_used], np.tile(columns[self.used], (len(self.half_cross), 1))])

    @cached_property
    def _inverse(self) -> FloatArray:
        return _inverse(self.lower)

    @cached_property
    def _side_inverse(self) -> FloatArray:
        return _inverse(self.side_lower)

    @cached_property
    def _follow(self) -> FloatArray:
        """(outputs, columns, side) negative derivative of x by the side unknowns, for used unknowns in prior units."""
        return np.stack([solved(self.lower, each, transposed=True) for each in self.half_cross])

    @cached_property
    def _by_half_side(self) -> FloatArray:
        """(outputs, columns, side): a square root of the covariance that z and b add to x."""
        return np.stack([solved(self.side_lower, each.T).T for each in self._follow])

    @cached_property
    def _variance(self) -> FloatArray:
        """(unknowns,) variances of the used unknowns in prior units."""
        of_x = np.diag(self._inverse) + np.sum(self._by_half_side**2, axis=2)
        return np.concatenate([np.diag(self._side_inverse), of_x.ravel()])

    @cached_property
    def _unit_covariance(self) -> FloatArray:
        """(unknowns, unknowns) covariance of the used unknowns in prior units."""
        outputs, columns, side = self.half_cross.shape
        half = self._by_half_side.reshape(outputs * columns, side)
        whole = np.empty((side + len(half), side + len(half)))
        whole[:side, :side] = self._side_inverse
        whole[side:, side:] = half @ half.T
        for output in range(outputs):
            block = slice(side + output * columns, side + (output + 1) * columns)
            whole[block, block] += self._inverse
        whole[:side, side:] = -solved(self.side_lower, half.T, transposed=True)
        whole[side:, :side] = whole[:side, side:].T
        return whole


def solved(lower: FloatArray, columns: FloatArray, transposed: bool = False) -> FloatArray:
    """Return L^-1 columns, or L'^-1 columns, of a lower triangular matrix L."""
    if columns.size == 0:
        return np.zeros_like(columns)
    solution, _ = scipy.linalg.lapack.dtrtrs(lower, columns, lower=1, trans=int(transposed))
    return np.asarray(solution)


def _inverse(lower: FloatArray) -> FloatArray:
    """Return the inverse of the matrix with this Cholesky factor."""
    if len(lower) == 0:
        return lower
    half, _ = scipy.linalg.lapack.dpotri(lower, lower=1)
    return np.asarray(half + np.tril(half, -1).T)


def _in_place(inverse: FloatArray, scale: FloatArray, used: BoolArray) -> FloatArray:
    """Return the covariance of all unknowns from the covariance of the used ones in units of their prior sizes."""
    covariance = np.diag(scale**2)
    covariance[np.ix_(used, used)] = scale[used][:, None] * inverse * scale[used]
    return covariance

"""Scatter of captures: a small random motion of the camera in each capture, with a size estimated from the readings.

    y = J c + E_g b_g + e,   c ~ N(mean, 1),   b_g ~ N(0, D^2),   e ~ N(0, noise^2)

y are white residuals of all captures, c the causes' values in prior sigmas, b_g the motion of the camera of capture g.
The sizes of motions and noise in each part of the session maximise the evidence times a prior for usual sizes. A
capture that moved by far more than the others gets a separate wide prior, at a cost in evidence.

Sources: MacKay, "Bayesian interpolation", Neural Computation 4 (1992), 415; Pinheiro and Bates, "Mixed-Effects Models
in S and S-PLUS" (2000), chapter 2.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np

from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray, rows_by_label
from wlr_render.usual import SESSION_REPEATABILITY_M, SESSION_TURN_RAD

LOG10_ODDS = float(0.5 / np.log(10.0))
"""Log10 odds for each unit of -2 log evidence."""
USUAL_SHIFT, USUAL_TURN = SESSION_REPEATABILITY_M.micro, SESSION_TURN_RAD.micro
"""Usual repeatability of a stage, micrometres, and random turns of its carriage, microradians."""
UNUSUAL_SHIFT, UNUSUAL_TURN = 200.0, 600.0
"""Limits of the repeatability of stages: 25 usual sizes, 2.7 standard deviations of their logarithms."""
_USUAL_RANGE = SESSION_REPEATABILITY_M.log_sigma  # standard deviation of the logarithms of usual sizes
MOVED = np.array([1000.0] * 3 + [8000.0] * 3)  # standard deviations of a moved capture's motion, in units of motions
_COST_OF_MOVING = float(np.log(0.97 / 0.03))  # prior log odds against a moved capture: three in a hundred move
PARTS = 3
"""Parts of a session, each with its own sizes: captures of the panel, of a target, and of both at run time."""


@dataclass(frozen=True, eq=False)
class Scatter:
    """Sizes of noise and of the captures' motions.

    Attributes:
        noise: (3,) ratio of each part's noise to the noise within its photographs.
        shift_um, turn_urad: (3,) standard deviations of a capture's motion in each part, per axis.
        moved: (captures,) mask of captures that moved far more than the others.
    """

    noise: FloatArray
    shift_um: FloatArray
    turn_urad: FloatArray
    moved: BoolArray

    @classmethod
    def usual(cls, captures: int) -> "Scatter":
        """Return start sizes for a search: half the usual ones, without moved captures."""
        ones = np.ones(PARTS)
        return cls(ones, 0.5 * USUAL_SHIFT * ones, 0.5 * USUAL_TURN * ones, np.zeros(captures, dtype=bool))

    def vector(self) -> FloatArray:
        """Return the logarithms of all sizes (9,)."""
        return np.asarray(np.log(np.concatenate([self.noise, self.shift_um, self.turn_urad])))

    def at(self, vector: FloatArray) -> "Scatter":
        """Return the scatter with other sizes."""
        noise, shift, turn = np.exp(vector).reshape(3, PARTS)
        return replace(self, noise=noise, shift_um=shift, turn_urad=turn)

    def at_rest(self) -> "Scatter":
        """Return the scatter without moved captures."""
        return replace(self, moved=np.zeros_like(self.moved))

    def with_other(self, number: int) -> "Scatter":
        """Return the scatter with the `moved` flag of one capture inverted."""
        return replace(self, moved=self.moved ^ (np.arange(len(self.moved)) == number))

    def is_ordinary(self, part: int, material_excess: float) -> bool:
        """Return whether a part shows no more than noise and the usual repeatability of stages."""
        usual = self.shift_um[part] <= UNUSUAL_SHIFT and self.turn_urad[part] <= UNUSUAL_TURN
        return bool(usual and self.noise[part] ** 2 <= 1.0 + material_excess)

    def sizes(self, part_of: IntArray) -> FloatArray:
        """Return the standard deviations (g, 6) of the motions of captures of parts `part_of` (g,), over the noise."""
        usual = np.repeat(np.stack([self.shift_um, self.turn_urad], axis=1), 3, axis=1)[part_of]
        sizes = np.where(self.moved[:, None], np.hypot(usual, MOVED), usual)
        return np.asarray(sizes / self.noise[part_of][:, None])


@dataclass(frozen=True, eq=False)
class ScatterSums:
    """Sums over the readings of each capture g, and of each part, from which the evidence follows.

    Attributes:
        part_of: (g,) part of each capture.
        used: (g,) whether the capture has readings.
        count, square: (parts,) number of values y, and their sum of squares.
        ee, ey, ex: (g, 6, 6), (g, 6) and (g, 6, m) products of motions E with themselves, with y and with columns J.
        xx, xy: (parts, m, m) and (parts, m) products of columns with themselves and with y.
        y, columns, part: white readings (n, 2), their columns (n, 2, m), and the part (n,) of each reading.
        mean, sigma: (m,) normal priors of the columns' coefficients.
        carried: number of columns at the end for located effects; their coefficients are integrated out like motions.
    """

    part_of: IntArray
    used: BoolArray
    count: FloatArray
    square: FloatArray
    ee: FloatArray
    ey: FloatArray
    ex: FloatArray
    xx: FloatArray
    xy: FloatArray
    y: FloatArray
    columns: FloatArray
    part: IntArray
    mean: FloatArray
    sigma: FloatArray
    carried: int = 0

    @classmethod
    def over(
        cls,
        y: FloatArray,
        motions: FloatArray,
        columns: FloatArray,
        group: IntArray,
        part: IntArray,
        captures: int,
        mean: FloatArray | float = 0.0,
        sigma: FloatArray | float = 1.0,
    ) -> "ScatterSums":
        """Return the sums over white readings.

        Args:
            y: (n, 2) readings.
            motions: (n, 2, 6) change of the readings by a micrometre or microradian of motion.
            columns: (n, 2, m) columns.
            group, part: (n,) group and part of each reading.
            captures: number of groups.
            mean, sigma: as in the class, one value or one for each column.
        """
        m = columns.shape[-1]
        part_of, used = np.zeros(captures, dtype=np.int64), np.zeros(captures, dtype=bool)
        ee, ey, ex = np.zeros((captures, 6, 6)), np.zeros((captures, 6)), np.zeros((captures, 6, m))
        count, square = np.zeros(PARTS), np.zeros(PARTS)
        xx, xy = np.zeros((PARTS, m, m)), np.zeros((PARTS, m))
        for name, rows in zip(*rows_by_label(group), strict=True):
            mine, e, x = y[rows].ravel(), motions[rows].reshape(-1, 6), columns[rows].reshape(2 * len(rows), m)
            part_of[name], used[name], at = part[rows[0]], True, part[rows[0]]
            ee[name], ey[name], ex[name] = e.T @ e, e.T @ mine, e.T @ x
            count[at] += len(mine)
            square[at] += float(mine @ mine)
            xx[at] += x.T @ x
            xy[at] += x.T @ mine
        mean, sigma = (np.broadcast_to(each, m) for each in (mean, sigma))
        return cls(part_of, used, count, square, ee, ey, ex, xx, xy, y, columns, part, mean, sigma)

    def of_columns(self, which: IntArray, mean: FloatArray | None = None, sigma: FloatArray | None = None) -> Self:
        """Return the sums for some of the columns and the carried columns, with other priors if given."""
        last = len(self.mean) - self.carried
        whole = np.r_[which, last : len(self.mean)]
        mean, sigma = (
            np.r_[old[which] if new is None else new, old[last:]]
            for new, old in ((mean, self.mean), (sigma, self.sigma))
        )
        ex, xx, xy = self.ex[:, :, whole], self.xx[:, whole][:, :, whole], self.xy[:, whole]
        columns = self.columns[:, :, whole]
        return replace(self, ex=ex, xx=xx, xy=xy, columns=columns, mean=mean, sigma=sigma)

    def joined(self, more: "ScatterSums") -> "ScatterSums":
        """Return the sums for these columns followed by the columns and y of `more`, over the same readings."""
        m, q = len(self.mean), len(more.mean)
        xx, xy = np.zeros((PARTS, m + q, m + q)), np.zeros((PARTS, m + q))
        xx[:, :m, :m], xx[:, m:, m:], xy[:, m:] = self.xx, more.xx, more.xy
        for each, rows in zip(*rows_by_label(self.part), strict=True):
            flat, x = self.columns[rows].reshape(2 * len(rows), m), more.columns[rows].reshape(2 * len(rows), q)
            xx[each, :m, m:] = flat.T @ x
            xx[each, m:, :m] = xx[each, :m, m:].T
            xy[each, :m] = flat.T @ more.y[rows].ravel()
        ex, columns = (np.concatenate(each, axis=2) for each in ((self.ex, more.ex), (self.columns, more.columns)))
        mean, sigma = np.r_[self.mean, more.mean], np.r_[self.sigma, more.sigma]
        return replace(more, ex=ex, xx=xx, xy=xy, columns=columns, mean=mean, sigma=sigma)


_NO_COLUMNS, _NO_VALUES = np.zeros(0, dtype=np.int64), np.zeros(0)


class Known(NamedTuple):
    """Columns that are integrated out.

    Attributes:
        columns: indices of the columns.
        sigma: standard deviations of their coefficients' priors.
        moved, by: other columns, and coefficients at which their effect is subtracted from the readings.
    """

    columns: IntArray
    sigma: FloatArray
    moved: IntArray = _NO_COLUMNS
    by: FloatArray = _NO_VALUES


@dataclass(frozen=True, eq=False)
class Marginal:
    """The readings with all motions integrated out: a quadratic form in the coefficients of columns.

    Attributes:
        minus_two_log: -2 log probability density of the readings at coefficients of zero, up to a constant.
        information, gradient: (m, m) and (m,) of the quadratic form.
        mean, sigma: (m,) normal priors of the coefficients.
    """

    minus_two_log: float
    information: FloatArray
    gradient: FloatArray
    mean: FloatArray
    sigma: FloatArray

    def of_columns(self, known: Known) -> "Marginal":
        """Return the quadratic form of the known columns alone, after the columns `moved` are moved."""
        columns, sigma, moved, by = known
        across = self.information[:, moved] @ by
        value = self.minus_two_log - 2.0 * float(by @ self.gradient[moved]) + float(by @ across[moved])
        information, gradient = self.information[np.ix_(columns, columns)], (self.gradient - across)[columns]
        return Marginal(value, information, gradient, self.mean[columns], sigma)

    def folded(self, known: Known, columns: IntArray) -> "Marginal":
        """Return the marginal likelihood of some columns with the known columns integrated out."""
        beside, some = (
            self.of_columns(known),
            self.of_columns(known._replace(columns=columns, sigma=self.sigma[columns])),
        )
        across = self.information[np.ix_(columns, known.columns)]
        pull = beside.gradient + beside.mean / beside.sigma**2
        solved = np.linalg.solve(beside.precision, np.column_stack([pull, across.T]))
        return replace(
            some,
            minus_two_log=beside.minus_two_log_evidence,
            information=some.information - across @ solved[:, 1:],
            gradient=some.gradient - across @ solved[:, 0],
        )

    @property
    def precision(self) -> FloatArray:
        """(m, m) inverse of `covariance`."""
        return np.asarray(self.information + np.diag(self.sigma**-2.0))

    @cached_property
    def covariance(self) -> FloatArray:
        """(m, m) covariance of the coefficients."""
        return np.asarray(np.linalg.inv(self.precision), np.float64)

    @property
    def values(self) -> FloatArray:
        """(m,) most probable coefficients."""
        return np.asarray(self.covariance @ (self.gradient + self.mean / self.sigma**2))

    @property
    def minus_two_log_evidence(self) -> float:
        """-2 log evidence of the readings, with the coefficients integrated out, too."""
        # Unknowns are distances from the mean in units of sigma.
        gradient = self.sigma * (self.gradient - self.information @ self.mean)
        normal = self.sigma[:, None] * self.information * self.sigma + np.eye(len(gradient))
        at_mean = self.minus_two_log - 2.0 * float(self.gradient @ self.mean)
        at_mean += float(self.mean @ self.information @ self.mean)
        _, determinant = np.linalg.slogdet(normal)
        return float(at_mean + determinant - gradient @ np.linalg.solve(normal, gradient))


def marginal(sums: ScatterSums, scatter: Scatter) -> Marginal:
    """Integrate out the motions and the carried effects."""
    every, count = without_motions(sums, scatter), len(sums.mean) - sums.carried
    return every.folded(Known(np.arange(count, len(sums.mean)), sums.sigma[count:]), np.arange(count))


def without_motions(sums: ScatterSums, scatter: Scatter) -> Marginal:
    """Integrate out the motions, for all columns."""
    variance = scatter.noise**2
    per = 1.0 / variance[sums.part_of]
    sizes = scatter.sizes(sums.part_of)
    normal = sizes[:, :, None] * sums.ee * sizes[:, None, :]
    normal[:, range(6), range(6)] += 1.0
    factor = np.linalg.cholesky(normal)
    sides = np.concatenate([sums.ey[:, :, None], sums.ex], axis=2) * sizes[:, :, None]
    half = np.linalg.solve(factor, sides)
    half_y, half_x = half[:, :, 0], half[:, :, 1:]
    determinant = 2.0 * float(np.sum(np.log(np.diagonal(factor, axis1=1, axis2=2))))
    present = sums.count > 0
    total = determinant + float(np.sum((sums.square / variance)[present])) - float(np.sum(per * np.sum(half_y**2, 1)))
    total += float(np.sum((sums.count * np.log(variance))[present]))
    weighted = half_x * per[:, None, None]
    flat = half_x.reshape(half_y.size, half_x.shape[2])
    information = np.einsum("pij,p->ij", sums.xx, 1.0 / variance) - weighted.reshape(flat.shape).T @ flat
    gradient = np.einsum("pi,p->i", sums.xy, 1.0 / variance) - weighted.reshape(flat.shape).T @ half_y.ravel()
    return Marginal(total, information, gradient, sums.mean, sums.sigma)


def costs_of_sizes(information: FloatArray, gradient: FloatArray, sizes: FloatArray) -> FloatArray:
    """Return the change of -2 log evidence for each size (s,) of coefficients that are integrated out.

    Args:
        information, gradient: (c, c) and (c,) as in `Marginal`.
        sizes: (s,) standard deviations of the coefficients.
    """
    values, axes = np.linalg.eigh(information)
    square = sizes[:, None] ** 2
    normal = 1.0 + square * values.clip(0.0)
    return np.asarray(np.sum(np.log(normal) - square * (gradient @ axes) ** 2 / normal, axis=1))


def surprise(scatter: Scatter, sums: ScatterSums) -> float:
    """Return -2 log prior probability of the sizes and of the moved captures, up to a constant."""
    parts = [part for part in range(PARTS) if np.any(sums.used & (sums.part_of == part))]
    off = [
        np.log(size[part] / usual) / _USUAL_RANGE
        for size, usual in ((scatter.shift_um, USUAL_SHIFT), (scatter.turn_urad, USUAL_TURN))
        for part in parts
    ]
    return float(np.sum(np.square(off))) + 2.0 * _COST_OF_MOVING * int(scatter.moved.sum())


def cost(sums: ScatterSums, scatter: Scatter) -> float:
    """Return -2 log evidence plus `surprise`: -2 log posterior of the sizes, up to a constant."""
    return without_motions(sums, scatter).minus_two_log_evidence + surprise(scatter, sums)


def cost_and_slopes(sums: ScatterSums, scatter: Scatter) -> tuple[float, FloatArray]:
    """Return `cost` and its derivatives (3, parts) by the logarithms of noise, shifts and turns.

    The derivative of -2 log N(y; 0, C) is tr(C^-1 C') - y' C^-1 C' C^-1 y.
    """
    every, variance = without_motions(sums, scatter), scatter.noise[sums.part_of] ** 2
    value = every.minus_two_log_evidence + surprise(scatter, sums)
    covariance, values = every.covariance, every.values
    sizes = scatter.sizes(sums.part_of)
    inverse = np.linalg.inv(sizes[:, :, None] * sums.ee * sizes[:, None, :] + np.eye(6))
    pull = sums.ey - sums.ex @ values
    rest = (inverse @ (sizes * pull)[:, :, None])[:, :, 0]
    response = inverse @ (sizes[:, :, None] * sums.ex)
    spread = response @ covariance
    explained = np.sum(spread * response, axis=2)
    by_axis = 2.0 * (1.0 - np.diagonal(inverse, axis1=1, axis2=2) - (explained + rest**2) / variance[:, None])
    # A moved capture has a wide prior of fixed size in addition to the usual one.
    by_axis = by_axis * (scatter.at_rest().sizes(sums.part_of) / sizes) ** 2 * sums.used[:, None]
    # Change of each capture's sum of squares by motions, and degrees of freedom that motions and columns absorb.
    motion, turned = sizes * rest, sizes[:, :, None] * response
    left = np.einsum("gi,gij,gj->g", motion, sums.ee, motion) - 2.0 * np.sum(motion * pull, axis=1)
    taken = 6.0 - np.trace(inverse, axis1=1, axis2=2)
    by_columns = (sums.ee @ turned - 2.0 * sums.ex) * (sizes[:, :, None] * spread)
    taken = taken + np.sum(by_columns, axis=(1, 2)) / variance
    slopes = np.zeros((3, PARTS))
    for part in np.unique(sums.part_of[sums.used]):
        mine, noise = sums.used & (sums.part_of == part), scatter.noise[part] ** 2
        square = sums.square[part] + values @ (sums.xx[part] @ values - 2.0 * sums.xy[part]) + np.sum(left[mine])
        free = sums.count[part] - np.sum(taken[mine]) - np.sum(sums.xx[part] * covariance) / noise
        slopes[0, part] = 2.0 * (free - square / noise)
        for row, axes, size, usual in (
            (1, slice(0, 3), scatter.shift_um, USUAL_SHIFT),
            (2, slice(3, 6), scatter.turn_urad, USUAL_TURN),
        ):
            surprising = 2.0 * np.log(size[part] / usual) / _USUAL_RANGE**2
            slopes[row, part] = np.sum(by_axis[mine, axes]) + surprising
    return value, slopes

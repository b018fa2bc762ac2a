"""Linear Gaussian models with variances estimated by maximum evidence, and the covariance of their unknowns.

    y = A x + C z + H_g b_g + e,    e ~ N(0, (noise sigma)^2)

The unknowns are the coefficients x, one set for each output of a reading, of a design that all outputs share; z, which
the outputs share; and b_g, which the readings of group g share, such as the motion of the camera in one capture. All
have normal priors about zero. sigma is the relative standard deviation of each reading. The logarithms of all prior
sizes are linear in a few hyperparameters h: log size = features @ h, and the noise is exp(h[noise]). The
hyperparameters maximise the evidence, the probability of the readings with all unknowns integrated out, by Newton's
method from several starts within bounds.

Only weighted sums of the readings are kept: memory grows with the unknowns, not with the readings.

Sources: MacKay, "Bayesian interpolation", Neural Computation 4 (1992), 415-447; Rasmussen and Williams, "Gaussian
Processes for Machine Learning" (2006), chapter 5; Bishop, "Pattern Recognition and Machine Learning" (2006), 3.5.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.posterior import Posterior, solved

_LOG_2PI = float(np.log(2.0 * np.pi))
_NEGLIGIBLE = 1e-7  # information of the readings on an unknown, relative to its prior, below which it is ignored
_ROUNDED_AWAY = 1e-3  # share of the expected sum of squares that exact readings may lose by rounding
_ROUGHLY, _ENOUGH = 0.05, 0.002  # gain in log evidence (nats) at which a search ends, and the last search
_LONGEST = 2.0  # longest step of a search along each principal axis of the evidence
_FLAT = 1e-3  # curvature below which the evidence does not determine the step length
_STEPS, _TRIALS = 60, 10  # most steps of a search, and most trials of each step, with shrinking length

Weights = FloatArray | Sequence[FloatArray]
"""(n,) one over the relative sigma of each reading, where zero leaves it out; or, for blocks of readings in turn, lower
triangular matrices (k, k) that make the noise that the readings of a block share independent and of size one."""


class Sums:
    """Weighted sums over readings of `outputs` values each.

    The side unknowns are z, then b of group 0, group 1 and so on.

    Attributes:
        count: number of values of nonzero weight.
        log_weight: sum of the logarithms of their weights.
        square: weighted sum of squares of the values.
        gram: (columns, columns) products of the design A with itself.
        moment: (outputs, columns) products of A and the values.
        side_gram, side_cross, side_moment: (side, side), (outputs, side, columns) and (side,) products of the side
            unknowns' columns with themselves, with A and with the values.
    """

    def __init__(self, columns: int, outputs: int, mixed: int = 0, groups: int = 0, grouped: int = 0) -> None:
        """Start with empty sums, before any reading.

        Args:
            columns: number of columns of A.
            outputs: number of values of a reading.
            mixed: number of unknowns z.
            groups, grouped: number of groups, and of unknowns b in each group.
        """
        self.mixed, self.groups, self.grouped = mixed, groups, grouped
        side = mixed + groups * grouped
        self.count, self.square, self.log_weight = 0, 0.0, 0.0
        self.gram, self.moment = np.zeros((columns, columns)), np.zeros((outputs, columns))
        self.side_gram, self.side_moment = np.zeros((side, side)), np.zeros(side)
        self.side_cross = np.zeros((outputs, side, columns))

    def add(self, value: FloatArray, weight: Weights, design: FloatArray) -> None:
        """Add n readings, without their side unknowns.

        Args:
            value: (n, outputs).
            weight: see `Weights`.
            design: (n, columns) A.
        """
        weighted_design, weighted_value = weight_values(weight, design), weight_values(weight, value)
        diagonal = weight if isinstance(weight, np.ndarray) else np.concatenate([np.diag(each) for each in weight])
        self.count += int(np.count_nonzero(diagonal)) * value.shape[1]
        self.log_weight += value.shape[1] * float(np.log(diagonal[diagonal > 0]).sum())
        self.square += float(np.sum(weighted_value**2))
        self.gram += weighted_design.T @ weighted_design
        self.moment += weighted_value.T @ weighted_design

    def add_side(
        self,
        value: FloatArray,
        weight: Weights,
        design: FloatArray,
        mixed: FloatArray | None = None,
        grouped: FloatArray | None = None,
        group: IntArray | None = None,
    ) -> None:
        """Add the side unknowns of n readings.

        Args:
            value, weight, design: as in `add`, which counts the readings.
            mixed: (n, outputs, mixed) C.
            grouped: (n, outputs, grouped) H.
            group: (n,) each reading's group, 0..groups - 1.

        Raises:
            ValueError: readings of several groups share noise.
        """
        everyone = slice(0, self.mixed)
        half = whole = None
        if mixed is not None:
            half = weight_values(weight, mixed)
            whole = weight_values(weight, half, transposed=True)
            self._add_side(everyone, half, whole, value, design)
        if grouped is None or group is None:
            return
        names, number = np.unique(group, return_inverse=True)
        if not isinstance(weight, np.ndarray):
            ends = np.cumsum([len(each) for each in weight])[:-1]
            if any(np.ptp(each) > 0 for each in np.split(group, ends)):
                raise ValueError("readings of several groups share noise; give each group a matrix of its own.")
        own_half = weight_values(weight, grouped)
        own_whole = weight_values(weight, own_half, transposed=True)
        order = np.argsort(number.reshape(-1), kind="stable")
        first = np.searchsorted(number.reshape(-1)[order], np.arange(len(names)))
        for name, rows in zip(names, np.split(order, first[1:]), strict=True):
            mine = slice(self.mixed + name * self.grouped, self.mixed + (name + 1) * self.grouped)
            self._add_side(mine, own_half[rows], own_whole[rows], value[rows], design[rows])
            if half is not None:
                cross = own_half[rows].reshape(-1, self.grouped).T @ half[rows].reshape(-1, self.mixed)
                self.side_gram[mine, everyone] += cross
                self.side_gram[everyone, mine] += cross.T

    def _add_side(
        self, which: slice, half: FloatArray, whole: FloatArray, value: FloatArray, design: FloatArray
    ) -> None:
        """Add columns (n, outputs, k) of unweighted readings, weighted once in `half` and twice in `whole`."""
        rows = half.reshape(-1, half.shape[2])  # matrix products are many times faster than einsum
        self.side_gram[which, which] += rows.T @ rows
        self.side_moment[which] += whole.reshape(-1, whole.shape[2]).T @ value.ravel()
        for output, cross in enumerate(self.side_cross):
            cross[which] += whole[:, output].T @ design

    def with_side(self, mixed: int, groups: int, grouped: int) -> "Sums":
        """Return sums over the same readings with other side unknowns, all zero until `add_side` adds them."""
        other = Sums(len(self.gram), len(self.moment), mixed, groups, grouped)
        other.count, other.square, other.log_weight = self.count, self.square, self.log_weight
        other.gram, other.moment = self.gram.copy(), self.moment.copy()
        return other

    def combined(self, mixed: FloatArray, groups: FloatArray) -> "Sums":
        """Return the sums for other side unknowns: z = mixed y, and b_go = sum_k groups_ogk c_ko of k groups.

        Args:
            mixed: (mixed, unknowns y).
            groups: (grouped, groups, k).
        """
        reduced = self.with_side(mixed.shape[1], groups.shape[2], self.grouped)
        grouped = np.einsum("ogk,op->gokp", groups, np.eye(self.grouped))
        to = np.zeros((len(self.side_moment), len(reduced.side_moment)))
        to[: self.mixed, : reduced.mixed] = mixed
        to[self.mixed :, reduced.mixed :] = grouped.reshape(self.groups * self.grouped, -1)
        reduced.side_gram = to.T @ self.side_gram @ to
        reduced.side_moment = to.T @ self.side_moment
        reduced.side_cross = np.stack([to.T @ cross for cross in self.side_cross])
        return reduced

    def __sub__(self, other: "Sums") -> "Sums":
        """Subtract the sums over a subset of the readings."""
        rest = Sums(self.gram.shape[0], len(self.moment), self.mixed, self.groups, self.grouped)
        for name, value in vars(self).items():
            if name not in ("mixed", "groups", "grouped"):
                setattr(rest, name, value - getattr(other, name))
        return rest


def weight_values(weight: Weights, values: FloatArray, transposed: bool = False) -> FloatArray:
    """Multiply values (n, ...) of n readings by their weights, or by the transposes of their matrices."""
    flat = values.reshape(len(values), -1)
    if isinstance(weight, np.ndarray):
        return np.asarray((weight[:, None] * flat).reshape(values.shape))
    product, last = np.empty(flat.shape), 0
    for each in weight:
        first, last = last, last + len(each)
        # The triangular product takes half the time; BLAS sees these arrays transposed.
        product[first:last] = scipy.linalg.blas.dtrmm(
            1.0, each.T, flat[first:last].T, side=1, trans_a=int(transposed)
        ).T
    return product.reshape(values.shape)


@dataclass(frozen=True)
class Prior:
    """Prior sizes and noise as functions of the hyperparameters.

    Attributes:
        names: names of the hyperparameters; one is "noise", the logarithm of the noise.
        bounds: (hyperparameters, 2) lowest and highest values.
        expected: (hyperparameters, 2) mean and standard deviation of their hyperprior; infinite without one.
        features: (columns, hyperparameters) derivatives of log size of the coefficients x, the same for each output.
        mixed_features: (mixed, hyperparameters) likewise for z.
        group_features: (grouped, hyperparameters) likewise for b.
        group_offset: (groups, grouped) offset of log size of b.
        offset: (columns,) offset of log size of x.
        mixed_offset: (mixed,) offset of log size of z.
    """

    names: tuple[str, ...]
    bounds: FloatArray
    expected: FloatArray
    features: FloatArray
    mixed_features: FloatArray
    group_features: FloatArray
    group_offset: FloatArray | float = 0.0
    offset: FloatArray | float = 0.0
    mixed_offset: FloatArray | float = 0.0

    def sizes(self, hyper: FloatArray) -> FloatArray:
        """Return the prior sizes (columns,) of the coefficients x of an output."""
        return np.asarray(np.exp(self.offset + self.features @ hyper))

    @property
    def noise(self) -> int:
        """Index of the noise among the hyperparameters."""
        return self.names.index("noise")

    def surprise(self, hyper: FloatArray) -> tuple[float, FloatArray]:
        """Return half the squared Mahalanobis distance of hyperparameters from their hyperprior, and its gradient."""
        off = (hyper - self.expected[:, 0]) / self.expected[:, 1]
        return 0.5 * float(off @ off), off / self.expected[:, 1]

    def side(self, groups: int) -> tuple[FloatArray, FloatArray]:
        """Return the features (side, hyperparameters) and offset (side,) of the side unknowns."""
        grouped = np.broadcast_to(self.group_offset, (groups, len(self.group_features))).ravel()
        features = [self.mixed_features, np.tile(self.group_features, (groups, 1))]
        mixed = np.broadcast_to(self.mixed_offset, len(self.mixed_features))
        return np.concatenate(features), np.concatenate([mixed, grouped])


def posterior(sums: Sums, prior: Prior, hyper: FloatArray, evidence: bool = True) -> Posterior:
    """Return posterior and evidence at given hyperparameters (hyperparameters,).

    Args:
        sums: sums over the readings.
        prior: prior of the unknowns.
        hyper: hyperparameters, logarithms.
        evidence: False if the evidence is not needed; rounding affects it first.

    Raises:
        np.linalg.LinAlgError: a normal matrix is indefinite, or the sum of squares vanishes, by rounding.
    """
    log_noise = float(hyper[prior.noise])
    per_noise = float(np.exp(-log_noise))
    side_features, side_offset = prior.side(sums.groups)
    scale, side_scale = prior.sizes(hyper), np.exp(side_offset + side_features @ hyper)
    # Unknowns without information from the readings keep their prior; leaving them out saves most of the work.
    used = scale**2 * np.diag(sums.gram) * per_noise**2 > _NEGLIGIBLE
    side_used = side_scale**2 * np.diag(sums.side_gram) * per_noise**2 > _NEGLIGIBLE
    width, side_width = scale[used] * per_noise, side_scale[side_used] * per_noise
    # In units of their prior sizes the unknowns have the normal matrix [[N, cross'], [cross, side]] for each output.
    # Sums of squares come from triangular solves, which keep their digits where an inverse would not.
    lower = _cholesky(_normal(sums.gram[np.ix_(used, used)], width))
    cross = side_width[:, None] * sums.side_cross[:, side_used][:, :, used] * width
    pull, side_pull = per_noise * width * sums.moment[:, used], per_noise * side_width * sums.side_moment[side_used]
    half_cross = np.stack([solved(lower, each.T) for each in cross])  # (outputs, used, side)
    half_pull = solved(lower, pull.T)
    side_normal = _normal(sums.side_gram[np.ix_(side_used, side_used)], side_width)
    side_lower = _cholesky(side_normal - sum(each.T @ each for each in half_cross))
    half_rest = solved(side_lower, side_pull - np.einsum("ois,io->s", half_cross, half_pull))
    side_unit = solved(side_lower, half_rest, transposed=True)
    unit = solved(lower, half_pull - (half_cross @ side_unit).T, transposed=True).T
    quadratic = sums.square * per_noise**2 - float(np.sum(half_pull**2)) - float(half_rest @ half_rest)
    square = quadratic - float(np.sum(unit**2)) - float(side_unit @ side_unit)
    if evidence and square < -_ROUNDED_AWAY * sums.count:
        raise np.linalg.LinAlgError("the sum of squares vanishes by rounding")
    log_determinant = 2.0 * float(len(pull) * np.log(np.diag(lower)).sum() + np.log(np.diag(side_lower)).sum())
    minus_two = log_determinant + quadratic + sums.count * (2.0 * log_noise + _LOG_2PI) - 2.0 * sums.log_weight
    mean, side_mean = np.zeros((len(pull), len(scale))), np.zeros(len(side_scale))
    mean[:, used], side_mean[side_used] = unit * scale[used], side_unit * side_scale[side_used]
    return Posterior(
        hyper=dict(zip(prior.names, map(float, hyper), strict=True)),
        log_evidence=-0.5 * minus_two,
        mean=mean,
        mixed_mean=side_mean[: sums.mixed],
        group_mean=side_mean[sums.mixed :].reshape(sums.groups, sums.grouped),
        square=max(square, 0.0) / per_noise**2,
        sizes=np.concatenate([side_scale, scale]),
        features=np.concatenate([side_features, prior.features]),
        count=sums.count,
        used=used,
        side_used=side_used,
        unit=np.concatenate([side_unit, unit.ravel()]),
        lower=lower,
        side_lower=side_lower,
        half_cross=half_cross,
    )


def _normal(gram: FloatArray, width: FloatArray) -> FloatArray:
    """Return the normal matrix of unknowns in units of their prior sizes."""
    normal = width[:, None] * gram * width
    normal[np.diag_indices_from(normal)] += 1.0
    return np.asarray(normal)


def _cholesky(normal: FloatArray) -> FloatArray:
    """Return the lower triangular factor of a positive definite matrix."""
    if len(normal) == 0:
        return normal
    factor, failed = scipy.linalg.lapack.dpotrf(normal, lower=1, clean=1)
    if failed:
        raise np.linalg.LinAlgError("the normal matrix is not positive definite")
    return np.asarray(factor)


def maximise(sums: Sums, prior: Prior, starts: Sequence[Mapping[str, float]]) -> Posterior:
    """Return the posterior of maximum evidence, with the hyperprior as a penalty, by searches from several starts.

    Args:
        sums: sums over the readings.
        prior: prior with the bounds of the search.
        starts: hyperparameters by name.

    Raises:
        np.linalg.LinAlgError: the evidence cannot be computed at any start.
    """
    best: Posterior | None = None
    for start in starts:
        hyper = np.clip([start[name] for name in prior.names], *prior.bounds.T)
        try:
            found = _climb(sums, prior, posterior(sums, prior, hyper), _ROUGHLY)
        except np.linalg.LinAlgError:
            continue
        if best is None or _height(prior, found) > _height(prior, best):
            best = found
    if best is None:
        raise np.linalg.LinAlgError("the evidence cannot be computed at any start")
    return _climb(sums, prior, best, _ENOUGH)


def _height(prior: Prior, at: Posterior) -> float:
    """Return the log evidence with the hyperprior as a penalty."""
    return at.log_evidence - prior.surprise(_values(at))[0]


def _values(at: Posterior) -> FloatArray:
    return np.array(list(at.hyper.values()))


def _climb(sums: Sums, prior: Prior, at: Posterior, enough: float) -> Posterior:
    """Return the posterior of highest evidence near another one, by Newton steps within the bounds.

    The search ends when the predicted gain of a step is less than `enough`.
    """
    radius = _LONGEST
    for _ in range(_STEPS):
        hyper, height = _values(at), _height(prior, at)
        slope = at.slope - prior.surprise(hyper)[1]
        curvature = np.diag(prior.expected[:, 1] ** -2.0) - at.second_slope
        stuck = ((hyper <= prior.bounds[:, 0]) & (slope <= 0)) | ((hyper >= prior.bounds[:, 1]) & (slope >= 0))
        free = np.flatnonzero(~stuck)
        values, axes = np.linalg.eigh(curvature[np.ix_(free, free)])
        along = axes.T @ slope[free]
        whole = along / np.maximum(np.abs(values), _FLAT)
        if along @ np.clip(whole, -_LONGEST, _LONGEST) < 2.0 * enough:
            return at
        for _ in range(_TRIALS):
            step = np.clip(whole, -radius, radius)
            tried = hyper.copy()
            tried[free] += axes @ step
            try:
                there = posterior(sums, prior, np.clip(tried, *prior.bounds.T))
            except np.linalg.LinAlgError:
                there = None
            if there is not None and _height(prior, there) > height:
                at, radius = there, min(4.0 * radius, _LONGEST)
                break
            radius = 0.25 * float(np.abs(step).max())
        else:
            return at
    return at

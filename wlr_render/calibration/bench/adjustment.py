"""Joint adjustment of every unknown of a bench from all direct views at once, with covariance.

The method is Gauss-Newton. The sizes of the stage's errors and the noise are hyperparameters that maximise the evidence
(`numerics.evidence`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from wlr_render.calibration.bench.bench_blocks import FEATURES, HYPER, USUAL_SIZES, Key, Layout, Sizes
from wlr_render.calibration.bench.normal_equations import Normal
from wlr_render.calibration.bench.state import BenchState
from wlr_render.calibration.poses import Pose, adjoint
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.evidence import Prior, Sums, maximise, posterior
from wlr_render.numerics.posterior import Posterior

_ROUNDS, _HALVINGS = 15, 6  # most rounds; most halvings of a step that leads uphill
_ROUGH, _SETTLED = 1.0, 0.05  # largest step, in sigmas, for an estimate of sizes, and at the end of the fit
_SAME = 0.01  # relative change of sizes that ends the rounds; their standard errors are 5 % and more
_FEATURES_CHANGE = 3.0  # largest change of the features' size in a round, a factor; the fixed point overshoots at first
_ROUNDING = 1e-7  # largest relative increase of the sum of squares due to rounding


class UndeterminedError(ValueError):
    """Error for views that do not determine the bench."""


@dataclass(frozen=True, eq=False)
class Adjustment:
    """A solved bench.

    Attributes:
        state: values of all unknowns.
        layout: layout of the unknowns in `covariance`.
        covariance: (unknowns, unknowns) covariance of small motions and values, as in steps of `BenchState.moved`.
        sizes: estimated variance components.
        normal: normal equations at the solution.
        hyper: logarithms of the hyperparameters.
        chi_square: reduced chi-squared of each camera that saw a board: sum of squares in units of the stated sigmas,
            divided by readings minus unknowns.
        is_settled: True if the steps ended at a minimum; otherwise the views contradict each other.
    """

    state: BenchState
    layout: Layout
    covariance: FloatArray
    sizes: Sizes
    normal: Normal
    hyper: FloatArray
    chi_square: Mapping[str, float]
    is_settled: bool

    def covariance_of(self, keys: Sequence[Key]) -> FloatArray:
        """Return the joint covariance of some blocks, in the order of `keys`."""
        columns = self.layout.columns(keys)
        return self.covariance[np.ix_(columns, columns)]

    def camera_poses(self, places: Sequence[str]) -> tuple[FloatArray, FloatArray]:
        """Return device_from_camera (n, 4, 4) at places, and the covariance (6 n, 6 n) of small motions, device frame.

        The covariance includes errors of the stage that no view measured, as independent from place to place.
        """
        poses, rows, own = self.camera_rows(places)
        flat = np.concatenate(rows)
        covariance = flat @ self.covariance @ flat.T
        for k, each in enumerate(own):
            covariance[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] += each
        return poses, covariance

    def relative_motion(self, one: str, other: str) -> tuple[FloatArray, FloatArray]:
        """Return device_from_camera (2, 4, 4) at two places, and the covariance (6, 6) of the motion between them.

        The motion is small and about the device's origin. The covariance excludes errors that both places share.
        """
        poses, rows, _ = self.camera_rows([one, other])
        apart = rows[1] - rows[0]
        covariance = apart @ self.covariance @ apart.T
        own = [self._unmeasured(place) for place in (one, other)]
        for pose, errors, shared in zip(poses, own, own[::-1], strict=True):
            to_device = adjoint(pose)
            for key in [key for key in errors if key not in shared]:
                covariance += to_device @ errors[key] @ to_device.T
        return poses, np.asarray(covariance)

    def camera_rows(self, places: Sequence[str]) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return device_from_camera at places and its derivatives by the unknowns.

        Returns:
            The poses (n, 4, 4), their small motions (n, 6, unknowns) by each unknown, device frame, and the covariance
            (n, 6, 6) of stage errors that are not unknowns, because no view measured them.
        """
        poses, rows, own = [], [], []
        for place in places:
            state = self.state
            pose = state.device_from_camera(place)
            to_device = adjoint(pose)
            row = np.zeros((6, len(self.layout.size)))
            for key, columns in state.camera_motion(place).items():
                row[:, self.layout.where[key]] = to_device @ columns
            poses.append(pose)
            rows.append(row)
            unmeasured = sum(self._unmeasured(place).values(), np.zeros((6, 6)))
            own.append(to_device @ unmeasured @ to_device.T)
        return np.array(poses), np.array(rows), np.array(own)

    def _unmeasured(self, place: str) -> dict[Key, FloatArray]:
        """Return covariances (6, 6), camera frame, of errors of a visit and of axis readings that no view measured."""
        found = {}
        for key, columns in self.state.visit_motion(place).items():
            if key not in self.state.blocks:
                root = columns * (self.sizes.visit if key[0] == "offset" else self.sizes["screw"])
                found[key] = root @ root.T
        return found

    def camera_pose(self, place: str) -> Pose:
        """Return device_from_camera at a place, with its covariance."""
        poses, covariance = self.camera_poses([place])
        return Pose(poses[0], covariance)

    def target_pose(self, number: int) -> Pose:
        """Return device_from_target, with its covariance in the device frame."""
        pose = self.state.targets[number]
        to_device = adjoint(pose)
        return Pose(pose, to_device @ self.covariance_of([("target", number)]) @ to_device.T)


def adjust(start: BenchState) -> Adjustment:
    """Estimate all unknowns, the sizes of the stage's errors and the noise.

    Args:
        start: values near the solution.

    Raises:
        UndeterminedError: the views do not determine the unknowns.
    """
    state, layout = start, Layout.of(start.blocks)
    prior = layout.prior
    hyper = prior.expected[:, 0]
    sizes = Sizes.of(
        hyper,
        {name: start.observations.tolerances[name].print_error_m for name in state.shape},
        {name: 1.0 for name in state.lens},
    )
    normal = Normal(state, layout, sizes, {})
    for number in range(_ROUNDS):
        earlier = state
        state, normal, found, away = _stepped(state, normal, layout, prior, hyper, sizes)
        is_stuck = state is earlier
        if away > _ROUGH and not is_stuck and number < _ROUNDS - 1:
            continue
        before = sizes
        if layout.has_sizes and normal.count:
            hyper = _best_hyper(normal, layout, prior, hyper, everywhere=number < 3)
        feature_m = {name: _feature_size(state, name, normal, sizes) for name in state.shape}
        sizes = Sizes.of(hyper, feature_m, _noise(normal, sizes, found))
        normal = Normal(state, layout, sizes, {})
        if (away < _SETTLED or is_stuck) and _alike(before, sizes):
            break
    found = _solved(normal, layout, prior, hyper)
    covariance = layout.size[:, None] * found.side_covariance * layout.size
    chi_square = {name: float(value**2) for name, value in _noise(normal, sizes, found).items() if normal.values[name]}
    return Adjustment(state, layout, covariance, sizes, normal, hyper, chi_square, away <= _ROUGH)


def _alike(one: Sizes, other: Sizes) -> bool:
    """Return True if two rounds agree in the noise and in the sizes of the features' errors."""
    pairs = [(one.noise[name], other.noise[name]) for name in one.noise]
    pairs += [(one.feature_m[name], other.feature_m[name]) for name in one.feature_m]
    return all(abs(np.log(first / second)) < _SAME for first, second in pairs)


def _stepped(
    state: BenchState, normal: Normal, layout: Layout, prior: Prior, hyper: FloatArray, sizes: Sizes
) -> tuple[BenchState, Normal, Posterior, float]:
    """Take one Gauss-Newton step, halved while it increases the cost; keep the state if no part of it lowers the cost.

    The last return value is the length of the whole step, in sigmas of the worst unknown.
    """
    width = layout.size * np.exp(prior.mixed_features @ hyper)
    cost = _cost(state, layout, width, sizes, normal)
    found = _solved(normal, layout, prior, hyper)
    vector = found.mixed_mean * layout.size
    before = state.deviation(layout.where)
    step = layout.steps(vector - before)
    features = normal.features_at(vector)
    for name, shape in state.shape.items():
        step[FEATURES, name] = (features[name] - shape.place).ravel()
    sigma = layout.size * np.sqrt(np.diag(found.side_covariance))
    away = float(np.max(np.abs(vector - before) / sigma))
    for _ in range(_HALVINGS):
        tried = state.moved(step)
        now = _sound(tried, layout, sizes)
        # Features outside a camera's field have no cost, so that losing features must not count as a gain.
        if (
            now is not None
            and now.count >= normal.count
            and _cost(tried, layout, width, sizes, now) <= cost * (1.0 + _ROUNDING)
        ):
            return tried, now, found, away
        step = {key: 0.5 * each for key, each in step.items()}
    return state, normal, found, away


def _sound(state: BenchState, layout: Layout, sizes: Sizes) -> Normal | None:
    """Return the normal equations; None if a board is so near a camera that they are not finite."""
    try:
        return Normal(state, layout, sizes, {})
    except np.linalg.LinAlgError:
        return None


def _solved(normal: Normal, layout: Layout, prior: Prior, hyper: FloatArray) -> Posterior:
    try:
        return posterior(normal.sums(layout), prior, hyper, evidence=False)
    except np.linalg.LinAlgError as error:
        raise UndeterminedError("the views leave an unknown of the bench open") from error


def _cost(state: BenchState, layout: Layout, width: FloatArray, sizes: Sizes, normal: Normal) -> float:
    """Return the cost in units of sigma squared: Huber's loss plus squared deviations from priors."""
    before = state.deviation(layout.where)
    features = sum(float(np.sum(shape.place**2)) / sizes.feature_m[name] ** 2 for name, shape in state.shape.items())
    return normal.loss + float(np.sum((before / width) ** 2)) + features


def _noise(normal: Normal, sizes: Sizes, found: Posterior) -> dict[str, float]:
    """Return the noise factor of each camera: rms residual per degree of freedom, in stated sigmas."""
    determined = 1.0 - np.diag(found.side_covariance) / found.sizes[: len(found.side_used)] ** 2
    features = sum(normal.determined_features(name, sizes.feature_m[name]) for name in normal.features)
    every, factors = sum(normal.informed.values()), dict(sizes.noise)
    for name, count in normal.values.items():
        if count:
            part = count / normal.count
            share = np.where(every > 0, normal.informed[name] / np.maximum(every, 1e-300), part)
            free = max(count - float(determined @ share) - part * features, 0.1 * count)
            factors[name] *= float(np.sqrt(max(normal.chi_square[name], 1e-12) / free))
    return factors


def _feature_size(state: BenchState, name: str, normal: Normal, sizes: Sizes) -> float:
    """Return the next standard deviation of the features' errors (MacKay's fixed point, see `numerics.evidence`)."""
    size = sizes.feature_m[name]
    if name not in normal.features:
        return size
    determined = max(normal.determined_features(name, size), 1.0)
    found = np.sqrt(float(np.sum(state.shape[name].place ** 2)) / determined)
    return float(np.clip(found, max(size / _FEATURES_CHANGE, 1e-7), min(size * _FEATURES_CHANGE, 1e-3)))


def _best_hyper(normal: Normal, layout: Layout, prior: Prior, hyper: FloatArray, everywhere: bool) -> FloatArray:
    """Return the hyperparameters of greatest evidence, with zero noise, which `_noise` estimates for each camera.

    Unknowns whose priors do not depend on hyperparameters are integrated out first. The search has a common noise, so
    that no size absorbs readings that scatter more than `normal` expects.
    """
    is_kept = np.any(layout.features, axis=1)
    kept, gone = np.flatnonzero(is_kept), np.flatnonzero(~is_kept)
    sums = normal.sums(layout)
    block = sums.side_gram[np.ix_(gone, gone)] + np.eye(len(gone))
    follow = np.linalg.solve(block, sums.side_gram[np.ix_(gone, kept)])
    rest = Sums(0, 1, len(kept))
    rest.count, rest.log_weight = sums.count - len(gone), sums.log_weight
    rest.square = sums.square - float(sums.side_moment[gone] @ np.linalg.solve(block, sums.side_moment[gone]))
    rest.side_gram = sums.side_gram[np.ix_(kept, kept)] - sums.side_gram[np.ix_(kept, gone)] @ follow
    rest.side_moment = sums.side_moment[kept] - follow.T @ sums.side_moment[gone]
    smaller = replace(prior, mixed_features=prior.mixed_features[kept])
    starts = [dict(zip(HYPER, hyper, strict=True))]
    for factor in _STARTS if everywhere else ():
        starts.append(starts[0] | {name: np.log(factor * size.value) for name, size in USUAL_SIZES.items()})
    best = maximise(rest, smaller, starts)
    return np.array([best.hyper[name] * (name != "noise") for name in HYPER])


_STARTS = (0.2, 4.0)  # further starts of the search for sizes, in usual sizes

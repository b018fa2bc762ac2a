"""The joint adjustment: every unknown of a bench from all direct views at once, with its covariance.

Gauss-Newton steps. The sizes of the stage's errors and the noise are hyperparameters that maximise the evidence
(`numerics.evidence`); the errors of a board's features are eliminated first, since no two of them meet
(B. Triggs et al., "Bundle adjustment: a modern synthesis" (2000), section 6). Huber weights hold off outliers.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from wlr_render.calibration.bench.observations import EYEBALL, TRACKING, BoardView, CameraSetup, KnownPose
from wlr_render.calibration.bench.state import AXIS_PARTS, BenchState, Key, smooth_orders, stretch_terms
from wlr_render.calibration.poses import Pose, adjoint, cross_matrix
from wlr_render.captures.photo_session import StageAxis
from wlr_render.geometry import transforms
from wlr_render.geometry.lens import Lens
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.evidence import Posterior, Prior, Sums, maximise, posterior

FLAT, EXACT = 10.0, 1e-9
"""Prior sizes of what is not known beforehand, and of what counts as exact: radians, metres, per unit."""
USUAL_SIZES = {"turn": 1e-5, "shift": 3e-6, "smooth turn": 5e-5, "smooth shift": 3e-6, "stretch": 1e-4}  # ordinary
USUAL_DIFFER = 1.2  # standard deviation of the logarithms: by a factor of 3.3
_LEAST, _MOST = 1e-9, 1e-2
_FOCUS_CHANGES = 2e-4  # standard deviation of a focal length, relative, from one target distance to the other
_PIVOT_M = 1e-3  # standard deviation of a stated pivot, about what a rule measures
_DECAY = 0.5  # of the smooth error's size by degree
_POWERS = {"k1": 2, "k2": 4, "k3": 6, "k4": 2, "k5": 4, "k6": 6, "s2": 3, "s4": 3}
"""Power of the distance from the centre with which a term displaces, relative to that distance; 1 for the others."""
_HUBER = 3.0  # sigmas
_ROUNDS, _HALVINGS = 15, 6
_ROUGH, _SETTLED = 1.0, 0.05  # sigmas of the worst unknown: when sizes are worth finding, and when all is found
_SAME = 0.01  # relative change of sizes
_FEATURES_CHANGE = 3.0  # factor by which their size may change in one round
_ROUNDING = 1e-7  # of the sum of squares
_NOISE_DIFFERS = 0.3


class UndeterminedError(ValueError):
    """The views do not determine the bench, or the adjustment does not converge."""


@dataclass(frozen=True)
class Sizes:
    """Variance components of a bench, standard deviations per axis.

    Attributes:
        turn, shift: random error of the stage in each visit, radians and metres.
        smooth_turn, smooth_shift: its smooth error over the travel.
        stretch: of the image of a board held freely, relative; each of the four parts.
        feature_m: error of a feature on each board.
        noise: factor on the stated sigma of the features, by camera.
    """

    turn: float
    shift: float
    smooth_turn: float
    smooth_shift: float
    stretch: float
    feature_m: Mapping[str, float]
    noise: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Layout:
    """Where each block of unknowns lies, and its prior.

    Attributes:
        where: columns of each block; features of boards come after all others.
        size: (unknowns,) prior sizes, of those with a hyperparameter as a multiple of it.
        hyper: (unknowns,) index into `HYPER`, or -1.
    """

    where: Mapping[Key, slice]
    size: FloatArray
    hyper: IntArray

    @property
    def has_sizes(self) -> bool:
        """Whether any unknown has a size that the views are to find."""
        return bool(np.any(self.hyper >= 0))

    def columns(self, keys: Sequence[Key]) -> IntArray:
        """Columns of some blocks, one after the other."""
        parts = [np.arange(self.where[key].start, self.where[key].stop) for key in keys]
        return np.concatenate(parts) if parts else np.zeros(0, np.int64)

    def steps(self, vector: FloatArray) -> dict[Key, FloatArray]:
        """The vector by block."""
        return {key: vector[where] for key, where in self.where.items()}


HYPER = ("turn", "shift", "smooth turn", "smooth shift", "stretch", "noise")
_STRETCH = HYPER.index("stretch")


def layout_of(state: BenchState) -> Layout:
    """Blocks of unknowns and their priors."""
    seen = state.observations
    where: dict[Key, slice] = {}
    size: list[FloatArray] = []
    hyper: list[IntArray] = []

    def add(key: Key, sizes: FloatArray, hypers: Sequence[int] = ()) -> None:
        start = sum(map(len, size))
        where[key] = slice(start, start + len(sizes))
        size.append(np.maximum(sizes, EXACT))
        hyper.append(np.array(hypers if len(hypers) else [-1] * len(sizes), dtype=np.int64))

    for name, lens in state.lens.items():
        add(("lens", name), _lens_sizes(lens, seen.cameras[name]))
    for name in state.shape:
        board = seen.tolerances[name]
        add(("shape", name), np.array([board.flatness_m] * 3 + [board.scale_sigma] * 2))
    for number in state.focus:
        add(("focus", number), np.array([_FOCUS_CHANGES]))
    for number in state.targets:
        add(("target", number), _pose_sizes(seen.targets.get(number)))
    if seen.device_from_tracking is not None:
        add(("extrinsics", TRACKING), _pose_sizes(seen.device_from_tracking))
    for number in state.base:
        add(("base", number), _pose_sizes(seen.device_from_camera if number == state.first_mounting else None))
    for number, axis in enumerate(seen.axes):
        add(("axis", number), _axis_sizes(axis))
    for number, order in enumerate(smooth_orders(len(state.twists)) if len(state.smooth) else []):
        add(("smooth", number), _smooth_sizes(order, seen.axes), [2, 2, 2, 3, 3, 3])
    random: list[tuple[Key, list[int]]] = [(("offset", place), [0, 0, 0, 1, 1, 1]) for place in state.offsets]
    random += [(("stretch", name), [_STRETCH] * 4) for name in state.stretches]
    for key, hypers in random:
        add(key, np.ones(len(hypers)), hypers)
    for key in [*(("free", place) for place in state.free), *(("board pose", name) for name in state.boards)]:
        add(key, np.full(6, FLAT))
    return Layout(where, np.concatenate(size), np.concatenate(hyper))


def _lens_sizes(lens: Lens, setup: CameraSetup) -> FloatArray:
    if setup.known is not None:
        return np.zeros(len(lens.values)) if setup.known_sigma is None else setup.known_sigma
    sizes = np.full(len(lens.values), 0.3 * float(np.mean(lens.focal_px)))
    # A term may be as large as to displace the corner of the picture by its distance from the centre.
    corner = float(np.linalg.norm(0.5 * np.array(lens.size_px) / lens.focal_px))
    sizes[4:] = [max(1.0, corner ** -_POWERS.get(name, 1)) for name in lens.names[4:]]
    return sizes


def _pose_sizes(known: KnownPose | None) -> FloatArray:
    return np.full(6, FLAT) if known is None else np.repeat(known.sigma, 3)


def _axis_sizes(axis: StageAxis) -> FloatArray:
    sizes = np.full(6, FLAT)
    if axis.kind == "linear":
        sizes[:3] = EXACT
    if axis.direction is not None:
        sizes[AXIS_PARTS[axis.kind]] = axis.direction_sigma or EXACT
    if axis.direction is not None and axis.pivot is not None:
        sizes[3:] = _PIVOT_M
    return sizes


def _smooth_sizes(order: Sequence[int], axes: Sequence[StageAxis]) -> FloatArray:
    """Of one term of the smooth error; the linear motion of an axis is its twist's."""
    sizes = np.full(6, _DECAY ** (sum(order) - 1))
    if sum(order) == 1:
        moved = next(axis for axis, each in zip(axes, order, strict=True) if each)
        sizes[slice(0 if moved.kind == "rotary" else 3, 6)] = EXACT
    return sizes


@dataclass(frozen=True, eq=False)
class ViewResiduals:
    """Residuals of one view, pixels, and their derivatives.

    Attributes:
        residual: (n, 2) seen minus predicted; NaN where the lens cannot see the point.
        by_motion: (n, 2, 6) of predicted by a small motion of camera_from_board, camera frame.
        by_lens: (n, 2, P). by_shape: (n, 2, 5). by_place: (n, 2, 3), by the feature's place.
        by_stretch: (n, 2, 4), or (n, 2, 0) where the image counts as not stretched.
    """

    residual: FloatArray
    by_motion: FloatArray
    by_lens: FloatArray
    by_shape: FloatArray
    by_place: FloatArray
    by_stretch: FloatArray


def residuals_of(state: BenchState, view: BoardView) -> ViewResiduals:
    """Residuals of a view and their derivatives."""
    shape, camera_from_board = state.shape[view.board], state.camera_from_board(view)
    point = transforms.apply(camera_from_board, shape.point_of(view.feature, view.point))
    seen = state.lens_of(view).project(point)
    turned = seen.by_point @ camera_from_board[:3, :3]
    by_motion = np.concatenate([seen.by_point @ -cross_matrix(point), seen.by_point], axis=-1)
    predicted, by_stretch = seen.pixel, np.zeros((len(point), 2, 0))
    if view.name in state.stretches:
        by_stretch = stretch_terms(view.pixel, state.lens_of(view).size_px)
        predicted = predicted + by_stretch @ state.stretches[view.name]
    return ViewResiduals(
        view.pixel - predicted, by_motion, seen.by_values, turned @ shape.by_low(view.point), turned, by_stretch
    )


Extra = Mapping[Key, Mapping[str, FloatArray]]
"""Further unknowns: by the name of a view, (6, k) motion of the board in its camera's frame."""


@dataclass(frozen=True, eq=False)
class _ViewEquations:
    """Weighted equations of one view in its local unknowns: lens, board's shape, motion of the board, stretch.

    Attributes:
        design: (n, 2, local). by_place: (n, 2, 3), by the places of the view's features. value: (n, 2), linearised
            readings, zero where all unknowns are at the middle of their priors.
        rows: (n,) of the features on the board.
        carry: (local, unknowns) from all unknowns to the local ones.
        chi_square: sum of squares. loss: Huber's. values: number of values seen. log_weight: sum over them.
    """

    design: FloatArray
    by_place: FloatArray
    value: FloatArray
    rows: IntArray
    carry: FloatArray
    chi_square: float
    loss: float
    values: int
    log_weight: float

    @classmethod
    def of(
        cls, state: BenchState, layout: Layout, sizes: Sizes, extra: Extra, before: FloatArray, view: BoardView
    ) -> "_ViewEquations":
        """Linearise a view; `before` (unknowns,) is how far they are from the middle of their priors."""
        part, shape = residuals_of(state, view), state.shape[view.board]
        sigma = view.sigma_px * sizes.noise[view.camera]
        seen = np.asarray(np.isfinite(part.residual).all(axis=1))
        residual = np.where(seen[:, None], part.residual, 0.0)
        length = np.sqrt(0.5 * np.sum(residual**2, axis=1)) / sigma
        weight = seen * np.sqrt(_HUBER / np.maximum(length, _HUBER)) / sigma
        near = np.minimum(length, _HUBER)
        local = np.concatenate([part.by_lens, part.by_shape, part.by_motion, part.by_stretch], axis=-1)
        design = np.where(seen[:, None, None], local, 0.0) * weight[:, None, None]
        by_place = np.where(seen[:, None, None], part.by_place, 0.0) * weight[:, None, None]
        rows = shape.rows_of(view.feature)
        carry = _carried(state, layout, extra, view, part)
        weighted = residual * weight[:, None]
        value = weighted + design @ (carry @ before) + np.einsum("nij,nj->ni", by_place, shape.place[rows])
        return cls(
            design,
            by_place,
            value,
            rows,
            carry,
            float(np.sum(weighted**2)),
            2.0 * float(np.sum(near * (2.0 * length - near))),
            2 * int(np.count_nonzero(seen)),
            2.0 * float(np.log(weight[seen]).sum()),
        )


def _carried(state: BenchState, layout: Layout, extra: Extra, view: BoardView, part: ViewResiduals) -> FloatArray:
    """(local, unknowns) local unknowns of a view by all unknowns."""
    blocks = state.board_motion(view)
    blocks |= {key: columns[view.name] for key, columns in extra.items() if view.name in columns}
    lens, low = part.by_lens.shape[-1], part.by_shape.shape[-1]
    stretch = part.by_stretch.shape[-1]
    carry = np.zeros((lens + low + 6 + stretch, len(layout.size)))
    carry[:lens, layout.where["lens", view.camera]] = np.eye(lens)
    carry[lens : lens + low, layout.where["shape", view.board]] = np.eye(low)
    if view.camera == EYEBALL and view.target is not None and lens:
        carry[:2, layout.where["focus", view.target]] = state.lens[EYEBALL].focal_px[:, None]
    for key, columns in blocks.items():
        carry[lens + low : lens + low + 6, layout.where[key]] = columns
    if stretch:
        carry[lens + low + 6 :, layout.where["stretch", view.name]] = np.eye(stretch)
    return carry


class Normal:
    """Normal equations of all unknowns, with the features' errors integrated out at given sizes.

    Attributes:
        gram: (unknowns, unknowns). moment: (unknowns,). square, count, log_weight: as of `evidence.Sums`.
        loss: Huber's, sigmas squared.
        chi_square, values: sum of squares and number of values, by camera.
        features: by board, covariance (f, 3, 3) where the other unknowns are known, mean (f, 3) where they are zero,
            and their mixed sums (unknowns, 3 f).
    """

    def __init__(self, state: BenchState, layout: Layout, sizes: Sizes, extra: Extra) -> None:
        """Sum over all views.

        Args:
            state: to linearise at.
            layout: of the unknowns.
            sizes: noise by camera and error of features by board.
            extra: further blocks of `layout`.
        """
        self.square, self.loss, self.log_weight = 0.0, 0.0, 0.0
        self.chi_square = {name: 0.0 for name in state.lens}
        self.values = {name: 0 for name in state.lens}
        before = np.concatenate([state.deviation(key) for key in layout.where if key not in extra])
        before = np.concatenate([before, np.zeros(len(layout.size) - len(before))])
        own = {name: np.zeros((len(each.feature), 3, 3)) for name, each in state.shape.items()}
        pull = {name: np.zeros((len(each.feature), 3)) for name, each in state.shape.items()}
        crosses: dict[str, list[FloatArray]] = {name: [] for name in state.shape}
        carries: dict[str, list[FloatArray]] = {name: [] for name in state.shape}
        carried, moments = [], []
        for view in state.observations.views:
            each = _ViewEquations.of(state, layout, sizes, extra, before, view)
            self.chi_square[view.camera] += each.chi_square
            self.values[view.camera] += each.values
            self.loss += each.loss
            self.log_weight += each.log_weight
            self.square += float(np.sum(each.value**2))
            flat = each.design.reshape(-1, each.design.shape[-1])
            carries[view.board].append(each.carry)
            carried.append((each.carry, (flat.T @ flat) @ each.carry))
            moments.append(flat.T @ each.value.ravel())
            cross = np.zeros((flat.shape[1], len(own[view.board]), 3))
            cross[:, each.rows] = np.einsum("nik,nij->knj", each.design, each.by_place)
            crosses[view.board].append(cross.reshape(flat.shape[1], -1))
            own[view.board][each.rows] += np.einsum("nik,nij->nkj", each.by_place, each.by_place)
            pull[view.board][each.rows] += np.einsum("nik,ni->nk", each.by_place, each.value)
        self.count = sum(self.values.values())
        count = len(layout.size)
        carry = np.concatenate([np.zeros((0, count)), *(each for each, _ in carried)])
        self.gram = carry.T @ np.concatenate([np.zeros((0, count)), *(each for _, each in carried)])
        self.moment = carry.T @ np.concatenate([np.zeros(0), *moments])
        cross_of = {name: np.concatenate(carries[name]).T @ np.concatenate(each) for name, each in crosses.items()}
        self._eliminate(sizes, cross_of, own, pull)

    def _eliminate(
        self,
        sizes: Sizes,
        cross: Mapping[str, FloatArray],
        own: Mapping[str, FloatArray],
        pull: Mapping[str, FloatArray],
    ) -> None:
        """Integrate the features' errors out."""
        self.features: dict[str, tuple[FloatArray, FloatArray, FloatArray]] = {}
        for name, each in own.items():
            if not len(each):
                continue
            size = sizes.feature_m[name]
            inverse = np.linalg.inv(each + np.eye(3) / size**2)
            mean: FloatArray = np.einsum("nij,nj->ni", inverse, pull[name])
            by_feature = cross[name].reshape(len(cross[name]), -1, 3).transpose(1, 0, 2)
            half = (by_feature @ np.linalg.cholesky(inverse)).transpose(1, 0, 2).reshape(len(cross[name]), -1)
            self.gram -= half @ half.T  # BLAS calculates one triangle of such a product
            self.moment -= cross[name] @ mean.ravel()
            self.square -= float(np.sum(pull[name] * mean))
            self.features[name] = np.asarray(inverse), mean, cross[name]

    def sums(self, layout: Layout) -> Sums:
        """For the evidence, in units of the prior sizes that have no hyperparameter."""
        sums = Sums(0, 1, len(layout.size))
        sums.count, sums.square, sums.log_weight = self.count, self.square, self.log_weight
        sums.side_gram = layout.size[:, None] * self.gram * layout.size
        sums.side_moment = layout.size * self.moment
        return sums

    def features_at(self, vector: FloatArray) -> dict[str, FloatArray]:
        """(f, 3) errors of each board's features, where the other unknowns are `vector`."""
        return {
            name: mean - np.einsum("nij,nj->ni", inverse, (vector @ cross).reshape(-1, 3))
            for name, (inverse, mean, cross) in self.features.items()
        }

    def determined_features(self, name: str, size: float) -> float:
        """How many of the coordinates of a board's features the views determine, at their prior size."""
        inverse = self.features[name][0]
        return 3.0 * len(inverse) - float(np.trace(inverse, axis1=1, axis2=2).sum()) / size**2


def prior_of(layout: Layout) -> Prior:
    """Prior of the unknowns of `layout`, by the hyperparameters `HYPER`."""
    features = np.zeros((len(layout.size), len(HYPER)))
    rows = np.flatnonzero(layout.hyper >= 0)
    features[rows, layout.hyper[rows]] = 1.0
    bounds = [(np.log(_LEAST), np.log(_MOST))] * 5 + [(-2.0, 2.0)]
    expected = [(np.log(USUAL_SIZES[name]), USUAL_DIFFER) for name in HYPER[:-1]] + [(0.0, _NOISE_DIFFERS)]
    none = np.zeros((0, len(HYPER)))
    return Prior(HYPER, np.array(bounds), np.array(expected), none, features, none)


@dataclass(frozen=True, eq=False)
class Adjustment:
    """A solved bench.

    Attributes:
        state: values of all unknowns.
        layout: of the unknowns in `covariance`.
        covariance: (unknowns, unknowns), small motions and values as `BenchState.moved` takes them.
        sizes: variance components found.
        normal: the equations at the solution.
        hyper: logarithms of the hyperparameters.
        chi_square: by camera that saw a board, reduced: sum of squares in units of the stated sigmas, over readings
            less unknowns.
    """

    state: BenchState
    layout: Layout
    covariance: FloatArray
    sizes: Sizes
    normal: Normal
    hyper: FloatArray
    chi_square: Mapping[str, float]

    def covariance_of(self, keys: Sequence[Key]) -> FloatArray:
        """Joint covariance of some blocks, one after the other."""
        columns = self.layout.columns(keys)
        return self.covariance[np.ix_(columns, columns)]

    def camera_poses(self, places: Sequence[str], measured: bool = True) -> tuple[FloatArray, FloatArray]:
        """Return device_from_camera (n, 4, 4) at places, and the covariance (6 n, 6 n) of small motions, device frame.

        Args:
            places: names; the random error of the stage is in the covariance of those that no view measured.
            measured: False for another visit to the same readings: the random error is not the one that was measured.
        """
        poses, rows, own = [], [], []
        random = np.repeat([self.sizes.turn**2, self.sizes.shift**2], 3)
        for place in places:
            state = self.state
            if not measured and place in state.offsets:
                state = replace(state, offsets={k: v for k, v in state.offsets.items() if k != place})
            pose = state.device_from_camera(place)
            to_device = adjoint(pose)
            row = np.zeros((6, len(self.layout.size)))
            for key, columns in state.camera_motion(place).items():
                row[:, self.layout.where[key]] = to_device @ columns
            poses.append(pose)
            rows.append(row)
            unmeasured = place not in state.offsets and place not in state.free
            own.append(to_device @ np.diag(random * unmeasured) @ to_device.T)
        flat = np.concatenate(rows)
        covariance = flat @ self.covariance @ flat.T
        for k, each in enumerate(own):
            covariance[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] += each
        return np.array(poses), covariance

    def camera_pose(self, place: str) -> Pose:
        """device_from_camera at a place, with its covariance."""
        poses, covariance = self.camera_poses([place])
        return Pose(poses[0], covariance)

    def target_pose(self, number: int) -> Pose:
        """device_from_target, with its covariance in the device frame."""
        pose = self.state.targets[number]
        to_device = adjoint(pose)
        return Pose(pose, to_device @ self.covariance_of([("target", number)]) @ to_device.T)


def adjust(start: BenchState) -> Adjustment:
    """Find the values of all unknowns, the sizes of the stage's errors and the noise.

    Args:
        start: values near the solution.

    Raises:
        UndeterminedError: the views do not determine the unknowns.
    """
    state, layout = start, layout_of(start)
    prior = prior_of(layout)
    hyper = np.array([*(np.log(USUAL_SIZES[name]) for name in HYPER[:-1]), 0.0])
    sizes = _sizes(
        hyper,
        {name: start.observations.tolerances[name].print_error_m for name in state.shape},
        {name: 1.0 for name in state.lens},
    )
    normal = Normal(state, layout, sizes, {})
    for number in range(_ROUNDS):
        state, normal, found, away = _stepped(state, normal, layout, prior, hyper, sizes)
        if away > _ROUGH and number < _ROUNDS - 1:
            continue
        before = sizes
        if layout.has_sizes and normal.count:
            hyper = _best_hyper(normal, layout, prior, hyper, everywhere=number < 3)
        feature_m = {name: _feature_size(state, name, normal, sizes) for name in state.shape}
        sizes = _sizes(hyper, feature_m, _noise(normal, sizes, found))
        normal = Normal(state, layout, sizes, {})
        if away < _SETTLED and _alike(before, sizes):
            break
    found = _solved(normal, layout, prior, hyper)
    covariance = layout.size[:, None] * found.side_covariance * layout.size
    chi_square = {name: float(value**2) for name, value in _noise(normal, sizes, found).items() if normal.values[name]}
    return Adjustment(state, layout, covariance, sizes, normal, hyper, chi_square)


def _alike(one: Sizes, other: Sizes) -> bool:
    """Whether noise and errors of features have settled."""
    pairs = [(one.noise[name], other.noise[name]) for name in one.noise]
    pairs += [(one.feature_m[name], other.feature_m[name]) for name in one.feature_m]
    return all(abs(np.log(first / second)) < _SAME for first, second in pairs)


def _sizes(hyper: FloatArray, feature_m: Mapping[str, float], noise: Mapping[str, float]) -> Sizes:
    turn, shift, smooth_turn, smooth_shift, stretch = (float(one) for one in np.exp(hyper[:-1]))
    return Sizes(turn, shift, smooth_turn, smooth_shift, stretch, feature_m, noise)


def _stepped(
    state: BenchState, normal: Normal, layout: Layout, prior: Prior, hyper: FloatArray, sizes: Sizes
) -> tuple[BenchState, Normal, Posterior, float]:
    """One Gauss-Newton step, halved where it leads uphill; also how long it was, in sigmas of the worst unknown."""
    width = layout.size * np.exp(prior.mixed_features @ hyper)
    cost = _cost(state, layout, width, sizes, normal)
    found = _solved(normal, layout, prior, hyper)
    vector = found.mixed_mean * layout.size
    before = np.concatenate([state.deviation(key) for key in layout.where])
    step = layout.steps(vector - before)
    features = normal.features_at(vector)
    for name, shape in state.shape.items():
        step["features", name] = (features[name] - shape.place).ravel()
    sigma = layout.size * np.sqrt(np.diag(found.side_covariance))
    away = float(np.max(np.abs(vector - before) / sigma))
    for _ in range(_HALVINGS):
        tried = state.moved(step)
        now = _sound(tried, layout, sizes)
        # Features that a step carries out of a camera's sight cost nothing, and are no gain.
        if (
            now is not None
            and now.count >= normal.count
            and _cost(tried, layout, width, sizes, now) <= cost * (1.0 + _ROUNDING)
        ):
            return tried, now, found, away
        step = {key: 0.5 * each for key, each in step.items()}
    return state, normal, found, 0.0


def _sound(state: BenchState, layout: Layout, sizes: Sizes) -> Normal | None:
    """The normal equations; None where a board is so near a camera that they are not finite."""
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
    """Huber's loss in units of sigma squared, with the squares of what has a prior."""
    before = np.concatenate([state.deviation(key) for key in layout.where])
    features = sum(float(np.sum(shape.place**2)) / sizes.feature_m[name] ** 2 for name, shape in state.shape.items())
    return normal.loss + float(np.sum((before / width) ** 2)) + features


def _noise(normal: Normal, sizes: Sizes, found: Posterior) -> dict[str, float]:
    """Factor on the stated sigmas, by camera."""
    known = found.determined + sum(normal.determined_features(name, sizes.feature_m[name]) for name in normal.features)
    free = max(1.0 - known / max(normal.count, 1), 0.1)
    return {
        name: float(
            sizes.noise[name] * np.sqrt(max(normal.chi_square[name], 1e-12) / max(free * normal.values[name], 1.0))
        )
        if normal.values[name]
        else sizes.noise[name]
        for name in normal.chi_square
    }


def _feature_size(state: BenchState, name: str, normal: Normal, sizes: Sizes) -> float:
    """The next standard deviation of the features' errors (MacKay's fixed point, see `numerics.evidence`)."""
    size = sizes.feature_m[name]
    if name not in normal.features:
        return size
    determined = max(normal.determined_features(name, size), 1.0)
    found = np.sqrt(float(np.sum(state.shape[name].place ** 2)) / determined)
    return float(np.clip(found, max(size / _FEATURES_CHANGE, 1e-7), min(size * _FEATURES_CHANGE, 1e-3)))


def _best_hyper(normal: Normal, layout: Layout, prior: Prior, hyper: FloatArray, everywhere: bool) -> FloatArray:
    """Hyperparameters of greatest evidence. Unknowns that meet no error of the stage are integrated out first."""
    gone_keys = [key for key in layout.where if key[0] in ("board pose", "lens")]
    gone = layout.columns(gone_keys)
    kept = np.setdiff1d(np.arange(len(layout.size)), gone)
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
    others = _STARTS if everywhere else ()
    starts += [
        starts[0] | {name: np.log(size) for name, size in zip(HYPER[:-1], other, strict=True)} for other in others
    ]
    best = maximise(rest, smaller, starts)
    return np.array([best.hyper[name] for name in HYPER])


_STARTS = ((1e-6, 5e-7, 1e-5, 1e-6, 1e-5), (5e-5, 1e-5, 1e-4, 1e-5, 1e-3))

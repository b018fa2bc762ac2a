"""The unknowns of a bench: their places in one vector, and what is known of them before the photographs are read."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from wlr_render import usual
from wlr_render.calibration.bench.board_views import TRACKING, CameraSetup, KnownPose
from wlr_render.calibration.bench.state import AXIS_PARTS, BenchState, Key, smooth_orders, stated_twist
from wlr_render.captures.photo_session import StageAxis
from wlr_render.geometry.lens import Lens
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.evidence import Prior

FLAT, EXACT = 10.0, 1e-9
"""Prior sizes of what is not known beforehand, and of what counts as exact: radians, metres, per unit."""
USUAL_SIZES = {
    "turn": usual.STAGE_TURN_RAD,
    "shift": usual.STAGE_REPEATABILITY_M,
    "smooth turn": usual.STAGE_SMOOTH_TURN_RAD,
    "smooth shift": usual.STAGE_SMOOTH_SHIFT_M,
    "stretch": usual.BOARD_STRETCH,
}
"""Sizes of ordinary benches by hyperparameter."""
_LEAST, _MOST = 1e-9, 1e-2  # bounds of sizes, radians, metres or ratios: exact, and no stage or board
_DECAY = 0.5  # factor of the smooth error's size from one degree to the next: rails bend more than they wave
_POWERS = {"k1": 2, "k2": 4, "k3": 6, "k4": 2, "k5": 4, "k6": 6, "s2": 3, "s4": 3}
"""Power of the distance from the centre with which a term displaces, relative to that distance; 1 for the others."""
_NOISE_DIFFERS = 0.3  # sigma of the logarithm of a camera's noise over the stated one, which detection measures


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
        """Return the vector by block."""
        return {key: vector[where] for key, where in self.where.items()}


HYPER = (*USUAL_SIZES, "noise")
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
        add(("focus", number), np.array([usual.CAMERA_FOCUS_BREATHING.value]))
    for number in state.targets:
        add(("target", number), _pose_sizes(seen.targets.get(number)))
    if seen.device_from_tracking is not None:
        add(("extrinsics", TRACKING), _pose_sizes(seen.device_from_tracking))
    for number in state.base:
        add(("base", number), _pose_sizes(seen.device_from_camera if number == state.first_mounting else None))
    for number, axis in enumerate(seen.axes):
        add(("axis", number), _axis_sizes(axis, stated_twist(axis, state.base[state.first_mounting])))
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
    if setup.calibrated is not None:
        return np.zeros(len(lens.values)) if setup.calibrated_sigma is None else setup.calibrated_sigma
    sizes = np.full(len(lens.values), 0.3 * float(np.mean(lens.focal_px)))
    # A term may be as large as to displace the corner of the picture by its distance from the centre.
    corner = float(np.linalg.norm(0.5 * np.array(lens.size_px) / lens.focal_px))
    sizes[4:] = [max(1.0, corner ** -_POWERS.get(name, 1)) for name in lens.names[4:]]
    return sizes


def _pose_sizes(known: KnownPose | None) -> FloatArray:
    return np.full(6, FLAT) if known is None else np.repeat(known.sigma, 3)


def _axis_sizes(axis: StageAxis, stated: FloatArray) -> FloatArray:
    """(6,) of the twist of an axis that is `stated` (6,): its scale along it, its direction's sigma across."""
    sizes = np.full(6, FLAT)
    if axis.kind == "linear":
        sizes[:3] = EXACT
    if axis.direction is not None:
        along = stated[AXIS_PARTS[axis.kind]] ** 2
        sigma = usual.STAGE_DIRECTION_RAD.value if axis.direction_sigma is None else axis.direction_sigma
        sizes[AXIS_PARTS[axis.kind]] = np.sqrt(usual.STAGE_SCALE.value**2 * along + sigma**2 * (1.0 - along))
    if axis.direction is not None and axis.pivot is not None:
        sizes[3:] = usual.STAGE_PIVOT_M.value
    return sizes


def _smooth_sizes(order: Sequence[int], axes: Sequence[StageAxis]) -> FloatArray:
    """Of one term of the smooth error; the linear motion of an axis is its twist's."""
    sizes = np.full(6, _DECAY ** (sum(order) - 1))
    if sum(order) == 1:
        moved = next(axis for axis, each in zip(axes, order, strict=True) if each)
        sizes[slice(0 if moved.kind == "rotary" else 3, 6)] = EXACT
    return sizes


def prior_of(layout: Layout) -> Prior:
    """Prior of the unknowns of `layout`, by the hyperparameters `HYPER`."""
    features = np.zeros((len(layout.size), len(HYPER)))
    rows = np.flatnonzero(layout.hyper >= 0)
    features[rows, layout.hyper[rows]] = 1.0
    bounds = [(np.log(_LEAST), np.log(_MOST))] * 5 + [(-2.0, 2.0)]
    expected = [(np.log(size.value), size.log_sigma) for size in USUAL_SIZES.values()] + [(0.0, _NOISE_DIFFERS)]
    none = np.zeros((0, len(HYPER)))
    return Prior(HYPER, np.array(bounds), np.array(expected), none, features, none)

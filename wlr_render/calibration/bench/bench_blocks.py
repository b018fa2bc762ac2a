"""Unknowns of a bench in blocks: value, prior, source of error, and effect of a step on the value.

`BenchState` has the values, and `Layout` has the place of each block in the vector of unknowns, with its prior. The
functions `..._block` state the priors.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

import numpy as np

from wlr_render import usual
from wlr_render.calibration.bench.board_shape import BOARD_SHAPE, BoardShape
from wlr_render.calibration.bench.board_views import EYEBALL, CameraSetup, KnownPose
from wlr_render.calibration.poses import motion_between, small_motion
from wlr_render.captures.boards.board import BoardTolerances
from wlr_render.captures.photo_session import StageAxis
from wlr_render.error_sources import ErrorSource
from wlr_render.geometry import transforms
from wlr_render.geometry.directions import ARCMIN
from wlr_render.lenses.lens import Lens
from wlr_render.lenses.lens_camera import LensCamera
from wlr_render.lenses.residual_lens import RESIDUAL, ResidualLens
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.evidence import Prior

Key = tuple[str, int | str]
"""Name of a block of unknowns: kind, and camera, board, target, axis, place or view."""
EXACT = 1e-9
"""Prior size of exact unknowns: radians, metres, per unit."""
FEATURES = "features"
"""Kind of blocks that are integrated out one feature at a time, and that have no place in a `Layout`."""
USUAL_SIZES = {
    "turn": usual.STAGE_TURN_RAD,
    "shift": usual.STAGE_REPEATABILITY_M,
    "smooth turn": usual.STAGE_SMOOTH_TURN_RAD,
    "smooth shift": usual.STAGE_SMOOTH_SHIFT_M,
    "screw": usual.STAGE_SCREW_M,
    "stretch": usual.BOARD_STRETCH,
    "residual": usual.CAMERA_LENS_PX,
    "print": usual.BOARD_PRINT_M,
    "height": usual.BOARD_HEIGHT_M,
    "drift": replace(usual.CAMERA_DRIFT_ARCMIN, value=usual.CAMERA_DRIFT_ARCMIN.value * ARCMIN, unit="rad"),
}
"""Sizes of ordinary benches by hyperparameter."""
FALL = "smooth fall"
"""Hyperparameter for the decrease of the log size of the stage's smooth errors from degree to degree."""
_BOUNDS = np.log(1e-9), np.log(1e-2)  # bounds of sizes in radians, metres or ratios: exact, worse than any bench
_BOUNDS_PX = np.log(1e-4), np.log(3.0)  # bounds of sizes in pixels: far below noise, a lens of another kind
_HYPERPRIORS = {
    **{
        name: (np.log(each.value), each.log_sigma, *(_BOUNDS_PX if each.unit == "px" else _BOUNDS))
        for name, each in USUAL_SIZES.items()
    },
    FALL: (0.7, 0.3, 0.1, 2.0),  # rail errors halve with each degree
    "noise": (0.0, 0.3, -2.0, 2.0),  # common factor in the search for sizes; `Sizes.noise` has a factor for each camera
}
"""Prior mean, prior sigma and bounds of each hyperparameter."""
HYPER = tuple(_HYPERPRIORS)
SMOOTH_DEGREE = 3
"""Degree of a stage axis' smooth error as a polynomial of the reading."""
AXIS_PARTS = {"linear": slice(3, 6), "rotary": slice(0, 3)}
"""Part of an axis' twist that is a vector along the axis."""
FLAT = 10.0
"""Prior size of an unknown without prior knowledge: radians, metres, per unit."""
TURNS = np.repeat([1.0, 0.0], 3)
"""Indicator of the rotations among the six parts of a motion."""
_NO_HYPER: Mapping[str, Any] = {}
_POWERS = {"k1": 2, "k2": 4, "k3": 6, "k4": 2, "k5": 4, "k6": 6, "s2": 3, "s4": 3}
"""Power of the distance from the centre in a term's displacement, relative to this distance; 1 for other terms."""
_HELD = ("k4", "k5", "k6", "s1", "s2", "s3", "s4")  # terms of perspective lenses that a residual field replaces
_LIKE_A_TURN = ("s1", "s3")  # terms confusable with p1, p2 and a turn; a residual of 0.1 px turns the camera by 30'


@dataclass(frozen=True)
class Chart:
    """Parametrisation of small steps of one kind of value.

    Attributes:
        moved: (value, step (k,)) -> value.
        apart: (middle of the prior, value) -> step (k,) from the middle to the value.
    """

    moved: Callable[[Any, FloatArray], Any]
    apart: Callable[[Any, Any], FloatArray]


def _motion_after(nominal: FloatArray, pose: FloatArray) -> FloatArray:
    """Return the small motion m (6,) with pose = nominal @ small_motion(m)."""
    return motion_between(np.eye(4), transforms.inverse(nominal) @ pose)


NUMBERS = Chart(lambda value, step: value + step.reshape(value.shape), lambda middle, value: (value - middle).ravel())
POSE = Chart(lambda pose, step: pose @ small_motion(step), _motion_after)
HELD_POSE = Chart(lambda pose, step: small_motion(step) @ pose, motion_between)
"""Steps of a pose in its source frame (`POSE`) or in its target frame."""
LENS = Chart(
    lambda lens, step: lens.with_values(lens.values + step), lambda middle, lens: np.asarray(lens.values - middle)
)


@dataclass(frozen=True, eq=False)
class Block:
    """Unknowns of a bench that belong together.

    Attributes:
        value: numbers, a pose (4, 4), or a lens.
        size: (k,) prior sizes; for unknowns with a hyperparameter, multiples of the hyperparameter's size.
        middle: middle of the prior, like `value`, or the values of a lens. NaN or None without prior knowledge.
        hyper: (k,) or a number, change of the logarithm of each prior size by a hyperparameter, by name.
        source: source of errors common to all captures, in an error budget; None for errors of one photograph.
        chart: parametrisation of steps of the value.
    """

    value: Any
    size: FloatArray
    middle: Any = None
    hyper: Mapping[str, Any] = field(default_factory=dict)
    source: ErrorSource | None = None
    chart: Chart = NUMBERS

    def moved(self, step: FloatArray) -> "Block":
        """Return the block after a step (k,)."""
        return replace(self, value=self.chart.moved(self.value, step))

    @property
    def deviation(self) -> FloatArray:
        """Step (k,) from the middle of the prior to the value; zero without prior knowledge."""
        if self.middle is None:
            return np.zeros(len(self.size))
        return np.nan_to_num(self.chart.apart(self.middle, self.value))


@dataclass(frozen=True)
class Sizes:
    """Variance components of a bench.

    Attributes:
        by: standard deviations per axis, by the names in `USUAL_SIZES`.
        feature_m: error of a feature beyond the smooth field, by board.
        noise: factor on the stated sigma of the features, by camera.
    """

    by: Mapping[str, float]
    feature_m: Mapping[str, float]
    noise: Mapping[str, float]

    @classmethod
    def of(cls, hyper: FloatArray, feature_m: Mapping[str, float], noise: Mapping[str, float]) -> "Sizes":
        """Return the sizes from the hyperparameters, which are logarithms of the sizes."""
        values = dict(zip(HYPER, map(float, hyper), strict=True))
        return cls({name: float(np.exp(values[name])) for name in USUAL_SIZES}, feature_m, noise)

    def __getitem__(self, name: str) -> float:
        return self.by[name]

    @property
    def visit(self) -> FloatArray:
        """Sizes (6,) of the stage's random error in each visit: rotation (rad), then position (m)."""
        return np.repeat([self["turn"], self["shift"]], 3)


@dataclass(frozen=True, eq=False)
class Layout:
    """Columns of each block in the vector of unknowns, and the prior of this vector.

    Attributes:
        where: columns of each block.
        size: (unknowns,) prior sizes; for unknowns with a hyperparameter, multiples of the hyperparameter's size.
        features: (unknowns, hyperparameters) change of the logarithms of the prior sizes by each of `HYPER`.
    """

    where: Mapping[Key, slice]
    size: FloatArray
    features: FloatArray

    @classmethod
    def of(cls, blocks: Mapping[Key, Block]) -> "Layout":
        """Return the layout of all blocks except `FEATURES`."""
        where: dict[Key, slice] = {}
        size: list[FloatArray] = []
        features: list[FloatArray] = []
        for key, block in blocks.items():
            if key[0] == FEATURES:
                continue
            start = sum(map(len, size))
            where[key] = slice(start, start + len(block.size))
            size.append(np.maximum(block.size, EXACT))
            features.append(np.zeros((len(block.size), len(HYPER))))
            for name, change in block.hyper.items():
                features[-1][:, HYPER.index(name)] = change
        return cls(where, np.concatenate(size), np.concatenate(features))

    @property
    def has_sizes(self) -> bool:
        """True if the size of any unknown is estimated from the views."""
        return bool(np.any(self.features))

    def columns(self, keys: Sequence[Key]) -> IntArray:
        """Return the columns of some blocks, in the order of `keys`."""
        parts = [np.arange(self.where[key].start, self.where[key].stop) for key in keys]
        return np.concatenate(parts) if parts else np.zeros(0, np.int64)

    def steps(self, vector: FloatArray) -> dict[Key, FloatArray]:
        """Return the parts of a vector of unknowns, by block."""
        return {key: vector[where] for key, where in self.where.items()}

    @property
    def prior(self) -> Prior:
        """Prior of the unknowns as a function of the hyperparameters `HYPER`."""
        table, none = np.array(list(_HYPERPRIORS.values())), np.zeros((0, len(HYPER)))
        return Prior(HYPER, table[:, 2:], table[:, :2], none, self.features, none)


def numbers_block(size: FloatArray, hyper: Mapping[str, Any] = _NO_HYPER, source: ErrorSource | None = None) -> Block:
    """Return a block of numbers that are zero on an exact bench."""
    return Block(np.zeros(size.shape), size, np.zeros(size.shape), hyper, source)


def lens_block(name: str, lens: Lens, setup: CameraSetup) -> Block:
    """Return the block of the lens of a camera."""
    source = lens_source(name)
    if setup.calibrated is not None:
        known = np.zeros(len(lens.values)) if setup.calibrated_sigma is None else setup.calibrated_sigma
        return Block(lens, known, setup.calibrated.values, source=source, chart=LENS)
    sizes, hyper = np.full(len(lens.values), 0.3 * float(np.mean(lens.focal_px))), {}
    # The largest term displaces the corner of the picture by the corner's distance from the centre.
    corner = float(np.linalg.norm(0.5 * np.array(lens.size_px) / lens.focal_px))
    sizes[4:] = [
        EXACT if term in _LIKE_A_TURN else max(1.0, corner ** -_POWERS.get(term, 1)) for term in lens.names[4:]
    ]
    middle = np.where(np.arange(len(sizes)) < 4, np.nan, 0.0)
    if isinstance(lens, ResidualLens):
        held = np.isin(lens.names, _HELD) & (lens.kind != "fisheye")
        sizes[held], middle[held] = EXACT, lens.values[held]
        sizes[-lens.residual_px.size :] = np.repeat(lens.field.sizes, 2)
        hyper["residual"] = np.array(lens.names) == RESIDUAL
    return Block(lens, sizes, middle, hyper, source, LENS)


def lens_source(name: str) -> ErrorSource:
    """Return the source of the errors of a camera's lens."""
    return ErrorSource.LENS if name == EYEBALL else ErrorSource.TRACKING_CAMERA


def with_residual(lens: Lens, setup: CameraSetup) -> Lens:
    """Return a lens with a residual field for the fit to estimate; a stated lens stays unchanged."""
    return ResidualLens.of(lens) if isinstance(lens, LensCamera) and setup.calibrated is None else lens


def shape_block(shape: BoardShape, tolerances: BoardTolerances) -> Block:
    """Return the block of the shape of a board."""
    size = np.zeros(len(shape.low))
    size[: len(BOARD_SHAPE)] = [tolerances.flatness_m] * 3 + [tolerances.scale_sigma] * 3
    if shape.fields is None:
        return numbers_block(size, source=ErrorSource.BOARD)
    height, printed = shape.fields
    end = len(BOARD_SHAPE) + len(height)
    size[len(BOARD_SHAPE) : end], size[end:] = height.sizes, np.tile(printed.sizes, 2)
    number = np.arange(len(size))
    hyper = {"height": (number >= len(BOARD_SHAPE)) & (number < end), "print": number >= end}
    return numbers_block(size, hyper, ErrorSource.BOARD)


def pose_block(pose: FloatArray, known: KnownPose | None, source: ErrorSource) -> Block:
    """Return the block of a pose (4, 4) with its prior."""
    if known is None:
        return Block(pose, np.full(6, FLAT), source=source, chart=POSE)
    return Block(pose, np.repeat(known.sigma, 3), known.pose, source=source, chart=POSE)


def axis_block(axis: StageAxis, twist: FloatArray, base: FloatArray) -> Block:
    """Return the block of an axis, with a prior of the scale along it and of the direction across it.

    Args:
        axis: the stated axis. twist: (6,) starting value. base: (4, 4) device_from_camera in the first mounting.
    """
    stated = stated_twist(axis, base)
    sizes = np.full(6, FLAT)
    if axis.kind == "linear":
        sizes[:3] = EXACT
    if axis.direction is not None:
        along = stated[AXIS_PARTS[axis.kind]] ** 2
        sigma = usual.STAGE_DIRECTION_RAD.value if axis.direction_sigma is None else axis.direction_sigma
        sizes[AXIS_PARTS[axis.kind]] = np.sqrt(usual.STAGE_SCALE.value**2 * along + sigma**2 * (1.0 - along))
    if axis.direction is not None and axis.pivot is not None:
        sizes[3:] = usual.STAGE_PIVOT_M.value
    return Block(twist, sizes, source=ErrorSource.STAGE)


def stage_error_blocks(axes: Sequence[StageAxis]) -> dict[Key, Block]:
    """Return the blocks of the stage's smooth error, without linear motions, which the axes' twists describe."""
    blocks: dict[Key, Block] = {}
    for (number, axis), degree in product(enumerate(axes), range(1, SMOOTH_DEGREE + 1)):
        sizes = np.ones(6)
        if degree == 1:
            sizes[slice(0 if axis.kind == "rotary" else 3, 6)] = EXACT
        hyper = {"smooth turn": TURNS, "smooth shift": 1.0 - TURNS, FALL: 1.0 - degree}
        blocks["smooth", number * SMOOTH_DEGREE + degree - 1] = numbers_block(sizes, hyper, ErrorSource.STAGE)
    return blocks


def stated_twist(axis: StageAxis, base: FloatArray) -> FloatArray:
    """Return the twist (6,) of an axis, camera frame, from stated direction and pivot; zero for parts not stated.

    Args:
        axis: axis of the stage. base: (4, 4) device_from_camera at the stage's reference.
    """
    twist = np.zeros(6)
    if axis.is_in_camera:
        base = np.eye(4)
    if axis.direction is not None:
        twist[AXIS_PARTS[axis.kind]] = base[:3, :3].T @ axis.direction
    if axis.direction is not None and axis.pivot is not None:
        twist[3:] = np.cross(transforms.apply(transforms.inverse(base), axis.pivot), twist[:3])
    return twist

"""A table of the unknowns of a bench: value, prior and source of error of each block, and how a step moves it.

`BenchState` has the values, and a `Layout` the place of each block in the vector of unknowns, with its prior.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from wlr_render import usual
from wlr_render.calibration.poses import motion_between, small_motion
from wlr_render.geometry import transforms
from wlr_render.geometry.directions import ARCMIN
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.evidence import Prior

Key = tuple[str, int | str]
"""Name of a block of unknowns: its kind, and its camera, board, target, axis, place or view."""
EXACT = 1e-9
"""Prior size of what counts as exact: radians, metres, per unit."""
FEATURES = "features"
"""Blocks of this name are integrated out one feature at a time; they have no place in a `Layout`."""
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
"""Hyperparameter: fall of the logarithm of the stage's smooth errors from one degree to the next."""
_BOUNDS = np.log(1e-9), np.log(1e-2)  # sizes in radians, metres or ratios, from exact to worse than any stage or board
_BOUNDS_PX = np.log(1e-4), np.log(3.0)  # sizes in pixels, from far below noise to a lens of another kind
_HYPERPRIORS = {
    **{
        name: (np.log(each.value), each.log_sigma, *(_BOUNDS_PX if each.unit == "px" else _BOUNDS))
        for name, each in USUAL_SIZES.items()
    },
    FALL: (0.7, 0.3, 0.1, 2.0),  # rails bend more than they wave: by a factor of 2 with each degree
    "noise": (0.0, 0.3, -2.0, 2.0),  # common factor in the search for sizes; `Sizes.noise` has one for each camera
}
"""Prior mean and sigma of each hyperparameter, and its bounds."""
HYPER = tuple(_HYPERPRIORS)


@dataclass(frozen=True)
class Chart:
    """Steps of one kind of value.

    Attributes:
        moved: value, step (k,) -> value.
        apart: middle of the prior, value -> the step (k,) between them.
    """

    moved: Callable[[Any, FloatArray], Any]
    apart: Callable[[Any, Any], FloatArray]


def _motion_after(nominal: FloatArray, pose: FloatArray) -> FloatArray:
    """(6,) small motion m with pose = nominal @ small_motion(m)."""
    return motion_between(np.eye(4), transforms.inverse(nominal) @ pose)


NUMBERS = Chart(lambda value, step: value + step.reshape(value.shape), lambda middle, value: (value - middle).ravel())
POSE = Chart(lambda pose, step: pose @ small_motion(step), _motion_after)
HELD_POSE = Chart(lambda pose, step: small_motion(step) @ pose, motion_between)
"""Steps of a pose in the frame from which it maps, or to which it maps."""
LENS = Chart(
    lambda lens, step: lens.with_values(lens.values + step), lambda middle, lens: np.asarray(lens.values - middle)
)


@dataclass(frozen=True, eq=False)
class Block:
    """Unknowns of a bench that belong together.

    Attributes:
        value: numbers, a pose (4, 4), or a lens.
        size: (k,) prior sizes; of unknowns with a hyperparameter, multiples of its size.
        middle: of the prior, like `value`, of a lens its values. NaN or None where nothing is known beforehand.
        hyper: (k,) or a number, change of the logarithm of each prior size by a hyperparameter, by its name.
        source: of the errors that all captures share, as a budget names it; "" of errors of one photograph.
        chart: how steps move the value.
    """

    value: Any
    size: FloatArray
    middle: Any = None
    hyper: Mapping[str, Any] = field(default_factory=dict)
    source: str = ""
    chart: Chart = NUMBERS

    def moved(self, step: FloatArray) -> "Block":
        """Return the block after a step (k,)."""
        return replace(self, value=self.chart.moved(self.value, step))

    @property
    def deviation(self) -> FloatArray:
        """(k,) step from the middle of the prior to the value; zero where nothing is known beforehand."""
        if self.middle is None:
            return np.zeros(len(self.size))
        return np.nan_to_num(self.chart.apart(self.middle, self.value))


@dataclass(frozen=True)
class Sizes:
    """Variance components of a bench.

    Attributes:
        by: standard deviations per axis of the errors that `USUAL_SIZES` names.
        feature_m: error of a feature on each board beyond its smooth field.
        noise: factor on the stated sigma of the features, by camera.
    """

    by: Mapping[str, float]
    feature_m: Mapping[str, float]
    noise: Mapping[str, float]

    @classmethod
    def of(cls, hyper: FloatArray, feature_m: Mapping[str, float], noise: Mapping[str, float]) -> "Sizes":
        """Return the sizes by the hyperparameters, logarithms of the sizes."""
        values = dict(zip(HYPER, map(float, hyper), strict=True))
        return cls({name: float(np.exp(values[name])) for name in USUAL_SIZES}, feature_m, noise)

    def __getitem__(self, name: str) -> float:
        return self.by[name]

    @property
    def visit(self) -> FloatArray:
        """(6,) random error of the stage in each visit: rotation (rad), then position (m)."""
        return np.repeat([self["turn"], self["shift"]], 3)


@dataclass(frozen=True, eq=False)
class Layout:
    """Columns of each block of unknowns in one vector, and its prior.

    Attributes:
        where: columns of each block.
        size: (unknowns,) prior sizes, of those with a hyperparameter as a multiple of it.
        features: (unknowns, hyperparameters) change of the logarithms of the prior sizes by each of `HYPER`.
    """

    where: Mapping[Key, slice]
    size: FloatArray
    features: FloatArray

    @classmethod
    def of(cls, blocks: Mapping[Key, Block]) -> "Layout":
        """Return the places of all blocks but `FEATURES`."""
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
        """True if the views find the size of any unknown."""
        return bool(np.any(self.features))

    def columns(self, keys: Sequence[Key]) -> IntArray:
        """Columns of some blocks, one after the other."""
        parts = [np.arange(self.where[key].start, self.where[key].stop) for key in keys]
        return np.concatenate(parts) if parts else np.zeros(0, np.int64)

    def steps(self, vector: FloatArray) -> dict[Key, FloatArray]:
        """Return the vector by block."""
        return {key: vector[where] for key, where in self.where.items()}

    @property
    def prior(self) -> Prior:
        """Prior of the unknowns, by the hyperparameters `HYPER`."""
        table, none = np.array(list(_HYPERPRIORS.values())), np.zeros((0, len(HYPER)))
        return Prior(HYPER, table[:, 2:], table[:, :2], none, self.features, none)

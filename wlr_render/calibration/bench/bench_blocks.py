"""A table of the unknowns of a bench: value, prior and source of error of each block, and how a step moves it.

`BenchState` has the values, and a `Layout` the place of each block in the vector of unknowns, with its prior.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from wlr_render import usual
from wlr_render.calibration.poses import motion_between, small_motion
from wlr_render.geometry import transforms
from wlr_render.geometry.lens import Lens
from wlr_render.geometry.lens_camera import LensCamera
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.evidence import Prior

Key = tuple[str, int | str]
"""Name of a block of unknowns: what it is, and of which camera, board, target, axis, place or view."""
EXACT = 1e-9
"""Prior size of what counts as exact: radians, metres, per unit."""
FEATURES = "features"
"""Blocks of this name are integrated out one feature at a time; they have no place in a `Layout`."""
USUAL_SIZES = {
    "turn": usual.STAGE_TURN_RAD,
    "shift": usual.STAGE_REPEATABILITY_M,
    "smooth turn": usual.STAGE_SMOOTH_TURN_RAD,
    "smooth shift": usual.STAGE_SMOOTH_SHIFT_M,
    "stretch": usual.BOARD_STRETCH,
}
"""Sizes of ordinary benches by hyperparameter."""
HYPER = (*USUAL_SIZES, "noise")
_LEAST, _MOST = 1e-9, 1e-2  # bounds of sizes, radians, metres or ratios: exact, and no stage or board
_NOISE_DIFFERS = 0.3  # sigma of the logarithm of a camera's noise over the stated one, which detection measures


@dataclass(frozen=True)
class Chart:
    """Steps of one kind of value.

    Attributes:
        moved: value, step (k,) -> value.
        apart: middle of the prior, value -> the step (k,) between them.
    """

    moved: Callable[[Any, FloatArray], Any]
    apart: Callable[[Any, Any], FloatArray]


def _moved_lens(lens: Lens, step: FloatArray) -> Lens:
    return lens.with_values(lens.values + step) if isinstance(lens, LensCamera) else lens


def _motion_after(nominal: FloatArray, pose: FloatArray) -> FloatArray:
    """(6,) small motion m with pose = nominal @ small_motion(m)."""
    return motion_between(np.eye(4), transforms.inverse(nominal) @ pose)


NUMBERS = Chart(lambda value, step: value + step.reshape(value.shape), lambda middle, value: (value - middle).ravel())
POSE = Chart(lambda pose, step: pose @ small_motion(step), _motion_after)
HELD_POSE = Chart(lambda pose, step: small_motion(step) @ pose, motion_between)
"""Steps of a pose in the frame from which it maps, or to which it maps."""
LENS = Chart(_moved_lens, lambda middle, lens: np.asarray(lens.values - middle))


@dataclass(frozen=True, eq=False)
class Block:
    """Unknowns of a bench that belong together.

    Attributes:
        value: numbers, a pose (4, 4), or a lens.
        size: (k,) prior sizes; of unknowns with a hyperparameter, multiples of its size.
        middle: of the prior, like `value`, of a lens its values. NaN or None where nothing is known beforehand.
        hyper: (k,) name of the hyperparameter of each unknown; empty without any.
        source: of the errors that all captures share, as a budget names it; "" of errors of one photograph.
        chart: how steps move the value.
    """

    value: Any
    size: FloatArray
    middle: Any = None
    hyper: Sequence[str] = ()
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
        where: columns of each block.
        size: (unknowns,) prior sizes, of those with a hyperparameter as a multiple of it.
        hyper: (unknowns,) index into `HYPER`, or -1.
    """

    where: Mapping[Key, slice]
    size: FloatArray
    hyper: IntArray

    @classmethod
    def of(cls, blocks: Mapping[Key, Block]) -> "Layout":
        """Return the places of all blocks but `FEATURES`."""
        where: dict[Key, slice] = {}
        size: list[FloatArray] = []
        hyper: list[int] = []
        for key, block in blocks.items():
            if key[0] == FEATURES:
                continue
            where[key] = slice(len(hyper), len(hyper) + len(block.size))
            size.append(np.maximum(block.size, EXACT))
            hyper += [HYPER.index(name) for name in block.hyper] or [-1] * len(block.size)
        return cls(where, np.concatenate(size), np.array(hyper, dtype=np.int64))

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

    @property
    def prior(self) -> Prior:
        """Prior of the unknowns, by the hyperparameters `HYPER`."""
        features = np.zeros((len(self.size), len(HYPER)))
        rows = np.flatnonzero(self.hyper >= 0)
        features[rows, self.hyper[rows]] = 1.0
        bounds = [(np.log(_LEAST), np.log(_MOST))] * len(USUAL_SIZES) + [(-2.0, 2.0)]
        expected = [(np.log(size.value), size.log_sigma) for size in USUAL_SIZES.values()] + [(0.0, _NOISE_DIFFERS)]
        none = np.zeros((0, len(HYPER)))
        return Prior(HYPER, np.array(bounds), np.array(expected), none, features, none)

"""How the stage carries the camera, from photographs of a board that stands still.

On an ideal stage the camera keeps its orientation, so that with the stage displaced by `d = reading - reference` the
board is seen at `camera_from_target(reading) = translation(-axes @ d) @ camera_from_target(reference)`. A real stage
departs from that in position and in orientation; how much, is estimated as well. All photographs are fitted together
by generalised least squares, as their errors share those of the lens.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from wlr_render.calibration.board_views import BoardPoses
from wlr_render.calibration.poses import Pose
from wlr_render.calibration.stage_faults import outsider, target_step
from wlr_render.calibration.stage_problem import STILL, Jitter, StageProblem, with_jitter
from wlr_render.errors import BadInputError
from wlr_render.numerics.arrays import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class TargetMoved:
    """A target that was moved between the photographs `before` and `after`, by a small motion (6,), camera frame."""

    before: str
    after: str
    motion: FloatArray


@dataclass(frozen=True, eq=False)
class StageFit:
    """A straight stage.

    Attributes:
        reference: (3,) the reading that poses are given at, the middle of all readings.
        travel: the largest range of the readings of an axis.
        moved: (m,) indices of the axes whose readings changed.
        axes: (3, m) camera frame: true displacement per reading of each moved axis, metres per metre.
        camera_from_target: target pose number -> (4, 4) at the reference.
        covariance: (3 m + 6 k, 3 m + 6 k) of the axes, one after the other, and of small motions of the k poses in the
            camera's frame.
        jitter: repeatability of the camera about the straight motion, beyond the noise of the dots; it is in the
            covariance.
        names: n photographs that were fitted.
        residual: (n, 6) small motion in the camera's frame from the fitted pose to the one seen.
        set_aside: photograph -> (6,) by how much it does not fit the others.
        target_moved: where the target was moved meanwhile, if that is why the photographs do not fit.
    """

    reference: FloatArray
    travel: float
    moved: IntArray
    axes: FloatArray
    camera_from_target: dict[int, FloatArray]
    covariance: FloatArray
    jitter: Jitter
    names: tuple[str, ...]
    residual: FloatArray
    set_aside: dict[str, FloatArray] = field(default_factory=dict)
    target_moved: TargetMoved | None = None

    def displacement(self, reading: FloatArray) -> FloatArray:
        """(..., 3) readings -> (..., 3) metres from the reference, camera frame.

        Raises:
            BadInputError: a reading of an axis that no photograph without the headset moved.
        """
        apart = np.asarray(reading, dtype=np.float64) - self.reference
        held = np.setdiff1d(np.arange(3), self.moved)
        off = np.abs(apart).reshape(-1, 3).max(axis=0)[held]
        if np.any(off > STILL * self.travel):
            axis = "xyz"[held[np.argmax(off)]]
            raise BadInputError(
                f"stage readings move axis {axis}, along which no photograph without the headset was taken; take some."
            )
        return np.asarray(apart[..., self.moved] @ self.axes.T)

    @property
    def out_of_plane_m(self) -> float:
        """Rms distance of the camera from the plane of two axes; NaN unless two moved."""
        if len(self.moved) != 2:
            return np.nan
        normal = np.cross(self.axes[:, 0], self.axes[:, 1])
        return float(np.sqrt(np.mean((self.residual[:, 3:] @ normal / np.linalg.norm(normal)) ** 2)))

    def pose(self, target: int) -> Pose:
        """camera_from_target at the reference."""
        start = 3 * len(self.moved) + 6 * list(self.camera_from_target).index(target)
        rows = slice(start, start + 6)
        return Pose(self.camera_from_target[target], self.covariance[rows, rows])


def fit_stage(seen: BoardPoses, target: Sequence[int], reading: FloatArray) -> StageFit:
    """Fit straight axes to photographs of a board taken without the headset.

    Args:
        seen: n photographs and the poses of the board in them.
        target: n, the number of the target pose that each shows.
        reading: (n, 3) stage readings, metres.

    Raises:
        BadInputError: too few photographs, or axes that were only moved together.
    """
    reading = np.asarray(reading, dtype=np.float64)
    moved = _moved(reading)
    reference = 0.5 * (reading.min(axis=0) + reading.max(axis=0))
    numbers, index = np.unique(np.asarray(target, dtype=np.int64), return_inverse=True)
    problem = StageProblem(seen.camera_from_board, seen.covariance, index, (reading - reference)[:, moved])
    if not problem.determined or problem.freedom <= 0:
        raise BadInputError(
            f"{len(seen)} photographs without the headset do not tell how the stage moves along "
            f"{' and '.join('xyz'[axis] for axis in moved)}; take a grid of 5 or more at one pose of the target."
        )
    names = list(seen.names)
    set_aside = {}
    while (moved_one := outsider(problem)) is not None:
        row, by = moved_one
        set_aside[names.pop(row)] = by
        problem = problem.without(row)
    step = target_step(problem)
    jitter, solution = with_jitter(problem)
    return StageFit(
        reference,
        float(np.ptp(reading, axis=0).max()),
        moved,
        solution.axes,
        dict(zip(numbers.tolist(), solution.poses, strict=True)),
        solution.covariance,
        jitter,
        tuple(names),
        solution.residual,
        set_aside,
        TargetMoved(names[step.before], names[step.row], step.motion) if step else None,
    )


def _moved(reading: FloatArray) -> IntArray:
    if len(reading) == 0:
        raise BadInputError("no photograph without the headset shows the target; the stage cannot be found.")
    travel = np.ptp(reading, axis=0)
    if not travel.max() > 0:
        raise BadInputError(
            "all photographs without the headset have the same stage reading; take some at other readings, "
            "so that the stage's axes can be found."
        )
    return np.flatnonzero(travel > STILL * travel.max())

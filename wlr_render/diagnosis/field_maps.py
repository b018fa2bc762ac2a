"""Which captures a report draws over the field: few, from viewpoints far apart."""

from dataclasses import dataclass

import numpy as np

from wlr_render.captures.session import DisplayPlan, RunTimePlan, SeeThroughPlan
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray

_MOST = 4


@dataclass(frozen=True, eq=False)
class FieldMap:
    """Which readings one map of the field shows.

    Attributes:
        title: of the map.
        rows: (m,) mask, of readings that count.
    """

    title: str
    rows: BoolArray


def display_maps(plan: DisplayPlan, used: BoolArray, origin: FloatArray) -> tuple[FieldMap, ...]:
    """The capture in the middle of all, then each time the one farthest from those chosen.

    Args:
        plan: of the display.
        used: (m,) readings that count.
        origin: (3,) from which titles measure the stage.
    """
    numbers, first = np.unique(plan.capture[used], return_index=True)
    stage = plan.stage[used][first]
    chosen = [int(np.argmin(np.linalg.norm(stage - stage.mean(axis=0), axis=1)))]
    while len(chosen) < min(_MOST, len(numbers)):
        chosen.append(_farthest(stage, stage[chosen]))
    return tuple(
        FieldMap(f"capture {numbers[k]}\n{_place(stage[k] - origin)}", used & (plan.capture == numbers[k]))
        for k in chosen
    )


def see_through_maps(
    plan: SeeThroughPlan, used: BoolArray, origin: FloatArray, distance: FloatArray
) -> tuple[FieldMap, ...]:
    """One capture for each target pose, near to far, each far from those of the other poses.

    Args:
        plan: of see-through.
        used: (m,) readings that count.
        origin: (3,) from which titles measure the stage.
        distance: (m,) of the target, metres.
    """
    poses, first = np.unique(plan.target_pose[used], return_index=True)
    maps, places = [], [plan.stage[used].mean(axis=0)]
    for pose in _thinned(poses[np.argsort(distance[used][first])]):
        rows = np.flatnonzero(used & (plan.target_pose == pose))
        row = rows[_farthest(plan.stage[rows], np.array(places))]
        places.append(plan.stage[row])
        title = (
            f"target pose {pose} at {distance[row]:.2f} m\ncapture {plan.capture[row]} {_place(places[-1] - origin)}"
        )
        maps.append(FieldMap(title, used & (plan.target_pose == pose) & (plan.capture == plan.capture[row])))
    return tuple(maps)


def run_time_maps(plan: RunTimePlan, used: BoolArray) -> tuple[FieldMap, ...]:
    """Some recordings, from the first to the last."""
    return tuple(
        FieldMap(f"recording {n}", used & (plan.capture == n)) for n in _thinned(np.unique(plan.capture[used]))
    )


def _farthest(places: FloatArray, chosen: FloatArray) -> int:
    """Index of the place (k, 3) whose nearest one among those chosen (c, 3) is farthest away."""
    return int(np.argmax(np.linalg.norm(places[:, None] - chosen, axis=-1).min(axis=1)))


def _place(from_origin: FloatArray) -> str:
    x, y, z = 1e3 * from_origin
    return f"at ({x:+.1f}, {y:+.1f}, {z:+.1f}) mm"


def _thinned(numbers: IntArray) -> IntArray:
    """As many as are drawn, evenly spaced."""
    return np.asarray(numbers[np.linspace(0, len(numbers) - 1, min(_MOST, len(numbers))).round().astype(int)])

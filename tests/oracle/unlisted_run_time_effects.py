"""Effects that stand in no list of causes and show while the glasses run: shutter, hinge, tracker, rows and columns."""

from dataclasses import replace

import numpy as np

from oracle.own_tracer import FloatArray, turn
from oracle.recipes import Amount, Draw, Recipe, vector, xyz
from oracle.run_time_effects import with_delay, with_pupil
from oracle.shapes import PlaneWaves, RandomWalks
from oracle.unlisted_effects import SEED
from oracle.world import Flex, World

_GAZE_REACH = 0.36  # tangent of the farthest gaze
_WALK_S, _WALK_STEP_S = 400.0, 0.5


def _with_flex(world: World, flex: Flex) -> World:
    return replace(world, flex=(*world.flex, flex))


def _camera_shutter(world: World, amount: Amount) -> World:
    def late(place: FloatArray) -> FloatArray:
        return np.asarray(1e-3 * amount["duration_ms"] * place[:, 1])

    return replace(world, shutter=(*world.shutter, late))


def _column_delay(world: World, amount: Amount) -> World:
    return with_delay(world, lambda place: 1e-3 * amount["duration_ms"] * place[:, 0])


def _band_delay(world: World, amount: Amount) -> World:
    def late(place: FloatArray) -> FloatArray:
        return np.where(np.abs(place[:, 1] - amount["row"]) < 0.5 * amount["width"], 1e-3 * amount["late_ms"], 0.0)

    return with_delay(world, late)


def _hinge_flex(world: World, amount: Amount) -> World:
    def flex(gravity: FloatArray, time_s: FloatArray) -> FloatArray:
        return turn(np.radians(gravity[:, 2:] * vector(amount, xyz("deg"))))

    return _with_flex(world, flex)


def _frame_creep(world: World, amount: Amount) -> World:
    walks = RandomWalks(amount["seed"], 3, _WALK_S, _WALK_STEP_S)
    return _with_flex(world, lambda gravity, time_s: turn(np.radians(amount["turn_deg"] * walks(time_s))))


def _gaze_waves(world: World, amount: Amount) -> World:
    waves = [PlaneWaves(amount["seed"] + axis, shortest=1.6) for axis in (0, 1)]

    def moved(pupil: FloatArray, gaze: FloatArray) -> FloatArray:
        place = gaze[:, :2] / gaze[:, 2:] / _GAZE_REACH
        off = np.column_stack([*(wave(place) for wave in waves), np.zeros(len(place))])
        return np.asarray(pupil + amount["shift_mm"] * off)

    return with_pupil(world, moved)


UNLISTED_AT_RUN_TIME_EFFECTS = {
    "camera_shutter": Recipe(
        "the camera exposes its rows one after the other, in so much from the first to the last",
        (Draw(("duration_ms",), 6.0, 20.0, "positive"),),
        _camera_shutter,
    ),
    "column_delay": Recipe(
        "the panel's columns are seen one after the other, in so much from the first to the last",
        (Draw(("duration_ms",), 4.0, 16.0, "positive"),),
        _column_delay,
    ),
    "band_delay": Recipe(
        "a band of the panel's rows, with hard edges, is seen late",
        (
            Draw(("late_ms",), 4.0, 16.0, "positive"),
            Draw(("row",), 0.35, 0.65, "setting"),
            Draw(("width",), 0.2, 0.4, "setting"),
        ),
        _band_delay,
    ),
    "hinge_flex": Recipe(
        "a hinge turns the picture in proportion to gravity along the line of sight",
        (Draw(xyz("deg"), 0.06, 0.2),),
        _hinge_flex,
    ),
    "frame_creep": Recipe(
        "the frame creeps: smoothed random walks in time turn the picture",
        (Draw(("turn_deg",), 0.02, 0.08, "positive"), SEED),
        _frame_creep,
    ),
    "gaze_waves": Recipe(
        "the true pupil lies off the tracked one by plane waves of the gaze at random",
        (Draw(("shift_mm",), 0.3, 1.5), SEED),
        _gaze_waves,
    ),
}

STATIONS_AT_RUN_TIME = {
    "camera_shutter": "camera",
    **dict.fromkeys(("column_delay", "band_delay"), "panel"),
    "hinge_flex": "head motion",
    "frame_creep": "time",
    "gaze_waves": "eye tracking",
}
"""Station of each effect of a recording of head motion."""

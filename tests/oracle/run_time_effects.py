"""Effects that show while the glasses run: eye tracking, the eye itself, and delays of the picture."""

from dataclasses import replace

import numpy as np

from oracle.own_tracer import FloatArray
from oracle.recipes import Amount, Draw, Recipe, vector, xyz
from oracle.world import Late, Pupil, World

_STRAIGHT_AHEAD = np.array([0.0, 0.0, 1.0])


def with_pupil(world: World, pupil: Pupil) -> World:
    """The glasses with one more thing wrong with where the pupil is."""
    return replace(world, pupil=(*world.pupil, pupil))


def with_delay(world: World, late: Late) -> World:
    """The glasses with one more delay of the picture."""
    return replace(world, late=(*world.late, late))


def _eye_position_bias(world: World, amount: Amount) -> World:
    bias = vector(amount, xyz("mm"))
    return with_pupil(world, lambda pupil, gaze: pupil + bias)


def _gaze_pupil_shift(world: World, amount: Amount) -> World:
    def moved(pupil: FloatArray, gaze: FloatArray) -> FloatArray:
        return np.asarray(pupil + amount["radius_mm"] * (gaze - _STRAIGHT_AHEAD))

    return with_pupil(world, moved)


def _latency(world: World, amount: Amount) -> World:
    return with_delay(world, lambda place: np.full(len(place), 1e-3 * amount["latency_ms"]))


def _rolling_scanout(world: World, amount: Amount) -> World:
    return with_delay(world, lambda place: 1e-3 * amount["duration_ms"] * place[:, 1])


RUN_TIME_EFFECTS = {
    "eye_position_bias": Recipe(
        "the true pupil lies off the tracked one", (Draw(xyz("mm"), 0.1, 1.0),), _eye_position_bias
    ),
    "gaze_pupil_shift": Recipe(
        "the true pupil lies off the tracked one by a radius times (gaze - straight ahead)",
        (Draw(("radius_mm",), 0.5, 10.5, "positive"),),
        _gaze_pupil_shift,
    ),
    "latency": Recipe(
        "frames are seen later than the time for which they are drawn",
        (Draw(("latency_ms",), 1.0, 20.0, "positive"),),
        _latency,
    ),
    "rolling_scanout": Recipe(
        "the panel's rows are seen one after the other, in so much from the first to the last",
        (Draw(("duration_ms",), 2.0, 16.0, "positive"),),
        _rolling_scanout,
    ),
}

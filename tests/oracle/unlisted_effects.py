"""Effects that stand in no list of causes, to see whether a diagnosis admits that it does not know."""

from dataclasses import replace

import numpy as np

from oracle.bench_effects import adding_image, adding_place, adding_print
from oracle.captures import CAMERA_CENTRE_PX, CAMERA_SIZE_PX, Captures
from oracle.form_effects import with_bump
from oracle.own_tracer import FloatArray
from oracle.recipes import Amount, Draw, Recipe
from oracle.world import World

_SCREW_PITCH_MM = 1.0


def _combiner_ripple(world: World, amount: Amount) -> World:
    pivot, wave_number = world.device.pivot, 2.0 * np.pi / amount["period_mm"]

    def bump(point: FloatArray) -> tuple[FloatArray, FloatArray]:
        phase = wave_number * (point - pivot)[:, 0]
        slope = amount["height_mm"] * wave_number * np.cos(phase)
        return amount["height_mm"] * np.sin(phase), slope[:, None] * [1.0, 0.0, 0.0]

    return with_bump(world, bump)


def _stage_screw_error(world: World, amount: Amount) -> World:
    def place(position: FloatArray, captures: Captures) -> FloatArray:
        swing = amount["swing_mm"] * np.sin(2.0 * np.pi * captures.reading[:, 0] / _SCREW_PITCH_MM)
        return np.asarray(position + np.outer(swing, [1.0, 0.0, 0.0]))

    return adding_place(world, place)


def _code_stripes(world: World, amount: Amount) -> World:
    def decode(pixel: FloatArray, time_s: FloatArray, channel: FloatArray) -> FloatArray:
        return np.asarray(pixel + amount["bias_px"] * np.sin(2.0 * np.pi * pixel / amount["period_px"]))

    return replace(world, decode=(*world.decode, decode))


def _row_skew(world: World, amount: Amount) -> World:
    def image(uv: FloatArray, time_s: FloatArray) -> FloatArray:
        row = (uv[:, 1] - CAMERA_CENTRE_PX[1]) / CAMERA_SIZE_PX[1]
        return uv + np.outer(amount["px_per_1000s"] * row * time_s / 1000.0, [1.0, 0.0])

    return adding_image(world, image)


def _target_wrinkle(world: World, amount: Amount) -> World:
    def wrinkled(dot: FloatArray, half_mm: FloatArray) -> FloatArray:
        across = dot[:, :2] / half_mm[0] - [amount["x_ratio"], amount["y_ratio"]]
        ridge = amount["height_mm"] * np.exp(-0.5 * np.sum((across / amount["width_ratio"]) ** 2, axis=-1))
        return dot + np.outer(ridge, [0.0, 0.0, 1.0])

    return adding_print(world, wrinkled)


UNLISTED_EFFECTS = {
    "combiner_ripple": Recipe(
        "all surfaces are raised by a sine of x about the pivot",
        (Draw(("height_mm",), 0.003, 0.015), Draw(("period_mm",), 12.0, 24.0, "setting")),
        _combiner_ripple,
    ),
    "stage_screw_error": Recipe(
        "the true x swings about the one read once per millimetre",
        (Draw(("swing_mm",), 0.05, 0.2),),
        _stage_screw_error,
    ),
    "code_stripes": Recipe(
        "decoded pixels are biased by a sine of themselves",
        (Draw(("bias_px",), 0.3, 1.5), Draw(("period_px",), 24.0, 80.0, "setting")),
        _code_stripes,
    ),
    "row_skew": Recipe(
        "camera rows slide sideways, the more the later", (Draw(("px_per_1000s",), 0.5, 2.0),), _row_skew
    ),
    "target_wrinkle": Recipe(
        "a Gaussian ridge on every target; ratios are of half its width",
        (
            Draw(("height_mm",), 3.0, 10.0),
            Draw(("x_ratio", "y_ratio"), -0.6, 0.6, "setting"),
            Draw(("width_ratio",), 0.15, 0.3, "setting"),
        ),
        _target_wrinkle,
    ),
}

"""Effects that stand in no list of causes, to see whether a diagnosis admits that it does not know."""

from dataclasses import replace

import numpy as np

from oracle.bench_effects import adding_image, adding_place, adding_print
from oracle.captures import CAMERA_CENTRE_PX, CAMERA_SIZE_PX, Captures
from oracle.own_tracer import Bump, FloatArray
from oracle.recipes import Amount, Draw, Recipe
from oracle.world import World

_COMBINER_REACH_MM = 20.0
_SCREW_PITCH_MM = 1.0


def _panel_bow(world: World, amount: Amount) -> World:
    device = world.device
    half = 0.5 * device.panel.size_mm
    panel = replace(device.panel, bow_per_mm=2.0 * amount["corner_mm"] / float(half @ half))
    return replace(world, device=replace(device, panel=panel))


def _with_bump(world: World, bump: Bump) -> World:
    device = world.device.with_surfaces(lambda surface: replace(surface, bumps=(*surface.bumps, bump)))
    return replace(world, device=device)


def _combiner_astigmatism(world: World, amount: Amount) -> World:
    pivot, strength = world.device.pivot, amount["sag_mm"] / _COMBINER_REACH_MM**2

    def bump(point: FloatArray) -> tuple[FloatArray, FloatArray]:
        x, y, _ = (point - pivot).T
        return strength * (x**2 - y**2), 2.0 * strength * np.stack([x, -y, np.zeros_like(x)], axis=-1)

    return _with_bump(world, bump)


def _combiner_dent(world: World, amount: Amount) -> World:
    centre = world.device.pivot + np.array([amount["x_mm"], amount["y_mm"], 0.0])

    def bump(point: FloatArray) -> tuple[FloatArray, FloatArray]:
        across = (point - centre) * [1.0, 1.0, 0.0] / amount["width_mm"]
        raised = amount["depth_mm"] * np.exp(-0.5 * np.sum(across**2, axis=-1))
        return raised, -raised[:, None] * across / amount["width_mm"]

    return _with_bump(world, bump)


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
    "panel_bow": Recipe(
        "the panel is a bowl, raised along its normal at the corners", (Draw(("corner_mm",), 0.2, 1.0),), _panel_bow
    ),
    "combiner_astigmatism": Recipe(
        "all surfaces are raised by x^2 - y^2 about the pivot, by so much at 20 mm",
        (Draw(("sag_mm",), 0.005, 0.02),),
        _combiner_astigmatism,
    ),
    "combiner_dent": Recipe(
        "a Gaussian dent in all surfaces, off the pivot",
        (
            Draw(("depth_mm",), 0.003, 0.02),
            Draw(("x_mm", "y_mm"), -8.0, 8.0, "setting"),
            Draw(("width_mm",), 3.0, 6.0, "setting"),
        ),
        _combiner_dent,
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

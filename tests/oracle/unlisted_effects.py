"""Effects that stand in no list of causes, to see whether a diagnosis admits that it does not know, and locates them.

Their shapes are no estimator's: plane waves at random, hard edges, smoothed random walks.
"""

from dataclasses import replace

import numpy as np

from oracle.bench_effects import adding_image, adding_place, adding_print, adding_turn
from oracle.captures import CAMERA_CENTRE_PX, CAMERA_FOCAL_PX, CAMERA_SIZE_PX, Captures
from oracle.form_effects import with_bump
from oracle.own_tracer import FloatArray, turn
from oracle.recipes import Amount, Draw, Recipe, xyz
from oracle.shapes import PlaneWaves, RandomWalks
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


_REACH_MM = 12.0  # half the part of a combiner that is looked through
_WALK_S, _WALK_STEP_S = 8000.0, 20.0


def _combiner_waves(world: World, amount: Amount) -> World:
    pivot, waves = world.device.pivot, PlaneWaves(amount["seed"], shortest=1.6)

    def bump(point: FloatArray) -> tuple[FloatArray, FloatArray]:
        place = (point - pivot)[:, :2] / _REACH_MM
        slope = amount["height_mm"] / _REACH_MM * waves.gradient(place)
        return amount["height_mm"] * waves(place), np.column_stack([slope, np.zeros(len(place))])

    return with_bump(world, bump)


def _combiner_bubble(world: World, amount: Amount) -> World:
    centre = world.device.pivot + np.array([amount["x_mm"], amount["y_mm"], 0.0])
    square = amount["radius_mm"] ** 2

    def bump(point: FloatArray) -> tuple[FloatArray, FloatArray]:
        across = (point - centre) * [1.0, 1.0, 0.0]
        apart = np.sum(across**2, axis=-1)
        inside = apart < square
        height = amount["height_mm"] * np.where(inside, 1.0 - apart / square, 0.0)
        return height, np.where(inside[:, None], -2.0 * amount["height_mm"] / square * across, 0.0)

    return with_bump(world, bump)


def _substrate_wedge(world: World, amount: Amount) -> World:
    device, tilt = world.device, turn(np.radians([amount["x_deg"], amount["y_deg"], 0.0]))
    face, pivot = device.surfaces[device.outer], device.pivot
    turned = replace(face, axes=tilt @ face.axes, origin=pivot + tilt @ (face.origin - pivot))
    return replace(world, device=replace(device, surfaces={**device.surfaces, device.outer: turned}))


def _panel_waves(world: World, amount: Amount) -> World:
    pixels, waves = world.device.panel.pixels, [PlaneWaves(amount["seed"] + axis) for axis in (0, 1)]

    def decode(pixel: FloatArray, time_s: FloatArray, channel: FloatArray) -> FloatArray:
        place = 2.0 * pixel / pixels - 1.0
        return pixel + amount["shift_px"] * np.column_stack([wave(place) for wave in waves])

    return replace(world, decode=(*world.decode, decode))


def _panel_swings(world: World, amount: Amount) -> World:
    panel = world.device.panel
    reach = np.array([amount["x_mm"], amount["y_mm"]]) / panel.size_mm * panel.pixels

    def decode(pixel: FloatArray, time_s: FloatArray, channel: FloatArray) -> FloatArray:
        return pixel + np.outer(np.sin(2.0 * np.pi * time_s / amount["period_s"]), reach)

    return replace(world, decode=(*world.decode, decode))


def _lens_waves(world: World, amount: Amount) -> World:
    waves = [PlaneWaves(amount["seed"] + axis) for axis in (0, 1)]

    def image(uv: FloatArray, time_s: FloatArray) -> FloatArray:
        place = (uv - CAMERA_CENTRE_PX) / CAMERA_CENTRE_PX
        return uv + amount["shift_px"] * np.column_stack([wave(place) for wave in waves])

    return adding_image(world, image)


def _lens_decentred(world: World, amount: Amount) -> World:
    p1, p2 = amount["p1"], amount["p2"]

    def image(uv: FloatArray, time_s: FloatArray) -> FloatArray:
        x, y = ((uv - CAMERA_CENTRE_PX) / CAMERA_FOCAL_PX).T
        square = x**2 + y**2
        off = [2.0 * p1 * x * y + p2 * (square + 2.0 * x**2), p1 * (square + 2.0 * y**2) + 2.0 * p2 * x * y]
        return uv + CAMERA_FOCAL_PX * np.stack(off, axis=-1)

    return adding_image(world, image)


def _print_waves(world: World, amount: Amount) -> World:
    waves = [PlaneWaves(amount["seed"] + axis) for axis in range(3)]

    def printed(dot: FloatArray, half_mm: FloatArray) -> FloatArray:
        off = np.column_stack([wave(dot[:, :2] / half_mm) for wave in waves])
        return np.asarray(dot + amount["shift_mm"] * half_mm[0] / 400.0 * off * [1.0, 1.0, 3.0])

    return adding_print(world, printed)


def _stage_pitch(world: World, amount: Amount) -> World:
    eye, per_mm = world.device.eye, np.radians([amount["x_deg"], amount["y_deg"], amount["z_deg"]])
    return adding_turn(world, lambda captures: turn(np.outer((captures.reading - eye)[:, 0], per_mm)))


def _pose_creep(world: World, amount: Amount) -> World:
    walks = RandomWalks(amount["seed"], 6, _WALK_S, _WALK_STEP_S)
    moved = adding_place(world, lambda place, captures: place + amount["shift_mm"] * walks(captures.time_s)[:, :3])
    return adding_turn(moved, lambda captures: turn(amount["turn_rad"] * walks(captures.time_s)[:, 3:]))


SEED = Draw(("seed",), 0.0, 1e6, "setting")

UNLISTED_EFFECTS = {
    "combiner_waves": Recipe(
        "all surfaces are raised by plane waves at random, 10 to 48 mm long",
        (Draw(("height_mm",), 0.0006, 0.002), SEED),
        _combiner_waves,
    ),
    "combiner_bubble": Recipe(
        "all surfaces have a paraboloid with a hard edge, off the pivot",
        (
            Draw(("height_mm",), 0.003, 0.008),
            Draw(("x_mm", "y_mm"), -4.0, 4.0, "setting"),
            Draw(("radius_mm",), 2.0, 3.0, "setting"),
        ),
        _combiner_bubble,
    ),
    "substrate_wedge": Recipe(
        "the outer face is turned about the pivot", (Draw(("x_deg", "y_deg"), 0.02, 0.05),), _substrate_wedge
    ),
    "panel_waves": Recipe(
        "decoded pixels are off by plane waves at random", (Draw(("shift_px",), 0.2, 1.0), SEED), _panel_waves
    ),
    "panel_swings": Recipe(
        "the panel swings with the temperature of the room",
        (Draw(("x_mm", "y_mm"), 0.015, 0.05), Draw(("period_s",), 700.0, 2500.0, "setting")),
        _panel_swings,
    ),
    "lens_waves": Recipe(
        "points are imaged off by plane waves at random", (Draw(("shift_px",), 0.15, 0.6), SEED), _lens_waves
    ),
    "lens_decentred": Recipe(
        "tangential distortion p1, p2 of D. C. Brown", (Draw(("p1", "p2"), 4e-4, 1.4e-3),), _lens_decentred
    ),
    "print_waves": Recipe(
        "dots are off by plane waves at random; the size is that of a target 800 mm wide",
        (Draw(("shift_mm",), 0.1, 0.4), SEED),
        _print_waves,
    ),
    "stage_pitch": Recipe(
        "the camera turns in proportion to the reading of x, degrees per millimetre",
        (Draw(xyz("deg"), 0.002, 0.006),),
        _stage_pitch,
    ),
    "pose_creep": Recipe(
        "the camera creeps by smoothed random walks",
        (Draw(("shift_mm",), 0.02, 0.06), Draw(("turn_rad",), 5e-5, 2e-4), SEED),
        _pose_creep,
    ),
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

STATIONS = {
    **dict.fromkeys(("combiner_waves", "combiner_bubble", "substrate_wedge", "combiner_ripple"), "combiner"),
    **dict.fromkeys(("panel_waves", "code_stripes"), "panel"),
    **dict.fromkeys(("panel_swings", "pose_creep"), "time"),
    **dict.fromkeys(("lens_waves", "lens_decentred", "row_skew"), "camera"),
    **dict.fromkeys(("print_waves", "target_wrinkle"), "target"),
    **dict.fromkeys(("stage_pitch", "stage_screw_error"), "stage"),
}
"""Station of each effect of a bench session."""

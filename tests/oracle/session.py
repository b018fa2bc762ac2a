"""Observe a bench with its hidden effects: both tables of a session."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from oracle import sights
from oracle.captures import (
    CAMERA_CENTRE_PX,
    CAMERA_FOCAL_PX,
    CAMERA_SIZE_PX,
    TARGET_DISTANCES_MM,
    Captures,
    Plan,
    device_from_target,
    display_captures,
    see_through_captures,
)
from oracle.devices import CHANNEL_UM, own_device
from oracle.effects import Effect
from oracle.nature import PERFECT, BenchNature
from oracle.own_tracer import FloatArray
from oracle.world import World

_GRID_FROM_PX = np.array([40.0, 40.0])
_PANEL_MARGIN_PX = 2.0  # nothing is decoded nearer to the panel's edge
_LENS_STEPS = 12

_STAGE = ("stage_x_mm", "stage_y_mm", "stage_z_mm")


@dataclass(frozen=True, eq=False)
class Session:
    """Two tables as arrays with named columns, named as in the files.

    Attributes:
        plan: what was done.
        display: every point of the grid in every capture, also those where nothing was decoded: there `pixel_u` is NaN.
        seethrough: every dot in every capture; `camera_u` is NaN where it was not seen.
    """

    plan: Plan
    display: NDArray[np.void]
    seethrough: NDArray[np.void]


def observe(plan: Plan, effects: Sequence[Effect], rng: np.random.Generator, nature: BenchNature = PERFECT) -> Session:
    """Measure a bench that is as stated but for the effects, applied in order, and for its nature.

    The same generator state gives the same positions and the same white noise, whatever the effects and the nature are.

    Raises:
        BadInputError: the plan names a device that does not exist.
    """
    world = World(own_device(plan.device))
    eye = world.device.eye
    for effect in effects:
        world = effect.applied(world)
    of_display, of_targets = display_captures(plan, eye, rng), see_through_captures(plan, eye)
    display = display_table(world, plan, of_display, rng, nature)
    return Session(plan, display, see_through_table(world, plan, of_targets, rng, nature))


def display_table(
    world: World, plan: Plan, captures: Captures, rng: np.random.Generator, nature: BenchNature = PERFECT
) -> NDArray[np.void]:
    """What is decoded on the display, capture by capture, as in `Session.display`.

    The noise moves a point in the camera's image, and the optics carry it to the panel.
    """
    points = _grid(plan)
    capture, point, colour = (
        index.ravel() for index in np.indices((len(captures.number), len(points), len(plan.channels)))
    )
    channel, time_s, seen = np.array(plan.channels)[colour], captures.time_s[capture], points[point]
    white, own = rng.normal(size=seen.shape), rng.spawn(1)[0]
    position, turned = _camera(world, captures, nature, own)
    noise = nature.noise(white, seen, capture, capture * len(plan.channels) + colour, _grid_spacing(plan), own)
    uv = _without_lens(world, seen + plan.sigma_px * noise, time_s)
    direction = np.einsum("nij,nj->ni", turned[capture], _line_of_sight(uv))
    pixel = np.full_like(seen, np.nan)
    for one in plan.channels:
        rows = channel == one
        ray = world.device.trace(world.device.display, position[capture[rows]], direction[rows], CHANNEL_UM[one])
        pixel[rows] = world.device.panel.pixel(*ray)
    for decode in world.decode:
        pixel = decode(pixel, time_s, channel.astype(np.float64))
    inside = (pixel > _PANEL_MARGIN_PX) & (pixel < world.device.panel.pixels - _PANEL_MARGIN_PX)
    pixel[~np.all(inside, axis=-1)] = np.nan
    return _table(
        {
            "capture": captures.number[capture],
            "time_s": time_s,
            "travel": captures.travel[capture],
            **dict(zip(_STAGE, captures.reading[capture].T, strict=True)),
            "channel": channel,
            **_pair("camera", seen),
            **_pair("pixel", pixel),
        }
    )


def see_through_table(
    world: World, plan: Plan, captures: Captures, rng: np.random.Generator, nature: BenchNature = PERFECT
) -> NDArray[np.void]:
    """Where the dots of the targets are seen, as in `Session.seethrough`."""
    columns, rows = plan.dots
    steps = _points(np.arange(columns) - 0.5 * (columns - 1), np.arange(rows) - 0.5 * (rows - 1))
    capture, dot = (index.ravel() for index in np.indices((len(captures.number), len(steps))))
    pose, time_s = captures.target_pose[capture], captures.time_s[capture]
    printed = steps[dot] * np.array([plan.pitch_mm(k) for k in range(len(TARGET_DISTANCES_MM))])[pose][:, None]
    own = rng.spawn(1)[0]
    position, turned = _camera(world, captures, nature, own)
    shifts, turns = nature.target_motion(len(TARGET_DISTANCES_MM), own)
    point = np.empty((len(printed), 3))
    for k in range(len(TARGET_DISTANCES_MM)):
        dots, middle = _dots_in_device(world, plan, k, printed[pose == k])
        point[pose == k] = (dots - middle) @ turns[k].T + middle + shifts[k]
    direction = np.einsum("nji,nj->ni", turned[capture], sights.of_point(world, position[capture], point))
    uv = CAMERA_CENTRE_PX + CAMERA_FOCAL_PX * direction[:, :2] / direction[:, 2:]
    for image in world.image:
        uv = image(uv, time_s)
    spacing_px = CAMERA_FOCAL_PX * plan.pitch_mm(0) / TARGET_DISTANCES_MM[0]
    white = rng.normal(size=uv.shape)
    uv = uv + plan.sigma_px * nature.noise(white, uv, capture, capture, spacing_px, own)
    uv[~np.all((uv > -0.5) & (uv < CAMERA_SIZE_PX - 0.5), axis=-1)] = np.nan
    return _table(
        {
            "target_pose": pose,
            "capture": captures.number[capture],
            "time_s": time_s,
            **dict(zip(_STAGE, captures.reading[capture].T, strict=True)),
            "target_x_mm": printed[:, 0],
            "target_y_mm": printed[:, 1],
            **_pair("camera", uv),
        }
    )


def _grid(plan: Plan) -> FloatArray:
    """Camera pixels at which the display is decoded, (n, 2), row by row."""
    last = CAMERA_SIZE_PX - _GRID_FROM_PX
    axes = (np.linspace(a, b, n) for a, b, n in zip(_GRID_FROM_PX, last, plan.grid, strict=True))
    return np.asarray(np.round(_points(*axes), 3))


def _grid_spacing(plan: Plan) -> float:
    """Distance of neighbouring points of the grid, averaged over both axes, camera pixels."""
    return float(np.mean((CAMERA_SIZE_PX - 2.0 * _GRID_FROM_PX) / (np.array(plan.grid) - 1)))


def _points(across: ArrayLike, down: ArrayLike) -> FloatArray:
    """All pairs of two axes, (n, 2), row by row."""
    y, x = np.meshgrid(down, across, indexing="ij")
    return np.stack([x.ravel(), y.ravel()], axis=-1)


def _camera(
    world: World, captures: Captures, nature: BenchNature, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """True positions (c, 3) and rotations (c, 3, 3), device from camera."""
    position = captures.reading
    for place in world.place:
        position = place(position, captures)
    turned = np.broadcast_to(np.eye(3), (len(position), 3, 3))
    for turn in world.turn:
        turned = turn(captures) @ turned
    shift, last_turn = nature.camera_motion(len(position), rng)
    return position + shift, last_turn @ turned


def _line_of_sight(uv: FloatArray) -> FloatArray:
    """Unit directions (n, 3) of camera pixels (n, 2) of a pinhole, camera frame."""
    return sights.forward((uv - CAMERA_CENTRE_PX) / CAMERA_FOCAL_PX)


def _without_lens(world: World, seen: FloatArray, time_s: FloatArray) -> FloatArray:
    """Pixels of a pinhole that the lens and the sensor turn into those seen, by fixed-point iteration."""
    ideal = seen
    for _ in range(_LENS_STEPS if world.image else 0):
        shown = ideal
        for image in world.image:
            shown = image(shown, time_s)
        ideal = ideal + seen - shown
    return ideal


def _dots_in_device(world: World, plan: Plan, target_pose: int, printed: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The dots (n, 3), and the target's middle (3,)."""
    half_mm = 0.5 * plan.pitch_mm(target_pose) * (np.array(plan.dots) - 1)
    dots = np.concatenate([printed, np.zeros((len(printed), 1))], axis=-1)
    for wrong in world.print:
        dots = wrong(dots, half_mm)
    axes, place = device_from_target(target_pose, world.device.eye)
    for pose in world.pose:
        axes, place = pose(axes, place)
    return np.asarray(dots @ axes.T + place), place


def _pair(name: str, values: FloatArray) -> dict[str, FloatArray]:
    return {f"{name}_u": values[:, 0], f"{name}_v": values[:, 1]}


def _table(columns: dict[str, NDArray[np.float64] | NDArray[np.int64]]) -> NDArray[np.void]:
    rows = len(next(iter(columns.values())))
    table = np.empty(rows, dtype=[(name, values.dtype) for name, values in columns.items()])
    for name, values in columns.items():
        table[name] = values
    return table

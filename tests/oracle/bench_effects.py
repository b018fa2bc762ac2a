"""Effects in the bench: stage, eyeball camera, targets, tracking, and a headset that slips."""

from dataclasses import replace

import numpy as np

from oracle.captures import (
    CAMERA_CENTRE_PX,
    CAMERA_FOCAL_PX,
    Captures,
    stage_origin,
)
from oracle.own_tracer import FloatArray
from oracle.recipes import Amount, Draw, Recipe, rotation, vector, xyz
from oracle.world import Image, Place, Print, Turn, World

_BOW_REFERENCE_MM = 400.0


def adding_place(world: World, place: Place) -> World:
    """The bench with one more thing wrong with where the camera is."""
    return replace(world, place=(*world.place, place))


def adding_turn(world: World, turn: Turn) -> World:
    """The bench with one more thing wrong with how the camera is turned."""
    return replace(world, turn=(*world.turn, turn))


def adding_image(world: World, image: Image) -> World:
    """The bench with one more thing wrong with the camera's image."""
    return replace(world, image=(*world.image, image))


def adding_print(world: World, wrong: Print) -> World:
    """The bench with one more thing wrong with the targets."""
    return replace(world, print=(*world.print, wrong))


def _stage_linear(world: World, matrix: FloatArray) -> World:
    origin = stage_origin(world.device.eye)
    return adding_place(world, lambda position, captures: origin + (position - origin) @ matrix.T)


def _stage_scale(world: World, amount: Amount) -> World:
    return _stage_linear(world, np.diag(1.0 + vector(amount, xyz("percent")) / 100.0))


def _stage_tilt(world: World, amount: Amount) -> World:
    return _stage_linear(world, rotation(amount))


def _stage_backlash(world: World, amount: Amount) -> World:
    def place(position: FloatArray, captures: Captures) -> FloatArray:
        return position - np.outer(captures.travel == -1, [amount["lost_mm"], 0.0, 0.0])

    return adding_place(world, place)


def _camera_pupil_offset(world: World, amount: Amount) -> World:
    offset = vector(amount, xyz("mm"))
    return adding_place(world, lambda position, captures: position + offset)


def _headset_slip(world: World, amount: Amount) -> World:
    shift = vector(amount, xyz("mm"))

    def place(position: FloatArray, captures: Captures) -> FloatArray:
        return position + np.outer(captures.time_s >= amount["start_s"], shift)

    return adding_place(world, place)


def _camera_rotation(world: World, amount: Amount) -> World:
    turned = rotation(amount)
    return adding_turn(world, lambda captures: turned)


def _camera_focal_length(world: World, amount: Amount) -> World:
    longer = 1.0 + amount["focal_percent"] / 100.0
    return adding_image(world, lambda uv, time_s: CAMERA_CENTRE_PX + longer * (uv - CAMERA_CENTRE_PX))


def _camera_distortion(world: World, amount: Amount) -> World:
    edge_px = CAMERA_CENTRE_PX[0]
    k1 = amount["edge_px"] / edge_px / (edge_px / CAMERA_FOCAL_PX) ** 2

    def image(uv: FloatArray, time_s: FloatArray) -> FloatArray:
        tangents = (uv - CAMERA_CENTRE_PX) / CAMERA_FOCAL_PX
        return np.asarray(uv + (uv - CAMERA_CENTRE_PX) * k1 * np.sum(tangents**2, axis=-1, keepdims=True))

    return adding_image(world, image)


def _target_scale(world: World, amount: Amount) -> World:
    return adding_print(world, lambda dot, half_mm: dot * (1.0 + amount["scale_percent"] / 100.0))


def _target_bow(world: World, amount: Amount) -> World:
    shape = amount["bow_mm"] / _BOW_REFERENCE_MM**2 * np.array([1.0, amount["second_ratio"]])

    def bent(dot: FloatArray, half_mm: FloatArray) -> FloatArray:
        return dot + np.outer(dot[:, :2] ** 2 @ shape, [0.0, 0.0, 1.0])

    return adding_print(world, bent)


def _tracking_rotation(world: World, amount: Amount) -> World:
    turned = rotation(amount)
    return replace(world, pose=(*world.pose, lambda axes, place: (turned @ axes, turned @ place)))


def _tracking_translation(world: World, amount: Amount) -> World:
    shift = vector(amount, xyz("mm"))
    return replace(world, pose=(*world.pose, lambda axes, place: (axes, place + shift)))


BENCH_EFFECTS = {
    "stage_scale": Recipe(
        "true moves from the stage's origin are longer than those read, axis by axis",
        (Draw(xyz("percent"), 0.1, 1.0),),
        _stage_scale,
    ),
    "stage_tilt": Recipe(
        "true moves are turned against those read by a rotation vector", (Draw(xyz("deg"), 0.1, 1.4),), _stage_tilt
    ),
    "stage_backlash": Recipe(
        "the true x is smaller than the one read where travel is -1", (Draw(("lost_mm",), 0.02, 0.3),), _stage_backlash
    ),
    "camera_pupil_offset": Recipe(
        "the true centre of projection lies off the one read", (Draw(xyz("mm"), 0.1, 1.0),), _camera_pupil_offset
    ),
    "camera_rotation": Recipe(
        "the camera is turned by a rotation vector in the device frame",
        (Draw(xyz("deg"), 0.02, 0.3),),
        _camera_rotation,
    ),
    "camera_focal_length": Recipe(
        "the true focal length is longer", (Draw(("focal_percent",), 0.05, 0.5),), _camera_focal_length
    ),
    "camera_distortion": Recipe(
        "points are seen farther from the centre by k1 r^2; the size is that at the image's left and right edge",
        (Draw(("edge_px",), 0.2, 0.8),),
        _camera_distortion,
    ),
    "target_scale": Recipe(
        "the targets are larger than printed on them", (Draw(("scale_percent",), 0.1, 0.4),), _target_scale
    ),
    "target_bow": Recipe(
        "z = bow (x^2 + ratio y^2) / (400 mm)^2 on every target: a cylinder at ratio 0, a bowl at 1",
        (Draw(("bow_mm",), 0.1, 3.0), Draw(("second_ratio",), 0.0, 1.0, "setting")),
        _target_bow,
    ),
    "tracking_rotation": Recipe(
        "the true target poses are those tracked, turned by a rotation vector about the device's origin",
        (Draw(xyz("deg"), 0.02, 0.3),),
        _tracking_rotation,
    ),
    "tracking_translation": Recipe(
        "the true target poses are those tracked, moved", (Draw(xyz("mm"), 0.2, 2.0),), _tracking_translation
    ),
    "headset_slip": Recipe(
        "from some time on the camera stands elsewhere in the device frame",
        (Draw(xyz("mm"), 0.1, 1.0), Draw(("start_s",), 300.0, 1600.0, "setting")),
        _headset_slip,
    ),
}

"""Convert columns of a session file to plans and readings, and back: frames, units and pixels.

`device_from_file` (3, 3) turns the axes that bench.toml states into the device frame's: the identity for "openxr",
diag(1, -1, -1) for "opencv". It applies alike to the device, the world, the camera and the printed target, so that a
rotation R of the file becomes `device_from_file @ R @ device_from_file.T`. Camera pixels have their centres at whole
numbers in the file and half a pixel further here; panel pixels are the same in both.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from wlr_render.captures.session import DisplayPlan, RunTimePlan, SeeThroughPlan
from wlr_render.captures.session_schema import (
    CAMERA_QUATERNION,
    DISPLAY,
    GAZE,
    HEAD_QUATERNION,
    RUN_TIME,
    SEE_THROUGH,
    STAGE,
    Schema,
    names,
)
from wlr_render.captures.session_tables import Columns
from wlr_render.geometry.directions import normalised
from wlr_render.geometry.transforms import rigid, rotation_of_quaternion
from wlr_render.numerics.arrays import FloatArray

Conversion = Callable[[Any, FloatArray], Any]

MM = 1e-3
"""One millimetre in metres."""
_HALF_PIXEL = 0.5
"""From a pixel's whole-numbered centre in a file to our pixels, which count from the image's outer corner."""


@dataclass(frozen=True)
class Quantity:
    """A kind of quantity, by how it changes between a session's files and this library.

    Attributes:
        of_file: (what a few columns (n, k) or a key hold, device_from_file) -> what a plan or a bench holds.
        to_file: the inverse.
    """

    of_file: Conversion = lambda value, _: value
    to_file: Conversion = lambda value, _: value


def _rotation_of_file(xyzw: FloatArray, device_from_file: FloatArray) -> FloatArray:
    return np.asarray(device_from_file @ rotation_of_quaternion(normalised(xyzw)) @ device_from_file.T)


def _rotation_to_file(rotation: FloatArray, device_from_file: FloatArray) -> FloatArray:
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(device_from_file.T @ rotation @ device_from_file).as_quat())


def _pose_of_file(pose: FloatArray, device_from_file: FloatArray) -> FloatArray:
    rotation = _rotation_of_file(pose[:, 3:], device_from_file)
    return rigid(rotation, _POINT.of_file(pose[:, :3], device_from_file))


def _pose_to_file(pose: FloatArray, device_from_file: FloatArray) -> FloatArray:
    position = _POINT.to_file(pose[:, :3, 3], device_from_file)
    return np.concatenate([position, _rotation_to_file(pose[:, :3, :3], device_from_file)], axis=1)


_NUMBER = Quantity(lambda value, _: value[:, 0], lambda value, _: value[:, None])
_WHOLE = Quantity(lambda value, _: value[:, 0].astype(np.int64), lambda value, _: value[:, None])
_PANEL_PIXEL = Quantity()
CAMERA_PIXEL = Quantity(lambda value, _: value + _HALF_PIXEL, lambda value, _: value - _HALF_PIXEL)
_POINT = Quantity(lambda value, axes: MM * value @ axes.T, lambda value, axes: value @ axes / MM)
_FLAT_POINT = Quantity(lambda value, axes: MM * value @ axes[:2, :2].T, lambda value, axes: value @ axes[:2, :2] / MM)
_VECTOR = Quantity(lambda value, axes: value @ axes.T, lambda value, axes: value @ axes)
_DIRECTION = Quantity(lambda value, axes: normalised(value) @ axes.T, lambda value, axes: value @ axes)
_ROTATION = Quantity(_rotation_of_file, _rotation_to_file)
_POSE = Quantity(_pose_of_file, _pose_to_file)


@dataclass(frozen=True)
class Part:
    """One of the three tables as a part of a session.

    Attributes:
        schema: of the table.
        plan: the attribute of a `SessionPlan`.
        reading: the attribute of `Readings`.
        plan_type: what the plan is.
        plan_quantities: for each attribute of the plan, its columns and what they hold.
        reading_quantity: the same for the reading.
    """

    schema: Schema
    plan: str
    reading: str
    plan_type: type
    plan_quantities: Mapping[str, tuple[tuple[str, ...], Quantity]]
    reading_quantity: tuple[tuple[str, ...], Quantity]

    def of_file(self, columns: Columns, device_from_file: FloatArray) -> tuple[Any, FloatArray]:
        """The plan, and its readings; dots are still in camera pixels."""
        attributes = {
            name: quantity.of_file(_stacked(columns, which), device_from_file)
            for name, (which, quantity) in self.plan_quantities.items()
            if which[0] in columns
        }
        which, quantity = self.reading_quantity
        return self.plan_type(**attributes), quantity.of_file(_stacked(columns, which), device_from_file)

    def to_file(self, plan: Any, reading: FloatArray, device_from_file: FloatArray) -> Columns:
        """The inverse of `of_file`."""
        quantities = {name: (getattr(plan, name), *rest) for name, rest in self.plan_quantities.items()}
        columns: Columns = {}
        for value, which, quantity in [*quantities.values(), (reading, *self.reading_quantity)]:
            if value is not None:
                columns |= dict(zip(which, quantity.to_file(value, device_from_file).T, strict=True))
        return columns


def _stacked(columns: Columns, which: tuple[str, ...]) -> FloatArray:
    return np.stack([columns[name] for name in which], axis=1)


_PHOTOGRAPH = {
    "capture": (("capture",), _WHOLE),
    "time_s": (("time_s",), _NUMBER),
    "travel": (("travel",), _NUMBER),
    "stage": (STAGE, _POINT),
}
_CAMERA = (names("camera_", "uv"), CAMERA_PIXEL)

PARTS = (
    Part(
        DISPLAY,
        "display",
        "panel_pixel",
        DisplayPlan,
        {**_PHOTOGRAPH, "channel": (("channel",), _WHOLE), "camera_pixel": _CAMERA},
        (names("pixel_", "uv"), _PANEL_PIXEL),
    ),
    Part(
        SEE_THROUGH,
        "see_through",
        "dot_pixel",
        SeeThroughPlan,
        {
            **_PHOTOGRAPH,
            "target_pose": (("target_pose",), _WHOLE),
            "dot": (names("target_", "xy", "_mm"), _FLAT_POINT),
            "orientation": (CAMERA_QUATERNION, _ROTATION),
            "bare_pixel": (names("bare_", "uv"), CAMERA_PIXEL),
        },
        _CAMERA,
    ),
    Part(
        RUN_TIME,
        "run_time",
        "seen",
        RunTimePlan,
        {
            "capture": (("capture",), _WHOLE),
            "time_s": (("time_s",), _NUMBER),
            "world_from_device": (names("head_", "xyz", "_mm") + HEAD_QUATERNION, _POSE),
            "head_velocity": (names("head_velocity_", "xyz", "_mm_s"), _POINT),
            "head_rate": (names("head_rate_", "xyz", "_rad_s"), _VECTOR),
            "viewpoint": (names("viewpoint_", "xyz", "_mm"), _POINT),
            "gaze": (GAZE, _DIRECTION),
            "dot": (names("dot_", "xyz", "_mm"), _POINT),
        },
        (names("virtual_", "uv") + names("real_", "uv"), CAMERA_PIXEL),
    ),
)

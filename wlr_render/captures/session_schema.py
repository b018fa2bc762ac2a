"""Tables of a bench session: columns, units, checks, and conversion to and from plans and readings.

Reading, writing, checking and docs/bench-session.md follow `SCHEMAS`.

`device_from_file` (3, 3) turns the axes of bench.toml into the device frame's: the identity for "openxr", diag(1, -1,
-1) for "opencv". It applies to the device, the world, the camera and the printed target, so that a rotation R of the
file becomes `device_from_file @ R @ device_from_file.T`. Camera pixels have their centres at whole numbers in the file
and half a pixel further here; panel pixels are the same in both.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from wlr_render.captures.session import DisplayPlan, RunTimePlan, SeeThroughPlan
from wlr_render.geometry.directions import normalised
from wlr_render.geometry.transforms import rigid, rotation_of_quaternion
from wlr_render.io.file_records import CAMERA_PIXEL, MM, Quantity, Rule
from wlr_render.io.input_files import LIMITS
from wlr_render.numerics.arrays import FloatArray

Columns = dict[str, FloatArray]
"""Columns (n,) by their names, in the units and the frame of the file."""


def _rotation_of_file(xyzw: FloatArray, device_from_file: FloatArray) -> FloatArray:
    return np.asarray(device_from_file @ rotation_of_quaternion(normalised(xyzw)) @ device_from_file.T)


def _rotation_to_file(rotation: FloatArray, device_from_file: FloatArray) -> FloatArray:
    return np.asarray(
        scipy.spatial.transform.Rotation.from_matrix(device_from_file.T @ rotation @ device_from_file).as_quat()
    )


def _pose_of_file(pose: FloatArray, device_from_file: FloatArray) -> FloatArray:
    rotation = _rotation_of_file(pose[:, 3:], device_from_file)
    return rigid(rotation, _POINT.of_file(pose[:, :3], device_from_file))


def _pose_to_file(pose: FloatArray, device_from_file: FloatArray) -> FloatArray:
    position = _POINT.to_file(pose[:, :3, 3], device_from_file)
    return np.concatenate([position, _rotation_to_file(pose[:, :3, :3], device_from_file)], axis=1)


_NUMBER = Quantity(lambda value, _: value[:, 0], lambda value, _: value[:, None])
_WHOLE = Quantity(lambda value, _: value[:, 0].astype(np.int64), lambda value, _: value[:, None])
_POINT = Quantity(lambda value, axes: MM * value @ axes.T, lambda value, axes: value @ axes / MM)
_FLAT_POINT = Quantity(lambda value, axes: MM * value @ axes[:2, :2].T, lambda value, axes: value @ axes[:2, :2] / MM)
_HEIGHT = Quantity(
    lambda value, axes: MM * axes[2, 2] * value[:, 0], lambda value, axes: axes[2, 2] * value[:, None] / MM
)
_VECTOR = Quantity(lambda value, axes: value @ axes.T, lambda value, axes: value @ axes)
_DIRECTION = Quantity(lambda value, axes: normalised(value) @ axes.T, lambda value, axes: value @ axes)
_ROTATION = Quantity(_rotation_of_file, _rotation_to_file)
_POSE = Quantity(_pose_of_file, _pose_to_file)


NUMBER = Rule("number", np.isfinite)
INDEX = Rule("whole number from 0", lambda value: (value >= 0) & (value == np.round(value)))
SIGN = Rule("+1 or -1", lambda value: abs(value) == 1)
CHANNEL = Rule("0, 1 or 2", lambda value: (value == 0) | (value == 1) | (value == 2))
POSITIVE = Rule("above 0", lambda value: value > 0)


@dataclass(frozen=True)
class Column:
    """One column of a table.

    Attributes:
        name: name in the header line.
        unit: unit in words; empty for a bare number.
        meaning: description for the documentation.
        kind: allowed values, (n,) -> mask (n,).
        group: name of a group of optional columns that occur together; empty for a required column.
        absent: default of an optional column; None if the default is not a number.
        most: largest plausible absolute value in `unit`; None: the value in `_MOST`.
        least: smallest plausible value in `unit`.
    """

    name: str
    unit: str
    meaning: str
    kind: Rule = NUMBER
    group: str = ""
    absent: float | None = None
    most: float | None = None
    least: float = -math.inf

    @property
    def largest(self) -> float:
        """Largest plausible absolute value."""
        return _MOST[self.unit] if self.most is None else self.most


_MOST = {"": LIMITS.index, "mm": 1e5, "px": 1e6, "s": LIMITS.time_s, "mm/s": 2e4, "rad/s": 20.0}
"""Largest plausible value by unit: a target or head within 100 m, a head that turns at 1100 degrees a second."""
_MOST_IN_DEVICE_MM = 1e4  # largest distance of stages, targets and pupils from the device


@dataclass(frozen=True)
class Field:
    """Columns that together form one attribute of a plan, or its reading.

    Attributes:
        attribute: attribute of the plan, or of `Readings`.
        quantity: conversion of the columns, (n, k).
        columns: the k columns; all optional or none.
    """

    attribute: str
    quantity: Quantity
    columns: tuple[Column, ...]

    def stacked(self, columns: Columns) -> FloatArray:
        """Return the field's columns stacked, (n, k)."""
        return np.stack([columns[column.name] for column in self.columns], axis=1)


@dataclass(frozen=True)
class Schema:
    """One table, a part of a session.

    Attributes:
        name: name of the file without its suffix.
        title: content of a row.
        plan: attribute of a `SessionPlan`.
        plan_type: its type.
        reading: attribute of `Readings`.
        fields: fields in the order of writing; a file may have columns in any order.
        capture_key: columns that together identify the capture of a row.
        setup: columns that are equal in all rows of a capture, and differ from one capture to the next.
        unit_vectors: columns that together are a vector of length 1.
    """

    name: str
    title: str
    plan: str
    plan_type: type
    reading: str
    fields: tuple[Field, ...]
    capture_key: tuple[str, ...]
    setup: tuple[str, ...]
    unit_vectors: tuple[tuple[str, ...], ...] = ()

    @property
    def columns(self) -> tuple[Column, ...]:
        """All columns, in the order in which they are written."""
        return tuple(column for field in self.fields for column in field.columns)

    def of_file(self, columns: Columns, device_from_file: FloatArray) -> tuple[Any, FloatArray]:
        """Convert columns of a file to a plan and its readings."""
        values = {
            field.attribute: field.quantity.of_file(field.stacked(columns), device_from_file)
            for field in self.fields
            if field.columns[0].name in columns
        }
        reading = values.pop(self.reading)
        return self.plan_type(**values), reading

    def to_file(self, plan: Any, reading: FloatArray, device_from_file: FloatArray) -> Columns:
        """Convert a plan and its readings to columns of a file."""
        columns: Columns = {}
        for field in self.fields:
            value = reading if field.attribute == self.reading else getattr(plan, field.attribute)
            absent = field.columns[0].absent
            if value is not None and (absent is None or np.any(value != absent)):
                names = (column.name for column in field.columns)
                columns |= dict(zip(names, field.quantity.to_file(value, device_from_file).T, strict=True))
        return columns


def _axes(
    name: str, unit: str, suffix: str, meaning: str, axes: str = "xyz", most: float | None = None
) -> tuple[Column, ...]:
    return tuple(Column(f"{name}_{axis}{suffix}", unit, f"{meaning}, {axis}", most=most) for axis in axes)


def _quaternion(name: str, meaning: str, group: str = "") -> tuple[Column, ...]:
    return tuple(Column(f"{name}_q{axis}", "", f"{meaning}: quaternion, {axis}", group=group) for axis in "xyzw")


def _pixel(name: str, meaning: str, group: str = "") -> tuple[Column, ...]:
    return tuple(Column(f"{name}_{axis}", "px", f"{meaning}, {axis}", group=group) for axis in "uv")


def _single(name: str, unit: str, meaning: str, kind: Rule = NUMBER, **rules: Any) -> Field:
    """Return the field of one column of the same name."""
    quantity = _WHOLE if kind in (INDEX, CHANNEL) else _NUMBER
    return Field(name, quantity, (Column(name, unit, meaning, kind, **rules),))


_SESSION_TIME = _single(
    "time_s", "s", "time since the start of the session (default: not recorded)", group="time", absent=0.0
)
_STAGE = Field(
    "stage",
    _POINT,
    _axes("stage", "mm", "_mm", "stage reading of the camera's centre of projection", most=_MOST_IN_DEVICE_MM),
)
_STAGE_NAMES = tuple(f"stage_{axis}_mm" for axis in "xyz")
_ORIENTATION = Field(
    "orientation", _ROTATION, _quaternion("camera", "camera rotation device_from_camera (default: none)", "camera_q")
)
_SIGMA = _single(
    "sigma_px",
    "px",
    "standard deviation of the reading per axis, camera pixels (default: `point_sigma_px` of `[camera]`)",
    POSITIVE,
    group="sigma",
    most=100.0,
    least=1e-6,
)
_CAMERA_QUATERNION = tuple(f"camera_q{axis}" for axis in "xyzw")
_HEAD_QUATERNION = tuple(f"head_q{axis}" for axis in "xyzw")
_GAZE = tuple(f"gaze_{axis}" for axis in "xyz")

DISPLAY = Schema(
    "display",
    "decoded camera pixel",
    "display",
    DisplayPlan,
    "panel_pixel",
    (
        _single("capture", "", "index of the photograph", INDEX),
        _SESSION_TIME,
        _single("travel", "", "direction of the stage's last move in x", SIGN),
        _STAGE,
        _single("channel", "", "0 red, 1 green, 2 blue", CHANNEL),
        Field("camera_pixel", CAMERA_PIXEL, _pixel("camera", "camera pixel")),
        Field("panel_pixel", Quantity(), _pixel("pixel", "decoded panel position")),
        _ORIENTATION,
        _SIGMA,
    ),
    ("capture",),
    ("time_s", "travel", *_STAGE_NAMES, *_CAMERA_QUATERNION),
    (_CAMERA_QUATERNION,),
)

SEE_THROUGH = Schema(
    "seethrough",
    "dot of the printed target found in a photograph",
    "see_through",
    SeeThroughPlan,
    "dot_pixel",
    (
        _single("target_pose", "", "index of the [[target_pose]] in bench.toml", INDEX),
        _single("capture", "", "index of the photograph, counted from 0 at every target pose", INDEX),
        _SESSION_TIME,
        _STAGE,
        Field(
            "dot",
            _FLAT_POINT,
            _axes("target", "mm", "_mm", "position of the dot on the printed target", "xy", _MOST_IN_DEVICE_MM),
        ),
        Field("dot_pixel", CAMERA_PIXEL, _pixel("camera", "position of the dot in the photograph, through the optics")),
        _single(
            "travel", "", "direction of the stage's last move in x (default: +1)", SIGN, group="travel", absent=1.0
        ),
        _ORIENTATION,
        Field(
            "bare_pixel",
            CAMERA_PIXEL,
            _pixel("bare", "position of the dot photographed from the same place without the headset", "bare"),
        ),
        Field(
            "height",
            _HEIGHT,
            (
                Column(
                    "target_z_mm", "mm", "height of the dot above the plane of the target (default: 0)", group="height"
                ),
            ),
        ),
        _SIGMA,
    ),
    ("target_pose", "capture"),
    ("time_s", "travel", *_STAGE_NAMES, *_CAMERA_QUATERNION),
    (_CAMERA_QUATERNION,),
)

RUN_TIME = Schema(
    "runtime",
    "time at which a real dot and the virtual dot drawn over it were observed",
    "run_time",
    RunTimePlan,
    "run_time_pixel",
    (
        _single("capture", "", "index of the recording; a recording has many rows", INDEX),
        _single("time_s", "s", "time since the start of the session"),
        Field(
            "world_from_device",
            _POSE,
            (
                *_axes("head", "mm", "_mm", "origin of the device frame in the world"),
                *_quaternion("head", "world_from_device"),
            ),
        ),
        Field("head_velocity", _POINT, _axes("head_velocity", "mm/s", "_mm_s", "velocity of that origin, world frame")),
        Field("head_rate", _VECTOR, _axes("head_rate", "rad/s", "_rad_s", "angular velocity of the head, world frame")),
        Field(
            "viewpoint",
            _POINT,
            _axes("viewpoint", "mm", "_mm", "tracked position of the pupil, device frame", most=_MOST_IN_DEVICE_MM),
        ),
        Field("gaze", _DIRECTION, _axes("gaze", "", "", "unit gaze direction, device frame")),
        Field("dot", _POINT, _axes("dot", "mm", "_mm", "the real dot, world frame")),
        Field(
            "run_time_pixel",
            CAMERA_PIXEL,
            (
                *_pixel("virtual", "position of the virtual dot in the eyeball camera's image"),
                *_pixel("real", "position of the real dot in that image"),
            ),
        ),
    ),
    ("capture",),
    (),
    (_HEAD_QUATERNION, _GAZE),
)

SCHEMAS = (DISPLAY, SEE_THROUGH, RUN_TIME)

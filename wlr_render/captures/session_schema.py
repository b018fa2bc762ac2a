"""Schema of the tables of a bench session: columns with units. Reading, writing, checks and documentation use it.

Lengths and directions are in the frame that bench.toml states, camera pixels have their centres at integers,
panel pixels are 0 at the panel's outer edge. `session_columns` turns them into this library's conventions.
"""

from dataclasses import dataclass
from enum import StrEnum


class Kind(StrEnum):
    """Values allowed in a column, in words."""

    NUMBER = "number"
    INDEX = "whole number from 0"
    SIGN = "+1 or -1"
    CHANNEL = "0, 1 or 2"


@dataclass(frozen=True)
class Column:
    """One column of a table.

    Attributes:
        name: in the header line.
        unit: in words; empty for a bare number.
        meaning: in words, for the documentation.
        kind: allowed values.
        group: name of a group of optional columns that occur together; empty for a required column.
        absent: default of an optional column; None if the default is not a number.
    """

    name: str
    unit: str
    meaning: str
    kind: Kind = Kind.NUMBER
    group: str = ""
    absent: float | None = None


@dataclass(frozen=True)
class Schema:
    """One table.

    Attributes:
        name: the file's name without its suffix.
        title: what a row is.
        columns: in the order in which they are written; a file may have them in any order.
        capture_key: the columns that identify the capture of a row.
        setup: the columns that are constant in a capture, and differ between captures.
        unit_vectors: groups of columns that form a unit vector.
    """

    name: str
    title: str
    columns: tuple[Column, ...]
    capture_key: tuple[str, ...]
    setup: tuple[str, ...]
    unit_vectors: tuple[tuple[str, ...], ...] = ()


def _triple(name: str, unit: str, suffix: str, meaning: str) -> tuple[Column, ...]:
    return tuple(Column(f"{name}_{axis}{suffix}", unit, f"{meaning}, {axis}") for axis in "xyz")


def _quaternion(name: str, meaning: str, group: str = "") -> tuple[Column, ...]:
    return tuple(Column(f"{name}_q{axis}", "", f"{meaning}: quaternion, {axis}", group=group) for axis in "xyzw")


def _pixel(name: str, meaning: str, group: str = "") -> tuple[Column, ...]:
    return tuple(Column(f"{name}_{axis}", "px", f"{meaning}, {axis}", group=group) for axis in "uv")


def names(prefix: str, endings: str, suffix: str = "") -> tuple[str, ...]:
    """Column names such as stage_x_mm, stage_y_mm, stage_z_mm."""
    return tuple(f"{prefix}{ending}{suffix}" for ending in endings)


_TIME = Column("time_s", "s", "time since the start of the session")
_STAGE = _triple("stage", "mm", "_mm", "stage reading of the camera's centre of projection")
STAGE = names("stage_", "xyz", "_mm")
CAMERA_QUATERNION = names("camera_q", "xyzw")
HEAD_QUATERNION = names("head_q", "xyzw")
GAZE = names("gaze_", "xyz")

DISPLAY = Schema(
    "display",
    "decoded camera pixel",
    (
        Column("capture", "", "index of the photograph", Kind.INDEX),
        _TIME,
        Column("travel", "", "direction of the stage's last move in x", Kind.SIGN),
        *_STAGE,
        Column("channel", "", "0 red, 1 green, 2 blue", Kind.CHANNEL),
        *_pixel("camera", "camera pixel"),
        *_pixel("pixel", "decoded panel position"),
    ),
    ("capture",),
    ("time_s", "travel", *STAGE),
)

SEE_THROUGH = Schema(
    "seethrough",
    "dot of the printed target found in a photograph",
    (
        Column("target_pose", "", "index of the [[target_pose]] in bench.toml", Kind.INDEX),
        Column("capture", "", "index of the photograph, counted from 0 at every target pose", Kind.INDEX),
        _TIME,
        *_STAGE,
        *(Column(f"target_{axis}_mm", "mm", f"position of the dot on the printed target, {axis}") for axis in "xy"),
        *_pixel("camera", "position of the dot in the photograph, through the optics"),
        Column("travel", "", "direction of the stage's last move in x (default: +1)", Kind.SIGN, "travel", 1.0),
        *_quaternion("camera", "camera rotation device_from_camera (default: none)", "camera_q"),
        *_pixel("bare", "position of the dot photographed from the same place without the headset", "bare"),
    ),
    ("target_pose", "capture"),
    ("time_s", "travel", *STAGE, *CAMERA_QUATERNION),
    (CAMERA_QUATERNION,),
)

RUN_TIME = Schema(
    "runtime",
    "time at which a real dot and the virtual dot drawn over it were observed",
    (
        Column("capture", "", "index of the recording; a recording has many rows", Kind.INDEX),
        _TIME,
        *_triple("head", "mm", "_mm", "origin of the device frame in the world"),
        *_quaternion("head", "world_from_device"),
        *_triple("head_velocity", "mm/s", "_mm_s", "velocity of that origin, world frame"),
        *_triple("head_rate", "rad/s", "_rad_s", "angular velocity of the head, world frame"),
        *_triple("viewpoint", "mm", "_mm", "tracked position of the pupil, device frame"),
        *_triple("gaze", "", "", "unit gaze direction, device frame"),
        *_triple("dot", "mm", "_mm", "the real dot, world frame"),
        *_pixel("virtual", "position of the virtual dot in the eyeball camera's image"),
        *_pixel("real", "position of the real dot in that image"),
    ),
    ("capture",),
    (),
    (HEAD_QUATERNION, GAZE),
)

SCHEMAS = (DISPLAY, SEE_THROUGH, RUN_TIME)

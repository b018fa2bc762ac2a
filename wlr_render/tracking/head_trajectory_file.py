"""Read head trajectories in TUM or EuRoC text files or OpenXR recordings, and write TUM.

Errors name the file and the line. `.jsonl` is an OpenXR recording (`openxr_recording.py`).

A header that names the columns, with or without `#`, decides their meaning: a time, a position and a quaternion, in
any order, with units as in `timestamp_ns` or `x [mm]`; other columns are ignored. Without one, rows separated by blanks
are TUM, `time tx ty tz qx qy qz qw` in seconds, and others EuRoC ground truth: integer nanoseconds, position,
quaternion wxyz, and possibly nine columns of velocity and biases, which are ignored.

Poses are poses of the device frame (OpenXR: x right, y up, looking along -z) in the world of the scene. Convert
the pose of an OpenCV camera at the same place by a half turn about x:
`world_from_device = world_from_camera @ diag(1, -1, -1, 1)`.
"""

from pathlib import Path

import numpy as np

from wlr_render.io import atomic_files
from wlr_render.io.input_files import shown
from wlr_render.tracking.openxr_recording import SUFFIX, read_openxr_head
from wlr_render.tracking.text_rows import (
    TIME,
    NamedColumn,
    Row,
    read_text_table,
    require_ascending_rows,
    require_plausible_motion,
    shortest,
)
from wlr_render.tracking.trajectory import HeadTrajectory

_FAR_M = 1000.0  # largest distance from the origin of the world
_KITTI = 12
"""Columns of KITTI's poses, which have no times."""
_QUATERNION = "quaternion|quat|q|rotation|rot|orientation"
_POSITION = "position|pos|p|translation|trans|t|location|loc"
_ROLES = {
    TIME: "time",
    rf"(?:.*[._ /])?(?:{_QUATERNION})(?:_[a-z]+)?[._ ]?([wxyz])": r"q\1",
    rf"(?:.*[._ /])?(?:{_POSITION})(?:_[a-z]+_[a-z]+)?[._ ]?([xyz])"
    "|(?:(?:head|headset|hmd|device|camera|cam|pose)[._ ])?([xyz])": r"\1\2",
}
"""Patterns of column names without units, in lower case, and their roles."""
_NEEDED = ("time", "x", "y", "z", "qx", "qy", "qz", "qw")


def read_head_trajectory(path: str | Path) -> HeadTrajectory:
    """Read head poses from a TUM or EuRoC file or an OpenXR recording (.jsonl).

    Raises:
        BadInputError: unreadable or empty file, wrong column count, a value that is not finite, a quaternion that is
            not of unit length, times that do not ascend, times or positions of another unit.
    """
    if Path(path).suffix == SUFFIX:
        return read_openxr_head(path)
    table = read_text_table(path)
    columns = table.columns(_ROLES, _NEEDED)
    if columns is not None:
        count = len(table.header or table.rows[0].fields)
        content = np.array([_named_row(row, columns, count) for row in table.rows])
    else:
        if len((first := table.rows[0]).fields) == _KITTI:
            raise first.fail("12 columns, as KITTI's poses, which have no times; write TUM: time tx ty tz qx qy qz qw.")
        content = np.array([(_euroc_row if table.separated else _tum_row)(row) for row in table.rows])
    require_ascending_rows(table.rows, content[:, 0], 0 if columns is None else columns["time"].index)
    require_plausible_motion(str(path), content[:, 0], content[:, 1:4], _FAR_M)
    unread = () if columns is None else table.unread(columns)
    return HeadTrajectory(content[:, 0], content[:, 1:4], content[:, 4:8], str(path), unread=unread)


def _named_row(row: Row, columns: dict[str, NamedColumn], count: int) -> list[float]:
    """Return the time, position and quaternion xyzw of a row whose columns are named."""
    row.require_columns((count,), "as its header names")
    position = [columns[axis].metres(row) for axis in "xyz"]
    quaternion = [columns[f"q{axis}"].index for axis in "xyzw"]
    return [columns["time"].seconds(row), *position, *row.unit_vector(quaternion, "quaternion")]


def _tum_row(row: Row) -> list[float]:
    """Return the time, position and quaternion xyzw of a TUM row."""
    row.require_columns((8,), "TUM: time tx ty tz qx qy qz qw")
    return row.numbers(0, 4) + row.unit_vector(range(4, 8), "quaternion")


def _euroc_row(row: Row) -> list[float]:
    """Return the time, position and quaternion xyzw of an EuRoC row."""
    row.require_columns((8, 17), "EuRoC: time[ns], p x y z, q w x y z, and possibly velocity and biases")
    row.number(0)
    try:
        time_s = int(row.fields[0]) / 1e9
    except ValueError:
        raise row.fail(
            f"time {shown(row.fields[0])} is not in integer nanoseconds, as EuRoC has it; convert it, or name the "
            "columns in a first line, such as time_s,x_m,y_m,z_m,qx,qy,qz,qw."
        ) from None
    w, x, y, z = row.unit_vector(range(4, 8), "quaternion")
    return [time_s, *row.numbers(1, 3), x, y, z, w]


def write_head_trajectory_tum(path: str | Path, trajectory: HeadTrajectory) -> Path:
    """Write poses as TUM text; they are read back exactly, except for the normalisation of the quaternions."""
    lines = ["# time_s tx_m ty_m tz_m qx qy qz qw; world_from_device, OpenXR axes (x right, y up, looking along -z)"]
    content = zip(trajectory.time_s, trajectory.position_in_world, trajectory.world_from_device_xyzw, strict=True)
    lines += [shortest([time, *position, *xyzw]) for time, position, xyzw in content]
    return atomic_files.write_text(path, "\n".join(lines) + "\n")

"""Recordings of located OpenXR spaces: head, eyes and gaze. Errors name the file and the line.

OpenXR defines no file for poses. This one is JSON Lines, one result of `xrLocateSpace` or `xrLocateViews` per line,
with the names of OpenXR's structures; the first line is a header:

    {"format": "wlr-openxr-recording", "version": 1}
    {"time": 1000000000, "space": "view", "base_space": "local", "locationFlags": 15,
     "pose": {"orientation": {"x": 0, "y": 0, "z": 0, "w": 1}, "position": {"x": 0, "y": 0, "z": 0}}}

`time` is XrTime in nanoseconds. The poses of `view` are the head's, in `local`, `stage` or `local_floor`. Relative to
`view` are `left_view` and `right_view` (views of xrLocateViews), `gaze` (XR_EXT_eye_gaze_interaction), `left_gaze` and
`right_gaze` (XR_FB_eye_tracking_social), `left_pupil` and `right_pupil` (XR_ANDROID_eye_tracking). Lines of other
spaces are skipped. Lines without valid position and orientation mark a gap. Poses of the head that are valid and not
tracked are the runtime's inference, unless no line of the head is tracked: some runtimes never set these bits. OpenXR
and this package use the same axes and units, so that only the pose of VIEW space in the device frame is needed:
`device_from_view` of the header, 4 rows of 4, or the identity.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.geometry.directions import normalised
from wlr_render.io.input_files import LIMITS, read_text, require_length
from wlr_render.io.toml_files import Table, parse_json
from wlr_render.numerics.arrays import FloatArray
from wlr_render.tracking.eye_model import RotatingEye
from wlr_render.tracking.text_rows import UNIT_TOLERANCE, require_plausible_motion
from wlr_render.tracking.trajectory import EYES, EyeTrack, EyeTrajectory, GazeTrack, HeadTrajectory, ViewpointTrack

SUFFIX = ".jsonl"
"""Files with this suffix are read as recordings."""
FORMAT, _VERSION = "wlr-openxr-recording", 1
_KIND = "an OpenXR recording"
_WORLD_SPACES = ("local", "stage", "local_floor")
_SPACES = ("view", "gaze", *(f"{eye}_{space}" for eye in EYES for space in ("view", "gaze", "pupil")))
_VALID = 3  # XR_SPACE_LOCATION_ORIENTATION_VALID_BIT | XR_SPACE_LOCATION_POSITION_VALID_BIT
_TRACKED = 12  # XR_SPACE_LOCATION_ORIENTATION_TRACKED_BIT | XR_SPACE_LOCATION_POSITION_TRACKED_BIT
_FIXATION_M = 1.0
"""Assumed distance of the point that both eyes fixate, along the gaze."""
_HEAD_FAR_M, _EYE_FAR_M = 1000.0, 0.5


@dataclass(frozen=True, eq=False)
class _Located:
    """Located poses of a space: times (n,), positions (n, 3) and quaternions xyzw (n, 4) in its base space.

    `is_tracked` (n,) is False where the runtime inferred the pose. `invalid_s` (m,) are the times at which the space
    was not located.
    """

    time_s: FloatArray
    position: FloatArray
    xyzw: FloatArray
    is_tracked: NDArray[np.bool_]
    invalid_s: FloatArray

    def poses(self) -> FloatArray:
        """Return the poses (n, 4, 4)."""
        return transforms.rigid(scipy.spatial.transform.Rotation.from_quat(self.xyzw).as_matrix(), self.position)


def read_openxr_head(path: str | Path) -> HeadTrajectory:
    """Read the head trajectory of a recording, as poses of the device frame.

    Raises:
        BadInputError: unreadable file, a line that is not a location, no pose of the head, base spaces that change,
            times that do not ascend, times or positions of another unit.
    """
    device_from_view, located, _ = _read(path)
    if "view" not in located:
        raise BadInputError(
            f"{path}: has no valid pose of 'view', the head; record VIEW space in LOCAL or STAGE space."
        )
    head = located["view"]
    world_from_device = head.poses() @ transforms.inverse(device_from_view)
    require_plausible_motion(str(path), head.time_s, head.position, _HEAD_FAR_M)
    xyzw = scipy.spatial.transform.Rotation.from_matrix(world_from_device[:, :3, :3]).as_quat()
    inferred_s = head.time_s[head.is_tracked.any() & ~head.is_tracked]
    place = world_from_device[:, :3, 3]
    return HeadTrajectory(head.time_s, place, xyzw, str(path), head.invalid_s, inferred_s=inferred_s)


def read_openxr_eyes(path: str | Path) -> EyeTrajectory:
    """Read the eye trajectories of a recording, from the best data that it holds for each eye.

    In order of preference: the positions of the pupil; the gaze of the eye, or of both eyes, with a `RotatingEye`
    centred behind its view's position; or that position, as the entrance pupil of an eye that looks ahead. Both eyes
    fixate a point 1 m along their common gaze.

    Raises:
        BadInputError: positions of the views and pupils are missing; see also `read_openxr_head`.
    """
    device_from_view, located, never = _read(path)
    tracks = {eye: _eye_track(path, eye, located, device_from_view) for eye in EYES}
    tracked = {eye: track for eye, track in tracks.items() if track is not None}
    if not tracked:
        raise BadInputError(
            f"{path}: has no pose of 'left_view' or 'right_view', the positions of the eyes; record "
            "xrLocateViews in VIEW space as well."
        )
    return EyeTrajectory(tracked, str(path), tuple(f"{space} (no valid pose)" for space in never))


def _eye_track(
    path: str | Path, eye: str, located: dict[str, _Located], device_from_view: FloatArray
) -> EyeTrack | None:
    name, pupil = f"{path} ({eye} eye)", located.get(f"{eye}_pupil")
    gaze_space = f"{eye}_gaze" if f"{eye}_gaze" in located else "gaze"
    eye_places = pupil or located.get(f"{eye}_view")
    if eye_places is None:
        return None
    place = transforms.apply(device_from_view, eye_places.position)
    require_plausible_motion(name, eye_places.time_s, place, _EYE_FAR_M)
    if pupil or gaze_space not in located:
        return ViewpointTrack(eye_places.time_s, place, name, eye_places.invalid_s)
    gaze = located[gaze_space]
    device_from_gaze = device_from_view @ gaze.poses()
    gaze_dir = -device_from_gaze[:, :3, 2]
    turning = RotatingEye.looking_ahead_from(np.median(place, axis=0))
    if gaze_space == "gaze":
        fixated = device_from_gaze[:, :3, 3] + _FIXATION_M * gaze_dir
        gaze_dir = normalised(fixated - turning.rotation_centre_in_device)
    if (gaze_dir[:, 2] >= 0).any():
        raise BadInputError(
            f"{path}: the pose of '{gaze_space}' looks backwards; it looks along its -z, and must be located in 'view'."
        )
    return GazeTrack(gaze.time_s, gaze_dir, turning, name, gaze.invalid_s)


def _read(path: str | Path) -> tuple[FloatArray, dict[str, _Located], list[str]]:
    """Read `device_from_view`, the poses of each space, and the names of the spaces without any valid pose."""
    lines = read_text(path, _KIND, LIMITS.table_bytes).splitlines()
    if len(lines) > LIMITS.rows:
        raise BadInputError(f"{path}: has {len(lines)} lines, more than {LIMITS.rows}; cut it into parts.")
    tables = [
        Table(parse_json(where, line, _KIND, "write it again"), where)
        for where, line in ((f"{path} line {number}", line) for number, line in enumerate(lines, start=1))
        if line.strip()
    ]
    if not tables:
        raise BadInputError(f"{path}: has no lines; is the recording empty?")
    header, *rows = tables
    header.check_head(FORMAT, _VERSION)
    entries_of: dict[str, list[tuple[Table, list[float]]]] = {}
    invalid_s: dict[str, list[float]] = {}
    bases: set[str] = set()
    for row in rows:
        space = row.text("space")
        if space not in _SPACES:
            continue
        base = row.text("base_space", choices=_WORLD_SPACES if space == "view" else ("view",))
        if space == "view":
            bases.add(base)
        if len(bases) > 1:
            raise row.fail(f"'base_space' changes from {' to '.join(sorted(bases))}; record the head in one space.")
        flags = row.whole("locationFlags", most=2**32)
        if flags & _VALID == _VALID:
            entries_of.setdefault(space, []).append((row, [*_numbers(row), flags & _TRACKED == _TRACKED]))
        else:
            invalid_s.setdefault(space, []).append(row.number("time") / 1e9)
    located = {space: _located(entries, invalid_s.get(space, [])) for space, entries in entries_of.items()}
    return _device_from_view(header), located, [space for space in invalid_s if space not in entries_of]


def _numbers(row: Table) -> list[float]:
    """Return the time in seconds, position and quaternion xyzw of a line."""
    pose = row.table("pose")
    place, turn = pose.table("position"), pose.table("orientation")
    xyzw = [turn.number(axis) for axis in "xyzw"]
    length = float(np.linalg.norm(xyzw))
    if abs(length - 1.0) > UNIT_TOLERANCE:
        raise turn.fail(f"the quaternion has length {length:.6g}, not 1; correct it.")
    return [row.number("time") / 1e9, *(place.number(axis) for axis in "xyz"), *(each / length for each in xyzw)]


def _located(entries: Sequence[tuple[Table, list[float]]], invalid_s: Sequence[float]) -> _Located:
    content = np.array([numbers for _, numbers in entries])
    late = np.flatnonzero(np.diff(content[:, 0]) <= 0)
    if late.size:
        raise entries[int(late[0]) + 1][0].fail(
            "'time' does not come after the previous time of the same space; sort the lines, drop duplicates."
        )
    return _Located(content[:, 0], content[:, 1:4], content[:, 4:8], content[:, 8] == 1, np.array(invalid_s))


def _device_from_view(header: Table) -> FloatArray:
    if not header.has("device_from_view"):
        return np.eye(4)
    matrix = header.vectors("device_from_view", 4)
    is_whole = matrix.shape == (4, 4) and (matrix[3] == [0, 0, 0, 1]).all()
    if not is_whole or not transforms.is_rotation(matrix[:3, :3]):
        raise header.fail(
            "'device_from_view' must be a rigid transform, 4 rows of 4, the last one 0 0 0 1; correct it."
        )
    require_length(f"{header.where}: 'device_from_view'", matrix[:3, 3], _EYE_FAR_M)
    return matrix

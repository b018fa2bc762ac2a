"""Read and write eye trajectories in text files. Errors name the file and the line.

    # format: wlr-eye-trajectory 1
    # kind: viewpoint
    # frame: openxr-device
    # units: s m
    0.000 right 0.0321 0.0002 -0.0300

`viewpoint` rows are `time eye x y z`, the entrance pupil in the device frame. `gaze` rows are `time eye dx dy dz`, a
unit direction; then the header also states `# rotation_centre_right_m: x y z` for each eye in the file, and may state
`# pupil_distance_m: d`. Rows of the two eyes may interleave; each eye's times ascend. `.jsonl` is an OpenXR recording
(`openxr_recording.py`).

A table whose first line names its columns with their units needs no such header: `time_s,left_x_mm,left_y_mm,...` with
the entrance pupils of one or both eyes in the device frame, or `time_s,eye,x_mm,y_mm,z_mm` with the eye in each row.
"""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.io import atomic_files
from wlr_render.io.input_files import require_length, shown
from wlr_render.numerics.arrays import FloatArray
from wlr_render.tracking.eye_model import PUPIL_DISTANCE_M, RotatingEye
from wlr_render.tracking.openxr_recording import SUFFIX, read_openxr_eyes
from wlr_render.tracking.text_rows import (
    TIME,
    NamedColumn,
    Row,
    TextTable,
    read_text_table,
    require_ascending_rows,
    require_plausible_motion,
    require_plausible_times,
    role_of,
    shortest,
)
from wlr_render.tracking.trajectory import EYES, EyeTrack, EyeTrajectory, GazeTrack, ViewpointTrack

EYE_FORMAT = "wlr-eye-trajectory 1"
EYE_FRAME = "openxr-device"
_FAR_M = 0.5  # largest distance of an eye from the origin of the device frame
_PUPIL_DISTANCE_M = 0.0, 0.03
_PUPIL = r"(?:_?eye)?(?:_?(?:entrance_)?(?:pupil|viewpoint))?(?:_?(?:position|pos|centre|center))?"
_ROLES = {
    TIME: "time",
    rf"(left|right){_PUPIL}[_. ]?([xyz])": r"\1_\2",
    r"(?:pupil|viewpoint|eye)(?:_?(?:position|pos))?_(left|right)[_. ]?([xyz])": r"\1_\2",
    r"([xyz])_(left|right)": r"\2_\1",
    r"eye": "eye",
    r"(?:(?:entrance_)?(?:pupil|viewpoint)_?)?([xyz])": r"\1",
}
"""Patterns of column names without units, in lower case, and their roles."""
_WANTED = f"""start it with the lines '# format: {EYE_FORMAT}', '# kind: viewpoint', '# frame: {EYE_FRAME}' and \
'# units: s m', or name its columns in the first line, such as time_s,left_x_mm,left_y_mm,left_z_mm"""


def read_eye_trajectory(path: str | Path) -> EyeTrajectory:
    """Read an eye trajectory, or the eyes of an OpenXR recording (.jsonl).

    Raises:
        BadInputError: unreadable or empty file, a missing or unknown header, wrong column count, unknown eye, a value
            that is not finite, a gaze that is not of unit length or looks backwards, times that do not ascend, times
            or positions of another unit.
    """
    if Path(path).suffix == SUFFIX:
        return read_openxr_eyes(path)
    table = read_text_table(path)
    header = _Header(table)
    if not header.states_format and (columns := table.columns(_ROLES, _needed(table))) is not None:
        return _of_named_columns(table, columns)
    header.check()
    gaze = header.text("kind", ("viewpoint", "gaze")) == "gaze"
    tracks: dict[str, EyeTrack] = {}
    for eye, rows in _rows_by_eye(table).items():
        content = np.array([[row.number(0), *(_gaze(row) if gaze else row.numbers(2, 3))] for row in rows])
        name = f"{path} ({eye} eye)"
        if gaze:
            require_ascending_rows(rows, content[:, 0])
            require_plausible_times(name, content[:, 0])
            tracks[eye] = GazeTrack(content[:, 0], content[:, 1:], header.eye_model(eye), name)
        else:
            tracks[eye] = _viewpoints(name, rows, content)
    return EyeTrajectory(tracks, str(path))


def _viewpoints(name: str, rows: Sequence[Row], content: FloatArray, column: int = 0) -> ViewpointTrack:
    """Build the track of rows (n, 4) of time and position, NaN during a loss; `column` is the column of the time."""
    require_ascending_rows(rows, content[:, 0], column)
    lost = np.isnan(content[:, 1])
    time_s, viewpoint = content[~lost, 0], content[~lost, 1:]
    require_plausible_motion(name, time_s, viewpoint, _FAR_M)
    return ViewpointTrack(time_s, viewpoint, name, content[lost, 0])


def _needed(table: TextTable) -> tuple[str, ...]:
    """Return the roles of the columns that the table needs: the coordinates of each eye, or of one eye in each row."""
    roles = {role_of(name, _ROLES) for cells in (table.header or (), *table.headers) for name in cells}
    eyes = [eye for eye in EYES if roles & {f"{eye}_{axis}" for axis in "xyz"}]
    if not eyes:
        return ("time", "eye", "x", "y", "z")
    return ("time", *(f"{eye}_{axis}" for eye in eyes for axis in "xyz"))


def _of_named_columns(table: TextTable, columns: dict[str, NamedColumn]) -> EyeTrajectory:
    """Read entrance pupils from named columns; an eye without numbers in a row was lost there."""
    count = len(table.rows[0].fields if table.header is None else table.header)
    for role, column in columns.items():
        if column.unit == "" and role != "eye":
            unit = "s" if role == "time" else "m"
            raise BadInputError(
                f"{table.path}: column '{column.name}' has no unit; name it {column.name}_{unit}, or with its own unit."
            )
    content: dict[str, list[tuple[Row, list[float]]]] = {}
    for row in table.rows:
        row.require_columns((count,), "as its header names")
        for eye, places in _eyes_of(row, columns).items():
            is_lost = all(row.fields[place.index].lower() in ("", "nan") for place in places)
            place_m = [math.nan] * 3 if is_lost else [place.metres(row) for place in places]
            content.setdefault(eye, []).append((row, [columns["time"].seconds(row), *place_m]))
    content = {eye: pairs for eye, pairs in content.items() if not all(math.isnan(each[1]) for _, each in pairs)}
    if not content:
        raise BadInputError(f"{table.path}: has no position of an eye; is the recording empty?")
    return EyeTrajectory(
        {
            eye: _viewpoints(
                f"{table.path} ({eye} eye)",
                [row for row, _ in pairs],
                np.array([numbers for _, numbers in pairs]),
                columns["time"].index,
            )
            for eye, pairs in content.items()
        },
        str(table.path),
        unread=table.unread(columns),
    )


def _eyes_of(row: Row, columns: dict[str, NamedColumn]) -> dict[str, list[NamedColumn]]:
    """Return the position columns of each eye that a row may have."""
    if "eye" not in columns:
        eyes = [eye for eye in EYES if f"{eye}_x" in columns]
        return {eye: [columns[f"{eye}_{axis}"] for axis in "xyz"] for eye in eyes}
    word = row.fields[columns["eye"].index].lower()
    eye = {"l": "left", "r": "right"}.get(word, word)
    if eye not in EYES:
        raise row.fail(f"unknown eye {shown(eye)}; it must be one of {', '.join(EYES)}.")
    return {eye: [columns[axis] for axis in "xyz"]}


def _rows_by_eye(table: TextTable) -> dict[str, list[Row]]:
    by_eye: dict[str, list[Row]] = {}
    for row in table.rows:
        row.require_columns((5,), "time eye x y z")
        eye = row.fields[1]
        if eye not in EYES:
            raise row.fail(f"unknown eye {shown(eye)}; it must be one of {', '.join(EYES)}.")
        by_eye.setdefault(eye, []).append(row)
    return by_eye


def _gaze(row: Row) -> list[float]:
    gaze_dir = row.unit_vector(range(2, 5), "gaze")
    if gaze_dir[2] >= 0:
        raise row.fail("the gaze looks backwards; the device frame looks along -z, so its z must be negative.")
    return gaze_dir


class _Header:
    """The `# key: value` comments of an eye trajectory."""

    def __init__(self, table: TextTable) -> None:
        pairs = (comment.partition(":") for comment in table.comments)
        self._values = {key.strip(): value.strip() for key, colon, value in pairs if colon}
        self._path = table.path
        self.states_format = "format" in self._values

    def check(self) -> None:
        """Refuse another format, frame or units."""
        self.text("format", (EYE_FORMAT,))
        self.text("frame", (EYE_FRAME,))
        self.text("units", ("s m",))

    def text(self, key: str, choices: tuple[str, ...]) -> str:
        """Return the value of a header key, one of `choices`."""
        value = self._values.get(key)
        if value not in choices:
            problem = "is missing" if value is None else f"is {shown(value)}"
            remedy = f"it must be {' or '.join(choices)}"
            remedy += f": {_WANTED}" if key == "format" and value is None else ""
            raise BadInputError(f"{self._path}: header '# {key}:' {problem}; {remedy}.")
        return value

    def numbers(self, key: str, count: int) -> list[float]:
        """Return the value of a header key: `count` finite numbers."""
        try:
            values = [float(item) for item in self._values.get(key, "").split()]
        except ValueError:
            values = []
        if len(values) != count or not np.isfinite(values).all():
            raise BadInputError(f"{self._path}: header '# {key}:' must state {count} number(s), in metres.")
        return values

    def eye_model(self, eye: str) -> RotatingEye:
        """Return the eye model that the header states."""
        key = f"rotation_centre_{eye}_m"
        centre = np.array(self.numbers(key, 3))
        require_length(f"{self._path}: header '# {key}:'", centre, _FAR_M)
        if "pupil_distance_m" not in self._values:
            return RotatingEye(centre, PUPIL_DISTANCE_M)
        (distance,), (low, high) = self.numbers("pupil_distance_m", 1), _PUPIL_DISTANCE_M
        if not low <= distance <= high:
            raise BadInputError(
                f"{self._path}: header '# pupil_distance_m:' is {distance:g}; it must lie between {low:g} and {high:g} "
                "metres."
            )
        return RotatingEye(centre, distance)


def write_eye_trajectory(path: str | Path, trajectory: EyeTrajectory) -> Path:
    """Write an eye trajectory, viewpoints or gazes, rows ascending in time over both eyes.

    Raises:
        BadInputError: the eyes are of different kinds or pupil distances, which one file cannot hold.
    """
    tracks = trajectory.tracks
    models = {eye: track.eye_model for eye, track in tracks.items() if isinstance(track, GazeTrack)}
    distances = {model.pupil_distance_m for model in models.values()}
    if len(models) not in (0, len(tracks)) or len(distances) > 1:
        raise BadInputError(f"{path}: both eyes of one file must be of one kind and share one pupil distance.")
    kind = "gaze" if models else "viewpoint"
    lines = [f"# format: {EYE_FORMAT}", f"# kind: {kind}", f"# frame: {EYE_FRAME}", "# units: s m"]
    lines += [f"# pupil_distance_m: {shortest([distance])}" for distance in distances]
    lines += [f"# rotation_centre_{eye}_m: {shortest(m.rotation_centre_in_device)}" for eye, m in models.items()]
    rows = [(t, eye, xyz) for eye, track in tracks.items() for t, xyz in zip(track.time_s, _xyz(track), strict=True)]
    rows.sort(key=lambda row: (row[0], row[1]))
    lines += [f"{shortest([time])} {eye} {shortest(xyz)}" for time, eye, xyz in rows]
    return atomic_files.write_text(path, "\n".join(lines) + "\n")


def _xyz(track: EyeTrack) -> FloatArray:
    """Return the numbers of a track's rows, (n, 3)."""
    return track.gaze_dir if isinstance(track, GazeTrack) else track.viewpoint_at(track.time_s)

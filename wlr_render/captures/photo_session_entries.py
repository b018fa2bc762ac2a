"""Entries of session.toml: photographs and code sets with their stage readings and camera positions.

The format is in docs/photo-session.md.
"""

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, replace
from typing import Any

import numpy as np
import scipy

from wlr_render.captures.photo_session import (
    BoardPhotograph,
    CodeSet,
    PhotoSession,
    SessionEntry,
    StageAxis,
    StageDescription,
    StageTable,
)
from wlr_render.geometry.transforms import FRAMES
from wlr_render.io.file_records import Place, read_part, read_record, record_keys
from wlr_render.io.toml_files import Table
from wlr_render.numerics.arrays import FloatArray, IntArray

_MOST_AXES = 12
_MOST_READING = 1e4  # largest reading, mm or degrees
_LEVER_M = 0.025
"""Radius that converts angles of rotary axes to arcs for comparisons of readings: about the radius of a camera that
rotates about its pupil."""


def read_stage(file: Table, axes: FloatArray) -> tuple[StageDescription | None, float]:
    """Read [stage]; without one, the stage has three linear axes.

    Args:
        file: session.toml.
        axes: (3, 3) rotation from the file's axes to the device frame's.

    Returns:
        The stage, None for a camera without one, and the tolerance of positions in metres.

    Raises:
        BadInputError: a key is faulty; the message names it.
    """
    table = file.table("stage") if file.has("stage") else Table({}, file.where)
    stated, stage = read_part(StageTable, table), StageDescription()
    in_camera = stated.directions_in == "camera"
    if stated.kind == "none":
        table.finish()
        return None, stated.place_tolerance
    if table.has("axes"):
        place, listed = _place_of_axes(in_camera, axes), table.tables("axes", most=_MOST_AXES)
        stage = StageDescription(tuple(read_record(StageAxis, each, place, is_in_camera=in_camera) for each in listed))
    if in_camera and all(axis.direction is None for axis in stage.axes):
        raise table.fail(
            "'directions_in' is given, but no axis has a 'direction'; list them under 'axes', or remove it."
        )
    if not stage.axes:
        raise table.fail("'axes' is empty; list an axis, or write kind = \"none\" for a camera without a stage.")
    table.finish()
    return stage, stated.place_tolerance


def written_stage(session: PhotoSession, axes: FloatArray) -> dict[str, Any]:
    """Return the table [stage] that `read_stage` reads back; empty if the file needs none."""
    if session.stage is None:
        return record_keys(StageTable("none"))
    listed = [] if _is_plain(session.stage) else session.stage.axes
    in_camera = any(axis.is_in_camera for axis in listed)
    keys = record_keys(StageTable("linear", session.place_tolerance, "camera" if in_camera else "device"))
    written = [record_keys(axis, _place_of_axes(in_camera, axes)) for axis in listed]
    return keys | ({"axes": written} if written else {})


def _place_of_axes(in_camera: bool, axes: FloatArray) -> Place:
    """Return the frame of the stage's axes: the camera's, which has OpenCV's axes in any file, or the file's."""
    return Place(axes=np.eye(3) if in_camera else axes)


def _is_plain(stage: StageDescription) -> bool:
    """Return whether a file needs no axes for the stage: three linear axes with unknown directions."""
    return len(stage.axes) == 3 and all(each.kind == "linear" and each.direction is None for each in stage.axes)


@dataclass(frozen=True, eq=False)
class EntryFormat(Place):
    """Format of the entries of one session.toml: eyes of the session, and stage of the eyeball camera, or None."""

    _: KW_ONLY
    eyes: tuple[str, ...]
    stage: StageDescription | None

    @property
    def turn(self) -> FloatArray:
        """Matrix (m, m) from readings in the file to readings along the axes of the stage.

        Readings of three linear axes of unknown directions are along the file's x, y and z, with unknown signs.
        """
        return self.axes if self.stage is None or _is_plain(self.stage) else np.eye(len(self.stage.axes))

    def photographs(self, file: Table, name: str) -> tuple[BoardPhotograph, ...]:
        """Read the list `name` of photographs of the board: "see_through", "bare", "beside" or "tracking".

        Raises:
            BadInputError: a key is missing, faulty or contradicts [stage].
        """
        photographs = []
        for table in file.tables(name, required=False):
            table.path("photograph", self.folder)  # refuses a name that leads out of the folder
            given = self._without_stage() if name == "tracking" else self._position(table, name)
            given |= {} if name == "beside" else {"regions": None}
            photographs.append(read_record(BoardPhotograph, table, folder=self.folder, **given))
        return tuple(photographs)

    def code_sets(self, file: Table) -> tuple[CodeSet, ...]:
        """Read [[display]], the sets of photographs of the panel; raises like `photographs`."""
        tables = file.tables("display", required=False)
        return tuple(read_record(CodeSet, table, self, **self._position(table, "display")) for table in tables)

    def _without_stage(self) -> dict[str, Any]:
        return {"stage": None, "place": "", "orientation": 0, "eye": self.eyes[0]}

    def _position(self, table: Table, name: str) -> dict[str, Any]:
        """Return stage reading, position and eye of an entry by the eyeball camera."""
        if len(self.eyes) > 1 and name in ("see_through", "display") and not table.has("eye"):
            raise table.fail('key \'eye\' is missing; in a session of both eyes write eye = "left" or eye = "right".')
        stage, place = self._reading(table), table.text("place", "")
        if stage is None and not place:
            raise table.fail(
                "key 'place' is missing; without a stage each entry names its camera place: entries with the "
                "same place were taken without moving the camera."
            )
        return {"stage": stage, "place": place, "eye": table.text("eye", self.eyes[0], self.eyes)}

    def _reading(self, table: Table) -> FloatArray | None:
        given = [key for key in ("stage", "stage_mm") if table.has(key)]
        if self.stage is None:
            if given:
                raise table.fail(f"'{given[0]}' is a stage reading, but [stage] has kind = \"none\"; remove one.")
            return None
        if len(given) == 2:
            raise table.fail("give either 'stage' or 'stage_mm', not both.")
        key, kinds = given[0] if given else "stage_mm", [axis.kind for axis in self.stage.axes]
        if not given and kinds != ["linear"] * 3:
            key = "stage"
        if key == "stage_mm" and "rotary" in kinds:
            raise table.fail("'stage_mm' cannot hold the angle of a rotary axis; write 'stage', mm and degrees.")
        reading = table.vector(key, len(kinds), least=-_MOST_READING, most=_MOST_READING)
        return np.asarray(self.stage.units * (self.turn @ reading))

    def written(self, entry: SessionEntry, place: str | None, on_stage: bool = True) -> dict[str, Any]:
        """Return the keys of an entry, with `place` if given; `on_stage` is True for the eyeball camera."""
        reading, key = None, "stage_mm"
        if entry.stage is not None and self.stage is not None:
            reading = self.turn.T @ (entry.stage / self.stage.units)
            key = "stage_mm" if _is_plain(self.stage) else "stage"
        keys = record_keys(replace(entry, stage=reading, place=place or ""), self)
        if len(self.eyes) == 1 or not on_stage:
            del keys["eye"]
        return {key if name == "stage" else name: value for name, value in keys.items()}


def stage_lists(session: PhotoSession) -> dict[str, Sequence[SessionEntry]]:
    """Return the lists of the eyeball camera's entries by their names in the file."""
    return {name: getattr(session, name) for name in ("bare", "beside", "see_through", "display")}


def with_places(session: PhotoSession, form: EntryFormat | None = None) -> PhotoSession:
    """Return a session in which entries without a position name get one from their stage reading.

    Args:
        session: session with a reading or a position name in each entry.
        form: format of the file, for the names; by default the format of a saved session.
    """
    form = form or EntryFormat(session.folder, FRAMES["opencv"], eyes=session.eyes, stage=session.stage)
    lists = stage_lists(session)
    names = iter(place_names([each for entries in lists.values() for each in entries], form, session.place_tolerance))
    placed: dict[str, Any] = {
        name: tuple(replace(each, place=next(names)) for each in entries) for name, entries in lists.items()
    }
    return replace(session, **placed)


def place_groups(entries: Sequence[SessionEntry], stage: StageDescription, tolerance_m: float) -> IntArray:
    """Return the number (n,) of each entry's group: one orientation, stage readings within the tolerance."""
    orientation = np.array([each.orientation for each in entries])
    lever = [1.0 if axis.kind == "linear" else _LEVER_M for axis in stage.axes]
    reading = np.array([each.stage for each in entries], dtype=np.float64).reshape(len(entries), -1) * lever
    pairs = scipy.spatial.cKDTree(reading).query_pairs(tolerance_m * (1 + 1e-9) + 1e-12, output_type="ndarray")
    pairs = pairs[orientation[pairs[:, 0]] == orientation[pairs[:, 1]]]
    graph = scipy.sparse.coo_array(
        (np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(entries), len(entries))
    )
    return np.asarray(scipy.sparse.csgraph.connected_components(graph, directed=False)[1], dtype=np.int64)


def place_names(entries: Sequence[SessionEntry], form: EntryFormat, tolerance_m: float) -> list[str]:
    """Return each entry's position name: its own, its group's, or one made from the group's first stage reading."""
    if form.stage is None or not entries:
        return [entry.place for entry in entries]
    groups = place_groups(entries, form.stage, tolerance_m)
    name_of: dict[int, str] = {}
    for group, entry in zip(groups, entries, strict=True):
        if group not in name_of:
            reading = rounded(form.turn.T @ (np.asarray(entry.stage) / form.stage.units))
            suffix = f" orientation {entry.orientation}" if entry.orientation else ""
            name_of[group] = " ".join(f"{number:.9g}" for number in reading) + suffix
    given = {(group, entry.place) for group, entry in zip(groups, entries, strict=True) if entry.place}
    for group in name_of:
        places = [place for other, place in given if other == group]
        if len(places) == 1:
            name_of[group] = places[0]
    return [entry.place or name_of[group] for group, entry in zip(groups, entries, strict=True)]


def rounded(value: Any) -> Any:
    """Return a number or an array as a list, rounded to nine decimals."""
    return (np.round(value, 9) + 0.0).tolist()

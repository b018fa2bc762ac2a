"""Read and write session folders: bench.toml and one to three tables (format: docs/bench-session.md)."""

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from wlr_render.bench.bench import Bench, Target
from wlr_render.bench.bench_file import (
    DEVICE_FILE,
    WRITTEN_FRAME,
    bench_of,
    device_from_file,
    load_bench,
    save_bench,
)
from wlr_render.captures.camera_lens_file import require_plausible_view
from wlr_render.captures.capture_checks import require_on_panel
from wlr_render.captures.session import Readings, SeeThroughPlan, Session, SessionPlan, select_rows
from wlr_render.captures.session_schema import SCHEMAS, Schema
from wlr_render.captures.session_tables import read_table, write_table
from wlr_render.errors import BadInputError
from wlr_render.geometry.transforms import FRAMES
from wlr_render.io.atomic_files import resource
from wlr_render.io.file_records import MM
from wlr_render.io.input_files import prefix_errors, require_length
from wlr_render.io.toml_files import read_toml
from wlr_render.numerics.arrays import FloatArray

FEWEST_CAPTURES = 6
_SUFFIXES = (".csv", ".csv.gz")
_TABLES = {"display": "display", "dot_pixel": "seethrough", "run_time_pixel": "runtime"}
_REACH_M = 0.5  # largest range of stage and eye; beyond it, lengths are in another unit
_NEAREST_M = 0.03  # least distance of a target from the camera
_MOST_PITCHES = 1000  # most pitches in a row of a target
_MANY = 10  # fewest rows that cannot all show the same point
_FACTOR, _LEAST_OFFSET_M = 100, 5e-3
_LEAST_TRAVEL_M = 0.5e-3
_SAME_PITCH = 1e-4  # largest relative difference of pitches of the same target


def load_session(folder: str | Path, bench_file: str | Path | None = None) -> tuple[Bench, Session]:
    """Read a session, named after its folder, and the nominal bench that bench.toml describes.

    Args:
        folder: folder with bench.toml and the tables.
        bench_file: bench of the same headset that replaces the folder's bench; see `bench_for_session`.

    Returns:
        The nominal bench, and the session measured on it: device frame, metres and radians.

    Raises:
        BadInputError: a file is missing or breaks the format, or the tables contradict the bench; the message says
            where and what to do.
    """
    folder = Path(folder)
    if not (folder / "bench.toml").is_file():
        manual = resource("docs", "bench-session.md")
        raise BadInputError(f"{folder}: has no bench.toml, so it is not a bench session; {manual} has the format.")
    file = read_toml(folder / "bench.toml")
    bench, axes = bench_of(file, folder), device_from_file(file)
    if bench_file is not None:
        bench = bench_for_session(load_bench(bench_file), bench, bench_file, folder)
    plans: dict[str, Any] = {}
    readings: dict[str, FloatArray] = {}
    for schema in SCHEMAS:
        table = _table_path(folder, schema)
        if table is not None:
            plan, reading = schema.of_file(read_table(table, schema), axes)
            plans[schema.plan], readings[schema.reading] = plan, reading
    if not plans:
        expected = ", ".join(f"{schema.name}.csv" for schema in SCHEMAS)
        raise BadInputError(f"{folder}: has none of the tables {expected} (plain or .gz); add at least one.")
    _check_against_bench(folder, bench, plans, readings)
    return bench, Session(folder.resolve().name, SessionPlan(**plans), Readings(**readings))


def bench_for_session(bench: Bench, nominal: Bench, path: str | Path, folder: str | Path) -> Bench:
    """Return another bench model with the target poses and the noise of a session.

    All corrections come from the other bench, including the target's (scale, bow, tracking). Bows that differ from pose
    to pose are matched by the pitch of the dots, which identifies the target. If the session has no target poses, the
    other bench keeps its own.

    Args:
        bench: the other bench.
        nominal: the session's bench.
        path: file of the other bench, for messages.
        folder: folder of the session, for messages.

    Raises:
        BadInputError: the benches are of different headsets or eyes, or the bow of a target is unknown.
    """
    if (bench.device.name, bench.eye) != (nominal.device.name, nominal.eye):
        raise BadInputError(
            f"{path}: is a bench of {bench.device.name} ({bench.eye} eye), the session {folder} is of "
            f"{nominal.device.name} ({nominal.eye} eye); choose a bench of that headset."
        )
    camera = replace(bench.camera, point_sigma_px=nominal.camera.point_sigma_px)
    if len(nominal.target.pitch) == 0:
        return replace(bench, camera=camera)
    target = replace(nominal.target, scale=bench.target.scale, bow=_bow_of(bench.target, nominal.target, path, folder))
    return replace(bench, camera=camera, target=target)


def _bow_of(corrected: Target, nominal: Target, path: str | Path, folder: str | Path) -> FloatArray:
    """Return the bow (1 or k, 2) of the corrected target at each of the session's k target poses."""
    bow = corrected.bow
    if np.ptp(bow, axis=0).max() == 0.0:
        return bow[:1]
    if len(nominal.pitch) == len(corrected.pitch) and np.allclose(
        nominal.pitch, corrected.pitch, rtol=_SAME_PITCH, atol=0.0
    ):
        return bow
    rows = []
    for number, pitch in enumerate(nominal.pitch):
        same = np.flatnonzero(np.isclose(corrected.pitch, pitch, rtol=_SAME_PITCH, atol=0.0))
        if len(same) == 0 or np.ptp(bow[same], axis=0).max() > 0.0:
            raise BadInputError(
                f"{path}: states a 'bow_per_m' for each target pose, which does not state how the target at "
                f"[[target_pose]] {number} of {folder} (pitch {pitch / MM:g} mm) is bowed; state one pair in [target]."
            )
        rows.append(bow[same[0]])
    return np.array(rows)


def remove_session(folder: str | Path) -> None:
    """Remove only the files of a session from a folder."""
    folder = Path(folder)
    tables = [path for schema in SCHEMAS for path in _tables(folder, schema)]
    for path in (folder / "bench.toml", folder / DEVICE_FILE, *tables):
        path.unlink(missing_ok=True)


def save_session(folder: str | Path, bench: Bench, session: Session) -> Path:
    """Write a session that `load_session` reads back, to 15 digits. Rows with a NaN reading are left out.

    Raises:
        BadInputError: the folder holds a table of another session, which would be read as part of this one.
    """
    folder = Path(folder)
    present = [schema for schema in SCHEMAS if getattr(session.plan, schema.plan) is not None]
    written = {schema.name: folder / f"{schema.name}.csv.gz" for schema in present}
    for schema in SCHEMAS:
        for other in _tables(folder, schema):
            if other != written.get(schema.name):
                raise BadInputError(
                    f"{other}: is not of the session to be written; remove it or choose another folder."
                )
    save_bench(bench, folder / "bench.toml")
    for schema in present:
        plan, reading = getattr(session.plan, schema.plan), getattr(session.readings, schema.reading)
        recorded = np.isfinite(reading).all(axis=1)
        columns = schema.to_file(select_rows(plan, recorded), reading[recorded], FRAMES[WRITTEN_FRAME])
        write_table(written[schema.name], schema, columns)
    return folder


def check_enough_captures(session: Session) -> None:
    """Refuse a session with too few captures to leave any out for validation.

    Raises:
        BadInputError: all tables together have fewer than `FEWEST_CAPTURES` captures.
    """
    count = 0
    for schema in SCHEMAS:
        plan = getattr(session.plan, schema.plan)
        if plan is not None:
            keys = [getattr(plan, name) for name in schema.capture_key]
            count += np.unique(np.stack(keys), axis=1).shape[1]
    if count < FEWEST_CAPTURES:
        raise BadInputError(
            f"{session.name}: has {count} captures, too few captures to hold any out; take {FEWEST_CAPTURES} or more, "
            "or compare them with a bench that other captures were diagnosed to: wlr-render predict BENCH SESSION."
        )


def _tables(folder: Path, schema: Schema) -> list[Path]:
    # A broken link is an unreadable table, not a missing one.
    return [path for suffix in _SUFFIXES if os.path.lexists(path := folder / f"{schema.name}{suffix}")]


def _table_path(folder: Path, schema: Schema) -> Path | None:
    tables = _tables(folder, schema)
    if len(tables) > 1:
        raise BadInputError(f"{folder}: has both {tables[0].name} and {tables[1].name}; remove one.")
    return tables[0] if tables else None


def _check_against_bench(folder: Path, bench: Bench, plans: dict[str, Any], readings: dict[str, FloatArray]) -> None:
    """Refuse readings that are impossible on the bench, such as lengths in metres, and poses missing from the bench."""
    camera = bench.camera
    require_plausible_view(f"{folder}: [camera] of the bench", camera.size_px, camera.focal_px, camera.centre_px)
    for name, plan in plans.items():
        if name == "run_time":
            require_length(
                f"{folder}: the distance of the viewpoint from the eye box in the runtime table",
                plan.viewpoint - bench.optics.eye_box.centre,
                _REACH_M,
            )
            continue
        table = next(schema.name for schema in SCHEMAS if schema.plan == name)
        require_length(
            f"{folder}: the distance of the stage from 'origin' in the {table} table",
            plan.stage - bench.stage.origin,
            _REACH_M,
        )
        _require_one_unit(folder, table, plan.stage, bench.stage.origin)
        _require_side(folder, table, plan.stage, bench)
        travel = float(np.linalg.norm(np.ptp(plan.stage, axis=0)))
        if 0 < travel < _LEAST_TRAVEL_M:
            raise BadInputError(
                f"{folder}: the stage travels {travel / MM:g} mm in the {table} table; are its readings in metres? "
                "Convert them to millimetres."
            )
    if "panel_pixel" in readings:
        size = bench.optics.panel.pixels.size_px
        with prefix_errors(f"{folder}: {bench.device.name}, display table"):
            require_on_panel(readings["panel_pixel"], size)
    pictures: dict[str, FloatArray] = {
        name: readings[name] for name in ("dot_pixel", "run_time_pixel") if name in readings
    }
    if "display" in plans:
        pictures["display"] = plans["display"].camera_pixel
    for name, pixel in pictures.items():
        _require_in_picture(folder, _TABLES[name], pixel.reshape(-1, 2), bench.camera.size_px)
    if "display" in plans:
        _require_spread(folder, "the camera pixels in the display table", plans["display"].camera_pixel)
        _require_spread(folder, "the panel positions in the display table", readings["panel_pixel"])
    if "see_through" in plans:
        _require_spread(folder, "the dots of the target in the seethrough table", plans["see_through"].dot)
        _require_spread(folder, "the camera pixels in the seethrough table", readings["dot_pixel"])
        _check_targets(folder, bench, plans["see_through"])
        poses, highest = len(bench.target.pitch), plans["see_through"].target_pose.max()
        if highest >= poses:
            raise BadInputError(
                f"{folder}: the seethrough table names target_pose {highest}, but its bench has {poses} "
                f"[[target_pose]], counted from 0; add the missing ones."
            )


def _check_targets(folder: Path, bench: Bench, plan: SeeThroughPlan) -> None:
    """Refuse targets behind the camera, and pitches in another unit than the dots."""
    for number, (pose, pitch) in enumerate(zip(bench.target.device_from_target, bench.target.pitch, strict=True)):
        place = f"{folder}: [[target_pose]] number {number + 1} of the bench"
        if bench.stage.origin[2] - pose[2, 3] < _NEAREST_M:
            raise BadInputError(
                f"{place}: 'translation' is not {_NEAREST_M / MM:g} mm or more in front of the stage's 'origin'; is it "
                "in metres, or in another frame? Convert it."
            )
        dots = plan.dot[plan.target_pose == number]
        extent = float(np.ptp(dots, axis=0).max()) if len(dots) else 0.0
        if extent > 0 and not extent / _MOST_PITCHES < pitch < _FACTOR * extent:
            raise BadInputError(
                f"{place}: 'pitch_mm' is {pitch / MM:g}, but the dots in the seethrough table lie over "
                f"{extent / MM:g} mm; is one of them in metres? Convert it to millimetres."
            )


def _require_spread(folder: Path, what: str, values: FloatArray) -> None:
    """Refuse positions (n, 2) that are all equal, from columns that were never filled in."""
    finite = values[np.isfinite(values).all(axis=1)]
    if len(finite) >= _MANY and np.ptp(finite, axis=0).max() == 0.0:
        raise BadInputError(f"{folder}: {what} are the same in all {len(finite)} rows; record where each point is.")


def _require_one_unit(folder: Path, table: str, stage: FloatArray, origin: FloatArray) -> None:
    """Refuse stage readings (n, 3) in another unit than the origin (3,), such as metres, along any axis."""
    reading, stated = np.abs(stage), np.abs(origin)
    small = (reading.max(axis=0) < stated / _FACTOR) & (stated > _LEAST_OFFSET_M)
    large = (stated > 0) & (stated < reading.min(axis=0) / _FACTOR) & (reading.min(axis=0) > _LEAST_OFFSET_M)
    if np.any(small | large):
        axis = int(np.argmax(small | large))
        raise BadInputError(
            f"{folder}: stage_{'xyz'[axis]}_mm in the {table} table is {stage[0, axis] / MM:g} mm, but 'origin' in "
            f"bench.toml is {origin[axis] / MM:g} mm; is one of them in metres? Convert it to millimetres."
        )


def _require_side(folder: Path, table: str, stage: FloatArray, bench: Bench) -> None:
    """Refuse a camera on the other side of the head than the eye of the bench."""
    eye, place = float(bench.optics.eye_box.centre[0]), float(np.median(stage[:, 0]))
    if abs(eye) > _LEAST_OFFSET_M and abs(place - eye) - abs(place + eye) > abs(eye):
        raise BadInputError(
            f"{folder}: stage_x_mm in the {table} table is {place / MM:.3g} mm, but the {bench.eye} eye of "
            f"{bench.device.name} is at {eye / MM:.3g} mm; correct 'eye' or 'frame' in bench.toml, or the readings."
        )


def _require_in_picture(folder: Path, table: str, pixel: FloatArray, size_px: FloatArray) -> None:
    """Refuse camera pixels (n, 2) outside the picture by more than its size."""
    far = np.any((pixel < -size_px) | (pixel > 2 * size_px), axis=1)
    if far.any():
        raise BadInputError(
            f"{folder}: the {table} table has the camera pixel {pixel[far][0].tolist()}, far outside the picture of "
            f"{size_px[0]:g} x {size_px[1]:g} pixels; correct it, or the size of the picture in [camera]."
        )

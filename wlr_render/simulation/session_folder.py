"""Read and write session folders: bench.toml and one to three tables (format: docs/bench-session.md)."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from wlr_render.captures.session import Readings, Session, SessionPlan, select_rows
from wlr_render.captures.session_schema import MM, SCHEMAS, Schema
from wlr_render.captures.session_tables import read_table, write_table
from wlr_render.errors import BadInputError
from wlr_render.files import resource
from wlr_render.geometry.transforms import FRAMES
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.bench import Bench, Target
from wlr_render.simulation.bench_file import (
    DEVICE_FILE,
    WRITTEN_FRAME,
    bench_of,
    device_from_file,
    load_bench,
    save_bench,
)
from wlr_render.toml_files import read_toml

FEWEST_CAPTURES = 6
_SUFFIXES = (".csv", ".csv.gz")
_SAME_PITCH = 1e-4  # of it: a target that was not measured again


def load_session(folder: str | Path, bench_file: str | Path | None = None) -> tuple[Bench, Session]:
    """Read a session and the bench as its makers believe it to be; the session is named after its folder.

    Args:
        folder: with bench.toml and the tables.
        bench_file: of the same headset; it replaces the folder's own as `bench_for_session` says.

    Raises:
        BadInputError: a file is missing or breaks the format, or the tables contradict the bench; the sentence says
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


def bench_for_session(bench: Bench, own: Bench, path: str | Path, folder: str | Path) -> Bench:
    """Another bench model with what belongs to a session: its target poses and the noise of its readings.

    All corrections, those of the target (scale, bow, tracking) included, are the bench's. A bow that differs from pose
    to pose goes with the pitch of the dots, which tells the targets apart. If the session has no target poses, the
    bench keeps its own.

    Args:
        bench: the other bench.
        own: the session's own bench.
        path: file of the other bench, for messages.
        folder: of the session, for messages.

    Raises:
        BadInputError: the benches are of different headsets or eyes, or the bow of a target is not known.
    """
    if (bench.device.name, bench.eye) != (own.device.name, own.eye):
        raise BadInputError(
            f"{path}: is a bench of {bench.device.name} ({bench.eye} eye), the session {folder} is of "
            f"{own.device.name} ({own.eye} eye); choose a bench of that headset."
        )
    camera = replace(bench.camera, point_sigma_px=own.camera.point_sigma_px)
    if len(own.target.pitch) == 0:
        return replace(bench, camera=camera)
    target = replace(own.target, scale=bench.target.scale, bow=_bow_of(bench.target, own.target, path, folder))
    return replace(bench, camera=camera, target=target)


def _bow_of(corrected: Target, own: Target, path: str | Path, folder: str | Path) -> FloatArray:
    """Bow (1 or k, 2) by a corrected target at the k poses of a session's own."""
    bow = corrected.bow
    if np.ptp(bow, axis=0).max() == 0.0:
        return bow[:1]
    if len(own.pitch) == len(corrected.pitch) and np.allclose(own.pitch, corrected.pitch, rtol=_SAME_PITCH, atol=0.0):
        return bow
    rows = []
    for number, pitch in enumerate(own.pitch):
        same = np.flatnonzero(np.isclose(corrected.pitch, pitch, rtol=_SAME_PITCH, atol=0.0))
        if len(same) == 0 or np.ptp(bow[same], axis=0).max() > 0.0:
            raise BadInputError(
                f"{path}: states a 'bow_per_m' for each target pose, which does not say how the target at "
                f"[[target_pose]] {number} of {folder} (pitch {pitch / MM:g} mm) is bowed; state one pair in [target]."
            )
        rows.append(bow[same[0]])
    return np.array(rows)


def remove_session(folder: str | Path) -> None:
    """Remove the files of a session, and nothing else, from a folder."""
    folder = Path(folder)
    tables = [path for schema in SCHEMAS for path in _tables(folder, schema)]
    for path in (folder / "bench.toml", folder / DEVICE_FILE, *tables):
        path.unlink(missing_ok=True)


def save_session(folder: str | Path, bench: Bench, session: Session) -> Path:
    """Write a session so that `load_session` reads the same one, to 15 digits. Rows with a NaN reading are left out.

    Raises:
        BadInputError: the folder holds a table that is not this session's, and would be read with it.
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
        seen = np.isfinite(reading).all(axis=1)
        columns = schema.to_file(select_rows(plan, seen), reading[seen], FRAMES[WRITTEN_FRAME])
        write_table(written[schema.name], schema, columns)
    return folder


def check_enough_captures(session: Session) -> None:
    """Refuse a session of which no captures can be held out.

    Raises:
        BadInputError: there are fewer than `FEWEST_CAPTURES` of them, all tables together.
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
    return [path for suffix in _SUFFIXES if (path := folder / f"{schema.name}{suffix}").exists()]


def _table_path(folder: Path, schema: Schema) -> Path | None:
    found = _tables(folder, schema)
    if len(found) > 1:
        raise BadInputError(f"{folder}: has both {found[0].name} and {found[1].name}; remove one.")
    return found[0] if found else None


def _check_against_bench(folder: Path, bench: Bench, plans: dict[str, Any], readings: dict[str, FloatArray]) -> None:
    """Readings that lie on the panel, and poses that the bench has."""
    if "panel_pixel" in readings:
        pixel, size = readings["panel_pixel"], bench.optics.panel.pixels.size_px
        if np.all(np.any((pixel < 0) | (pixel > size), axis=1)):
            raise BadInputError(
                f"{folder}: in the display table every pixel_u, pixel_v is outside the panel of {bench.device.name} "
                f"({size[0]:g} x {size[1]:g} pixels); name the device that was measured, or decode in its pixels."
            )
    if "see_through" in plans:
        poses, highest = len(bench.target.pitch), plans["see_through"].target_pose.max()
        if highest >= poses:
            raise BadInputError(
                f"{folder}: the seethrough table names target_pose {highest}, but its bench has {poses} "
                f"[[target_pose]], counted from 0; add the missing ones."
            )

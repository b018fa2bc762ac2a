import csv
import dataclasses
import json

import numpy as np
import pytest
from PIL import Image

from benchmarks.soak import report, study
from benchmarks.soak.records import Cost, EyeMoment, FrameNote, Stream, StreamFrame
from wlr_render.progress import Progress
from wlr_render.tracking.viewpoint_filter import TrackingState


class Heard(Progress):
    def __init__(self, given):
        self.given = given

    def __call__(self, items, total, label):
        self.given.append((total, label))
        yield from items


def stream_of(states, *, frame_ms=None, failed=None, x_mm=None, resident_mb=None, jumped_at=()):
    """One eye; per frame its state, and what else is told; times are 10 ms apart."""
    count = len(states)
    x_mm = np.zeros(count) if x_mm is None else np.array(x_mm)
    frames = []
    for k, state in enumerate(states):
        moved_mm = 2.0 if k in jumped_at else 0.0
        eye = EyeMoment(1e-3 * np.array([x_mm[k], 0, 0]), TrackingState[state], moved_mm, brought_back=False)
        resident = 100.0 if resident_mb is None else resident_mb[k]
        cost = Cost(0.25 * frame_ms[k] if frame_ms is not None else 1.0, 0.0, 1.0, 0.5 * k, 0, resident)
        if frame_ms is not None:
            cost = dataclasses.replace(cost, compose_ms=0.75 * frame_ms[k])
        unsolved = {"not converged": failed[k]} if failed and failed.get(k) else {}
        frames.append(FrameNote(StreamFrame(0.01 * k, np.eye(4), np.eye(4), {"right": eye}), cost, {"right": unsolved}))
    return Stream(frames, (), 100.0, 0.0, "nobody", (5, 4))


def table(stream, title):
    (found,) = (each for each in report.tables_of(stream) if title in each.title)
    return {row[0]: dict(zip(found.columns, row, strict=True)) for row in found.rows}, found


def test_percentiles_are_of_all_frames_but_the_first():
    stream = stream_of(["TRACKED"] * 102, frame_ms=[1e6, *range(101)])
    rows, found = table(stream, "frames of 5 x 4")
    whole = rows["whole frame (ms)"]
    assert [whole[column] for column in ("50 %", "95 %", "99 %", "most")] == pytest.approx([50, 95, 99, 100])
    assert rows["scene drawn (ms)"]["99 %"] == pytest.approx(24.75)
    assert "11 of 101 took no more" in found.notes[0]


def test_gaps_are_counted_measured_and_their_ways_told():
    states = ["TRACKED", "HELD", "FADING", "LOST", "TRACKED", "HELD", "TRACKED", "HELD"]
    x_mm = [1.0, 1.0, 0.6, 0.25, 3.0, 3.0, 3.0, 3.0]
    rows, _ = table(stream_of(states, x_mm=x_mm, jumped_at=(4,)), "Blinks")
    right = rows["right"]
    assert [right[name] for name in ("tracked", "held", "fading", "lost", "gaps")] == [3, 3, 1, 1, 3]
    assert right["longest (ms)"] == pytest.approx(30.0)
    assert right["farthest fade (mm)"] == pytest.approx(0.75)
    assert right["farthest return (mm)"] == pytest.approx(2.0)


def test_a_run_leaves_tables_a_row_of_each_frame_and_a_picture(gl_context, straight_device, scene_file, tmp_path):
    out, given = tmp_path / "out", []
    options = study.SoakOptions(straight_device, scene_file, eye="both", frames=6, size=(32, 18), out=out)
    found = study.run(options, progress=Heard(given))
    assert given[0] == (6, "frames")
    assert sorted(found.files) == sorted(out.iterdir())
    assert all(each.title in (out / "soak.md").read_text() for each in found.tables)
    assert json.loads((out / "soak.json").read_text())["size_px"] == [32, 18]
    rows = list(csv.DictReader((out / "frames.csv").open()))
    assert [float(row["time_s"]) for row in rows] == pytest.approx([k / 90.0 for k in range(6)])
    assert {row["left_tracking"] for row in rows} | {row["right_tracking"] for row in rows} <= {
        state.name.lower() for state in TrackingState
    }
    with Image.open(out / "soak.png") as picture:
        assert picture.width > 1000
        assert len(picture.convert("RGB").getcolors(1 << 20)) > 20

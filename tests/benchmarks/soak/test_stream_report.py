import csv
import json
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks.soak import report, study
from benchmarks.soak.records import Cost, EyeMoment, FrameNote, Stream, StreamFrame
from wlr_render.gl.context import GlContext
from wlr_render.report.blocks import Cell, ReportTable
from wlr_render.tracking.viewpoint_filter import TrackingState
from wlr_render.work.progress import Item, Progress


class Heard(Progress):
    def __init__(self, given: list[tuple[int, str]]) -> None:
        self.given = given

    def __call__(self, items: Iterable[Item], total: int, label: str) -> Iterator[Item]:
        self.given.append((total, label))
        yield from items


def stream_of(frame_ms: Sequence[float]) -> Stream:
    """One eye at rest; frames take so long, a quarter of it for drawing, and are 10 ms apart."""
    eye = EyeMoment(np.zeros(3), TrackingState.TRACKED, 0.0, brought_back=False)
    frames = []
    for k, whole_ms in enumerate(frame_ms):
        cost = Cost(0.25 * whole_ms, 0.75 * whole_ms, 1.0, 0.5 * k, 0, 100.0)
        frames.append(FrameNote(StreamFrame(0.01 * k, np.eye(4), np.eye(4), {"right": eye}), cost, {"right": {}}))
    return Stream(frames, (), 100.0, 0.0, "nobody", (5, 4))


def table(stream: Stream, title: str) -> tuple[dict[Cell, dict[str, Cell]], ReportTable]:
    (found,) = (each for each in report.tables_of(stream) if title in each.title)
    return {row[0]: dict(zip(found.columns, row, strict=True)) for row in found.rows}, found


def test_percentiles_are_of_all_frames_but_the_first() -> None:
    stream = stream_of([1e6, *range(101)])
    rows, found = table(stream, "frames of 5 x 4")
    whole = rows["whole frame (ms)"]
    assert [whole[column] for column in ("50 %", "95 %", "99 %", "most")] == pytest.approx([50, 95, 99, 100])
    assert rows["scene drawn (ms)"]["99 %"] == pytest.approx(24.75)
    assert "11 of 101 took no more" in found.notes[0]


@pytest.mark.slow
def test_a_run_leaves_tables_a_row_of_each_frame_and_a_picture(
    gl_context: GlContext, straight_device: str, scene_file: str, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    given: list[tuple[int, str]] = []
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

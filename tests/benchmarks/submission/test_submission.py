"""CPU cost of a frame: what is counted, and that nobody's state is read."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest
from fitted_eyes import fitted_eye
from present import as_number, narrowed

from benchmarks.submission import study
from benchmarks.submission.gl_calls import is_get
from benchmarks.submission.measure import WAYS, measure
from wlr_render.gl.context import GlContext
from wlr_render.mappings import Eye, Panel
from wlr_render.models.display_model import DisplayModel
from wlr_render.report.blocks import ReportTable

pytestmark = [pytest.mark.gl, pytest.mark.usefixtures("choices_made_once")]

SIZE = 60, 50


@pytest.fixture(scope="module")
def models() -> dict[str, Eye]:
    eye = fitted_eye("northstar", 3)
    return {"left": replace(eye, eye="left"), "right": eye}


@pytest.fixture
def egl(gl_context: GlContext) -> None:
    if gl_context.backend != "egl":
        pytest.skip("EGL does not open here.")


@pytest.mark.slow
def test_a_clean_host_has_no_gets_and_few_calls(egl: None, models: Mapping[str, Eye]) -> None:
    clean = measure(models, SIZE, "clean", 2)
    assert {name: count for name, count in clean.by_name.items() if is_get(name)} == {}
    assert 20 < clean.calls <= 150
    assert clean.gets == 0
    assert clean.kept_bytes < 2000
    # A context that shares costs two switches a call: fences, and one error that is read.
    shared, block = (measure(models, SIZE, way, 2) for way in ("shared", "block"))
    assert clean.calls < block.calls < shared.calls <= clean.calls + 40
    assert {name for name in shared.by_name if is_get(name)} == {"glGetError"}
    assert block.gets == 1
    fences = [shared.by_name[f"gl{name}Sync"] for name in ("Fence", "Wait", "Delete")]
    assert fences == [4] * 3  # before and after each of two calls


@pytest.mark.slow
def test_the_report_has_a_row_for_each_way(egl: None, models: Mapping[str, Eye], tmp_path: Path) -> None:
    small = {
        eye: replace(each, display=replace(narrowed(each.display, DisplayModel), panel=Panel(*SIZE)))
        for eye, each in models.items()
    }
    report = study.run(study.SubmissionOptions(frames=2, out=tmp_path), models=small)
    costs, functions = report.blocks
    assert isinstance(costs, ReportTable)
    assert [row[0] for row in costs.rows] == list(WAYS.values())
    assert all(len(row) == len(costs.columns) for row in costs.rows)
    totals = [sum(map(as_number, row[1:])) for row in narrowed(functions, ReportTable).rows]
    assert totals == sorted(totals, reverse=True)
    assert totals[-1] > 0
    assert (tmp_path / "submission.md").exists()

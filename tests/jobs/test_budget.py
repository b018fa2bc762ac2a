"""The verb `budget`: its report, and what it refuses."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fitted_eyes import with_source
from present import narrowed

from wlr_render.error_sources import ErrorSource, remedy
from wlr_render.errors import BadInputError
from wlr_render.jobs.budget import budget
from wlr_render.jobs.budget_options import BudgetOptions
from wlr_render.mappings import Eye
from wlr_render.models.display_model import DisplayModel
from wlr_render.models.model_file import EyeModel, load_eye_model, save_eye_models

NO_TRACKER_ERRORS: dict[str, Any] = {
    "eye_noise_mm": (0.0,),
    "eye_bias_mm": (0.0,),
    "eye_latency_ms": 0.0,
    "head_noise_deg": 0.0,
    "head_noise_mm": 0.0,
    "head_latency_ms": 0.0,
    "without_cornea": True,
}


@pytest.mark.slow
@pytest.mark.usefixtures("known_warp_grid")
def test_report_of_a_model(model_file: str, tmp_path: Path) -> None:
    report = budget(BudgetOptions(model_file, depth_m=0.8, out=tmp_path))
    assert "at 0.8 m" in report.verdict
    assert report.advice[0].startswith("Improve this first: ")
    (found,) = json.loads((tmp_path / "budget.json").read_text())["eyes"]
    for parts in (found["owners"], found["sources"]):
        assert sum(each["share"] for each in parts) == pytest.approx(1.0)
        assert sum(each["rms_arcmin"] ** 2 for each in parts) == pytest.approx(found["rms_arcmin"] ** 2)
        assert all(each["radius_if_halved_arcmin"] <= found["radius_arcmin"] + 1e-9 for each in parts)
    assert set(found["regions"]) == {"centre", "edge", "corner"}
    assert {path.name for path in report.files} == {"budget.html", "budget.md", "budget.json"}


@pytest.mark.slow
@pytest.mark.usefixtures("known_warp_grid")
def test_without_trackers_the_model_owns_the_error(model_file: str, tmp_path: Path) -> None:
    report = budget(BudgetOptions(model_file, **NO_TRACKER_ERRORS, raster_arcmin=0.0, out=tmp_path))
    found = report.record["eyes"][0]
    assert found.owners[0].name == "model"
    of_model = next(each for each in found.sources if each.name == "model: noise and stage")
    assert of_model.rms_arcmin > 0


@pytest.mark.usefixtures("known_warp_grid")
@pytest.mark.parametrize("source", [*(each for each in ErrorSource if each != ErrorSource.TRUNCATION), "heat"])
def test_the_advice_says_of_each_source_of_a_calibration_what_to_do(
    model_file: str, tmp_path: Path, source: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("wlr_render.budget.eye_budget.PANEL_CELLS", 6)
    model = load_eye_model(model_file)
    path = tmp_path / "model.json"
    save_eye_models(path, [replace(model, mappings=with_source(model.mappings, source))])
    (first, *_) = budget(BudgetOptions(str(path), **NO_TRACKER_ERRORS, out=tmp_path)).advice
    what = remedy(source).rstrip(".")
    assert first.startswith(f"Improve this first: the {source} ({what[0].lower()}{what[1:]}): half as large, 95 % of")


def test_without_any_error_the_page_says_so(
    straight_device: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("wlr_render.jobs.budget.choose_warp_grid", lambda *_: SimpleNamespace(bound_arcmin=0.0))
    report = budget(BudgetOptions(straight_device, **NO_TRACKER_ERRORS, raster_arcmin=0.0, out=tmp_path))
    assert report.verdict.startswith("The predicted error is zero")
    assert report.advice == []


def test_both_eyes_have_disparity(straight_device: str, tmp_path: Path) -> None:
    report = budget(BudgetOptions(straight_device, eye="both", out=tmp_path))
    disparity = {each.source: each for each in report.record["disparity"]}
    one_eye = {each.name: each for each in report.record["eyes"][0].sources}
    assert disparity["head tracker: noise"].vertical_arcmin < 0.1 * one_eye["head tracker: noise"].rms_arcmin
    parts = [each.horizontal_arcmin for name, each in disparity.items() if name != "all"]
    assert disparity["all"].horizontal_arcmin == pytest.approx(float(np.linalg.norm(parts)))
    assert "is a device" in report.warnings[0]
    assert "(left eye) and" in report.verdict


@pytest.mark.usefixtures("known_warp_grid")
def test_an_old_model_is_told_how_to_get_a_covariance(small_panel_model: Eye, tmp_path: Path) -> None:
    display = narrowed(small_panel_model.display, DisplayModel)
    bare = replace(small_panel_model, display=replace(display, spread=None))
    path = save_eye_models(tmp_path / "old.json", [EyeModel(bare, "northstar")])
    with pytest.raises(BadInputError, match=r"old\.json: .*no covariance.*calibrate again"):
        budget(BudgetOptions(str(path), out=tmp_path / "out"))


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"eye_noise_mm": (0.0005,)}, "--eye-noise-mm is 0.0005.* millimetres .is it in another unit"),
        ({"eye_bias_mm": (0.1, 0.2)}, "--eye-bias-mm has 2 values"),
    ],
)
def test_sizes_in_another_unit_are_asked_about(values: dict[str, Any], sentence: str) -> None:
    with pytest.raises(BadInputError, match=sentence):
        BudgetOptions("model.json", **values)


def test_zero_is_a_size() -> None:
    assert BudgetOptions("model.json", **NO_TRACKER_ERRORS).head_noise_mm == 0.0

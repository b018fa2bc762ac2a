"""The benchmark of self-calibration: one wear from end to end, and the tables of its results."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fitted_eyes import captures

from benchmarks.wear import study
from benchmarks.wear.simulated_wear import MOST_CLICKS, SLIPS, Wear, WearResult, half_hour, worn_eye
from benchmarks.wear.study import WearOptions, run
from wlr_render.calibration.fit_eye import calibrate
from wlr_render.mappings import Eye

DEVICE = "birdbath28"


@pytest.fixture(scope="module")
def models() -> Eye:
    return replace(calibrate(captures(DEVICE), "planar", 3, 2).mappings, field=worn_eye(DEVICE).field)


@pytest.fixture(scope="module")
def worn(models: Eye) -> list[WearResult]:
    return [half_hour(worn_eye(DEVICE), models, Wear(), np.random.default_rng(seed)) for seed in (1, 2)]


def test_five_clicks_after_a_slip_restore_the_alignment(worn: Sequence[WearResult]) -> None:
    slips = [slip for wear in worn for slip in wear.slips]
    assert len(slips) == 2 * SLIPS
    before, after, uncorrected = (
        np.sqrt(np.mean(np.square(each)))
        for each in zip(*((slip.before, slip.after[5], slip.uncorrected) for slip in slips), strict=True)
    )
    assert after < 1.5 * before
    assert after < 0.7 * uncorrected
    assert all(len(slip.after) == len(slip.predicted) == MOST_CLICKS + 1 for slip in slips)


def test_the_report_has_the_ratio_with_its_interval_and_the_picture(
    worn: Sequence[WearResult], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(study, "as_finished", lambda _, tasks, __: ((task, worn) for task in tasks))
    report = run(WearOptions((DEVICE,), models=1, out=tmp_path))
    ratio = np.sqrt(
        np.mean([slip.after[5] ** 2 for wear in worn for slip in wear.slips])
        / np.mean([slip.before**2 for wear in worn for slip in wear.slips])
    )
    assert f"{DEVICE} {ratio:.2f} (" in report.verdict
    assert report.tables[0].rows[0][1] == 2 * SLIPS
    assert {path.name for path in tmp_path.iterdir()} >= {"wear.html", "wear.md", "wear.json", "wear.png"}

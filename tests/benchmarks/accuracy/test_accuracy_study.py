from pathlib import Path
from typing import Any

import numpy as np
import pytest
from present import narrowed

from benchmarks.__main__ import main
from benchmarks.accuracy.lab_sessions import SIDES, LabTrial, labs
from benchmarks.accuracy.measurements import display, see_through, stuck
from benchmarks.trial_study import Study
from benchmarks.trials import EvaluatedEye, FoundBench, Measure, NoModelTrial, Outcome, Trial
from wlr_render.evaluation.metrics import summary
from wlr_render.report.blocks import Block, ReportTable

BOX = (10.0, 8.0, 6.0)
NORTHSTAR = EvaluatedEye("northstar", "right", BOX, name="northstar")


def outcome(
    rms: float, predicted: float, shift_um: float = 30.0, turn_urad: float = 100.0, seconds: float = 1.0
) -> Outcome:
    errors = {Measure.FORWARD: rms, Measure.REAL_POINT: rms, Measure.PREDICTED: predicted}
    found = FoundBench(0.25, shift_um, turn_urad)
    return Outcome({name: summary([value]) for name, value in errors.items()}, found, 500, seconds)


def rows_of(block: Block) -> list[dict[str, Any]]:
    table = narrowed(block, ReportTable)
    return [dict(zip(table.columns, row, strict=True)) for row in table.rows]


def test_draws_are_averaged_beside_the_figure_wanted_and_the_prediction_is_pooled() -> None:
    study = Study([NORTHSTAR], lambda trial: outcome(3.0 + getattr(trial, "repeat", 0), 5.0), 2)
    for experiment, wanted, first in ((display, 0.12, 0), (see_through, 0.06, 1)):
        (table,) = experiment(study).blocks
        noisy = rows_of(table)[first + 2]
        assert noisy["camera noise (arcmin)"] == 1.0
        assert (noisy["rms (arcmin)"], noisy["standard error"], noisy["wanted"]) == (3.5, pytest.approx(0.5), wanted)
        assert noisy["predicted / true"] == pytest.approx(5.0 / np.sqrt(12.5))
        assert rows_of(table)[first]["standard error"] is None  # exact captures are drawn once


def test_fits_in_a_wrong_maximum_are_counted() -> None:
    found = [(30.0, 100.0), (14.0, 100.0), (30.0, 210.0), (58.0, 55.0)]
    study = Study([NORTHSTAR], lambda trial: outcome(1.0, 1.0, *found[narrowed(trial, Trial).repeat]))
    (row,) = rows_of(stuck(study, 4).blocks[0])
    assert (row["draws"], row["stuck"]) == (4, 2)
    assert row["least shift found / true"] == pytest.approx(14 / 30)


def test_sessions_of_labs_are_counted_by_kind() -> None:
    """One of two sessions of each kind is honest."""

    def run(given: Trial | NoModelTrial) -> Outcome:
        trial = narrowed(given, LabTrial)
        if trial.level == 0.0:
            return Outcome({}, refused="why")
        honest = {"true": 1.0, "predicted": 1.1 - 0.6 * trial.repeat, "in 68 %": 0.7, "in 95 %": 0.9}
        counts = {"bumped": 2.0, "found": 1.0, "accused falsely": float(trial.viewpoints == 49)}
        figures = {f"{side} {name}": value for side in SIDES for name, value in (honest | counts).items()}
        return Outcome({}, figures=figures, seconds=3.0)

    kinds, each = labs(Study([NORTHSTAR], run, 9), 2).blocks
    white, *other = rows_of(kinds)
    assert (white["statement"], white["sessions"], white["refused"]) == ("white noise only", 4, 4)
    assert len(other) == 2 * 3 * 2 * 2 + 1  # levels, statements, neighbours, sides; and white noise of the other side
    full = [row for row in other if row["level"] == 1.0]
    assert {row["ratio in .8 to 1.25 (%)"] for row in full} == {50.0}
    assert {(row["sessions"], row["bumped"], row["found"], row["accused falsely"]) for row in full} == {(8, 16, 8, 4)}
    assert full[0]["largest"] == pytest.approx(2.0)
    assert len(rows_of(each)) == 2 * (4 + 2 * 2 * 3 * 3 * 2)


@pytest.mark.slow
def test_a_session_of_a_lab_is_fitted() -> None:
    trial = LabTrial("birdbath28", "planar", None, 9, BOX, level=0.5, without=("drift",), stated=())
    found = trial.run(1)
    assert found.refused == ""
    for side in SIDES:
        assert min(found.figures[f"{side} {name}"] for name in ("true", "predicted")) > 0.0
        assert 0.0 <= found.figures[f"{side} in 68 %"] <= found.figures[f"{side} in 95 %"] <= 1.0


def test_the_benchmark_keeps_its_tables(tmp_path: Path) -> None:
    """A table without rows, as this headset is not the one that is counted; test_trials.py runs whole studies."""
    arguments = ["accuracy", "no_optics", "--part", "stuck", "--stuck", "1", "--draws", "1", "--workers", "1"]
    assert main([*arguments, "--out", str(tmp_path / "out"), "--record", str(tmp_path)]) == 0
    kept = (tmp_path / "accuracy.md").read_text()
    assert "Wrong maxima: 30 um and 100 urad" in kept
    assert kept == (tmp_path / "out" / "accuracy.md").read_text()

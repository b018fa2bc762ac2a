import numpy as np
import pytest

from benchmarks.__main__ import main
from benchmarks.accuracy.measurements import camera_positions, display, see_through, stage, stuck, time, tracking
from benchmarks.trial_study import Study
from benchmarks.trials import EvaluatedEye, FoundBench, Measure, Outcome
from wlr_render.evaluation.metrics import summary

BOX = (10.0, 8.0, 6.0)
NORTHSTAR = EvaluatedEye("northstar", "right", BOX, name="northstar")


def outcome(rms, predicted, shift_um=30.0, turn_urad=100.0, seconds=1.0):
    errors = {Measure.FORWARD: rms, Measure.REAL_POINT: rms, Measure.PREDICTED: predicted}
    found = FoundBench(0.25, shift_um, turn_urad)
    return Outcome({name: summary([value]) for name, value in errors.items()}, found, 500, seconds)


def rows_of(table):
    return [dict(zip(table.columns, row, strict=True)) for row in table.rows]


def test_draws_are_averaged_beside_the_figure_wanted_and_the_prediction_is_pooled():
    study = Study([NORTHSTAR], lambda trial: outcome(3.0 + getattr(trial, "repeat", 0), 5.0), 2)
    for experiment, wanted, first in ((display, 0.12, 0), (see_through, 0.06, 1)):
        (table,) = experiment(study).blocks
        noisy = rows_of(table)[first + 2]
        assert noisy["camera noise (arcmin)"] == 1.0
        assert (noisy["rms (arcmin)"], noisy["standard error"], noisy["wanted"]) == (3.5, pytest.approx(0.5), wanted)
        assert noisy["predicted / true"] == pytest.approx(5.0 / np.sqrt(12.5))
        assert rows_of(table)[first]["standard error"] is None  # exact captures are drawn once


def test_models_stand_beside_each_other_and_figures_are_wanted_of_planar_ones_alone():
    study = Study([NORTHSTAR], lambda trial: outcome(1.0, 1.0), 1)
    for experiment, models in (
        (display, {"planar", "volumetric", "point-per-pixel", "static"}),
        (see_through, {"none", "planar", "volumetric", "static"}),
    ):
        rows = rows_of(experiment(study).blocks[0])
        assert {row["model"] for row in rows} == models
        assert {row["model"] for row in rows if row["wanted"] is not None} == {"planar"}


def test_camera_positions_are_those_given_and_predicted_errors_are_plotted_beside_the_true_ones():
    study = Study([NORTHSTAR], lambda trial: outcome(1.0 / trial.viewpoints, 0.5 / trial.viewpoints))
    table, plot = camera_positions(study, [12, 16]).blocks
    rows = [[row[name] for name in ("model", "camera positions", "rms (arcmin)")] for row in rows_of(table)]
    assert rows == [
        ["planar", 12, 1 / 12],
        ["planar", 16, 1 / 16],
        ["volumetric", 12, 1 / 12],
        ["volumetric", 16, 1 / 16],
    ]
    assert plot.data[0]["y"] == pytest.approx([1 / 12, 1 / 16], rel=1e-3)
    assert plot.data[2]["y"] == pytest.approx([0.5 / 12, 0.5 / 16], rel=1e-3)


def test_eye_tracking_is_compared_with_exact_viewpoints():
    study = Study([NORTHSTAR], lambda trial: outcome(1.0 + trial.tracking_error_mm, 1.0), 2)
    assert tracking(study).blocks[0].rows == [["northstar (right)", pytest.approx(1.0), pytest.approx(1.05)]]


def test_stages_are_those_of_the_table_and_times_those_of_the_fits():
    seen = []
    study = Study([NORTHSTAR], lambda trial: seen.append(trial) or outcome(1.0, 1.1, seconds=1.0 + trial.repeat), 2)
    rows = rows_of(stage(study).blocks[0])
    assert {(trial.stage_error_mm, trial.stage_turn_urad) for trial in seen} == {(0, 0), (0.01, 30), (0.03, 100)}
    assert all(row["predicted / true"] == pytest.approx(1.1) for row in rows)
    assert [(row["fit (s)"], row["longest (s)"], row["wanted (s)"]) for row in rows_of(time(study).blocks[0])] == [
        (1.5, 2.0, 3.0),
        (1.5, 2.0, 10.0),
    ]


def test_fits_in_a_wrong_maximum_are_counted():
    found = [(30.0, 100.0), (14.0, 100.0), (30.0, 210.0), (58.0, 55.0)]
    study = Study([NORTHSTAR], lambda trial: outcome(1.0, 1.0, *found[trial.repeat]))
    (row,) = rows_of(stuck(study, 4).blocks[0])
    assert (row["draws"], row["stuck"]) == (4, 2)
    assert row["least shift found / true"] == pytest.approx(14 / 30)


def test_the_benchmark_keeps_its_tables(tmp_path):
    arguments = ["accuracy", "northstar", "--part", "stuck", "--stuck", "1", "--draws", "1", "--workers", "1"]
    assert main([*arguments, "--out", str(tmp_path / "out"), "--record", str(tmp_path)]) == 0
    kept = (tmp_path / "accuracy.md").read_text()
    assert "Wrong maxima: 30 um and 100 urad" in kept
    assert kept == (tmp_path / "out" / "accuracy.md").read_text()


def test_an_option_without_its_part_is_refused(tmp_path, capsys):
    assert main(["accuracy", "--part", "time", "--stuck", "5", "--out", str(tmp_path / "out")]) == 2
    assert "--stuck is used with --part stuck" in capsys.readouterr().err

"""Trials of simulated captures: errors of fitted models, random numbers, tasks, and outcomes that are kept."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from present import narrowed
from small_headsets import changed_device

from benchmarks import trial_study
from benchmarks.accuracy.study import AccuracyOptions, run
from benchmarks.trial_study import Study, pooled, trial_at
from benchmarks.trials import (
    DisplayTrial,
    EvaluatedEye,
    Measure,
    NoModelTrial,
    Outcome,
    SeeThroughTrial,
    Trial,
)
from wlr_render.evaluation.metrics import Summary, summary

SEED = 3
BOX = (10.0, 8.0, 6.0)
EXACT: dict[str, Any] = {"part": ("camera-positions",), "counts": (2,), "workers": 1}


def display(device: str, kind: str, degree: int | None, count: int, **more: Any) -> DisplayTrial:
    return DisplayTrial(device, kind, degree, count, BOX, **more)


def see_through(device: str, kind: str, degree: int, count: int, **more: Any) -> SeeThroughTrial:
    return SeeThroughTrial(device, kind, degree, count, BOX, **more)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("trial", "measure", "expected"),
    [
        (display("northstar", "planar", 5, 25, camera_noise_arcmin=1.0), Measure.FORWARD, 0.272),
        (display("northstar", "planar", 4, 25, tracking_error_mm=0.05), Measure.FORWARD, 1.47),
        (see_through("northstar", "planar", 3, 25), Measure.REAL_POINT, 0.017),
        (NoModelTrial(EvaluatedEye("northstar", "right", BOX)), Measure.REAL_POINT, 12.2),
    ],
)
def test_first_figures_are_reproduced(
    trial: DisplayTrial | NoModelTrial | SeeThroughTrial, measure: Measure, expected: float
) -> None:
    # Found once with an independent program in the same eye box. Its field is not known: northstar's nominal field was
    # picked, among some tried, because the display figures at N=3 to 5 are met in it. Their agreement says that tracer,
    # fit and judge go together; it is no evidence for the field.
    np.testing.assert_allclose(trial.run(SEED).rms(measure), expected, rtol=0.2)


@pytest.mark.slow
def test_a_stage_that_turns_the_camera_is_found_and_its_error_is_predicted() -> None:
    trial = display("birdbath28", "planar", None, 25, camera_noise_arcmin=0.25, stage_turn_urad=100.0)
    outcome = trial.run(SEED)
    assert outcome.found is not None
    assert outcome.found.wobble_urad == pytest.approx(100.0, rel=0.3)
    assert outcome.found.repeatability_um < 15.0
    assert outcome.found.noise_arcmin == pytest.approx(0.25, rel=0.05)
    assert 0.5 < outcome.rms(Measure.PREDICTED) / outcome.rms(Measure.FORWARD) < 2.0
    assert outcome.seconds > 0.0


def test_each_trial_has_its_own_random_numbers() -> None:
    trial = display("northstar", "planar", 5, 25, camera_noise_arcmin=1.0)
    again = display("northstar", "planar", 5, 25, camera_noise_arcmin=1.0)
    other = display("northstar", "planar", 5, 25, camera_noise_arcmin=1.0, repeat=1)
    left = replace(trial, eye="left")
    numbers = [t.rng(SEED).normal() for t in (trial, again, other, left)] + [trial.rng(SEED + 1).normal()]
    assert numbers[0] == numbers[1]
    assert len(set(numbers)) == 4


def test_trials_with_random_errors_are_repeated_and_pooled() -> None:
    study = Study([], lambda trial: Outcome({Measure.FORWARD: summary([3.0 + narrowed(trial, Trial).repeat])}), 2)
    trial = trial_at(DisplayTrial, EvaluatedEye("a", "right", BOX), "planar", None, 25)
    assert len(study.repeated(trial)) == 1
    noisy = replace(trial, camera_noise_arcmin=1.0)
    assert len(study.repeated(noisy, most=1)) == 1
    assert pooled(study.repeated(noisy), Measure.FORWARD) == pytest.approx(np.sqrt(12.5))


@pytest.mark.slow
def test_a_study_does_not_depend_on_workers_and_is_resumed(tmp_path: Path) -> None:
    first, second = (
        run(AccuracyOptions(("no_optics",), **EXACT | {"workers": workers}, out=tmp_path / str(workers)))
        for workers in (1, 2)
    )
    assert first.tables == second.tables
    for path in (tmp_path / "1" / "trials").rglob("*.json"):
        kept = json.loads(path.read_text())
        kept["outcome"]["errors"]["forward (arcmin)"]["rms"] = 77.0
        kept["sha256"] = hashlib.sha256(json.dumps(kept["outcome"]).encode()).hexdigest()
        path.write_text(json.dumps(kept))
    resumed = run(AccuracyOptions(("no_optics",), **EXACT, resume=True, out=tmp_path / "1"))
    assert resumed.tables[1].rows[0][3] == 77.0


def test_the_eye_box_is_that_of_the_device_unless_another_is_given(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The trials' eye boxes; none of them runs."""
    errors: dict[str, Summary] = {Measure.FORWARD: summary([1.0]), Measure.PREDICTED: summary([1.0])}
    taken = []

    def run_none(trials: Sequence[DisplayTrial], *given: object) -> dict[DisplayTrial, Outcome]:
        taken.append({trial.eye_box_mm for trial in trials})
        return dict.fromkeys(trials, Outcome(errors))

    monkeypatch.setattr(trial_study, "run_trials", run_none)
    small = changed_device(tmp_path, "northstar", ("[10.0, 8.0, 6.0]", "[6.0, 4.0, 4.0]"))
    own = run(AccuracyOptions((small,), eye="both", **EXACT, out=tmp_path / "out"))
    run(AccuracyOptions(("northstar",), box=(9.0, 7.0, 5.0), **EXACT, out=tmp_path / "out"))
    assert [row[:2] for row in own.tables[0].rows] == [
        ["northstar (left)", "6 x 4 x 4 mm"],
        ["northstar (right)", "6 x 4 x 4 mm"],
    ]
    assert taken == [{(6.0, 4.0, 4.0)}, {(9.0, 7.0, 5.0)}]

import json

import numpy as np
import pytest

from wlr_render.errors import BadInputError
from wlr_render.evaluation.metrics import summary
from wlr_render.jobs.evaluate import study as sampling_study
from wlr_render.jobs.evaluate.dense_experiments import dense_cells, dense_findings
from wlr_render.jobs.evaluate.experiment import Line, Plot, StudyOptions, pooled, spread_note
from wlr_render.jobs.evaluate.pool import _tasks
from wlr_render.jobs.evaluate.trials import DisplayTrial, Measure, NoModelTrial, Outcome, SeeThroughTrial

SEED = 3


def outcome(forward):
    return Outcome({Measure.FORWARD: summary([forward]), Measure.BACKWARD: summary([0.1])})


def test_results_do_not_depend_on_the_number_of_workers():
    few = {"devices": ("birdbath28",), "experiments": ("position",), "repeats": 1, "seed": SEED}
    heard = []

    def progress(items, total, label):
        for item in items:
            heard.append(total)
            yield item

    first = sampling_study.run(StudyOptions(**few, workers=1), progress)
    second = sampling_study.run(StudyOptions(**few, workers=2))
    assert heard == [3, 3, 3]
    assert [t.as_record() for t in first.tables] == [t.as_record() for t in second.tables]
    exact, stage, tracking = first.tables[1].rows[0][1:]
    assert first.tables[0].rows == [["birdbath28", "-20 to +20 x -11.25 to +11.25 degrees"]]
    assert exact < 0.01
    # 0.05 mm per axis at the swim of this device, 4.2, 4.6 and 1.1 arcmin per mm on average.
    np.testing.assert_allclose([stage, tracking], 0.05 * np.sqrt(4.2**2 + 4.6**2 + 1.1**2), rtol=0.35)


@pytest.mark.parametrize(
    ("trial", "measure", "expected"),
    [
        (DisplayTrial("northstar", "planar", 4, 25), Measure.FORWARD, 1.06),
        (DisplayTrial("northstar", "planar", 5, 25), Measure.FORWARD, 0.243),
        (DisplayTrial("northstar", "planar", 5, 25), Measure.BACKWARD, 0.171),
        (DisplayTrial("northstar", "planar", 5, 25), Measure.MOVED_BACK, 0.23),
        (DisplayTrial("northstar", "planar", 5, 25, camera_noise_arcmin=1.0), Measure.FORWARD, 0.272),
        (DisplayTrial("northstar", "planar", 5, 25, tracking_error_mm=0.05), Measure.FORWARD, 1.06),
        (DisplayTrial("northstar", "point-per-pixel", 5, 25), Measure.FORWARD, 10.0),
        (DisplayTrial("northstar", "static", 5, 1), Measure.FORWARD, 55.9),
        (SeeThroughTrial("northstar", "planar", 3, 25), Measure.REAL_POINT, 0.017),
        (NoModelTrial("northstar"), Measure.REAL_POINT, 12.2),
    ],
)
def test_first_figures_are_reproduced(trial, measure, expected):
    # Found once with an independent program in the same eye box. Its field is not known: northstar's nominal field was
    # picked, among some tried, because the display figures at N=3 to 5 are met in it. Their agreement says that tracer,
    # fit and judge go together; it is no evidence for the field.
    np.testing.assert_allclose(trial.run(SEED).rms(measure), expected, rtol=0.2)


def test_volumetric_sampling_is_refused_the_viewpoints_that_planar_sampling_does_with():
    planar = DisplayTrial("birdbath28", "planar", 5, 25).run(SEED)
    volumetric = DisplayTrial("birdbath28", "volumetric", 5, 25).run(SEED)
    assert planar.rms(Measure.FORWARD) < 0.01
    assert volumetric.cell(Measure.FORWARD) == "refused: needs 56"
    assert np.isnan(volumetric.rms(Measure.FORWARD))


def test_a_planar_model_never_contradicts_itself_along_a_ray_and_a_volumetric_one_does():
    along = [
        DisplayTrial("birdbath28", kind, 3, 25).run(SEED).errors[Measure.ALONG_RAY].p95
        for kind in ("planar", "volumetric")
    ]
    assert along[0] < 1e-6
    assert along[1] > 0.1


def test_a_fault_that_is_no_want_of_viewpoints_is_not_hidden():
    with pytest.raises(BadInputError, match="kind of display model 'cubic'"):
        DisplayTrial("birdbath28", "cubic", 1, 5).run(SEED)


def test_errors_depend_on_the_field_that_they_are_stated_in():
    nominal, whole = (DisplayTrial("northstar", "planar", 5, 25, whole_panel=w).run(SEED) for w in (False, True))
    assert whole.rms(Measure.FORWARD) > 3 * nominal.rms(Measure.FORWARD)


def test_each_trial_has_its_own_random_numbers():
    trial = DisplayTrial("northstar", "planar", 5, 25, camera_noise_arcmin=1.0)
    again = DisplayTrial("northstar", "planar", 5, 25, camera_noise_arcmin=1.0)
    other = DisplayTrial("northstar", "planar", 5, 25, camera_noise_arcmin=1.0, repeat=1)
    numbers = [t.rng(SEED).normal() for t in (trial, again, other)] + [trial.rng(SEED + 1).normal()]
    assert numbers[0] == numbers[1]
    assert len(set(numbers)) == 3


def test_trials_that_share_captures_make_one_task_and_none_runs_twice():
    quiet = DisplayTrial("northstar", "planar", 5, 25)
    noisy = DisplayTrial("northstar", "planar", 5, 25, camera_noise_arcmin=1.0)
    other = DisplayTrial("northstar", "planar", 5, 121)
    tasks = _tasks([quiet, noisy, other, quiet])
    assert tasks == [[other], [quiet, noisy]]


def test_the_verdict_on_dense_captures_follows_the_numbers():
    options = StudyOptions(devices=("a", "b"), degrees=(3,))
    planar_wins = {("a", 3, "planar"): outcome(1.0), ("a", 3, "volumetric"): outcome(2.0)}
    volumetric_wins = {("b", 3, "planar"): outcome(1.0), ("b", 3, "volumetric"): outcome(0.5)}
    assert set(dense_cells(options)) == {*planar_wins, *volumetric_wins}
    (table,) = dense_findings(options, planar_wins | volumetric_wins).tables
    assert "in 1 of 2 cases" in table.notes[0]
    assert "b N=3 (0.50)" in table.notes[0]
    assert [row[-1] for row in table.rows] == [2.0, 0.5]


def test_repetitions_are_pooled_by_their_squares_and_their_spread_is_told():
    group = [outcome(3.0), outcome(4.0)]
    np.testing.assert_allclose(pooled(group, Measure.FORWARD), np.sqrt(12.5))
    assert "at most 20 %" in spread_note([group], Measure.FORWARD)
    assert "drawn once" in spread_note([group[:1]], Measure.FORWARD)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (StudyOptions(experiments=("density",)), "no experiment 'density'"),
        (StudyOptions(repeats=0), "repetitions is 0"),
        (StudyOptions(degrees=()), "no degree"),
        (StudyOptions(devices=()), "no device"),
    ],
)
def test_impossible_studies_are_refused_before_they_start(options, words):
    with pytest.raises(BadInputError, match=words):
        sampling_study.run(options)


def test_reports_are_written(tmp_path):
    options = StudyOptions(devices=("a",), degrees=(3, 4))
    cells = {key: outcome(0.1) for key in dense_cells(options)}
    found = dense_findings(options, cells)
    gap = Plot("gap", "a gap", "x", "y", (Line("a, planar", [1, 2], [float("nan"), 2.0]),))
    report = sampling_study.StudyReport(options, found.tables, (*found.plots, gap))
    paths = sampling_study.write(report, tmp_path / "out")
    assert [p.name for p in paths] == ["study.md", "study.json", "error_over_degree.png", "gap.png"]
    assert all(p.read_bytes().startswith(b"\x89PNG") for p in paths[2:])
    record = json.loads(paths[1].read_text())
    assert record["options"]["degrees"] == [3, 4]
    assert record["tables"][0]["rows"][0]["forward rms, planar (arcmin)"] == pytest.approx(0.1)
    assert "![a gap](gap.png)" in paths[0].read_text()

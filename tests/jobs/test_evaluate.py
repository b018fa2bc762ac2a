import hashlib
import json
from dataclasses import replace

import numpy as np
import pytest
from browser import needs_browser, open_page
from small_headsets import changed_device

from wlr_render.cli import main
from wlr_render.errors import BadInputError
from wlr_render.evaluation.metrics import summary
from wlr_render.jobs.evaluate.evaluate import (
    EvaluateOptions,
    camera_positions,
    evaluate,
    noise,
    position_errors,
    positions_needed,
)
from wlr_render.jobs.evaluate.evaluate import see_through as see_through_experiment
from wlr_render.jobs.evaluate.study import Study, pooled, spread_note
from wlr_render.jobs.evaluate.trials import (
    DisplayTrial,
    EvaluatedEye,
    Measure,
    NoModelTrial,
    Outcome,
    SeeThroughTrial,
    tasks_of,
)
from wlr_render.progress import Progress

SEED = 3
BOX = (10.0, 8.0, 6.0)
FEW = {"experiment": ("position-errors",), "repeats": 1, "seed": SEED}


def display(device, kind, degree, count, **more):
    return DisplayTrial(device, kind, degree, count, BOX, **more)


def see_through(device, kind, degree, count, **more):
    return SeeThroughTrial(device, kind, degree, count, BOX, **more)


def outcome(error, predicted=0.1):
    errors = {Measure.FORWARD: error, Measure.REAL_POINT: error, Measure.BACKWARD: 0.1, Measure.PREDICTED: predicted}
    return Outcome({measure: summary([value]) for measure, value in errors.items()})


def eye(name):
    return EvaluatedEye(name, "right", BOX, name=name)


class Heard(Progress):
    def __init__(self):
        self.totals = []

    def __call__(self, items, total, label):
        for item in items:
            self.totals.append(total)
            yield item


def test_results_do_not_depend_on_the_number_of_workers(tmp_path):
    heard = Heard()
    few = {**FEW, "stage_error_mm": 0.03, "stage_turn_urad": 100.0}
    first = evaluate(EvaluateOptions(("birdbath28",), **few, workers=1, out=tmp_path / "a"), progress=heard)
    second = evaluate(EvaluateOptions(("birdbath28",), **few, workers=2, out=tmp_path / "b"))
    assert heard.totals == [3] * 3
    assert first.tables == second.tables
    assert first.tables[0].rows == [["birdbath28 (right)", "10 x 8 x 6 mm", "-20 to +20 x -11.25 to +11.25 degrees"]]
    still, moved = first.tables[1].rows
    assert [row[1:3] for row in (still, moved)] == [[0, 0], [30, 100]]
    rms, predicted, noise_found, shift_found, turn_found = moved[3:]
    assert 0.5 < predicted / rms < 2.0
    assert noise_found == pytest.approx(0.25, rel=0.03)
    assert shift_found == pytest.approx(30, rel=0.5)
    assert turn_found == pytest.approx(100, rel=0.5)
    assert still[3] < 0.04
    assert still[4] == pytest.approx(still[3], rel=0.2)
    # 0.05 mm per axis at the swim of this device, 4.2, 4.6 and 1.1 arcmin per mm on average.
    exact, tracking = first.tables[2].rows[0][1:]
    assert exact == still[3]
    assert tracking == pytest.approx(0.05 * np.sqrt(4.2**2 + 4.6**2 + 1.1**2), rel=0.35)


def test_errors_of_position_are_those_given(tmp_path):
    few = {**FEW, "workers": 1, "out": tmp_path}
    options = EvaluateOptions(("birdbath28",), stage_error_mm=0.0, tracking_error_mm=0.3, noise_arcmin=0.0, **few)
    stage, tracking = evaluate(options).tables[1:]
    assert [row[1:3] for row in stage.rows] == [[0, 0]]
    exact, tracked = tracking.rows[0][1:]
    assert exact < 0.001
    assert tracked == pytest.approx(0.3 * np.sqrt(4.2**2 + 4.6**2 + 1.1**2), rel=0.35)
    assert tracking.columns[-1] == "eye-tracking error 0.3 mm (arcmin)"


def test_the_eye_box_is_that_of_the_device_unless_another_is_given(tmp_path):
    small = changed_device(tmp_path, "northstar", ("[10.0, 8.0, 6.0]", "[6.0, 4.0, 4.0]"))
    exact = {"stage_error_mm": 0.0, "tracking_error_mm": 0.0, "noise_arcmin": 0.0}
    few = {**FEW, **exact, "out": tmp_path, "workers": 1}
    own = evaluate(EvaluateOptions((small,), eye="both", **few))
    overridden = evaluate(EvaluateOptions(("northstar",), box=(6.0, 4.0, 4.0), **few))
    shipped = evaluate(EvaluateOptions(("northstar",), **few))
    assert [row[:2] for row in own.tables[0].rows] == [
        ["northstar (left)", "6 x 4 x 4 mm"],
        ["northstar (right)", "6 x 4 x 4 mm"],
    ]
    of_own, of_override, of_shipped = (report.tables[1].rows[-1][3] for report in (own, overridden, shipped))
    assert of_own == of_override
    assert of_own < 0.9 * of_shipped


@pytest.mark.parametrize(
    ("trial", "measure", "expected"),
    [
        (display("northstar", "planar", 4, 25), Measure.FORWARD, 1.06),
        (display("northstar", "planar", 5, 25), Measure.FORWARD, 0.243),
        (display("northstar", "planar", 5, 25, camera_noise_arcmin=1.0), Measure.FORWARD, 0.272),
        (display("northstar", "planar", 5, 25, tracking_error_mm=0.05), Measure.FORWARD, 1.06),
        (display("northstar", "point-per-pixel", 5, 25), Measure.FORWARD, 10.0),
        (display("northstar", "static", 5, 1), Measure.FORWARD, 55.9),
        (see_through("northstar", "planar", 3, 25), Measure.REAL_POINT, 0.017),
        (NoModelTrial(eye("northstar")), Measure.REAL_POINT, 12.2),
    ],
)
def test_first_figures_are_reproduced(trial, measure, expected):
    # Found once with an independent program in the same eye box. Its field is not known: northstar's nominal field was
    # picked, among some tried, because the display figures at N=3 to 5 are met in it. Their agreement says that tracer,
    # fit and judge go together; it is no evidence for the field.
    np.testing.assert_allclose(trial.run(SEED).rms(measure), expected, rtol=0.2)


def test_the_inverse_of_the_forward_model_beats_a_backward_polynomial():
    """The first figure, 0.171 px, was that of a backward polynomial of its own with the same captures and degree."""
    assert display("northstar", "planar", 5, 25).run(SEED).rms(Measure.BACKWARD) < 0.171
    assert display("northstar", "planar", None, 25).run(SEED).rms(Measure.BACKWARD) < 0.001


def test_no_number_of_camera_positions_is_refused_and_more_of_them_are_better():
    for kind in ("planar", "volumetric"):
        trials = [display("birdbath28", kind, 4, count, camera_noise_arcmin=0.25) for count in (2, 8, 30)]
        outcomes = [trial.run(SEED) for trial in trials]
        for measure in (Measure.FORWARD, Measure.PREDICTED):
            rms = [each.rms(measure) for each in outcomes]
            assert rms == sorted(rms, reverse=True)


@pytest.mark.parametrize(
    ("trial", "measure"),
    [
        (display("freeform40", "planar", None, 25, camera_noise_arcmin=1.0), Measure.FORWARD),
        (see_through("freeform40", "planar", None, 25, camera_noise_arcmin=1.0), Measure.REAL_POINT),
    ],
)
def test_the_fits_predict_their_errors_and_find_the_noise(trial, measure):
    found = trial.run(SEED)
    assert 0.8 < found.rms(Measure.PREDICTED) / found.rms(measure) < 1.25
    assert found.found.noise_arcmin == pytest.approx(1.0, rel=0.02)
    # Far less than the noise of a capture's some hundred readings tells.
    assert found.found.repeatability_um < 5.0
    assert found.found.wobble_urad < 10.0
    assert found.seconds > 0.0


def test_a_stage_that_turns_the_camera_is_found():
    trial = display("birdbath28", "planar", None, 25, camera_noise_arcmin=0.25, stage_turn_urad=100.0)
    assert trial.has_random_errors
    found = trial.run(SEED).found
    assert found.wobble_urad == pytest.approx(100.0, rel=0.3)
    assert found.repeatability_um < 15.0


def test_a_fault_that_is_no_want_of_viewpoints_is_not_hidden():
    with pytest.raises(BadInputError, match="kind of display model 'cubic'"):
        display("birdbath28", "cubic", 1, 5).run(SEED)


def test_errors_depend_on_the_field_that_they_are_stated_in():
    nominal, whole = (display("northstar", "planar", 5, 25, whole_panel=w).run(SEED) for w in (False, True))
    assert whole.rms(Measure.FORWARD) > 3 * nominal.rms(Measure.FORWARD)


def test_each_trial_has_its_own_random_numbers():
    trial = display("northstar", "planar", 5, 25, camera_noise_arcmin=1.0)
    again = display("northstar", "planar", 5, 25, camera_noise_arcmin=1.0)
    other = display("northstar", "planar", 5, 25, camera_noise_arcmin=1.0, repeat=1)
    left = replace(trial, eye="left")
    numbers = [t.rng(SEED).normal() for t in (trial, again, other, left)] + [trial.rng(SEED + 1).normal()]
    assert numbers[0] == numbers[1]
    assert len(set(numbers)) == 4


def test_trials_that_share_captures_make_one_task_and_none_runs_twice():
    quiet = display("northstar", "planar", 5, 25)
    noisy = display("northstar", "planar", 5, 25, camera_noise_arcmin=1.0)
    other = display("northstar", "planar", 5, 121)
    tasks = tasks_of([quiet, noisy, other, quiet])
    assert tasks == [[other], [quiet, noisy]]


def test_no_two_trials_share_the_file_of_an_outcome():
    trial = display("northstar", "planar", 5, 25, camera_noise_arcmin=1.0)
    others = [replace(trial, eye="left"), replace(trial, repeat=1), replace(trial, device="birdbath28")]
    others += [SeeThroughTrial("northstar", "planar", 5, 25, trial.eye_box_mm, 1.0), NoModelTrial(trial.at)]
    assert len({each.file for each in (trial, *others)}) == 6


def test_a_resumed_run_takes_the_outcomes_that_are_kept(tmp_path):
    options = EvaluateOptions(
        ("birdbath28",), experiment=("camera-positions",), counts=(5,), degrees=(3,), workers=1, out=tmp_path
    )
    evaluate(options)
    files = list((tmp_path / "trials").rglob("*.json"))
    for path in files:
        kept = json.loads(path.read_text())
        kept["outcome"]["errors"]["forward (arcmin)"]["rms"] = 77.0
        kept["sha256"] = hashlib.sha256(json.dumps(kept["outcome"]).encode()).hexdigest()
        path.write_text(json.dumps(kept))
    resumed = evaluate(replace(options, resume=True))
    (row,) = next(table for table in resumed.tables if table.title.startswith("Camera positions")).rows
    assert row[3] == 77.0
    again = evaluate(options)
    (row,) = next(table for table in again.tables if table.title.startswith("Camera positions")).rows
    assert row[3] != 77.0


ERRORS = {(3, 16): 0.9, (3, 25): 0.8, (3, 49): 0.8, (4, 16): 0.95, (4, 25): 0.25, (4, 49): 0.24}


@pytest.mark.parametrize(
    ("changed", "goal", "sentence"),
    [
        ({}, 0.3, "E: 25 camera positions suffice for 0.3': 0.25' rms with N=4; 16 give 0.9'."),
        ({}, 1.0, "E: 16 camera positions suffice for 1': 0.9' rms with N=3."),
        (
            {},
            0.1,
            "E: none of the numbers of camera positions tried reaches 0.1' rms; the largest gives 0.24' with N=4.",
        ),
        # A number that suffices by chance is not taken while a larger one does not.
        (
            {(3, 16): 0.2, (4, 49): 0.2},
            0.22,
            "E: 49 camera positions suffice for 0.22': 0.2' rms with N=4; 25 give 0.25'.",
        ),
    ],
)
def test_the_fewest_camera_positions_that_suffice(changed, goal, sentence):
    assert str(positions_needed("E", ERRORS | changed, goal)) == sentence


def test_degrees_are_not_named_where_none_was_given():
    errors = {(None, 16): 0.2, (None, 25): 0.1}
    assert str(positions_needed("E", errors, 0.1)) == "E: 25 camera positions suffice for 0.1': 0.1' rms; 16 give 0.2'."


@pytest.mark.parametrize(("degrees", "limit"), [(None, []), ((4,), [4])])
def test_camera_positions_are_compared_with_the_errors_of_the_bench(degrees, limit):
    seen = []

    def of(trial):
        seen.append(trial)
        return outcome((2.0 if trial.kind == "volumetric" else 1.0) / trial.viewpoints, 0.5 / trial.viewpoints)

    bench = {"noise_arcmin": 0.5, "stage_error_mm": 0.02, "stage_turn_urad": 50.0}
    options = EvaluateOptions(degrees=degrees, counts=(49, 12, 16), goal_arcmin=0.05, repeats=2, **bench)
    found = camera_positions(options, Study([eye("a")], of, options.repeats))
    table, plot = found.blocks
    assert {(t.camera_noise_arcmin, t.stage_error_mm, t.stage_turn_urad, t.repeat) for t in seen} == {
        (0.5, 0.02, 50.0, 0),
        (0.5, 0.02, 50.0, 1),
    }
    assert table.rows == [["a (right)", *limit, n, 1 / n, 0.5 / n, 2 / n, 0.5 / n, 2.0] for n in (12, 16, 49)]
    assert len(table.columns) == len(table.rows[0])
    assert [(t["name"], list(t["x"]), t["line"].get("dash")) for t in plot.data[::2]] == [
        (f"a (right), planar{', N=4' if limit else ''}", [12, 16, 49], None),
        (f"a (right), planar{', N=4' if limit else ''}, predicted", [12, 16, 49], "dash"),
    ]
    named = " with N=4" if limit else ""
    assert found.verdict == [f"a (right): 49 camera positions suffice for 0.05': 0.02' rms{named}; 16 give 0.062'."]
    assert found.advice == ["Calibrate a (right) with 49 camera positions."]


def test_every_table_of_models_shows_the_predicted_error_beside_the_true_one():
    study = Study([eye("northstar")], lambda trial: outcome(3.0, 2.0))
    for experiment, pairs in ((noise, 3), (see_through_experiment, 2), (position_errors, 1)):
        table = experiment(EvaluateOptions(), study).blocks[0]
        predicted = [number for number, column in enumerate(table.columns) if "predicted" in column]
        assert len(predicted) == pairs
        assert [table.rows[-1][k - 1 : k + 1] for k in predicted] == [[3.0, 2.0]] * pairs
    assert [row[1:3] for row in table.rows] == [[0, 0], [10, 30], [30, 100]]


def test_repetitions_are_pooled_by_their_squares_and_their_spread_is_told():
    group = [outcome(3.0), outcome(4.0)]
    np.testing.assert_allclose(pooled(group, Measure.FORWARD), np.sqrt(12.5))
    assert "at most 20 %" in spread_note([group], Measure.FORWARD)
    assert "drawn once" in spread_note([group[:1]], Measure.FORWARD)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--experiment", "densty"], "densty"),
        (["--repeats", "0"], "--repeats is 0"),
        (["--degrees", "13"], "--degrees is 13"),
        (["--experiment", "noise", "--degrees", "3"], "--degrees is used with --experiment camera-positions"),
        (["--experiment", "noise", "--stage-turn-urad", "30"], "--stage-turn-urad is used with"),
        (["--stage-turn-urad", "-1"], "--stage-turn-urad is -1"),
        (["--box", "10x8"], "'10x8' is not width, height and depth in mm"),
        (["--box", "10x8x0"], "--box is 0.0; it must be a finite number above 0"),
        (["no-such-device"], "no-such-device"),
        (["no_optics", "--eye", "left"], "no left eye"),
    ],
)
def test_impossible_studies_are_refused_before_they_start(arguments, words, tmp_path, capsys):
    assert main(["evaluate", *arguments, "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert len(error.splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_empty_lists_and_unknown_experiments_are_refused(tmp_path):
    with pytest.raises(BadInputError, match="--experiment is densty; choose from camera-positions, noise"):
        EvaluateOptions(experiment=("noise", "densty"))
    for name in ("device", "experiment", "degrees", "counts"):
        with pytest.raises(BadInputError, match=f"{name} is empty"):
            evaluate(EvaluateOptions(**{name: ()}, out=tmp_path))


@needs_browser
def test_the_page_has_its_plots_and_the_json_their_points(tmp_path):
    arguments = ["evaluate", "birdbath28", "--experiment", "camera-positions", "--degrees", "3"]
    arguments += ["--goal-arcmin", "0.2"]
    assert main([*arguments, "--counts", "10", "12", "--repeats", "1", "--workers", "1", "--out", str(tmp_path)]) == 0
    page = open_page(tmp_path / "report.html", tmp_path)
    assert (page.plots, page.console) == (1, [])
    record = json.loads((tmp_path / "report.json").read_text())
    points = [row["planar (arcmin)"] for row in record["tables"][1]["rows"]]
    assert record["plots"][0]["data"][0]["y"] == pytest.approx(points, rel=1e-3)
    assert record["camera-positions"]["camera_positions_needed"][0]["positions"] == 10
    assert record["options"]["degrees"] == [3]
    assert record["sentence"].startswith("birdbath28 (right): 10 camera positions suffice for 0.2': 0.1")


def test_naming_the_default_experiments_asks_for_them():
    four = ("camera-positions", "noise", "position-errors", "see-through")
    assert EvaluateOptions(methods=("all",)).experiment == ("methods",)
    with pytest.raises(BadInputError, match="--methods is used with --experiment methods only; leave it out"):
        EvaluateOptions(experiment=four, methods=("all",))
    assert EvaluateOptions(experiment=(*four, "methods"), methods=("all",)).experiment == (*four, "methods")

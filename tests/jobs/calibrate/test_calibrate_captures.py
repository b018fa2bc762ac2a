import json
import re
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from browser import needs_browser, open_page
from fitted_eyes import thinned
from memo import memoised, shared_folder
from present import as_number, narrowed, present

import wlr_render as wlr
from wlr_render.bench.bench import Bench, EyeballCamera, Stage, Target
from wlr_render.bench.bench_file import save_bench
from wlr_render.bench.session_folder import save_session
from wlr_render.bench.simulate_session import simulate as read_off
from wlr_render.calibration.fit_display import fit_display
from wlr_render.calibration.fit_eye import Calibration, KindComparison
from wlr_render.calibration.fit_report import ErrorShare, FitReport, OneMore, Residuals
from wlr_render.calibration.label_errors import LabelError
from wlr_render.calibration.moved_captures import CaptureMotion, MotionAgreement
from wlr_render.captures.capture_file import load_captures
from wlr_render.captures.correspondences import Captures, DisplayCaptures, SeeThroughCaptures
from wlr_render.captures.session import DisplayPlan, SeeThroughPlan, Session, SessionPlan
from wlr_render.cli import main
from wlr_render.error_sources import ErrorSource, remedy
from wlr_render.errors import BadInputError
from wlr_render.evaluation import mapping_error
from wlr_render.evaluation.truth_tests import TruthTests
from wlr_render.geometry.transforms import rigid
from wlr_render.jobs.calibrate.calibrate import calibrate
from wlr_render.jobs.calibrate.calibrate_device import simulate_captures
from wlr_render.jobs.calibrate.calibrate_options import CalibrateOptions, FitOptions
from wlr_render.jobs.calibrate.fit_findings import fit_advice, fit_blocks, fit_sentence, fit_warnings
from wlr_render.mappings import Eye, FieldOfView
from wlr_render.models.display_model import DisplayModel
from wlr_render.models.model_file import load_eye_model, load_eye_models
from wlr_render.models.see_through_model import SeeThroughModel
from wlr_render.optics.device_file import device_path, load_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.report.blocks import Plot, Report, ReportTable

NORTHSTAR = load_device("northstar")
SMALL = CalibrateOptions("birdbath28", viewpoints=12, noise_arcmin=0.0, seed=4)


TWO_EYES = replace(
    SMALL, path="northstar", viewpoints=4, noise_arcmin=0.1, fit=FitOptions(degree=2, see_through_degree=1)
)


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Report]:
    """Folder of a calibration from 12 positions, where nobody writes, and its report."""
    shared = shared_folder(tmp_path_factory)
    folder = shared / "calibrated"
    return folder, memoised(calibrate, shared)(replace(SMALL, noise_arcmin=0.1, out=folder))


@pytest.fixture(scope="module")
def few(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Report]:
    """The same from 4 positions, with few terms."""
    folder = tmp_path_factory.mktemp("few")
    return folder, calibrate(replace(TWO_EYES, out=folder))


def captures_of(calibrated: tuple[Path, Report]) -> Captures:
    """The captures of a calibration."""
    return load_captures(calibrated[0] / "captures-right.npz")


def truth_errors(report: Report, column: str = "rms") -> dict[Any, Any]:
    table = report.tables[-1]
    return {row[0]: row[table.columns.index(column)] for row in table.rows}


def table(report: Report, title: str) -> list[Any]:
    (found,) = [each for each in report.tables if each.title == title]
    return [dict(zip(found.columns, row, strict=True)) for row in found.rows]


def residual(report: Report) -> float:
    """Of the display, rms in arcminutes."""
    return as_number(table(report, "Fit")[0]["residual rms (arcmin)"])


@pytest.mark.parametrize("kind", ["planar", "volumetric"])
def test_noise_free_captures_of_an_image_that_the_model_can_hold_are_recovered(
    flat_image_headset: Eye, kind: Literal["planar", "volumetric"]
) -> None:
    captures = simulate_captures(flat_image_headset, replace(SMALL, fit=FitOptions(kind=kind)))
    fitted = wlr.calibrate(captures, kind, 2, 2).mappings
    rng = np.random.default_rng(8)
    viewpoint = flat_image_headset.eye_box.at(rng.uniform(-1, 1, (20, 1, 3)))
    pixel = rng.uniform(0, 1, (20, 5, 2)) * [140, 100]
    seen = mapping_error.observations_of_pixels(flat_image_headset.display, viewpoint, pixel)
    world = mapping_error.see_through_observations(
        flat_image_headset.see_through, seen.viewpoint, seen.view_dir, rng.uniform(0.3, 5.0, 100)
    )
    if kind == "planar":
        # A flat image parallel to the plane, and a plate, are of degree 1 on it: the bundle holds them exactly.
        assert mapping_error.display_error(fitted.display, seen).forward_arcmin.max() < 1e-6
        assert mapping_error.see_through_error(fitted.see_through, world).backward_arcmin.max() < 1e-6
    else:
        assert mapping_error.display_error(fitted.display, seen).forward_arcmin.max() < 0.05
        assert mapping_error.see_through_error(fitted.see_through, world).backward_arcmin.max() < 0.05


def test_written_files_are_read_back(calibrated: tuple[Path, Report]) -> None:
    folder, report = calibrated
    assert [path.name for path in report.files[:2]] == ["model.json", "captures-right.npz"]
    assert {path.name for path in report.files} == {path.name for path in folder.iterdir()}
    model = load_eye_model(folder / "model.json")
    assert (model.device, model.mappings.eye) == ("birdbath28", "right")
    captures = load_captures(folder / "captures-right.npz")
    assert len(np.unique(present(captures.display).capture)) == 12
    record = json.loads((folder / "report.json").read_text())
    options = record["provenance"]["options"]
    assert (options["--viewpoints"], options["--noise-arcmin"], options["--seed"]) == (12, 0.1, 4)
    assert record["fits"]["right"] == json.loads(json.dumps(model.report))
    assert "Error against the traced device in the nominal field" in (folder / "report.md").read_text()


def test_both_eyes_are_one_model_file_and_their_noise_is_not_mirrored(tmp_path: Path) -> None:
    both = calibrate(replace(TWO_EYES, eye="both", out=tmp_path))
    assert [path.name for path in both.files[:3]] == ["model.json", "captures-left.npz", "captures-right.npz"]
    assert list(load_eye_models(tmp_path / "model.json")) == ["left", "right"]
    noise = []
    for eye in ("left", "right"):
        captures, truth = load_captures(tmp_path / f"captures-{eye}.npz").display, traced_eye(NORTHSTAR, eye)
        assert captures is not None
        noise.append(captures.view_dir - truth.display.view_dir_of_pixel(captures.pixel, captures.viewpoint).value)
    rows = min(map(len, noise))
    upward = [each[:rows, 1] for each in noise]  # mirroring leaves y as it is
    assert abs(narrowed(np.corrcoef(upward), np.ndarray)[0, 1]) < 0.1


def test_results_of_an_earlier_calibration_do_not_stand_beside_a_new_model(tmp_path: Path) -> None:
    """Captures, station, pictures and models of primaries belong to the model that they were written with.

    Captures fit to the model that they were simulated for.
    """
    earlier = ["station-right.json", "coverage.png", "coverage-right.png", "decoding.png"]
    other = ["station-left.json", "captures-left.npz", "notes.txt"]

    def run(calibrate: Callable[..., Any], options: CalibrateOptions) -> set[Any]:
        for name in (*earlier, *other):
            (tmp_path / name).write_text("of an earlier calibration")
        if (tmp_path / "model.json").exists():  # of this eye alone
            (tmp_path / "model-red.json").write_bytes((tmp_path / "model.json").read_bytes())
        calibrate(options)
        assert not (tmp_path / "model-red.json").exists()
        return {name for name in (*earlier, *other, "captures-right.npz") if (tmp_path / name).exists()}

    assert run(calibrate, replace(TWO_EYES, out=tmp_path)) == {*other, "captures-right.npz"}
    model = (tmp_path / "model.json").read_text()
    own = CalibrateOptions(str(tmp_path / "captures-right.npz"), fit=TWO_EYES.fit, out=tmp_path)
    # The model is of these very captures, which the station belongs to.
    assert run(calibrate, own) == {"station-right.json", *other, "captures-right.npz"}
    assert (tmp_path / "model.json").read_text() == model
    display, see_through = load_captures(tmp_path / "captures-right.npz").both
    moved = Captures(thinned(display), thinned(see_through)).save(tmp_path / "moved.npz")
    (tmp_path / "captures-right.npz").write_text("of an earlier calibration")
    assert run(calibrate, replace(own, path=str(moved))) == set(other)
    assert moved.exists()


def test_a_second_eye_is_added_to_the_first_and_the_report_says_so(few: tuple[Path, Report], tmp_path: Path) -> None:
    assert not any("earlier run" in warning for warning in few[1].warnings)
    shutil.copytree(few[0], tmp_path, dirs_exist_ok=True)
    (right,) = json.loads((tmp_path / "model.json").read_text())["eyes"]
    *_, kept = calibrate(replace(TWO_EYES, eye="left", out=tmp_path)).warnings
    assert "also holds the right eye, from an earlier run" in kept
    eyes = json.loads((tmp_path / "model.json").read_text())["eyes"]
    assert [each["eye"] for each in eyes] == ["left", "right"]
    assert eyes[1] == right


@needs_browser
def test_the_page_draws_its_plots(calibrated: tuple[Path, Report], tmp_path: Path) -> None:
    folder, report = calibrated
    page = open_page(folder / "report.html", tmp_path)
    assert page.console == []
    assert page.plots == sum(isinstance(block, Plot) for block in report.blocks) == 6


def test_a_calibrated_eye_is_near_the_truth(calibrated: tuple[Path, Report]) -> None:
    errors = truth_errors(calibrated[1])
    assert 0.01 < errors["direction of a pixel (arcmin)"] < 0.5
    assert 0.005 < errors["direction of a real point (arcmin)"] < 0.3


def test_the_verdict_tells_the_nominal_field_from_the_whole_panel(calibrated: tuple[Path, Report]) -> None:
    report = calibrated[1]
    both = ({row[0]: row[1] for row in table.rows} for table in report.tables[-2:])
    field, panel = (as_number(each["direction of a pixel (arcmin)"]) for each in both)
    assert re.search(
        rf"rms: {field:.3g}' in the nominal field \(.*' predicted\), {panel:.3g}' over the whole panel", report.verdict
    )
    assert field < panel


def test_stage_error_spoils_the_calibration_by_its_pupil_swim() -> None:
    eye = traced_eye(load_device("birdbath28"))
    shown = present(simulate_captures(eye, replace(SMALL, noise_arcmin=0.1, repeatability_um=300.0)).display)
    spoiled = fit_display(thinned(shown), "planar", 5).mapping
    error = mapping_error.display_error(spoiled, TruthTests.of(eye, [SMALL.seed, 1]).display).forward_arcmin
    # Of an exact stage the median is 0.06'. 0.3 mm per axis at 6.3 arcmin per mm, which twelve positions hardly
    # average; the rms is that of some pixels that need extrapolation.
    assert 0.5 < np.nanmedian(error) < 2.0


def test_predicted_errors_stand_beside_the_true_ones(calibrated: tuple[Path, Report]) -> None:
    folder, report = calibrated
    model = load_eye_model(folder / "model.json").mappings
    tests = TruthTests.of(traced_eye(load_device("birdbath28")), [SMALL.seed, 1])
    sigmas = {
        "direction of a pixel (arcmin)": narrowed(model.display, DisplayModel).sigma(
            tests.display.pixel, tests.display.viewpoint
        ),
        "direction of a real point (arcmin)": narrowed(model.see_through, SeeThroughModel).sigma(
            tests.see_through.point, tests.see_through.viewpoint
        ),
    }
    predicted = truth_errors(report, "predicted rms")
    for name, sigma in sigmas.items():
        assert predicted[name] == pytest.approx(np.sqrt(np.nanmean(sigma**2)), rel=1e-3)
        assert 0.3 < predicted[name] / truth_errors(report)[name] < 10.0  # twelve positions say little of a stage


def test_the_sentence_tells_what_the_fit_found(calibrated: tuple[Path, Report]) -> None:
    report = calibrated[1]
    display, see_through = table(report, "Fit")
    for found, name in ((display, "display"), (see_through, "see-through")):
        assert found["mapping"] == name
        assert found["noise stated (arcmin)"] == 0.1
        assert found["noise found (arcmin)"] == pytest.approx(0.1, rel=0.1)
    assert re.match(
        r"Right eye: display 0\.\d+' predicted rms \(noise 0\.\d\d\d' found, 0\.1' stated; ", report.verdict
    )
    assert "see-through 0.0" in report.verdict


def test_held_out_rows_and_columns_stand_beside_what_is_expected(calibrated: tuple[Path, Report]) -> None:
    rows = table(calibrated[1], "Held-out camera positions")
    assert {row["mapping"] for row in rows} == {"display", "see-through"}
    assert {"row 1 of 3", "column 3 of 3"} <= {row["left out"] for row in rows}
    (held_out,) = [each for each in calibrated[1].tables if each.title == "Held-out camera positions"]
    assert any(note.startswith("Display: left-out positions are predicted to") for note in held_out.notes)


def test_residuals_by_label_show_nothing_on_a_sound_session(calibrated: tuple[Path, Report]) -> None:
    rows = table(calibrated[1], "Errors by label")
    assert {"cell of the panel", "cell of the field", "visit"} <= {row["label"] for row in rows}
    assert all(float(row["log10 odds"]) < 0 for row in rows)


def test_few_positions_are_fitted_and_the_report_says_what_one_more_row_brings(few: tuple[Path, Report]) -> None:
    rows = table(few[1], "Gain of one more row of positions")
    assert rows
    for row in rows:
        assert row["with them (arcmin)"] < row["predicted rms error now (arcmin)"]
        assert "camera positions at" in row["positions to add"]


def test_maps_of_the_predicted_error_cover_the_panel(calibrated: tuple[Path, Report]) -> None:
    maps = [block for block in calibrated[1].blocks if isinstance(block, Plot) and "Predicted error" in block.title]
    centre, corner = maps
    assert "centre" in centre.title
    assert "worst corner" in corner.title
    width, height = load_device("birdbath28").eyes["right"].panel.pixels.size_px
    values = []
    for (trace,) in (centre.data, corner.data):
        assert 0.97 * width < max(trace["x"]) < width
        assert 0.95 * height < max(trace["y"]) < height
        values.append(np.array(trace["z"], dtype=float))
        assert np.mean(np.isfinite(values[-1])) > 0.5
    assert np.nanmean(values[1]) > np.nanmean(values[0])


@pytest.fixture(scope="module")
def linear() -> tuple[Calibration, FitReport]:
    """A fit of degree 1 and a report of it in which nothing is wrong."""
    captures = simulate_captures(traced_eye(load_device("birdbath28")), SMALL)
    fit = wlr.calibrate(captures, "planar", 1, 1)
    good = FitReport(
        kind="planar",
        orders="total 1",
        coefficients=10,
        determined=10.0,
        viewpoints=12,
        samples=6300,
        unsolved=0,
        outliers=0,
        residual_arcmin=Residuals(0.3, 0.5, 0.9),
        residual_px=None,
        contraction=0.1,
        noise_arcmin=0.25,
        stated_noise_arcmin=0.25,
        repeatability_um=9.0,
        wobble_urad=25.0,
        moved=(),
        log_evidence=1.0,
        predicted_arcmin=0.12,
        held_out=(),
        one_more=OneMore("a row of 5 camera positions at y = +4.0 mm", 0.115),
    )
    return fit, good


def captures_of_fit(fit: Calibration) -> Captures:
    display, see_through = (side.captures for side in fit.both)
    return Captures(narrowed(display, DisplayCaptures), narrowed(see_through, SeeThroughCaptures))


def with_report(linear: tuple[Calibration, FitReport], **changes: Any) -> Calibration:
    """The fit with another report of the display."""
    fit, good = linear
    display, see_through = replace(present(fit.display)), replace(present(fit.see_through))
    display.__dict__["report"], see_through.__dict__["report"] = replace(good, **changes), good
    return replace(fit, display=display, see_through=see_through)


def test_a_fit_in_which_nothing_is_wrong_warns_of_nothing_and_says_what_it_found(
    linear: tuple[Calibration, FitReport],
) -> None:
    fit = with_report(linear)
    assert fit_warnings(fit) == fit_advice(fit) == []
    side = "0.12' predicted rms (noise 0.250' found, 0.25' stated; repeatability 9.0 um, wobble 25 urad)"
    assert fit_sentence(fit) == f"Right eye: display {side}; see-through {side}."
    still = with_report(linear, repeatability_um=1e-3, wobble_urad=1e-3)
    assert "display 0.12' predicted rms (noise 0.250' found, 0.25' stated; the stage repeats exactly);" in (
        fit_sentence(still)
    )
    stated = with_report(linear, motion_agreement=MotionAgreement(5.1e-6, 9e-6, 0.92, 1.1, 0.3, 0.5))
    assert (
        "0.25' stated; stage repeatability 5.1 um, 9.0 urad from the bench, the readings agree: factors 0.92 and 1.1);"
        in fit_sentence(stated)
    )
    assert fit_warnings(stated) == []
    captures = captures_of_fit(stated)
    (table,) = (
        block
        for block in fit_blocks(KindComparison({"planar": stated}, "planar"), captures)
        if isinstance(block, ReportTable) and block.title == "Motion of the camera"
    )
    assert narrowed(table, ReportTable).rows[0] == ["display", "shift (um)", pytest.approx(5.1), 9.0, 0.92, 0.3]
    late = with_report(linear, labels=(LabelError("time", 6, 7.1, 7.8, 0.177, 0.092, 0.08),))
    assert "wobble 25 urad; errors by time 0.18');" in fit_sentence(late)
    exact = with_report(linear, stated_noise_arcmin=None, repeatability_um=0.0, wobble_urad=0.0)
    assert "display 0.12' predicted rms (noise 0.250' found);" in fit_sentence(exact)


@pytest.mark.parametrize(
    ("changes", "warning"),
    [
        (
            {"moved": (CaptureMotion(5, 3.5e-4, 2e-4, 5.0, 20.0),)},
            "Display: the readings of set 5 lie as if its camera had stood 350 um and 200 microradians from where it "
            "is stated (log10 odds 20 against noise and an ordinary stage): the camera or the headset moved, its entry "
            "is wrong, or the optics are less smooth there than the model. The model was fitted without them.",
        ),
        (
            {"unsure": (CaptureMotion(5, 3.5e-4, 2e-4, 5.0, 1.0),)},
            "Display: the readings of set 5 lie as if its camera had stood 350 um and 200 microradians from where it "
            "is stated (log10 odds 1 against noise and an ordinary stage): these captures do not show whether it moved "
            "or the optics are less smooth there than the model. The model was fitted with them; take this capture "
            "again, or add positions near it.",
        ),
        (
            {"noise_arcmin": 1.0},
            "Display: the noise found is 4.0 times the stated one (1.00' beside 0.25'): the stated sigma is too small, "
            "or the readings have errors other than noise (lens, decoding, target).",
        ),
        (
            {"noise_arcmin": 0.1},
            "Display: the stated noise is 2.5 times the one found (0.100' beside 0.25'): state a smaller sigma.",
        ),
        (
            {"repeatability_um": 1000.0},
            "Display: the repeatability of positions found is at its bound, 1000 um, which no stage has: check "
            "viewpoints, units and axes of the captures.",
        ),
        (
            {"wobble_urad": 2999.0},
            "Display: the wobble found is at its bound, 3000 microradians, which no stage has: check viewpoints, units "
            "and axes of the captures.",
        ),
        (
            {"motion_agreement": MotionAgreement(5e-6, 9e-6, 2.4, 1.0, 4.2, 0.1)},
            "Display: between captures the camera seems to have shifted 2.40 times as far as the bench states (off by "
            "4.2 sigma): camera or headset moved after the bench was photographed, or the optics are less smooth than "
            "the model.",
        ),
        (
            {"motion_agreement": MotionAgreement(5e-6, 9e-6, 1.0, 0.3, 0.1, 3.5)},
            "Display: between captures the camera seems to have turned 0.300 times as far as the bench states (off by "
            "3.5 sigma): the predicted errors are too large.",
        ),
        (
            {
                "labels": (
                    LabelError("time", 6, 7.1, 7.8, 0.177, 0.092, 0.08),
                    LabelError("dot", 80, 1.4, 3.1, 0.014, 0.005, 0.08),  # hardly matters
                    LabelError("visit", 12, 1.1, -1.3, 0.1, 0.1, 0.08),  # does not stand out
                )
            },
            "Display: the residuals show errors by time of 0.18' rms (log10 odds 8), which the model lacks. They cause "
            "errors of the model of about 0.092', which the predicted error contains as 'drift'. Let camera and "
            "headset warm up, and visit the positions in random order.",
        ),
        (
            {"one_more": OneMore("a row of 3 camera positions at y = +4.0 mm", 0.06)},
            "Display: the number of camera positions limits the predicted error; one more row or column of them would "
            "lower it by 50 %.",
        ),
    ],
)
def test_what_is_wrong_is_told_in_a_sentence(
    linear: tuple[Calibration, FitReport], changes: dict[str, Any], warning: str
) -> None:
    assert fit_warnings(with_report(linear, **changes), [f"set {number}" for number in range(12)]) == [warning]


@pytest.mark.parametrize(
    ("eye", "x_m", "other"),
    [("left", 0.032, "right"), ("right", -0.032, "left"), ("left", -0.032, ""), ("left", 0, "")],
)
def test_an_eye_on_the_side_of_the_other_eye_is_doubted_first(
    linear: tuple[Calibration, FitReport], eye: str, x_m: float, other: str
) -> None:
    fit = with_report(linear, noise_arcmin=1.0)
    box = replace(fit.mappings.eye_box, centre=np.array([x_m, 0.0, 0.03]))
    first, *others = fit_warnings(replace(fit, mappings=replace(fit.mappings, eye=eye, eye_box=box)))
    if other:
        assert first == (
            f"The eye box of the {eye} eye is at x = {1e3 * x_m:+g} mm (x right), where the {other} eye is if the "
            "frame's origin lies between the eyes: check 'eye', 'frame' and the sign of x."
        )
        assert len(others) == 1
    else:
        assert first.startswith("Display: the noise found")


def test_a_row_of_positions_is_advised_where_it_pays(linear: tuple[Calibration, FitReport]) -> None:
    fit = with_report(linear, one_more=OneMore("a row of 5 camera positions at y = +4.0 mm", 0.1))
    (advice,) = fit_advice(fit)
    assert advice == (
        "Display: add a row of 5 camera positions at y = +4.0 mm; the predicted error falls from 0.12' to 0.10'."
    )


def test_the_largest_source_of_the_predicted_error_is_advised_against(linear: tuple[Calibration, FitReport]) -> None:
    board = ErrorShare("printing errors of the board", 0.1, 4.8e-5, 5e-5, "m")
    own, drift = ErrorShare("noise and stage", 0.05), ErrorShare("drift", 0.04, 0.1, 0.1, "arcmin")
    fit = with_report(linear, shares=(board, own, drift), unseen=("heat (thermometers)",))
    assert fit_advice(fit) == [
        "Display: 0.10' of the predicted 0.12' come from the source 'printing errors of the board' (48 um in the fit, "
        "usually 50 um). Print the board on glass, measure its dots, or turn it by 90 degrees at one pose."
    ]
    captures = captures_of_fit(fit)
    blocks = fit_blocks(KindComparison({"planar": fit}, "planar"), captures)
    tables = [block for block in blocks if isinstance(block, ReportTable)]
    (shares,) = (block for block in tables if block.title == "Predicted error by source")
    assert shares.rows[2] == ["display", "drift", 0.04, "0.10'", "0.10'"]
    assert shares.notes[1] == (
        "Display: the predicted error does not contain the following errors, because the captures lack the data in "
        "brackets: heat (thermometers)."
    )


@pytest.mark.parametrize("source", [*ErrorSource, "heat"])
def test_each_source_of_most_of_the_predicted_error_has_a_remedy(
    linear: tuple[Calibration, FitReport], source: str
) -> None:
    fit = with_report(linear, shares=(ErrorShare(source, 0.11), ErrorShare("lens", 0.01)))
    advice = f"Display: 0.11' of the predicted 0.12' come from the source '{source}'. {remedy(source)}"
    # Against noise help positions, on which a sentence of its own advises, where they pay.
    assert fit_advice(fit) == ([] if source == ErrorSource.NOISE_AND_STAGE else [advice])
    assert re.fullmatch(r"[A-Z].{20,}[^.]\.", remedy(source))


def test_a_prescription_is_compared_with_no_prescription_and_the_best_kind_is_saved(
    calibrated: tuple[Path, Report], tmp_path: Path
) -> None:
    display, see_through = captures_of(calibrated).both
    few = Captures(thinned(display), thinned(see_through)).save(tmp_path / "few.npz")
    fit = FitOptions(prescription="birdbath28")
    again = calibrate(CalibrateOptions(str(few), fit=fit, out=tmp_path))
    kinds = {row["model"]: row for row in table(again, "Gain of the prescription")}
    assert kinds.keys() == {"planar", "grey-box", "prescription"}
    (saved,) = [kind for kind, row in kinds.items() if row[""] == "saved"]
    assert saved in ("grey-box", "prescription")
    assert table(again, "Fit")[0]["model"] == saved
    assert kinds["planar"]["log10 odds against planar"] == 0.0
    assert float(kinds[saved]["log10 odds against planar"]) > 2.0
    assert kinds[saved]["display predicted (arcmin)"] < kinds["planar"]["display predicted (arcmin)"]
    assert "prescription" in again.verdict
    assert any(path.name == "birdbath28.toml" for path in again.inputs)
    viewpoint, pixel = NORTHSTAR.eyes["right"].eye_box.centre, np.array([900.0, 500.0])
    saved_display = load_eye_model(tmp_path / "model.json").mappings.display
    assert narrowed(saved_display, DisplayModel).sigma(pixel, viewpoint) > 0


def test_a_prescription_without_the_eye_is_refused(calibrated: tuple[Path, Report], tmp_path: Path) -> None:
    folder, _ = calibrated
    one_eyed = tmp_path / "left.toml"
    text = device_path("birdbath28").read_text()
    one_eyed.write_text(text.replace('side = "right"', 'side = "left"', 1))
    fit = FitOptions(kind="prescription", prescription=str(one_eyed))
    with pytest.raises(BadInputError, match="has no right eye, but the captures are of it"):
        calibrate(CalibrateOptions(str(folder / "captures-right.npz"), fit=fit, out=tmp_path))


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        (["--kind", "grey-box"], "--kind grey-box needs --prescription DEVICE"),
        (["--kind", "static", "--prescription", "northstar"], "--prescription is not used by a static model"),
    ],
)
def test_wrong_options_are_refused_in_one_line(
    wrong: Sequence[str], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["calibrate", "birdbath28", *wrong, "--out", str(tmp_path / "out")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert sentence in line
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("side", ["display", "see_through"])
def test_captures_of_one_side_alone_are_calibrated_and_their_model_is_not_rendered(
    calibrated: tuple[Path, Report], tmp_path: Path, side: str, capsys: pytest.CaptureFixture[str]
) -> None:
    both, fit = captures_of(calibrated), FitOptions(degree=3, see_through_degree=2)
    alone = Captures(both.display) if side == "display" else Captures(None, both.see_through)
    path = alone.save(tmp_path / "alone.npz")
    report = calibrate(CalibrateOptions(str(path), fit=fit, out=tmp_path / "out"))
    lacking = "see-through" if side == "display" else "display"
    assert lacking not in report.verdict
    assert set(report.record["fits"]["right"]) == {side}
    model = str(tmp_path / "out" / "model.json")
    assert main(["render", model, "desk", "--out", str(tmp_path / "picture")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"the model has no {lacking} mapping" in line


@pytest.fixture(scope="module")
def night(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Folder of a session of northstar whose stage went further than it said, and file of the bench as it was."""
    folder = tmp_path_factory.mktemp("night")
    camera = EyeballCamera(np.array([1280.0, 1024.0]), np.array([1350.0, 1350.0]), np.array([640.5, 512.5]), 0.1)
    poses = rigid(np.eye(3), np.array([[0.03, 0.0, -0.6], [0.03, 0.0, -1.1]]))
    device = load_device("northstar")
    centre = device.eyes["right"].eye_box.centre
    believed = Bench(device, "right", camera, Stage(centre), Target(poses, np.full(2, 0.02)))
    true = replace(believed, stage=Stage(centre, 1.1 * np.eye(3)))
    rng = np.random.default_rng(2)
    count, each = 16, 60
    capture = np.repeat(np.arange(count), each)
    stage = (centre + rng.uniform(-0.004, 0.004, (count, 3)) * [1, 1, 0])[capture]
    time_s, travel, pixel = (
        40.0 * capture,
        np.ones(count * each),
        rng.uniform([450, 350], [850, 650], (count * each, 2)),
    )
    display = DisplayPlan(capture, np.asarray(time_s), travel, stage, np.ones_like(capture), pixel)
    dot = rng.uniform(-0.15, 0.15, (count * each, 2))
    plan = SessionPlan(display, SeeThroughPlan(capture, np.asarray(time_s), travel, stage, capture % 2, dot))
    save_session(folder / "session", believed, Session("night", plan, read_off(true, plan)))
    return folder / "session", save_bench(true, folder / "true.toml")


BY_BENCH = FitOptions(degree=3, see_through_degree=2)


@pytest.fixture(scope="module")
def extended(night: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Report:
    """The session calibrated by the bench as it was."""
    session, bench = night
    return calibrate(CalibrateOptions(str(session), bench=bench, fit=BY_BENCH, out=tmp_path_factory.mktemp("extended")))


def display_error(model: Eye) -> float:
    """Of a model against northstar as it is, rms in arcminutes, well inside the fit."""
    truth = traced_eye(load_device("northstar"))
    viewpoint = truth.eye_box.at(np.random.default_rng(3).uniform(-0.4, 0.4, (20, 1, 3)) * [1, 1, 0])
    middle = FieldOfView(np.full(2, -0.08), np.full(2, 0.08)).directions(5, 5)
    seen = mapping_error.observations_of_dirs(truth.display, viewpoint, middle)
    return float(np.sqrt(np.mean(mapping_error.display_error(model.display, seen).forward_arcmin ** 2)))


def test_a_session_is_calibrated_by_the_bench_that_is_believed(
    night: tuple[Path, Path], extended: Report, tmp_path: Path
) -> None:
    believed = calibrate(CalibrateOptions(str(night[0]), fit=BY_BENCH, out=tmp_path))
    assert extended.inputs == list(night)
    before, after = (display_error(load_eye_model(each.files[0]).mappings) for each in (believed, extended))
    assert after < 0.3 * before
    # The fit itself cannot tell: whoever believes the stage finds its captures in good order.
    assert residual(believed) < 1.1 * residual(extended)


def test_a_bench_of_another_headset_is_refused(night: tuple[Path, Path], tmp_path: Path) -> None:
    session, bench = night
    other = tmp_path / "other.toml"
    other.write_text(bench.read_text().replace('"northstar"', '"freeform40"'))
    with pytest.raises(BadInputError, match=r"other.toml: is a bench of freeform40 \(right eye\), the session"):
        calibrate(CalibrateOptions(str(session), bench=other, out=tmp_path))


def test_target_poses_are_the_sessions_whatever_a_bench_states(
    night: tuple[Path, Path], extended: Report, tmp_path: Path
) -> None:
    session, bench = night
    other = tmp_path / "other.toml"
    other.write_text(bench.read_text().rsplit("[[target_pose]]", 1)[0])
    by_other = calibrate(CalibrateOptions(str(session), bench=other, fit=BY_BENCH, out=tmp_path))
    fewer, all_of_them = (load_eye_model(each.files[0]) for each in (by_other, extended))
    viewpoint = NORTHSTAR.eyes["right"].eye_box.centre
    point = viewpoint + [0.05, 0.02, -0.8]
    seen = [each.mappings.see_through.view_dir_of_real_point(point, viewpoint).value for each in (fewer, all_of_them)]
    assert np.isfinite(seen).all()
    np.testing.assert_allclose(seen[0], seen[1], atol=1e-15)


def test_a_bench_beside_a_capture_file_is_refused(
    calibrated: tuple[Path, Report], night: tuple[Path, Path], tmp_path: Path
) -> None:
    folder, _ = calibrated
    with pytest.raises(
        BadInputError, match=r"--bench is used with a bench session only, and \S*captures-right\.npz is a capture file"
    ):
        calibrate(CalibrateOptions(str(folder / "captures-right.npz"), bench=night[1], out=tmp_path))

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from calibration.prescribed_eyes import captured, prescription
from calibration.toy_device import EYE_BOX, display_captures, positions_in_plane, see_through_captures
from present import narrowed, present

from benchmarks.wrong_headset import wrong_headset
from wlr_render.calibration.fit_display import fit_display
from wlr_render.calibration.fit_eye import Calibration, EyeTrends, calibrate, eye_trends, fit_kinds, fit_with_trends
from wlr_render.calibration.fit_prescription import fit_assembly
from wlr_render.captures.correspondences import AnyCaptures, Captures
from wlr_render.captures.feature_captures import CaptureMotionPrior
from wlr_render.error_sources import ErrorSource
from wlr_render.errors import BadInputError
from wlr_render.evaluation import mapping_error
from wlr_render.geometry.directions import ARCMIN, arcmin_between, normalised
from wlr_render.mappings import Eye
from wlr_render.models.display_model import DisplayModel
from wlr_render.models.model_file import load_eye_model, save_eye_models
from wlr_render.models.model_place import NOWHERE
from wlr_render.models.see_through_model import SeeThroughModel
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.assembly import ASSEMBLY_SIZES, assembled
from wlr_render.optics.device import EyeOptics
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import TracedDisplay, traced_eye
from wlr_render.simulation import viewpoints
from wlr_render.simulation.capture_setup import CaptureSetup
from wlr_render.simulation.simulate_captures import simulate_display, simulate_see_through

CAPTURES = Captures(display_captures(positions_in_plane(12)), see_through_captures(positions_in_plane(12)))


def test_eye_fit_names_what_it_is_and_goes_through_a_file(tmp_path: Path) -> None:
    eye = calibrate(CAPTURES, "planar", 2, 1)
    assert eye.mappings.name == "toy (planar)"
    path = save_eye_models(tmp_path / "right.json", [eye.model()])
    loaded = load_eye_model(path)
    assert loaded.device == "toy"
    assert loaded.report["display"]["residual_px"]["rms"] == present(present(eye.display).report.residual_px).rms
    assert CAPTURES.display is not None
    pixel, viewpoint = CAPTURES.display.pixel, CAPTURES.display.viewpoint
    before = eye.mappings.display.view_dir_of_pixel(pixel, viewpoint).value
    np.testing.assert_array_equal(loaded.mappings.display.view_dir_of_pixel(pixel, viewpoint).value, before)


def test_point_per_pixel_goes_with_a_static_see_through() -> None:
    eye = calibrate(CAPTURES, "point-per-pixel", 3, 2)
    assert narrowed(eye.mappings.see_through, SeeThroughModel).place == NOWHERE
    assert (present(eye.display).kind, present(eye.see_through).kind) == ("point-per-pixel", "static")


def test_report_is_json_ready() -> None:
    record = calibrate(CAPTURES, "planar", 1, 1).model().report
    assert json.loads(json.dumps(record))["see_through"]["residual_px"] is None


@pytest.mark.parametrize(("missing", "lacking"), [("display", "display"), ("see_through", "see-through")])
def test_captures_of_one_side_give_its_model_and_the_other_side_refuses_every_use(
    tmp_path: Path, missing: str, lacking: str
) -> None:
    fit = calibrate(dataclasses.replace(CAPTURES, **{missing: None}), "planar", 1, 1)
    both = calibrate(CAPTURES, "planar", 1, 1).mappings
    (kept,) = {"display", "see_through"} - {missing}
    viewpoint, pixel, far = EYE_BOX.centre, np.array([480.0, 420.0]), EYE_BOX.centre - [0.0, 0.0, 1.0]
    path = save_eye_models(tmp_path / "model.json", [fit.model()])
    assert set(fit.model().report) == {kept}
    for mappings in (fit.mappings, load_eye_model(path).mappings):
        if missing == "display":
            seen, known = (each.see_through.view_dir_of_real_point(far, viewpoint).value for each in (mappings, both))
        else:
            seen, known = (each.display.view_dir_of_pixel(pixel, viewpoint).value for each in (mappings, both))
        np.testing.assert_array_equal(seen, known)
        with pytest.raises(BadInputError, match=f"the model has no {lacking} mapping"):
            (
                mappings.display.view_dir_of_pixel(pixel, viewpoint),
                mappings.see_through.view_dir_of_real_point(far, viewpoint),
            )
    with pytest.raises(BadInputError, match=f"no {lacking} part"):
        fit_kinds(dataclasses.replace(CAPTURES, **{missing: None}), prescription("birdbath28"))


@pytest.mark.parametrize("kind", ["grey-box", "prescription"])
def test_a_kind_that_needs_a_prescription_says_so(kind: str) -> None:
    with pytest.raises(BadInputError, match=f"a {kind} model needs the device's prescription"):
        calibrate(CAPTURES, kind)


def display_errors(fit: Calibration, truth: EyeOptics) -> tuple[FloatArray, Any]:
    """Angles (n,) in arcminutes between model and truth at random viewpoints, and those that the model expects."""
    rng = np.random.default_rng(2)
    viewpoint = viewpoints.random_in_eye_box(truth.eye_box, 64, rng)[:, None]
    directions = present(truth.field).directions(15, 15)
    view_dir = directions[rng.integers(0, len(directions), (64, 32))]
    seen = mapping_error.observations_of_dirs(TracedDisplay(truth, 0.55), viewpoint, view_dir)
    place = np.broadcast_to(seen.viewpoint, (*seen.pixel.shape[:-1], 3))
    found = fit.mappings.display.view_dir_of_pixel(seen.pixel, place).value
    sigma = narrowed(fit.mappings.display, DisplayModel).sigma(seen.pixel, place)
    return arcmin_between(found, seen.view_dir), sigma


def rms(values: FloatArray) -> float:
    return float(np.sqrt(np.nanmean(np.square(values))))


def test_five_positions_and_a_prescription_with_a_wrong_shape_are_enough() -> None:
    """What 25 positions gave without one is 0.12'. The stage moves the camera by 10 um and 30 microradians."""
    truth = wrong_headset(prescription("northstar"), np.random.default_rng(0), shape=0.002)
    captures = captured(truth, 5, 0.25, stage_error_m=10e-6, grid=(11, 9), stage_turn_rad=30e-6)
    kinds = fit_kinds(captures, prescription("northstar"))
    assert kinds.best == "grey-box"
    found, expected = display_errors(kinds.chosen, truth)
    assert rms(found) < 0.2
    assert 0.5 < rms(expected) / rms(found) < 2.0
    assert rms(found) < 0.5 * min(
        rms(display_errors(kinds.fits[kind], truth)[0]) for kind in ("planar", "prescription")
    )
    assert "and a small smooth remainder explain them" in kinds.sentence


def test_where_the_prescription_is_right_nothing_is_left_to_the_smooth_remainder() -> None:
    """Kinds are compared on the same readings: an outlier has one weight in all, also a somewhat improbable one."""
    truth = wrong_headset(prescription("northstar"), np.random.default_rng(0))
    captures = captured(truth, 9, 1.0)
    shown = present(captures.display)
    pixel = shown.pixel.copy()
    pixel[::40] += np.linspace(1.0, 64.0, len(pixel[::40]))[:, None]
    spoilt = Captures(dataclasses.replace(shown, pixel=pixel), captures.see_through)
    kinds = fit_kinds(spoilt, prescription("northstar"))
    assert kinds.best == "prescription"
    grey, alone = (display_errors(kinds.fits[kind], truth)[0] for kind in ("grey-box", "prescription"))
    assert rms(grey) < 1.2 * rms(alone) < 0.1
    assert "explains the captures" in kinds.sentence
    assert kinds.log10_odds("prescription") > 10.0
    weights = [present(fit.display).smooth.kept for fit in kinds.fits.values()]
    assert weights[0][::40][-1] == 0.0
    assert np.any((weights[0] > 0.0) & (weights[0] < 1.0))
    assert all(np.array_equal(weights[0], other) for other in weights)


def test_the_corrected_prescription_is_in_the_model_file(tmp_path: Path) -> None:
    truth = wrong_headset(prescription("birdbath28"), np.random.default_rng(0))
    fit = calibrate(captured(truth, 5, 0.25, grid=(7, 5)), "prescription", prescription=prescription("birdbath28"))
    report = load_eye_model(save_eye_models(tmp_path / "right.json", [fit.model()])).report["prescription"]
    path = tmp_path / "corrected.toml"
    path.write_text(report["device_file"])
    corrected = load_device(str(path)).eyes["right"]
    given = assembled(
        prescription("birdbath28"), np.array([each["value"] for each in report["assembly_errors"].values()])
    )
    np.testing.assert_allclose(corrected.panel.device_from_panel, given.panel.device_from_panel, atol=1e-9)
    assert np.abs(corrected.panel.device_from_panel - prescription("birdbath28").panel.device_from_panel).max() > 1e-5


@pytest.fixture(scope="module")
def drawn() -> tuple[EyeTrends, list[Calibration]]:
    """Fits to captures that differ in their noise alone, by trends of the same optics."""
    optics = prescription("birdbath28")
    truth = assembled(optics, 0.3 * ASSEMBLY_SIZES * np.random.default_rng(4).normal(size=12))
    captures = [captured(truth, 5, 1.0, seed=seed, grid=(7, 5)) for seed in range(24)]
    trends = eye_trends(captures[0], fit_assembly(captured(truth, 5), optics))
    return trends, [fit_with_trends(each, "prescription", trends) for each in captures]


def test_both_models_have_the_same_posterior_of_the_assembly_errors(drawn: tuple[EyeTrends, list[Calibration]]) -> None:
    trends, fits = drawn
    found = fits[0].assembly
    assert found is not None
    root = np.linalg.cholesky(found.covariance / np.outer(ASSEMBLY_SIZES, ASSEMBLY_SIZES))
    for fitted, trend in ((fits[0].display, trends.display), (fits[0].see_through, trends.see_through)):
        inputs = np.random.default_rng(0).uniform(trend.mean.box.low, trend.mean.box.high, (30, 4))
        expected = trend.about(found.values / ASSEMBLY_SIZES, np.asarray(root))
        assert fitted is not None
        np.testing.assert_allclose(fitted.smooth.polynomial(inputs), expected.mean(inputs), atol=1e-9)
        outputs = fitted.smooth.polynomial.coefficients.shape[1]
        change = expected.by_parameter(inputs).reshape(30, outputs, 12)
        assert fitted.mapping.spread is not None
        np.testing.assert_allclose(
            fitted.mapping.spread.covariance(inputs), change @ change.transpose(0, 2, 1), rtol=1e-4, atol=1e-13
        )
        assert fitted.mapping.spread.sources[:12] == (ErrorSource.PRESCRIPTION,) * 12


def test_errors_of_display_and_see_through_vary_together_as_the_shared_variables_say(
    drawn: tuple[EyeTrends, list[Calibration]],
) -> None:
    trends, fits = drawn
    display, see_through = trends.display.mean.box, trends.see_through.mean.box
    rng = np.random.default_rng(0)
    shown = rng.uniform(display.low, display.high, (30, 4))
    seen = rng.uniform(see_through.low, see_through.high, (30, 4))

    def values(fit: Calibration) -> tuple[FloatArray, FloatArray]:
        of_pixels, of_points = (each.mapping for each in fit.both)
        far = narrowed(of_points, SeeThroughModel).deviation(seen)[:, :2]
        return narrowed(of_pixels, DisplayModel).forward(shown).ravel() / ARCMIN, far.ravel() / ARCMIN

    errors = [np.stack(each) for each in zip(*map(values, fits), strict=True)]
    display_error, see_through_error = (each - each.mean(axis=0) for each in errors)
    together = display_error.T @ see_through_error / (len(fits) - 1)
    of_display = present(present(fits[0].display).mapping.spread).unshared_and_shared(shown)[1].reshape(60, -1) / ARCMIN
    of_see_through = (
        present(present(fits[0].see_through).mapping.spread).unshared_and_shared(seen)[1][:, :2].reshape(60, -1)
        / ARCMIN
    )
    predicted = of_display @ of_see_through.T
    assert np.sum(together * predicted) / np.sum(predicted**2) == pytest.approx(1.0, abs=0.35)
    assert np.corrcoef(together.ravel(), predicted.ravel())[0, 1] > 0.6


def test_display_and_see_through_are_of_one_stage() -> None:
    """Five positions alone cannot tell motions of 17 um from a shape that is wrong; see-through knows them."""
    truth = wrong_headset(prescription("birdbath28"), np.random.default_rng(2), shape=0.002)
    fit = calibrate(
        captured(truth, 5, 0.25, seed=102, grid=(25, 21)), "grey-box", prescription=prescription("birdbath28")
    )
    for name, (size, sigma) in present(fit.see_through).smooth.stage.items():
        assert fit.display is not None
        assert fit.display.smooth.stage[name][0] == pytest.approx(size, abs=sigma)
    assert present(fit.display).smooth.shift_m < 3e-6
    assert rms(display_errors(fit, truth)[0]) < 0.05


@pytest.mark.parametrize("kind", ["planar", "grey-box"])
def test_captures_of_a_display_on_a_worse_stage_are_not_accused(kind: str) -> None:
    truth = wrong_headset(prescription("birdbath28"), np.random.default_rng(2), shape=0.002)
    captures = captured(truth, 16, 0.25, seed=102, grid=(9, 8))
    assert captures.display is not None
    shift = np.random.default_rng(5).normal(0, 4e-5, (16, 3))[captures.display.capture]
    display = dataclasses.replace(captures.display, viewpoint=captures.display.viewpoint + shift)
    fit = calibrate(Captures(display, captures.see_through), kind, prescription=prescription("birdbath28"))
    assert present(fit.display).smooth.moved == present(fit.see_through).smooth.moved == ()
    error, predicted = map(rms, display_errors(fit, truth))
    assert 0.7 < error / predicted < 1.4


def with_motion(side: AnyCaptures) -> AnyCaptures:
    """Captures that state how far the camera moved in each."""
    numbers = np.unique(side.visits[0])
    return dataclasses.replace(
        side, motion=CaptureMotionPrior(numbers, np.tile([1.4e-5] * 3 + [5e-6] * 3, (len(numbers), 1)), 0.3)
    )


@pytest.mark.parametrize("stated", [with_motion, lambda side: side], ids=["stated", "not-stated"])
def test_the_display_is_fitted_with_the_stage_that_see_through_found(stated: Callable[..., Any]) -> None:
    sides = (make(positions_in_plane(12), sigma_arcmin=0.1) for make in (display_captures, see_through_captures))
    captures = Captures(*map(stated, sides))
    fit = calibrate(captures, "planar", 2, 1)
    given, alone = (
        fit_display(present(captures.display), "planar", 2, stage=stage).smooth.posterior.log_evidence
        for stage in (present(fit.see_through).smooth.stage, None)
    )
    assert present(fit.display).smooth.posterior.log_evidence == given != alone


def few_places_of_freeform40(seed: int) -> tuple[Eye, Captures]:
    """16 places of an accurate camera whose stage moves by what the captures state, with tails and rounding."""
    truth = traced_eye(load_device("freeform40"), "right")
    setup = CaptureSetup(truth, 0.0, 5e-6, truth.field, (9, 8), stage_turn_rad=1.4e-5)
    rng = np.random.default_rng(seed)
    positions = setup.camera_positions("planar", 16)

    def noisy(side: AnyCaptures) -> AnyCaptures:
        noise = 0.045 * ARCMIN / np.sqrt(2.0) * rng.standard_t(4, side.view_dir.shape)
        sigma = np.full(len(side), 0.045)
        return with_motion(dataclasses.replace(side, view_dir=normalised(side.view_dir + noise), sigma_arcmin=sigma))

    display = noisy(simulate_display(setup, positions, rng))
    return truth, Captures(display, noisy(simulate_see_through(setup, positions, rng)))


@pytest.mark.slow
def test_few_places_of_strong_optics_neither_inflate_the_stage_nor_the_predicted_error() -> None:
    truth, captures = few_places_of_freeform40(seed=3)
    fit = calibrate(captures)
    assert fit.display is not None
    assert fit.display.smooth.shift_m < 12e-6
    rng = np.random.default_rng(4)
    pixel = rng.uniform(0.05, 0.95, (400, 2)) * truth.display.panel.size_px
    viewpoint = truth.eye_box.at(rng.uniform(-1.0, 1.0, (400, 3)))
    true, predicted = truth.display.view_dir_of_pixel(pixel, viewpoint).value, fit.display.mapping
    error = rms(arcmin_between(predicted.view_dir_of_pixel(pixel, viewpoint).value, true))
    assert error < 0.3
    assert 0.6 < rms(predicted.sigma(pixel, viewpoint)) / error < 1.6

"""Prescriptions with fitted assembly errors, on captures of headsets that differ from them."""

from dataclasses import replace
from typing import Any, NoReturn

import numpy as np
import pytest
from calibration.prescribed_eyes import captured, prescription

from benchmarks.wrong_headset import wrong_headset
from wlr_render.calibration.fit_prescription import IMPLAUSIBLE, display_trend, fit_assembly, see_through_trend
from wlr_render.captures.correspondences import Captures
from wlr_render.errors import BadInputError
from wlr_render.geometry.planes import BasePlane
from wlr_render.numerics.polynomial import Box
from wlr_render.optics.assembly import ASSEMBLY_SIZES, assembled
from wlr_render.optics.device import EyeOptics
from wlr_render.optics.traced_mappings import TracedDisplay
from wlr_render.simulation import viewpoints

DEVICES = ("northstar", "freeform40", "birdbath28")


def forward_rms(fitted: EyeOptics, truth: EyeOptics) -> float:
    """Rms angle in arcminutes over the nominal field at random viewpoints: the fitted pixel's shift as an angle."""
    rng = np.random.default_rng(2)
    viewpoint = viewpoints.random_in_eye_box(truth.eye_box, 400, rng)
    assert truth.field is not None
    view_dir = truth.field.directions(20, 20)
    pixel, _ = TracedDisplay(truth, 0.55).plane_pixel(view_dir, viewpoint)
    found, _ = TracedDisplay(fitted, 0.55).plane_pixel(view_dir, viewpoint)
    px_per_arcmin = truth.panel.pixels.size_px / (
        np.rad2deg(np.arctan(truth.field.high) - np.arctan(truth.field.low)) * 60
    )
    return float(np.sqrt(np.mean(np.sum(((found - pixel) / px_per_arcmin) ** 2, axis=1))))


@pytest.mark.slow
@pytest.mark.parametrize("name", DEVICES)
def test_exact_captures_give_back_the_assembly_errors(name: str) -> None:
    drawn = 0.3 * ASSEMBLY_SIZES * np.random.default_rng(4).normal(size=12)
    fitted = fit_assembly(captured(assembled(prescription(name), drawn)), prescription(name))
    assert forward_rms(fitted.optics, assembled(prescription(name), drawn)) < 2e-3
    sigma = np.sqrt(np.diag(fitted.covariance))
    np.testing.assert_array_less(np.abs(fitted.values - drawn), 5.0 * sigma + 1e-3 * ASSEMBLY_SIZES)


def test_the_prior_of_the_assembly_errors_is_gaussian_however_large_they_are(monkeypatch: pytest.MonkeyPatch) -> None:
    class SolverReachedError(Exception):
        pass

    def solver(residual: Any, start: Any, *, loss: Any, f_scale: Any, **_: object) -> NoReturn:
        """An error of 6 sizes costs 18, a reading off by 6 sizes less."""
        square = (np.full(len(residual(start)), 6.0) / f_scale) ** 2
        cost = 0.5 * f_scale**2 * loss(square)[0]
        np.testing.assert_allclose(cost[-len(ASSEMBLY_SIZES) :], 18.0)
        assert np.all(cost[: -len(ASSEMBLY_SIZES)] < 9.0)
        raise SolverReachedError

    monkeypatch.setattr("scipy.optimize.least_squares", solver)
    with pytest.raises(SolverReachedError):
        fit_assembly(captured(prescription("birdbath28"), count=1), prescription("birdbath28"))


def test_displaced_parts_are_found_at_a_quarter_arcminute_of_noise() -> None:
    truth = wrong_headset(prescription("freeform40"), np.random.default_rng(0))
    fitted = fit_assembly(captured(truth, count=5, noise=0.25), prescription("freeform40"))
    assert forward_rms(prescription("freeform40"), truth) > 5.0
    assert forward_rms(fitted.optics, truth) < 0.05
    assert fitted.display_arcmin == pytest.approx(0.25, rel=0.1)
    assert fitted.see_through_arcmin == pytest.approx(0.25, rel=0.1)


def test_an_error_of_the_shape_stays_in_the_residuals_and_not_in_absurd_values() -> None:
    truth = wrong_headset(prescription("birdbath28"), np.random.default_rng(0), shape=0.002)
    fitted = fit_assembly(captured(truth, noise=0.25), prescription("birdbath28"))
    assert 0.1 < forward_rms(fitted.optics, truth) < 1.0
    assert fitted.display_arcmin > 1.15 * 0.25
    assert np.abs(fitted.values / ASSEMBLY_SIZES).max() < 1.5


def test_stage_jitter_spreads_the_fit_and_does_not_lead_it_astray() -> None:
    truth = wrong_headset(prescription("northstar"), np.random.default_rng(0))
    fitted = fit_assembly(
        captured(truth, count=25, noise=0.25, stage_error_m=30e-6, grid=(7, 6)), prescription("northstar")
    )
    assert forward_rms(fitted.optics, truth) < 0.5
    assert np.abs(fitted.values / ASSEMBLY_SIZES).max() < 1.0


def test_gross_outliers_do_not_move_the_fit() -> None:
    truth = wrong_headset(prescription("northstar"), np.random.default_rng(0))
    captures = captured(truth, noise=0.25, grid=(9, 8))
    assert captures.display is not None
    pixel = captures.display.pixel.copy()
    pixel[::20] += 64.0
    spoilt = Captures(replace(captures.display, pixel=pixel), captures.see_through)
    assert forward_rms(fit_assembly(spoilt, prescription("northstar")).optics, truth) < 0.1


def test_a_display_alone_is_enough() -> None:
    truth = wrong_headset(prescription("birdbath28"), np.random.default_rng(0))
    fitted = fit_assembly(Captures(captured(truth, noise=0.25).display), prescription("birdbath28"))
    assert forward_rms(fitted.optics, truth) < 0.05
    assert fitted.see_through_arcmin is None


@pytest.mark.parametrize(
    ("captured_device", "named", "reason"),
    [("birdbath28", "northstar", "times what is plausible"), ("northstar", "birdbath28", "have no ray through")],
)
def test_the_prescription_of_another_headset_is_refused(captured_device: str, named: str, reason: str) -> None:
    with pytest.raises(BadInputError, match=f"{reason}.*check that it is of this headset and this eye"):
        fit_assembly(captured(prescription(captured_device), count=5, grid=(7, 6)), prescription(named))


def test_the_trends_are_compiled_over_the_boxes_of_the_models() -> None:
    """At the fitted errors they are the optics; at zero they are those continued to first order."""
    truth = wrong_headset(prescription("birdbath28"), np.random.default_rng(0))
    captures = captured(truth, count=4, grid=(7, 6))
    fitted = fit_assembly(captures, prescription("birdbath28"))
    plane = BasePlane(float(truth.eye_box.centre[2]))
    shown, seen = captures.display, captures.see_through
    assert shown is not None
    inputs = np.concatenate([shown.pixel, plane.carry(shown.viewpoint, shown.tangents)], axis=1)
    assert seen is not None
    world = np.concatenate([plane.carry(seen.viewpoint, seen.tangents), seen.tangents], axis=1)
    errors = fitted.values / ASSEMBLY_SIZES
    display = display_trend(fitted, plane, Box.around(inputs)).about(errors, np.eye(12))
    np.testing.assert_allclose(display.mean(inputs), shown.tangents, atol=1e-5)
    see_through = see_through_trend(fitted, plane, Box.around(world)).about(errors, np.eye(12))
    deviation = see_through.mean(world)
    depth = (seen.viewpoint[:, 2] - seen.point[:, 2])[:, None]
    past = world[:, :2] + deviation[:, 2:] + depth * (seen.tangents + deviation[:, :2]) - seen.point[:, :2]
    np.testing.assert_allclose(past / depth, 0.0, atol=1e-5)
    more = display_trend(replace(fitted, values=1.001 * fitted.values), plane, Box.around(inputs))
    step = display.by_parameter(inputs).reshape(len(inputs), 2, 12) @ (1e-3 * errors)
    found = more.about(1.001 * errors, np.eye(12)).mean(inputs) - display.mean(inputs)
    np.testing.assert_allclose(found, step, atol=0.02 * np.abs(step).max())


def test_a_wrong_shape_that_looks_like_large_assembly_errors_is_not_refused() -> None:
    """The prescription's ellipsoid is 0.2 % too long: turning it by degrees about its centre imitates that."""
    drawn = wrong_headset(prescription("northstar"), np.random.default_rng([1, 0]), shape=0.002)
    fitted = fit_assembly(captured(prescription("northstar"), count=25, noise=0.25), drawn)
    assert np.abs(fitted.values / ASSEMBLY_SIZES).max() > IMPLAUSIBLE
    assert fitted.display_arcmin < 0.3
    assert forward_rms(fitted.optics, prescription("northstar")) < 0.5

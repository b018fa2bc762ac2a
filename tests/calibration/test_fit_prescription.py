"""Prescriptions with fitted assembly errors, on captures of headsets that differ from them."""

from dataclasses import replace

import numpy as np
import pytest
from wrong_headset import wrong_headset

from wlr_render.calibration.fit_prescription import compiled_trend, fit_assembly
from wlr_render.captures.correspondences import EyeCaptures
from wlr_render.errors import BadInputError
from wlr_render.geometry.planes import BasePlane
from wlr_render.mappings import EyeMappings
from wlr_render.numerics.polynomial import Box
from wlr_render.optics.assembly import ASSEMBLY_SIZES, assembled
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import TracedDisplay, TracedSeeThrough
from wlr_render.simulation import viewpoints
from wlr_render.simulation.simulate_captures import CaptureSetup, simulate_display, simulate_see_through

DEVICES = ("northstar", "freeform40", "birdbath28")


def prescription(name):
    return load_device(name).eyes["right"]


def mappings(optics):
    return EyeMappings(
        "test", "right", TracedDisplay(optics, 0.55), TracedSeeThrough(optics, 0.55), optics.eye_box, optics.field
    )


def captured(optics, count=9, noise=0.0, stage_error_m=0.0, seed=1):
    setup = CaptureSetup(mappings(optics), noise, stage_error_m, optics.field, (15, 13))
    rng, positions = np.random.default_rng(seed), setup.camera_positions("planar", count)
    return EyeCaptures(simulate_display(setup, positions, rng), simulate_see_through(setup, positions, rng))


def forward_rms(fitted, truth):
    """Rms angle in arcminutes over the nominal field at random viewpoints: the fitted pixel's shift as an angle."""
    rng = np.random.default_rng(2)
    viewpoint = viewpoints.random_in_eye_box(truth.eye_box, 400, rng)
    view_dir = truth.field.directions(20, 20)
    pixel, _ = TracedDisplay(truth, 0.55).plane_pixel(view_dir, viewpoint)
    found, _ = TracedDisplay(fitted, 0.55).plane_pixel(view_dir, viewpoint)
    px_per_arcmin = truth.panel.pixels.size_px / (
        np.rad2deg(np.arctan(truth.field.high) - np.arctan(truth.field.low)) * 60
    )
    return float(np.sqrt(np.mean(np.sum(((found - pixel) / px_per_arcmin) ** 2, axis=1))))


@pytest.mark.parametrize("name", DEVICES)
def test_exact_captures_give_back_the_assembly_errors(name):
    drawn = 0.3 * ASSEMBLY_SIZES * np.random.default_rng(4).normal(size=12)
    fitted = fit_assembly(captured(assembled(prescription(name), drawn)), prescription(name))
    assert forward_rms(fitted.optics, assembled(prescription(name), drawn)) < 2e-3
    sigma = np.sqrt(np.diag(fitted.covariance))
    np.testing.assert_array_less(np.abs(fitted.values - drawn), 5.0 * sigma + 1e-3 * ASSEMBLY_SIZES)


@pytest.mark.parametrize("name", DEVICES)
def test_displaced_parts_are_found_at_a_quarter_arcminute_of_noise(name):
    truth = wrong_headset(prescription(name), np.random.default_rng(0))
    fitted = fit_assembly(captured(truth, count=5, noise=0.25), prescription(name))
    assert forward_rms(prescription(name), truth) > 5.0
    assert forward_rms(fitted.optics, truth) < 0.05
    assert fitted.display_arcmin == pytest.approx(0.25, rel=0.1)
    assert fitted.see_through_arcmin == pytest.approx(0.25, rel=0.1)


@pytest.mark.parametrize("name", DEVICES)
def test_an_error_of_the_shape_stays_in_the_residuals_and_not_in_absurd_values(name):
    truth = wrong_headset(prescription(name), np.random.default_rng(0), shape=0.002)
    fitted = fit_assembly(captured(truth, noise=0.25), prescription(name))
    assert 0.1 < forward_rms(fitted.optics, truth) < 1.0
    assert fitted.display_arcmin > 1.15 * 0.25
    assert np.abs(fitted.values / ASSEMBLY_SIZES).max() < 1.5


def test_stage_jitter_spreads_the_fit_and_does_not_lead_it_astray():
    truth = wrong_headset(prescription("northstar"), np.random.default_rng(0))
    fitted = fit_assembly(captured(truth, count=25, noise=0.25, stage_error_m=30e-6), prescription("northstar"))
    assert forward_rms(fitted.optics, truth) < 0.5
    assert np.abs(fitted.values / ASSEMBLY_SIZES).max() < 1.0


def test_gross_outliers_do_not_move_the_fit():
    truth = wrong_headset(prescription("northstar"), np.random.default_rng(0))
    captures = captured(truth, noise=0.25)
    pixel = captures.display.pixel.copy()
    pixel[::20] += 64.0
    spoilt = EyeCaptures(replace(captures.display, pixel=pixel), captures.see_through)
    assert forward_rms(fit_assembly(spoilt, prescription("northstar")).optics, truth) < 0.1


def test_a_display_alone_is_enough():
    truth = wrong_headset(prescription("birdbath28"), np.random.default_rng(0))
    fitted = fit_assembly(EyeCaptures(captured(truth, noise=0.25).display), prescription("birdbath28"))
    assert forward_rms(fitted.optics, truth) < 0.05
    assert fitted.see_through_arcmin is None


@pytest.mark.parametrize(
    ("captured_device", "named", "reason"),
    [("birdbath28", "northstar", "times what is plausible"), ("northstar", "birdbath28", "have no ray through")],
)
def test_the_prescription_of_another_headset_is_refused(captured_device, named, reason):
    with pytest.raises(BadInputError, match=f"{reason}.*check that it is of this headset and this eye"):
        fit_assembly(captured(prescription(captured_device)), prescription(named))


def test_the_trend_is_compiled_over_the_boxes_of_the_models():
    truth = wrong_headset(prescription("birdbath28"), np.random.default_rng(0))
    captures = captured(truth)
    fitted = fit_assembly(captures, prescription("birdbath28"))
    plane = BasePlane(float(truth.eye_box.centre[2]))
    shown, seen = captures.display, captures.see_through
    inputs = np.concatenate([shown.pixel, plane.carry(shown.viewpoint, shown.tangents)], axis=1)
    world = np.concatenate([plane.carry(seen.viewpoint, seen.tangents), seen.tangents], axis=1)
    trend = compiled_trend(fitted, plane, Box.around(inputs), Box.around(world))
    np.testing.assert_allclose(trend.display.polynomial(inputs), shown.tangents, atol=1e-5)
    deviation = trend.see_through.polynomial(world)
    depth = (seen.viewpoint[:, 2] - seen.point[:, 2])[:, None]
    past = world[:, :2] + deviation[:, 2:] + depth * (seen.tangents + deviation[:, :2]) - seen.point[:, :2]
    np.testing.assert_allclose(past / depth, 0.0, atol=1e-5)
    assert compiled_trend(fitted, plane, Box.around(inputs)).see_through is None

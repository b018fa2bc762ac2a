"""Errors found by refits over errors stated: of a session as the model takes it, and of one with errors it lacks."""

from dataclasses import replace

import numpy as np
import pytest

import wlr_render as wlr
from wlr_render.calibration.fit_eye import Calibration, calibrate
from wlr_render.calibration.validation import BANDS, NOISE, QUARTERS, Ratio, ratios, refits
from wlr_render.captures.correspondences import Captures
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import ARCMIN, dir_of_tangents
from wlr_render.mappings import Eye

ROW = 4  # positions of a row, which a camera visits one after the other


def captures_of(eye: Eye, drift_arcmin: float, positions: int = 16, noise_arcmin: float = 0.25) -> Captures:
    """Captures of a display from a stage that repeats to 5 um; all positions of a row are turned alike."""
    shown = wlr.simulate(eye, positions, noise_arcmin, 2, grid=(5, 4), stage_error_m=5e-6, stage_turn_rad=3e-5).display
    assert shown is not None
    rows = np.random.default_rng(2).normal(0.0, drift_arcmin * ARCMIN, (-(-positions // ROW), 2))
    return Captures(replace(shown, view_dir=dir_of_tangents(shown.tangents + rows[shown.capture // ROW])))


def flat_fit(captures: Captures) -> Calibration:
    """A flat image and a plate are of degree 1 exactly."""
    return calibrate(captures, "planar", 1, 1)


def found(captures: Captures, noise: int) -> dict[str, Ratio]:
    """Ratios by method, of some refits to noise and all of the bands."""
    fit = flat_fit(captures)
    chosen = [each for each in refits(fit) if each.method == BANDS or (each.method == NOISE and each.number < noise)]
    outcomes = [each.outcome(flat_fit(each.captures)) for each in chosen]
    return {each.method: each for each in ratios(fit, outcomes)}


@pytest.mark.slow
def test_the_law_holds_where_the_errors_are_as_stated(flat_image_headset: Eye) -> None:
    of = found(captures_of(flat_image_headset, 0.0), noise=8)
    assert of[NOISE].refits == 8
    assert of[BANDS].refits == 8
    assert of[NOISE].low < 1.0 < of[NOISE].high
    assert of[NOISE].high < 1.5 * of[NOISE].low
    assert of[BANDS].low < 1.0 < of[BANDS].high


@pytest.mark.slow
def test_positions_that_share_errors_show_in_cross_validation_and_not_in_noise(flat_image_headset: Eye) -> None:
    of = found(captures_of(flat_image_headset, 1.5), noise=4)
    assert 0.75 < of[NOISE].value < 1.25
    assert of[BANDS].low > 1.0
    assert of[BANDS].value > 1.5


def test_readings_that_no_refit_can_test_are_refused(flat_image_headset: Eye) -> None:
    with pytest.raises(BadInputError, match="8 camera positions or more, and the fit of the display has 4; add"):
        refits(flat_fit(captures_of(flat_image_headset, 0.0, positions=4)))
    with pytest.raises(BadInputError, match="stated to be exact; leave it out"):
        refits(flat_fit(wlr.simulate(flat_image_headset, 9, noise_arcmin=0.0, grid=(5, 4))))


def test_every_position_is_left_out_once_by_quarters_and_bands(flat_image_headset: Eye) -> None:
    captures = captures_of(flat_image_headset, 0.0, positions=9)
    assert captures.display is not None
    fit = flat_fit(captures)
    for method, times in ((QUARTERS, 3), (BANDS, 2)):
        left = [
            np.setdiff1d(captures.display.capture, each.captures.source.capture)
            for each in refits(fit)
            if each.method == method
        ]
        assert np.array_equal(np.bincount(np.concatenate(left)), np.full(9, times))

"""Captures that were exchanged, or whose camera stood elsewhere, and dots beside their place are told by the others."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from wlr_render.calibration.fit_display import fit_display
from wlr_render.calibration.fit_see_through import fit_see_through
from wlr_render.calibration.photograph_captures import dot_inliers, outliers
from wlr_render.captures.correspondences import AnyCaptures, DisplayCaptures, SeeThroughCaptures, select
from wlr_render.captures.feature_captures import CaptureMotionPrior
from wlr_render.geometry.directions import ARCMIN, normalised
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.simulation import viewpoints
from wlr_render.simulation.capture_setup import CaptureSetup
from wlr_render.simulation.simulate_captures import simulate_display, simulate_see_through

BothCaptures = tuple[DisplayCaptures, SeeThroughCaptures]

one_device = pytest.mark.parametrize("captures", ["northstar"], indirect=True)


@pytest.fixture(scope="module", params=["northstar", "freeform40"])
def captures(request: pytest.FixtureRequest) -> BothCaptures:
    truth = traced_eye(load_device(request.param), "right")
    setup = CaptureSetup(truth, 0.1, grid=(10, 8))
    places = viewpoints.planar(truth.eye_box, setup.field.reach, 25)
    rng = np.random.default_rng(1)
    return simulate_display(setup, places, rng), simulate_see_through(setup, places, rng)


def moved_by(captures: AnyCaptures, rows: slice | BoolArray, shift: FloatArray | Sequence[float]) -> AnyCaptures:
    viewpoint = captures.viewpoint.copy()
    viewpoint[rows] += shift
    return replace(captures, viewpoint=viewpoint)


def photographs(see_through: SeeThroughCaptures) -> IntArray:
    return see_through.target_pose * 100 + see_through.capture


def test_sound_captures_are_left_alone(captures: BothCaptures) -> None:
    display, see_through = captures
    assert outliers(display, display.capture, fit_display) == {}
    assert outliers(see_through, photographs(see_through), fit_see_through) == {}


@one_device
def test_exchanged_sets_of_the_panel_are_both_named(captures: BothCaptures) -> None:
    display, _ = captures
    first, second = display.capture == 3, display.capture == 9
    viewpoint = display.viewpoint.copy()
    viewpoint[first], viewpoint[second] = display.viewpoint[second][0], display.viewpoint[first][0]
    assert set(outliers(replace(display, viewpoint=viewpoint), display.capture, fit_display)) == {3, 9}


@one_device
def test_a_photograph_from_elsewhere_is_named_with_its_size(captures: BothCaptures) -> None:
    _, see_through = captures
    number = photographs(see_through)
    # 2 mm to the right are 17' at 0.4 m, where the first target stands.
    found = outliers(moved_by(see_through, number == 7, [0.002, 0.0, 0.0]), number, fit_see_through)
    assert found == {7: pytest.approx(17, rel=0.3)}


@pytest.mark.parametrize("places", [4, 13, 15])
def test_few_places_raise_no_false_alarm(captures: BothCaptures, places: int) -> None:
    """A model with hardly more places than terms predicts the outermost of them badly."""
    display, _ = captures
    few = select(display, display.capture < places)
    assert outliers(few, few.capture, fit_display) == {}


def test_strong_optics_from_few_places_raise_no_false_alarm() -> None:
    """Sharp photographs show what a smooth model of nine places lacks, which looks like motions of single cameras."""
    truth = traced_eye(load_device("birdbath28"), "right")
    setup = CaptureSetup(truth, 0.005, 7e-6, grid=(16, 12), stage_turn_rad=12e-6)
    places = viewpoints.planar(truth.eye_box, 1.3 * setup.field.reach, 9)
    motion = CaptureMotionPrior(np.arange(9), np.tile(np.repeat([12e-6, 7e-6], 3), (9, 1)), 0.2)
    display = replace(simulate_display(setup, places, np.random.default_rng(0)), motion=motion)
    assert outliers(display, display.capture, fit_display) == {}
    assert fit_display(display).smooth.moved == ()
    # A motion far beyond what the model lacks is found from nine places, too.
    moved = moved_by(display, display.capture == 4, [0.003, 0.0, 0.0])
    assert set(outliers(moved, moved.capture, fit_display)) == {4}


@one_device
def test_where_all_disagree_few_or_none_are_named(captures: BothCaptures) -> None:
    display, _ = captures
    rng = np.random.default_rng(2)
    shift = rng.normal(0, 0.005, (25, 3))[display.capture]
    assert len(outliers(moved_by(display, slice(None), shift), display.capture, fit_display)) <= 5


def four_photographs() -> SeeThroughCaptures:
    truth = traced_eye(load_device("northstar"), "right")
    setup = CaptureSetup(truth, 0.05, grid=(14, 12))
    places = viewpoints.planar(truth.eye_box, setup.field.reach, 4)
    return simulate_see_through(setup, places, np.random.default_rng(1))


def test_dots_that_are_off_are_found_and_no_others() -> None:
    captures = four_photographs()
    photograph = captures.target_pose * 10 + captures.capture
    rng = np.random.default_rng(3)
    off = rng.random(len(captures)) < 0.03
    kick = rng.normal(size=(len(captures), 3))
    kick -= np.sum(kick * captures.view_dir, axis=1, keepdims=True) * captures.view_dir
    kick *= off[:, None] * rng.uniform(2.0, 20.0, (len(captures), 1)) * ARCMIN / np.linalg.norm(kick, axis=1)[:, None]
    spoilt = replace(captures, view_dir=normalised(captures.view_dir + kick))
    assert np.array_equal(dot_inliers(spoilt, photograph), ~off)


def test_dots_that_are_stated_to_be_unsure_are_left_out() -> None:
    captures = four_photographs()
    photograph = captures.target_pose * 10 + captures.capture
    unsure = np.random.default_rng(4).random(len(captures)) < 0.05
    sigma = np.where(unsure, 8.0, 1.0) * captures.sigma_arcmin
    assert np.array_equal(dot_inliers(replace(captures, sigma_arcmin=sigma), photograph), ~unsure)


def test_a_photograph_of_few_dots_is_not_judged() -> None:
    captures = four_photographs()
    photograph = np.arange(len(captures)) // 5
    assert dot_inliers(captures, photograph).all()

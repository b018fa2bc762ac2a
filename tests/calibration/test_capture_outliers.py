"""Captures that were exchanged, or whose camera stood elsewhere, are told by the others; sound ones are left alone."""

from dataclasses import replace

import numpy as np
import pytest

from wlr_render.calibration.capture_outliers import display_outliers, see_through_outliers
from wlr_render.captures.correspondences import select
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.simulation import viewpoints
from wlr_render.simulation.simulate_captures import CaptureSetup, simulate_display, simulate_see_through


@pytest.fixture(scope="module", params=["freeform40", "northstar"])
def captures(request):
    truth = traced_eye(load_device(request.param), "right")
    setup = CaptureSetup(truth, 0.1, grid=(10, 8))
    places = viewpoints.planar(truth.eye_box, setup.field.reach, 25)
    rng = np.random.default_rng(1)
    return simulate_display(setup, places, rng), simulate_see_through(setup, places, rng)


def moved_by(captures, rows, shift):
    viewpoint = captures.viewpoint.copy()
    viewpoint[rows] += shift
    return replace(captures, viewpoint=viewpoint)


def photographs(see_through):
    return see_through.target_pose * 100 + see_through.capture


def test_sound_captures_are_left_alone(captures):
    display, see_through = captures
    assert display_outliers(display) == []
    assert see_through_outliers(see_through, photographs(see_through)) == []


def test_exchanged_sets_of_the_panel_are_both_named(captures):
    display, _ = captures
    first, second = display.capture == 3, display.capture == 9
    viewpoint = display.viewpoint.copy()
    viewpoint[first], viewpoint[second] = display.viewpoint[second][0], display.viewpoint[first][0]
    assert {each.group for each in display_outliers(replace(display, viewpoint=viewpoint))} == {3, 9}


def test_a_photograph_from_elsewhere_is_named_with_its_size(captures):
    _, see_through = captures
    number = photographs(see_through)
    # 2 mm to the right are 17' at 0.4 m, where the first target stands.
    (found,) = see_through_outliers(moved_by(see_through, number == 7, [0.002, 0.0, 0.0]), number)
    assert found.group == 7
    assert found.arcmin == pytest.approx(17, rel=0.3)


@pytest.mark.parametrize("places", [4, 13, 15])
def test_few_places_raise_no_false_alarm(captures, places):
    """A model with hardly more places than terms predicts the outermost of them badly."""
    display, _ = captures
    assert display_outliers(select(display, display.capture < places)) == []


def test_where_all_disagree_few_or_none_are_named(captures):
    display, _ = captures
    rng = np.random.default_rng(2)
    shift = rng.normal(0, 0.005, (25, 3))[display.capture]
    assert len(display_outliers(moved_by(display, slice(None), shift))) <= 5

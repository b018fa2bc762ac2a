"""Each effect changes what it should, leaves alone what it should not, and has the size and sign it states."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from oracle.captures import CAMERA_CENTRE_PX, Plan
from oracle.devices import own_device
from oracle.effects import (
    DISPLAY_ONLY,
    LISTED,
    SEE_THROUGH_ONLY,
    UNLISTED,
    Effect,
    draw_effect,
    draw_late_slip,
    draw_outlier,
    draw_outliers,
)
from oracle.own_tracer import turn
from oracle.session import Session, observe
from oracle.world import World
from wlr_render.errors import BadInputError
from wlr_render.numerics.arrays import FloatArray

QUIET = Plan(grid=(7, 6), dots=(7, 5), off_plane=4, sigma_px=0.0)
FREEFORM = replace(QUIET, device="freeform40")
NO_TURN = {"x_deg": 0.0, "y_deg": 0.0, "z_deg": 0.0}
STILL = {"x_mm": 0.0, "y_mm": 0.0, "z_mm": 0.0}
SEEN_PX = 2e-3  # raising all surfaces of a thin combiner hardly bends what is seen through it

NORTH_STAR = ("substrate_index", "substrate_thickness")
"""Effects that North Star, whose combiner is met from inside, shows in the see-through part alone."""


def see(plan: Plan, *effects: Effect) -> tuple[NDArray[Any], NDArray[Any], Session]:
    """Panel pixels (m, 2) of the display table and camera pixels (m, 2) of the other, and the session."""
    session = observe(plan, effects, np.random.default_rng(5))
    pixel = np.stack([session.display["pixel_u"], session.display["pixel_v"]], axis=-1)
    dots = np.stack([session.seethrough["camera_u"], session.seethrough["camera_v"]], axis=-1)
    return pixel, dots, session


def change(plan: Plan, *effects: Effect) -> tuple[Any, Any, Any]:
    """By how much the effects move what is observed, where both benches observe it, else NaN."""
    pixel, dots, session = see(plan, *effects)
    clean_pixel, clean_dots, _ = see(plan)
    return pixel - clean_pixel, dots - clean_dots, session


def largest(moved: FloatArray) -> float:
    assert np.isfinite(moved).mean() > 0.1
    return float(np.nanmax(np.abs(moved)))


@pytest.mark.parametrize("name", [*LISTED, *UNLISTED])
def test_it_is_seen_where_it_should_be_and_nowhere_else(name: str) -> None:
    plan = replace(QUIET, channels=(0, 1, 2)) if name == "lateral_colour" else QUIET
    display, dots, _ = change(plan, draw_effect(name, np.random.default_rng(3)))
    see_through_only = name in (*SEE_THROUGH_ONLY, *NORTH_STAR)
    assert (largest(display) > SEEN_PX) == (not see_through_only)
    assert (largest(dots) > SEEN_PX) == (name not in DISPLAY_ONLY)
    if name in DISPLAY_ONLY:
        assert largest(dots) == 0.0
    if see_through_only:
        assert largest(display) == 0.0


@pytest.mark.parametrize("name", LISTED)
def test_strength_scales_the_size_and_leaves_the_settings(name: str) -> None:
    weak, strong = (draw_effect(name, np.random.default_rng(4), strength) for strength in (1.0, 3.0))
    assert strong.amount == pytest.approx(weak.scaled(3.0).amount)
    assert strong.amount != weak.amount
    settings = {key for key in weak.amount if key.startswith(("tau", "start", "tilt", "second"))}
    assert all(strong.amount[key] == weak.amount[key] for key in settings)


@pytest.mark.parametrize("name", LISTED)
def test_no_size_is_no_effect(name: str) -> None:
    display, dots, _ = change(replace(QUIET, channels=(0, 1, 2)), draw_effect(name, np.random.default_rng(4), 0.0))
    assert max(largest(display), largest(dots)) < 1e-9


def test_panel_effects_move_pixels_as_they_say() -> None:
    panel = own_device("northstar").panel
    pixel, _, _ = see(QUIET)
    from_middle = pixel - 0.5 * panel.pixels
    shift, _, _ = change(QUIET, Effect("panel_shift", {"x_mm": 0.3, "y_mm": -0.2}))
    assert largest(shift + np.array([0.3, -0.2]) / panel.size_mm * panel.pixels) < 1e-9
    scale, _, _ = change(QUIET, Effect("panel_scale", {"scale_percent": 0.4}))
    assert largest(scale - from_middle * (1.0 / 1.004 - 1.0)) < 1e-9
    turned, _, _ = change(QUIET, Effect("panel_rotation", {"angle_deg": 0.5}))
    mm = from_middle / panel.pixels * panel.size_mm
    there = mm @ turn(np.radians([0.0, 0.0, 0.5]))[:2, :2] / panel.size_mm * panel.pixels
    assert largest(turned - (there - from_middle)) < 1e-9
    origin, _, _ = change(QUIET, Effect("pixel_origin", {"offset_px": -0.5}))
    assert largest(origin + 0.5) < 1e-9


def test_the_panel_creeps_with_time() -> None:
    panel = own_device("northstar").panel
    moved, _, session = change(QUIET, Effect("thermal_drift", {"x_mm": 0.1, "y_mm": 0.0, "tau_s": 1000.0}))
    expected = -0.1 / panel.size_mm[0] * panel.pixels[0] * (1.0 - np.exp(-session.display["time_s"] / 1000.0))
    assert largest(moved[:, 0] - expected) < 1e-9
    assert largest(moved[:, 1]) == 0.0


def test_red_and_blue_part_about_the_middle_and_green_stays() -> None:
    pixel, _, _ = see(replace(QUIET, channels=(0, 1, 2)))
    moved, _, session = change(replace(QUIET, channels=(0, 1, 2)), Effect("lateral_colour", {"scale_percent": 0.2}))
    away = (pixel - 0.5 * own_device("northstar").panel.pixels) * 0.002
    for channel, sign in enumerate((1.0, 0.0, -1.0)):
        rows = session.display["channel"] == channel
        assert largest(moved[rows] - sign * away[rows]) < 1e-9


def test_tilting_the_combiner_turns_the_reflected_ray_by_twice_as_much() -> None:
    world = World(own_device("freeform40"))
    tilted = Effect("combiner_tilt", {**NO_TURN, "x_deg": 0.7}).applied(world).device
    ray = world.device.eye[None], np.array([[0.0, 0.0, 1.0]])
    (place, before), (same_place, after) = (d.trace(d.display, *ray, 0.55) for d in (world.device, tilted))
    np.testing.assert_allclose(same_place, place, atol=1e-9)
    np.testing.assert_allclose(after[0], turn(np.radians([1.4, 0.0, 0.0])) @ before[0], atol=1e-12)


def test_camera_effects_move_dots_as_they_say() -> None:
    _, dots, _ = see(QUIET)
    away = dots - CAMERA_CENTRE_PX
    _, longer, _ = change(QUIET, Effect("camera_focal_length", {"focal_percent": 0.3}))
    assert largest(longer - 0.003 * away) < 1e-9
    _, rolled, _ = change(QUIET, Effect("camera_rotation", {**NO_TURN, "z_deg": 0.2}))
    assert largest(rolled - (away @ turn(np.radians([0.0, 0.0, 0.2]))[:2, :2] - away)) < 1e-9
    _, bent, _ = change(QUIET, Effect("camera_distortion", {"edge_px": 0.6}))
    assert largest(bent - 0.6 * away / 640.0 * np.sum((away / 640.0) ** 2, axis=-1, keepdims=True)) < 1e-9


def test_the_display_sees_through_the_same_lens() -> None:
    # A longer lens shows at its pixels what a normal one shows nearer to the centre.
    pixel, _, session = see(QUIET, Effect("camera_focal_length", {"focal_percent": 3.0}))
    device = own_device("northstar")
    row = np.flatnonzero(np.isfinite(pixel[:, 0]))[0]
    seen = session.display[row]
    tangents = (np.array([seen["camera_u"], seen["camera_v"]]) - CAMERA_CENTRE_PX) / (1.03 * 1350.0)
    direction = np.array([[*tangents, 1.0]]) / np.sqrt(1.0 + tangents @ tangents)
    origin = np.array([[seen["stage_x_mm"], seen["stage_y_mm"], seen["stage_z_mm"]]])
    expected = device.panel.pixel(*device.trace(device.display, origin, direction, 0.55))
    np.testing.assert_allclose(pixel[row], expected[0], atol=1e-9)


def test_targets_and_tracking_move_dots_as_they_say() -> None:
    # To a few percent: the combiner itself bends rays little, and the targets are only slightly tilted.
    _, clean, session = see(FREEFORM)
    far = session.seethrough["target_pose"] == 2
    _, sideways, _ = change(FREEFORM, Effect("tracking_translation", {**STILL, "x_mm": 2.0}))
    assert np.nanmean(sideways[far, 0]) == pytest.approx(1350.0 * 2.0 / 2200.0, rel=0.02)
    _, turned, _ = change(FREEFORM, Effect("tracking_rotation", {**NO_TURN, "y_deg": 0.1}))
    central = np.nanargmin(np.sum((clean - CAMERA_CENTRE_PX) ** 2, axis=-1))
    assert turned[central, 0] == pytest.approx(1350.0 * np.radians(0.1), rel=0.05)
    _, larger, _ = change(FREEFORM, Effect("target_scale", {"scale_percent": 0.4}))
    for pose in range(3):
        rows = session.seethrough["target_pose"] == pose
        middle = np.nanmean(clean[rows], axis=0)
        assert np.nansum(larger[rows] * (clean[rows] - middle)) / np.nansum(
            (clean[rows] - middle) ** 2
        ) == pytest.approx(0.004, rel=0.05)


def test_the_stage_errs_with_position_and_travel() -> None:
    reading = observe(QUIET, [], np.random.default_rng(5)).display
    backlash, _, _ = change(QUIET, Effect("stage_backlash", {"lost_mm": 0.2}))
    assert largest(backlash[reading["travel"] == 1]) == 0.0
    assert np.nanmin(np.abs(backlash[reading["travel"] == -1, 0])) > 0.0
    in_middle = Effect("camera_pupil_offset", {**STILL, "x_mm": -0.2})
    offset, _, _ = change(QUIET, in_middle)
    rows = reading["travel"] == -1
    assert largest(backlash[rows] - offset[rows]) < 1e-9


def test_a_slip_comes_at_its_time() -> None:
    moved, dots, session = change(QUIET, Effect("headset_slip", {**STILL, "x_mm": 0.5, "start_s": 1000.0}))
    late = session.display["time_s"] >= 1000.0
    assert largest(moved[~late]) == 0.0
    assert np.nanmin(np.abs(moved[late, 0])) > 0.0
    assert np.nanmin(np.abs(dots[:, 0])) > 0.0


def test_an_outlier_is_one_capture() -> None:
    found = set()
    for seed in range(12):
        outlier = draw_outlier(QUIET, np.random.default_rng(seed))
        pose, number = int(outlier.amount["target_pose"]), int(outlier.amount["capture"])
        display, dots, session = change(QUIET, outlier)
        hit = {-1: session.display["capture"][np.nan_to_num(np.abs(display[:, 0])) > 0]}
        for k in range(3):
            rows = session.seethrough["target_pose"] == k
            hit[k] = session.seethrough["capture"][rows][np.nan_to_num(np.abs(dots[rows, 0])) > 0]
        assert {k for k, captures in hit.items() if len(captures)} == {pose}
        assert set(hit[pose]) == {number}
        found.add(pose == -1)
    assert found == {True, False}


def test_several_captures_of_the_display_move_each_by_itself() -> None:
    drawn = draw_outliers(QUIET, np.random.default_rng(2), 6)
    display, dots, session = change(QUIET, *drawn)
    moved = {int(capture) for capture in session.display["capture"][np.nan_to_num(np.abs(display[:, 0])) > 0]}
    assert moved == {int(outlier.amount["capture"]) for outlier in drawn}
    assert len(moved) == 6
    assert len({outlier.amount["x_mm"] for outlier in drawn}) == 6
    assert largest(dots) == 0.0
    with pytest.raises(BadInputError, match="Of 40 captures 41"):
        draw_outliers(QUIET, np.random.default_rng(2), 41)


@pytest.mark.parametrize("of_session", [False, True])
def test_a_late_slip_leaves_so_many_captures(of_session: bool) -> None:
    for seed in range(4):
        slip = draw_late_slip(QUIET, np.random.default_rng(seed), 2, of_session)
        display, dots, session = change(QUIET, slip)
        seen = session.seethrough
        early, last = seen["target_pose"] < 2, seen["capture"] >= 14
        if of_session:
            assert largest(display) == 0.0
            assert largest(dots[early | ~last]) == 0.0
            assert np.nanmin(np.abs(dots[~early & last, 0])) > 0.0
        else:
            after = session.display["capture"] >= 38
            assert largest(display[~after]) == 0.0
            assert np.nanmin(np.abs(display[after, 0])) > 0.0
            assert np.nanmin(np.abs(dots[:, 0])) > 0.0


def test_two_effects_compose() -> None:
    panel, target = Effect("panel_scale", {"scale_percent": 0.4}), Effect("target_scale", {"scale_percent": 0.3})
    both = change(QUIET, panel, target)
    np.testing.assert_array_equal(both[0], change(QUIET, panel)[0])
    np.testing.assert_array_equal(both[1], change(QUIET, target)[1])
    twice, _, _ = see(
        QUIET, Effect("panel_shift", {"x_mm": 0.1, "y_mm": 0.0}), Effect("panel_shift", {"x_mm": 0.2, "y_mm": 0.0})
    )
    once, _, _ = see(QUIET, Effect("panel_shift", {"x_mm": 0.3, "y_mm": 0.0}))
    np.testing.assert_allclose(twice, once, atol=1e-9)


def test_sizes_are_typical_and_directions_random() -> None:
    drawn = [draw_effect("camera_rotation", np.random.default_rng(seed)) for seed in range(200)]
    vectors = np.array([list(effect.amount.values()) for effect in drawn])
    sizes = np.linalg.norm(vectors, axis=-1)
    assert 0.02 <= sizes.min() < 0.025
    assert 0.24 < sizes.max() <= 0.3
    assert np.all(np.abs((vectors > 0).mean(axis=0) - 0.5) < 0.12)


def test_an_unknown_effect_is_named() -> None:
    with pytest.raises(BadInputError, match=r"no effect 'combiner_tlt'.*combiner_tilt"):
        draw_effect("combiner_tlt", np.random.default_rng(0))
    with pytest.raises(BadInputError, match="draw_outlier"):
        draw_effect("outlier", np.random.default_rng(0))

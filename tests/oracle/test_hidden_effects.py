"""Each effect changes what it should and leaves alone what it should not.

tests/benchmarks/diagnosis/test_diagnosis_trials.py compares the listed causes with those of the package; the signs of a
panel's and of a camera's effects are here.
"""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from oracle.captures import CAMERA_CENTRE_PX, Plan
from oracle.devices import own_device
from oracle.effects import (
    LISTED,
    UNLISTED,
    Effect,
    draw_effect,
    draw_late_slip,
    draw_outlier,
    draw_outliers,
)
from oracle.own_tracer import turn
from oracle.session import Session, observe
from wlr_render.errors import BadInputError
from wlr_render.numerics.arrays import FloatArray

QUIET = Plan(grid=(7, 6), dots=(7, 5), off_plane=4, sigma_px=0.0)
NO_TURN = {"x_deg": 0.0, "y_deg": 0.0, "z_deg": 0.0}
SEEN_PX = 2e-3  # raising all surfaces of a thin combiner hardly bends what is seen through it

DISPLAY_ONLY = ("code_stripes", "panel_waves", "panel_swings")
SEE_THROUGH_ONLY = ("target_wrinkle", "print_waves", "substrate_wedge")


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


@pytest.mark.parametrize("name", UNLISTED)
def test_an_unlisted_effect_is_seen_where_it_should_be_and_nowhere_else(name: str) -> None:
    display, dots, _ = change(QUIET, draw_effect(name, np.random.default_rng(3)))
    for moved, is_still in ((display, name in SEE_THROUGH_ONLY), (dots, name in DISPLAY_ONLY)):
        assert largest(moved) == 0.0 if is_still else largest(moved) > SEEN_PX


@pytest.mark.parametrize("name", LISTED)
def test_strength_scales_the_size_and_leaves_the_settings(name: str) -> None:
    weak, strong = (draw_effect(name, np.random.default_rng(4), strength) for strength in (1.0, 3.0))
    assert strong.amount == pytest.approx(weak.scaled(3.0).amount)
    assert strong.amount != weak.amount
    settings = {key for key in weak.amount if key.startswith(("tau", "start", "tilt", "second"))}
    assert all(strong.amount[key] == weak.amount[key] for key in settings)


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


def test_camera_effects_move_dots_as_they_say() -> None:
    _, dots, _ = see(QUIET)
    away = dots - CAMERA_CENTRE_PX
    _, longer, _ = change(QUIET, Effect("camera_focal_length", {"focal_percent": 0.3}))
    assert largest(longer - 0.003 * away) < 1e-9
    _, rolled, _ = change(QUIET, Effect("camera_rotation", {**NO_TURN, "z_deg": 0.2}))
    assert largest(rolled - (away @ turn(np.radians([0.0, 0.0, 0.2]))[:2, :2] - away)) < 1e-9
    _, bent, _ = change(QUIET, Effect("camera_distortion", {"edge_px": 0.6}))
    assert largest(bent - 0.6 * away / 640.0 * np.sum((away / 640.0) ** 2, axis=-1, keepdims=True)) < 1e-9


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

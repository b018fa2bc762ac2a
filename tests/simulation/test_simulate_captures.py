from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from present import present

from wlr_render.errors import BadInputError
from wlr_render.geometry import directions
from wlr_render.geometry.transforms import rotations_of_vectors
from wlr_render.mappings import Eye, FieldOfView, Panel, QueryResult
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.simulation import viewpoints
from wlr_render.simulation.capture_setup import CaptureSetup
from wlr_render.simulation.simulate_captures import simulate, simulate_display, simulate_see_through


@pytest.fixture
def setup(flat_image_headset: Eye) -> CaptureSetup:
    return CaptureSetup(flat_image_headset)


def planar(setup: CaptureSetup, count: int = 9) -> FloatArray:
    return viewpoints.planar(setup.truth.eye_box, setup.field.reach, count)


def rng() -> np.random.Generator:
    return np.random.default_rng(11)


def test_the_camera_stands_as_the_sampling_says(flat_image_headset: Eye) -> None:
    """A plane, the eye box and its centre; another word is refused, not taken for one of them."""
    depths = {
        sampling: np.unique(
            present(simulate(flat_image_headset, 4, sampling=sampling, grid=(3, 3)).display).viewpoint, axis=0
        )
        for sampling in ("planar", "volumetric", "static")
    }
    assert [len(each) for each in depths.values()] == [4, 4, 1]
    assert [np.ptp(each[:, 2]) > 0 for each in depths.values()] == [False, True, False]
    with pytest.raises(BadInputError, match="sampling is 'plannar'; choose from planar, volumetric, static"):
        simulate(flat_image_headset, 4, sampling="plannar")  # type: ignore[arg-type]  # a wrong word is refused


def test_field_bounds_every_pixel_from_everywhere_in_the_eye_box(setup: CaptureSetup) -> None:
    panel = setup.truth.display.panel
    viewpoint = viewpoints.random_in_eye_box(setup.truth.eye_box, 50, rng())
    seen = setup.truth.display.view_dir_of_pixel(panel.pixel_centres()[:, :, None], viewpoint)
    assert setup.field.contains(seen.value).all()
    # 1.4 m of picture 2.01 m away, seen from 6 mm off its axis at most.
    np.testing.assert_allclose(setup.field.reach, [0.706 / 2.007, 0.506 / 2.007], rtol=1e-3)


def test_exact_display_captures_are_the_truth(setup: CaptureSetup) -> None:
    at = planar(setup)
    captures = simulate_display(setup, at, rng())
    assert len(captures) == 9 * 525
    np.testing.assert_array_equal(captures.viewpoint, at[captures.capture])
    again = setup.truth.display.pixel_of_view_dir(captures.view_dir, captures.viewpoint)
    np.testing.assert_allclose(again.value, captures.pixel, atol=1e-9)
    assert not captures.sigma_arcmin.any()


def test_a_camera_with_a_small_field_decodes_its_own_pixels(setup: CaptureSetup) -> None:
    small = replace(setup, camera_field=FieldOfView(np.array([-0.1, -0.05]), np.array([0.2, 0.05])), grid=(4, 3))
    captures = simulate_display(small, planar(setup), rng())
    assert len(captures) == 9 * 12
    tangents = directions.tangents_of_dir(captures.view_dir)
    np.testing.assert_allclose(np.unique(tangents[:, 0].round(9)), [-0.1, 0.0, 0.1, 0.2], atol=1e-9)
    again = setup.truth.display.view_dir_of_pixel(captures.pixel, captures.viewpoint)
    np.testing.assert_allclose(again.value, captures.view_dir, atol=1e-12)
    world = simulate_see_through(small, planar(setup), rng())
    assert small.field.contains(world.view_dir).all()


def test_exact_see_through_captures_are_the_truth_and_cover_the_field(setup: CaptureSetup) -> None:
    captures = simulate_see_through(setup, planar(setup), rng())
    again = setup.truth.see_through.view_dir_of_real_point(captures.point, captures.viewpoint)
    np.testing.assert_allclose(again.value, captures.view_dir, atol=1e-12)
    centre_z = setup.truth.eye_box.centre[2]
    np.testing.assert_allclose(centre_z - captures.point[:, 2], np.take([0.4, 3.0], captures.target_pose))
    assert setup.field.contains(captures.view_dir).all()
    for pose in (0, 1):
        for position in range(9):
            rows = (captures.target_pose == pose) & (captures.capture == position)
            span = np.ptp(directions.tangents_of_dir(captures.view_dir[rows]), axis=0)
            assert np.all(span > 0.85 * (setup.field.high - setup.field.low))


@pytest.mark.parametrize("errors", [{}, {"stage_error_m": 5e-5, "stage_turn_rad": 1e-4}])
def test_forward_see_through_captures_satisfy_the_backward_solve(
    setup: CaptureSetup, errors: Mapping[str, Any]
) -> None:
    truth = traced_eye(load_device("freeform40"))
    bent = replace(setup, truth=truth, camera_field=truth.field, grid=(7, 5), **errors)
    at = planar(bent, 5)
    forward = simulate_see_through(replace(bent, see_through_rays="forward"), at, rng())
    assert len(forward) == 2 * 5 * 35
    np.testing.assert_array_equal(forward.viewpoint, at[forward.capture])
    # The same random numbers as in simulate_see_through: shifts, then turns, for each target.
    draw, solve = rng(), bent.truth.see_through.view_dir_of_real_point
    for pose, depth in enumerate(bent.target_depths_m):
        shift, turn = draw.normal(0.0, bent.stage_error_m, at.shape), np.zeros_like(at)
        if bent.stage_turn_rad:
            turn = draw.normal(0.0, bent.stage_turn_rad, at.shape)
        rows = forward.target_pose == pose
        point, capture = forward.point[rows], forward.capture[rows]
        np.testing.assert_allclose(bent.truth.eye_box.centre[2] - point[:, 2], depth)
        true = solve(point, (at + shift)[capture]).value
        measured = np.einsum("nij,ni->nj", rotations_of_vectors(turn)[capture], true)
        np.testing.assert_allclose(measured, forward.view_dir[rows], atol=1e-12)


def test_forward_see_through_captures_leave_out_points_within_the_optics(setup: CaptureSetup) -> None:
    # World rays of freeform40 leave its last surface 32 to 49 mm in front of the eye box.
    truth = traced_eye(load_device("freeform40"))
    near = replace(
        setup, truth=truth, camera_field=truth.field, target_depths_m=(0.041, 0.4), see_through_rays="forward"
    )
    captures = simulate_see_through(near, planar(near), rng())
    rows = captures.target_pose == 0
    assert 0.1 * 9 * 525 < np.sum(rows) < 0.9 * 9 * 525
    assert np.sum(~rows) == 9 * 525
    assert truth.see_through.view_dir_of_real_point(captures.point, captures.viewpoint).ok.all()


def test_camera_noise_is_isotropic_and_of_the_stated_size(setup: CaptureSetup) -> None:
    noisy = simulate_display(replace(setup, camera_noise_arcmin=2.0), planar(setup, 20), rng())
    exact = simulate_display(setup, planar(setup, 20), rng())
    error = (noisy.view_dir - exact.view_dir) / directions.ARCMIN
    right = directions.normalised(np.cross(exact.view_dir, [0.0, 1.0, 0.0]))
    up = np.cross(right, exact.view_dir)
    across = np.stack([np.sum(error * axis, axis=-1) for axis in (right, up)])
    np.testing.assert_allclose(across.std(axis=1), 2.0, rtol=0.03)
    assert abs(np.corrcoef(across)[0, 1]) < 0.03
    np.testing.assert_array_equal(noisy.sigma_arcmin, 2.0)


def test_see_through_noise_has_the_stated_size(setup: CaptureSetup) -> None:
    noisy = simulate_see_through(replace(setup, camera_noise_arcmin=1.0), planar(setup), rng())
    exact = simulate_see_through(setup, planar(setup), rng())
    angle = directions.arcmin_between(noisy.view_dir, exact.view_dir)
    np.testing.assert_allclose(np.sqrt(np.mean(angle**2)), np.sqrt(2.0), rtol=0.03)


def test_stage_error_moves_the_camera_and_not_the_report(setup: CaptureSetup) -> None:
    at = planar(setup, 400)
    captures = simulate_display(replace(setup, stage_error_m=5e-5, grid=(2, 2)), at, rng())
    np.testing.assert_array_equal(captures.viewpoint, at[captures.capture])
    # Follow each measured ray back from the true picture point: it passes by the reported position at the stage error.
    picture = (captures.pixel / [140, 100] - 0.5) * [1.4, -1.0]
    depth = captures.viewpoint[:, 2] + 2.0
    miss = picture - depth[:, None] * directions.tangents_of_dir(captures.view_dir) - captures.viewpoint[:, :2]
    expected = 5e-5 * np.sqrt(1.0 + np.mean(directions.tangents_of_dir(captures.view_dir) ** 2, axis=0))
    np.testing.assert_allclose(miss.std(axis=0), expected, rtol=0.1)
    same_position = miss[captures.capture == 0]
    assert np.ptp(same_position[:, 0]) < 1e-4


def test_stage_turn_rotates_all_directions_of_a_visit_alike_and_each_visit_on_its_own(setup: CaptureSetup) -> None:
    turned = replace(setup, stage_turn_rad=1e-4)
    at = planar(setup, 100)
    captures = simulate_display(turned, at, rng())
    exact = setup.truth.display.view_dir_of_pixel(captures.pixel, captures.viewpoint).value
    turns = [_turn(exact[captures.capture == k], captures.view_dir[captures.capture == k]) for k in range(100)]
    np.testing.assert_allclose(np.std(turns, axis=0), 1e-4, rtol=0.2)
    world = simulate_see_through(turned, at, rng())
    exact = setup.truth.see_through.view_dir_of_real_point(world.point, world.viewpoint).value
    visits = [(world.capture == k) & (world.target_pose == pose) for pose in (0, 1) for k in range(100)]
    of_visits = np.array([_turn(exact[rows], world.view_dir[rows]) for rows in visits])
    np.testing.assert_allclose(of_visits.std(axis=0), 1e-4, rtol=0.2)
    assert np.abs(np.corrcoef(of_visits[:100].ravel(), of_visits[100:].ravel())[0, 1]) < 0.2


def test_a_turned_camera_with_a_small_field_decodes_what_it_looks_at(setup: CaptureSetup) -> None:
    small = FieldOfView(np.array([-0.1, -0.05]), np.array([0.2, 0.05]))
    turned = replace(setup, camera_field=small, grid=(4, 3), stage_turn_rad=1e-3)
    captures = simulate_display(turned, planar(setup), rng())
    exact = setup.truth.display.view_dir_of_pixel(captures.pixel, captures.viewpoint).value
    turn = _turn(exact[captures.capture == 0], captures.view_dir[captures.capture == 0])
    assert np.linalg.norm(turn) > 3e-4


def _turn(exact: FloatArray, measured: FloatArray) -> FloatArray:
    """The small rotation from measured to exact directions; all of them agree on it."""
    lever = np.stack([np.cross(axis, measured) for axis in np.eye(3)], axis=-1).reshape(-1, 3)
    turn, squares, *_ = np.linalg.lstsq(lever, (exact - measured).ravel(), rcond=None)
    assert squares < 1e-10 * len(exact)
    return np.asarray(turn)


def test_captures_of_a_stage_with_errors_never_state_that_they_are_exact(setup: CaptureSetup) -> None:
    error_m, turn_rad = replace(setup, stage_error_m=1e-5), replace(setup, stage_turn_rad=1e-5)
    for with_errors, sigma in ((setup, 0.0), (error_m, 1e-3), (turn_rad, 1e-3)):
        for captures in (take(with_errors, planar(setup), rng()) for take in (simulate_display, simulate_see_through)):
            np.testing.assert_array_equal(captures.sigma_arcmin, sigma)


def test_same_seed_gives_the_same_captures(setup: CaptureSetup) -> None:
    noisy = replace(setup, camera_noise_arcmin=1.0, stage_error_m=1e-4)
    first, second = (simulate_display(noisy, planar(setup), rng()) for _ in range(2))
    np.testing.assert_array_equal(first.view_dir, second.view_dir)


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ({"camera_noise_arcmin": -1.0}, "camera_noise_arcmin"),
        ({"stage_error_m": float("nan")}, "stage_error_m"),
        ({"stage_turn_rad": -1e-6}, "stage_turn_rad"),
        ({"grid": (0, 3)}, "at least one column"),
        ({"target_depths_m": (1.0, 1.0)}, "give no ray"),
        ({"target_depths_m": (-1.0, 1.0)}, "give no ray"),
        ({"see_through_rays": "sideways"}, "'see_through_rays' is 'sideways'"),
    ],
)
def test_impossible_benches_are_refused(flat_image_headset: Eye, fault: dict[str, Any], words: str) -> None:
    with pytest.raises(BadInputError, match=words):
        CaptureSetup(flat_image_headset, **fault)


def test_a_panel_that_nobody_sees_is_said(flat_image_headset: Eye) -> None:
    class Dark:
        panel = Panel(10, 10)

        def view_dir_of_pixel(self, pixel: FloatArray, viewpoint: FloatArray, warm_start: object = None) -> QueryResult:
            seen = flat_image_headset.display.view_dir_of_pixel(pixel, viewpoint)
            return replace(seen, value=seen.value * np.nan, status=np.full_like(seen.status, 3))

        def pixel_of_view_dir(
            self, view_dir: FloatArray, viewpoint: FloatArray, warm_start: object = None
        ) -> QueryResult:
            return flat_image_headset.display.pixel_of_view_dir(view_dir, viewpoint)

    truth = Eye("dark", "right", Dark(), flat_image_headset.see_through, flat_image_headset.eye_box)
    with pytest.raises(BadInputError, match="no panel pixel of dark is seen"):
        _ = CaptureSetup(truth).field

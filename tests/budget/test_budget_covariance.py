"""Laws of the error budget: sums, symmetry, scaling; trackers against exact displacements and Monte Carlo."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from present import narrowed

from wlr_render.budget.error_sizes import Drawing, ErrorSizes, EyeTracker, HeadTracker, Truncation
from wlr_render.budget.registration_budget import TRACKING_CAMERA, disparity_covariance, registration_covariance
from wlr_render.calibration.bench.common_errors import SOURCES
from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.geometry.directions import ARCMIN
from wlr_render.mappings import Eye
from wlr_render.models.display_model import DisplayModel
from wlr_render.models.registration import right_and_up
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.tracking.eye_model import RotatingEye

DEPTH_M = 1.2
EYE_SIZES = EyeTracker(noise_m=(1e-5, 2e-5, 3e-5))
HEAD_SIZES = HeadTracker(rotation_rad=(1e-5, 2e-5, 3e-5), position_m=(4e-5, 2e-5, 1e-5))
ALL_SIZES = ErrorSizes(
    EyeTracker(3e-5, 1e-4, 0.02, (0.002, 0.002, 0.0)),
    HeadTracker(2e-4, 4e-4, 0.003, 0.2, 0.1),
    Drawing(0.02, 0.004, True, True),
    Truncation(0.05, 0.02),
)


@pytest.fixture(scope="module")
def northstar() -> Eye:
    return traced_eye(load_device("northstar"), "right")


def pixels_and_viewpoints(eye: Eye, shape: tuple[int, ...] = (4, 3)) -> tuple[FloatArray, FloatArray]:
    """Pixels near the middle of the panel, and viewpoints in the inner half of the eye box."""
    rng = np.random.default_rng(5)
    pixel = rng.uniform(0.35, 0.65, (*shape, 2)) * eye.display.panel.size_px
    return pixel, eye.eye_box.at(rng.uniform(-0.5, 0.5, (*shape, 3)))


def registration_error(
    eye: Eye, viewpoint: FloatArray, point: FloatArray, used_viewpoint: FloatArray, used_point: FloatArray
) -> FloatArray:
    """Error (..., 2) in arcmin of a pixel that was chosen for another viewpoint and point than the true ones."""
    aimed = eye.see_through.view_dir_of_real_point(used_point, used_viewpoint).value
    pixel = eye.display.pixel_of_view_dir(aimed, used_viewpoint).value
    shown = eye.display.view_dir_of_pixel(pixel, viewpoint).value
    seen = eye.see_through.view_dir_of_real_point(point, viewpoint).value
    return np.asarray(np.einsum("...ij,...j->...i", right_and_up(seen), shown - seen) / ARCMIN)


def outer_sum(errors: Sequence[FloatArray]) -> FloatArray:
    return np.asarray(np.sum([each[..., :, None] * each[..., None, :] for each in errors], axis=0))


def test_total_is_the_sum_of_symmetric_positive_sources(northstar: Eye) -> None:
    found = registration_covariance(northstar, *pixels_and_viewpoints(northstar), DEPTH_M, ALL_SIZES)
    np.testing.assert_allclose(found.total, sum(found.by_source.values()))
    assert found.total.shape == (4, 3, 2, 2)
    for each in found.by_source.values():
        np.testing.assert_allclose(each, np.swapaxes(each, -1, -2), atol=1e-12)
        assert np.linalg.eigvalsh(each).min() >= -1e-9
    nonzero = {name for name, each in found.by_source.items() if np.all(np.trace(each, axis1=-2, axis2=-1) > 0)}
    assert nonzero == set(found.by_source)


@pytest.mark.parametrize(
    ("halved", "name"),
    [
        (replace(ALL_SIZES, eye=replace(ALL_SIZES.eye, noise_m=1.5e-5)), "eye tracker: noise"),
        (replace(ALL_SIZES, eye=replace(ALL_SIZES.eye, bias_m=5e-5)), "eye tracker: bias"),
        (replace(ALL_SIZES, eye=replace(ALL_SIZES.eye, latency_s=0.01)), "eye tracker: latency"),
        (replace(ALL_SIZES, head=replace(ALL_SIZES.head, rotation_rad=1e-4, position_m=2e-4)), "head tracker: noise"),
        (replace(ALL_SIZES, head=replace(ALL_SIZES.head, latency_s=0.0015)), "head tracker: latency"),
        (replace(ALL_SIZES, truncation=Truncation(0.025, 0.01)), "model: truncation"),
        (replace(ALL_SIZES, drawing=Drawing(0.01, 0.002, True, True)), "drawing: raster and warp grid"),
    ],
)
def test_half_a_sigma_is_a_quarter_of_its_variance_and_nothing_else(
    flat_image_headset: Eye, halved: ErrorSizes, name: str
) -> None:
    at = (*pixels_and_viewpoints(flat_image_headset), DEPTH_M)
    whole = registration_covariance(flat_image_headset, *at, ALL_SIZES).by_source
    half = registration_covariance(flat_image_headset, *at, halved).by_source
    for source, each in whole.items():
        np.testing.assert_allclose(half[source], each / (4.0 if source == name else 1.0), rtol=1e-12)


def test_eye_tracker_follows_exact_displacements(northstar: Eye) -> None:
    pixel, viewpoint = pixels_and_viewpoints(northstar)
    found = registration_covariance(northstar, pixel, viewpoint, DEPTH_M, ErrorSizes(eye=EYE_SIZES))
    errors = [
        registration_error(northstar, viewpoint, found.point, viewpoint + offset, found.point)
        for offset in np.diag(EYE_SIZES.noise_m)
    ]
    expected = outer_sum(errors)
    np.testing.assert_allclose(found.total, expected, atol=2e-3 * expected.max())


def test_eye_tracker_agrees_with_a_monte_carlo_of_the_mappings(flat_image_headset: Eye) -> None:
    pixel, viewpoint = pixels_and_viewpoints(flat_image_headset, (2,))
    sizes = ErrorSizes(eye=EyeTracker(bias_m=(2e-4, 1e-4, 3e-4)))
    found = registration_covariance(flat_image_headset, pixel, viewpoint, DEPTH_M, sizes)
    offset = np.random.default_rng(1).normal(0.0, sizes.eye.bias_m, (20_000, 1, 3))
    error = registration_error(flat_image_headset, viewpoint, found.point, viewpoint + offset, found.point)
    for row in range(2):
        np.testing.assert_allclose(np.cov(error[:, row].T), found.total[row], atol=0.03 * found.total[row].max())


def test_head_tracker_follows_exact_transforms(northstar: Eye) -> None:
    pixel, viewpoint = pixels_and_viewpoints(northstar)
    found = registration_covariance(northstar, pixel, viewpoint, DEPTH_M, ErrorSizes(head=HEAD_SIZES))
    turns, shifts = np.diag(HEAD_SIZES.rotation_rad), np.diag(HEAD_SIZES.position_m)
    moves = [transforms.rigid(transforms.rotations_of_vectors(turn), np.zeros(3)) for turn in turns]
    moves += [transforms.rigid(np.eye(3), shift) for shift in shifts]
    errors = [
        registration_error(northstar, viewpoint, found.point, viewpoint, transforms.apply(move, found.point))
        for move in moves
    ]
    expected = outer_sum(errors)
    np.testing.assert_allclose(found.total, expected, atol=2e-3 * expected.max())


def test_latency_is_motion_during_it(flat_image_headset: Eye) -> None:
    at = (*pixels_and_viewpoints(flat_image_headset), DEPTH_M)
    late = HeadTracker(latency_s=0.004, angular_speed_rad_s=0.5, speed_m_s=0.25)
    still = HeadTracker(rotation_rad=0.002, position_m=0.001)
    of_latency, of_noise = (
        registration_covariance(flat_image_headset, *at, ErrorSizes(head=head)).total for head in (late, still)
    )
    np.testing.assert_allclose(of_latency, of_noise)


def test_whole_pixels_are_a_twelfth_of_a_square_pixel(flat_image_headset: Eye) -> None:
    """In the middle of a picture 2 m away, 1.4 m wide on 140 pixels, a pixel is 0.01 m."""
    eye = flat_image_headset
    centre = np.array([0.0, 0.0, 0.0])
    sizes = ErrorSizes(drawing=Drawing(is_rounded=True))
    found = registration_covariance(eye, eye.display.panel.size_px / 2, centre, DEPTH_M, sizes)
    pitch = 0.01 / 2.0 / ARCMIN
    np.testing.assert_allclose(found.total, pitch**2 / 12.0 * np.eye(2), rtol=1e-4)


def test_one_viewpoint_misses_the_pupil_that_the_cornea_shows_to_each_direction(northstar: Eye) -> None:
    pixel, viewpoint = pixels_and_viewpoints(northstar)
    sizes = ErrorSizes(drawing=Drawing(has_one_viewpoint=True))
    found = registration_covariance(northstar, pixel, viewpoint, DEPTH_M, sizes)
    eye = RotatingEye(viewpoint + [0.0, 0.0, 0.0105], 0.0105)
    for_pixel = eye.viewpoint_of_gaze(np.array([0.0, 0.0, -1.0]), found.view_dir)
    expected = outer_sum([registration_error(northstar, for_pixel, found.point, viewpoint, found.point)])
    np.testing.assert_allclose(found.total, expected, atol=1e-2 * expected.max())
    assert expected.max() > 1e-6


def test_an_exact_device_has_no_error_of_its_own(northstar: Eye) -> None:
    found = registration_covariance(northstar, *pixels_and_viewpoints(northstar), DEPTH_M, ErrorSizes())
    assert np.all(found.total == 0.0)


def test_what_the_eye_does_not_see_has_no_covariance(northstar: Eye) -> None:
    pixel = np.array([[-400.0, 100.0], [700.0, 800.0]])
    found = registration_covariance(northstar, pixel, northstar.eye_box.centre, DEPTH_M, ALL_SIZES)
    assert not np.isfinite(found.total[0]).any() or not found.is_inside[0]
    assert np.isfinite(found.total[1]).all()
    assert found.is_inside[1]


def test_models_state_their_own_errors(small_panel_model: Eye) -> None:
    at = (*pixels_and_viewpoints(small_panel_model), DEPTH_M)
    found = registration_covariance(small_panel_model, *at, ErrorSizes())
    assert np.all(np.linalg.eigvalsh(found.by_source["model: noise and stage"]) > 0)
    bare = replace(small_panel_model, display=replace(narrowed(small_panel_model.display, DisplayModel), spread=None))
    with pytest.raises(BadInputError, match=r"has no covariance.*calibrate again"):
        registration_covariance(bare, *at, ErrorSizes())


def test_the_tracking_camera_does_not_count_in_its_own_frame(flat_image_headset: Eye) -> None:
    at = (*pixels_and_viewpoints(flat_image_headset), DEPTH_M)
    found = registration_covariance(flat_image_headset, *at, ALL_SIZES)
    with_camera = replace(found, by_source=found.by_source | {TRACKING_CAMERA: np.eye(2) + np.zeros((4, 3, 2, 2))})
    np.testing.assert_allclose(with_camera.total, found.total + np.eye(2))
    np.testing.assert_allclose(with_camera.in_camera_frame().total, found.total)
    assert TRACKING_CAMERA.removeprefix("model: ") in SOURCES  # as calibrations name it


def test_disparity_of_two_equal_eyes_has_only_what_is_independent(flat_image_headset: Eye) -> None:
    """One eye twice: what moves the head or both eyes cancels, noise counts twice, and truncation once of each eye."""
    eye, untruncated = flat_image_headset, replace(ALL_SIZES, truncation=Truncation())
    pixel, viewpoint = pixels_and_viewpoints(eye)
    alone = registration_covariance(eye, pixel, viewpoint, DEPTH_M, ALL_SIZES)
    both = disparity_covariance((eye, eye), alone.point, (viewpoint, viewpoint), (ALL_SIZES, untruncated))
    assert set(both) == set(alone.by_source)
    for name, each in both.items():
        is_common = name.startswith("head tracker") or name == "eye tracker: latency"
        times = 0.0 if is_common else 1.0 if name == "model: truncation" else 2.0
        np.testing.assert_allclose(each, times * alone.by_source[name], atol=1e-6)


def test_errors_of_the_head_move_far_points_alike_in_both_eyes(flat_image_headset: Eye) -> None:
    eye, apart = flat_image_headset, np.array([0.064, 0.0, 0.0])
    pixel, viewpoint = pixels_and_viewpoints(eye)
    sizes = ErrorSizes(head=HeadTracker(rotation_rad=1e-3, position_m=1e-3))
    sizes_of = {}
    for depth_m in (0.4, 90.0):
        alone = registration_covariance(eye, pixel, viewpoint, depth_m, sizes)
        viewpoints = (viewpoint - apart / 2, viewpoint + apart / 2)
        both = disparity_covariance((eye, eye), alone.point, viewpoints, (sizes, sizes))
        sizes_of[depth_m] = np.nanmax(np.abs(both["head tracker: noise"])) / alone.total.max()
    assert sizes_of[90.0] < 1e-3 < sizes_of[0.4]


def test_negative_sizes_are_refused() -> None:
    with pytest.raises(BadInputError, match="noise_m of EyeTracker is -1e-05"):
        EyeTracker(noise_m=-1e-5)


def held_out(found: Iterable[float], expected: Iterable[float]) -> dict[str, list[dict[str, float]]]:
    rows = [{"rms_arcmin": f, "expected_arcmin": e, "captures": 5} for f, e in zip(found, expected, strict=True)]
    return {"held_out": rows}


def test_truncation_is_the_excess_of_left_out_rows() -> None:
    expected = [0.3, 0.3, 0.4, 0.3, 0.5, 0.3]
    as_expected = held_out([0.31, 0.28, 0.42, 0.29, 0.49, 0.31], expected)
    too_large = held_out(np.hypot(expected, 0.2), expected)
    found = Truncation.from_report({"display": too_large, "see_through": as_expected})
    assert found.display_arcmin == pytest.approx(0.2 / np.sqrt(2.0))
    assert found.see_through_arcmin == 0.0
    assert Truncation.from_report({"display": {"held_out": [{"rms": 3}]}}) == Truncation()

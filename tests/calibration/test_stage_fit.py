import numpy as np
import pytest
from synthetic_station import EYEBALL, NOISE_PX, STAGE_AXES, board_view, lens_views, stage_grid, turned

from wlr_render.calibration.board_poses import BoardPoses, poses_of
from wlr_render.calibration.camera_calibration import calibrate_camera
from wlr_render.calibration.poses import motion_between, small_motion
from wlr_render.calibration.stage_fit import fit_stage
from wlr_render.calibration.stage_problem import Jitter
from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms

TARGETS = {4: transforms.rigid(turned(4, -6, 1), [0.01, -0.005, 0.5]), 7: transforms.rigid(np.eye(3), [0.0, 0.02, 0.8])}
GRID = stage_grid(steps=4)
MIDDLE = 0.5 * (GRID.min(axis=0) + GRID.max(axis=0))


def camera_from_target(reading, target=4, axes=STAGE_AXES):
    return transforms.rigid(np.eye(3), -(reading - MIDDLE) @ axes.T) @ TARGETS[target]


def exact(readings, targets, motions=None):
    """Poses with a little claimed noise and none made."""
    seen = np.array([camera_from_target(r, k) for r, k in zip(readings, targets, strict=True)])
    if motions is not None:
        seen = small_motion(motions) @ seen
    sigma = np.tile([1e-5] * 6, len(seen))
    names = tuple(f"bare/{i:02d}.png" for i in range(len(seen)))
    return BoardPoses(EYEBALL, names, seen, np.diag(sigma**2), np.full(len(seen), NOISE_PX))


def photographed(rng):
    return [board_view(f"bare/{i:02d}.png", EYEBALL, camera_from_target(r), rng, 6) for i, r in enumerate(GRID)]


def error_in_sigmas(stage):
    error = np.concatenate(
        [(stage.axes - STAGE_AXES[:, :2]).T.ravel(), motion_between(TARGETS[4], stage.camera_from_target[4])]
    )
    return float(error @ np.linalg.solve(stage.covariance, error)) / len(error)


def test_without_noise_the_stage_is_exact_with_three_axes_and_two_targets():
    readings = MIDDLE + 0.01 * np.random.default_rng(1).uniform(-1, 1, size=(14, 3))
    targets = [4] * 9 + [7] * 5
    stage = fit_stage(exact(readings, targets), targets, readings)
    np.testing.assert_allclose(stage.axes, STAGE_AXES, atol=1e-10)
    shifted = (stage.reference - MIDDLE) @ STAGE_AXES.T
    for target, pose in TARGETS.items():
        expected = transforms.rigid(np.eye(3), -shifted) @ pose
        np.testing.assert_allclose(stage.camera_from_target[target], expected, atol=1e-10)
    assert stage.jitter == Jitter()
    assert stage.rejected == {}
    np.testing.assert_allclose(stage.residual, 0.0, atol=1e-9)


@pytest.mark.parametrize("shape", [(), (1,), (3, 1, 2)])
def test_displacement_takes_any_shape(shape):
    stage = fit_stage(exact(GRID, [4] * len(GRID)), [4] * len(GRID), GRID)
    travel = np.random.default_rng(2).uniform(-0.01, 0.01, size=(*shape, 3)) * [1, 1, 0]
    np.testing.assert_allclose(stage.displacement(MIDDLE + travel), travel @ STAGE_AXES.T, atol=1e-9)


def test_the_stage_scatters_as_it_says_with_a_known_lens():
    scaled = []
    for seed in range(25):
        seen = poses_of(EYEBALL, photographed(np.random.default_rng(seed)))
        scaled.append(error_in_sigmas(fit_stage(seen, [4] * len(GRID), GRID)))
    assert 0.85 < np.sqrt(np.mean(scaled)) < 1.15


def test_the_stage_scatters_as_it_says_with_a_lens_from_the_same_photographs():
    scaled = []
    for seed in range(25):
        rng = np.random.default_rng(seed)
        bare = photographed(rng)
        found = calibrate_camera([*lens_views(rng, every=6), *bare], EYEBALL.size_px).poses
        stage = fit_stage(found.only([view.name for view in bare]), [4] * len(GRID), GRID)
        scaled.append(error_in_sigmas(stage))
    assert 0.8 < np.sqrt(np.mean(scaled)) < 1.2


def test_a_stage_that_strays_says_by_how_much():
    rng = np.random.default_rng(3)
    motions = rng.normal(size=(16, 6)) * [1e-5, 1e-5, 1e-5, 2e-4, 2e-4, 2e-4]
    stage = fit_stage(exact(GRID, [4] * 16, motions), [4] * 16, GRID)
    assert stage.jitter.translation_m == pytest.approx(2e-4, rel=0.3)
    assert 0.5 < np.sqrt(error_in_sigmas(stage)) < 1.5


def test_a_stage_that_rotates_says_by_how_much_and_does_not_seem_to_stray():
    rng = np.random.default_rng(3)
    motions = rng.normal(size=(16, 6)) * [1e-4, 1e-4, 1e-4, 1e-5, 1e-5, 1e-5]
    stage = fit_stage(exact(GRID, [4] * 16, motions), [4] * 16, GRID)
    assert stage.jitter.rotation_rad == pytest.approx(1e-4, rel=0.3)
    assert stage.jitter.translation_m < 1e-5
    assert 0.5 < np.sqrt(error_in_sigmas(stage)) < 1.5


def test_both_components_are_found_together():
    rng = np.random.default_rng(4)
    motions = rng.normal(size=(16, 6)) * [5e-5, 5e-5, 5e-5, 2e-4, 2e-4, 2e-4]
    stage = fit_stage(exact(GRID, [4] * 16, motions), [4] * 16, GRID)
    assert stage.jitter.rotation_rad == pytest.approx(5e-5, rel=0.3)
    assert stage.jitter.translation_m == pytest.approx(2e-4, rel=0.3)


def test_photographs_that_no_jitter_explains_are_refused_in_a_sentence():
    motions = np.random.default_rng(5).normal(size=(16, 6)) * 0.05
    seen = exact(GRID, [4] * 16, motions)
    sure = BoardPoses(EYEBALL, seen.names, seen.camera_from_board, 1e-8 * seen.covariance, seen.rms_px)
    with pytest.raises(BadInputError, match=r"cannot be estimated: .* more than a million times their noise"):
        fit_stage(sure, [4] * 16, GRID)


def test_one_photograph_that_moved_is_set_aside_and_the_rest_fits():
    motions = np.zeros((16, 6))
    motions[5] = [0, 0, 0, 1e-4, 0, 2e-4]
    stage = fit_stage(exact(GRID, [4] * 16, motions), [4] * 16, GRID)
    assert list(stage.rejected) == ["bare/05.png"]
    np.testing.assert_allclose(stage.rejected["bare/05.png"], motions[5], atol=1e-8)
    np.testing.assert_allclose(stage.axes, STAGE_AXES[:, :2], atol=1e-8)
    assert "bare/05.png" not in stage.names


@pytest.mark.parametrize("first_after", [3, 8, 12])
def test_a_target_that_moved_half_way_is_told_from_a_bad_stage(first_after):
    motion = np.array([2e-3, 0, 1e-3, 3e-4, 0, 2e-4])
    motions = np.where(np.arange(16)[:, None] >= first_after, motion, 0.0)
    stage = fit_stage(exact(GRID, [4] * 16, motions), [4] * 16, GRID)
    assert stage.target_moved is not None
    assert stage.target_moved.before == f"bare/{first_after - 1:02d}.png"
    assert stage.target_moved.after == f"bare/{first_after:02d}.png"


def test_a_bowed_stage_leaves_its_plane_and_no_single_photograph_is_blamed():
    bow = 1e-3 * ((GRID[:, 0] - MIDDLE[0]) / 0.008) ** 2
    motions = np.concatenate([np.zeros((16, 5)), bow[:, None]], axis=1)
    stage = fit_stage(exact(GRID, [4] * 16, motions), [4] * 16, GRID)
    assert stage.rejected == {}
    assert stage.target_moved is None
    assert stage.out_of_plane_m == pytest.approx(np.std(bow), rel=0.01)


def test_photographs_that_do_not_show_the_stages_motion_are_refused():
    with pytest.raises(BadInputError, match="no photograph without the headset"):
        fit_stage(exact(GRID[:0], []), [], GRID[:0])
    still = np.tile(MIDDLE, (6, 1))
    with pytest.raises(BadInputError, match="same stage reading"):
        fit_stage(exact(still, [4] * 6), [4] * 6, still)
    diagonal = MIDDLE + np.linspace(-0.01, 0.01, 7)[:, None] * [1, 1, 0]
    with pytest.raises(BadInputError, match="do not determine how the stage moves along x and y"):
        fit_stage(exact(diagonal, [4] * 7), [4] * 7, diagonal)


def test_an_axis_that_never_moved_cannot_be_asked_for():
    stage = fit_stage(exact(GRID, [4] * 16), [4] * 16, GRID)
    assert list(stage.moved_axes) == [0, 1]
    with pytest.raises(BadInputError, match="vary along axis z, but no photograph"):
        stage.displacement(MIDDLE + [0.001, 0.0, 0.002])

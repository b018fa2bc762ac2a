from dataclasses import replace

import numpy as np
import pytest
from synthetic_station import BOARD, EYEBALL, NOISE_PX, board_view, lens_views, tilted_poses, turned

from wlr_render.calibration.camera_calibration import calibrate_camera
from wlr_render.calibration.poses import motion_between
from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.geometry.lens_camera import LENS_PARAMETERS, LensCamera

SIZE = EYEBALL.size_px


def values(camera):
    return np.concatenate([camera.focal_px, camera.centre_px, camera.distortion])


@pytest.fixture(scope="module")
def many():
    return [calibrate_camera(lens_views(np.random.default_rng(seed), every=5), SIZE) for seed in range(40)]


def test_lens_and_poses_scatter_as_they_say(many):
    with np.errstate(divide="ignore", invalid="ignore"):
        scaled = np.array([(values(found.camera) - values(EYEBALL)) / found.sigma for found in many])
    assert np.all(np.abs(np.sqrt(np.mean(scaled[:, :4] ** 2, axis=0)) - 1.0) < 0.35)
    error = [motion_between(tilted_poses(), found.poses.camera_from_board).ravel() for found in many]
    chi = [e @ np.linalg.solve(found.poses.covariance, e) / len(e) for e, found in zip(error, many, strict=True)]
    assert 0.9 < np.sqrt(np.mean(chi)) < 1.1


def test_what_poses_owe_to_the_lens_is_shared_by_them(many):
    """The distances of all poses are wrong together where the focal length is."""
    covariance = many[0].poses.covariance
    distances = covariance[5::6, 5::6]
    sigma = np.sqrt(np.diag(distances))
    assert np.all(distances / np.outer(sigma, sigma) > 0.8)


def test_terms_that_the_lens_does_not_have_are_dropped(many):
    assert np.mean(["k3" in found.terms for found in many]) < 0.3
    assert all({"k1", "k2", "p1", "p2"} <= set(found.terms) for found in many)
    plain = LensCamera(SIZE, EYEBALL.focal_px, EYEBALL.centre_px)
    found = calibrate_camera(lens_views(np.random.default_rng(1), camera=plain), SIZE)
    assert len(found.terms) <= 1
    unused = [i for i, name in enumerate(LENS_PARAMETERS) if i > 3 and name not in found.terms]
    assert np.all(values(found.camera)[unused] == 0)
    assert np.all(found.sigma[unused] == 0)


def test_a_strong_third_radial_term_is_kept():
    strong = replace(EYEBALL, distortion=np.array([-0.3, 0.15, 0.0, 0.0, -0.4]))
    found = calibrate_camera(lens_views(np.random.default_rng(1), every=2, camera=strong), SIZE)
    assert "k3" in found.terms
    assert abs(found.camera.distortion[4] + 0.4) < 5 * found.sigma[8]


def test_noise_is_read_off_the_dots():
    views = [replace(view, sigma_px=view.sigma_px * 5) for view in lens_views(np.random.default_rng(2))]
    found = calibrate_camera(views, SIZE)
    assert found.noise == pytest.approx(0.2, rel=0.05)
    np.testing.assert_allclose(found.poses.rms_px, NOISE_PX, rtol=0.25)


def test_a_photograph_that_does_not_fit_is_set_aside_and_the_rest_as_good_as_without_it():
    rng = np.random.default_rng(3)
    views = lens_views(rng)
    zoomed = LensCamera(SIZE, EYEBALL.focal_px * [1.0, 1.02], EYEBALL.centre_px, EYEBALL.distortion)
    odd = board_view("zoomed.png", zoomed, tilted_poses()[1], rng, 4)
    found = calibrate_camera([*views[:4], odd, *views[4:]], SIZE)
    assert list(found.poses.rejected) == ["zoomed.png"]
    assert "the other photographs" in found.poses.rejected["zoomed.png"]
    np.testing.assert_allclose(values(found.camera), values(calibrate_camera(views, SIZE).camera), rtol=1e-9)


def test_misread_dots_spoil_one_photograph_only():
    views = lens_views(np.random.default_rng(4))
    shuffled = [replace(views[i], point=np.roll(views[i].point, i + 5, axis=0)) for i in (2, 6)]
    found = calibrate_camera([*views[:2], shuffled[0], *views[3:6], shuffled[1], *views[7:]], SIZE)
    assert list(found.poses.rejected) == ["lens/02.png", "lens/06.png"]
    assert "misread" in found.poses.rejected["lens/02.png"]


def test_stray_dots_do_not_move_the_lens():
    views = lens_views(np.random.default_rng(5))
    clean = calibrate_camera(views, SIZE)
    spoilt = [replace(view, pixel=view.pixel + 4.0 * (np.arange(len(view)) == 11)[:, None]) for view in views]
    found = calibrate_camera(spoilt, SIZE)
    assert np.all(np.abs(values(found.camera) - values(clean.camera))[:4] < clean.sigma[:4])


@pytest.mark.parametrize("count", [0, 2])
def test_too_few_photographs_are_refused(count):
    with pytest.raises(BadInputError, match=f"needs 3 or more photographs.*and {count} can be used"):
        calibrate_camera(lens_views(np.random.default_rng(0))[:count], SIZE)


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("tilt_deg", [(0, 0), (20, 10)])
def test_photographs_at_one_tilt_do_not_determine_the_focal_length(tilt_deg, seed):
    """Parallel to the image, or a fixed camera on a stage before one pose of the target.

    The lens has no distortion: its middle would be one thing more that is known.
    """
    plain = LensCamera(SIZE, EYEBALL.focal_px, EYEBALL.centre_px)
    places = [(x, y, 0.5 + 0.1 * x) for x in (-0.03, 0, 0.03) for y in (-0.02, 0.02)]
    poses = [transforms.rigid(turned(*tilt_deg, 0), place) for place in places]
    views = lens_views(np.random.default_rng(seed), camera=plain, poses=poses)
    with pytest.raises(BadInputError, match=r"photographs lens/00.png to lens/05.png do not determine .* tilted by 20"):
        calibrate_camera(views, SIZE)


def test_photographs_with_too_little_of_the_board_are_named_in_the_refusal():
    views = lens_views(np.random.default_rng(0))[:3]
    some = [replace(view, point=view.point[:4], pixel=view.pixel[:4], sigma_px=view.sigma_px[:4]) for view in views]
    with pytest.raises(BadInputError, match=r"lens/02.png: shows only 4 dots"):
        calibrate_camera([*views[:2], some[2]], SIZE)
    assert len(BOARD.indices()) == 24 * 18

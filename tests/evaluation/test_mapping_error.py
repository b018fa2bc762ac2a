import numpy as np
import pytest
from flat_image import PrismPlate, TurnedDisplay

from benchmarks.moved_observations import displaced, straight_error
from wlr_render.evaluation import mapping_error
from wlr_render.evaluation.mapping_error import DisplayObservations, SeeThroughObservations
from wlr_render.geometry import transforms
from wlr_render.geometry.directions import ARCMIN
from wlr_render.mappings import Eye

SHAPES = [(), (1,), (3, 1, 2)]


@pytest.fixture(params=SHAPES, ids=str)
def display_observations(request: pytest.FixtureRequest, flat_image_headset: Eye) -> DisplayObservations:
    rng = np.random.default_rng(5)
    viewpoint = flat_image_headset.eye_box.at(rng.uniform(-1, 1, (*request.param, 3)))
    pixel = rng.uniform(0, 1, (*request.param, 2)) * [140, 100]
    return mapping_error.observations_of_pixels(flat_image_headset.display, viewpoint, pixel)


@pytest.fixture(params=SHAPES, ids=str)
def see_through_observations(request: pytest.FixtureRequest, flat_image_headset: Eye) -> SeeThroughObservations:
    rng = np.random.default_rng(6)
    viewpoint = flat_image_headset.eye_box.at(rng.uniform(-1, 1, (*request.param, 3)))
    pixel = rng.uniform(0, 1, (*request.param, 2)) * [140, 100]
    view_dir = flat_image_headset.display.view_dir_of_pixel(pixel, viewpoint).value
    depth = rng.uniform(0.3, 5.0, request.param)
    return mapping_error.see_through_observations(flat_image_headset.see_through, viewpoint, view_dir, depth)


def test_truth_against_itself_is_zero(
    flat_image_headset: Eye, display_observations: DisplayObservations, see_through_observations: SeeThroughObservations
) -> None:
    display = mapping_error.display_error(flat_image_headset.display, display_observations)
    assert display.forward_arcmin.shape == display.backward_px.shape == (len(display_observations.pixel),)
    assert len(display_observations.pixel) >= 1
    np.testing.assert_allclose(display.forward_arcmin, 0.0, atol=1e-9)
    np.testing.assert_allclose(display.backward_px, 0.0, atol=1e-9)
    world = mapping_error.see_through_error(flat_image_headset.see_through, see_through_observations)
    np.testing.assert_allclose(world.backward_arcmin, 0.0, atol=1e-9)
    np.testing.assert_allclose(world.forward_arcmin, 0.0, atol=1e-9)
    np.testing.assert_allclose(world.forward_miss_m, 0.0, atol=1e-12)


def test_pixels_broadcast_against_viewpoints(flat_image_headset: Eye) -> None:
    viewpoint = flat_image_headset.eye_box.at(np.random.default_rng(1).uniform(-1, 1, (4, 1, 3)))
    pixel = flat_image_headset.display.panel.grid(3, 2).reshape(-1, 2)
    observations = mapping_error.observations_of_pixels(flat_image_headset.display, viewpoint, pixel)
    assert observations.viewpoint.shape == (24, 3)
    np.testing.assert_array_equal(observations.viewpoint[::6], viewpoint[:, 0])
    np.testing.assert_array_equal(observations.pixel[:6], pixel)


def test_observations_of_directions_are_those_of_the_pixels_seen(
    flat_image_headset: Eye, display_observations: DisplayObservations
) -> None:
    again = mapping_error.observations_of_dirs(
        flat_image_headset.display, display_observations.viewpoint, display_observations.view_dir
    )
    np.testing.assert_allclose(again.pixel, display_observations.pixel, atol=1e-9)
    np.testing.assert_array_equal(again.viewpoint, display_observations.viewpoint)


def test_directions_invisible_in_the_exact_optics_are_omitted(flat_image_headset: Eye) -> None:
    backwards = np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])
    viewpoint, see_through = flat_image_headset.eye_box.centre, flat_image_headset.see_through
    observations = mapping_error.see_through_observations(see_through, viewpoint, backwards, np.array(1.0))
    assert len(observations.point) == 1


def test_an_injected_rotation_is_measured(flat_image_headset: Eye, display_observations: DisplayObservations) -> None:
    angle = 3.0 * ARCMIN
    turned = TurnedDisplay(flat_image_headset.display, transforms.rotation_about("y", angle))
    error = mapping_error.display_error(turned, display_observations)
    # A direction at height y moves on a circle of radius sqrt(1 - y^2) about the axis.
    radius = np.sqrt(1.0 - display_observations.view_dir[:, 1] ** 2)
    np.testing.assert_allclose(error.forward_arcmin, 3.0 * radius, rtol=1e-6)
    per_px = 1.4 / 140 / 2.01 / ARCMIN
    assert np.all((error.backward_px > 0.95 * 3.0 / per_px) & (error.backward_px < 1.3 * 3.0 / per_px))


def test_an_injected_offset_of_the_real_ray_is_measured(
    flat_image_headset: Eye, see_through_observations: SeeThroughObservations
) -> None:
    shifted = PrismPlate(prism=0.004)
    error = mapping_error.see_through_error(shifted, see_through_observations)
    depth = (see_through_observations.viewpoint - see_through_observations.point)[:, 2]
    # A prism of 0.001 displaces the point by a thousandth of its depth, less the slant of the ray.
    assert np.all((error.forward_miss_m > 0.8e-3 * depth) & (error.forward_miss_m <= 1e-3 * depth))
    prism_arcmin = 1e-3 / ARCMIN
    for angle in (error.backward_arcmin, error.forward_arcmin):
        assert np.all((angle > 0.8 * prism_arcmin) & (angle < 1.01 * prism_arcmin))


def test_straight_error_is_the_deviation_of_the_optics(
    flat_image_headset: Eye, see_through_observations: SeeThroughObservations
) -> None:
    straight = PrismPlate(offset_m=0.0, prism=0.0)
    expected = mapping_error.see_through_error(straight, see_through_observations).backward_arcmin
    np.testing.assert_allclose(straight_error(see_through_observations), expected, rtol=1e-9)


def test_an_eye_tracking_error_costs_its_parallax(
    flat_image_headset: Eye, display_observations: DisplayObservations
) -> None:
    wrong = displaced(display_observations, np.array([1e-4, 0.0, 0.0]))
    error = mapping_error.display_error(flat_image_headset.display, wrong)
    parallax = 1e-4 / 2.01 / ARCMIN
    assert np.all((error.forward_arcmin > 0.8 * parallax) & (error.forward_arcmin < 1.01 * parallax))

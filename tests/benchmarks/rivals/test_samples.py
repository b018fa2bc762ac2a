"""Samples in blocks, and a regressor in each structure against models whose truth it can be."""

import numpy as np
import pytest
from present import narrowed
from rival_headsets import EYE_BOX, IN_PLANE, IN_VOLUME, PANEL, PIXELS, display_captures, see_through_captures
from rival_samples import grid_of_places, samples_of

from benchmarks.rivals.samples import Samples, fit_structure
from wlr_render.calibration.fit_display import DISPLAY
from wlr_render.calibration.fit_see_through import SEE_THROUGH
from wlr_render.geometry.directions import arcmin_between, tangents_of_dir
from wlr_render.geometry.planes import BasePlane
from wlr_render.models import model_place
from wlr_render.models.display_model import DisplayModel
from wlr_render.models.inverse import backward_start_of
from wlr_render.models.model_place import OwnPlace
from wlr_render.models.see_through_model import SeeThroughModel
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import Box, Polynomial, total_degree

EXACT = 1e-6  # arcminutes
RNG = np.random.default_rng(6)
VIEWPOINT = EYE_BOX.at(RNG.uniform(-0.7, 0.7, (40, 3)))  # within the places of the captures
PIXEL = RNG.uniform([200, 200], [800, 600], (40, 2))
POINT = np.column_stack([VIEWPOINT[:, :2] + RNG.uniform(-0.1, 0.1, (40, 2)), RNG.uniform(-3, -0.3, 40)])
PLANE = BasePlane(float(EYE_BOX.centre[2]))
POSITIONS = {"planar": IN_PLANE, "volumetric": IN_VOLUME, "static": IN_VOLUME}
PIXEL_BOX = ([0.0, 0.0], [1000.0, 800.0])
PLACE_BOX = ([0.02, -0.01, 0.015], [0.04, 0.01, 0.025])
TANGENT_BOX = ([-1.0, -1.0], [1.0, 1.0])
PLACES: dict[str, BasePlane | OwnPlace] = {
    "planar": PLANE,
    "volumetric": model_place.VIEWPOINT,
    "static": model_place.NOWHERE,
}


def seen_box(places: int, last: bool) -> Box:
    low, high = (np.array(each[:places]) for each in PLACE_BOX)
    parts = [PIXEL_BOX, (low, high)] if last else [(low, high), TANGENT_BOX]
    return Box(*(np.concatenate([part[end] for part in parts]) for end in (0, 1)))


def display_of(structure: str) -> DisplayModel:
    """A display of the structure whose regressor is a quadratic."""
    box = seen_box(PLACES[structure].coordinates, last=True)
    orders = total_degree(len(box.low), 2)
    coefficients = np.random.default_rng(3).normal(0.0, 0.01, (len(orders), 2))
    coefficients[orders.sum(axis=1) == 0] = 0.0
    for axis, slope in ((0, 0.35), (1, -0.3)):
        coefficients[(orders.sum(axis=1) == 1) & (orders[:, axis] == 1), axis] = slope
    forward = Polynomial(orders, box, coefficients)
    start = backward_start_of(forward)
    return DisplayModel(PANEL, EYE_BOX, PLACES[structure], forward, start)


def see_through_of(structure: str) -> SeeThroughModel:
    """A see-through model of the structure whose regressor is a quadratic."""
    box = seen_box(PLACES[structure].coordinates, last=False)
    orders = total_degree(len(box.low), 2)
    deviation = Polynomial(orders, box, np.random.default_rng(4).normal(0.0, 2e-3, (len(orders), 4)) * [1, 1, 0.2, 0.2])
    return SeeThroughModel(EYE_BOX, PLACES[structure], deviation)


def quadratic(samples: Samples) -> Polynomial:
    return samples.polynomial(2)


def two_blocks(inputs: FloatArray) -> FloatArray:
    """A and B, (n, 4): cubic."""
    u, v, x, y = (inputs / [1.0, 1.0, 0.005, 0.005]).T
    return np.column_stack([u * v + 0.1 * x, v**2 - 0.1 * y * u, 0.3 + 0.05 * x * y, 0.2 * u * v * x])


def test_the_least_squares_polynomial_of_two_blocks_is_the_truth() -> None:
    samples = samples_of(two_blocks, grid_of_places(), 30, blocks=2)
    inputs = RNG.uniform([0, 0, -0.005, -0.005], [1, 1, 0.005, 0.005], (50, 4))
    np.testing.assert_allclose(samples.polynomial(3)(inputs), two_blocks(inputs), atol=1e-10)
    assert np.abs(samples.polynomial(2)(inputs) - two_blocks(inputs)).max() > 1e-3


@pytest.mark.parametrize("structure", POSITIONS)
def test_a_display_whose_truth_is_the_regressor_is_recovered(structure: str) -> None:
    truth = display_of(structure)
    captures = display_captures(
        POSITIONS[structure], lambda pixel, viewpoint: truth.view_dir_of_pixel(pixel, viewpoint).value
    )
    model, regressor = fit_structure(DISPLAY, captures, structure, quadratic)
    assert isinstance(model, DisplayModel)
    assert model.place == truth.place
    assert model.forward is regressor
    found, expected = (each.view_dir_of_pixel(PIXEL, VIEWPOINT).value for each in (model, truth))
    assert arcmin_between(found, expected).max() < EXACT
    np.testing.assert_allclose(model.pixel_of_view_dir(expected, VIEWPOINT).value, PIXEL, atol=1e-6)


@pytest.mark.parametrize("structure", POSITIONS)
def test_a_see_through_model_whose_truth_is_the_regressor_is_recovered(structure: str) -> None:
    truth = see_through_of(structure)
    captures = see_through_captures(
        POSITIONS[structure],
        lambda point, viewpoint: tangents_of_dir(truth.view_dir_of_real_point(point, viewpoint).value),
    )
    model, regressor = fit_structure(SEE_THROUGH, captures, structure, quadratic)
    assert narrowed(model, SeeThroughModel).place == truth.place
    assert regressor.outputs == 4
    found, expected = (each.view_dir_of_real_point(POINT, VIEWPOINT).value for each in (model, truth))
    assert arcmin_between(found, expected).max() < EXACT
    ray, expected_ray = (each.real_ray_of_view_dir(expected, VIEWPOINT).value for each in (model, truth))
    np.testing.assert_allclose(ray, expected_ray, atol=1e-10)


def test_a_static_model_of_a_display_with_pupil_swim_is_that_of_the_position_nearest_to_the_centre() -> None:
    truth = display_of("volumetric")
    captures = display_captures(
        IN_VOLUME, lambda pixel, viewpoint: truth.view_dir_of_pixel(pixel, viewpoint).value, PIXELS
    )
    model, _ = fit_structure(DISPLAY, captures, "static", quadratic)
    nearest = IN_VOLUME[np.argmin(np.linalg.norm(IN_VOLUME - EYE_BOX.centre, axis=1))]
    expected = truth.view_dir_of_pixel(PIXEL, nearest).value
    assert arcmin_between(model.view_dir_of_pixel(PIXEL, VIEWPOINT).value, expected).max() < EXACT

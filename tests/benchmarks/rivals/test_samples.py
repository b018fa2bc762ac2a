"""Samples in blocks, folds, and a regressor in each structure against models whose truth it can be."""

import numpy as np
import pytest
from rival_headsets import EYE_BOX, IN_PLANE, IN_VOLUME, PANEL, PIXELS, display_captures, see_through_captures
from rival_samples import grid_of_places, readings_of, samples_of

from benchmarks.rivals.samples import FOLDS, fit_structure
from wlr_render.calibration.fit_display import DISPLAY
from wlr_render.calibration.fit_see_through import SEE_THROUGH
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import arcmin_between, tangents_of_dir
from wlr_render.geometry.planes import BasePlane
from wlr_render.models.bundle import BundleDisplay, BundleSeeThrough
from wlr_render.models.inverse import backward_start_of
from wlr_render.models.static import StaticDisplay, StaticSeeThrough
from wlr_render.models.volumetric import VolumetricDisplay, VolumetricSeeThrough
from wlr_render.numerics.polynomial import Box, Polynomial, basis, total_degree

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
PLACES = {"planar": 2, "volumetric": 3, "static": 0}
ORDERS = total_degree(4, 3)


def seen_box(places, last):
    low, high = (np.array(each[:places]) for each in PLACE_BOX)
    parts = [PIXEL_BOX, (low, high)] if last else [(low, high), TANGENT_BOX]
    return Box(*(np.concatenate([part[end] for part in parts]) for end in (0, 1)))


def display_of(structure):
    """A display of the structure whose regressor is a quadratic."""
    box = seen_box(PLACES[structure], last=True)
    orders = total_degree(len(box.low), 2)
    coefficients = np.random.default_rng(3).normal(0.0, 0.01, (len(orders), 2))
    coefficients[orders.sum(axis=1) == 0] = 0.0
    for axis, slope in ((0, 0.35), (1, -0.3)):
        coefficients[(orders.sum(axis=1) == 1) & (orders[:, axis] == 1), axis] = slope
    forward = Polynomial(orders, box, coefficients)
    start = backward_start_of(forward)
    if structure == "planar":
        return BundleDisplay(PANEL, EYE_BOX, PLANE, forward, start)
    return (VolumetricDisplay if structure == "volumetric" else StaticDisplay)(PANEL, EYE_BOX, forward, start)


def see_through_of(structure):
    """A see-through model of the structure whose regressor is a quadratic."""
    box = seen_box(PLACES[structure], last=False)
    orders = total_degree(len(box.low), 2)
    deviation = Polynomial(orders, box, np.random.default_rng(4).normal(0.0, 2e-3, (len(orders), 4)) * [1, 1, 0.2, 0.2])
    if structure == "planar":
        return BundleSeeThrough(EYE_BOX, PLANE, deviation)
    return (VolumetricSeeThrough if structure == "volumetric" else StaticSeeThrough)(EYE_BOX, deviation)


def quadratic(samples):
    return samples.polynomial(2)


def two_blocks(inputs):
    """A and B, (n, 4): cubic."""
    u, v, x, y = (inputs / [1.0, 1.0, 0.005, 0.005]).T
    return np.column_stack([u * v + 0.1 * x, v**2 - 0.1 * y * u, 0.3 + 0.05 * x * y, 0.2 * u * v * x])


def test_coefficients_of_two_blocks_go_from_outputs_to_columns_and_back():
    samples = samples_of(two_blocks, grid_of_places(), 30, noise=0.5, blocks=2)
    box = samples.readings.box
    polynomial = Polynomial(ORDERS, box, RNG.normal(size=(len(ORDERS), 4)))
    phi = basis(samples.readings.inputs, ORDERS, box)
    columns = samples.by_column(polynomial.coefficients)
    assert columns.shape == (2 * len(ORDERS), 2)
    np.testing.assert_array_equal(samples.by_block(columns), polynomial.coefficients)
    first, second = np.split(polynomial(samples.readings.inputs), 2, axis=1)
    predicted = first + samples.readings.multiplier[:, 1:] * second
    weighted = predicted * samples.readings.weight[:, None]
    np.testing.assert_allclose(samples.design(phi) @ columns, weighted, rtol=1e-10, atol=1e-8)
    observed = samples.readings.observed * samples.readings.weight[:, None]
    np.testing.assert_allclose(samples.target(), observed)
    np.testing.assert_allclose(samples.target(polynomial), observed - weighted, rtol=1e-10, atol=1e-7)
    rows = np.array([7, 3, 500])
    np.testing.assert_array_equal(samples.design(phi[rows], rows), samples.design(phi)[rows])
    np.testing.assert_array_equal(samples.target(polynomial, rows), samples.target(polynomial)[rows])
    assert samples.outputs == 4


def test_readings_weigh_by_their_sigma():
    samples = samples_of(two_blocks, grid_of_places(), 30, noise=0.25, blocks=2)
    twice = samples_of(two_blocks, grid_of_places(), 30, noise=0.5, blocks=2)
    np.testing.assert_allclose(samples.readings.weight, 2.0 * twice.readings.weight)


def test_the_least_squares_polynomial_of_two_blocks_is_the_truth():
    samples = samples_of(two_blocks, grid_of_places(), 30, blocks=2)
    inputs = RNG.uniform([0, 0, -0.005, -0.005], [1, 1, 0.005, 0.005], (50, 4))
    np.testing.assert_allclose(samples.polynomial(3)(inputs), two_blocks(inputs), atol=1e-10)
    assert np.abs(samples.polynomial(2)(inputs) - two_blocks(inputs)).max() > 1e-3


@pytest.mark.parametrize("count", [5, 13, 30])
def test_folds_keep_positions_together_and_are_of_equal_size(count):
    samples = samples_of(lambda inputs: inputs[:, :2], np.zeros((count, 2)), 20)
    by_position = [np.unique(samples.fold[samples.position == number]) for number in range(count)]
    assert all(len(each) == 1 for each in by_position)
    sizes = np.bincount(np.concatenate(by_position), minlength=FOLDS)
    assert sizes.min() == count // FOLDS
    assert sizes.max() == -(-count // FOLDS)


def test_readings_of_a_few_positions_are_dealt_out():
    samples = samples_of(lambda inputs: inputs[:, :2], np.zeros((2, 2)), 50)
    np.testing.assert_array_equal(np.bincount(samples.fold), [20] * FOLDS)
    assert all(len(np.unique(samples.fold[samples.position == number])) == FOLDS for number in (0, 1))


def test_inputs_are_scaled_by_the_box_of_the_fit():
    inputs = np.column_stack([np.linspace(100, 900, 50), RNG.uniform(0, 800, 50), np.linspace(-0.005, 0.005, 50)])
    samples = readings_of(inputs, np.arange(50), inputs[:, :2], np.ones((50, 1)))
    np.testing.assert_allclose(samples.scaled[[0, -1]][:, [0, 2]], [[-1 / 1.05] * 2, [1 / 1.05] * 2])


@pytest.mark.parametrize("structure", POSITIONS)
def test_a_display_whose_truth_is_the_regressor_is_recovered(structure):
    truth = display_of(structure)
    captures = display_captures(
        POSITIONS[structure], lambda pixel, viewpoint: truth.view_dir_of_pixel(pixel, viewpoint).value
    )
    model, regressor = fit_structure(DISPLAY, captures, structure, quadratic)
    assert type(model) is type(truth)
    assert model.forward is regressor
    found, expected = (each.view_dir_of_pixel(PIXEL, VIEWPOINT).value for each in (model, truth))
    assert arcmin_between(found, expected).max() < EXACT
    np.testing.assert_allclose(model.pixel_of_view_dir(expected, VIEWPOINT).value, PIXEL, atol=1e-6)


@pytest.mark.parametrize("structure", POSITIONS)
def test_a_see_through_model_whose_truth_is_the_regressor_is_recovered(structure):
    truth = see_through_of(structure)
    captures = see_through_captures(
        POSITIONS[structure],
        lambda point, viewpoint: tangents_of_dir(truth.view_dir_of_real_point(point, viewpoint).value),
    )
    model, regressor = fit_structure(SEE_THROUGH, captures, structure, quadratic)
    assert type(model) is type(truth)
    assert regressor.outputs == 4
    found, expected = (each.view_dir_of_real_point(POINT, VIEWPOINT).value for each in (model, truth))
    assert arcmin_between(found, expected).max() < EXACT
    rays = [each.real_ray_of_view_dir(expected, VIEWPOINT).value for each in (model, truth)]
    np.testing.assert_allclose(*rays, atol=1e-10)


def test_a_static_model_of_a_display_with_pupil_swim_is_that_of_the_position_nearest_to_the_centre():
    truth = display_of("volumetric")
    captures = display_captures(
        IN_VOLUME, lambda pixel, viewpoint: truth.view_dir_of_pixel(pixel, viewpoint).value, PIXELS
    )
    model, _ = fit_structure(DISPLAY, captures, "static", quadratic)
    nearest = IN_VOLUME[np.argmin(np.linalg.norm(IN_VOLUME - EYE_BOX.centre, axis=1))]
    expected = truth.view_dir_of_pixel(PIXEL, nearest).value
    assert arcmin_between(model.view_dir_of_pixel(PIXEL, VIEWPOINT).value, expected).max() < EXACT


def test_positions_are_numbered_from_zero_whatever_the_captures_call_them():
    captures = display_captures(IN_PLANE[:7], lambda pixel, viewpoint: np.array([[0.0, 0.0, -1.0]]) + 0 * viewpoint)
    seen = []

    def fit(samples):
        seen.append(samples.position)
        return samples.polynomial(1)

    renamed = type(captures)(**(vars(captures) | {"capture": 40 - 3 * captures.capture}))
    fit_structure(DISPLAY, renamed, "planar", fit)
    assert set(seen[0]) == set(range(7))
    np.testing.assert_array_equal(seen[0], 6 - captures.capture)


def test_targets_of_one_pose_are_refused():
    captures = see_through_captures(IN_PLANE, lambda point, viewpoint: (point - viewpoint)[:, :2], depths=(1.0,))
    with pytest.raises(BadInputError, match="two depths"):
        fit_structure(SEE_THROUGH, captures, "planar", quadratic)

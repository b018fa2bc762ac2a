"""Tables and components of maps: functions that they reproduce, a traced headset on a bench with errors, refusals."""

from dataclasses import replace

import numpy as np
import pytest
from rival_headsets import rms
from rival_samples import error_arcmin, grid_of_places, readings_of, samples_of

from benchmarks.rivals import map_tables
from benchmarks.rivals.map_tables import (
    PositionMaps,
    components_with_scores,
    linear_table,
    principal_components,
    thin_plate_table,
)
from benchmarks.rivals.samples import fit_structure
from benchmarks.trials import EvaluatedEye, capture_setup
from wlr_render.calibration.fit_display import DISPLAY
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import arcmin_between
from wlr_render.numerics.polynomial import term_count
from wlr_render.simulation import viewpoints
from wlr_render.simulation.simulate_captures import simulate_display

EXACT = 1e-6  # arcminutes
SIZE = 0.005
SCATTERED = np.random.default_rng(8).uniform(-SIZE, SIZE, (40, 3))
CORNERS = SIZE * np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)


def in_millimetres(inputs):
    return inputs[:, 0], inputs[:, 1], *(inputs[:, 2:] / SIZE).T


def linear_in_place(inputs):
    """Tangents (n, 2) of maps that are cubic in the pixel and linear in the place."""
    u, v, x, y, *z = in_millimetres(inputs)
    depth = z[0] if z else 0.0
    return np.column_stack([0.6 * u + 0.1 * u**2 * v + 0.03 * x * (1 + v), 0.5 * v + 0.02 * y * u**3 + 0.01 * depth])


def quadratic_in_place(inputs):
    """A mean map and three components, whose scores are of degrees 1, 1 and 2."""
    u, v, x, y = in_millimetres(inputs)
    return linear_in_place(inputs) + (x**2 + x * y)[:, None] * np.column_stack([0.02 * u - 0.01 * v**2, 0.02 * u * v])


def two_blocks(inputs):
    """A and B, (n, 4)."""
    return np.hstack([linear_in_place(inputs), 0.1 * linear_in_place(inputs)[:, ::-1]])


@pytest.mark.parametrize("blocks", [1, 2])
@pytest.mark.parametrize("fit", [linear_table, thin_plate_table, principal_components])
def test_a_table_of_a_map_that_is_linear_in_the_place_is_exact(fit, blocks):
    truth = linear_in_place if blocks == 1 else two_blocks
    model = fit(samples_of(truth, grid_of_places(3), blocks=blocks))
    assert error_arcmin(model, truth) < EXACT
    assert model.outputs == 2 * blocks


def test_a_linear_table_takes_places_in_a_volume():
    model = linear_table(samples_of(linear_in_place, np.vstack([SCATTERED, CORNERS])))
    assert error_arcmin(model, linear_in_place, variables=5) < EXACT


@pytest.mark.parametrize("beyond", [1.2, 3.0, 5.0])
def test_a_linear_table_is_clamped_to_the_hull_of_its_places(beyond):
    model = linear_table(samples_of(linear_in_place, grid_of_places()))
    inputs = np.array([[0.3, 0.4, beyond * SIZE, 0.0]])
    found = model(inputs)[0, 0]
    middle, border = (linear_in_place(inputs * [1, 1, at, 1])[0, 0] for at in (0.0, 1.0 / beyond))
    assert 0.97 <= (found - middle) / (border - middle) <= 1.0 + 1e-9
    assert np.isfinite(model(np.array([[0.3, 0.4, 100.0, 100.0]]))).all()


def test_a_linear_table_lies_on_the_chord_between_two_places():
    """Halfway between the places of a map that is curved in the place, it is the mean of both."""
    samples = samples_of(lambda inputs: linear_in_place(inputs) + 4000.0 * inputs[:, 2:3] ** 2, grid_of_places(3))
    model = linear_table(samples)
    left, middle, right = (model(np.array([[0.2, 0.7, at, -SIZE]])) for at in (-SIZE, -0.5 * SIZE, 0.0))
    np.testing.assert_allclose(middle, 0.5 * (left + right), atol=1e-10)


def test_a_thin_plate_through_a_plane_is_that_plane_also_outside():
    model = thin_plate_table(samples_of(linear_in_place, grid_of_places(3)))
    assert error_arcmin(model, linear_in_place, size=2 * SIZE) < EXACT


def test_a_thin_plate_through_many_places_reproduces_quadratics():
    model = thin_plate_table(samples_of(quadratic_in_place, grid_of_places()))
    assert error_arcmin(model, quadratic_in_place, size=2 * SIZE) < EXACT


def test_between_places_it_is_the_thin_plate_through_them():
    """r^2 log r and a plane, solved for here directly."""
    place = grid_of_places(3)
    value = np.random.default_rng(5).normal(0.0, 0.1, 9)

    def radial(apart):
        return apart**2 * np.log(np.where(apart > 0, apart, 1.0))

    def at(wanted):
        return radial(np.linalg.norm(wanted[:, None] - place, axis=2) / SIZE)

    plane = np.column_stack([np.ones(9), place])
    matrix = np.block([[at(place), plane], [plane.T, np.zeros((3, 3))]])
    solution = np.linalg.solve(matrix, np.concatenate([value, np.zeros(3)]))
    index = {tuple(each): number for number, each in enumerate(place)}

    def truth(inputs):
        here = [value[index[tuple(each)]] for each in inputs[:, 2:]]
        return linear_in_place(inputs) + np.column_stack([here, np.zeros(len(here))])

    model = thin_plate_table(samples_of(truth, place))
    wanted = np.random.default_rng(6).uniform(-SIZE, SIZE, (40, 2))
    inputs = np.hstack([np.full((40, 2), 0.4), wanted])
    plate = np.hstack([at(wanted), np.ones((40, 1)), wanted]) @ solution
    np.testing.assert_allclose(model(inputs)[:, 0], linear_in_place(inputs)[:, 0] + plate, atol=1e-9)


def test_components_recover_a_map_of_three_components():
    model = principal_components(samples_of(quadratic_in_place, grid_of_places()))
    assert error_arcmin(model, quadratic_in_place) < EXACT


def test_no_more_components_are_stored_than_rise_above_the_noise():
    noisy = principal_components(samples_of(quadratic_in_place, grid_of_places(), noise=0.3))
    assert error_arcmin(noisy, quadratic_in_place) < 0.1
    assert noisy.numbers == (1 + 3) * term_count(2, 4) * 2 + 3 * term_count(2, 2)


def test_the_size_of_a_map_is_that_over_all_readings(monkeypatch):
    monkeypatch.setattr(map_tables, "_MAP_DEGREES", (4,))
    samples = samples_of(linear_in_place, grid_of_places(), noise=0.25)
    maps = PositionMaps.of(samples_of(linear_in_place, grid_of_places()))
    change = replace(maps, samples=samples).metric_root() @ (maps.coefficients[-1] - maps.coefficients[0])
    inputs, weight = samples.readings.inputs, samples.readings.weight[:, None]
    first, last = (linear_in_place(np.hstack([inputs[:, :2], 0 * weight + place])) for place in inputs[[0, -1], 2:])
    assert np.linalg.norm(change) == pytest.approx(np.linalg.norm((last - first) * weight) / np.sqrt(len(samples)))


@pytest.mark.parametrize("fit", [linear_table, thin_plate_table, principal_components])
def test_without_places_it_is_one_map(fit):
    samples = samples_of(lambda inputs: linear_in_place(np.hstack([inputs, 0 * inputs])), np.empty((1, 0)))
    model = fit(samples)
    inputs = np.random.default_rng(3).uniform(0, 1, (50, 2))
    np.testing.assert_allclose(model(inputs), linear_in_place(np.hstack([inputs, 0 * inputs])), atol=1e-9)


@pytest.mark.parametrize("fit", [linear_table, principal_components])
def test_a_bench_with_stage_errors_is_calibrated_better_in_a_plane_than_in_a_volume(fit):
    """A traced headset is no polynomial, its stage errs by 50 um, and viewpoints of the test lie off the plane."""
    at = EvaluatedEye("birdbath28", "right", (10.0, 8.0, 6.0))
    setup = replace(capture_setup(at), grid=(9, 7), stage_error_m=5e-5)
    truth, rng = setup.truth, np.random.default_rng(4)
    viewpoint = viewpoints.random_in_eye_box(truth.eye_box, 12, rng)[:, None]
    seen = truth.display.view_dir_of_pixel(truth.display.panel.grid(7, 5).reshape(1, -1, 2), viewpoint)
    error = {}
    for structure in ("planar", "volumetric"):
        captures = simulate_display(setup, setup.camera_positions(structure, 16), rng)
        model, _ = fit_structure(DISPLAY, captures, structure, fit)
        found = model.view_dir_of_pixel(truth.display.panel.grid(7, 5).reshape(1, -1, 2), viewpoint)
        assert found.usable[seen.ok].all()
        error[structure] = rms(arcmin_between(found.value, seen.value)[seen.ok])
    assert error["planar"] < error["volumetric"]
    assert error["planar"] < 2.0


def test_a_position_with_too_few_readings_is_refused():
    samples = samples_of(linear_in_place, grid_of_places(3), readings=5)
    with pytest.raises(BadInputError, match=r"camera position 0 has 5 readings, .* needs 6 or more at each"):
        linear_table(samples)


@pytest.mark.parametrize("fit", [linear_table, thin_plate_table, principal_components])
def test_positions_whose_rays_cross_the_plane_at_many_points_are_refused(fit):
    samples = samples_of(linear_in_place, grid_of_places())
    moved = samples.readings.inputs.copy()
    moved[:, 2] += 1e-4 * moved[:, 0]
    readings = samples.readings
    with pytest.raises(BadInputError, match="do not lie in the base plane"):
        fit(readings_of(moved, samples.position, readings.observed, readings.multiplier))


@pytest.mark.parametrize("fit", [linear_table, thin_plate_table])
def test_places_on_a_line_are_refused(fit):
    place = np.linspace(-SIZE, SIZE, 7)[:, None] * [1.0, 0.5]
    with pytest.raises(BadInputError, match=r"7 camera positions do not span 2 dimensions .*not all in one line"):
        fit(samples_of(linear_in_place, place))


def test_too_few_positions_for_components_are_refused():
    for place, count in ((grid_of_places(2), "4 "), (SCATTERED[:12], "12 ")):
        with pytest.raises(BadInputError, match=count + ".*take 9 or more in a plane, 13 or more in a volume"):
            principal_components(samples_of(linear_in_place, place))
    plane = principal_components(samples_of(linear_in_place, grid_of_places(3)))
    assert error_arcmin(plane, linear_in_place) < 0.01
    volume = principal_components(samples_of(linear_in_place, SCATTERED[:13]))
    assert error_arcmin(volume, linear_in_place, variables=5) < 0.01


def test_a_setting_of_the_scores_that_needs_more_positions_is_left_out():
    def scores(place, values, setting):
        if setting == "greedy":
            raise BadInputError("too few")
        return (lambda wanted: np.zeros((len(wanted), values.shape[1]))), 0

    samples = samples_of(linear_in_place, grid_of_places())
    assert components_with_scores(samples, (2,), ("greedy", "none"), scores).outputs == 2
    with pytest.raises(BadInputError, match="25 camera positions are too few"):
        components_with_scores(samples, (2,), ("greedy",), scores)

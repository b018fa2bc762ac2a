import itertools
from collections.abc import Callable

import numpy as np
import pytest

from wlr_render.numerics import chebyshev, newton, polynomial
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.polynomial import Polynomial


@pytest.mark.parametrize(("variables", "degree", "terms"), [(4, 5, 126), (5, 5, 252), (4, 3, 35), (5, 3, 56)])
def test_number_of_terms_is_the_binomial_coefficient(variables: int, degree: int, terms: int) -> None:
    assert polynomial.term_count(variables, degree) == terms
    assert len(polynomial.total_degree(variables, degree)) == terms


TABLES = {
    "pixel | place": polynomial.limited_orders(2, 8, 2, 5, 8),
    "pixel | place in space": polynomial.limited_orders(2, 4, 3, 2, 5),
    "place in space | direction": polynomial.limited_orders(3, 2, 2, 4, 5),
    "one variable": polynomial.total_degree(1, 4),
    "shuffled, with gaps": np.array([[0, 3, 1], [0, 0, 0], [2, 0, 4], [1, 3, 0]]),
}


def random_model(orders: IntArray, seed: int = 4) -> Polynomial:
    rng, variables = np.random.default_rng(seed), orders.shape[1]
    low = rng.uniform(-3, 0, (variables,))
    box = polynomial.Box(low, low + rng.uniform(0.5, 4, variables))
    return polynomial.Polynomial(orders, box, rng.normal(size=(len(orders), 3)))


def inputs_of(model: Polynomial, grown: float) -> FloatArray:
    """Inputs in the box, or in a larger one."""
    unit = np.random.default_rng(5).uniform(-grown, grown, (60, len(model.box.low)))
    return 0.5 * (model.box.low + model.box.high) + 0.5 * unit * (model.box.high - model.box.low)


def plain_sum(model: Polynomial, inputs: FloatArray) -> FloatArray:
    x = model.box.scaled(inputs)
    terms = [np.prod(np.cos(order * np.arccos(x)), axis=1) for order in model.orders]
    return np.array(terms).T @ model.coefficients


def test_orders_are_limited_apart_and_ordered_by_their_sum() -> None:
    assert len(polynomial.limited_orders(2, 8, 2, 5, 8)) == 420
    orders = polynomial.limited_orders(2, 3, 1, 1, 3)
    every = polynomial.total_degree(3, 3)
    np.testing.assert_array_equal(orders, every[every[:, 2] <= 1])
    np.testing.assert_array_equal(polynomial.limited_orders(2, 9, 2, 9, 3), polynomial.total_degree(4, 3))


@pytest.mark.parametrize("name", TABLES)
def test_value_and_basis_are_the_sum_over_the_terms(name: str) -> None:
    model = random_model(TABLES[name])
    inputs = inputs_of(model, 1.0)
    expected = plain_sum(model, inputs)
    np.testing.assert_allclose(model(inputs), expected, atol=1e-11)
    np.testing.assert_allclose(
        polynomial.basis(inputs, model.orders, model.box) @ model.coefficients, expected, atol=1e-11
    )


@pytest.mark.parametrize("grown", [1.0, 1.5])
@pytest.mark.parametrize("name", TABLES)
def test_jacobian_is_the_derivative_in_the_box_and_beyond(name: str, grown: float) -> None:
    model = random_model(TABLES[name])
    inputs = inputs_of(model, grown)
    value, jacobian = model.with_jacobian(inputs)
    np.testing.assert_allclose(value, model(inputs), atol=1e-11)
    np.testing.assert_allclose(
        polynomial.basis(inputs, model.orders, model.box) @ model.coefficients, value, atol=1e-10
    )
    for axis in range(inputs.shape[1]):
        shift = 1e-6 * np.eye(inputs.shape[1])[axis]
        slope = (model(inputs + shift) - model(inputs - shift)) / 2e-6
        np.testing.assert_allclose(jacobian[..., axis], slope, rtol=1e-6, atol=1e-6 * np.abs(jacobian).max())


@pytest.mark.parametrize("lead", [(), (1,), (3, 1, 2)])
def test_value_and_jacobian_have_every_batch_shape(lead: tuple[int, ...]) -> None:
    model = random_model(TABLES["pixel | place"])
    one = inputs_of(model, 1.0)[:6]
    x = one[: int(np.prod(lead))].reshape(*lead, 4)
    value, jacobian = model.with_jacobian(x)
    expected, slope = model.with_jacobian(one)
    np.testing.assert_allclose(value, expected[: int(np.prod(lead))].reshape(*lead, 3), atol=1e-12)
    np.testing.assert_allclose(jacobian, slope[: int(np.prod(lead))].reshape(*lead, 3, 4), atol=1e-10)
    np.testing.assert_array_equal(model.with_jacobian(x, axes=(3, 1))[1], jacobian[..., [3, 1]])


@pytest.mark.parametrize("grown", [1.0, 1.5])
@pytest.mark.parametrize("held_axes", [(0, 1), (2, 3), (3,), (1, 3), (0, 1, 2, 3), ()])
def test_a_held_polynomial_is_the_whole_one_in_its_other_variables(held_axes: tuple[int, ...], grown: float) -> None:
    model = random_model(TABLES["pixel | place"])
    inputs, free = inputs_of(model, grown), [axis for axis in range(4) if axis not in held_axes]
    held = model.held(held_axes, inputs[:, list(held_axes)])
    value, jacobian = model.with_jacobian(inputs)
    np.testing.assert_allclose(held(inputs[:, free]), value, atol=1e-10)
    some = np.array([3, 7, 8, 40])
    held_value, held_jacobian = held.with_jacobian(inputs[some][:, free], some)
    np.testing.assert_allclose(held_value, value[some], atol=1e-10)
    np.testing.assert_allclose(held_jacobian, jacobian[some][..., free], atol=1e-9)


def test_beyond_the_box_a_polynomial_is_linear_and_joins_smoothly() -> None:
    model = random_model(TABLES["pixel | place"])
    centre, half = 0.5 * (model.box.low + model.box.high), 0.5 * (model.box.high - model.box.low)
    border = 1.0 + 2.0 * polynomial.BOX_SLACK
    for unit in ([border, 0.3, -0.2, 0.5], [0.1, -border, border, 0.0], [-border] * 4):
        outwards = half * np.where(np.abs(unit) == border, np.sign(unit), 0.0)
        edge = centre + half * np.array(unit)
        inside, there, outside = (model.with_jacobian(edge + step * outwards) for step in (-1e-9, 0.0, 1e-9))
        for part in (0, 1):
            scale = np.abs(there[part]).max()
            np.testing.assert_allclose(inside[part], there[part], atol=1e-6 * scale)
            np.testing.assert_allclose(outside[part], there[part], atol=1e-6 * scale)
        for step in (0.1, 2.0, 1e3):
            expected = there[0] + step * there[1] @ outwards
            np.testing.assert_allclose(model(edge + step * outwards), expected, rtol=1e-9)
    # Inside the slack it is still the polynomial itself.
    near = np.array([[border - 1e-4, 0.0, 0.0, 0.0]])
    order = model.orders[:, 0]
    terms = np.cosh(order * np.arccosh(near[0, 0])) * np.prod(np.cos(model.orders[:, 1:] * 0.5 * np.pi), axis=1)
    np.testing.assert_allclose(model(centre + half * near)[0], terms @ model.coefficients, atol=1e-10)


def test_inputs_that_are_not_finite_have_no_value() -> None:
    model = random_model(TABLES["pixel | place"])
    inputs = inputs_of(model, 1.0)
    expected = model(inputs)
    inputs[5, 1] = np.nan
    value = model(inputs)
    assert np.isnan(value[5]).all()
    np.testing.assert_allclose(np.delete(value, 5, axis=0), np.delete(expected, 5, axis=0), atol=1e-12)


def circle_and_line(angle: FloatArray) -> Callable[[FloatArray, IntArray], tuple[FloatArray, FloatArray]]:
    def residual(unknown: FloatArray, index: IntArray) -> tuple[FloatArray, FloatArray]:
        x, y = unknown.T
        slope = np.tan(angle[index])
        value = np.stack([x * x + y * y - 1, y - slope * x], axis=1)
        one = np.ones_like(x)
        jacobian = np.stack([np.stack([2 * x, 2 * y], 1), np.stack([-slope, one], 1)], axis=1)
        return value, jacobian

    return residual


def test_newton_finds_roots_and_owns_up_to_failures() -> None:
    angle = np.linspace(-1.4, 1.4, 101)
    root = newton.solve_2x2(circle_and_line(angle), np.tile([1.5, 0.2], (101, 1)), 1e-13)
    assert root.converged.all()
    np.testing.assert_allclose(root.unknown, np.stack([np.cos(angle), np.sin(angle)], 1), atol=1e-12)

    def no_root(unknown: FloatArray, index: object) -> tuple[FloatArray, FloatArray]:
        x, y = unknown.T
        zero = np.zeros_like(x)
        return np.stack([x * x + 1, y], 1), np.stack([np.stack([2 * x, zero], 1), np.stack([zero, zero + 1], 1)], 1)

    assert not newton.solve_2x2(no_root, np.array([[0.3, 0.0], [np.nan, 0.0]]), 1e-9).converged.any()


def test_chebyshev_interpolation_is_exact_for_polynomials_and_converges_geometrically() -> None:
    at = np.linspace(0, 100, 57)
    matrix = chebyshev.interpolation_matrix(9, 0, 100, at)
    x = chebyshev.nodes(9, 0, 100)
    np.testing.assert_allclose(matrix @ (x / 50) ** 8, (at / 50) ** 8, atol=1e-11)
    assert np.allclose(chebyshev.interpolation_matrix(9, 0, 100, x), np.eye(9))
    fine = np.linspace(-1, 1, 83)
    errors = []
    for count in (12, 16, 20, 24):
        node = chebyshev.nodes(count, -1, 1)
        weights = chebyshev.interpolation_matrix(count, -1, 1, fine)
        errors.append(np.abs(weights @ np.exp(np.sin(4 * node)) - np.exp(np.sin(4 * fine))).max())
    assert all(later < 0.3 * earlier for earlier, later in itertools.pairwise(errors))
    assert errors[-1] < 1e-3

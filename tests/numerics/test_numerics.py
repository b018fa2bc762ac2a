import itertools

import numpy as np
import pytest
from numpy.polynomial import chebyshev as numpy_chebyshev

from wlr_render.numerics import chebyshev, least_squares, newton, polynomial


def random_polynomial(rng, variables, degree, outputs=2):
    low = rng.uniform(-3, 0, variables)
    box = polynomial.Box(low, low + rng.uniform(0.5, 4, variables))
    orders = polynomial.total_degree(variables, degree)
    return polynomial.Polynomial(orders, box, rng.normal(size=(len(orders), outputs)))


@pytest.mark.parametrize(("variables", "degree", "terms"), [(4, 5, 126), (5, 5, 252), (4, 3, 35), (5, 3, 56)])
def test_number_of_terms_is_that_of_the_paper(variables, degree, terms):
    assert polynomial.term_count(variables, degree) == terms
    assert len(polynomial.total_degree(variables, degree)) == terms


def test_value_agrees_with_numpy_term_by_term():
    rng = np.random.default_rng(1)
    model = random_polynomial(rng, 3, 4)
    points = rng.uniform(model.box.low, model.box.high, (20, 3))
    orders = polynomial.total_degree(3, 4)
    dense = np.zeros((5, 5, 5, 2))
    for order, coefficients in zip(orders, model.coefficients, strict=True):
        dense[tuple(order)] = coefficients
    expected = numpy_chebyshev.chebval3d(*model.box.scaled(points).T, dense).T
    np.testing.assert_allclose(model(points), expected, atol=1e-12)


@pytest.mark.parametrize("lead", [(), (1,), (3, 1, 2)])
def test_jacobian_is_the_derivative_for_every_batch_shape(lead):
    rng = np.random.default_rng(2)
    model = random_polynomial(rng, 4, 5)
    x = rng.uniform(model.box.low, model.box.high, (*lead, 4))
    value, jacobian = model.with_jacobian(x)
    assert value.shape == (*lead, 2)
    assert jacobian.shape == (*lead, 2, 4)
    np.testing.assert_allclose(value, model(x), atol=1e-12)
    step = 1e-6
    for axis in range(4):
        shift = step * np.eye(4)[axis]
        slope = (model(x + shift) - model(x - shift)) / (2 * step)
        np.testing.assert_allclose(jacobian[..., axis], slope, rtol=1e-6, atol=1e-5)
    np.testing.assert_array_equal(model.with_jacobian(x, axes=(3, 1))[1], jacobian[..., [3, 1]])


def test_least_squares_recovers_coefficients():
    rng = np.random.default_rng(3)
    model = random_polynomial(rng, 2, 3)
    points = rng.uniform(model.box.low, model.box.high, (200, 2))
    design = polynomial.basis(points, model.orders, model.box)
    observed = model(points)
    np.testing.assert_allclose(least_squares.solve(design, observed).coefficients, model.coefficients, atol=1e-9)
    observed[0] += 100.0
    solution = least_squares.solve(design, observed)
    assert np.abs(solution.coefficients - model.coefficients).max() > 0.1
    np.testing.assert_allclose(design.T @ solution.residual, 0, atol=1e-9)


def test_five_levels_do_not_carry_degree_five():
    levels = np.linspace(-1, 1, 5)
    points = np.stack(np.meshgrid(levels, levels, np.linspace(-1, 1, 9)), -1).reshape(-1, 3)
    box = polynomial.Box.around(points)
    least_squares.solve(polynomial.basis(points, polynomial.total_degree(3, 4), box), points)
    with pytest.raises(least_squares.RankDeficientError) as caught:
        least_squares.solve(polynomial.basis(points, polynomial.total_degree(3, 5), box), points)
    assert caught.value.rank == caught.value.columns - 2


def circle_and_line(angle):
    def residual(unknown, index):
        x, y = unknown.T
        slope = np.tan(angle[index])
        value = np.stack([x * x + y * y - 1, y - slope * x], axis=1)
        one = np.ones_like(x)
        jacobian = np.stack([np.stack([2 * x, 2 * y], 1), np.stack([-slope, one], 1)], axis=1)
        return value, jacobian

    return residual


def test_newton_finds_roots_and_owns_up_to_failures():
    angle = np.linspace(-1.4, 1.4, 101)
    root = newton.solve_2x2(circle_and_line(angle), np.tile([1.5, 0.2], (101, 1)), 1e-13)
    assert root.converged.all()
    np.testing.assert_allclose(root.unknown, np.stack([np.cos(angle), np.sin(angle)], 1), atol=1e-12)

    def no_root(unknown, index):
        x, y = unknown.T
        zero = np.zeros_like(x)
        return np.stack([x * x + 1, y], 1), np.stack([np.stack([2 * x, zero], 1), np.stack([zero, zero + 1], 1)], 1)

    assert not newton.solve_2x2(no_root, np.array([[0.3, 0.0], [np.nan, 0.0]]), 1e-9).converged.any()


def test_chebyshev_interpolation_is_exact_for_polynomials_and_converges_geometrically():
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

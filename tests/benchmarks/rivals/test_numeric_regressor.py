"""`NumericRegressor`: values, differences and held variables of a polynomial of which only values are known."""

import numpy as np
import pytest

from benchmarks.rivals import numeric_regressor
from benchmarks.rivals.numeric_regressor import NumericRegressor
from wlr_render.numerics.polynomial import Box, Polynomial, total_degree

RNG = np.random.default_rng(4)
BOX = Box(np.array([0.0, 0.0, -0.01, -0.2]), np.array([1000.0, 800.0, 0.01, 0.4]))
ORDERS = total_degree(4, 4)
POLYNOMIAL = Polynomial(ORDERS, BOX, RNG.normal(size=(len(ORDERS), 3)))
INPUTS = RNG.uniform(BOX.low, BOX.high, (30, 4))
SLOPE = 1e-7  # in scaled units, of differences over 1e-5 of the box


def wrapped(polynomial):
    """The same function, of which only values are known."""
    return NumericRegressor(polynomial, polynomial.box, polynomial.outputs, polynomial.numbers)


def in_scaled_units(jacobian, axes=slice(None)):
    return jacobian * (BOX.high - BOX.low)[axes] / 2.0


@pytest.mark.parametrize("lead", [(), (1,), (0,), (3, 1, 2)])
def test_values_and_jacobian_take_any_leading_axes(lead):
    inputs = RNG.uniform(BOX.low, BOX.high, (*lead, 4))
    value, jacobian = wrapped(POLYNOMIAL).with_jacobian(inputs)
    exact_value, exact_jacobian = POLYNOMIAL.with_jacobian(inputs)
    assert value.shape == (*lead, 3)
    assert jacobian.shape == (*lead, 3, 4)
    np.testing.assert_allclose(value, exact_value, atol=1e-13)
    np.testing.assert_allclose(in_scaled_units(jacobian), in_scaled_units(exact_jacobian), atol=SLOPE)


def test_values_are_computed_in_chunks(monkeypatch):
    sizes = []

    def function(inputs):
        sizes.append(len(inputs))
        return POLYNOMIAL(inputs)

    monkeypatch.setattr(numeric_regressor, "_CHUNK", 8)
    value = NumericRegressor(function, BOX, 3, 0)(INPUTS.reshape(6, 5, 4))
    assert sizes == [8, 8, 8, 6]
    np.testing.assert_allclose(value.reshape(-1, 3), POLYNOMIAL(INPUTS), atol=1e-13)


@pytest.mark.parametrize("axes", [None, (2, 3), (3, 0)])
def test_jacobian_is_that_of_the_polynomial_in_the_units_of_the_inputs(axes):
    chosen = slice(None) if axes is None else list(axes)
    found, exact = (each.with_jacobian(INPUTS, axes)[1] for each in (wrapped(POLYNOMIAL), POLYNOMIAL))
    np.testing.assert_allclose(in_scaled_units(found, chosen), in_scaled_units(exact, chosen), atol=SLOPE)


@pytest.mark.parametrize("axes", [(0, 1), (1, 3), ()])
@pytest.mark.parametrize("index", [None, np.array([2, 3, 11])])
def test_held_is_the_whole_function_at_the_held_rows(axes, index):
    free = [axis for axis in range(4) if axis not in axes]
    held = wrapped(POLYNOMIAL).held(axes, INPUTS[:, list(axes)])
    rows = INPUTS if index is None else INPUTS[index]
    value, jacobian = held.with_jacobian(rows[:, free], index)
    exact_value, exact_jacobian = POLYNOMIAL.with_jacobian(rows, free)
    np.testing.assert_allclose(held(rows[:, free], index), exact_value, atol=1e-13)
    np.testing.assert_allclose(value, exact_value, atol=1e-13)
    np.testing.assert_allclose(in_scaled_units(jacobian, free), in_scaled_units(exact_jacobian, free), atol=SLOPE)

"""Models answer the same with a polynomial as with any function of the same values."""

import numpy as np
import pytest
from models.toy_models import DISPLAYS, EYE_BOX, SEE_THROUGHS, Fitted, changed
from present import narrowed

from benchmarks.rivals.numeric_regressor import NumericRegressor
from wlr_render.models.display_model import DisplayModel
from wlr_render.numerics.arrays import FloatArray

RNG = np.random.default_rng(4)
PIXEL = RNG.uniform([100, 100], [900, 700], (30, 2))
VIEWPOINT = EYE_BOX.at(RNG.uniform(-1, 1, (30, 3)))
POINT = np.column_stack([VIEWPOINT[:, :2] + RNG.uniform(-0.1, 0.1, (30, 2)), RNG.uniform(-3, -0.3, 30)])
ANGLE = 1e-10  # radians: 3e-7 arcminutes


def of_function(model: Fitted) -> Fitted:
    """The same model, made of a function without derivatives of its own."""
    polynomial = model.modelled
    function = NumericRegressor(polynomial, polynomial.box, polynomial.outputs, polynomial.numbers)
    return changed(model, **{model.MODELLED: function})


@pytest.mark.parametrize("kind", ["planar", "volumetric", "static"])
def test_a_display_answers_the_same_with_the_function_as_with_the_polynomial(kind: str) -> None:
    exact = DISPLAYS[kind]()
    found = of_function(exact)
    seen, expected = (each.view_dir_of_pixel(PIXEL, VIEWPOINT) for each in (found, exact))
    np.testing.assert_array_equal(seen.status, expected.status)
    np.testing.assert_allclose(seen.value, expected.value, atol=ANGLE)
    shown, expected_pixel = (each.pixel_of_view_dir(expected.value, VIEWPOINT) for each in (found, exact))
    np.testing.assert_array_equal(shown.status, expected_pixel.status)
    np.testing.assert_allclose(shown.value, PIXEL, atol=1e-6)
    moved = VIEWPOINT + 1e-4
    again = found.view_dir_of_pixel(PIXEL, moved, seen.warm_start)
    np.testing.assert_allclose(again.value, exact.view_dir_of_pixel(PIXEL, moved).value, atol=ANGLE)
    back = found.pixel_of_view_dir(again.value, moved, shown.warm_start)
    assert back.ok.all()
    np.testing.assert_allclose(back.value, PIXEL, atol=1e-6)


@pytest.mark.parametrize("kind", SEE_THROUGHS)
def test_a_see_through_model_answers_the_same_with_the_function_as_with_the_polynomial(kind: str) -> None:
    exact = SEE_THROUGHS[kind]()
    found = of_function(exact)
    seen, expected = (each.view_dir_of_real_point(POINT, VIEWPOINT) for each in (found, exact))
    np.testing.assert_array_equal(seen.status, expected.status)
    np.testing.assert_allclose(seen.value, expected.value, atol=ANGLE)
    ray, expected_ray = (each.real_ray_of_view_dir(expected.value, VIEWPOINT) for each in (found, exact))
    np.testing.assert_array_equal(ray.status, expected_ray.status)
    np.testing.assert_allclose(ray.value, expected_ray.value, atol=ANGLE)
    moved = VIEWPOINT + 1e-4
    again = found.view_dir_of_real_point(POINT, moved, seen.warm_start)
    np.testing.assert_allclose(again.value, exact.view_dir_of_real_point(POINT, moved).value, atol=ANGLE)
    assert found.contraction() == pytest.approx(exact.contraction(), rel=1e-5)


def test_the_backward_query_meets_a_pixel_of_a_function_that_rounds_coarsely() -> None:
    """A kernel regressor with large weights rounds at 1e-9: the solve must not ask for more, and converge."""
    exact = narrowed(DISPLAYS["planar"](), DisplayModel)
    polynomial = exact.forward
    noise = np.random.default_rng(1)

    def rounded(inputs: FloatArray) -> FloatArray:
        value = polynomial(inputs)
        return np.asarray(value + 1e-9 * noise.uniform(-1.0, 1.0, value.shape))

    function = NumericRegressor(rounded, polynomial.box, 2, 0, rounding=1e-9)
    found = changed(exact, forward=function)
    shown = found.pixel_of_view_dir(exact.view_dir_of_pixel(PIXEL, VIEWPOINT).value, VIEWPOINT)
    assert shown.ok.all()
    np.testing.assert_allclose(shown.value, PIXEL, atol=1e-4)

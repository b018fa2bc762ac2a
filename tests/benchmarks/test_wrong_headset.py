"""Surfaces with an error of their shape."""

from collections.abc import Sequence

import numpy as np
import pytest
from present import narrowed

from benchmarks.wrong_headset import misshapen
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.sag_surfaces import XYPolynomial
from wlr_render.optics.surfaces import Shape

_SMALL = 1e-4  # metres from the vertex: higher powers do not matter


def curvatures(shape: Shape) -> FloatArray:
    """Second derivatives (2,) of the sag along x and y at the vertex, 1/m."""
    x, of = np.array([0.0, _SMALL, -_SMALL]), narrowed(shape, XYPolynomial)
    along_x, along_y = of.sag_and_slopes(x, 0.0 * x)[0], of.sag_and_slopes(0.0 * x, x)[0]
    return np.array([(each[1] + each[2] - 2.0 * each[0]) / _SMALL**2 for each in (along_x, along_y)])


@pytest.mark.parametrize(
    ("coefficients", "curvature", "factors"),
    [
        ([[0.0], [0.0], [3.0]], 0.0, (1.002, 1.0)),
        ([[0.0, 0.0, 2.0]], 0.0, (1.0, 1.002)),  # flat along x
        ([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]], 5.0, (1.002, 1.0)),  # curved along x by its base
        ([[0.0, 1.0]], 5.0, (1.002, 1.0)),
        ([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [2.0, 0.0, 0.0]], 5.0, (1.002, 1.0)),
    ],
)
def test_a_misshapen_polynomial_has_another_curvature_at_its_vertex(
    coefficients: Sequence[list[float]], curvature: float, factors: tuple[float, float]
) -> None:
    shape = XYPolynomial(np.array(coefficients), curvature)
    expected = curvatures(shape) * np.array(factors)
    np.testing.assert_allclose(curvatures(misshapen(shape, 0.002)), expected, rtol=1e-6, atol=1e-7)
    assert misshapen(shape, 0.0) is shape


def test_a_polynomial_without_curvature_stays_as_it_is() -> None:
    plane = XYPolynomial(np.array([[0.0, 0.1]]))
    assert curvatures(misshapen(plane, 0.002)) == pytest.approx([0.0, 0.0])

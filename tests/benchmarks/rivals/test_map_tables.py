"""Tables and components of maps: functions that they reproduce."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from rival_samples import error_arcmin, grid_of_places, samples_of

from benchmarks.rivals.map_tables import (
    linear_table,
    principal_components,
    thin_plate_table,
)
from wlr_render.numerics.arrays import FloatArray

EXACT = 1e-6  # arcminutes
SIZE = 0.005


def in_millimetres(inputs: FloatArray) -> tuple[FloatArray, ...]:
    return inputs[:, 0], inputs[:, 1], *(inputs[:, 2:] / SIZE).T


def linear_in_place(inputs: FloatArray) -> FloatArray:
    """Tangents (n, 2) of maps that are cubic in the pixel and linear in the place."""
    u, v, x, y, *rest = in_millimetres(inputs)
    depth = rest[0] if rest else 0.0
    return np.column_stack([0.6 * u + 0.1 * u**2 * v + 0.03 * x * (1 + v), 0.5 * v + 0.02 * y * u**3 + 0.01 * depth])


def quadratic_in_place(inputs: FloatArray) -> FloatArray:
    """A mean map and three components, whose scores are of degrees 1, 1 and 2."""
    u, v, x, y = in_millimetres(inputs)
    return linear_in_place(inputs) + (x**2 + x * y)[:, None] * np.column_stack([0.02 * u - 0.01 * v**2, 0.02 * u * v])


def two_blocks(inputs: FloatArray) -> FloatArray:
    """A and B, (n, 4)."""
    return np.hstack([linear_in_place(inputs), 0.1 * linear_in_place(inputs)[:, ::-1]])


@pytest.mark.parametrize("blocks", [1, 2])
@pytest.mark.parametrize("fit", [linear_table, thin_plate_table, principal_components])
def test_a_table_of_a_map_that_is_linear_in_the_place_is_exact(fit: Callable[..., Any], blocks: int) -> None:
    truth = linear_in_place if blocks == 1 else two_blocks
    model = fit(samples_of(truth, grid_of_places(3), blocks=blocks))
    assert error_arcmin(model, truth) < EXACT
    assert model.outputs == 2 * blocks


def test_a_thin_plate_through_many_places_reproduces_quadratics() -> None:
    model = thin_plate_table(samples_of(quadratic_in_place, grid_of_places()))
    assert error_arcmin(model, quadratic_in_place, size=2 * SIZE) < EXACT


def test_components_recover_a_map_of_three_components() -> None:
    model = principal_components(samples_of(quadratic_in_place, grid_of_places()))
    assert error_arcmin(model, quadratic_in_place) < EXACT

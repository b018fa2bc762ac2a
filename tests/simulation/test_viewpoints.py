from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from wlr_render.errors import BadInputError
from wlr_render.geometry.planes import BasePlane
from wlr_render.mappings import EyeBox
from wlr_render.numerics.polynomial import Box, basis, term_count, total_degree
from wlr_render.simulation import viewpoints

BOX = EyeBox(np.array([0.032, 0.0, -0.03]), np.array([0.010, 0.008, 0.006]))
REACH = np.array([0.5, 1.2])


def test_planar_viewpoints_lie_in_the_plane_of_the_centre() -> None:
    points = viewpoints.planar(BOX, REACH, 25)
    assert points.shape == (25, 3)
    np.testing.assert_array_equal(points[:, 2], BOX.centre[2])


@pytest.mark.parametrize(("count", "share"), [(16, 0.8), (25, 0.85), (121, 0.95)])
def test_planar_region_covers_every_ray_through_the_eye_box(count: int, share: float) -> None:
    points = viewpoints.planar(BOX, REACH, count)
    corners = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3, [-1.0, 1.0], [-1.0, 1.0]), axis=-1).reshape(-1, 5)
    carried = BasePlane(BOX.centre[2]).carry(BOX.at(corners[:, :3]), REACH * corners[:, 3:])
    needed_low, needed_high = carried.min(axis=0), carried.max(axis=0)
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    # The outermost viewpoint touches the region's edge on each axis; the opposite edge is nearly reached.
    np.testing.assert_allclose(np.minimum(low - needed_low, needed_high - high), 0.0, atol=1e-12)
    assert np.all(high - low >= share * (needed_high - needed_low))


@pytest.mark.parametrize(("degree", "count"), [(3, 16), (4, 25), (5, 25), (6, 49), (7, 49)])
def test_planar_viewpoints_determine_the_degree(degree: int, count: int) -> None:
    points = viewpoints.planar(BOX, REACH, count)[:, :2]
    assert all(len(np.unique(points[:, axis])) >= degree + 1 for axis in (0, 1))
    assert np.linalg.cond(basis(points, total_degree(2, degree), Box.around(points))) < 50


@pytest.mark.parametrize("degree", [3, 5])
def test_volumetric_viewpoints_determine_the_degree_once_there_are_enough(degree: int) -> None:
    enough = viewpoints.volumetric(BOX, int(1.5 * term_count(3, degree)))
    assert np.all(BOX.contains(enough))
    assert np.linalg.cond(basis(enough, total_degree(3, degree), Box.around(enough))) < 100
    few = viewpoints.volumetric(BOX, term_count(3, degree) - 1)
    assert np.linalg.matrix_rank(basis(few, total_degree(3, degree), Box.around(few))) < term_count(3, degree)


def test_random_viewpoints_fill_the_eye_box() -> None:
    points = viewpoints.random_in_eye_box(BOX, 4000, np.random.default_rng(3))
    assert np.all(BOX.contains(points))
    np.testing.assert_allclose(points.mean(axis=0), BOX.centre, atol=2e-4)
    np.testing.assert_allclose(points.std(axis=0), BOX.size / np.sqrt(12.0), rtol=0.05)


def test_nominal_is_the_centre_alone() -> None:
    np.testing.assert_array_equal(viewpoints.nominal(BOX), BOX.centre[None])


@pytest.mark.parametrize("make", [lambda n: viewpoints.planar(BOX, REACH, n), lambda n: viewpoints.volumetric(BOX, n)])
def test_no_viewpoints_are_refused(make: Callable[..., Any]) -> None:
    with pytest.raises(BadInputError, match="number of viewpoints is 0"):
        make(0)

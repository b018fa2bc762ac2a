"""The direction in which a point is seen through the optics: solved from cold, and from a neighbour's solution."""

from dataclasses import replace

import numpy as np
import pytest

from wlr_render.bench.observed_points import ObservedPoints
from wlr_render.optics.device_file import load_device

COUNT = 50


def scene(device: str = "northstar", seed: int = 5) -> ObservedPoints:
    optics = load_device(device).eyes["right"]
    rng = np.random.default_rng(seed)
    viewpoint = optics.eye_box.centre + rng.uniform(-3e-3, 3e-3, (COUNT, 3))
    sight = np.column_stack([rng.uniform(-0.25, 0.2, COUNT), rng.uniform(-0.4, 0.1, COUNT), np.full(COUNT, -1.0)])
    return ObservedPoints(optics, 0.55, viewpoint, viewpoint + rng.uniform(0.3, 2.0, (COUNT, 1)) * sight)


@pytest.mark.parametrize("device", ["northstar", "birdbath28", "plane_plate", "no_optics"])
def test_the_ray_in_the_direction_solved_for_meets_the_point(device: str) -> None:
    here = scene(device)
    solved = here.solved()
    assert np.isfinite(solved).all(axis=1).mean() > 0.5
    assert np.nanmax(np.abs(here.miss(solved))) < 1e-12


def test_without_optics_the_miss_is_the_difference_of_tangents() -> None:
    here = scene("no_optics")
    straight = (here.point - here.viewpoint)[:, :2] / -(here.point - here.viewpoint)[:, 2:]
    tangents = np.random.default_rng(6).uniform(-0.5, 0.5, (COUNT, 2))
    np.testing.assert_allclose(here.miss(tangents), tangents - straight, atol=1e-12)
    inverse = here.tangents_from_miss(tangents)
    np.testing.assert_allclose(inverse, np.broadcast_to(np.eye(2), (COUNT, 2, 2)), atol=1e-9)


def test_rows_are_solved_and_missed_by_themselves() -> None:
    here, rows = scene(), np.array([3, 17, 4])
    np.testing.assert_allclose(here.solved(rows), here.solved()[rows], atol=1e-13)
    tangents = here.solved() + 1e-3
    np.testing.assert_array_equal(here.miss(tangents[rows], rows), here.miss(tangents)[rows])


def test_the_inverse_jacobian_is_that_of_central_differences() -> None:
    here = scene()
    tangents, step = here.solved(), 1e-4
    columns = [(here.miss(tangents + shift) - here.miss(tangents - shift)) / (2 * step) for shift in step * np.eye(2)]
    product = here.tangents_from_miss(tangents) @ np.stack(columns, axis=-1)
    np.testing.assert_allclose(product, np.broadcast_to(np.eye(2), product.shape), atol=1e-5)


@pytest.mark.parametrize("size", [1e-4, 1e-2, 0.2])
def test_following_a_neighbour_ends_where_a_cold_solve_does(size: float) -> None:
    here = scene()
    solved = here.solved()
    inverse = here.tangents_from_miss(solved)
    moved = replace(here, point=here.point + size * np.array([1.0, -0.5, 0.7]))
    np.testing.assert_allclose(moved.solved_from(solved, inverse), moved.solved(), atol=1e-11)


def test_rows_that_the_neighbour_does_not_see_or_misleads_are_solved_from_cold() -> None:
    here = scene()
    solved = here.solved()
    inverse = here.tangents_from_miss(solved)
    lost, misled = solved.copy(), inverse.copy()
    lost[:5] = np.nan
    misled[5:10] *= -1.0  # leads away from the point
    misled[10:12] = np.nan
    start = lost.copy()
    np.testing.assert_allclose(here.solved_from(lost + 1e-3, misled), solved, atol=1e-11)
    np.testing.assert_array_equal(lost, start)


def test_points_behind_the_eye_are_not_seen() -> None:
    here = scene()
    behind = replace(here, point=2 * here.viewpoint - here.point)
    assert np.isnan(behind.solved()).all()
    assert np.isnan(behind.solved_from(np.full((COUNT, 2), np.nan), np.full((COUNT, 2, 2), np.nan))).all()


def test_a_follower_keeps_points_that_come_to_lie_past_an_aperture_and_a_cold_solve_does_not() -> None:
    """Where the edge of an aperture is, is no part of what is measured: a fit must not lose its readings there."""
    here = scene()
    solved = here.solved()
    moved = replace(here, point=here.point + 3.0 * (here.point - here.viewpoint) * [1.0, 1.0, 0.0])
    cold = moved.solved()
    solved_from = moved.solved_from(solved, here.tangents_from_miss(solved))
    hidden = np.isnan(cold).any(axis=1)
    assert 0 < hidden.sum() < COUNT
    np.testing.assert_allclose(solved_from[~hidden], cold[~hidden], atol=1e-11)
    assert np.abs(moved.miss(solved_from)).max() < 1e-11

"""Radii and shares of populations of normal errors."""

import numpy as np
import pytest

from wlr_render.budget.statement import by_owner, radius_within, region_of, shares
from wlr_render.mappings import Panel


def test_radius_of_a_round_error_is_rayleighs() -> None:
    radius = radius_within(np.array([[[4.0, 0.0], [0.0, 4.0]]]))
    assert radius == pytest.approx(2.0 * np.sqrt(-2.0 * np.log(0.05)), rel=1e-6)


def test_radius_along_one_axis_is_the_normal_quantile() -> None:
    assert radius_within(np.diag([9.0, 0.0])[None]) == pytest.approx(3.0 * 1.96, rel=0.01)


def test_radius_of_a_mixture_agrees_with_draws() -> None:
    rng = np.random.default_rng(2)
    roots = rng.normal(size=(5, 2, 2))
    errors = np.einsum("nij,ndj->ndi", roots, rng.normal(size=(5, 100_000, 2)))
    drawn = np.quantile(np.linalg.norm(errors, axis=-1), 0.95)
    covariance = roots @ roots.transpose(0, 2, 1)
    assert radius_within(covariance) == pytest.approx(drawn, rel=0.01)
    with_missing = np.concatenate([covariance, np.full((2, 2, 2), np.nan)])
    assert radius_within(with_missing) == radius_within(covariance)


def test_shares_add_up_and_the_largest_comes_first() -> None:
    by_source = {"a: one": np.eye(2)[None], "a: two": 2.0 * np.eye(2)[None], "b: one": 5.0 * np.eye(2)[None]}
    found = shares(by_source)
    assert [each.name for each in found] == ["b: one", "a: two", "a: one"]
    assert sum(each.share for each in found) == pytest.approx(1.0)
    halved = np.sqrt((3.0 + 5.0 / 4.0) / 8.0) * radius_within(8.0 * np.eye(2)[None])
    assert found[0].radius_if_halved_arcmin == pytest.approx(halved)
    assert [each.share for each in shares(by_owner(by_source))] == pytest.approx([5 / 8, 3 / 8])


def test_regions_of_a_panel() -> None:
    pixel = np.array([[50.0, 25.0], [5.0, 25.0], [50.0, 48.0], [95.0, 2.0]])
    assert region_of(Panel(100, 50), pixel).tolist() == [0, 1, 1, 2]

"""Noise that neighbours share: found where it is, and made white."""

import numpy as np
import pytest

from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.evidence import Sums
from wlr_render.numerics.shared_noise import SharedNoise, find_shared_noise, neighbour_distance

PLACE = np.stack(np.meshgrid(np.arange(12.0), np.arange(10.0)), axis=-1).reshape(-1, 2)
PHOTOGRAPHS = 12


def sure(number: object, rows: IntArray) -> FloatArray:
    return np.zeros((len(rows), 0))


def photographs(noise: SharedNoise, seed: int) -> FloatArray:
    """Noise with an exponential correlation, which the Matern field is not."""
    rng = np.random.default_rng(seed)
    apart = np.linalg.norm(PLACE[:, None] - PLACE, axis=-1)
    covariance = (1 - noise.share) * np.eye(len(PLACE)) + noise.share * np.exp(-apart / noise.length)
    return np.linalg.cholesky(covariance) @ rng.normal(size=(PHOTOGRAPHS, len(PLACE), 2))


@pytest.mark.parametrize("share", [0.3, 0.6])
def test_shared_noise_is_found(share: float) -> None:
    found = find_shared_noise([PLACE] * PHOTOGRAPHS, list(photographs(SharedNoise(share, 1.5), 1)), sure)
    assert found is not None
    assert 0.6 * share < found.share < 1.4 * share
    assert 0.7 < found.length < 3.0


def test_the_mean_of_noise_of_short_reach_is_nearly_as_good_as_it_is() -> None:
    """White noise smoothed by a cone: a field of neither class, and of no tail."""
    node = np.stack(np.meshgrid(np.arange(-4.0, 16.0, 0.5), np.arange(-4.0, 14.0, 0.5)), axis=-1).reshape(-1, 2)
    near = np.maximum(1.0 - np.linalg.norm(PLACE[:, None] - node, axis=-1) / 2.5, 0.0)
    root = near / np.linalg.norm(near, axis=1, keepdims=True)
    middle = np.flatnonzero(np.all(PLACE == 5.0, axis=1))[0]
    of_mean = []
    for rng in map(np.random.default_rng, range(4)):
        white, of_node = (rng.normal(size=(PHOTOGRAPHS, len(place), 2)) for place in (PLACE, node))
        found = find_shared_noise([PLACE] * PHOTOGRAPHS, list(np.sqrt(0.5) * (white + root @ of_node)), sure)
        assert found is not None
        assert found.share == pytest.approx(0.5, abs=0.15)
        of_mean.append(found.share * found.correlation(PLACE)[middle].sum())
    assert np.mean(of_mean) == pytest.approx(0.5 * (root @ root.T)[middle].sum(), rel=0.5)


@pytest.mark.parametrize("seed", range(5))
def test_white_noise_is_not_shared(seed: int) -> None:
    white = list(np.random.default_rng(seed).normal(size=(PHOTOGRAPHS, len(PLACE), 2)))
    assert find_shared_noise([PLACE] * PHOTOGRAPHS, white, sure) is None


def test_what_a_fit_followed_is_missed_unless_it_is_told() -> None:
    """A fit that removes smooth waves from the residuals states how unsure it is of them."""
    seen = photographs(SharedNoise(0.5, 2.0), 2)
    waves = np.cos(np.pi * (PLACE[:, :1] + 0.5) / 12 * np.arange(6))[:, :, None]
    waves = (waves * np.cos(np.pi * (PLACE[:, 1:] + 0.5) / 10 * np.arange(6))[:, None]).reshape(len(PLACE), -1)
    waves = np.linalg.qr(waves)[0]
    left = [each - waves @ (waves.T @ each) for each in seen]
    blind = find_shared_noise([PLACE] * PHOTOGRAPHS, left, sure)
    told = find_shared_noise([PLACE] * PHOTOGRAPHS, left, lambda number, rows: 2.0 * waves[rows])
    assert told is not None
    assert blind is None or blind.share < told.share


def test_the_root_makes_noise_white_and_leaves_outliers_out() -> None:
    noise, kept = SharedNoise(0.4, 1.5), np.ones(len(PLACE))
    kept[[3, 40]] = 0.0
    root = noise.root(PLACE, kept)
    covariance = 0.4 * noise.correlation(PLACE) + 0.6 * np.eye(len(PLACE))
    np.testing.assert_allclose(root @ covariance @ root.T, np.diag(kept), atol=1e-12)
    assert neighbour_distance([PLACE]) == 1.0


def test_sums_of_readings_that_share_noise_are_those_of_their_inverse_covariance() -> None:
    rng = np.random.default_rng(0)
    noise, weight = SharedNoise(0.4, 1.5), rng.uniform(0.5, 2.0, len(PLACE))
    value, design, grouped = (rng.normal(size=(len(PLACE), *shape)) for shape in ((2,), (5,), (2, 3)))
    sums = Sums(5, 2, 0, 1, 3)
    root = noise.root(PLACE, np.ones(len(PLACE))) * weight
    sums.add(value, [root], design)
    sums.add_side(value, [root], design, None, grouped, np.zeros(len(PLACE), int))
    covariance = (0.4 * noise.correlation(PLACE) + 0.6 * np.eye(len(PLACE))) / weight / weight[:, None]
    inverse = np.linalg.inv(covariance)
    np.testing.assert_allclose(sums.gram, design.T @ inverse @ design)
    np.testing.assert_allclose(sums.moment, value.T @ inverse @ design)
    np.testing.assert_allclose(sums.side_gram, sum(grouped[:, k].T @ inverse @ grouped[:, k] for k in (0, 1)))
    np.testing.assert_allclose(sums.side_cross[1], grouped[:, 1].T @ inverse @ design)
    assert sums.count == value.size
    assert sums.log_weight == pytest.approx(-np.linalg.slogdet(covariance)[1])

"""Errors that readings share are taken apart: against dense covariances, and against a field of another law."""

import numpy as np
import pytest
from diagnosis.small_session import measured, weighed
from oracle.nature import smooth_field

from wlr_render.bench.bench import Bench
from wlr_render.captures.session import SessionPlan
from wlr_render.diagnosis.observations import DISPLAY
from wlr_render.diagnosis.weighed_readings import Whitening, shared_noise_whitening
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.scatter import Scatter


def matrix(whitening: Whitening, count: int) -> FloatArray:
    """The linear map of `count` readings as a dense matrix."""
    unit = np.eye(2 * count).reshape(count, 2, 2 * count)
    return whitening(unit).reshape(2 * count, 2 * count)


def test_groups_with_common_errors_become_independent() -> None:
    rng = np.random.default_rng(1)
    rows = [np.array([4, 0, 7]), np.array([1, 2, 3, 5, 6])]
    effects = [rng.normal(size=(3, 2, 2)), 3.0 * rng.normal(size=(5, 2, 4))]
    white = Whitening(np.ones(9)).then(rows, effects)
    covariance = np.eye(18).reshape(9, 2, 9, 2)
    for mine, effect in zip(rows, effects, strict=True):
        covariance[np.ix_(mine, np.arange(2), mine, np.arange(2))] += np.einsum("aik,bjk->aibj", effect, effect)
    found = matrix(white, 9)
    np.testing.assert_allclose(found @ covariance.reshape(18, 18) @ found.T, np.eye(18), atol=1e-9)
    values = rng.normal(size=(9, 2))
    np.testing.assert_allclose(white(values), (found @ values.ravel()).reshape(9, 2))


def test_then_composes(bench: Bench, plan: SessionPlan) -> None:
    """First the noise that neighbours share, then motions of what that leaves."""
    observations = measured(bench, plan)
    some = observations.of_rows(observations.group < 2)
    readings = weighed(some, shared=0.6, reach_px=150.0)
    first = shared_noise_whitening(some, readings.noise)
    assert len(first.groups) == 2
    rows, effect = np.flatnonzero(some.group == 1), np.random.default_rng(2).normal(size=(56, 2, 3))
    both = first.then([rows], [effect])
    common = np.zeros((2 * len(some), 3))
    common[(2 * rows[:, None] + [0, 1]).ravel()] = effect.reshape(-1, 3)
    outer = np.eye(len(common)) + common @ common.T
    inner, whole = matrix(first, len(some)), matrix(both, len(some))
    # Their map is the second's after the first's.
    second = whole @ np.linalg.inv(inner)
    np.testing.assert_allclose(second @ outer @ second.T, np.eye(len(outer)), atol=1e-8)


def test_motions_of_captures_are_taken_apart(bench: Bench, plan: SessionPlan) -> None:
    observations = measured(bench, plan)
    some = observations.of_rows(np.isin(observations.group, [0, 1, 20]))
    readings = weighed(some)
    scatter = Scatter(
        np.array([1.5, 1.0, 1.0]), np.array([30.0, 12.0, 1.0]), np.array([80.0, 20.0, 1.0]), np.arange(36) == 1
    )
    covariance = np.zeros((2 * len(some),) * 2)
    covariance[np.diag_indices_from(covariance)] = np.where(some.part == DISPLAY, 1.5**2, 1.0).repeat(2)
    for number, (shift, turn) in {0: (30.0, 80.0), 1: (np.hypot(30, 1000), np.hypot(80, 8000)), 20: (12, 20)}.items():
        mine = (some.group == number).repeat(2)[:, None]
        effect = np.where(mine, readings.motions.reshape(-1, 6) * np.repeat([shift, turn], 3), 0.0)
        covariance += effect @ effect.T
    found = matrix(readings.whitening(scatter), len(some))
    # Directions in which a motion has a ten thousandth of the noise's variance are left as they are.
    np.testing.assert_allclose(found @ covariance @ found.T, np.eye(len(covariance)), atol=1e-3)


@pytest.mark.parametrize("share", [0.3, 0.7])
def test_a_field_that_neighbours_share_is_whitened(bench: Bench, plan: SessionPlan, share: float) -> None:
    """The oracle's field is no draw of the model's: of what is smooth, the variance is nearly one after whitening."""
    observations = measured(bench, plan)
    observations = observations.of_rows(observations.part == DISPLAY)
    reach = 1.5 * 88.0
    white = shared_noise_whitening(observations, weighed(observations, share, reach).noise)
    place = observations.image_place - observations.image_place.mean(axis=0)
    design = np.column_stack([np.ones(len(place)), place])
    raw: list[FloatArray] = []
    left: list[FloatArray] = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        field = smooth_field(observations.image_place, observations.photograph, reach, rng)
        noise = np.sqrt(share) * field + np.sqrt(1 - share) * rng.normal(size=field.shape)
        for values, columns, kept in ((noise, design, raw), (white(noise), white(np.stack([design] * 2, 1)), left)):
            for number in range(6):
                rows = observations.group == number
                x = columns[rows] if columns.ndim == 2 else columns[rows][:, 0]
                kept.append(np.linalg.inv(np.linalg.cholesky(x.T @ x)) @ (x.T @ values[rows]))
    assert np.mean(np.square(raw)) > 2.0
    assert np.mean(np.square(left)) == pytest.approx(1.0, abs=0.35)


def test_nothing_shared_leaves_values_as_they_are(bench: Bench, plan: SessionPlan) -> None:
    observations = measured(bench, plan)
    values = np.random.default_rng(1).normal(size=(len(observations), 2, 3))
    readings = weighed(observations)
    np.testing.assert_array_equal(readings.shared(values), values)

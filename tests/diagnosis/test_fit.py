"""Fits: what was injected comes back, also from far away; and the error bars say how well."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from diagnosis.small_session import SIGMA_PX, explanation, fitted_at_rest, measured, with_noise
from numpy.typing import ArrayLike, NDArray
from present import present

from wlr_render.bench.bench import Bench
from wlr_render.captures.session import SessionPlan
from wlr_render.diagnosis.cause import Cause, Parameter, Role
from wlr_render.diagnosis.causes import CAUSES
from wlr_render.diagnosis.fit import Fit
from wlr_render.diagnosis.prediction import Explanation, Hypothesis
from wlr_render.errors import BadInputError
from wlr_render.numerics.arrays import FloatArray

# Forms and moments cannot be drawn at a share of their prior sigma; and from where a fit of them sets out.
VALUES = {
    "see_through_plate": [8.0, 5.0, -4.0],
    "thermal_drift": [0.08, -0.05, 500.0],
    "headset_slip": [0.3, 0.2, -0.4, 0.1, 0.2, -0.1, 1290.0],
    "combiner_dent": [4.0, 5.0, -4.0, 4.0],
}
STARTS = {
    "see_through_plate": [2.0, 0.0, 0.0],
    "headset_slip": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1290.0],
    "combiner_dent": [0.0, 7.0, -7.0, 5.0],
}
DRAWS = 12


def drawn_by_prior(found: Fit | None, true: ArrayLike) -> FloatArray:
    """By how much the prior draws the free values of a fit without noise; moments have no mean."""
    assert found is not None
    parameters = found.explanation.parameters()
    mean = np.array([p.starts[0] if p.role is Role.SHAPE else p.prior_mean for p in parameters])
    prior_sigma = np.array([p.prior_sigma for p in parameters])
    off = np.where([p.role is Role.TIME for p in parameters], 0.0, (np.asarray(true) - mean) / prior_sigma)
    drawn, free = np.zeros(len(off)), found.at.free
    drawn[free] = prior_sigma[free] * (found.covariance @ off[free])
    return drawn


def assert_came_back(found: Fit | None, true: ArrayLike) -> None:
    """The posterior mean: the truth, drawn by the prior, by less than one standard error."""
    assert found is not None
    drawn, sigmas = drawn_by_prior(found, true), found.sigmas()
    np.testing.assert_array_less(np.abs(found.explanation.vector() - np.asarray(true) + drawn), 0.03 * sigmas + 1e-9)
    np.testing.assert_array_less(np.abs(drawn)[found.at.free], sigmas[found.at.free])


def injected(cause: Cause) -> NDArray[Any]:
    sizes = [0.8 * p.prior_sigma * (-1) ** number for number, p in enumerate(cause.parameters)]
    return np.array(VALUES.get(cause.name, sizes))


@pytest.mark.parametrize("cause", CAUSES.values(), ids=CAUSES)
def test_what_was_injected_comes_back(bench: Bench, plan: SessionPlan, run_time: SessionPlan, cause: Cause) -> None:
    """Without noise: from nothing, through whatever is not linear on the way, to where the prior draws the truth."""
    session, true = run_time if cause.part in ("eye tracking", "clock") else plan, injected(cause)
    observations = measured(bench, session, 0.0, 0, **{cause.name: true})
    observations = observations.of_rows(observations.spread(800))
    found = fitted_at_rest(observations, explanation(**{cause.name: STARTS.get(cause.name, cause.null())}))
    assert_came_back(found, true)


def test_where_readings_tell_little_the_prior_draws_as_in_linear_regression(bench: Bench, plan: SessionPlan) -> None:
    """Ten readings of a turned panel: the posterior mean lies between the truth and nothing."""
    true = [1.0, -1.0, 1.0]
    observations = measured(bench, plan, panel_rotation=true)
    observations = observations.of_rows(observations.spread(10)).with_sigma(np.full(10, 5.0))
    # From beyond the truth, so that the first step must know of the prior.
    found = fitted_at_rest(observations, explanation(panel_rotation=[3.0, -3.0, 3.0]))
    drawn = drawn_by_prior(found, true)
    assert found is not None
    assert np.max(np.abs(drawn) / found.sigmas()) > 0.3
    np.testing.assert_array_less(np.abs(found.explanation.vector() - true + drawn), 0.05 * found.sigmas())


def test_error_bars_are_honest(bench: Bench, plan: SessionPlan) -> None:
    """Over draws of the noise, (estimate - truth) weighted by the stated covariance is chi-squared distributed."""
    names = ("combiner_tilt", "target_scale", "thermal_drift")
    truth = explanation(**{name: injected(CAUSES[name]) for name in names})
    exact = measured(bench, plan, 0.0, 0, **dict(zip(truth.names, truth.values, strict=True)))
    exact = exact.of_rows(exact.spread(240))
    prior_sigma = np.array([parameter.prior_sigma for parameter in truth.parameters()])
    total, within = 0.0, []
    for seed in range(DRAWS):
        found = fitted_at_rest(with_noise(exact, SIGMA_PX, np.random.default_rng(seed)), truth)
        assert found is not None
        off = (found.explanation.vector() - truth.vector()) / prior_sigma
        total += off @ np.linalg.solve(found.covariance, off)
        within.append(np.abs(found.explanation.vector() - truth.vector()) < found.sigmas())
    degrees = DRAWS * len(prior_sigma)
    assert abs(total - degrees) < 3 * np.sqrt(2 * degrees)
    assert abs(np.mean(within) - 0.683) < 3 * np.sqrt(0.683 * 0.317 / DRAWS)


def test_twice_the_noise_makes_error_bars_twice_as_wide(bench: Bench, plan: SessionPlan) -> None:
    observations = measured(bench, plan, 0.1, panel_shift=[0.3, 0.3])
    one = fitted_at_rest(observations, explanation(panel_shift=[0.0, 0.0]))
    two = fitted_at_rest(observations.with_sigma(2 * observations.sigma_px), explanation(panel_shift=[0.0, 0.0]))
    assert two is not None
    assert one is not None
    np.testing.assert_allclose(
        two.explanation.vector(), one.explanation.vector(), atol=1e-3 * present(one).sigmas().min()
    )
    np.testing.assert_allclose(two.sigmas(), 2 * one.sigmas(), rtol=1e-4)
    assert two.chi_squared == pytest.approx(one.chi_squared / 4, rel=1e-6)


def test_nothing_to_fit_leaves_the_residual(bench: Bench, plan: SessionPlan) -> None:
    observations = measured(bench, plan, SIGMA_PX, seed=4)
    found = fitted_at_rest(observations, Explanation())
    degrees = 2 * len(observations)
    assert found is not None
    assert abs(found.chi_squared - degrees) < 4 * np.sqrt(2 * degrees)
    assert found.covariance.shape == (0, 0)
    assert len(found.sigmas()) == 0


def test_a_cause_that_the_session_cannot_see_stays_where_it_is(bench: Bench, plan: SessionPlan) -> None:
    found = fitted_at_rest(measured(bench, plan, SIGMA_PX), explanation(latency=[3.0], target_scale=[0.0, 0.0]))
    assert found is not None
    assert found.explanation.values[0] == 3.0
    assert found.sigmas()[0] == 0.0
    assert np.all(found.sigmas()[1:] > 0)


def test_no_iterations_only_look(bench: Bench, plan: SessionPlan) -> None:
    observations = measured(bench, plan, panel_shift=[0.3, 0.3])
    found = fitted_at_rest(observations, explanation(panel_shift=[0.1, 0.0]), iterations=0)
    assert found is not None
    np.testing.assert_array_equal(found.explanation.vector(), [0.1, 0.0])
    assert np.all(found.sigmas() > 0)


def test_a_step_that_no_headset_can_take_is_a_shorter_one(bench: Bench, plan: SessionPlan) -> None:
    """The function of a cause refuses what is beyond 0.2; the truth is 0.5."""

    def refusing(old: Bench, px: FloatArray) -> Bench:
        if abs(px[0]) > 0.2:
            raise BadInputError("device: the panel is not seen from most of the eye box")
        return replace(old, readout=replace(old.readout, origin_px=old.readout.origin_px + px))

    cause = Cause("origin", "origin", "device", (Parameter("u", "px", 0.5),), "s", "m", {"v": refusing})
    observations = measured(bench, plan, pixel_origin=[0.5, 0.0])
    observations = observations.of_rows(observations.spread(300))
    (value,) = present(fitted_at_rest(observations, Explanation().plus(Hypothesis(cause, "v")))).explanation.values
    assert 0.0 < value[0] <= 0.2
    beyond = Explanation().plus(Hypothesis(cause, "v"), np.array([0.3]))
    assert fitted_at_rest(observations, beyond) is None

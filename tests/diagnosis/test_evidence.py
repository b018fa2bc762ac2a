"""What a cause must pay for: Occam's razor, whole steps, and chance."""

from dataclasses import replace

import numpy as np
import pytest
from small_session import SIGMA_PX, explanation, measured

from wlr_render.diagnosis.fit import fit, is_physical, minus_two_log_evidence, p_value, reduced_chi_squared
from wlr_render.diagnosis.prediction import Explanation, Predictor


def fits(observations, *starts):
    predictor, used = Predictor(observations), np.ones(len(observations), dtype=bool)
    return [fit(predictor, start, used) for start in starts]


def costs(observations, *starts):
    return [minus_two_log_evidence(found) for found in fits(observations, *starts)]


@pytest.fixture(scope="module")
def tilted(bench, plan):
    return measured(bench, plan, SIGMA_PX, seed=7, combiner_tilt=[0.3, -0.2, 0.3])


def test_reduced_chi_squared_is_one_at_the_noise_and_more_above(tilted):
    nothing, tilt = fits(tilted, Explanation(), explanation(combiner_tilt=[0, 0, 0]))
    assert reduced_chi_squared(nothing) > 100
    assert reduced_chi_squared(tilt) == pytest.approx(1.0, abs=4 * np.sqrt(2 / (2 * len(tilted))))


@pytest.mark.parametrize("richer", [{"panel_rotation": [0, 0, 0]}, {"stage_tilt": [0, 0, 0]}, {"target_bow": [0, 0]}])
def test_a_true_cause_costs_less_than_one_that_nests_it(tilted, richer):
    true, more = fits(tilted, explanation(combiner_tilt=[0, 0, 0]), explanation(combiner_tilt=[0, 0, 0], **richer))
    assert more.chi_squared < true.chi_squared
    assert minus_two_log_evidence(true) < minus_two_log_evidence(more) - 4


def test_a_true_cause_costs_less_than_its_spurious_matches_and_than_nothing(tilted):
    found = costs(
        tilted,
        explanation(combiner_tilt=[0, 0, 0]),
        explanation(panel_shift=[0, 0]),
        explanation(combiner_shift=[0, 0, 0]),
        Explanation(),
    )
    assert found[0] < min(found[1:]) - 40


def test_without_an_effect_nothing_costs_least(bench, plan):
    clean = measured(bench, plan, SIGMA_PX, seed=8)
    nothing, *others = costs(
        clean,
        Explanation(),
        explanation(panel_shift=[0, 0]),
        explanation(combiner_tilt=[0, 0, 0]),
        explanation(pixel_origin=[0, 0]),
        explanation(stage_backlash=[0]),
    )
    assert nothing < min(others)


@pytest.mark.parametrize("offset", [[0.5, -0.5], [0.5, 0.0], [-1.0, 0.5]])
def test_offsets_of_half_pixels_are_counted_wrong(bench, plan, offset):
    origin, shift = costs(
        measured(bench, plan, SIGMA_PX, seed=9, pixel_origin=offset),
        explanation(pixel_origin=[0, 0]),
        explanation(panel_shift=[0, 0]),
    )
    assert origin < shift - 10


@pytest.mark.parametrize("offset", [[0.37, 0.21], [0.5, 0.25], [0.6, -0.1]])
def test_offsets_of_other_sizes_are_shifts_of_the_panel(bench, plan, offset):
    origin, shift = costs(
        measured(bench, plan, SIGMA_PX, seed=9, pixel_origin=offset),
        explanation(pixel_origin=[0, 0]),
        explanation(panel_shift=[0, 0]),
    )
    assert shift < origin - 10


def test_one_part_explained_wholly_is_worth_more_than_a_little_of_both(tilted):
    """What is left in a part counts as noise of that part: 1000 values each, of which 9 and 4 sigma are left."""
    (base,) = fits(tilted, Explanation())
    wholly = replace(base, by_part=((1000, 9_000.0), (1000, 1_000.0)), chi_squared=10_000.0)
    little = replace(base, by_part=((1000, 4_500.0), (1000, 4_500.0)), chi_squared=9_000.0)
    assert minus_two_log_evidence(wholly) < minus_two_log_evidence(little)


@pytest.mark.parametrize(("thickness_mm", "physical"), [(2.0, True), (-2.0, False)])
def test_a_negative_thickness_is_not_physical_beyond_its_error(bench, plan, thickness_mm, physical):
    observations = measured(bench, plan, SIGMA_PX, seed=10, see_through_plate=[thickness_mm, 0, 0])
    (found,) = fits(observations, explanation(see_through_plate=[0.5, 0, 0]))
    assert is_physical(found) is physical


def test_chance_is_the_tail_of_chi_squared_times_the_tries():
    assert p_value(10.83, 1, 1) == pytest.approx(1e-3, rel=0.01)  # textbook quantiles
    assert p_value(18.47, 4, 1) == pytest.approx(1e-3, rel=0.01)
    assert p_value(10.83, 1, 30) == pytest.approx(0.03, rel=0.01)
    assert p_value(1.0, 3, 40) == 1.0
    assert p_value(-5.0, 3, 1) == 1.0


def test_the_evidence_is_the_marginal_likelihood_of_a_linear_model(tilted):
    """Against the closed form of Bayesian linear regression, -2 log N(residual; 0, 1 + J J^T), of noise 1."""
    (found,) = fits(tilted, explanation(combiner_tilt=[0, 0, 0]))
    rng = np.random.default_rng(1)
    jacobian, count = rng.normal(0, 0.4, (60, 2, 3)), 120
    flat = jacobian.reshape(count, 3)
    sizes = np.array([0.7, -1.1, 0.4])
    measured_values = flat @ sizes + rng.normal(0, 1, count)
    # The noise must not be profiled: less is left than sigma would give.
    posterior = np.linalg.solve(flat.T @ flat + np.eye(3), flat.T @ measured_values)
    measured_values = flat @ posterior + 0.9 * (measured_values - flat @ posterior)
    solution = np.linalg.solve(flat.T @ flat + np.eye(3), flat.T @ measured_values)
    left = measured_values - flat @ solution
    prior_sigma = np.array([parameter.prior_sigma for parameter in found.explanation.parameters()])
    linear = replace(
        found,
        explanation=found.explanation.at(solution * prior_sigma),
        chi_squared=float(left @ left),
        by_part=((count, float(left @ left)),),
        information=flat.T @ flat,
    )
    covariance = np.eye(count) + flat @ flat.T
    expected = measured_values @ np.linalg.solve(covariance, measured_values) + np.linalg.slogdet(covariance)[1]
    assert minus_two_log_evidence(linear) == pytest.approx(expected, rel=1e-9)

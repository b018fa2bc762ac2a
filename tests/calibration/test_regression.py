import numpy as np
import pytest

from wlr_render.calibration.coverage import missing_coverage
from wlr_render.calibration.fit_report import Residuals
from wlr_render.calibration.regression import Regression, angular_metric, fit, relative_sigma
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import arcmin_between, dir_of_tangents
from wlr_render.numerics.least_squares import RankDeficientError
from wlr_render.numerics.polynomial import basis, total_degree

RNG = np.random.default_rng(11)


def noisy_deviation(count=600, groups=10):
    inputs = RNG.uniform(-1, 1, (count, 2))
    inverse_depth = RNG.uniform(0.3, 3.0, (count, 1, 1))
    multiplier = np.concatenate([np.ones_like(inverse_depth), inverse_depth], axis=2)
    observed = np.stack([np.sin(inputs[:, 0]) + multiplier[:, 0, 1] * inputs[:, 1] ** 3, inputs.prod(axis=1)], axis=1)
    observed = observed + 0.01 * RNG.normal(size=observed.shape)
    sigma = RNG.uniform(0.5, 2.0, count)
    metric = RNG.uniform(1.0, 3.0, count)
    return Regression(inputs, observed[:, None], multiplier, metric, sigma, RNG.integers(0, groups, count))


def plain_design(regression, degree, box):
    phi = basis(regression.inputs, total_degree(regression.inputs.shape[1], degree), box)
    return np.hstack([phi * regression.multiplier[:, 0, b : b + 1] for b in range(regression.blocks)])


@pytest.mark.parametrize("degree", [1, 3])
def test_compressed_fit_equals_plain_least_squares_on_all_rows(degree):
    regression = noisy_deviation()
    fitted = fit(regression, degree)
    design = plain_design(regression, degree, fitted.polynomial.box)
    weight = (regression.metric / regression.sigma)[:, None]
    plain, *_ = np.linalg.lstsq(design * weight, regression.observed[:, 0] * weight)
    np.testing.assert_allclose(fitted.polynomial.coefficients, np.hstack(np.split(plain, 2)), atol=1e-12)


def test_held_out_error_equals_leaving_each_group_out_by_hand():
    regression = noisy_deviation(groups=5)  # fewer groups than folds: each fold is one group
    fitted = fit(regression, None)
    assert [entry.degree for entry in fitted.held_out] == [1, 2, 3, 4, 5, 6, 7]
    for entry in fitted.held_out:
        design = plain_design(regression, entry.degree, fitted.polynomial.box)
        weight = (regression.metric / regression.sigma)[:, None]
        mean_squares, total = [], 0.0
        for group in range(5):
            left, kept = regression.group == group, regression.group != group
            c, *_ = np.linalg.lstsq((design * weight)[kept], (regression.observed[:, 0] * weight)[kept])
            squares = np.sum((weight * (design @ c - regression.observed[:, 0]))[left] ** 2)
            mean_squares.append(squares / np.sum(regression.sigma[left] ** -2))
            total += squares
        rms = np.sqrt(total / np.sum(regression.sigma**-2))
        assert entry.rms == pytest.approx(rms, rel=1e-9)
        assert entry.standard_error == pytest.approx(np.std(mean_squares, ddof=1) / np.sqrt(5) / (2 * rms), rel=1e-9)


def test_lowest_degree_within_one_standard_error_of_the_best_is_taken():
    fitted = fit(noisy_deviation(), None)
    best = min(fitted.held_out, key=lambda entry: entry.rms)
    passed_over = [e for e in fitted.held_out if e.degree < fitted.degree]
    assert fitted.degree == 3
    assert all(entry.rms > best.rms + best.standard_error for entry in passed_over)


def test_groups_leave_whole():
    """One group has a bias of its own; leaving single rows out would let its other rows predict it."""
    regression = noisy_deviation(groups=5)
    biased = regression.observed + np.where(regression.group == 2, 1.0, 0.0)[:, None, None]
    inputs = np.hstack([regression.inputs, regression.group[:, None] == 2]).astype(float)
    arguments = (biased, regression.multiplier, regression.metric, regression.sigma)
    assert fit(Regression(inputs, *arguments, regression.group), 1).held_out == ()
    assert len(fit(Regression(inputs, *arguments, np.arange(len(inputs))), 1).held_out) == 1


def test_fewer_rows_than_terms_are_refused():
    with pytest.raises(RankDeficientError):
        fit(noisy_deviation(count=10), 3)


@pytest.mark.parametrize("tangents", [[0.0, 0.0], [0.5, 0.0], [-0.3, 0.4]])
def test_angular_metric_lies_between_the_radial_and_the_transverse_step(tangents):
    tangents, step = np.array(tangents), 1e-6
    radial = tangents / max(np.linalg.norm(tangents), 1e-9) if tangents.any() else np.array([1.0, 0.0])
    across = np.array([-radial[1], radial[0]])
    here = dir_of_tangents(tangents)
    rates = [arcmin_between(dir_of_tangents(tangents + step * d), here) / step for d in (radial, across)]
    assert angular_metric(tangents[None])[0] == pytest.approx(np.sqrt(np.prod(rates)), rel=1e-5)


def test_exact_data_are_weighted_equally():
    np.testing.assert_array_equal(relative_sigma(np.zeros(3)), np.ones(3))
    np.testing.assert_array_equal(relative_sigma(np.array([0.5, 2.0])), [0.5, 2.0])


def test_shortage_is_silent_where_samples_suffice_and_repetitions_do_not_count():
    spread = RNG.uniform(-1, 1, (10, 2))
    assert missing_coverage("viewpoints", spread, "xy", 3) is None
    assert "there are 9: 1 more" in missing_coverage("viewpoints", np.tile(spread[:9], (4, 1)) + 1e-9, "xy", 3)
    assert "there are 1: 2 more" in missing_coverage("viewpoints", np.zeros((5, 2)), "xy", 1)


def test_residual_sizes_leave_out_what_has_no_value():
    size = np.array([3.0, np.nan, 4.0])
    assert Residuals.of(size) == Residuals(np.sqrt(12.5), pytest.approx(3.95), 4.0)
    with pytest.raises(BadInputError, match="answers none of the captures"):
        Residuals.of(np.array([np.nan]))

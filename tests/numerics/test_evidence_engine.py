"""The evidence engine against dense linear algebra, and its coverage on data that its model does not contain."""

import numpy as np
import pytest
from scipy.linalg import block_diag

from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.evidence import Prior, Sums, maximise, posterior
from wlr_render.numerics.posterior import Posterior

NAMES = ("size", "slope", "noise", "motion")
HYPER = np.array([-0.3, 0.2, 0.1, -0.5])
OUTPUTS, GROUPS, OWN = 2, 8, 3


class Problem:
    """Random readings with a design, mixed unknowns and groups; `dense` is the textbook formula for all of it."""

    def __init__(self, seed: int, count: int = 400, columns: int = 30, mixed: int = 0) -> None:
        rng = np.random.default_rng(seed)
        self.design = rng.normal(size=(count, columns))
        self.mixed = rng.normal(size=(count, OUTPUTS, mixed))
        self.own = rng.normal(size=(count, OUTPUTS, OWN))
        self.group = rng.integers(0, GROUPS, count)
        self.value, self.weight = rng.normal(size=(count, OUTPUTS)), rng.uniform(0.5, 2.0, count)
        features = np.zeros((columns, 4))
        features[:, 0], features[:, 1] = 1.0, -rng.integers(0, 5, columns)
        self.prior = Prior(
            NAMES,
            np.tile([-20.0, 20.0], (4, 1)),
            np.tile([0.0, np.inf], (4, 1)),
            features,
            np.tile([0.5, 0.0, 0.0, 0.0], (mixed, 1)),
            np.tile([0.0, 0.0, 0.0, 1.0], (OWN, 1)),
        )

    def sums(self, parts: int = 1) -> Sums:
        sums = Sums(self.design.shape[1], OUTPUTS, self.mixed.shape[2], GROUPS, OWN)
        for rows in np.array_split(np.arange(len(self.value)), parts):
            mixed = self.mixed[rows] if self.mixed.shape[2] else None
            readings = self.value[rows], self.weight[rows], self.design[rows]
            sums.add(*readings)
            sums.add_side(*readings, mixed, self.own[rows], self.group[rows])
        return sums

    def dense(self, hyper: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """Log evidence, mean and covariance of all unknowns, from the covariance of all readings."""
        count, columns = self.design.shape
        mixed = self.mixed.shape[2]
        side = mixed + GROUPS * OWN
        whole = np.zeros((count, OUTPUTS, side + OUTPUTS * columns))
        whole[:, :, :mixed] = self.mixed
        for row, group in enumerate(self.group):
            whole[row, :, mixed + group * OWN : mixed + (group + 1) * OWN] = self.own[row]
        for output in range(OUTPUTS):
            first = side + output * columns
            whole[:, output, first : first + columns] = self.design
        flat = whole.reshape(count * OUTPUTS, -1)
        sizes = [self.prior.mixed_features @ hyper, np.full(GROUPS * OWN, hyper[3])]
        sizes += [self.prior.features @ hyper] * OUTPUTS
        variance = np.exp(2.0 * np.concatenate(sizes))
        noise = np.repeat(np.exp(2.0 * hyper[2]) / self.weight**2, OUTPUTS)
        spread, value = (flat * variance) @ flat.T + np.diag(noise), self.value.ravel()
        log_evidence = -0.5 * (
            np.linalg.slogdet(spread)[1] + value @ np.linalg.solve(spread, value) + len(value) * np.log(2.0 * np.pi)
        )
        covariance = np.linalg.inv(np.diag(1.0 / variance) + (flat.T / noise) @ flat)
        return float(log_evidence), covariance @ (flat.T / noise) @ value, covariance


def all_means(found: Posterior) -> FloatArray:
    return np.concatenate([found.mixed_mean, found.group_mean.ravel(), found.mean.ravel()])


def covariance_of(found: Posterior) -> FloatArray:
    """Covariance of the side unknowns, then of all coefficients, which follow them."""
    side, follow = found.side_covariance, np.concatenate([*found.by_side], axis=1)
    own = block_diag(*[found.alone] * OUTPUTS) + follow.T @ side @ follow
    return np.block([[side, side @ follow], [follow.T @ side, own]])


@pytest.mark.parametrize("mixed", [0, 4])
@pytest.mark.parametrize("motion", [-0.5, -20.0])
def test_evidence_mean_and_covariance_are_those_of_the_covariance_of_all_readings(mixed: int, motion: float) -> None:
    problem = Problem(mixed, mixed=mixed)
    hyper = np.array([*HYPER[:3], motion])
    found = posterior(problem.sums(parts=3), problem.prior, hyper)
    log_evidence, mean, covariance = problem.dense(hyper)
    assert found.log_evidence == pytest.approx(log_evidence, abs=1e-8)
    np.testing.assert_allclose(all_means(found), mean, atol=1e-12)
    np.testing.assert_allclose(covariance_of(found), covariance, atol=1e-14)


@pytest.mark.parametrize("mixed", [0, 4])
def test_the_slope_of_the_evidence_is_its_derivative(mixed: int) -> None:
    problem, step = Problem(5, mixed=mixed), 1e-5
    slope = [
        (problem.dense(HYPER + by)[0] - problem.dense(HYPER - by)[0]) / (2.0 * step) for by in step * np.eye(len(HYPER))
    ]
    np.testing.assert_allclose(posterior(problem.sums(), problem.prior, HYPER).slope, slope, atol=1e-5)


@pytest.mark.parametrize("mixed", [0, 4])
def test_the_second_slope_of_the_evidence_is_its_second_derivative(mixed: int) -> None:
    problem, step = Problem(6, mixed=mixed), 1e-4
    sums = problem.sums()
    steps = step * np.eye(len(HYPER))
    after, before = ([posterior(sums, problem.prior, HYPER + by).slope for by in sign * steps] for sign in (1, -1))
    second = np.subtract(after, before) / (2.0 * step)
    np.testing.assert_allclose(posterior(sums, problem.prior, HYPER).second_slope, second, rtol=1e-5, atol=1e-4)


def test_readings_of_weight_zero_are_not_there() -> None:
    problem = Problem(1)
    kept = np.arange(len(problem.value)) % 3 > 0
    weighted = Problem(1)
    weighted.weight = np.where(kept, problem.weight, 0.0)
    weighted.value[~kept] = 1e6
    for name in ("design", "own", "group", "value", "weight", "mixed"):
        setattr(problem, name, getattr(problem, name)[kept])
    with_zeros, without = (posterior(each.sums(), each.prior, HYPER) for each in (weighted, problem))
    assert with_zeros.log_evidence == pytest.approx(without.log_evidence, abs=1e-8)
    np.testing.assert_allclose(all_means(with_zeros), all_means(without), atol=1e-12)


def test_sums_less_those_of_some_readings_are_those_of_the_others() -> None:
    problem = Problem(2)
    first = Sums(problem.design.shape[1], OUTPUTS, 0, GROUPS, OWN)
    rows = slice(0, 100)
    readings = problem.value[rows], problem.weight[rows], problem.design[rows]
    first.add(*readings)
    first.add_side(*readings, None, problem.own[rows], problem.group[rows])
    rest = Problem(2)
    for name in ("design", "own", "group", "value", "weight", "mixed"):
        setattr(rest, name, getattr(problem, name)[100:])
    found = posterior(problem.sums() - first, problem.prior, HYPER)
    assert found.log_evidence == pytest.approx(posterior(rest.sums(), rest.prior, HYPER).log_evidence, abs=1e-8)


@pytest.mark.parametrize("motion", [0.02, 0.05, 0.2])
def test_the_curvature_is_that_of_the_evidence(motion: float) -> None:
    """Of each hyperparameter, for motions from strongly to weakly determined; the mean of 60 draws."""
    rng, step = np.random.default_rng(23), 1e-2
    hyper = np.array([0.0, 0.7, np.log(0.1), np.log(motion)])
    found, second = [], []
    for _ in range(60):
        sums, prior, _ = drawn(rng, motion)

        def evidence(at: FloatArray, sums: Sums = sums, prior: Prior = prior) -> float:
            return posterior(sums, prior, at).log_evidence

        steps = step * np.eye(4)
        second.append([2.0 * evidence(hyper) - evidence(hyper - by) - evidence(hyper + by) for by in steps])
        found.append(posterior(sums, prior, hyper).curvature)
    np.testing.assert_allclose(np.mean(found, axis=0), np.mean(second, axis=0) / step**2, rtol=0.15)


def test_the_curvature_of_correlated_unknowns_is_that_of_the_evidence() -> None:
    """The mean of 100 draws of a size with which 30 columns, nearly alike, are hardly determined."""
    size, step, count, columns = 0.05, 1e-2, 200, 30
    features = np.tile([1.0, 0.0], (columns, 1))
    prior = Prior(("size", "noise"), np.zeros((2, 2)), np.zeros((2, 2)), features, np.zeros((0, 2)), np.zeros((0, 2)))
    hyper, by = np.log([size, 1.0]), np.array([step, 0.0])
    found, second = [], []
    for seed in range(100):
        rng = np.random.default_rng(seed)
        design = 0.1 * rng.normal(size=(count, columns)) + rng.normal(size=(count, 3)) @ rng.normal(size=(3, columns))
        value = design @ (size * rng.normal(size=columns)) + rng.normal(size=count)
        sums = Sums(columns, 1, 0, 0, 0)
        sums.add(value[:, None], np.ones(count), design)
        three = [posterior(sums, prior, hyper + each) for each in (-by, 0.0 * by, by)]
        second.append(-np.diff([each.log_evidence for each in three], 2)[0] / step**2)
        found.append(three[1].curvature[0])
    assert np.mean(found) == pytest.approx(np.mean(second), rel=0.15)


def drawn(
    rng: np.random.Generator, motion: float, tails: bool = False, rim: bool = False
) -> tuple[Sums, Prior, FloatArray]:
    """A smooth curve read in groups that share an offset; noise 0.1, or of other kinds that the model does not have."""
    count, groups, columns = 600, 20, 12
    place = rng.uniform(-1.0, 1.0, count)
    group: IntArray = rng.integers(0, groups, count)
    design = np.polynomial.chebyshev.chebvander(place, columns - 1)
    order = np.arange(columns)
    truth = rng.normal(size=(2, columns)) * np.exp(-0.7 * order)
    noise = 0.1 * (rng.standard_t(5, (count, 2)) / np.sqrt(5 / 3) if tails else rng.normal(size=(count, 2)))
    noise = noise * (np.sqrt((1.0 + place**2) ** 2 / 1.87)[:, None] if rim else 1.0)
    value = design @ truth.T + noise + motion * rng.normal(size=(groups, 1))[group]
    sums = Sums(columns, 2, 0, groups, 1)
    sums.add(value, np.ones(count), np.asarray(design))
    sums.add_side(value, np.ones(count), np.asarray(design), None, np.ones((count, 2, 1)), group)
    features = np.zeros((columns, 4))
    features[:, 0], features[:, 1] = 1.0, -order
    none = np.zeros((0, 4))
    bounds = np.array([[-10.0, 5.0], [0.0, 5.0], [-10.0, 5.0], [-12.0, 3.0]])
    own = np.array([[0.0, 0.0, 0.0, 1.0]])
    free = np.tile([0.0, np.inf], (4, 1))
    prior = Prior(NAMES, bounds, free, features, none, own)
    return sums, prior, truth


STARTS = [dict(zip(NAMES, start, strict=True)) for start in ((0.0, 0.5, -1.0, -2.0), (-2.0, 1.0, -4.0, -5.0))]


@pytest.mark.parametrize("motion", [0.0, 0.02, 0.2])
@pytest.mark.parametrize("kind", ["white", "tails", "rim"])
def test_the_predicted_error_is_the_true_one(motion: float, kind: str) -> None:
    """Also for noise that the model does not contain; 40 draws fix the ratio of the rms errors to some 5 %."""
    rng = np.random.default_rng(17)
    at = np.polynomial.chebyshev.chebvander(np.linspace(-1.0, 1.0, 41), 11)
    squares, predicted, found_motion = [], [], []
    for _ in range(40):
        sums, prior, truth = drawn(rng, motion, tails=kind == "tails", rim=kind == "rim")
        found = maximise(sums, prior, STARTS)
        assert found.noise == pytest.approx(0.1, rel=0.15)
        squares.append(np.mean((at @ (found.mean - truth).T) ** 2))
        covariance = covariance_of(found)
        first = len(covariance) - 24
        predicted.append(
            np.mean([np.einsum("ni,ij,nj->n", at, covariance[a : a + 12, a : a + 12], at) for a in (first, first + 12)])
        )
        found_motion.append(np.exp(found.hyper["motion"]))
    assert 0.8 < np.sqrt(np.mean(predicted) / np.mean(squares)) < 1.25
    assert np.median(found_motion) == pytest.approx(motion, rel=0.3, abs=0.01)


def test_what_is_expected_of_a_hyperparameter_counts_where_readings_say_nothing() -> None:
    """One group cannot tell how much groups differ: its offset is part of the curve."""
    sums, prior, _ = drawn(np.random.default_rng(3), 0.0)
    blind = Sums(12, 2, 0, 1, 1)
    for name in ("gram", "moment", "square", "count", "log_weight"):
        setattr(blind, name, getattr(sums, name))
    expected = np.tile([0.0, np.inf], (4, 1))
    expected[3] = -4.0, 1.0
    known = Prior(**{**vars(prior), "expected": expected})
    start = dict(zip(NAMES, (0.0, 0.5, -1.0, 1.0), strict=True))
    # Half a natural unit of evidence, a standard deviation of what is expected, is not worth another step.
    assert maximise(blind, known, [start]).hyper["motion"] == pytest.approx(-4.0, abs=1.0)
    assert maximise(blind, prior, [start]).hyper["motion"] == pytest.approx(1.0)


def test_no_start_at_which_the_evidence_can_be_computed_is_said() -> None:
    sums, prior, _ = drawn(np.random.default_rng(3), 0.0)
    sums.square = 0.0
    with pytest.raises(np.linalg.LinAlgError, match="any start"):
        maximise(sums, prior, STARTS)

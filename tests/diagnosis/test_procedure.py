"""The whole procedure on small sessions: verdicts, noise that is measured, spurious matches that are dropped."""

import numpy as np
import pytest
from small_session import SIGMA_PX, diagnosed, measured

from wlr_render.diagnosis import prediction
from wlr_render.diagnosis.diagnosis import EXPLAINED, NO_EFFECT, UNEXPLAINED


def test_the_record_of_an_explained_session_holds_the_truth(explained):
    assert explained.verdict == EXPLAINED
    truth = {"combiner_tilt": [0.3, -0.2, 0.3], "target_scale": [0.3, 0.3]}
    assert {cause.name for cause in explained.causes} == set(truth)
    for cause in explained.causes:
        for parameter, true in zip(cause.parameters, truth[cause.name], strict=True):
            assert abs(parameter.value - true) < 4 * parameter.sigma
        # The first of the ranking is the cause itself, at even odds with itself.
        assert (cause.ranking[0].name, cause.ranking[0].log10_odds) == (cause.name, 0.0)
        assert cause.ranking[0].reduced_chi_squared == pytest.approx(explained.after.over_noise**2, rel=0.02)
        assert cause.improvement.significance > 3
    np.testing.assert_allclose(explained.corrected.target.scale, 1.003, atol=2e-4)
    assert explained.reasons[-1] == "no other cause has better odds than none"


def test_a_cause_is_described_with_its_own_effect(explained):
    """Each effect is the change of the readings by that cause alone: the tilt moves the display, the print does not."""
    observations, used = explained.observations, explained.used
    sizes = {cause.name: cause.effect_over_noise for cause in explained.causes}
    rest = np.sqrt(np.mean(explained.residual_before[used] ** 2) - np.mean(explained.residual_after[used] ** 2))
    assert sizes["combiner_tilt"] == pytest.approx(rest, rel=0.1)
    assert 0.5 < sizes["target_scale"] < 0.2 * sizes["combiner_tilt"]
    assert len(observations.captures) == len(explained.captures)


def test_each_capture_has_its_residual(explained):
    for number, capture in enumerate(explained.captures):
        own = explained.residual_after[explained.observations.group == number]
        assert capture.rms_after == pytest.approx(np.sqrt(np.mean(own**2)))
        assert capture.excluded == (capture.capture == "display capture 3")
        assert (capture.reduced_chi_squared > 5) == capture.excluded


def test_what_no_cause_explains_is_placed_and_its_spurious_matches_are_dropped(unexplained):
    assert unexplained.verdict == UNEXPLAINED
    assert (unexplained.unexplained.part, unexplained.unexplained.depends_on) == ("display", "panel pixels")
    assert unexplained.corrected is unexplained.observations.nominal
    assert all(floor.used_px == pytest.approx(2 * SIGMA_PX, rel=0.2) for floor in unexplained.noise_floors)


def test_a_clean_session_has_detection_limits(nothing):
    assert (nothing.verdict, nothing.causes, nothing.unexplained) == (NO_EFFECT, (), None)
    assert {limit.cause for limit in nothing.detection_limits} == {"target_scale", "combiner_tilt"}


@pytest.mark.parametrize("larger", [1.06, 1.08, 1.1, 1.2])
def test_clean_sessions_with_more_noise_than_stated_are_not_unexplained(bench, plan, larger):
    found = diagnosed(measured(bench, plan, larger * SIGMA_PX, seed=31), ("target_scale", "stage_scale"))
    assert found.verdict == NO_EFFECT


def test_the_nominal_bench_is_simulated_once(bench, plan, monkeypatch):
    observations, count = measured(bench, plan, SIGMA_PX, seed=32), []
    simulate = prediction.simulate

    def counted(which, what, *others):
        if which is bench and what.display is not None:
            count.append(which)
        return simulate(which, what, *others)

    monkeypatch.setattr(prediction, "simulate", counted)
    diagnosed(observations, ("target_scale",))
    assert len(count) == 1

"""Selection of causes: who is ranked first, who is refused and why, restarts, and causes made idle."""

from dataclasses import replace

import numpy as np
import pytest
from small_session import SIGMA_PX, explanation, hypothesis, measured

from wlr_render.diagnosis.causes import CAUSES
from wlr_render.diagnosis.fit import fit, reduced_chi_squared
from wlr_render.diagnosis.prediction import Explanation, Predictor
from wlr_render.diagnosis.search import Search, hypotheses
from wlr_render.diagnosis.settings import Settings

NAMES = ("combiner_tilt", "panel_shift", "target_scale", "stage_scale")


def searching(observations, names=NAMES, **settings):
    spread = observations.spread(700)
    full = Predictor(observations)
    everything = np.ones(len(observations), dtype=bool)
    candidates = hypotheses({name: CAUSES[name] for name in names})
    return Search(full, full.of_rows(spread), everything, everything[spread], candidates, settings=Settings(**settings))


def names_of(selection):
    return selection.fit.explanation.names


def with_dent(observations, size_px):
    """A dent of the display over an eighth of its field, which no cause explains."""
    read, camera = observations.session.readings, observations.session.plan.display.camera_pixel
    radius = np.linalg.norm(camera - [700.0, 600.0], axis=1)
    read.panel_pixel[:, 0] += size_px * np.exp(-0.5 * (radius / 80.0) ** 2)
    return observations


@pytest.fixture(scope="module")
def two(bench, plan):
    return measured(bench, plan, SIGMA_PX, seed=11, combiner_tilt=[0.3, -0.2, 0.3], target_scale=[0.3, 0.3])


@pytest.fixture(scope="module")
def clean_and_noisy(bench, plan):
    return measured(bench, plan, SIGMA_PX, seed=12)


def test_causes_are_added_until_nothing_more_gains_than_chance(two):
    selection = searching(two).select()
    assert set(names_of(selection)) == {"combiner_tilt", "target_scale"}
    assert selection.reason == "no other cause gains more than chance would"
    assert reduced_chi_squared(selection.fit) == pytest.approx(1.0, abs=0.1)


def test_nothing_is_added_to_noise(clean_and_noisy):
    assert names_of(searching(clean_and_noisy).select()) == ()


def test_no_more_causes_than_allowed_are_added_and_the_reason_says_so(two):
    selection = searching(two, max_causes=1, restarts=0).select()
    assert names_of(selection) == ("combiner_tilt",)
    assert selection.reason == "1 causes are the most that are searched for"


def test_the_ranking_is_by_evidence_and_leaves_out_causes_at_work(two):
    search = searching(two, min_relative_gain=0.001)
    ranking = search.rank(fit(search.full, explanation(target_scale=[0, 0]), search.used))
    assert ranking.candidates[0].hypothesis.cause.name == "combiner_tilt"
    assert "target_scale" not in {each.hypothesis.cause.name for each in ranking.screened}
    behind = [each.behind for each in ranking.candidates]
    assert behind == sorted(behind)
    assert behind[0] == 0.0
    assert [each.gain for each in ranking.screened] == sorted((e.gain for e in ranking.screened), reverse=True)
    assert ranking.candidates[0].fitted_to_all


@pytest.mark.parametrize(("share", "most"), [(0.001, 4), (0.99, 1)])
def test_only_candidates_that_promise_a_share_of_the_best_gain_are_fitted(two, share, most):
    search = searching(two, min_relative_gain=share)
    ranking = search.rank(fit(search.full, Explanation(), search.used))
    assert (len(ranking.candidates) == 1) == (most == 1)
    assert len(searching(two, min_relative_gain=share, max_fits=1).rank(ranking.current).candidates) == 1


def test_a_cause_that_explains_too_little_beside_something_unlisted_is_refused_with_its_share(bench, plan):
    observations = with_dent(measured(bench, plan, SIGMA_PX, seed=13, target_scale=[0.05, 0.05]), 5.0)
    refused = searching(observations, ("target_scale",)).select()
    assert names_of(refused) == ()
    assert "target_scale comes next, but explains only" in refused.reason
    assert "% of the excess over the noise, and more than noise would be left" in refused.reason
    assert names_of(searching(observations, ("target_scale",), min_share_explained=0.0).select()) == ("target_scale",)


def test_a_cause_that_explains_little_but_reaches_the_noise_is_accepted(bench, plan):
    """The whole of a small excess: the share rule is for what stays unexplained."""
    observations = measured(bench, plan, SIGMA_PX, seed=14, target_scale=[0.02, 0.02])
    search = searching(observations, ("target_scale",), min_share_explained=2.0)
    assert names_of(search.select()) == ("target_scale",)


def test_a_cause_is_refused_where_held_out_captures_do_not_gain(two):
    selection = searching(two, min_held_out_se=1e9).select()
    assert names_of(selection) == ()
    assert "held-out captures gain" in selection.reason


def test_chance_refuses_what_a_looser_limit_accepts(bench, plan):
    observations = measured(bench, plan, SIGMA_PX, seed=15, target_scale=[0.012, 0.0])
    strict, loose = (
        searching(observations, ("target_scale",), max_p_value=value, min_held_out_se=-1e9).select()
        for value in (1e-12, 0.5)
    )
    assert names_of(strict) == ()
    assert names_of(loose) == ("target_scale",)


def test_runners_up_near_the_best_are_restarts_and_others_are_not(two):
    search = searching(two, min_relative_gain=0.001)
    first = search.rank(fit(search.full, Explanation(), search.used))
    best, *others = first.candidates
    near = replace(others[0], reduced_chi_squared=2.9 * best.reduced_chi_squared)
    far = replace(others[0], reduced_chi_squared=3.1 * best.reduced_chi_squared)
    ranking = replace(first, candidates=(best, far, near, near, near))
    assert search._seeds(ranking) == [near, near]
    assert search._seeds(replace(first, candidates=())) == []


def test_a_cause_that_a_later_one_has_made_idle_is_pruned(two):
    search = searching(two)
    both = explanation(panel_shift=[0, 0], combiner_tilt=[0, 0, 0]).plus(hypothesis("target_scale"))
    assert search._pruned(fit(search.full, both, search.used)).explanation.names == ("combiner_tilt", "target_scale")


def test_no_cause_at_work_is_pruned(two):
    search = searching(two)
    found = fit(search.full, explanation(target_scale=[0, 0], combiner_tilt=[0, 0, 0]), search.used)
    assert search._pruned(found) is found

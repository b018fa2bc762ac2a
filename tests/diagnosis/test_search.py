"""Selection of causes: who is ranked first, who is refused and why, restarts, and causes made idle."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pytest
from diagnosis.small_session import (
    SIGMA_PX,
    explanation,
    fitted,
    hypothesis,
    measured,
    weighed,
    with_jitter,
    with_noise,
)
from oracle.captures import Plan
from oracle.effects import Effect
from oracle.session_writer import write_session
from present import present
from scipy.spatial.transform import Rotation

from wlr_render.bench.bench import Bench
from wlr_render.bench.session_folder import load_session
from wlr_render.bench.simulate_session import simulate
from wlr_render.captures.session import DisplayPlan, SeeThroughPlan, Session, SessionPlan
from wlr_render.diagnosis.cause_selection import CandidateRanking, Search, Selection
from wlr_render.diagnosis.causes import CAUSES
from wlr_render.diagnosis.fit import fit, times_between_captures
from wlr_render.diagnosis.observations import Observations
from wlr_render.diagnosis.prediction import Explanation, Predictor
from wlr_render.diagnosis.screening import Signatures, best_fit, hypotheses, screen
from wlr_render.diagnosis.settings import Settings
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.scatter import Scatter
from wlr_render.optics.device import EyeOptics

Part = TypeVar("Part", DisplayPlan, SeeThroughPlan)

NAMES = ("combiner_tilt", "panel_shift", "target_scale", "stage_scale")


def searching(observations: Observations, names: tuple[str, ...] = NAMES, most: int = 700, **settings: Any) -> Search:
    full = weighed(observations)
    candidates = hypotheses({name: CAUSES[name] for name in names})
    return Search(full, full.of_rows(observations.spread(most)), candidates, settings=Settings(**settings))


def ranking_of(search: Search, start: Explanation = Explanation()) -> CandidateRanking:  # noqa: B008
    return search.rank(search.refitted(start, Scatter.usual(len(search.full.observations.captures))))


def names_of(selection: Selection) -> tuple[str, ...]:
    return selection.fit.explanation.names


def with_dent(observations: Observations, size_px: float) -> Observations:
    """A dent of the display over an eighth of its field, which no cause explains."""
    read, camera = observations.session.readings, present(observations.session.plan.display).camera_pixel
    radius = np.linalg.norm(camera - [700.0, 600.0], axis=1)
    present(read.panel_pixel)[:, 0] += size_px * np.exp(-0.5 * (radius / 80.0) ** 2)
    return observations


@pytest.fixture(scope="module")
def two(bench: Bench, plan: SessionPlan) -> Observations:
    observations = measured(bench, plan, SIGMA_PX, seed=11, combiner_tilt=[0.3, -0.2, 0.3], target_scale=[0.3, 0.3])
    return observations.of_rows(observations.spread(900))


@pytest.fixture(scope="module")
def clean_and_noisy(bench: Bench, plan: SessionPlan) -> Observations:
    return measured(bench, plan, SIGMA_PX, seed=12)


@pytest.mark.slow
def test_what_factory_calibrations_show_is_found_with_its_size(bench: Bench, plan: SessionPlan) -> None:
    """A panel that is wider than high, and colours apart by more than a magnification, on a shaky stage (seed 11)."""
    truth: dict[str, Any] = {"panel_scale": [0.2, -0.1], "lateral_colour": [0.1, -0.1, 1.0, -0.5, -1.5, 0.8]}
    rng = np.random.default_rng(11)
    read = with_noise(with_jitter(measured(bench, plan, **truth), bench, 8.0, rng), SIGMA_PX, rng)
    found = searching(read, ("frame_bend", "panel_scale", "lateral_colour"), 1200).select().fit
    assert set(found.explanation.names) == set(truth)
    true = np.concatenate([truth[name] for name in found.explanation.names])
    np.testing.assert_array_less(np.abs(found.explanation.vector() - true), 4 * found.sigmas())
    assert found.sigmas().max() < 0.05


@pytest.mark.slow
def test_a_bent_frame_of_an_independent_simulator_is_found_with_both_eyes(tmp_path: Path) -> None:
    bend = Effect("frame_bend", {"toe_in_deg": 0.2, "twist_deg": -0.1})
    write_session(tmp_path, Plan(grid=(12, 9), dots=(5, 4)), [bend], np.random.default_rng(12))
    bench, session = load_session(tmp_path)
    observations = Predictor.of_session(bench, session).observations
    names = ("frame_bend", "panel_shift", "combiner_tilt", "camera_rotation")
    found = searching(observations, names, 1200).select().fit
    assert found.explanation.names == ("frame_bend",)
    np.testing.assert_array_less(np.abs(found.explanation.vector() - [0.2, -0.1]), 4 * found.sigmas())
    eyes = found.explanation.bench(bench).device.eyes
    toe_in = {side: np.rad2deg(_turned_by(eyes[side], bench.device.eyes[side])[1]) for side in eyes}
    assert toe_in["right"] == pytest.approx(0.2, abs=0.01)
    assert all(abs(each) == pytest.approx(0.2, abs=0.01) for each in toe_in.values())


def _turned_by(new: EyeOptics, old: EyeOptics) -> FloatArray:
    """Rotation vector of a panel's motion."""
    rotation = (new.panel.device_from_panel @ old.panel.panel_from_device)[:3, :3]
    return np.asarray(Rotation.from_matrix(rotation).as_rotvec())


@pytest.mark.slow
def test_no_more_causes_than_allowed_are_added_and_the_reason_says_so(two: Observations) -> None:
    selection = searching(two, max_causes=1, restarts=0).select()
    assert names_of(selection) == ("combiner_tilt",)
    assert selection.reason == "1 causes are the most that are searched for"


@pytest.mark.slow
def test_the_ranking_is_by_evidence_and_leaves_out_causes_at_work(two: Observations) -> None:
    search = searching(two, min_relative_gain=0.001)
    ranking = ranking_of(search, explanation(target_scale=[0, 0]))
    assert ranking.fits[0].explanation.names[-1] == "combiner_tilt"
    assert "target_scale" not in {each.hypothesis.cause.name for each in ranking.screened}
    behind = [each.minus_two_log_evidence for each in ranking.fits]
    assert behind == sorted(behind)
    assert [each.gain for each in ranking.screened] == sorted((e.gain for e in ranking.screened), reverse=True)


@pytest.mark.parametrize(("share", "most"), [(0.001, 4), (0.99, 1)])
@pytest.mark.slow
def test_only_candidates_that_promise_a_share_of_the_best_gain_are_fitted(
    two: Observations, share: float, most: int
) -> None:
    search = searching(two, min_relative_gain=share)
    ranking = ranking_of(search)
    assert (len(ranking.rough) == 1) == (most == 1)
    assert len(searching(two, min_relative_gain=share, max_fits=1).rank(ranking.current).rough) == 1


def test_a_cause_below_the_limit_of_the_odds_is_refused_and_named_with_its_odds(
    bench: Bench, plan: SessionPlan
) -> None:
    """At five standard errors the odds are better than even, and worse than a hundred to one."""
    observations = measured(bench, plan, SIGMA_PX, seed=15, target_scale=[0.014, 0.0])
    refused = searching(observations, ("target_scale",), 9999).select()
    assert names_of(refused) == ()
    assert re.fullmatch(r"target_scale comes next, but the odds for it are 10\^[01]\.\d only", refused.reason)
    loose = searching(observations, ("target_scale",), 9999, least_log10_odds=0.0).select()
    assert names_of(loose) == ("target_scale",)


@pytest.mark.slow
def test_no_cause_is_named_on_shaky_benches(bench: Bench, plan: SessionPlan) -> None:
    """Motions with tails, which the model takes for normal ones: none of ten sessions has odds for any cause."""
    clean = measured(bench, plan)
    clean = clean.of_rows(clean.spread(900))
    for seed in range(10):
        rng = np.random.default_rng(seed)
        shaky = with_noise(with_jitter(clean, bench, 15.0, rng, 40.0, dof=4.0), SIGMA_PX, rng)
        assert names_of(searching(shaky).select()) == ()


@pytest.mark.slow
def test_an_unlisted_effect_in_one_part_hides_no_cause_in_another(bench: Bench, plan: SessionPlan) -> None:
    """A dent of the display, and a target printed too large, which shows in the other part alone."""
    for size_px in (1.0, 3.0, 10.0):
        observations = with_dent(measured(bench, plan, SIGMA_PX, seed=13, target_scale=[0.3, 0.3]), size_px)
        selection = searching(observations, ("target_scale",)).select()
        assert names_of(selection) == ("target_scale",)
        np.testing.assert_allclose(selection.fit.explanation.vector(), 0.3, atol=0.02)


def test_a_cause_that_only_all_readings_show_is_accepted(bench: Bench, plan: SessionPlan) -> None:
    observations = measured(bench, plan, SIGMA_PX, seed=15, target_scale=[0.02, 0.02])
    search = searching(observations, ("target_scale",), 60)
    assert ranking_of(search).screened[0].gain < 0.0
    assert names_of(search.select()) == ("target_scale",)


@pytest.mark.parametrize("late", [2, 3, 4])
def test_a_slip_in_the_last_captures_is_a_slip_and_none_of_them_moved(
    bench: Bench, plan: SessionPlan, late: int
) -> None:
    """Two captures are as many as tell a slip from a capture that moved."""
    seconds = 60.0 * (18 - late) - 30.0
    shown = SessionPlan(plan.display)
    slipped = measured(bench, shown, SIGMA_PX, seed=16, headset_slip=[0.6, 0.0, 0.0, 0.0, 0.2, 0.0, seconds])
    selection = searching(slipped, ("headset_slip", "panel_shift", "stage_scale", "thermal_drift")).select()
    assert names_of(selection) == ("headset_slip",)
    found = dict(
        zip([p.name for p in CAUSES["headset_slip"].parameters], selection.fit.explanation.vector(), strict=True)
    )
    assert found["moment"] == pytest.approx(seconds, abs=30.0)
    assert found["shift_x"] == pytest.approx(0.6, abs=0.05)
    assert not selection.fit.scatter.moved.any()


@pytest.mark.slow
def test_a_candidate_that_loses_readings_is_none(two: Observations) -> None:
    """Its few residuals would be smaller than those of all readings."""
    search = searching(two, ("combiner_shift",))
    nothing = search.on_subsample(ranking_of(search).current)
    prospect, *_ = screen(search.signatures, nothing, search.hypotheses)
    assert best_fit(search.subsample, nothing, prospect) is not None
    lost = Explanation().plus(prospect.hypothesis, np.array([100.0, 0.0, 0.0]))
    assert fit(search.subsample, lost, prospect.scatter) is None


def test_a_cause_that_a_later_one_has_made_idle_is_pruned(two: Observations) -> None:
    search = searching(two)
    both = explanation(panel_shift=[0, 0], combiner_tilt=[0, 0, 0]).plus(hypothesis("target_scale"))
    found = search.refitted(both, Scatter.usual(len(two.captures)))
    assert search.pruned(found).explanation.names == ("combiner_tilt", "target_scale")


def test_no_cause_at_work_is_pruned(two: Observations) -> None:
    search = searching(two)
    start = explanation(target_scale=[0, 0], combiner_tilt=[0, 0, 0])
    found = search.refitted(start, Scatter.usual(len(two.captures)))
    assert search.pruned(found) is found


def test_the_excess_is_that_of_the_captures_that_count(clean_and_noisy: Observations) -> None:
    readings = weighed(clean_and_noisy)
    count = len(clean_and_noisy.captures)
    calm = Scatter.usual(count)
    one = replace(calm, moved=np.arange(count) == 0)
    everyone, others = np.ones(count, dtype=bool), np.arange(count) > 0
    # By the definition: half the squared length of what a motion of usual size does to a reading, on average.
    size = np.repeat([calm.shift_um[0], calm.turn_urad[0]], 3)
    mine = readings.motions[readings.observations.part == 0]
    assert readings.excess(calm, 0, everyone) == pytest.approx(0.5 * np.mean(np.sum((mine * size) ** 2, axis=(1, 2))))
    assert readings.excess(one, 0, everyone) > 100 * readings.excess(calm, 0, everyone)
    assert readings.excess(one, 0, others) == pytest.approx(readings.excess(calm, 0, others))


def test_values_that_lose_readings_are_fitted_from_null_values(clean_and_noisy: Observations) -> None:
    """Without another cause, the values of one may leave readings unpredicted."""
    search = searching(clean_and_noisy)
    far = explanation(combiner_shift=[100.0, 0.0, 0.0])
    found = search.refitted(far, Scatter.usual(len(search.full.observations.captures)))
    assert np.abs(found.explanation.vector()).max() < 1.0


@pytest.mark.parametrize("times", [1, 2])
def test_without_a_moment_between_captures_nothing_can_have_slipped(
    bench: Bench, plan: SessionPlan, times: int
) -> None:
    """A lab may write the same time for all captures; with two times there is no moment away from either end."""

    def at_few_times(part: Part | None) -> Part:
        assert part is not None
        return replace(part, time_s=np.asarray(part.capture % times * 40.0))

    timeless = replace(plan, display=at_few_times(plan.display), see_through=at_few_times(plan.see_through))
    assert len(times_between_captures(timeless)) == 0
    observations = Predictor.of_session(bench, Session("timeless", timeless, simulate(bench, timeless))).observations
    readings, current = weighed(observations), fitted(observations, Explanation())
    candidates = hypotheses({name: CAUSES[name] for name in ("headset_slip", "panel_shift")})
    screened = screen(Signatures.of(readings, candidates), present(current), candidates)
    assert {each.hypothesis.cause.name for each in screened} == {"panel_shift"}

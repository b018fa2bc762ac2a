"""The whole procedure on small sessions: verdicts, noise that is measured, spurious matches that are dropped."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnosis.small_session import SIGMA_PX, diagnosed, explanation, fitted, measured, with_jitter, with_noise
from oracle.captures import Plan
from oracle.effects import Effect
from oracle.session_writer import write_session
from present import present

from wlr_render.bench.bench import Bench
from wlr_render.bench.session_folder import load_session
from wlr_render.captures.session import DisplayPlan, SessionPlan
from wlr_render.diagnosis.diagnosis import EXPLAINED, LOCATED, NO_EFFECT
from wlr_render.diagnosis.fit import few_captures_factor
from wlr_render.diagnosis.observations import DISPLAY
from wlr_render.diagnosis.prediction import Explanation
from wlr_render.diagnosis.procedure import diagnose
from wlr_render.diagnosis.report import Diagnosis
from wlr_render.diagnosis.settings import Settings
from wlr_render.numerics.arrays import FloatArray


def test_the_record_of_an_explained_session_holds_the_truth(explained: Diagnosis) -> None:
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
    assert explained.reasons[-1] == "no other cause makes the readings more probable"


def test_a_cause_is_described_with_its_own_effect(explained: Diagnosis) -> None:
    """Each effect is the change of the readings by that cause alone: the tilt moves the display, the print does not."""
    observations, used = explained.observations, explained.used
    sizes = {cause.name: cause.effect_over_noise for cause in explained.causes}
    rest = np.sqrt(np.mean(explained.residual_before[used] ** 2) - np.mean(explained.residual_after[used] ** 2))
    assert sizes["combiner_tilt"] == pytest.approx(rest, rel=0.1)
    assert 0.5 < sizes["target_scale"] < 0.2 * sizes["combiner_tilt"]
    assert len(observations.captures) == len(explained.captures)


def test_each_capture_has_its_residual(explained: Diagnosis) -> None:
    for number, capture in enumerate(explained.captures):
        own = explained.residual_after[explained.observations.group == number]
        assert capture.rms_after == pytest.approx(np.sqrt(np.mean(own**2)))
        assert capture.excluded == (capture.capture == "display capture 3")
        assert (capture.rms_after**2 > 5) == capture.excluded


def test_an_effect_that_no_cause_has_is_located_and_gets_no_name(located: Diagnosis) -> None:
    assert (located.verdict, located.causes, located.unexplained_parts) == (LOCATED, (), ())
    first = located.effects[0]
    assert (first.station, first.coordinates, first.form) == ("panel", "panel pixels", "smooth")
    assert first.parts == ("display",)
    assert first.log10_odds > 20
    assert first.size == pytest.approx(4.0 / np.sqrt(2.0), rel=0.2)  # of a sine of 4 pixels
    assert first.share_of_excess_removed > 0.7
    assert first.held_out_improvement.significance > 3
    assert first.is_in_bench
    assert all(floor.used_px == pytest.approx(2 * SIGMA_PX, rel=0.2) for floor in located.noise_floors)


def magnified_red(u: FloatArray, plan: DisplayPlan, origin: object) -> FloatArray:
    return np.asarray(0.8 * (plan.channel == 0) * (u - 700) / 500)


def swimming(u: FloatArray, plan: DisplayPlan, origin: FloatArray) -> FloatArray:
    return np.sin(2 * np.pi * u / 1200) * (plan.stage - origin)[:, 0] / 4e-3


@pytest.mark.slow
@pytest.mark.parametrize(("off", "displaces"), [(magnified_red, "shift"), (swimming, "shift by viewpoint")])
def test_the_corrected_bench_has_the_effect_and_a_diagnosis_of_it_finds_nothing(
    bench: Bench, plan: SessionPlan, tmp_path: Path, off: Callable[..., Any], displaces: str
) -> None:
    observations = measured(bench, plan, SIGMA_PX, seed=17)
    read = observations.session.readings
    present(read.panel_pixel)[:, 0] += off(present(read.panel_pixel)[:, 0].copy(), plan.display, bench.stage.origin)
    said = diagnosed(observations, ("target_scale",))
    assert said.is_corrected
    assert said.after.over_noise < 1.1 < said.before.over_noise
    said.save(tmp_path)
    nominal, session = load_session(tmp_path / "corrected")
    assert {(each.station, each.displaces) for each in nominal.effects} == {("panel", displaces)}
    again = diagnose(nominal, session, causes={}, settings=said.settings)
    assert (again.verdict, again.effects) == (NO_EFFECT, ())


@pytest.mark.slow
def test_what_stripes_do_is_not_called_noise(tmp_path: Path) -> None:
    """Stripes are finer than the spacing of the readings in a photograph, where they look like noise."""
    stripes, plan = Effect("code_stripes", {"bias_px": 1.1, "period_px": 41.9}), Plan(grid=(12, 9), dots=(5, 4))
    write_session(tmp_path, plan, [stripes], np.random.default_rng(5))
    found = diagnose(*load_session(tmp_path), causes={}, settings=Settings(subsample=1200))
    (floor,) = [each for each in found.noise_floors if each.part == "display"]
    assert [effect.station for effect in found.effects[:2]] == ["panel", "panel"]
    assert floor.used_px == pytest.approx(floor.stated_px, rel=0.1)


def test_a_clean_session_has_detection_limits(nothing: Diagnosis) -> None:
    assert (nothing.verdict, nothing.causes, nothing.effects, nothing.unexplained_parts) == (NO_EFFECT, (), (), ())
    assert {limit.cause for limit in nothing.detection_limits} == {"target_scale", "combiner_tilt"}


@pytest.mark.parametrize("larger", [1.06, 1.2])
def test_clean_sessions_with_more_noise_than_stated_are_not_unexplained(
    bench: Bench, plan: SessionPlan, larger: float
) -> None:
    found = diagnosed(measured(bench, plan, larger * SIGMA_PX, seed=31), ("target_scale", "stage_scale"))
    assert found.verdict == NO_EFFECT


@pytest.mark.slow
def test_errors_cover_where_the_camera_repeats_to_ten_micrometres(bench: Bench, plan: SessionPlan) -> None:
    """Motions have the tails of Student's t; by independent readings 33 % of the intervals held the truth."""
    true = [0.5, -0.4, 0.3]
    clean, inside = measured(bench, plan, stage_scale=true), []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        shaky = with_noise(with_jitter(clean, bench, 10.0, rng, dof=5.0), SIGMA_PX, rng)
        found = present(fitted(shaky, explanation(stage_scale=[0.0, 0.0, 0.0])))
        sigma = few_captures_factor(found, shaky) * found.sigmas()
        inside += (np.abs(found.explanation.vector() - true) < sigma).tolist()
    assert abs(np.mean(inside) - 0.683) < 3.0 * np.sqrt(0.683 * 0.317 / len(inside))
    said = diagnosed(shaky, ("stage_scale",))
    (cause,) = said.causes
    assert said.verdict == EXPLAINED
    np.testing.assert_allclose([each.sigma for each in cause.parameters], sigma, rtol=0.1)


@pytest.mark.slow
def test_a_stage_that_repeats_to_ten_micrometres_is_no_effect_and_is_told(bench: Bench, plan: SessionPlan) -> None:
    clean = measured(bench, plan)
    for seed in range(2):
        rng = np.random.default_rng(seed)
        shaky = with_noise(with_jitter(clean, bench, 10.0, rng, dof=5.0), SIGMA_PX, rng)
        said = diagnosed(shaky, ("target_scale", "stage_scale"))
        assert (said.verdict, said.causes, said.excluded) == (NO_EFFECT, (), ())
        display = said.motions[0]
        assert display.part == "display"
        assert abs(display.shift_um - 10.0) < 3.5 * display.shift_error_um


def test_where_more_than_noise_is_left_the_error_bars_are_wider(bench: Bench, plan: SessionPlan) -> None:
    """What a field leaves of waves over the panel counts as noise for the causes, and few captures as Student's t."""
    observations = measured(bench, plan, SIGMA_PX, seed=9, combiner_tilt=[0.3, -0.2, 0.3])
    observations = observations.of_rows(observations.spread(1000))
    read, names = observations.session.readings, ("combiner_tilt",)
    alone = diagnosed(observations, names).causes[0]
    present(read.panel_pixel)[:, 0] += 2.0 * np.sin(2 * np.pi * present(read.panel_pixel)[:, 0] / 500)
    said = diagnosed(observations, names)
    assert (said.verdict, said.effects[0].station) == (LOCATED, "panel")
    (cause,) = said.causes
    sigmas = np.array([[each.sigma for each in one.parameters] for one in (alone, cause)])
    # By the sigma of the fit: the noise that is stated is that of the corrected bench.
    observations = said.readings.observations
    sigma_px = np.sqrt(np.mean(observations.sigma_px[observations.part == DISPLAY] ** 2))
    noise = said.fit.scatter.noise[0] * sigma_px / SIGMA_PX
    assert noise > 1.2
    assert np.all(sigmas[1] > 0.8 * noise * sigmas[0])
    factor = few_captures_factor(said.fit, said.readings.observations)
    assert factor > 1.01
    np.testing.assert_allclose(sigmas[1] / said.fit.sigmas(), factor, rtol=1e-6)


def test_few_captures_widen_the_error_bars_as_student_does(bench: Bench, plan: SessionPlan) -> None:
    """68.3 % of Student's t: 1.20 of a standard deviation with 3 degrees of freedom, 1.84 with one."""
    observations = measured(bench, plan, SIGMA_PX)
    for captures, factor in ((1, 1.837), (3, 1.197), (36, 1.014)):
        few = observations.of_rows(observations.group < captures)
        assert few_captures_factor(present(fitted(few, Explanation())), few) == pytest.approx(factor, abs=2e-3)

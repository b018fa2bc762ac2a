"""Effects hidden by code that shares nothing with the causes: the diagnosis finds them, or says that it does not.

tests/benchmarks/diagnosis has the sign and the size of every cause.
"""

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from oracle.captures import Plan
from oracle.effects import LISTED_AT_RUN_TIME, OUTLIER, Effect
from oracle.run_time import RunTimePlan
from oracle.unlisted_effects import STATIONS
from present import present

from benchmarks.diagnosis.trial import observed
from benchmarks.diagnosis.truths import truth_of
from wlr_render.diagnosis.causes import CAUSES
from wlr_render.diagnosis.diagnosis import EXPLAINED, LOCATED, NO_EFFECT
from wlr_render.diagnosis.procedure import diagnose
from wlr_render.diagnosis.report import Diagnosis
from wlr_render.diagnosis.settings import Settings
from wlr_render.diagnosis.verdict_sentences import verdict_sentence

SETTINGS = Settings(subsample=1200)
"""About a third of the readings, as in a session of full size."""


def small(device: str, channels: tuple[int, ...] = (1,)) -> Plan:
    return Plan(device, grid=(9, 7), dots=(8, 5), nodes=4, off_plane=12, channels=channels)


def diagnosed(plan: Plan | RunTimePlan, *effects: Effect, causes: Mapping[Any, Any] = CAUSES) -> Diagnosis:
    return diagnose(*observed(plan, effects, np.random.default_rng(1)), causes=causes, settings=SETTINGS)


def names(said: Diagnosis) -> set[Any]:
    return {cause.name for cause in said.causes}


def check_explained(said: Diagnosis, plan: Plan | RunTimePlan, *effects: Effect) -> None:
    """Exactly the hidden effects, down to the noise, with values whose error bars hold the truth."""
    assert names(said) == {effect.name for effect in effects}
    assert said.verdict == EXPLAINED
    assert said.after.over_noise == pytest.approx(1.0, abs=0.04)
    for cause in said.causes:
        (effect,) = (each for each in effects if each.name == cause.name)
        truth = truth_of(effect, plan)
        assert truth
        for parameter in cause.parameters:
            if parameter.name in truth:
                assert abs(parameter.value - truth[parameter.name]) < 4.0 * parameter.sigma


@pytest.mark.parametrize(
    ("device", "effect"),
    [
        ("freeform40", Effect("combiner_shift", {"x_mm": 0.02, "y_mm": 0.03, "z_mm": -0.03})),
        ("birdbath28", Effect("headset_slip", {"x_mm": 0.3, "y_mm": -0.2, "z_mm": 0.3, "start_s": 650.0})),
    ],
    ids=lambda value: getattr(value, "name", value),
)
@pytest.mark.slow
def test_one_cause_is_found_with_its_size_and_sign(device: str, effect: Effect) -> None:
    plan = small(device)
    check_explained(diagnosed(plan, effect), plan, effect)


@pytest.mark.slow
def test_nothing_hidden_is_no_effect_and_says_what_would_have_been_found() -> None:
    said = diagnosed(small("northstar"))
    assert (said.verdict, said.causes, said.excluded) == (NO_EFFECT, (), ())
    limit = {(each.cause, each.parameter): each.limit for each in said.detection_limits}
    assert 0.0 < limit["panel_shift", "shift_u"] < 0.1
    assert 0.0 < limit["tracking_translation", "shift_x"] < 0.8


@pytest.mark.slow
@pytest.mark.parametrize(
    ("device", "effect"),
    [
        (
            "northstar",
            Effect("target_wrinkle", {"height_mm": 8.0, "x_ratio": 0.2, "y_ratio": -0.1, "width_ratio": 0.3}),
        ),
        ("birdbath28", Effect("panel_swings", {"x_mm": 0.03, "y_mm": -0.02, "period_s": 1100.0})),
    ],
    ids=lambda value: getattr(value, "name", value),
)
def test_what_no_cause_stands_for_is_located_without_a_name(device: str, effect: Effect) -> None:
    said = diagnosed(small(device), effect, causes={})
    assert (said.verdict, names(said)) == (LOCATED, set())
    assert said.effects[0].station == STATIONS[effect.name]
    assert said.effects[0].log10_odds > 4


@pytest.mark.slow
def test_a_bubble_is_a_bump_of_its_height_width_and_place() -> None:
    """A cap with a hard edge, while the diagnosis has sine waves; half its height is at .71 of its radius."""
    bubble = Effect("combiner_bubble", {"height_mm": 0.001, "x_mm": -2.0, "y_mm": 1.0, "radius_mm": 2.5})
    said = diagnosed(small("freeform40"), bubble)
    (bump,) = said.effects
    assert (said.verdict, names(said), bump.station, bump.form) == (LOCATED, set(), "combiner", "fine")
    assert abs(bump.size - 1.0) < 3.0 * bump.size_sigma < 0.5
    assert abs(bump.length - np.sqrt(2.0) * 2.5) < 0.4
    np.testing.assert_allclose(present(bump.place), [-2.0, -1.0], atol=0.3)
    assert bump.share_of_excess_removed > 0.7
    assert re.search(r"a bump of 0\.\d+ \+- 0\.\d+ um, 3\.\d+ mm wide, 2\.?\d* mm left of", verdict_sentence(said))


@pytest.mark.slow
def test_a_capture_that_moved_is_set_aside_by_name_and_hides_no_cause() -> None:
    plan, cause = small("northstar"), Effect("camera_focal_length", {"focal_percent": 0.2})
    pose = {"x_mm": 0.5, "y_mm": -0.4, "z_mm": 0.3, "x_deg": 0.1, "y_deg": -0.1, "z_deg": 0.2}
    said = diagnosed(plan, cause, Effect(OUTLIER, {"target_pose": 1, "capture": 6, **pose}))
    assert [str(each.capture) for each in said.excluded] == ["see-through capture 6 of target pose 1"]
    check_explained(said, plan, cause)


@pytest.mark.slow
@pytest.mark.parametrize(
    "effect",
    [
        Effect("rolling_scanout", {"duration_ms": 6.0}),
        Effect("eye_position_bias", {"x_mm": 0.3, "y_mm": -0.4, "z_mm": 0.5}),
    ],
    ids=lambda effect: effect.name,
)
def test_a_cause_that_shows_while_the_glasses_run_is_found(effect: Effect) -> None:
    plan = RunTimePlan("northstar", recordings=8, moments=30, sigma_px=0.2)
    at_run_time = {name: CAUSES[name] for name in LISTED_AT_RUN_TIME}
    check_explained(diagnosed(plan, effect, causes=at_run_time), plan, effect)

"""Captures that moved are found by name and amount, and nothing else is taken for one."""

from collections.abc import Sequence

import numpy as np
import pytest
from diagnosis.small_session import SIGMA_PX, explanation, hypothesis, measured, weighed, with_motions
from present import present

from wlr_render.bench.bench import Bench
from wlr_render.captures.session import SessionPlan
from wlr_render.diagnosis.cause_selection import Search
from wlr_render.diagnosis.diagnosis import MovedCapture
from wlr_render.diagnosis.findings import moved_captures, not_excluded
from wlr_render.diagnosis.observations import DISPLAY, SEE_THROUGH, CaptureName, Observations
from wlr_render.diagnosis.prediction import Explanation
from wlr_render.numerics.scatter import Scatter

STILL = (0.0, 0.0, 0.0)
NEAR, FAR = CaptureName(SEE_THROUGH, 0, 3), CaptureName(SEE_THROUGH, 1, 5)


def with_moved(
    observations: Observations,
    bench: Bench,
    captures: Sequence[CaptureName],
    shift_mm: tuple[float, float, float],
    turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Observations:
    """The same readings, some captures of which a camera took that stands elsewhere."""
    motions = np.zeros((len(observations.captures), 6))
    rows = [observations.captures.index(name) for name in captures]
    motions[rows] = [*np.multiply(1e3, shift_mm), *(1e6 * np.radians(turn_deg))]
    return with_motions(observations, bench, motions)


def found_in(observations: Observations, start: Explanation = Explanation()) -> list[MovedCapture]:  # noqa: B008
    """As the selection of causes finds them, without a further cause."""
    search = Search(weighed(observations), weighed(observations), ())
    return moved_captures(search.full, search.refitted(start, Scatter.usual(len(observations.captures))))


@pytest.mark.parametrize(
    ("shift_mm", "turn_deg"),
    [((0.5, 0.0, 0.0), STILL), ((0.0, 0.5, 0.0), STILL), ((0.0, 0.0, 0.5), STILL), (STILL, (0.2, -0.1, 0.3))],
)
def test_a_photograph_of_the_panel_that_moved_is_found_with_its_shift_and_turn(
    bench: Bench, plan: SessionPlan, shift_mm: tuple[float, float, float], turn_deg: tuple[float, float, float]
) -> None:
    name = CaptureName(DISPLAY, -1, 6)
    (found,) = found_in(with_moved(measured(bench, plan, SIGMA_PX, seed=2), bench, [name], shift_mm, turn_deg))
    assert found.capture == name
    np.testing.assert_allclose(present(found.shift_mm), shift_mm, atol=0.05)
    np.testing.assert_allclose(present(found.turn_deg), turn_deg, atol=0.02)
    assert found.rms_before > 3
    assert found.rms_after == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("name", [NEAR, FAR])
def test_a_photograph_of_a_target_is_found(bench: Bench, plan: SessionPlan, name: CaptureName) -> None:
    """How far it moved, one plane of dots does not tell well: a shift looks like a turn."""
    moved = with_moved(measured(bench, plan, SIGMA_PX, seed=2), bench, [name], (0.5, 0.3, 0.0))
    (found,) = found_in(moved)
    assert found.capture == name
    assert found.rms_before > 3
    assert found.rms_after == pytest.approx(1.0, abs=0.15)


def test_two_that_moved_are_found_on_top_of_a_cause(bench: Bench, plan: SessionPlan) -> None:
    observations = measured(bench, plan, SIGMA_PX, seed=3, combiner_tilt=[0.5, -0.5, 0.5])
    names = [CaptureName(DISPLAY, -1, 2), NEAR]
    observations = with_moved(observations, bench, names, (0.7, 0.0, 0.0))
    search = Search(weighed(observations), weighed(observations), ())
    found = search.refitted(explanation(combiner_tilt=[0, 0, 0]), Scatter.usual(len(observations.captures)))
    assert {each.capture for each in moved_captures(search.full, found)} == set(names)
    np.testing.assert_allclose(found.explanation.vector(), [0.5, -0.5, 0.5], atol=0.01)


def test_readings_of_outliers_are_not_not_excluded(bench: Bench, plan: SessionPlan) -> None:
    observations = with_moved(measured(bench, plan, SIGMA_PX, seed=2), bench, [NEAR], (0.5, 0.0, 0.0))
    excluded = ~not_excluded(observations, found_in(observations))
    np.testing.assert_array_equal(excluded, observations.group == observations.captures.index(NEAR))
    assert not_excluded(observations, []).all()


@pytest.mark.parametrize("seed", range(4))
def test_nothing_moved_in_a_clean_session(bench: Bench, plan: SessionPlan, seed: int) -> None:
    assert found_in(measured(bench, plan, SIGMA_PX, seed=seed)) == []


def test_a_cause_that_moves_every_photograph_sets_none_aside(bench: Bench, plan: SessionPlan) -> None:
    for causes in ({"camera_rotation": [0.3, 0.3, 0.3]}, {"stage_scale": [1.0, 1.0, 1.0]}):
        assert found_in(measured(bench, plan, SIGMA_PX, 0, **causes)) == []


@pytest.mark.parametrize("count", [2, 3, 4])
def test_several_captures_that_moved_alike_do_not_hide_each_other(bench: Bench, plan: SessionPlan, count: int) -> None:
    names = [CaptureName(DISPLAY, -1, number) for number in range(count)]
    found = found_in(with_moved(measured(bench, plan, SIGMA_PX, seed=2), bench, names, (0.5, 0.0, 0.0)))
    assert [each.capture for each in found] == names


def test_recordings_at_run_time_have_no_camera_to_move(bench: Bench, run_time: SessionPlan) -> None:
    observations = measured(bench, run_time, SIGMA_PX)
    present(observations.session.readings.run_time_pixel)[observations.group == 2] += [9.0, 0.0, 0.0, 0.0]
    assert found_in(observations) == []


def test_the_fit_keeps_its_own_camera_causes(bench: Bench, plan: SessionPlan) -> None:
    """Where the camera's offset is fitted already, what a single capture has beyond it is told."""
    observations = measured(bench, plan, SIGMA_PX, seed=2, camera_pupil_offset=[1.0, -1.0, 0.5])
    name = CaptureName(DISPLAY, -1, 6)
    observations = with_moved(observations, bench, [name], (0.5, 0.0, 0.0))
    (found,) = found_in(observations, Explanation().plus(hypothesis("camera_pupil_offset")))
    assert found.capture == name
    np.testing.assert_allclose(present(found.shift_mm), [0.5, 0.0, 0.0], atol=0.1)

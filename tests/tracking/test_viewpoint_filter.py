import itertools
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike, NDArray

from wlr_render.errors import BadInputError
from wlr_render.tracking.viewpoint_filter import LID_S, TrackingState, ViewpointFilter

NOMINAL = np.array([0.032, 0.0, -0.03])
HOLD_S, FADE_S = 0.05, 0.08
TRACKED, HELD, FADING, LOST = TrackingState


def new_filter() -> ViewpointFilter:
    return ViewpointFilter(NOMINAL, hold_s=HOLD_S, fade_s=FADE_S)


def fixate(
    viewpoint_filter: ViewpointFilter, viewpoint: NDArray[Any], start_s: float, end_s: float, rate_hz: float = 200.0
) -> float:
    """Good samples of an eye at rest; the last time."""
    for time_s in np.arange(start_s, end_s, 1 / rate_hz):
        viewpoint_filter.update(time_s, viewpoint)
    return time_s


def dragged_into_a_blink(viewpoint: NDArray[Any], drag_m: float = 0.002) -> tuple[Any, Any, Any]:
    """A filter whose eye rested 0.3 s and was then dragged down by the lid for 25 ms; the last time and sample."""
    viewpoint_filter = new_filter()
    rest_s = fixate(viewpoint_filter, viewpoint, 0.0, 0.3)
    for share in np.arange(1, 25) / 24:
        last_s, last = rest_s + 0.025 * share, viewpoint - [0, drag_m * share, 0]
        viewpoint_filter.update(last_s, last)
    return viewpoint_filter, last_s, last


coordinates = st.floats(-0.05, 0.05) | st.sampled_from([math.nan, math.inf])
samples = st.none() | st.tuples(coordinates, coordinates, coordinates)
steps = st.lists(st.tuples(st.floats(0.0, 0.15), samples, st.floats(0, 1)), min_size=1, max_size=60)


@given(steps)
@settings(max_examples=200, deadline=None)
def test_whatever_comes_the_viewpoint_is_among_the_usable_samples_or_nominal(stream: Any) -> None:
    viewpoint_filter, time_s, usable = new_filter(), 0.0, []
    for step_s, offset, confidence in stream:
        time_s += step_s
        sample = None if offset is None else NOMINAL + offset
        good = sample is not None and confidence >= 0.5 and np.linalg.norm(sample - NOMINAL) <= 0.02
        usable += [sample] if good else []
        result = viewpoint_filter.update(time_s, sample, confidence)
        box = np.array(usable or [NOMINAL])
        assert np.all(result.viewpoint >= box.min(axis=0) - 1e-15)
        assert np.all(result.viewpoint <= box.max(axis=0) + 1e-15)
        assert (result.state == TRACKED) == good
    assert viewpoint_filter.counts.total == len(stream)


def test_a_jump_is_followed_in_the_same_update() -> None:
    viewpoint_filter = new_filter()
    last_s = fixate(viewpoint_filter, NOMINAL, 0.0, 0.3)
    leap = NOMINAL + [0.008, -0.004, 0.002]
    result = viewpoint_filter.update(last_s + 0.002, leap)
    np.testing.assert_array_equal(result.viewpoint, leap)
    assert result.state == TRACKED


@pytest.mark.parametrize("gap_s", [0.01, HOLD_S + 0.5 * FADE_S, 10.0])
def test_the_first_good_sample_after_a_gap_is_followed_at_once(gap_s: float) -> None:
    viewpoint_filter, last_s, _ = dragged_into_a_blink(NOMINAL)
    viewpoint_filter.update(last_s + 0.9 * gap_s, None)
    back = NOMINAL + [0.003, 0, 0]
    result = viewpoint_filter.update(last_s + gap_s, back)
    np.testing.assert_array_equal(result.viewpoint, back)
    assert result.state == TRACKED


@pytest.mark.parametrize(
    ("sample", "confidence"),
    [
        (None, 1.0),
        ([math.nan, 0, -0.03], 1.0),
        ([0.032, math.inf, -0.03], 1.0),
        (NOMINAL + [0.0, 0.021, 0.0], 1.0),
        (NOMINAL, 0.49),
        (NOMINAL, math.nan),
    ],
)
def test_an_unusable_sample_is_held_over(sample: ArrayLike | None, confidence: float) -> None:
    viewpoint_filter = new_filter()
    seen = NOMINAL + [0.001, 0.002, 0.003]
    viewpoint_filter.update(0.0, seen)
    result = viewpoint_filter.update(0.01, sample, confidence)
    np.testing.assert_array_equal(result.viewpoint, seen)
    assert result.state == HELD


def test_held_then_fading_then_lost_exactly_where_the_eye_was_before_the_lid_came_down() -> None:
    rest = NOMINAL + [0.002, 0.001, 0.0]
    viewpoint_filter, last_s, last = dragged_into_a_blink(rest)
    results = {gap_s: viewpoint_filter.update(last_s + gap_s, None) for gap_s in (0.049, 0.051, 0.129, 0.131, 60.0)}
    assert [result.state for result in results.values()] == [HELD, FADING, FADING, LOST, LOST]
    np.testing.assert_array_equal(results[0.049].viewpoint, last)
    for gap_s in (0.131, 60.0):
        np.testing.assert_array_equal(results[gap_s].viewpoint, rest)


def test_single_wild_samples_do_not_move_the_place_that_the_fade_ends_at() -> None:
    viewpoint_filter = new_filter()
    for index, time_s in enumerate(np.arange(60) * 0.005):
        viewpoint_filter.update(time_s, NOMINAL + [0.015 if index % 5 == 4 else 0.001, 0, 0])
    np.testing.assert_allclose(viewpoint_filter.update(5.0, None).viewpoint, NOMINAL + [0.001, 0, 0], atol=1e-16)


def test_through_a_loss_the_viewpoint_moves_without_a_jump_no_faster_than_minimum_jerk_does() -> None:
    viewpoint_filter, last_s, last = dragged_into_a_blink(NOMINAL)
    gap_s = np.arange(0.0, 0.2, 0.0005)
    path = np.array([viewpoint_filter.update(last_s + gap, None).viewpoint for gap in gap_s])
    speed = np.linalg.norm(np.diff(path, axis=0), axis=1) / 0.0005
    limit = 15 / 8 * np.linalg.norm(NOMINAL - last) / FADE_S
    assert 0.99 * limit < speed.max() <= limit * (1 + 1e-9)
    acceleration = np.linalg.norm(np.diff(path, 2, axis=0), axis=1) / 0.0005**2
    assert acceleration.max() < 6 * np.linalg.norm(NOMINAL - last) / FADE_S**2


def test_samples_while_the_lid_goes_up_are_followed_but_not_trusted() -> None:
    viewpoint_filter, last_s, _ = dragged_into_a_blink(NOMINAL)
    viewpoint_filter.update(last_s + 0.2, None)
    opening_s = last_s + 0.25
    open_s = fixate(viewpoint_filter, NOMINAL - [0, 0.002, 0], opening_s, opening_s + LID_S - 0.001)
    fixate(viewpoint_filter, NOMINAL + [0.004, 0, 0], open_s + 0.005, open_s + 0.04)
    np.testing.assert_array_equal(viewpoint_filter.update(opening_s + 5.0, None).viewpoint, NOMINAL)


def test_after_the_lid_went_up_the_new_place_is_trusted() -> None:
    viewpoint_filter, last_s, _ = dragged_into_a_blink(NOMINAL)
    viewpoint_filter.update(last_s + 0.2, None)
    place = NOMINAL + [0.004, 0, 0]
    end_s = fixate(viewpoint_filter, place, last_s + 0.25, last_s + 0.55)
    np.testing.assert_array_equal(viewpoint_filter.update(end_s + 5.0, None).viewpoint, place)


def test_a_tracker_that_misses_every_other_sample_is_trusted_all_the_same() -> None:
    viewpoint_filter = new_filter()
    place = NOMINAL + [0.004, 0, 0]
    for index in range(40):
        viewpoint_filter.update(0.01 * index, place if index % 2 else None)
    viewpoint_filter.update(0.4, place - [0, 0.002, 0])
    np.testing.assert_array_equal(viewpoint_filter.update(5.0, None).viewpoint, place)


def test_an_eye_never_seen_is_at_the_nominal_viewpoint_and_one_seen_too_briefly_stays_where_it_was() -> None:
    viewpoint_filter = new_filter()
    unseen = viewpoint_filter.update(0.0, None)
    np.testing.assert_array_equal(unseen.viewpoint, NOMINAL)
    assert unseen.state == LOST
    glimpse = NOMINAL + [0.001, 0, 0]
    viewpoint_filter.update(0.01, glimpse)
    np.testing.assert_array_equal(viewpoint_filter.update(5.0, None).viewpoint, glimpse)


def test_what_the_caller_does_to_its_arrays_does_not_reach_the_filter() -> None:
    viewpoint_filter, sample = new_filter(), NOMINAL.copy()
    first = viewpoint_filter.update(0.0, sample)
    sample += 1.0
    first.viewpoint[:] = math.nan
    np.testing.assert_array_equal(viewpoint_filter.update(0.01, None).viewpoint, NOMINAL)


def test_the_counts_are_of_the_states_that_were_returned() -> None:
    viewpoint_filter, last_s, _ = dragged_into_a_blink(NOMINAL)
    before = viewpoint_filter.counts
    for gap_s in (0.01, 0.02, 0.1, 0.2, 0.3, 0.4):
        viewpoint_filter.update(last_s + gap_s, None)
    assert dict(viewpoint_filter.counts.by_state) == {TRACKED: 84, HELD: 2, FADING: 1, LOST: 3}
    assert viewpoint_filter.counts.sentence == "90 updates: 84 tracked, 2 held, 1 fading, 3 lost"
    assert before.total == 84


@pytest.mark.parametrize(
    ("time_s", "sample", "complaint"),
    [
        (math.nan, NOMINAL, "time of an eye sample is nan"),
        (math.inf, None, "time of an eye sample is inf"),
        (0.2, NOMINAL, "comes after one at"),
        (1.0, [0.03, 0.0], "three numbers"),
        (1.0, NOMINAL[None], "three numbers"),
        (1.0, "ahead", "three numbers"),
    ],
)
def test_a_refused_update_leaves_the_filter_as_it_was(
    time_s: float, sample: ArrayLike | str | None, complaint: str
) -> None:
    disturbed, last_s, _ = dragged_into_a_blink(NOMINAL)
    untouched = dragged_into_a_blink(NOMINAL)[0]
    with pytest.raises(BadInputError, match=complaint):
        disturbed.update(time_s, sample)
    for gap_s, follow_up in itertools.product((0.0, 0.02, 0.1, 0.4), (None, NOMINAL + 0.001)):
        pair = [each.update(last_s + gap_s, follow_up) for each in (disturbed, untouched)]
        np.testing.assert_array_equal(pair[0].viewpoint, pair[1].viewpoint)
    assert disturbed.counts == untouched.counts


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"nominal_in_device": [0.03, 0.0]}, "three numbers"),
        ({"nominal_in_device": [0.03, 0.0, math.nan]}, "nominal viewpoint"),
        ({"hold_s": -0.01}, "hold_s"),
        ({"hold_s": math.nan}, "hold_s"),
        ({"fade_s": 0.0}, "fade_s"),
        ({"fade_s": math.inf}, "fade_s"),
        ({"reach_m": math.nan}, "reach_m"),
        ({"min_confidence": math.nan}, "min_confidence"),
    ],
)
def test_settings_that_make_no_sense_are_refused(changes: dict[str, Any], complaint: str) -> None:
    with pytest.raises(BadInputError, match=complaint):
        ViewpointFilter(**{"nominal_in_device": NOMINAL, **changes})

"""Pacing of frames, with a clock that the tests move."""

import numpy as np
import pytest

from wlr_render.errors import BadInputError
from wlr_render.numerics.arrays import FloatArray
from wlr_render.warp.frame_pacing import FramePacer

NOMINAL_S, TRUE_S = 1 / 90, 1.0005 / 90
"""The display's period as it is stated, and as it is: 0.05 % longer."""
MARGIN_S = 1e-3


class Clock:
    def __init__(self) -> None:
        self.now_s = 17.3

    def __call__(self) -> float:
        return self.now_s


def paced(works_s: list[float], seed: int, jitter_s: float = 1e-4, reported: int = 1) -> FloatArray:
    """Run frames of these durations; return (begin, finish, display, true beat after the finish) of each."""
    rng, clock = np.random.default_rng(seed), Clock()
    pacer, first_s = FramePacer(NOMINAL_S, MARGIN_S, clock), 17.3 + rng.uniform(0, TRUE_S)
    rows = []
    for work_s in works_s:
        frame = pacer.next_frame()
        clock.now_s = frame.begin_s + work_s
        finish_s = clock.now_s
        pacer.finished(frame)
        beat_s = first_s + np.ceil((finish_s - first_s) / TRUE_S) * TRUE_S
        rows.append((frame.begin_s, finish_s, frame.display_s, beat_s))
        if len(rows) % reported == 0:
            pacer.shown(beat_s - TRUE_S + rng.normal(0, jitter_s))  # the last beat before it
    return np.array(rows)


@pytest.mark.parametrize("seed", range(5))
def test_frames_are_finished_just_before_their_beat(seed: int) -> None:
    works = np.random.default_rng(seed + 100).normal(4e-3, 2e-4, 600).clip(3e-3, 5e-3)
    begin, finish, display, beat = paced(list(works), seed)[60:].T
    assert np.abs(display - beat).max() < 0.6e-3  # the planned beat is the one that shows it
    assert (finish < beat).all()
    assert np.median(np.diff(display)) == pytest.approx(TRUE_S, rel=1e-3)  # each beat has a frame
    assert (display - begin).max() < works.max() + MARGIN_S + 1e-5  # and none begins earlier than it must


def test_rare_reports_of_beats_are_enough() -> None:
    _, finish, display, beat = paced([4e-3] * 900, 3, reported=30)[60:].T
    assert np.abs(display - beat).max() < 0.6e-3
    assert (finish < beat).all()


def test_a_program_that_cannot_keep_the_beat_is_paced_at_every_second_one() -> None:
    begin, finish, display, beat = paced([4e-3] * 100 + [15e-3] * 100, 0)[102:].T  # one slow frame may be a hitch
    assert (finish < beat).all()
    np.testing.assert_allclose(np.diff(display), 2 * TRUE_S, atol=3e-4)
    assert (display - begin).max() < 15e-3 + MARGIN_S + 1e-5


def test_after_a_slow_frame_the_beat_is_kept_again() -> None:
    begin, finish, display, beat = paced([4e-3] * 60 + [0.2] + [4e-3] * 60, 1).T
    assert finish[60] > display[60]  # nobody could know
    assert (finish[61:] < beat[61:]).all()
    assert (display - begin)[61:].max() < 4e-3 + MARGIN_S + TRUE_S
    assert np.median(np.diff(display[-20:])) == pytest.approx(TRUE_S, abs=3e-4)


def test_frames_that_overlap_have_beats_of_their_own() -> None:
    pacer = FramePacer(NOMINAL_S, MARGIN_S, Clock())
    first, second = pacer.next_frame(), pacer.next_frame()
    assert second.display_s - first.display_s == pytest.approx(NOMINAL_S)
    assert first.ahead_s == first.display_s - first.begin_s
    clock = Clock()
    pacer = FramePacer(NOMINAL_S, MARGIN_S, clock)
    frames = [pacer.next_frame(), pacer.next_frame()]
    for _ in range(20):  # two frames at a time, of 10 ms each
        clock.now_s = frames[0].begin_s + 10e-3
        pacer.finished(frames.pop(0))
        frames.append(pacer.next_frame())
    assert frames[-1].ahead_s == pytest.approx(10e-3 + MARGIN_S, abs=1e-6)


def test_poses_are_predicted_as_far_as_a_compositor_does() -> None:
    clock = Clock()
    pacer = FramePacer(0.5, 0.0, clock)
    frame = pacer.next_frame()
    assert frame.display_s - frame.begin_s > 0.1
    assert frame.ahead_s == 0.1


def test_bad_numbers_are_refused() -> None:
    for arguments, words in (((0.0,), "period_s"), ((float("nan"),), "period_s"), ((0.01, 0.02), "margin_s")):
        with pytest.raises(BadInputError, match=words):
            FramePacer(*arguments)

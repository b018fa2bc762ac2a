import numpy as np
import pytest
from streamed import BOX, RATE_HZ, fixations, recorded

from benchmarks.soak.wearer import Wearer
from wlr_render.errors import BadInputError
from wlr_render.mappings import EyeBox
from wlr_render.tracking.viewpoint_filter import TrackingState

HELD, FADING, LOST, TRACKED = (TrackingState[name] for name in ("HELD", "FADING", "LOST", "TRACKED"))


def head_file(folder, *rows):
    path = folder / "head.tum"
    path.write_text("\n".join(f"{t} {x} 0 0 0 0 0 1" for t, x in rows) + "\n")
    return path


def states_of(moments):
    return [moment.eyes["right"].state for moment in moments]


def viewpoints_of(moments):
    return np.stack([moment.eyes["right"].viewpoint for moment in moments])


def test_a_gap_in_a_recording_is_held_then_faded_then_waited_out_and_left_at_once(tmp_path):
    before, after = [1.0, 0.0, 0.5], [-2.0, 1.0, 0.0]
    drifting = np.array(before) + np.linspace(-0.4, 0.0, 20)[:, None] * [0.0, 1.0, 0.0]
    places = np.concatenate([drifting, fixations(before, each=30), fixations(after, each=5)])
    wearer = recorded(tmp_path / "eyes.txt", places, lost=range(20, 50))
    moments = wearer.moments({"right": BOX}, 55, RATE_HZ)
    states = states_of(moments)
    assert states == sorted(states[:50]) + [TRACKED] * 5
    assert set(states) == set(TrackingState)
    offset_mm = 1e3 * (viewpoints_of(moments) - BOX.centre)
    held, lost = ([k for k, state in enumerate(states) if state == which] for which in (HELD, LOST))
    np.testing.assert_allclose(offset_mm[held], np.broadcast_to(before, (len(held), 3)), atol=1e-9)
    # What is trusted ended 50 ms before the loss, when the pupil was lower.
    assert np.ptp(offset_mm[lost], axis=0).max() < 1e-9
    assert offset_mm[lost][0, 1] < before[1] - 0.05
    np.testing.assert_allclose(offset_mm[50], after, atol=1e-9)
    assert moments[50].eyes["right"].jumped
    assert not any(moment.jumped for moment in moments[:50])


def test_a_pupil_beyond_the_models_reach_is_brought_back_to_its_rim(tmp_path):
    wearer = recorded(tmp_path / "eyes.txt", fixations([0, 0, 0], [15.0, 0, 0]))
    inside, beyond = wearer.moments({"right": BOX}, 8, RATE_HZ)[3::4]
    assert not inside.eyes["right"].brought_back
    at = beyond.eyes["right"]
    assert at.brought_back
    assert BOX.size[0] / 2 < at.viewpoint[0] - BOX.centre[0] < BOX.size[0] + 1e-3
    np.testing.assert_allclose(at.viewpoint[1:], BOX.centre[1:], atol=1e-12)


def test_a_made_up_wearer_follows_from_the_seed_and_moves_both_eyes():
    boxes = {"left": EyeBox(BOX.centre - [0.06, 0, 0], BOX.size), "right": BOX}
    first, again, other = (Wearer(seed=seed).moments(boxes, 400, 90.0) for seed in (1, 1, 2))
    for moments, same in ((again, True), (other, False)):
        assert np.array_equal(viewpoints_of(first), viewpoints_of(moments)) == same
        assert np.array_equal(first[9].at_scan_out, moments[9].at_scan_out) == same
    seen = np.array([state == TRACKED for state in states_of(first)])
    assert np.linalg.norm(np.diff(viewpoints_of(first), axis=0), axis=1)[seen[1:]].min() > 0
    apart = viewpoints_of(first) - np.stack([moment.eyes["left"].viewpoint for moment in first])
    assert apart[:, 0].min() > 0.05


def test_a_late_pose_is_the_heads_own_at_that_time(tmp_path):
    head = head_file(tmp_path, (0, 0.0), (10, 1.0))
    moments = Wearer(head=head).moments({"right": BOX}, 5, 10.0, late_s=0.02)
    for k, moment in enumerate(moments):
        np.testing.assert_allclose(moment.world_from_device[0, 3], 0.01 * k, atol=1e-12)
        np.testing.assert_allclose(moment.at_scan_out[0, 3], 0.01 * k + 0.002, atol=1e-12)


def test_in_a_gap_the_heads_last_pose_is_kept_and_left_at_once(tmp_path):
    rows = [(0.1 * k, 0.1 * k) for k in range(21) if not 10 < k < 15]
    moments = Wearer(head=head_file(tmp_path, *rows)).moments({"right": BOX}, 40, 20.0, late_s=0.02)
    for moment in moments:
        gone = 1.001 < moment.time_s < 1.499
        assert moment.head_lost == gone
        np.testing.assert_allclose(moment.world_from_device[0, 3], 1.0 if gone else moment.time_s, atol=1e-9)
    assert moments[21].at_scan_out[0, 3] == pytest.approx(1.0)
    assert moments[31].at_scan_out[0, 3] == pytest.approx(1.57)


def test_the_frames_begin_where_all_tracks_do_and_fill_them_to_the_last_row(tmp_path):
    head = head_file(tmp_path, (0.03, 0.0), (10, 1.0))
    eyes = recorded(tmp_path / "eyes.txt", fixations([0, 0, 0], [1, 0, 0])).eyes
    moments = Wearer(head=head, eyes=eyes).moments({"right": BOX}, 5, RATE_HZ)
    assert (moments[0].time_s, moments[-1].time_s) == (0.03, pytest.approx(0.07))


def test_recordings_that_do_not_do_are_refused_in_a_sentence(tmp_path):
    eyes = recorded(tmp_path / "eyes.txt", fixations([0, 0, 0], [1, 0, 0])).eyes
    later = head_file(tmp_path, (5, 0.0), (6, 0.0))
    for wearer, boxes, sentence in (
        (Wearer(eyes=eyes), {"right": BOX}, "cover 0.070 s, which is 8 frames at 100 per second, and 9 were asked for"),
        (Wearer(later, eyes), {"right": BOX}, "do not overlap in time"),
        (Wearer(eyes=eyes), {"left": BOX}, "has no left eye, only the right one"),
    ):
        with pytest.raises(BadInputError, match=sentence):
            wearer.moments(boxes, 9, RATE_HZ)
    with pytest.raises(BadInputError, match="which is 6 frames"):
        Wearer(eyes=eyes).moments({"right": BOX}, 8, RATE_HZ, late_s=0.02)

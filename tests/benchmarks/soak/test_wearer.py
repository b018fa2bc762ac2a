from collections.abc import Sequence
from pathlib import Path

import numpy as np
from streamed import BOX, RATE_HZ, fixations, recorded

from benchmarks.soak.records import StreamFrame
from benchmarks.soak.wearer import Wearer
from wlr_render.mappings import EyeBox
from wlr_render.numerics.arrays import FloatArray
from wlr_render.tracking.viewpoint_filter import TrackingState

HELD, FADING, LOST, TRACKED = (TrackingState[name] for name in ("HELD", "FADING", "LOST", "TRACKED"))


def head_file(folder: Path, *rows: tuple[int, float]) -> Path:
    path = folder / "head.tum"
    path.write_text("\n".join(f"{t} {x} 0 0 0 0 0 1" for t, x in rows) + "\n")
    return path


def states_of(moments: Sequence[StreamFrame]) -> list[TrackingState]:
    return [moment.eyes["right"].state for moment in moments]


def viewpoints_of(moments: Sequence[StreamFrame]) -> FloatArray:
    return np.stack([moment.eyes["right"].viewpoint for moment in moments])


def test_a_gap_in_a_recording_is_held_then_faded_then_waited_out_and_left_at_once(tmp_path: Path) -> None:
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


def test_a_made_up_wearer_follows_from_the_seed_and_moves_both_eyes() -> None:
    boxes = {"left": EyeBox(BOX.centre - [0.06, 0, 0], BOX.size), "right": BOX}
    first, again, other = (Wearer(seed=seed).moments(boxes, 400, 90.0) for seed in (1, 1, 2))
    for moments, same in ((again, True), (other, False)):
        assert np.array_equal(viewpoints_of(first), viewpoints_of(moments)) == same
        assert np.array_equal(first[9].at_scan_out, moments[9].at_scan_out) == same
    seen = np.array([state == TRACKED for state in states_of(first)])
    assert np.linalg.norm(np.diff(viewpoints_of(first), axis=0), axis=1)[seen[1:]].min() > 0
    apart = viewpoints_of(first) - np.stack([moment.eyes["left"].viewpoint for moment in first])
    assert apart[:, 0].min() > 0.05


def test_a_late_pose_is_the_heads_own_at_that_time(tmp_path: Path) -> None:
    head = head_file(tmp_path, (0, 0.0), (10, 1.0))
    moments = Wearer(head=head).moments({"right": BOX}, 5, 10.0, late_s=0.02)
    for k, moment in enumerate(moments):
        np.testing.assert_allclose(moment.world_from_device[0, 3], 0.01 * k, atol=1e-12)
        np.testing.assert_allclose(moment.at_scan_out[0, 3], 0.01 * k + 0.002, atol=1e-12)

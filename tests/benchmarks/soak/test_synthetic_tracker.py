import numpy as np
import pytest

from benchmarks.soak.synthetic_tracker import tracker_samples
from wlr_render.errors import BadInputError
from wlr_render.tracking import synthetic
from wlr_render.tracking.trajectory import EyeTrajectory, ViewpointTrack
from wlr_render.tracking.viewpoint_filter import ViewpointFilter

VIEWPOINTS = {"left": np.array([-0.032, 0, -0.03]), "right": np.array([0.032, 0, -0.03])}


def eyes_at_rest(duration_s):
    time_s = np.array([0.0, duration_s])
    return EyeTrajectory({eye: ViewpointTrack(time_s, np.array([place, place])) for eye, place in VIEWPOINTS.items()})


def seen(samples):
    """(n, 3), NaN where there is no sample."""
    return np.array([np.full(3, np.nan) if sample is None else sample for sample in samples])


def runs(flags):
    """First index and length of each run of true flags, (m, 2)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]]))).reshape(-1, 2)
    return np.stack([edges[:, 0], edges[:, 1] - edges[:, 0]], axis=1)


def test_the_same_seed_gives_the_same_samples_and_another_seed_and_eye_others():
    eyes, time_s = eyes_at_rest(60.0), np.arange(0, 60, 0.01)
    first, again, other = (tracker_samples(eyes, time_s, seed) for seed in (1, 1, 2))
    for eye in VIEWPOINTS:
        np.testing.assert_array_equal(seen(first[eye]), seen(again[eye]))
        assert np.any(np.isnan(seen(first[eye])) != np.isnan(seen(other[eye])))
    assert np.any(np.isnan(seen(first["left"])) != np.isnan(seen(first["right"])))


def test_a_moment_s_sample_does_not_depend_on_the_other_moments_nor_on_the_other_eye():
    eyes, time_s = eyes_at_rest(60.0), np.arange(12000) / 200.0
    dense = seen(tracker_samples(eyes, time_s, 4)["right"])
    coarse = seen(tracker_samples(eyes, time_s[:6000:4], 4)["right"])
    np.testing.assert_array_equal(coarse, dense[:6000:4])
    alone = EyeTrajectory({"right": eyes.tracks["right"]})
    np.testing.assert_array_equal(seen(tracker_samples(alone, time_s, 4)["right"]), dense)


def test_eyes_blink_together_some_17_times_a_minute_for_100_to_300_ms():
    samples = tracker_samples(eyes_at_rest(600.0), np.arange(0, 600, 0.002), 5)
    lost = {eye: np.isnan(seen(samples[eye])[:, 0]) for eye in VIEWPOINTS}
    both = runs(lost["left"] & lost["right"])
    blinks = both[both[:, 1] * 0.002 > 0.06]
    assert 14 < len(blinks) / 10 < 20
    assert blinks[:, 1].min() * 0.002 > 0.095
    assert blinks[:, 1].max() * 0.002 < 0.36  # with a dropout at its edge
    assert 5 < (len(runs(lost["left"])) - len(blinks)) / 10 < 15


def test_the_lid_drags_the_pupil_down_only_and_only_beside_a_blink():
    time_s = np.arange(0, 120, 0.001)
    offset = seen(tracker_samples(eyes_at_rest(120.0), time_s, 6)["right"]) - VIEWPOINTS["right"]
    lost = np.isnan(offset[:, 0])
    np.testing.assert_allclose(offset[~lost][:, [0, 2]], 0, atol=1e-16)
    drag = -offset[:, 1]
    assert np.nanmin(drag) == 0
    assert 0.0018 < np.nanmax(drag) < 0.002
    for start, length in runs(lost)[runs(lost)[:, 1] > 60]:
        assert drag[start - 1] > 0.0018
        assert not np.any(np.diff(drag[start - 24 : start]) <= 0)  # NaN where a dropout falls there
        assert not np.any(np.diff(drag[start + length : start + length + 39]) >= 0)
    dragged = np.flatnonzero(drag > 0)
    blink_edges = np.concatenate([[start, start + length] for start, length in runs(lost) if length > 60])
    assert np.abs(dragged[:, None] - blink_edges).min(axis=1).max() <= 41


def errors_while_lost(eyes, time_s, seed):
    """(k,) distances to the true right eye where it is lost: of the filter, and of holding the last sample."""
    samples = tracker_samples(eyes, time_s, seed)["right"]
    truth = eyes.viewpoint_at("right", time_s)
    viewpoint_filter = ViewpointFilter(VIEWPOINTS["right"])
    filtered = np.array([viewpoint_filter.update(*pair).viewpoint for pair in zip(time_s, samples, strict=True)])
    lost = np.isnan(seen(samples)[:, 0])
    last = np.maximum.accumulate(np.where(lost, 0, np.arange(lost.size)))
    return [np.linalg.norm(each - truth, axis=1)[lost] for each in (filtered, seen(samples)[last])]


def test_when_an_eye_at_rest_blinks_the_filter_returns_to_the_truth_and_the_last_sample_does_not():
    time_s = np.arange(0, 60, 1 / 250)
    error, held_error = errors_while_lost(eyes_at_rest(60.0), time_s, 8)
    dragged = held_error > 0.001
    assert np.mean(error[dragged] < 1e-15) > 0.4
    assert np.all(error <= held_error + 1e-15)


def test_when_an_eye_on_the_move_blinks_the_filter_is_nearer_to_the_truth_than_the_last_sample_is():
    time_s = np.arange(0, 60, 1 / 90)
    pairs = [errors_while_lost(synthetic.eye_motion(VIEWPOINTS, seed, 60.0), time_s, seed) for seed in range(6)]
    error, held_error = (np.concatenate(each) for each in zip(*pairs, strict=True))
    assert np.mean(error) < 0.9 * np.mean(held_error)


@pytest.mark.parametrize(
    ("time_s", "complaint"),
    [
        ([0.0, 61.0], "outside its range"),
        ([0.0, 2.0, 1.0], "does not come after"),
        ([0.0, np.nan], "does not come after"),
        ([], "at least two"),
    ],
)
def test_moments_that_are_not_a_stream_within_the_movement_are_refused(time_s, complaint):
    with pytest.raises(BadInputError, match=complaint):
        tracker_samples(eyes_at_rest(60.0), np.array(time_s), 1)

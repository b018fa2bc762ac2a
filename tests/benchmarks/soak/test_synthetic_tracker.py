from collections.abc import Sequence

import numpy as np

from benchmarks.soak.synthetic_tracker import tracker_samples
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray
from wlr_render.tracking.trajectory import EyeTrajectory, ViewpointTrack

VIEWPOINTS = {"left": np.array([-0.032, 0, -0.03]), "right": np.array([0.032, 0, -0.03])}


def eyes_at_rest(duration_s: float) -> EyeTrajectory:
    time_s = np.array([0.0, duration_s])
    return EyeTrajectory({eye: ViewpointTrack(time_s, np.array([place, place])) for eye, place in VIEWPOINTS.items()})


def seen(samples: Sequence[FloatArray | None]) -> FloatArray:
    """(n, 3), NaN where there is no sample."""
    return np.array([np.full(3, np.nan) if sample is None else sample for sample in samples])


def runs(flags: BoolArray) -> IntArray:
    """First index and length of each run of true flags, (m, 2)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]]))).reshape(-1, 2)
    return np.stack([edges[:, 0], edges[:, 1] - edges[:, 0]], axis=1)


def test_the_same_seed_gives_the_same_samples_and_another_seed_and_eye_others() -> None:
    eyes, time_s = eyes_at_rest(60.0), np.arange(0, 60, 0.01)
    first, again, other = (tracker_samples(eyes, time_s, seed) for seed in (1, 1, 2))
    for eye in VIEWPOINTS:
        np.testing.assert_array_equal(seen(first[eye]), seen(again[eye]))
        assert np.any(np.isnan(seen(first[eye])) != np.isnan(seen(other[eye])))
    assert np.any(np.isnan(seen(first["left"])) != np.isnan(seen(first["right"])))


def test_eyes_blink_together_some_17_times_a_minute_for_100_to_300_ms() -> None:
    samples = tracker_samples(eyes_at_rest(600.0), np.arange(0, 600, 0.002), 5)
    lost = {eye: np.isnan(seen(samples[eye])[:, 0]) for eye in VIEWPOINTS}
    both = runs(lost["left"] & lost["right"])
    blinks = both[both[:, 1] * 0.002 > 0.06]
    assert 14 < len(blinks) / 10 < 20
    assert blinks[:, 1].min() * 0.002 > 0.095
    assert blinks[:, 1].max() * 0.002 < 0.36  # with a dropout at its edge
    assert 5 < (len(runs(lost["left"])) - len(blinks)) / 10 < 15

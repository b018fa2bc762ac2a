"""A recording of head motion shows its noise where readings that are near each other at no station are alike."""

import numpy as np
import pytest
from diagnosis.small_session import SIGMA_PX, diagnosed, measured, with_noise, with_readings
from present import present

from wlr_render.bench.bench import Bench
from wlr_render.captures.session import SessionPlan
from wlr_render.diagnosis.diagnosis import NO_EFFECT, UNEXPLAINED

CAUSES = ("latency", "eye_position_bias")
LARGER = 2.0


@pytest.mark.slow
def test_noise_of_another_size_is_measured_and_said_first(bench: Bench, run_time: SessionPlan) -> None:
    observations = measured(bench, run_time, SIGMA_PX, seed=3)
    noisier = with_noise(observations, SIGMA_PX * np.sqrt(LARGER**2 - 1.0), np.random.default_rng(4))
    said = diagnosed(noisier, CAUSES)
    (floor,) = said.noise_floors
    assert said.verdict == NO_EFFECT
    assert floor.measured_px / floor.stated_px == pytest.approx(LARGER, abs=4.0 * floor.error_px / floor.stated_px)
    assert not floor.is_believable
    assert str(said).startswith("No effect found, but the run-time readings are")
    assert said.after.run_time_rms_arcmin == pytest.approx(said.expected.run_time_rms_arcmin, rel=0.05)


@pytest.mark.slow
def test_what_is_alike_at_a_station_is_no_noise(bench: Bench, run_time: SessionPlan) -> None:
    """The picture jumps by steps of the gaze that are too fine for a field."""
    plan = run_time.run_time
    cells = np.floor(present(plan).gaze[:, 0] / 0.01).astype(int)
    steps = np.random.default_rng(5).normal(0.0, 3.0 * SIGMA_PX, (200, 2))[cells - cells.min()]
    observations = measured(bench, run_time, SIGMA_PX, seed=3)
    pixel = present(observations.session.readings.run_time_pixel).copy()
    pixel[:, :2] += steps
    said = diagnosed(with_readings(observations, run_time_pixel=pixel), CAUSES)
    assert said.verdict == UNEXPLAINED
    assert np.isnan(said.noise_floors[0].measured_px)


@pytest.mark.slow
def test_noise_is_not_measured_where_a_fit_cannot_find_it_or_where_readings_are_few(
    bench: Bench, run_time: SessionPlan
) -> None:
    """A fit takes no noise for smaller than stated; and a few readings do not tell noise from an effect."""
    quiet = measured(bench, run_time, 0.5 * SIGMA_PX, seed=3)
    noisy = measured(bench, run_time, LARGER * SIGMA_PX, seed=3)
    few = noisy.of_rows(np.arange(len(noisy)) < 20)
    for observations in (quiet, few):
        said = diagnosed(observations, CAUSES)
        assert np.isnan(said.noise_floors[0].measured_px)
    assert said.verdict == UNEXPLAINED

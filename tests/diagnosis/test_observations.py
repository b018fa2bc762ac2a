"""A session as residuals in units of the noise: what counts as one unit, and which reading belongs to which capture."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis.small_session import SIGMA_PX, explanation, with_readings
from present import present

from wlr_render.bench.bench import Bench
from wlr_render.bench.simulate_session import simulate
from wlr_render.captures.session import Readings, Session, SessionPlan, select_rows
from wlr_render.diagnosis.observations import DISPLAY, RUN_TIME, SEE_THROUGH, CaptureName, Observations
from wlr_render.diagnosis.prediction import Predictor
from wlr_render.errors import BadInputError


@pytest.fixture(scope="module")
def every_part(bench: Bench, plan: SessionPlan, run_time: SessionPlan) -> Observations:
    """A session of all three parts without noise, and what was read."""
    whole = SessionPlan(plan.display, plan.see_through, run_time.run_time)
    session = Session("whole", whole, simulate(bench, whole))
    return Predictor.of_session(bench, session).observations


def test_what_a_bench_reads_has_no_residual_against_it(bench: Bench, every_part: Observations) -> None:
    residual = every_part.residual(simulate(bench, every_part.session.plan))
    assert residual.shape == (len(every_part), 2)
    np.testing.assert_array_equal(residual, 0.0)


def test_every_reading_belongs_to_its_capture(every_part: Observations) -> None:
    plan = every_part.session.plan
    names = [every_part.captures[group] for group in every_part.group]
    assert list(every_part.captures) == sorted(set(names))
    assert plan.see_through is not None
    seen = zip(plan.see_through.target_pose, plan.see_through.capture, strict=True)
    expected = [CaptureName(DISPLAY, -1, c) for c in present(plan.display).capture]
    expected += [CaptureName(SEE_THROUGH, p, c) for p, c in seen]
    expected += [CaptureName(RUN_TIME, -1, c) for c in present(plan.run_time).capture]
    assert names == expected
    np.testing.assert_array_equal(every_part.part, [name.part for name in names])


def test_a_dot_off_by_sigma_is_one_unit(bench: Bench, clean: Observations) -> None:
    read = clean.session.readings
    moved = with_readings(clean, dot_pixel=present(read.dot_pixel) + SIGMA_PX * np.array([1.0, -2.0]))
    residual = moved.residual(simulate(bench, clean.session.plan))
    np.testing.assert_array_equal(residual[clean.part == DISPLAY], 0.0)
    np.testing.assert_allclose(residual[clean.part == SEE_THROUGH], np.tile([1.0, -2.0], (882, 1)), rtol=1e-9)
    half = moved.with_sigma(2 * clean.sigma_px).residual(simulate(bench, clean.session.plan))
    np.testing.assert_allclose(half, 0.5 * residual)


def test_a_panel_position_that_is_seen_a_sigma_beside_is_one_unit(bench: Bench, clean: Observations) -> None:
    """The noise of a decoded position is the camera's: it is read where a pixel a little beside would be."""
    shown = clean.session.plan.display
    assert shown is not None
    beside = replace(shown, camera_pixel=shown.camera_pixel + SIGMA_PX * np.array([0.6, -0.8]))
    moved = with_readings(clean, panel_pixel=simulate(bench, SessionPlan(beside)).panel_pixel)
    residual = moved.residual(simulate(bench, clean.session.plan))[clean.part == DISPLAY]
    np.testing.assert_allclose(residual, np.tile([0.6, -0.8], (len(residual), 1)), atol=2e-3)


def test_at_run_time_only_the_gap_between_the_dots_counts(bench: Bench, every_part: Observations) -> None:
    read = every_part.session.readings
    predicted = simulate(bench, every_part.session.plan)
    both = with_readings(every_part, run_time_pixel=present(read.run_time_pixel) + 10.0)
    np.testing.assert_allclose(both.residual(predicted), 0.0, atol=1e-9)
    one = with_readings(
        every_part, run_time_pixel=present(read.run_time_pixel) + SIGMA_PX * np.array([1.0, 0.0, 0.0, 0.0])
    )
    rows = every_part.part == RUN_TIME
    # Two dots are read, so that one of them off by sigma is less than a standard deviation of the gap.
    np.testing.assert_allclose(one.residual(predicted)[rows], np.tile([np.sqrt(0.5), 0.0], (rows.sum(), 1)), atol=1e-9)


def test_some_rows_have_the_residuals_that_they_have_among_all(bench: Bench, every_part: Observations) -> None:
    keep = np.random.default_rng(2).random(len(every_part)) < 0.3
    some, wrong = every_part.of_rows(keep), explanation(camera_rotation=[0.1, 0.1, 0.1]).bench(bench)
    whole = every_part.residual(simulate(wrong, every_part.session.plan))
    np.testing.assert_allclose(some.residual(simulate(wrong, some.session.plan)), whole[keep], atol=1e-6)
    np.testing.assert_array_equal(some.group, every_part.group[keep])
    assert some.captures is every_part.captures


def test_a_spread_takes_alike_from_every_capture_row_and_column(clean: Observations) -> None:
    keep = clean.spread(600)
    assert 500 < keep.sum() <= 600
    for part, rows in ((DISPLAY, 56), (SEE_THROUGH, 49)):
        own = clean.part == part
        share = keep[own].mean()
        counts = np.bincount(clean.group[own & keep])[np.unique(clean.group[own])]
        assert np.all(np.abs(counts - share * rows) <= 2.5)
    column = np.arange(56 * 18) % 8
    counts = np.bincount(column[keep[clean.part == DISPLAY]])
    assert counts.min() > 0.8 * counts.max()
    assert clean.spread(len(clean)).all()


def test_readings_that_the_bench_cannot_predict_are_left_out(bench: Bench, plan: SessionPlan) -> None:
    few = select_rows(present(plan.see_through), np.arange(40))
    assert few is not None
    place = few.stage.copy()
    place[::4, 2] -= 2.0  # beyond the target
    read = Readings(dot_pixel=np.zeros((40, 2)))
    observed = Predictor.of_session(
        bench, Session("few", SessionPlan(see_through=replace(few, stage=place)), read)
    ).observations
    assert len(observed) == len(observed.group) == len(observed.part) == 30
    np.testing.assert_array_equal(
        present(observed.session.plan.see_through).stage, np.delete(place, np.s_[::4], axis=0)
    )


@pytest.mark.parametrize("part", ["display", "see_through"])
def test_a_bench_that_sees_nothing_is_an_error(bench: Bench, plan: SessionPlan, part: str) -> None:
    """A stage a metre off, so that the camera's lines of sight pass the combiner and the target."""
    alone = SessionPlan(**{part: getattr(plan, part)})
    session = Session("dark", alone, simulate(bench, alone))
    away = explanation(camera_pupil_offset=[-2000.0, 0.0, -2000.0]).bench(bench)
    with pytest.raises(BadInputError, match=r"dark: the bench as described sees none of its \d+ readings"):
        Predictor.of_session(away, session)

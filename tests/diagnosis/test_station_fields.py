"""An effect that no cause has is located at its station, whatever its shape; nothing is located where nothing acts.

The shapes are plane waves, humps and steps; the fields are polynomials.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any, TypeVar

import numpy as np
import pytest
from diagnosis.small_session import SIGMA_PX, explanation, fitted, measured, weighed, with_noise, with_readings
from numpy.typing import NDArray
from present import present

from wlr_render.bench.bench import Bench
from wlr_render.bench.bench_effects import BENCH_KINDS, RUN_TIME_KINDS, BenchEffect
from wlr_render.bench.simulate_session import simulate
from wlr_render.captures.session import DisplayPlan, Readings, SeeThroughPlan, Session, SessionPlan, StagePlan
from wlr_render.diagnosis.cause_selection import Search
from wlr_render.diagnosis.causes import CAUSES
from wlr_render.diagnosis.effect_findings import station_effects
from wlr_render.diagnosis.field_contest import FieldContest
from wlr_render.diagnosis.field_terms import LocatedEffect
from wlr_render.diagnosis.fit import Fit
from wlr_render.diagnosis.observations import Observations
from wlr_render.diagnosis.prediction import Explanation, Predictor
from wlr_render.diagnosis.station_fields import station_fields
from wlr_render.diagnosis.weighed_readings import WeighedReadings
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import Box

Part = TypeVar("Part", DisplayPlan, SeeThroughPlan)


def wave(variable: FloatArray, period: float) -> FloatArray:
    return np.sin(2 * np.pi * variable / period)


def beside(values: NDArray[Any]) -> NDArray[Any]:
    """The first of two components; the second is zero."""
    return np.stack([values, np.zeros_like(values)], axis=-1)


def bent_panel(bench: Bench, plan: SessionPlan) -> Readings:
    """Waves over the panel, as of a warped one."""
    read = simulate(bench, plan)
    off = 0.6 * wave(present(read.panel_pixel)[:, 0], 1000) * wave(present(read.panel_pixel)[:, 1], 900)
    return replace(read, panel_pixel=read.panel_pixel + beside(off))


def misread_stripes(bench: Bench, plan: SessionPlan) -> Readings:
    """A few of every 64 pixels are off, as where one stripe of a Gray code is misread."""
    read = simulate(bench, plan)
    off = np.where(np.mod(present(read.panel_pixel)[:, 0], 64) < 5, 3.0, 0.0)
    return replace(read, panel_pixel=read.panel_pixel + beside(off))


def fringes(bench: Bench, plan: SessionPlan) -> Readings:
    """Fringes of 37 pixels whose profile is no sine: decoded positions swing once and twice a fringe."""
    read = simulate(bench, plan)
    shown = present(read.panel_pixel)
    off = 0.8 * wave(shown + 11, 37) + 0.2 * wave(shown, 18.5)
    return replace(read, panel_pixel=shown + off)


def magnified_red(bench: Bench, plan: SessionPlan) -> Readings:
    read = simulate(bench, plan)
    off = 0.6 * (present(plan.display).channel == 0) * (present(read.panel_pixel)[:, 0] - 700) / 500
    return replace(read, panel_pixel=read.panel_pixel + beside(off))


def imaged_off(bench: Bench, plan: SessionPlan, off: Callable[[FloatArray, FloatArray], FloatArray]) -> Readings:
    """Points are imaged off by a function of camera pixels and time, in both parts."""
    shown, seen = present(plan.display), present(plan.see_through)
    ideal = shown.camera_pixel - off(shown.camera_pixel, shown.time_s)
    read = simulate(bench, replace(plan, display=replace(shown, camera_pixel=ideal)))
    dots = present(read.dot_pixel)
    return replace(read, dot_pixel=dots + off(dots, seen.time_s))


def lens(bench: Bench, plan: SessionPlan) -> Readings:
    """Waves over the camera's image, as of a lens that is not radial."""
    return imaged_off(bench, plan, lambda pixel, _: 0.4 * beside(wave(pixel[:, 0], 700) * wave(pixel[:, 1], 600)))


def breathing(bench: Bench, plan: SessionPlan) -> Readings:
    """The lens magnifies more and less by one part in a thousand, as its temperature swings with the room's."""

    def off(pixel: FloatArray, time_s: FloatArray) -> FloatArray:
        return 1e-3 * wave(time_s[:, None], 1300.0) * (pixel - [640.0, 512.0])

    return imaged_off(bench, plan, off)


def at_stage(bench: Bench, plan: SessionPlan, error: Callable[..., Any]) -> Readings:
    """The camera stands elsewhere than the stage says, in both parts."""
    shown, seen = present(plan.display), present(plan.see_through)
    moved = SessionPlan(replace(shown, stage=shown.stage + error(shown)), replace(seen, stage=seen.stage + error(seen)))
    return simulate(bench, moved)


def screw(bench: Bench, plan: SessionPlan) -> Readings:
    """A stage whose screw of 1.6 mm lead errs by 60 um once a turn, by 15 um twice a turn, and in its mean lead."""

    def error(table: StagePlan) -> FloatArray:
        x = table.stage[:, :1]
        turns = 6e-5 * wave(x + 2e-4, 1.6e-3) + 1.5e-5 * wave(x, 0.8e-3) + 2e-3 * (x - x.mean())
        return np.asarray(turns * [1.0, 0.0, 0.0])

    return at_stage(bench, plan, error)


def hump(bench: Bench, plan: SessionPlan) -> Readings:
    """A stage that is bent by 100 micrometres."""
    return at_stage(
        bench, plan, lambda table: 1e-4 * ((table.stage[:, :1] - bench.stage.origin[0]) / 4e-3) ** 2 * [0, 1, 0]
    )


def swing(bench: Bench, plan: SessionPlan) -> Readings:
    """The camera swings by 100 micrometres as the room warms and cools."""
    return at_stage(bench, plan, lambda table: 1e-4 * wave(table.time_s[:, None], 1300.0) * [0.0, 0.0, 1.0])


def warped_print(bench: Bench, plan: SessionPlan) -> Readings:
    seen = present(plan.see_through)
    off = 4e-4 * beside(wave(seen.dot[:, 0], 0.25) * wave(seen.dot[:, 1] + 0.03, 0.3))
    return simulate(bench, replace(plan, see_through=replace(seen, dot=seen.dot + off)))


def dent(bench: Bench, plan: SessionPlan) -> Readings:
    """A bump of the combiner 6 mm wide, of which the causes considered know nothing."""
    return simulate(explanation(combiner_dent=[6.0, 3.0, -2.0, 6.0]).bench(bench), plan)


EFFECTS = [
    (bent_panel, "panel", "panel pixels"),
    (misread_stripes, "panel", "panel pixels"),
    (fringes, "panel", "panel pixels"),
    (magnified_red, "panel", "panel pixels and colour"),
    (lens, "camera", "camera pixels"),
    (breathing, "camera", "camera pixels and time"),
    (screw, "stage", "stage readings"),
    (hump, "stage", "stage readings"),
    (swing, "time", "time"),
    (warped_print, "target", "place on the target"),
    (dent, "combiner", "place on the combiner"),
]


def of_fields(readings: WeighedReadings, found: Fit | None) -> FieldContest:
    return Search(readings, readings, (), fields=station_fields(readings)).contest(present(found))


def noisy(bench: Bench, plan: SessionPlan, read: Readings) -> Observations:
    observations = Predictor.of_session(bench, Session("small", plan, read)).observations
    return with_noise(observations, SIGMA_PX, np.random.default_rng(3))


def contest(bench: Bench, plan: SessionPlan, read: Readings, causes: Explanation | None = None) -> FieldContest:
    observations = noisy(bench, plan, read)
    readings = weighed(observations)
    return of_fields(readings, fitted(observations, causes or Explanation()))


@pytest.fixture(scope="module")
def contest_of(bench: Bench, plan: SessionPlan) -> Callable[..., FieldContest]:
    """(effect) -> the contest of a session with it, made once."""
    return cache(lambda effect: contest(bench, plan, effect(bench, plan)))


@pytest.mark.slow
@pytest.mark.parametrize(("effect", "station", "coordinates"), EFFECTS, ids=[each[0].__name__ for each in EFFECTS])
def test_an_effect_is_located_at_its_station(
    contest_of: Callable[..., FieldContest], effect: Callable[..., Any], station: str, coordinates: str
) -> None:
    first = contest_of(effect).located(2.0)[0]
    assert (first.field.station, first.field.coordinates) == (station, coordinates)
    assert first.log10_odds > 4


@pytest.mark.slow
def test_other_readings_get_the_periods_that_were_found(bench: Bench, plan: SessionPlan) -> None:
    readings = weighed(noisy(bench, plan, screw(bench, plan)))
    some = readings.of_rows(np.arange(len(readings.observations)) % 7 == 0)
    periods = [
        [field.period for field in fields if field.period > 0.0]
        for of in (readings, some)
        for fields in (station_fields(of), station_fields(of, station_fields(some)))
    ]
    assert periods[0] != periods[1] == periods[2] == periods[3]


@pytest.mark.slow
def test_the_period_of_a_screw_is_found_between_those_that_are_tried_first(bench: Bench, plan: SessionPlan) -> None:
    """At places off the raster, where the nearest of these is 1.625 mm."""

    def off_raster(table: Part | None) -> Part:
        assert table is not None
        rng, number = np.random.default_rng(8), np.unique(table.time_s, return_inverse=True)[1]
        x = 4e-3 * rng.uniform(-1.0, 1.0, number.max() + 1)
        return replace(
            table, stage=table.stage + np.outer(x[number] + bench.stage.origin[0] - table.stage[:, 0], [1, 0, 0])
        )

    places = SessionPlan(off_raster(plan.display), off_raster(plan.see_through))
    read = at_stage(bench, places, lambda table: 6e-5 * wave(table.stage[:, :1] + 2e-4, 1.6e-3) * [1.0, 0.0, 0.0])
    readings = weighed(noisy(bench, places, read))
    (along_x,) = (each for each in station_fields(readings) if each.form.startswith("shift along x"))
    assert along_x.period == pytest.approx(1.6, rel=3e-3)


@pytest.mark.slow
def test_the_period_of_fringes_is_found_and_a_bench_has_their_wave(
    bench: Bench, plan: SessionPlan, contest_of: Callable[..., FieldContest]
) -> None:
    won = contest_of(fringes)
    effects = won.located(2.0)
    assert [each.field.period for each in effects[:2]] == pytest.approx([37.0, 37.0], rel=2e-3)
    stated = [
        effect.in_bench(*each)
        for effect, each in zip(effects, won.values_and_covariances(effects, won.found.scatter), strict=True)
    ]
    changed = simulate(replace(bench, effects=tuple(sum(stated, ()))), plan).panel_pixel
    truth = fringes(bench, plan).panel_pixel
    assert np.std(present(changed) - present(truth)) < 0.35 * np.std(
        present(truth) - present(simulate(bench, plan).panel_pixel)
    )


@pytest.mark.slow
def test_a_bump_of_any_degree_has_an_error(bench: Bench, plan: SessionPlan) -> None:
    observations = noisy(bench, plan, dent(bench, plan))
    readings = weighed(observations)
    fields = station_fields(readings, spot=Box(np.array([-3.0, -8.0]), np.array([9.0, 4.0])))
    contest = Search(readings, readings, (), fields=fields).contest(present(fitted(observations, Explanation())))
    (field, *_) = (each for each in fields if each.is_in_spot)
    for degree in field.degrees:
        effect = LocatedEffect(field, degree, 1.0, 10.0)
        (record,) = station_effects(contest, [effect], contest.scatter_beside([effect]), None, readings.predictor)
        assert 0.0 < record.size_sigma < np.inf
        assert record.unit == "um"


@pytest.mark.slow
def test_nothing_is_located_where_nothing_acts(bench: Bench, plan: SessionPlan) -> None:
    quiet = contest(bench, plan, simulate(bench, plan))
    assert quiet.located(2.0) == []
    assert max(each.log10_odds for each in quiet.ranked) < 1.0


@pytest.mark.slow
def test_a_displacement_is_returned_in_the_units_of_its_station(
    bench: Bench, plan: SessionPlan, contest_of: Callable[..., FieldContest]
) -> None:
    won = contest_of(bent_panel)
    (effect, *_) = won.located(2.0)
    ((values, _),) = won.values_and_covariances([effect], won.scatter_beside([effect]))
    found, read = effect.acting.displacement(values), simulate(bench, plan).panel_pixel
    true = 0.6 * wave(present(read)[:, 0], 1000) * wave(present(read)[:, 1], 900)
    assert np.std(found[: len(true), 0] - true) < 0.25 * np.std(true)
    assert np.std(found[: len(true), 1]) < 0.25 * np.std(true)


@pytest.mark.slow
def test_a_cause_keeps_its_name_where_its_effect_is_there_and_loses_it_where_another_shape_is(
    bench: Bench, plan: SessionPlan
) -> None:
    true = explanation(panel_scale=[0.3, 0.3])
    right = contest(bench, plan, simulate(true.bench(bench), plan), true)
    assert right.odds_of_cause(0, "panel", right.located(2.0))[0] > 4
    # A panel that is bent looks a little as if it were larger.
    wrong = contest(bench, plan, bent_panel(bench, plan), true)
    assert wrong.odds_of_cause(0, "panel", wrong.located(2.0))[0] < 2


@pytest.mark.slow
def test_two_causes_that_one_field_does_as_well_have_no_name(bench: Bench, run_time: SessionPlan) -> None:
    """Rows of the camera are late one after the other: a scan-out and a latency together are much alike."""
    rolled = BenchEffect.of_function("camera", "delay", lambda pixel: 6e-3 * pixel[:, 1:], (0.0, 0.0), (1280.0, 1024.0))
    alike, both = explanation(rolling_scanout=[5.0], latency=[1.0]), []
    for true in (alike.bench(bench), replace(bench, effects=(rolled,))):
        observations = Predictor.of_session(bench, Session("small", run_time, simulate(true, run_time))).observations
        readings = weighed(with_noise(observations, SIGMA_PX, np.random.default_rng(3)))
        both.append(of_fields(readings, fitted(readings.observations, alike)).odds_of_all_causes([])[0])
    assert both[0] > both[1]
    assert both[1] < 2.0


@pytest.mark.slow
@pytest.mark.parametrize(("share", "is_named"), [(0.6, False), (1.5, False), (6.0, True)])
def test_the_mean_of_a_drift_is_a_cause_elsewhere_only_if_it_is_much_larger(
    bench: Bench, plan: SessionPlan, share: float, is_named: bool
) -> None:
    """A camera that swings in the course of the session, about a place beside the stated one."""

    def off(table: StagePlan) -> FloatArray:
        return 1e-4 * (share + wave(table.time_s[:, None], 1300.0)) * [0.0, 0.0, 1.0]

    won = contest(bench, plan, at_stage(bench, plan, off), explanation(camera_pupil_offset=[0.0, 0.0, 0.1 * share]))
    effects = won.located(2.0)
    assert effects[0].field.station == "time"
    assert (won.odds_of_cause(0, "camera", effects)[0] > 2) == is_named


@pytest.mark.slow
def test_a_cause_elsewhere_keeps_its_name_where_nothing_drifts(bench: Bench, plan: SessionPlan) -> None:
    still = at_stage(bench, plan, lambda table: [0.0, 0.0, 6e-5])
    alone = contest(bench, plan, still, explanation(camera_pupil_offset=[0.0, 0.0, 0.06]))
    assert alone.odds_of_cause(0, "camera", alone.located(2.0))[0] > 2


@pytest.mark.slow
def test_a_clock_that_runs_apart_is_an_effect_of_the_time(bench: Bench, run_time: SessionPlan) -> None:
    """The picture is later and later, by 3 ms at the end of the recording."""
    late = np.linspace(0.0, 1.0, len(present(run_time.run_time)))[:, None]
    first, last = (measured(bench, run_time, latency=[each]).session.readings.run_time_pixel for each in (0.0, 3.0))
    observations = measured(bench, run_time, SIGMA_PX, seed=2)
    noise = present(observations.session.readings.run_time_pixel) - present(first)
    pixel = (1.0 - late) * present(first) + late * present(last) + noise
    readings = weighed(with_readings(observations, run_time_pixel=pixel))
    (effect,) = of_fields(readings, fitted(readings.observations, Explanation())).located(2.0)
    assert (effect.field.station, effect.field.form, effect.field.unit) == ("time", "delay", "ms")
    assert effect.log10_odds > 4


@pytest.mark.slow
@pytest.mark.parametrize(
    ("off", "station", "coordinates"),
    [
        (lambda plan, pixel: 0.5 * beside(plan.world_from_device[:, 1, 2]), "head motion", "direction of gravity"),
        (lambda plan, pixel: 0.4 * beside(wave(plan.viewpoint[:, 0], 5e-3)), "eye tracking", "tracked pupil"),
        (lambda plan, pixel: 0.4 * beside(wave(plan.time_s, 9.0)), "time", "time"),
    ],
)
def test_an_effect_at_run_time_is_located(
    bench: Bench, run_time: SessionPlan, off: Callable[..., Any], station: str, coordinates: str
) -> None:
    observations = measured(bench, run_time, SIGMA_PX, seed=2)
    pixel = present(observations.session.readings.run_time_pixel).copy()
    pixel[:, :2] += off(observations.session.plan.run_time, pixel)
    observations = with_readings(observations, run_time_pixel=pixel)
    readings = weighed(observations)
    first = of_fields(readings, fitted(observations, Explanation())).ranked[0]
    assert (first.field.station, first.field.coordinates) == (station, coordinates)
    assert first.log10_odds > 4


def test_the_error_of_a_size_is_that_by_the_covariance_of_the_coefficients(bench: Bench, plan: SessionPlan) -> None:
    fields = station_fields(weighed(measured(bench, plan)))
    rng = np.random.default_rng(5)
    for station, per_axis in (("camera", 2), ("stage", 6), ("combiner", 1)):
        field = next(each for each in fields if each.station == station)
        effect = LocatedEffect(field, 1, 1.0, 10.0)
        values = 1.0 + rng.uniform(size=effect.acting.order.size)
        root = 0.02 * rng.normal(size=(len(values), len(values)))
        drawn = [
            effect.acting.displacement(values + root @ each)[field.acts] for each in rng.normal(size=(400, len(values)))
        ]
        size, sigma, unit = effect.size_of(values, root @ root.T)
        part = slice(3, None) if unit == "urad" else slice(3)
        sizes = [np.sqrt(np.mean(np.sum(each[:, part] ** 2, axis=1))) for each in drawn]
        assert drawn[0].shape[1] == per_axis
        # Heights are about their mean: a constant one moves no reading.
        assert (abs(drawn[0].mean()) < 1e-9 * size) == (station == "combiner")
        assert size == pytest.approx(np.mean(sizes), rel=0.02)
        assert sigma == pytest.approx(np.std(sizes), rel=0.15)


def test_the_size_of_a_pose_is_its_shift_or_its_turn_whichever_is_clearer(bench: Bench, plan: SessionPlan) -> None:
    fields = station_fields(weighed(measured(bench, plan)))
    effect = LocatedEffect(next(each for each in fields if each.station == "stage"), 1, 1.0, 10.0)
    for axes, unit in (([0, 1, 2], "um"), ([3, 4, 5], "urad")):
        moved = np.isin(np.arange(effect.acting.order.size) % 6, axes)
        size, sigma, said = effect.size_of(np.where(moved, 3.0, 0.001), 0.01 * np.eye(moved.size))
        assert (said, size > 10.0 * sigma) == (unit, True)


def test_every_cause_has_a_station_that_a_session_shows(bench: Bench, plan: SessionPlan, run_time: SessionPlan) -> None:
    shown = {field.station for field in station_fields(weighed(measured(bench, plan)))}
    shown |= {field.station for field in station_fields(weighed(measured(bench, run_time)))}
    assert {cause.station for cause in CAUSES.values()} <= shown


@pytest.mark.parametrize("session", ["bench", "run time"])
def test_a_bench_with_an_effect_reads_what_the_field_says(
    bench: Bench, plan: SessionPlan, run_time: SessionPlan, session: str
) -> None:
    """Every field that a file can state, with small random coefficients: to first order the bench does the same."""
    readings = weighed(measured(bench, plan if session == "bench" else run_time, SIGMA_PX, seed=2))
    predictor, rng, stated = readings.predictor, np.random.default_rng(3), set()
    for field in station_fields(readings, spot=Box(np.array([-4.0, -3.0]), np.array([2.0, 3.0]))):
        if field.in_bench is None:
            continue
        low = field.order <= 2
        # Few readings look through a spot: they move by more than the mean.
        size = 0.1 if field.is_in_spot else 0.5
        values = size * low * rng.normal(size=low.size) / np.sqrt(low.sum())
        effects = field.in_bench(values)
        stated |= {(each.station, each.displaces) for each in effects}
        read = predictor.residual(Explanation()) - predictor.residual_of_bench(replace(bench, effects=effects))
        expected = field.columns @ values
        assert np.sqrt(np.nanmean((read - expected) ** 2)) < 0.05 * np.sqrt(np.mean(expected**2)), field.kind
    missing = set(BENCH_KINDS if session == "bench" else RUN_TIME_KINDS) - stated
    assert missing == ({("combiner", "view")} if session == "bench" else set())


@pytest.mark.slow
def test_a_far_smaller_effect_may_be_the_rest_of_a_large_one(bench: Bench, plan: SessionPlan) -> None:
    """Large waves over the panel, and a camera that swings a little."""

    def off(table: StagePlan) -> FloatArray:
        return 6e-5 * wave(table.time_s[:, None], 1300.0) * [0.0, 0.0, 1.0]

    read = at_stage(bench, plan, off)
    pixel = read.panel_pixel
    won = contest(
        bench, plan, replace(read, panel_pixel=pixel + beside(6.0 * wave(present(pixel)[:, 0] + 100.0, 2400.0)))
    )
    effects = won.located(2.0)
    assert [each.field.station for each in effects] == ["panel"]
    rests = won.located(2.0, before=effects)
    assert all(each.is_rest for each in rests)
    assert "time" in {each.field.station for each in rests}
    left = [np.mean(won.left(each, won.scatter_beside(each)) ** 2) for each in (effects, [*effects, *rests])]
    assert left[1] < left[0]


@pytest.mark.slow
def test_effects_are_fitted_as_the_bench_does_them_where_it_is_not_linear(bench: Bench, run_time: SessionPlan) -> None:
    """The pupil is far from where it is tracked."""

    def off(gaze: FloatArray) -> FloatArray:
        return np.stack([3.0 * wave(gaze[:, 0], 1.1), -2.0 * gaze[:, 1], np.zeros(len(gaze))], axis=1)

    true = BenchEffect.of_function("eye tracking", "pupil by gaze", off, (-1.0, -1.0), (1.0, 1.0))
    read = simulate(replace(bench, effects=(true,)), run_time)
    observations = Predictor.of_session(bench, Session("small", run_time, read)).observations
    readings = weighed(with_noise(observations, SIGMA_PX, np.random.default_rng(3)))
    linear = of_fields(readings, fitted(readings.observations, Explanation()))
    effects, exact = linear.located(2.0, 1), []
    assert effects[0].field.form == "place of the pupil"
    for each in (linear, linear.with_effects(effects)):
        scatter = each.scatter_beside(effects)
        stated = effects[0].in_bench(*each.values_and_covariances(effects, scatter)[0])
        exact.append(readings.predictor.residual_of_bench(replace(bench, effects=stated)))
        off_by = np.sqrt(np.mean((each.left(effects, scatter) - exact[-1]) ** 2))
        assert (off_by > 0.2) == (each is linear)
    assert np.mean(exact[1] ** 2) < 0.98 * np.mean(exact[0] ** 2)

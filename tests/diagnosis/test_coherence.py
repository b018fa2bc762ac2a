"""What different captures have in common at one place is found where it sits; noise has nothing in common."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnosis.small_session import SIGMA_PX, measured, with_readings
from present import narrowed, present

from wlr_render.bench.bench import Bench
from wlr_render.bench.bench_file import load_bench, save_bench
from wlr_render.captures.session import SessionPlan, select_rows
from wlr_render.diagnosis.coherence import ROUNDS, FineEffect, fine_effect
from wlr_render.diagnosis.combiner_fields import footprints
from wlr_render.diagnosis.fine_in_bench import fine_in_bench, size_of, with_fine
from wlr_render.diagnosis.observations import DISPLAY, SEE_THROUGH, Observations
from wlr_render.diagnosis.prediction import Explanation, Predictor
from wlr_render.numerics.cells import Cells

PLACE_MM = np.array([2.0, -1.5])


def of(observations: Observations, rounds: tuple[int, ...] = (1,)) -> FineEffect | None:
    predictor = Predictor(observations)
    return fine_effect(predictor, predictor.residual(Explanation()), 2.0, rounds)


def spotted(observations: Observations, radius_mm: float = 2.0, size_px: float = 1.0) -> Observations:
    """Display readings that are off, all the same way, inside a circle with a hard edge on the combiner."""
    inside = np.linalg.norm(footprints(Predictor(observations)) - PLACE_MM, axis=1) < radius_mm
    rows = observations.part == DISPLAY
    off = np.where(inside[rows, None], [size_px, -0.5 * size_px], 0.0)
    shown = (observations.panel_from_camera @ off[:, :, None])[:, :, 0]
    return with_readings(observations, panel_pixel=present(observations.session.readings.panel_pixel) + shown)


def denser(plan: SessionPlan, times: int = 4) -> SessionPlan:
    """The display read at so many times as many pixels, between those of the plan."""
    shown = present(plan.display)
    table = select_rows(shown, np.repeat(np.arange(len(shown)), times))
    apart = 40.0 * np.random.default_rng(1).uniform(-1, 1, (len(table), 2))
    return SessionPlan(replace(table, camera_pixel=table.camera_pixel + apart), plan.see_through)


def test_a_spot_on_the_combiner_is_found_at_its_place(bench: Bench, plan: SessionPlan) -> None:
    found = of(spotted(measured(bench, denser(plan), SIGMA_PX, seed=12)))
    assert found is not None
    assert (found.station, found.part) == ("combiner", "display")
    assert found.log10_odds > 5
    np.testing.assert_allclose(found.place, PLACE_MM, atol=0.75)
    assert found.width < 2.0
    assert found.improvement.percent > 0
    assert len(found.cells) == len(found.means)


def test_the_size_of_a_spot_is_what_it_displaces_within_its_error(bench: Bench, plan: SessionPlan) -> None:
    observations = spotted(measured(bench, denser(plan, 12), SIGMA_PX, seed=12), radius_mm=3.0)
    size, sigma = size_of(present(of(observations, ROUNDS)), Predictor(observations))
    true = 1e6 * np.hypot(1.0, 0.5) / bench.camera.focal_px[0]
    assert sigma < 0.2 * true
    assert abs(size - true) < 3.0 * sigma


@pytest.mark.slow
def test_a_bench_with_the_cells_of_a_spot_has_no_spot(bench: Bench, plan: SessionPlan, tmp_path: Path) -> None:
    observations = spotted(measured(bench, denser(plan, 6), SIGMA_PX, seed=12), radius_mm=3.0)
    predictor, found = Predictor(observations), of(observations, ROUNDS)
    assert present(found).predicts
    corrected = with_fine(bench, found, predictor, 2.0)
    kinds = {(each.station, each.displaces, each.part) for each in corrected.effects}
    assert kinds == {("combiner", "view", "display")}
    left = Predictor(replace(observations, nominal=load_bench(save_bench(corrected, tmp_path / "bench.toml"))))
    before, after = (each.residual(Explanation())[observations.part == DISPLAY] for each in (predictor, left))
    assert np.mean(before**2) > 1.1
    assert np.mean(after**2) - 1.0 < 0.4 * (np.mean(before**2) - 1.0)
    again = fine_effect(left, left.residual(Explanation()), 2.0, ROUNDS)
    assert again is None or not again.predicts


@pytest.mark.parametrize("station", ["panel", "camera", "target", "combiner"])
def test_cells_of_any_station_change_the_readings_as_they_were_changed(
    bench: Bench, plan: SessionPlan, station: str
) -> None:
    """The change of every reading is 1 sigma along u, whatever the station: the bench's effect must do the same."""
    predictor = Predictor(measured(bench, plan, SIGMA_PX, seed=3))
    observations, fine = predictor.observations, of(spotted(measured(bench, denser(plan), SIGMA_PX, seed=12)))
    rows = np.flatnonzero(observations.part == DISPLAY)
    if station == "target":  # at one distance
        rows = np.flatnonzero(observations.part == SEE_THROUGH)[
            present(observations.session.plan.see_through).target_pose == 0
        ]
    change = np.tile([1.0, 0.0], (len(rows), 1))
    assert fine is not None
    fine = replace(fine, station=station, rows=rows, at=np.zeros((len(rows), 2)), cell=1e6, change=change)
    (effect,) = fine_in_bench(fine, predictor)
    cells = narrowed(effect.function, Cells)
    everywhere = [replace(effect, function=replace(cells, middles=place)) for place in QUADRANTS]
    read = predictor.residual_of_bench(replace(bench, effects=tuple(everywhere))) - predictor.residual(Explanation())
    np.testing.assert_allclose(np.nanmean(read[rows], axis=0), [-1.0, 0.0], atol=0.05)


QUADRANTS = [1e4 * np.array([[x, y]]) for x in (-1, 1) for y in (-1, 1)]


@pytest.mark.parametrize("seed", [13, 14, 15])
def test_noise_with_long_tails_has_nothing_in_common(bench: Bench, plan: SessionPlan, seed: int) -> None:
    clean, rng = measured(bench, plan), np.random.default_rng(seed)
    read = clean.session.readings
    assert read.panel_pixel is not None
    kick = SIGMA_PX * rng.standard_t(4.0, size=read.panel_pixel.shape)
    assert read.dot_pixel is not None
    noisy = with_readings(
        clean,
        panel_pixel=read.panel_pixel + (clean.panel_from_camera @ kick[:, :, None])[:, :, 0],
        dot_pixel=read.dot_pixel + SIGMA_PX * rng.standard_t(4.0, size=read.dot_pixel.shape),
    )
    assert of(noisy) is None


def test_one_wild_reading_is_no_spot(bench: Bench, plan: SessionPlan) -> None:
    observations = measured(bench, plan, SIGMA_PX, seed=16)
    pixel = present(observations.session.readings.panel_pixel).copy()
    pixel[100] += 60.0
    assert of(with_readings(observations, panel_pixel=pixel)) is None

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.workshop import SWITCHES, Workshop, travel_of

WORKSHOP = Workshop(3)
SEEDS = range(20)
PICTURE = np.stack(np.meshgrid(np.linspace(-0.8, 0.8, 23), np.linspace(-0.6, 0.6, 19)), axis=-1).reshape(-1, 2)
LINE_M = np.linspace(-0.01, 0.01, 4001)


def along_x(line: FloatArray) -> NDArray[Any]:
    return np.column_stack([line, np.zeros((len(line), 2))])


def parts(workshop: Workshop) -> dict[Any, Any]:
    """Return all errors of a workshop."""
    reading, sides = along_x(LINE_M[::100]), np.ones((41, 3))
    sheet = 0.5 * PICTURE
    return {
        "travel": workshop.stage_motion(reading, sides)[:, 3:] - workshop.stage_motion(reading, -sides)[:, 3:],
        "shift": workshop.stage_motion(reading, 0 * sides)[:, 3:],
        "turn": workshop.stage_motion(reading, sides)[:, :3],
        "visits": workshop.visit_motion(30, 0),
        "print": workshop.printed_m(sheet),
        "height": workshop.height_m(PICTURE),
        "lens": workshop.lens_px(PICTURE),
        "pupil": workshop.pupil_m(PICTURE),
        "drift": workshop.drift_px(np.linspace(0, 1, 5), PICTURE),
    }


MOVED = {
    "screw": {"shift"},
    "hysteresis": {"travel"},
    "abbe": {"turn", "shift"},
    "repeatability": {"visits"},
    "print": {"print"},
    "bow": {"height"},
    "lens": {"lens"},
    "pupil": {"pupil"},
    "drift": {"drift"},
}


def moved(first: Mapping[Any, Any], second: Mapping[Any, Any]) -> set[Any]:
    return {part for part in first if np.abs(first[part] - second[part]).max() > 1e-12}


@pytest.mark.parametrize("name", SWITCHES)
def test_a_switch_moves_its_error_alone(name: str) -> None:
    perfect, alone, whole = (parts(each) for each in (WORKSHOP.only(), WORKSHOP.only(name), WORKSHOP))
    assert moved(perfect, alone) == MOVED[name]
    assert moved(whole, parts(WORKSHOP.without(name))) == MOVED[name]


def test_errors_depend_on_the_seed_and_grow_with_the_level() -> None:
    first, again, other = (parts(Workshop(seed)) for seed in (3, 3, 4))
    half = parts(Workshop(3, 0.5))
    for part, values in first.items():
        np.testing.assert_array_equal(values, again[part])
        assert np.any(values != other[part]) or part == "travel"  # one size
        np.testing.assert_allclose(half[part], 0.5 * values, atol=1e-15)


def rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def test_the_stage_errs_by_the_stated_sizes() -> None:
    for seed in SEEDS:
        bench = Workshop(seed)
        screw = 1e6 * bench.only("screw").stage_motion(along_x(LINE_M), np.ones((len(LINE_M), 3)))[:, 3]
        assert 4.9 <= np.abs(screw).max() <= 10.0
        spectrum = np.abs(np.fft.rfft(screw[:-1] * np.hanning(len(screw) - 1)))
        period_mm = 20.0 / np.argmax(spectrum)
        assert 0.9 <= period_mm <= 2.1
        turn = 1e6 * bench.only("abbe").stage_motion(along_x(LINE_M), np.ones((len(LINE_M), 3)))[:, :3]
        assert np.all((np.ptp(turn, axis=0) > 29.0) & (np.ptp(turn, axis=0) < 61.0))
        np.testing.assert_allclose(turn[len(turn) // 2], 0.0, atol=1e-9)
        cubic = np.polynomial.legendre.legfit(LINE_M / 0.01, turn, 3)
        left = turn - np.polynomial.legendre.legval(LINE_M / 0.01, cubic).T
        assert rms(left) > 0.05 * rms(turn)  # no cubic
    sides = [WORKSHOP.only("hysteresis").stage_motion(np.zeros((1, 3)), sign * np.ones((1, 3))) for sign in (1, -1)]
    np.testing.assert_allclose(1e6 * (sides[0] - sides[1])[0], [0, 0, 0, 5, 5, 5], atol=1e-9)


def test_visits_scatter_by_the_stated_sizes_and_wobble_slowly() -> None:
    motion = np.concatenate([Workshop(seed).visit_motion(500, 0) for seed in SEEDS])
    np.testing.assert_allclose(1e6 * rms(motion[:, 3:]), 5.0, rtol=0.1)
    np.testing.assert_allclose(1e6 * rms(motion[:, :3]), 15.0, rtol=0.1)
    following = [np.corrcoef(column[:-1], column[1:])[0, 1] for column in motion.T]
    np.testing.assert_allclose(following, [0.7] * 3 + [0.0] * 3, atol=0.05)
    shift = motion[:, 3:] / motion[:, 3:].std()
    assert np.mean(shift**4) > 4.0  # heavier tails than a Gaussian's 3


@pytest.mark.slow
def test_the_board_errs_by_the_stated_sizes() -> None:
    sheet = 0.6 * np.stack(np.meshgrid(*[np.linspace(-1, 1, 61)] * 2), axis=-1).reshape(-1, 2)
    for seed in range(6):
        printed = 1e3 * Workshop(seed).printed_m(sheet)
        assert 0.025 <= rms(printed[:, 0]) <= 0.095
        assert 0.035 <= rms(printed[:, 1]) <= 0.11  # and .03 mm of feed
        assert 0.09 <= 1e3 * np.ptp(Workshop(seed).height_m(sheet / 0.6)) <= 0.31
    # Dots move together within 8 mm, and independently at a distance of 0.3 m.
    many = np.concatenate(
        [Workshop(seed).printed_m(np.array([[0.1, 0], [0.108, 0], [0.4, 0]]))[:, 0] for seed in range(50)]
    )
    at = many.reshape(-1, 3).T
    assert np.corrcoef(at[0], at[1])[0, 1] > 0.95
    assert abs(np.corrcoef(at[0], at[2])[0, 1]) < 0.3


def test_lens_pupil_and_drift_have_the_stated_sizes() -> None:
    for seed in SEEDS:
        bench = Workshop(seed)
        assert 0.09 <= rms(bench.lens_px(PICTURE)) <= 0.21
        assert 0.05 <= 1e3 * bench.pupil_m(np.array([0.0, 1.0])) <= 0.2
        drift = bench.drift_px(np.linspace(0, 1, 1001), np.zeros((1, 2)))[:, 0]
        assert 0.3 <= np.linalg.norm(drift[-1] - drift[0]) <= 0.5
        np.testing.assert_allclose(drift.mean(axis=0), 0.0, atol=1e-3)


def test_an_unknown_switch_and_an_impossible_level_are_refused() -> None:
    with pytest.raises(BadInputError, match="unknown imperfection 'bwo'; choose from screw,"):
        WORKSHOP.without("bwo")
    with pytest.raises(BadInputError, match="'level' is -1; give 0 or more"):
        Workshop(1, -1)


def test_the_direction_of_travel_stays_while_an_axis_rests() -> None:
    reading = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 0]]) * 1e-3
    np.testing.assert_array_equal(travel_of(reading)[:, 0], [1, 1, 1, -1, -1])
    np.testing.assert_array_equal(travel_of(reading)[:, 1], [1, 1, 1, 1, -1])

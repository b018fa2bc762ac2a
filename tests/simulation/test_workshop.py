from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from wlr_render.captures.correspondences import DisplayCaptures, SeeThroughCaptures
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import arcmin_between
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.capture_setup import CaptureSetup
from wlr_render.simulation.simulate_captures import simulate_display, simulate_see_through
from wlr_render.simulation.workshop import OF_NOISE, SWITCHES, Workshop, travel_of
from wlr_render.simulation.workshop_captures import LabBoard, LabSweep

WORKSHOP = Workshop(3)
SEEDS = range(20)
PICTURE = np.stack(np.meshgrid(np.linspace(-0.8, 0.8, 23), np.linspace(-0.6, 0.6, 19)), axis=-1).reshape(-1, 2)
LINE_M = np.linspace(-0.01, 0.01, 4001)


def along_x(line: FloatArray) -> NDArray[Any]:
    return np.column_stack([line, np.zeros((len(line), 2))])


def parts(workshop: Workshop) -> dict[Any, Any]:
    """Return all errors of a workshop."""
    rng, reading, sides = np.random.default_rng(5), along_x(LINE_M[::100]), np.ones((41, 3))
    sheet = 0.5 * PICTURE
    return {
        "travel": workshop.stage_motion(reading, sides)[:, 3:] - workshop.stage_motion(reading, -sides)[:, 3:],
        "shift": workshop.stage_motion(reading, 0 * sides)[:, 3:],
        "turn": workshop.stage_motion(reading, sides)[:, :3],
        "visits": workshop.visit_motion(30, 0),
        "bumps": workshop.bumps(30),
        "print": workshop.printed_m(sheet),
        "height": workshop.height_m(PICTURE),
        "lens": workshop.lens_px(PICTURE),
        "pupil": workshop.pupil_m(PICTURE),
        "drift": workshop.drift_px(np.linspace(0, 1, 5), PICTURE),
        "noise": np.stack([workshop.noise(PICTURE, rng) for _ in range(3)]),
    }


MOVED = {
    "screw": {"shift"},
    "hysteresis": {"travel"},
    "abbe": {"turn", "shift"},
    "repeatability": {"visits"},
    "bumped": {"bumps"},
    "print": {"print"},
    "bow": {"height"},
    "lens": {"lens"},
    "pupil": {"pupil"},
    "drift": {"drift"},
    **{name: {"noise"} for name in OF_NOISE},
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
        assert np.any(values != other[part]) or part in ("travel", "noise")  # one size; of the caller's generator
        if part != "noise":
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


def test_bumped_visits_are_one_or_two_of_the_stated_size() -> None:
    for seed in SEEDS:
        size = 1e6 * np.linalg.norm(Workshop(seed, bump_um=(300.0, 300.0)).bumps(25), axis=1)
        np.testing.assert_allclose(size[size > 0], 300.0)
        assert 1 <= np.count_nonzero(size) <= 2


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


def noise_of(name: tuple[str, ...], count: int = 200) -> NDArray[Any]:
    rng = np.random.default_rng(1)
    return np.stack([WORKSHOP.only(*name).noise(PICTURE, rng) for _ in range(count)])


def test_noise_has_its_rms_and_each_shape() -> None:
    radius = np.linalg.norm(PICTURE, axis=1)
    white, tails, rim, shared, gross = (noise_of(name) for name in ((), *[(each,) for each in OF_NOISE]))
    for noise in (white, tails, rim, shared):
        np.testing.assert_allclose(rms(noise), 1.0, rtol=0.05)
    assert np.mean(tails**4) / np.mean(tails**2) ** 2 > 4.0
    assert rms(rim[:, radius > 0.9]) > 1.5 * rms(rim[:, radius < 0.3])
    grid = shared[..., 0].reshape(-1, 19, 23)
    near = [np.mean(grid[:, :, lag:] * grid[:, :, : 23 - lag]) for lag in (1, 3, 6)]
    assert near[0] > 0.3
    assert 0.01 < near[1] < 0.2
    assert abs(near[2]) < 0.03
    wild = np.linalg.norm(gross, axis=-1) > 5.0
    assert 0.005 < wild.mean() < 0.015
    assert radius[np.nonzero(wild)[1]].mean() > 0.75


def test_an_unknown_switch_and_an_impossible_level_are_refused() -> None:
    with pytest.raises(BadInputError, match="unknown imperfection 'bwo'; choose from screw,"):
        WORKSHOP.without("bwo")
    with pytest.raises(BadInputError, match="'level' is -1; give 0 or more"):
        Workshop(1, -1)


@pytest.fixture
def setup(flat_image_headset: Eye) -> CaptureSetup:
    return CaptureSetup(flat_image_headset, grid=(7, 6), target_depths_m=(0.6, 1.0), workshop=WORKSHOP)


def captured(setup: CaptureSetup, seed: int = 7) -> tuple[DisplayCaptures, SeeThroughCaptures]:
    at, rng = setup.camera_positions("planar", 4), np.random.default_rng(seed)
    return simulate_display(setup, at, rng), simulate_see_through(setup, at, rng)


def errors(setup: CaptureSetup, display: Any, see_through: Any) -> tuple[FloatArray, FloatArray]:
    """Return the angles between captured and exact directions of panel and points, arcminutes."""
    shown = setup.truth.display.view_dir_of_pixel(display.pixel, display.viewpoint).value
    seen = setup.truth.see_through.view_dir_of_real_point(see_through.point, see_through.viewpoint).value
    return arcmin_between(shown, display.view_dir), arcmin_between(seen, see_through.view_dir)


def test_captures_of_a_perfect_workshop_are_exact(setup: CaptureSetup) -> None:
    shown, seen = errors(setup, *captured(replace(setup, workshop=Workshop(3, 0.0))))
    assert max(shown.max(), seen.max()) < 1e-6


@pytest.mark.parametrize("name", [name for name in SWITCHES if name not in OF_NOISE])
def test_each_error_reaches_the_captures_that_it_concerns(setup: CaptureSetup, name: str) -> None:
    shown, seen = errors(setup, *captured(replace(setup, workshop=WORKSHOP.only(name))))
    assert (shown.max() > 1e-3) == (name not in ("print", "bow"))
    assert seen.max() > 1e-3


def test_captures_record_what_a_lab_records(setup: CaptureSetup) -> None:
    display, see_through = captured(replace(setup, camera_noise_arcmin=0.5))
    for part in (display, see_through):
        np.testing.assert_allclose(part.viewpoint, setup.truth.eye_box.centre + part.stage)
        assert part.has_visits
        assert np.isfinite(part.time_s).all()
        assert set(np.unique(part.travel)) <= {-1.0, 1.0}
        assert np.all(part.sigma_arcmin == 0.5)
        np.testing.assert_allclose(
            part.device_from_camera @ np.swapaxes(part.device_from_camera, 1, 2),
            np.eye(3)[None].repeat(len(part), 0),
            atol=1e-12,
        )
    first = see_through.target_pose == 0
    assert set(see_through.visit[first]) == set(display.visit)  # the panel is decoded in the first sweep
    assert see_through.time_s[~first].min() > see_through.time_s[first].max()
    board = LabBoard.of(setup)
    for pose in (0, 1):
        rows = see_through.target_pose == pose
        placed = see_through.target_point[rows] @ board.device_from_target[pose][:3, :3].T
        np.testing.assert_allclose(placed + board.device_from_target[pose][:3, 3], see_through.point[rows])
    both = [set(map(tuple, np.round(see_through.target_point[see_through.target_pose == k], 6))) for k in (0, 1)]
    assert both[1] & both[0]  # the same dots at both poses


def test_noise_has_the_stated_sigma(setup: CaptureSetup) -> None:
    noisy = replace(setup, grid=(25, 21), camera_noise_arcmin=0.5, workshop=Workshop(3, 0.0))
    for part in errors(noisy, *captured(noisy)):
        np.testing.assert_allclose(rms(part), 0.5 * np.sqrt(2.0), rtol=0.05)


def test_rays_and_views_of_points_are_inverse(setup: CaptureSetup) -> None:
    """A point on the true ray of a camera pixel is seen at this pixel, whatever the errors."""
    at = setup.camera_positions("planar", 4)
    sweep = LabSweep.driven(setup, WORKSHOP, at, 1, np.random.default_rng(1))
    view_dir = setup.camera_dirs()[10:11]
    origin, direction = sweep.rays_of_dirs(view_dir)
    world = setup.truth.see_through.real_ray_of_view_dir(direction, origin).value[0, 0]
    stated, _ = sweep.views_of_points((world[:3] + 0.8 * world[3:])[None])
    assert arcmin_between(stated[0, 0], view_dir[0]) < 1e-4


def test_the_direction_of_travel_stays_while_an_axis_rests() -> None:
    reading = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 0]]) * 1e-3
    np.testing.assert_array_equal(travel_of(reading)[:, 0], [1, 1, 1, -1, -1])
    np.testing.assert_array_equal(travel_of(reading)[:, 1], [1, 1, 1, 1, -1])

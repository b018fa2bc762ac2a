"""Effects at the stations of a bench: what they displace, that captures take them off again, and their file."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from present import narrowed, present

from wlr_render.bench.bench import Bench, EyeballCamera, Stage, Target
from wlr_render.bench.bench_effects import BENCH_KINDS, KINDS, AnyFunction, BenchEffect
from wlr_render.bench.bench_file import load_bench, save_bench
from wlr_render.bench.session_captures import captures_of, session_of
from wlr_render.bench.simulate_session import display_dirs, simulate
from wlr_render.captures.session import DisplayPlan, SeeThroughPlan, Session, SessionPlan
from wlr_render.diagnosis.prediction import Predictor
from wlr_render.errors import BadInputError
from wlr_render.geometry.transforms import rigid, rotations_of_vectors
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.cells import Cells
from wlr_render.numerics.polynomial import Box, Polynomial, total_degree
from wlr_render.numerics.waves import LocalWaves, Wave
from wlr_render.optics.combiner_form import places_on_combiner
from wlr_render.optics.device_file import load_device

BOXES = {
    "panel": ([0.0, 0.0], [1440.0, 1600.0]),
    "camera": ([0.0, 0.0], [1280.0, 1024.0]),
    "target": ([-3.0, -3.0], [3.0, 3.0]),
    "stage": ([20.0, -10.0, 20.0], [45.0, 10.0, 45.0]),
    "time": ([0.0], [2000.0]),
    "combiner": ([-20.0, -20.0], [20.0, 20.0]),
    "head motion": ([-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]),
    "shift by viewpoint": ([0.0, 0.0, 20.0, -10.0, 20.0], [1440.0, 1600.0, 45.0, 10.0, 45.0]),
    "pose by travel": ([-1.0, 20.0, -10.0, 20.0], [1.0, 45.0, 10.0, 45.0]),
    "picture by pupil": ([0.02, -0.01, 0.02], [0.04, 0.01, 0.04]),
    "shift by time": ([0.0, 0.0, 0.0], [1280.0, 1024.0, 2000.0]),
    "pupil by pupil": ([0.02, -0.01, 0.02], [0.04, 0.01, 0.04]),
    "pupil by gaze": ([-1.0, -1.0], [1.0, 1.0]),
}
SIZES = {"panel": 0.5, "camera": 0.3, "target": 0.2, "stage": 30.0, "time": 5.0, "combiner": 0.5, "view": 100.0}


def effect(station: str, displaces: str, degree: int = 2, seed: int = 1) -> BenchEffect:
    """A random effect of ordinary size."""
    kind, (low, high) = KINDS[station, displaces], BOXES.get(displaces) or BOXES[station]
    orders, size = total_degree(len(low), degree), SIZES.get(displaces) or SIZES.get(station, 1.0)
    coefficients = size * np.random.default_rng(seed).normal(size=(len(orders), len(kind.per_displacement)))
    return BenchEffect(station, displaces, Polynomial(orders, Box(np.array(low), np.array(high)), coefficients))


@pytest.fixture(scope="module")
def bench() -> Bench:
    device = load_device("northstar")
    middle = device.eyes["right"].eye_box.centre
    camera = EyeballCamera(np.array([1280.0, 1024.0]), np.array([900.0, 900.0]), np.array([640.0, 300.0]), 0.1)
    poses = rigid(rotations_of_vectors(np.array([[0.1, -0.2, 0.05]])), middle + np.array([[0.0, -0.08, -0.6]]))
    return Bench(device, "right", camera, Stage(middle), Target(poses, np.array([0.03])))


@pytest.fixture(scope="module")
def plan(bench: Bench) -> SessionPlan:
    """Three captures of the panel and of the target."""
    place = bench.stage.origin + 1e-3 * np.array([[-2.0, 1.0, 0.0], [2.0, -1.0, 1.0], [0.0, 2.0, -1.0]])
    u, v = np.meshgrid(np.linspace(400, 900, 5), np.linspace(250, 800, 4))
    grid = np.stack([u, v], axis=-1).reshape(-1, 2)
    capture = np.repeat(np.arange(3), len(grid))
    ones = np.ones(len(capture))
    display = DisplayPlan(
        capture, np.asarray(100.0 * capture), ones, place[capture], np.ones(len(capture), int), np.tile(grid, (3, 1))
    )
    x, y = np.meshgrid(np.arange(-2, 3), np.arange(-2, 3))
    dots = 0.03 * np.tile(np.stack([x, y], axis=-1).reshape(-1, 2), (3, 1))
    capture = np.repeat(np.arange(3), 25)
    poses = np.zeros(len(capture), dtype=int)
    see_through = SeeThroughPlan(
        capture, np.asarray(1000.0 + 100.0 * capture), np.ones(len(capture)), place[capture], poses, np.asarray(dots)
    )
    return SessionPlan(display, see_through)


@pytest.mark.parametrize(("station", "displaces"), BENCH_KINDS)
def test_captures_of_a_bench_with_an_effect_are_those_of_a_bench_without(
    bench: Bench, plan: SessionPlan, station: str, displaces: str
) -> None:
    """The effects of all stations but the combiner are the bench's: what is handed to calibration has none of them."""
    disturbed = replace(bench, effects=(effect(station, displaces),))
    read = simulate(disturbed, plan)
    changed = [
        np.nanmax(np.abs(present(a) - present(b)))
        for a, b in zip(read.parts[:2], simulate(bench, plan).parts[:2], strict=True)
    ]
    assert max(changed) > 0.01
    if station == "combiner":
        return
    table = captures_of(disturbed, Session("s", plan, read))
    back = session_of(disturbed, table, "s")
    again = simulate(disturbed, back.plan)
    for measured, simulated in zip(back.readings.parts[:2], again.parts[:2], strict=True):
        assert simulated is not None
        assert measured is not None
        np.testing.assert_allclose(simulated, measured, atol=2e-4)
    # The headset's own optics, without any effect, lead from these viewpoints and directions to these readings.
    exact = session_of(bench, table, "s")
    for measured, simulated in zip(exact.readings.parts[:2], simulate(bench, exact.plan).parts[:2], strict=True):
        np.testing.assert_allclose(present(simulated), present(measured), atol=2e-4)


def test_a_shift_of_the_panel_is_read_in_pixels(bench: Bench, plan: SessionPlan) -> None:
    constant = Polynomial(np.array([[0, 0]]), Box(np.zeros(2), np.full(2, 1000.0)), np.array([[0.7, -0.2]]))
    disturbed = replace(bench, effects=(BenchEffect("panel", "shift", constant),))
    off = present(simulate(disturbed, plan).panel_pixel) - present(simulate(bench, plan).panel_pixel)
    np.testing.assert_allclose(
        off[np.isfinite(off).all(axis=1)], [[0.7, -0.2]] * int(np.isfinite(off).all(axis=1).sum())
    )


def test_a_shift_of_the_whole_image_is_not_seen_where_the_bare_photograph_has_it_too(
    bench: Bench, plan: SessionPlan
) -> None:
    constant = Polynomial(np.array([[0, 0]]), Box(np.zeros(2), np.full(2, 1000.0)), np.array([[0.7, -0.2]]))
    disturbed = replace(bench, effects=(BenchEffect("camera", "shift", constant),))
    bare = replace(present(plan.see_through), bare_pixel=simulate(bench, plan).dot_pixel)
    for rows, least, most in ((plan.see_through, 0.6, 0.8), (bare, 0.0, 0.05)):
        one = SessionPlan(see_through=rows)
        off = present(simulate(disturbed, one).dot_pixel) - present(simulate(bench, one).dot_pixel)
        assert least <= np.nanmax(np.abs(off)) < most


def test_a_tilt_of_the_combiners_height_turns_the_reflection_by_twice_as_much(bench: Bench, plan: SessionPlan) -> None:
    """A height of 1 um per mm turns the surface by 1 mrad; on the display a constant height does much less."""
    box = Box(np.full(2, -20.0), np.full(2, 20.0))
    sizes = []
    for order in ([0, 0], [1, 0]):
        tilted = BenchEffect("combiner", "all surfaces", Polynomial(np.array([order]), box, np.array([[20.0]])))
        off = present(simulate(replace(bench, effects=(tilted,)), plan).panel_pixel) - present(
            simulate(bench, plan).panel_pixel
        )
        sizes.append(np.sqrt(np.nanmean(off**2)))
    assert sizes[1] > 5 * sizes[0]


def test_an_effect_of_one_target_pose_leaves_the_others_alone(bench: Bench, plan: SessionPlan) -> None:
    one = replace(effect("target", "shift"), target_pose=1)
    same = simulate(replace(bench, effects=(one,)), plan).dot_pixel
    np.testing.assert_array_equal(same, simulate(bench, plan).dot_pixel)


@pytest.mark.parametrize("kind", [("panel", "shift"), ("panel", "shift by viewpoint"), ("time", "shift")])
def test_an_effect_of_one_colour_leaves_the_others_alone(
    bench: Bench, plan: SessionPlan, kind: tuple[str, str]
) -> None:
    assert plan.display is not None
    colours = SessionPlan(replace(plan.display, channel=plan.display.capture % 3))
    of_red = replace(bench, effects=(replace(effect(*kind), channel=0),))
    off = np.abs(present(simulate(of_red, colours).panel_pixel) - present(simulate(bench, colours).panel_pixel)).max(
        axis=1
    )
    red, seen = present(colours.display).channel == 0, np.isfinite(off)
    assert np.all(off[seen & red] > 0.0)
    assert np.all(off[seen & ~red] == 0.0)


def test_a_pose_by_travel_changes_sign_with_the_direction(bench: Bench, plan: SessionPlan) -> None:
    orders, box = np.array([[1, 0, 0, 0]]), Box(*map(np.array, BOXES["pose by travel"]))
    backlash = BenchEffect("stage", "pose by travel", Polynomial(orders, box, 20.0 * np.eye(6)[:1]))
    read = []
    for travel in (1.0, -1.0):
        assert plan.display is not None
        moved = SessionPlan(replace(plan.display, travel=np.full(len(plan.display), travel)))
        read.append(simulate(replace(bench, effects=(backlash,)), moved).panel_pixel)
        stage = replace(bench, stage=replace(bench.stage, backlash=np.array([2e-5, -2e-5])))
        np.testing.assert_allclose(present(read[-1]), present(simulate(stage, moved).panel_pixel), atol=1e-9)
    assert np.nanmax(np.abs(present(read[0]) - present(read[1]))) > 0.01


def test_a_view_moves_what_each_part_sees_through_the_combiner_the_same_way(bench: Bench, plan: SessionPlan) -> None:
    """On the display the panel is read at given pixels of the camera: what is read comes from the other side."""
    still = Polynomial(np.array([[0, 0]]), Box(np.full(2, -20.0), np.full(2, 20.0)), np.array([[1000.0, 0.0]]))
    for part, (display, dots) in {"display": (True, False), "see-through": (False, True), "": (True, True)}.items():
        moved = replace(bench, effects=(BenchEffect("combiner", "view", still, part=part),))
        off = [
            present(a) - present(b)
            for a, b in zip(simulate(moved, plan).parts[:2], simulate(bench, plan).parts[:2], strict=True)
        ]
        assert [bool(np.nanmax(np.abs(each)) > 0.0) for each in off] == [display, dots]
    np.testing.assert_allclose(np.nanmean(off[1], axis=0), [0.9, 0.0], atol=0.02)  # 1 mrad by 900 px
    assert plan.display is not None
    shifted = replace(plan.display, camera_pixel=plan.display.camera_pixel - [0.9, 0.0])
    expected = present(simulate(bench, SessionPlan(shifted)).panel_pixel) - present(simulate(bench, plan).panel_pixel)
    np.testing.assert_allclose(np.nanmean(off[0], axis=0), np.nanmean(expected, axis=0), rtol=0.02)


def test_cells_hold_where_they_are_and_nowhere_else(bench: Bench, plan: SessionPlan) -> None:
    assert plan.display is not None
    time_s = np.unique(plan.display.time_s)
    cells = Cells(50.0, np.array([[125.0]]), np.array([[0.7, -0.2]]))
    moved = replace(bench, effects=(BenchEffect("time", "shift", cells),))
    off = present(simulate(moved, plan).panel_pixel) - present(simulate(bench, plan).panel_pixel)
    inside = plan.display.time_s == time_s[1]
    assert 100.0 <= time_s[1] < 150.0
    np.testing.assert_allclose(off[inside & np.isfinite(off[:, 0])][0], [0.7, -0.2])
    assert np.nanmax(np.abs(off[~inside])) == 0.0


def test_a_view_by_places_on_a_later_surface_moves_what_meets_it_there(
    bench: Bench, plan: SessionPlan, tmp_path: Path
) -> None:
    device = load_device("birdbath28")
    middle = device.eyes["right"].eye_box.centre
    folded = replace(bench, device=device, stage=Stage(middle), target=Target(np.zeros((0, 4, 4)), np.zeros(0)))
    assert plan.display is not None
    stage = plan.display.stage - bench.stage.origin + middle
    one = SessionPlan(replace(plan.display, stage=stage))
    places = 1e3 * places_on_combiner(folded.optics, stage, display_dirs(folded, present(one.display)), 2)
    seen = np.isfinite(present(simulate(folded, one).panel_pixel)[:, 0])
    cell = np.floor(places[np.flatnonzero(seen)[3]])
    view = BenchEffect(
        "combiner", "view", Cells(1.0, cell[None] + 0.5, np.array([[500.0, 0.0]])), part="display", meeting=2
    )
    stated = load_bench(save_bench(replace(folded, effects=(view,)), tmp_path / "bench.toml"))
    off = present(simulate(stated, one).panel_pixel) - present(simulate(folded, one).panel_pixel)
    moved = np.abs(off[:, 0]) > 0.01
    np.testing.assert_array_equal(moved[seen], np.all(np.floor(places) == cell, axis=1)[seen])
    assert 0 < moved.sum() < seen.sum()
    session = Session("s", one, simulate(folded, one))
    slopes = [Predictor.of_session(each, session).observations.panel_from_camera for each in (folded, stated)]
    np.testing.assert_array_equal(slopes[0], slopes[1])


def test_any_function_displaces_a_station_and_a_file_states_it(bench: Bench, plan: SessionPlan, tmp_path: Path) -> None:
    def wave(place: FloatArray) -> FloatArray:
        return 0.4 * np.sin(place[:, :1] / 8.0) * np.cos(place[:, 1:] / 10.0)

    low, high = (-45, -45), (45, 45)  # the farthest of these lines of sight meets the combiner 40 mm from its middle
    own = BenchEffect.of_function("combiner", "all surfaces", wave, low, high)
    moved = replace(bench, effects=(own,))
    stated = load_bench(save_bench(moved, tmp_path / "bench.toml"))
    exact, read = simulate(moved, plan).panel_pixel, simulate(stated, plan).panel_pixel
    change = np.nanmax(np.abs(present(exact) - present(simulate(bench, plan).panel_pixel)))
    assert change > 0.05
    np.testing.assert_allclose(present(read), present(exact), atol=1e-3 * change)
    (found,) = stated.effects
    assert narrowed(found.function, Polynomial).orders.max() > 5
    # A lead screw: one coordinate of three, many periods.
    screw = BenchEffect.of_function(
        "stage", "pose", lambda x: np.sin(3.0 * x[:, :1]) * np.eye(6)[:1], (24,) * 3, (40,) * 3
    )
    place = np.array([[25.0, 30.0, 39.0], [33.3, 25.0, 30.0]])
    function = narrowed(screw.function, AnyFunction)
    np.testing.assert_allclose(function.as_polynomial()(place), function(place), atol=1e-6)


@pytest.mark.parametrize(("station", "displaces", "axis"), [("stage", "pose", 0), ("combiner", "all surfaces", 1)])
def test_a_wave_is_the_sine_of_one_coordinate_and_a_file_states_it(
    bench: Bench, plan: SessionPlan, tmp_path: Path, station: str, displaces: str, axis: int
) -> None:
    (low, high), outputs = BOXES[station], len(KINDS[station, displaces].per_displacement)
    coefficients = SIZES[station] * np.random.default_rng(3).normal(size=(2, outputs))

    def sine(place: FloatArray) -> FloatArray:
        phase = 2.0 * np.pi * place[:, [axis]] / 5.0
        return np.asarray(np.sin(phase) * coefficients[0] + np.cos(phase) * coefficients[1])

    wave = BenchEffect(station, displaces, Wave(axis, 5.0, coefficients))
    stated = load_bench(save_bench(replace(bench, effects=(wave,)), tmp_path / "bench.toml"))
    expected = replace(bench, effects=(BenchEffect.of_function(station, displaces, sine, low, high),))
    read, exact, still = (simulate(each, plan).parts[:2] for each in (stated, expected, bench))
    for one, other, without in zip(read, exact, still, strict=True):
        change = np.nanmax(np.abs(present(other) - present(without)))
        np.testing.assert_allclose(present(one), present(other), atol=1e-5 * change)
    assert np.nanmax(np.abs(present(exact[0]) - present(still[0]))) > 0.05


def test_waves_in_a_box_are_products_of_sines_and_nothing_outside(
    bench: Bench, plan: SessionPlan, tmp_path: Path
) -> None:
    low, high, orders = np.array([-4.0, -3.0]), np.array([5.0, 6.0]), np.array([[1, 1], [2, 1], [1, 3]])
    coefficients = np.array([[3.0], [-2.0], [1.0]])

    def height(place: FloatArray) -> FloatArray:
        s = (place - low) / (high - low)
        inside = np.all((s > 0) & (s < 1), axis=1)
        terms = np.prod(np.sin(np.pi * s)[:, None] * np.sin(np.pi * s[:, None] * orders), axis=2)
        return np.where(inside[:, None], terms @ coefficients, 0.0)

    bump = BenchEffect("combiner", "all surfaces", LocalWaves(orders, Box(low, high), coefficients))
    stated = load_bench(save_bench(replace(bench, effects=(bump,)), tmp_path / "bench.toml"))
    own = BenchEffect.of_function("combiner", "all surfaces", height, tuple(low - 20), tuple(high + 20))
    read, exact, still = (simulate(each, plan).panel_pixel for each in (stated, replace(bench, effects=(own,)), bench))
    change = np.nanmax(np.abs(present(exact) - present(still)))
    assert change > 1.0
    np.testing.assert_allclose(present(read), present(exact), atol=1e-4 * change)
    assert np.any(exact == still), "readings beside the box"


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("lens", "shift", np.sin, [0], [1]), r"no station 'lens' with a displacement 'shift'; choose panel \(shift\)"),
        (("time", "shift", np.sin, [5], [1]), r"The bounds \[5\] and \[1\] of an effect of the time"),
        (("panel", "shift", np.sin, [0], [1]), "are not lower and upper ones of panel pixel u, v"),
        (("time", "shift", np.sin, [0], [1]), r"returns shape \(2, 1\) for 2 places; it must return \(2, 2\): decoded"),
    ],
)
def test_a_function_that_does_not_fit_its_station_is_refused(
    arguments: tuple[str, str, Callable[..., Any], list[int], list[int]], sentence: str
) -> None:
    with pytest.raises(BadInputError, match=sentence):
        BenchEffect.of_function(*arguments)


def test_effects_are_written_and_read_back(bench: Bench, tmp_path: Path) -> None:
    root = np.random.default_rng(2).normal(size=(12, 12))
    effects = (
        *(effect(*kind) for kind in KINDS),
        replace(effect("target", "shift"), target_pose=0),
        replace(effect("panel", "shift by viewpoint"), channel=2),
        replace(effect("camera", "shift"), part="display", covariance=root @ root.T),
        BenchEffect("target", "shift", Cells(1.0, np.array([[0.5, -1.5], [2.5, 0.5]]), np.eye(3)[:2])),
    )
    found = load_bench(save_bench(replace(bench, effects=effects), tmp_path / "bench.toml"))
    for name in ("station", "displaces", "target_pose", "part", "channel"):
        assert [getattr(each, name) for each in found.effects] == [getattr(each, name) for each in effects]
    for one, other in zip(found.effects, effects, strict=True):
        assert (one.covariance is None) == (other.covariance is None)
        if one.covariance is not None:
            np.testing.assert_allclose(one.covariance, present(other.covariance), rtol=1e-8)
        assert isinstance(one.function, Cells | Polynomial)
        assert isinstance(other.function, Cells | Polynomial)
        if isinstance(other.function, Cells):
            np.testing.assert_array_equal(narrowed(one.function, Cells).middles, other.function.middles)
        else:
            np.testing.assert_array_equal(narrowed(one.function, Polynomial).orders, other.function.orders)
        np.testing.assert_allclose(one.function.coefficients, other.function.coefficients, rtol=1e-12)
        np.testing.assert_allclose(one.function.box.high, other.function.box.high)

"""The state of a bench: its derivatives against finite differences, and the motions of stages against closed forms."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from calibration.bench.imperfect_bench import Imperfections, TrueBench

from wlr_render.calibration.bench.bench_blocks import EXACT, FEATURES, SMOOTH_DEGREE, Block, Layout, lens_block
from wlr_render.calibration.bench.board_views import EYEBALL, BoardView, CameraSetup
from wlr_render.calibration.bench.normal_equations import residuals_of
from wlr_render.calibration.bench.start import start_lens, start_state
from wlr_render.calibration.bench.state import BenchState, StageModel
from wlr_render.calibration.poses import motion_between, small_motion
from wlr_render.captures.photo_session import StageAxis
from wlr_render.geometry import transforms
from wlr_render.lenses.lens_camera import LENS_KINDS, LensCamera
from wlr_render.lenses.residual_lens import ResidualLens
from wlr_render.numerics.arrays import FloatArray


@pytest.fixture(scope="module")
def state() -> BenchState:
    bench = TrueBench(1)
    observations = bench.observations(lens_photographs=5)
    rotary = (StageAxis(), StageAxis("rotary"), StageAxis())
    times = {name: replace(place, time_s=60.0 * k) for k, (name, place) in enumerate(observations.places.items())}
    observations = replace(observations, axes=rotary, places=times)
    lens = {}
    for name, setup in observations.cameras.items():
        views = [view for view in observations.views if view.camera == name and view.target is None]
        lens[name] = start_lens(views, setup.size_px, setup.kind)
    found = start_state(replace(observations, axes=(StageAxis(),) * 3), lens)
    rng = np.random.default_rng(2)
    twists = found.twists + np.concatenate([0.3 * rng.normal(size=(3, 3)), np.zeros((3, 3))], axis=1)
    sizes = {
        "smooth": 5e-5,
        "offset": 3e-4,
        "focus": 1e-5,
        "stretch": 1e-3,
        "screw": 3e-10,
        "shape": 1e-4,
        "drift": 1e-5,
    }
    values = {
        key: sizes[key[0]] * rng.normal(size=len(each.size)) for key, each in found.blocks.items() if key[0] in sizes
    }
    values |= {("axis", number): twist for number, twist in enumerate(twists)}
    return replace(found, observations=observations).with_values(values)


def test_derivatives_of_all_unknowns_are_those_of_finite_differences(state: BenchState) -> None:
    layout = Layout.of(state.blocks)
    rng = np.random.default_rng(3)
    views = [
        next(view for view in state.observations.views if view.name.startswith(kind))
        for kind in ("lens/eyeball", "bare/pose1_03", "tracking/pose0")
    ]
    for view in views:
        part = residuals_of(state, view)
        columns = {("shape", view.board): part.by_place @ state.shape[view.board].by_low(view.point), **part.columns}
        columns |= {key: part.by_motion @ motion for key, motion in part.motion.items()}
        for key, derivative in columns.items():
            width = layout.where[key].stop - layout.where[key].start
            direction = rng.normal(size=width)
            if key[0] == "lens":
                direction[:4] *= 100.0

            def residual(
                amount: float,
                key: tuple[str, int | str] = key,
                direction: FloatArray = direction,
                view: BoardView = view,
            ) -> FloatArray:
                still = layout.steps(np.zeros(len(layout.size)))
                still |= {(FEATURES, name): np.zeros(shape.place.size) for name, shape in state.shape.items()}
                return residuals_of(state.moved(still | {key: amount * direction}), view).residual

            step = 1e-6
            expected = -(residual(step) - residual(-step)) / (2 * step)
            size = np.abs(expected).max()
            assert size > 0, key
            # The stage's errors are taken as motions in the camera's frame, to first order in their own size; readings
            # are small, and so is what an axis does to pixels of a thousand.
            tolerance = {"smooth": 5e-3, "offset": 5e-3, "screw": 5e-3, "drift": 5e-3, "axis": 5e-4}.get(key[0], 2e-5)
            rounded = 3e-7  # of pixels to the last bit, over twice the step
            atol = tolerance * size + rounded
            np.testing.assert_allclose(derivative @ direction, expected, atol=atol, err_msg=str(key))


def test_a_stretched_image_is_larger_about_its_middle(state: BenchState) -> None:
    view = next(view for view in state.observations.views if view.name in state.of("stretch"))
    part = residuals_of(state, view)
    unstretched = {key: block for key, block in state.blocks.items() if key[0] != "stretch"}
    still = residuals_of(replace(state, blocks=unstretched), view)
    from_middle = view.pixel - 0.5 * np.array(state.lens[EYEBALL].size_px)
    stretch = state.of("stretch")[view.name]
    larger = from_middle @ stretch.reshape(2, 2).T
    np.testing.assert_allclose(still.residual - part.residual, larger, atol=1e-9)
    np.testing.assert_allclose(part.columns["stretch", view.name] @ stretch, larger, atol=1e-9)


def test_a_linear_axis_translates_and_a_rotary_one_turns_about_its_pivot() -> None:
    middle, half = np.zeros(2), np.ones(2)
    pivot = np.array([0.0, 0.0, -0.01])
    about_y = np.array([0.0, 1.0, 0.0])
    twists = np.array([[0, 0, 0, 1.0, 0.01, 0], [*about_y, *-np.cross(about_y, pivot)]])
    stage = StageModel(middle, half, twists, np.zeros((0, 6)))
    np.testing.assert_allclose(stage.motion(np.array([0.02, 0.0]))[:3, 3], [0.02, 2e-4, 0.0], atol=1e-15)
    angle = 0.4
    turned_about_pivot = stage.motion(np.array([0.0, angle]))
    np.testing.assert_allclose(turned_about_pivot[:3, :3], transforms.rotation_about("y", angle), atol=1e-14)
    np.testing.assert_allclose(transforms.apply(turned_about_pivot, pivot), pivot, atol=1e-15)


def test_the_camera_at_a_place_is_base_stage_and_errors(state: BenchState) -> None:
    place = next(name for name in state.of("offset") if name.endswith("_03.png"))
    reading = state.observations.places[place].reading
    assert reading is not None
    offset = state.stage.smooth_error(reading) + state.of("offset")[place]
    for (_, which), along in state.screws(reading).items():
        offset = offset + along[:, 0] * state.of("screw")[which]
    offset[:2] += state.drift_terms(place) @ np.array(list(state.of("drift").values()))
    expected = state.base[0] @ state.stage.nominal(reading) @ small_motion(offset)
    assert np.abs(motion_between(expected, state.device_from_camera(place))).max() < 1e-12


def test_errors_of_a_visit_move_the_camera_of_a_second_mounting_as_stated(state: BenchState) -> None:
    place = next(name for name in state.of("offset") if name.endswith("_03.png"))
    mount = small_motion(np.array([0.2, -1.0, 0.3, 0.01, 0.02, -0.03]))
    places = dict(state.observations.places)
    places[place] = replace(places[place], orientation=7)
    second: dict[tuple[str, int | str], Block] = {
        ("base", 7): replace(state.blocks["base", 0], value=state.base[0] @ mount)
    }
    there = replace(state, observations=replace(state.observations, places=places), blocks={**state.blocks, **second})
    still = there.with_values({("offset", place): np.zeros(6)})
    before = still.device_from_camera(place)
    columns = still.visit_motion(place)["offset", place]
    for axis, step in enumerate(1e-6 * np.eye(6)):
        after = still.with_values({("offset", place): step}).device_from_camera(place)
        np.testing.assert_allclose(
            motion_between(np.eye(4), transforms.inverse(before) @ after), 1e-6 * columns[:, axis], atol=2e-9
        )


def test_a_bent_board_is_where_its_shape_says() -> None:
    bench = TrueBench(0, Imperfections())
    observations = bench.observations(lens_photographs=3)
    lens = dict(bench.lens)
    shape = start_state(observations, lens).shape["board"]
    bent = replace(shape, low=np.array([1e-4, 2e-4, 3e-5, 1e-3, -1e-3, 0.0]), fields=None)
    corner, middle = bench.nominal[:1], np.zeros((1, 3))
    x, y = corner[0, :2]
    np.testing.assert_allclose(
        bent.point_of(bench.feature[:1], corner), [[x * 1.001, y * 0.999, 3e-5 * np.sign(x * y)]], atol=2e-7
    )
    np.testing.assert_allclose(bent.point_of(np.array([[-5, -5]]), middle), [[0, 0, 3e-4]], atol=1e-12)


def test_smooth_terms_have_unit_rms_over_the_range() -> None:
    stage = StageModel(np.array([0.01]), np.array([0.005]), np.zeros((1, 6)), np.zeros((SMOOTH_DEGREE, 6)))
    readings = np.linspace(0.005, 0.015, 2001)
    terms = np.array([stage.smooth_terms(np.array([reading])) for reading in readings])
    np.testing.assert_allclose(np.sqrt(np.mean(terms**2, axis=0)), 1.0, rtol=5e-3)


def test_terms_of_a_narrow_lens_may_be_large() -> None:
    # Terms that displace the corner of a field of +-20 degrees by a tenth are up to 42 in size.
    terms = np.array([0.64, 1.96, 7e-4, -6e-4, 42.8, 0.92, 1.87, 42.8])
    lens = LensCamera((1280, 1024), np.full(2, 2200.0), np.array([640.0, 512.0]), terms, "rational")
    observations = TrueBench(1).observations(lens_photographs=3)
    sizes = start_state(observations, {**TrueBench(1).lens, EYEBALL: lens}, rough=True).blocks["lens", EYEBALL].size
    assert np.all(np.abs(lens.distortion) < sizes[4:])
    assert np.all(sizes[6:8] < 10.0)


@pytest.mark.parametrize(("kind", "held"), [("fisheye", []), ("brown", []), ("rational", ["k4", "k5", "k6"])])
def test_a_residual_field_replaces_the_last_terms_of_perspective_lenses_alone(kind: str, held: Sequence[str]) -> None:
    terms = 1e-3 * np.arange(1, len(LENS_KINDS[kind]) + 1)
    lens = ResidualLens.of(
        LensCamera((1280, 1024), np.full(2, 900.0), np.array([640.0, 512.0]), np.asarray(terms), kind)
    )
    block = lens_block(EYEBALL, lens, CameraSetup(lens.size_px, kind))
    assert [name for name, size in zip(lens.names, block.size, strict=True) if size <= EXACT] == held
    for name, middle, value in zip(lens.names, block.middle, lens.values, strict=True):
        if name in held:
            assert middle == value

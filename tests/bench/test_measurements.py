"""Captures are diagnosed as the bench session is that they were made of, and by a device alone."""

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from oracle.captures import Plan
from oracle.effects import Effect
from oracle.session_writer import write_session
from present import present

from wlr_render.bench.bench import Bench
from wlr_render.bench.measurements import load_measurements
from wlr_render.bench.session_captures import captures_of
from wlr_render.bench.session_folder import load_session, save_session
from wlr_render.bench.simulate_session import simulate
from wlr_render.captures.capture_file import load_observations
from wlr_render.captures.correspondences import Captures
from wlr_render.captures.session import Session
from wlr_render.diagnosis.causes import CAUSES
from wlr_render.diagnosis.prediction import Predictor
from wlr_render.diagnosis.procedure import diagnose
from wlr_render.diagnosis.settings import Settings
from wlr_render.errors import BadInputError
from wlr_render.geometry.transforms import rotation_about
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.simulation.capture_setup import CaptureSetup
from wlr_render.simulation.simulate_captures import simulate_display, simulate_see_through

SCALE_PERCENT = 0.4
FEW = {name: CAUSES[name] for name in ("target_scale", "combiner_tilt", "camera_rotation")}


@pytest.fixture(scope="module")
def printed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a bench session whose target was printed too large."""
    folder = tmp_path_factory.mktemp("bench") / "printed"
    effect = Effect("target_scale", {"scale_percent": SCALE_PERCENT})
    write_session(folder, Plan(grid=(7, 6), dots=(7, 5), off_plane=6), [effect], np.random.default_rng(2))
    return folder


@pytest.fixture(scope="module")
def captures(printed: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Capture file of the same session."""
    path = tmp_path_factory.mktemp("captures") / "captures-right.npz"
    return captures_of(*load_session(printed)).save(path)


def assert_same_observations(found: tuple[Bench, Session], expected: tuple[Bench, Session]) -> None:
    """A diagnosis takes nothing else from measurements than these, and what times and travel are recorded."""
    one, other = (Predictor.of_session(*each).observations for each in (found, expected))
    np.testing.assert_array_equal(one.group, other.group)
    assert [each.part for each in one.captures] == [each.part for each in other.captures]
    np.testing.assert_allclose(one.sigma_px, other.sigma_px, rtol=1e-4)
    mine, theirs = (each.residual(simulate(each.nominal, each.session.plan)) for each in (one, other))
    np.testing.assert_allclose(mine, theirs, atol=1e-4)
    for part, column in product(("display", "see_through"), ("time_s", "travel", "stage")):
        mine, theirs = (getattr(getattr(each.session.plan, part), column) for each in (one, other))
        np.testing.assert_allclose(mine, theirs, atol=1e-7, err_msg=column)


def test_captures_are_observed_as_the_session_that_they_were_made_of(printed: Path, captures: Path) -> None:
    assert_same_observations(load_measurements(captures, printed / "bench.toml"), load_session(printed))


def test_by_the_device_alone_the_cause_is_named_with_its_size(captures: Path) -> None:
    bench, session = load_measurements(captures)
    np.testing.assert_allclose(1.0 / bench.camera.focal_px, np.radians(1 / 60))
    assert np.all(
        (present(session.plan.display).camera_pixel > 0)
        & (present(session.plan.display).camera_pixel < bench.camera.size_px)
    )
    found = diagnose(bench, session, causes=FEW, settings=Settings(subsample=1500))
    (cause,) = found.causes
    assert (cause.name, found.verdict) == ("target_scale", "explained")
    for parameter in cause.parameters:
        assert abs(parameter.value - SCALE_PERCENT) < 4 * parameter.sigma


@pytest.fixture(scope="module")
def repeated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Capture file of a headset that is as it should be, on a stage that repeats to 5 um and 20 urad."""
    truth, rng = traced_eye(load_device("northstar"), "right"), np.random.default_rng(3)
    setup = CaptureSetup(truth, 0.25, 5e-6, grid=(9, 8), stage_turn_rad=20e-6)
    positions = setup.camera_positions("volumetric", 16)
    table = Captures(simulate_display(setup, positions, rng), simulate_see_through(setup, positions, rng))
    return table.save(tmp_path_factory.mktemp("repeated") / "captures-right.npz")


def test_captures_are_observed_alike_once_they_are_saved_as_a_session(repeated: Path, tmp_path: Path) -> None:
    bench, session = load_measurements(repeated, device="northstar")
    assert_same_observations(load_session(save_session(tmp_path / "session", bench, session)), (bench, session))
    assert not present(session.plan.display).time_s.any()


def test_the_bench_of_captures_predicts_what_exact_captures_hold(tmp_path: Path) -> None:
    truth, rng = traced_eye(load_device("northstar"), "right"), np.random.default_rng(3)
    setup = CaptureSetup(truth, grid=(5, 4))
    positions = setup.camera_positions("volumetric", 6)
    display, see_through = simulate_display(setup, positions, rng), simulate_see_through(setup, positions, rng)
    for turned in (None, np.eye(3), rotation_about("y", 0.2), _by_capture(display.capture, see_through.capture)):
        shown, seen = display, see_through
        if turned is not None:
            one, other = turned if isinstance(turned, tuple) else (turned, turned)
            shown, seen = replace(shown, device_from_camera=one), replace(seen, device_from_camera=other)
        path = Captures(shown, seen).save(tmp_path / "captures-right.npz")
        bench, session = load_measurements(path)
        predicted = simulate(bench, session.plan)
        assert predicted.panel_pixel is not None
        np.testing.assert_allclose(predicted.panel_pixel, present(session.readings.panel_pixel), atol=1e-6)
        assert predicted.dot_pixel is not None
        np.testing.assert_allclose(predicted.dot_pixel, present(session.readings.dot_pixel), atol=1e-6)
        again_bench, again = load_session(save_session(tmp_path / "again", bench, session))
        predicted = simulate(again_bench, again.plan)
        np.testing.assert_allclose(present(predicted.panel_pixel), present(again.readings.panel_pixel), atol=1e-6)
        np.testing.assert_allclose(present(predicted.dot_pixel), present(again.readings.dot_pixel), atol=1e-6)


def _by_capture(first: IntArray, second: IntArray) -> tuple[FloatArray, FloatArray]:
    """A rotation of the camera for each row, one for each camera position."""
    turns = np.stack([rotation_about("x", angle) for angle in np.linspace(-0.1, 0.1, 6)])
    return turns[first], turns[second]


def test_targets_that_are_not_flat_keep_their_shape(repeated: Path, tmp_path: Path) -> None:
    shown, seen = load_observations(repeated).both
    lifted = seen.point + [0, 0, 0.001] * np.cos(300 * seen.point[:, :1])
    own = np.column_stack([seen.point[:, 1], -seen.point[:, 0], lifted[:, 2] - seen.point[:, 2]]) + [0.3, 0.0, 0.01]
    for target_point in (np.full(3, np.nan), own):
        changed = replace(seen, point=lifted, target_point=target_point)
        path = Captures(shown, changed).save(tmp_path / "captures-right.npz")
        bench, session = load_measurements(path)
        plan = session.plan.see_through
        assert plan is not None
        assert present(plan.height).std() > 3e-4
        at = np.column_stack([plan.dot, present(plan.height)])
        pose = bench.target.device_from_target[plan.target_pose]
        np.testing.assert_allclose(np.einsum("nij,nj->ni", pose[:, :3, :3], at) + pose[:, :3, 3], lifted, atol=1e-12)
        if target_point is own:
            np.testing.assert_allclose(at, own, atol=1e-9)


def test_a_calibrations_folder_has_the_captures_of_one_eye(captures: Path, printed: Path, tmp_path: Path) -> None:
    folder = tmp_path / "calibrated"
    folder.mkdir()
    (folder / "captures-right.npz").write_bytes(captures.read_bytes())
    assert load_measurements(folder)[1].name == "calibrated"
    (folder / "captures-left.npz").write_bytes(captures.read_bytes())
    with pytest.raises(BadInputError, match=r"has captures-left\.npz and captures-right\.npz; name one"):
        load_measurements(folder)
    assert load_measurements(folder, printed / "bench.toml")[0].eye == "right"


def test_benches_and_devices_that_do_not_fit_are_refused(captures: Path, printed: Path, tmp_path: Path) -> None:
    for arguments, words in (
        ((printed, None, "northstar"), "so --device does not apply"),
        ((captures, printed / "bench.toml", "northstar"), "give one of them"),
        ((captures, _other_device(printed, tmp_path)), "the captures are of northstar"),
        ((tmp_path / "nothing",), "nothing: has no bench.toml, so it is not a bench session"),
    ):
        with pytest.raises(BadInputError, match=words):
            load_measurements(*arguments)
    other = load_observations(captures).of_device("mine").save(tmp_path / "captures-right.npz")
    with pytest.raises(BadInputError, match=r"is of 'mine', which is not a shipped device; name its presc"):
        load_measurements(other)
    assert load_measurements(other, None, "northstar")[0].device.name == "northstar"
    with pytest.raises(BadInputError, match="is of a panel of 1440 x 1600 pixels, but birdbath28 has"):
        load_measurements(other, None, "birdbath28")


def _other_device(printed: Path, folder: Path) -> Path:
    """The bench of a session, with another headset."""
    text = (printed / "bench.toml").read_text().replace('"northstar"', '"birdbath28"')
    (folder / "bench.toml").write_text(text)
    return folder / "bench.toml"

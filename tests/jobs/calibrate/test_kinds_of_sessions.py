"""Sessions of other kinds than the usual one, from readings to report: one mapping, both eyes, primaries, one axis."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from memo import memoised, shared_folder
from present import narrowed, present
from small_photo_session import with_stated_lenses

from benchmarks.simulated_lab.simulate_readings import SimulatedReadings, simulate_readings
from wlr_render.calibration.calibrate_session import SessionCalibration, calibrate_session
from wlr_render.calibration.fit_display import fit_display
from wlr_render.calibration.poses import motion_between
from wlr_render.captures.boards.board import BoardObservation
from wlr_render.captures.photo_session import CodeSet, PhotoSession, SessionPanel, StageAxis, StageDescription
from wlr_render.captures.photo_session_checks import check_session
from wlr_render.captures.session_reading import Reading
from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.geometry.directions import arcmin_between
from wlr_render.io.toml_files import Table
from wlr_render.jobs.calibrate.calibrate_options import CalibrateOptions, FitOptions
from wlr_render.jobs.calibrate.photos import report_of
from wlr_render.models.model_file import load_eye_model, load_eye_models
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.planning.planned_bench import ReadingOptions
from wlr_render.report.blocks import Report, ReportTable
from wlr_render.simulation.photographs.imperfections import BenchImperfections
from wlr_render.simulation.photographs.photo_bench import PhotoBenchOptions
from wlr_render.simulation.photographs.recipe import SimulationRecipe
from wlr_render.simulation.viewpoints import random_in_eye_box

pytestmark = pytest.mark.slow  # a session takes some ten seconds

FIT = FitOptions(degree=3, see_through_degree=2)
FEW = ReadingOptions(most_dots=40, panel_samples=80)


def simulated(**bench: Any) -> SimulatedReadings:
    return simulate_readings(SimulationRecipe("birdbath28", viewpoints=9, bench=PhotoBenchOptions(**bench)), FEW)


def with_known_lenses(made: SimulatedReadings) -> PhotoSession:
    """The session with both cameras calibrated before: no board is photographed for them, and none of it is fitted."""
    bench, session = made.truth.bench, made.session
    cameras: dict[str, Any] = {
        "eyeball_camera": replace(session.eyeball_camera, intrinsics=(), calibrated=bench.eyeball.camera),
        "tracking_camera": replace(present(session.tracking_camera), intrinsics=(), calibrated=bench.tracking.camera),
    }
    return replace(session, **cameras)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> SimulatedReadings:
    return memoised(simulated, shared_folder(tmp_path_factory))()


@pytest.fixture(scope="module")
def usual(made: SimulatedReadings) -> SimulatedReadings:
    return replace(made, session=with_known_lenses(made))


def calibrated(session: PhotoSession, reading: Reading, folder: Path) -> tuple[SessionCalibration, Report]:
    found = calibrate_session(session, reading, folder, FIT.fit)
    return found, report_of(found, CalibrateOptions(str(session.folder), fit=FIT, out=folder))


def rows_of(report: Report, title: str) -> dict[Any, Any]:
    (table,) = (block for block in report.blocks if getattr(block, "title", "") == title)
    return {row[0]: row[1:] for row in narrowed(table, ReportTable).rows}


def assert_poses(
    found: SessionCalibration, entries: tuple[CodeSet, ...], places: FloatArray | Sequence[FloatArray]
) -> None:
    off = [
        motion_between(found.bench.camera_pose(each).b_from_a, true) for each, true in zip(entries, places, strict=True)
    ]
    sigma = [np.sqrt(np.diag(found.bench.camera_pose(each).covariance)) for each in entries]
    assert np.sqrt(np.mean(np.square(np.array(off) / sigma))) < 2.0


def test_see_through_alone(usual: SimulatedReadings, tmp_path: Path) -> None:
    session = replace(usual.session, display=())
    found, report = calibrated(session, usual.reading, tmp_path)
    assert found.eyes["right"].captures.display is None
    assert "display" not in report.verdict
    model = load_eye_model(tmp_path / "model.json").mappings
    with pytest.raises(BadInputError, match="no display mapping"):
        model.display.pixel_of_view_dir(np.array([0.0, 0.0, -1.0]), model.eye_box.centre)


@pytest.mark.parametrize("known_lens", [False, True])
def test_display_alone_in_the_frame_of_the_camera(
    made: SimulatedReadings, usual: SimulatedReadings, tmp_path: Path, known_lens: bool
) -> None:
    bench, stated_lens = usual.truth.bench, with_stated_lenses(made.session).eyeball_camera
    gauge = transforms.OPENXR_FROM_OPENCV @ bench.device_from_camera[:3, :3].T
    axes = tuple(StageAxis("linear", gauge @ (axis / np.linalg.norm(axis)), 5e-3) for axis in bench.stage_axes.T)
    # With a known lens no board was ever photographed.
    session = replace(
        usual.session if known_lens else replace(usual.session, eyeball_camera=stated_lens),
        see_through=(),
        bare=(),
        tracking=(),
        tracking_camera=None,
        device_from_tracking=None,
        tracking_sigma=None,
        gauge="camera",
        stage=StageDescription(axes),
    )
    found, report = calibrated(session, usual.reading, tmp_path)
    assert "see-through" not in report.verdict
    readings = np.array([each.stage for each in session.display])
    middle = 0.5 * (readings.min(axis=0) + readings.max(axis=0))
    own = transforms.rigid(transforms.OPENXR_FROM_OPENCV, session.eye_box.centre)
    own = own @ transforms.inverse(bench.camera_at(middle))
    true = [own @ pose for pose in usual.truth.display]
    assert_poses(found, session.display, true)


def test_both_eyes_have_one_bench_and_their_alignment_is_stated(usual: SimulatedReadings, tmp_path: Path) -> None:
    """The left eye is the right one photographed again: both displays agree within what is stated."""

    def of_left(path: Path) -> Path:
        return path.with_name(f"left_{path.name}")

    one, box = usual.session, usual.session.eye_box
    display = tuple(replace(each, folder=of_left(each.folder), eye="left") for each in one.display)
    through = tuple(replace(each, name=f"left_{each.name.replace('/', '_')}", eye="left") for each in one.see_through)
    boards = dict(usual.reading.boards)
    boards |= {new.path: boards[old.path] for new, old in zip(through, one.see_through, strict=True)}
    panels = usual.reading.panels | {of_left(each.folder): usual.reading.panels[each.folder] for each in one.display}
    session = replace(
        one,
        eyes=("left", "right"),
        eye_boxes={"left": box, "right": box},
        panels={eye: SessionPanel(one.pattern) for eye in ("left", "right")},
        display=one.display + display,
        see_through=one.see_through + through,
    )
    _, report = calibrated(session, Reading(boards, panels), tmp_path)
    assert set(load_eye_models(tmp_path / "model.json")) == {"left", "right"}
    alignment = rows_of(report, "Binocular alignment")
    for name in ("vertical (arcmin)", "horizontal (arcmin)", "roll (arcmin)"):
        apart, sigma = alignment[name]
        assert abs(apart) < 0.1
        # Two visits of one stage place: its repeatability, and nothing of the tracking camera's pose (3').
        assert 0.005 < sigma < 0.5
    assert alignment["position along x (mm)"][1] < 0.05


def test_every_primary_has_its_display_model(usual: SimulatedReadings, tmp_path: Path) -> None:
    offsets = {"red": np.array([-0.333, 0.0]), "blue": np.array([0.333, 0.0])}
    one = usual.session
    colours = ("red", "green", "blue")
    display, panels = [], {}
    for each in one.display:
        for colour in colours:
            own = replace(each, folder=Path(f"{each.folder}_{colour}"), channel=colour)
            display.append(own)
            read = usual.reading.panels[each.folder]
            # The primary lies beside the middle of its pixel, which decoding takes it for; red is magnified more.
            place = read.samples.panel_pixel - offsets.get(colour, 0.0)
            place = place if colour != "red" else place + 1e-3 * (place - 900.0)
            panels[own.folder] = replace(read, samples=replace(read.samples, panel_pixel=place))
    session = replace(one, display=tuple(display), panels={"right": SessionPanel(one.pattern, primary_offsets=offsets)})
    found, report = calibrated(session, replace(usual.reading, panels=panels), tmp_path)
    assert (
        set(found.eyes["right"].primaries) == set(rows_of(report, "Models of the other primaries")) == {"red", "blue"}
    )
    models = {
        colour: load_eye_model(tmp_path / ("model.json" if colour == "green" else f"model-{colour}.json")).mappings
        for colour in colours
    }
    pixel, eye = np.array([[300.0, 300.0], [1500.0, 800.0]]), one.eye_box.centre
    seen = {colour: model.display.view_dir_of_pixel(pixel, eye).value for colour, model in models.items()}
    assert arcmin_between(seen["blue"], seen["green"]).max() < 0.02  # a third of a pixel is 0.4'
    assert arcmin_between(seen["red"], seen["green"]).min() > 0.3
    assert len(present(found.eyes["right"].captures.display)) * 3 == sum(len(each.samples) for each in panels.values())


def test_a_stage_of_one_axis(tmp_path: Path) -> None:
    """No kind of lens is stated for the eyeball camera, so that it is chosen."""
    made = simulated(stage="x")
    eyeball = replace(with_stated_lenses(made.session).eyeball_camera, lens="auto")
    session = replace(with_known_lenses(made), eyeball_camera=eyeball)
    found, report = calibrated(session, made.reading, tmp_path)
    assert_poses(found, made.session.display, made.truth.display)
    assert present(found.eyes["right"].fit.display).report.moved == ()  # nine positions, none of which moved
    assert any("camera positions at" in step for step in report.advice)


def in_the_hand(made: SimulatedReadings) -> tuple[PhotoSession, Reading]:
    """The session without its stage: from each place a part of the board is also seen past the optics."""
    truth, rng = made.truth, np.random.default_rng(1)
    boards, through, beside = dict(made.reading.boards), [], []
    poses = zip(truth.see_through, truth.see_through_targets, strict=True)
    for number, (each, (camera, target)) in enumerate(zip(made.session.see_through, poses, strict=True)):
        through.append(replace(each, stage=None, place=f"place {number}"))
        beside.append(replace(through[-1], name=f"beside/{number:02d}.png"))
        lens, index = truth.eyeball_at_target[each.target_pose], made.session.board.indices()
        pixel = lens.pixel_of_point(transforms.apply(transforms.inverse(camera) @ target, truth.bench.printed.points))
        seen = np.flatnonzero(np.all((pixel > 6) & (pixel < np.array(lens.size_px) - 6), axis=1))
        seen = seen[index[seen, 0] <= np.quantile(index[seen, 0], 0.25)]
        noisy = pixel[seen] + rng.normal(0.0, 0.02, (len(seen), 2))
        boards[beside[-1].path] = BoardObservation(index[seen], noisy, np.full(len(seen), 0.02))
    display = [replace(each, stage=None, place=f"place {k}") for k, each in enumerate(made.session.display)]
    parts: dict[str, Any] = {"display": tuple(display), "see_through": tuple(through), "beside": tuple(beside)}
    return replace(made.session, stage=None, bare=(), **parts), replace(made.reading, boards=boards)


def test_a_camera_in_the_hand(usual: SimulatedReadings, tmp_path: Path) -> None:
    session, reading = in_the_hand(usual)
    check_session(Table({}, "session.toml"), session)
    found = calibrate_session(session, reading, tmp_path, FIT.fit)
    assert_poses(found, session.display, usual.truth.display)
    assert found.all_excluded == []


def test_positions_in_the_eye_box_are_fitted_as_a_volume_and_as_a_plane(tmp_path: Path) -> None:
    """Judged off the middle plane, by the exact optics; the extrinsics alone turn every direction by some 0.4'."""
    sizes = replace(BenchImperfections(), extrinsics_mm=0.02, extrinsics_deg=0.005)
    bench = PhotoBenchOptions(camera_px=(640, 512), sampling="volumetric", imperfections=sizes)
    recipe = SimulationRecipe("birdbath28", viewpoints=12, bench=bench)
    made = simulate_readings(recipe, FEW)
    session = with_known_lenses(made)
    found = calibrate_session(
        session, made.reading, tmp_path, FitOptions(kind="volumetric", degree=5, see_through_degree=2).fit
    ).eyes["right"]
    assert found.captures.display is not None
    assert np.ptp(found.captures.display.viewpoint[:, 2]) > 0.9 * session.eye_box.size[2]
    truth = traced_eye(made.truth.bench.device, "right")
    viewpoint = random_in_eye_box(truth.eye_box, 20, np.random.default_rng(1))[:, None]
    pixel = truth.display.panel.grid(9, 7).reshape(-1, 2)
    true = truth.display.view_dir_of_pixel(pixel, viewpoint)
    median = []
    for display in (found.fit.mappings.display, fit_display(found.captures.display, "planar", 3).mapping):
        seen = display.view_dir_of_pixel(pixel, viewpoint)
        usable = true.usable & seen.usable
        assert usable.sum() > 0.95 * true.usable.sum()
        median.append(np.median(arcmin_between(true.value, seen.value)[usable]))
    volumetric, planar = median
    assert planar < 1.0
    assert volumetric < 1.2  # 1.4 if the depth of a viewpoint is ignored

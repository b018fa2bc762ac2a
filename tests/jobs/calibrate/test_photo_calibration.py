"""A session of photographs, simulated and calibrated: what comes out beside the truth, and what is read again."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import needs_browser, open_page
from numpy.typing import NDArray
from present import narrowed, present
from scipy.stats import chi2
from small_photo_session import VIEWPOINTS, SmallSession, small_plan

from benchmarks.simulated_lab.saved_station import load_station
from wlr_render.bench.measurements import load_measurements
from wlr_render.calibration.calibrate_session import EyeCalibration, SessionCalibration
from wlr_render.calibration.poses import Pose, motion_between
from wlr_render.captures.capture_file import load_captures
from wlr_render.diagnosis.observations import DISPLAY, SEE_THROUGH
from wlr_render.diagnosis.prediction import Explanation, Predictor
from wlr_render.geometry.directions import ARCMIN, arcmin_between
from wlr_render.jobs.calibrate.calibrate_options import save_models
from wlr_render.jobs.calibrate.photos import calibrated
from wlr_render.lenses.residual_lens import ResidualLens
from wlr_render.models.model_file import load_eye_model
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device_file import save_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.report.blocks import Plot, Report, Section
from wlr_render.simulation.photographs.photo_bench import PhotoBench
from wlr_render.simulation.photographs.photo_plan import true_camera_poses

pytestmark = pytest.mark.slow  # the session that all of them copy takes some twenty seconds to make

LEAST_PROBABILITY = 1e-4  # of 38 poses
NEAREST_M = 0.4  # of the targets
ALL = 22 + 4 + 10 + 2 * 6 + 4  # photographs of the board, and sets of the panel


@pytest.fixture
def found(calibrated_session: tuple[SmallSession, SessionCalibration, Report]) -> SessionCalibration:
    return calibrated_session[1]


@pytest.fixture
def report(calibrated_session: tuple[SmallSession, SessionCalibration, Report]) -> Report:
    return calibrated_session[2]


@pytest.fixture
def right(found: SessionCalibration) -> EyeCalibration:
    return found.eyes["right"]


@pytest.fixture
def bench(calibrated_session: tuple[SmallSession, SessionCalibration, Report]) -> PhotoBench:
    return calibrated_session[0].bench


def probability(true: FloatArray, pose: Pose) -> float:
    """Of an error of a pose as large as this one, by its covariance."""
    motion = motion_between(true, pose.b_from_a)
    return float(chi2.sf(motion @ np.linalg.solve(pose.covariance, motion), 6))


def test_camera_and_target_are_where_they_are_found_within_their_sigmas(
    found: SessionCalibration, bench: PhotoBench
) -> None:
    """At every visit: each has its own random error."""
    visits = true_camera_poses(bench, small_plan(bench, VIEWPOINTS))
    for kind in ("bare", "see_through", "display"):
        entries = getattr(found.session, kind)
        for entry, visit in zip(entries, getattr(visits, kind), strict=True):
            pose = found.bench.camera_pose(entry)
            assert probability(visit.device_from_camera, pose) > LEAST_PROBABILITY, entry
            np.testing.assert_allclose(pose.b_from_a, found.bench.device_from_camera(entry), atol=1e-12)
    for number, true in enumerate(bench.device_from_target):
        assert probability(true, found.bench.targets[number]) > LEAST_PROBABILITY


def test_every_check_passes_and_nothing_is_left_unchecked(found: SessionCalibration) -> None:
    assert [check.sentence for check in found.bench.checks if not check.ok] == []
    assert (found.bench.faults, found.bench.rejected, found.bench.unchecked) == ([], (), [])


def test_lenses_are_found_within_their_sigmas(found: SessionCalibration, bench: PhotoBench) -> None:
    adjustment = found.bench.adjustment
    for name, true in (("eyeball", bench.eyeball.camera), ("tracking", bench.tracking.camera)):
        lens = narrowed(adjustment.state.lens[name], ResidualLens)
        sigma = np.sqrt(np.diag(adjustment.covariance_of([("lens", name)])))[:4]
        off = np.concatenate([lens.focal_px - true.focal_px, lens.centre_px - true.centre_px])
        assert np.all(np.abs(off) < 4 * sigma)


def camera_error_arcmin(found: SessionCalibration) -> float:
    """What the uncertainty of the camera's rotation does to every direction of a session alike."""
    return float(np.linalg.norm(found.bench.camera_pose(found.session.display[0]).sigma_arcmin))


def test_captures_agree_with_the_devices_exact_mappings(
    found: SessionCalibration, right: EyeCalibration, bench: PhotoBench
) -> None:
    truth = traced_eye(bench.device, "right")
    allowed = 4 * camera_error_arcmin(found)
    display, see_through = right.captures.display, right.captures.see_through
    assert display is not None
    seen = truth.display.view_dir_of_pixel(display.pixel, display.viewpoint)
    assert seen.usable.all()
    assert np.median(arcmin_between(seen.value, display.view_dir)) < allowed
    assert see_through is not None
    seen = truth.see_through.view_dir_of_real_point(see_through.point, see_through.viewpoint)
    assert seen.usable.all()
    assert np.median(arcmin_between(seen.value, see_through.view_dir)) < allowed


def test_a_photographic_session_can_be_diagnosed(
    found: SessionCalibration, bench: PhotoBench, photo_session: SmallSession, tmp_path: Path
) -> None:
    device = save_device(bench.device, tmp_path / "device.toml")
    nominal, session = load_measurements(photo_session.out, device=device)
    captures = load_captures(photo_session.out / "captures-right.npz").see_through
    stage = np.array([each.stage for each in found.session.see_through])
    assert captures is not None
    np.testing.assert_array_equal(captures.stage, stage[captures.visit])
    predictor = Predictor.of_session(nominal, session)
    observations, residual = predictor.observations, predictor.residual(Explanation())
    assert np.mean(observations.part == SEE_THROUGH) > 0.1
    for part in (DISPLAY, SEE_THROUGH):
        arcmin = np.linalg.norm(observations.arcminutes(residual, part), axis=1)
        assert np.median(arcmin) < 4 * camera_error_arcmin(found)


def test_a_flat_image_is_fitted_to_the_noise(found: SessionCalibration, right: EyeCalibration) -> None:
    fit = right.fit
    # The camera's pixel is nearly 6 arcminutes; a fiftieth of it is what the mean over a window of pixels can leave.
    pixel = arcmin_between(*found.bench.eyeball.dir_of_pixel(np.array([[200.0, 160.0], [201.0, 160.0]])))
    for report in (present(fit.display).report, present(fit.see_through).report):
        assert report.noise_arcmin < 0.02 * pixel
        # The stage moved by errors of its own at each camera position; the residual of the model has them.
        motion = 1e-6 * np.hypot(report.wobble_urad, report.repeatability_um / NEAREST_M) / ARCMIN
        assert report.residual_arcmin.rms < 2 * np.hypot(motion, report.noise_arcmin)
        # Four camera positions leave the model less sure beside them than at them.
        assert report.predicted_arcmin < 0.2 * pixel


def test_what_is_written_can_be_read_back_and_used(
    found: SessionCalibration, right: EyeCalibration, photo_session: SmallSession
) -> None:
    out = photo_session.out
    station, state = load_station(out / "station-right.json"), found.bench.adjustment.state
    reading = found.session.see_through[1].stage
    assert reading is not None
    expected = state.base[0] @ state.stage.motion(reading)
    np.testing.assert_allclose(station.device_from_camera(reading), expected, atol=1e-12)
    np.testing.assert_allclose(
        present(station.device_from_tracking), present(found.session.device_from_tracking), atol=1e-9
    )
    pixel = np.array([[100.0, 90.0], [200.0, 160.0]])
    for lens, own in ((station.eyeball_camera, "eyeball"), (station.tracking_camera, "tracking")):
        np.testing.assert_array_equal(present(lens).dir_of_pixel(pixel), state.lens[own].dir_of_pixel(pixel))
    index = found.session.board.indices()
    nominal = found.session.board.point_of(index)
    true = state.shape["board"].point_of(index, nominal)
    np.testing.assert_allclose(present(station.shape).point_of(index, nominal), true, atol=1e-8)
    assert np.array_equal(
        present(load_captures(out / "captures-right.npz").display).pixel, present(right.captures.display).pixel
    )
    viewpoint, pixel = np.zeros(3), np.array([160.0, 90.0])
    again = load_eye_model(out / "model.json").mappings.display.view_dir_of_pixel(pixel, viewpoint)
    assert np.allclose(again.value, right.fit.mappings.display.view_dir_of_pixel(pixel, viewpoint).value, atol=1e-9)


def test_the_report_tells_everything_in_the_order_of_the_procedure(report: Report, photo_session: SmallSession) -> None:
    assert all(path.is_file() and path.stat().st_size > 0 for path in report.files)
    for name in ("coverage", "decoding"):
        assert (photo_session.out / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    titles = [table.title for table in report.tables]
    assert "Excluded" not in titles  # nothing was, and an empty table says nothing
    assert titles[0] == "Readings"
    sections = [block.title for block in report.blocks if isinstance(block, Section)]
    assert sections == ["Photographs", "The bench", "The models"]
    assert titles[titles.index("Lenses") : titles.index("Fit")] == [
        "Lenses",
        "Poses in the device frame",
        "Errors of stage, board and lens",
        "Reduced chi-squared",
        "Checks of the bench",
    ]
    assert [row[1:3] for row in report.tables[0].rows] == [[22, 22], [4, 4], [10, 10], [4, 4]]
    record = json.loads((photo_session.out / "report.json").read_text(encoding="utf-8"))
    assert record["eye"] == "right"
    assert "every check of the bench passed" in report.verdict
    assert report.faults == ()
    assert not any("state a smaller sigma" in warning for warning in report.warnings)  # nobody stated one
    assert "Errors by label" in titles
    assert not any("show errors by" in warning for warning in report.warnings)


def test_residuals_of_each_photograph_are_plotted(
    found: SessionCalibration, right: EyeCalibration, report: Report
) -> None:
    plots = {each.title: each for each in report.blocks if isinstance(each, Plot)}
    (bars,) = plots["Residual of the display, by camera position"].data
    assert bars["x"] == [f"display/0{number}" for number in range(4)]
    overall = present(right.fit.display).report.residual_arcmin.rms
    assert np.sqrt(np.mean(np.square(bars["y"]))) == pytest.approx(overall, rel=0.05)
    sigma = found.bench.camera_pose(found.session.display[0]).sigma_mm
    (poses,) = [each for each in report.tables if each.title == "Poses in the device frame"]
    assert [float(each) for each in str(poses.rows[0][2]).split(" / ")] == pytest.approx(list(sigma), rel=0.05)


@needs_browser
def test_the_page_draws_its_plots(report: Report, photo_session: SmallSession, tmp_path: Path) -> None:
    page = open_page(photo_session.out / "report.html", tmp_path)
    assert page.console == []
    assert page.plots == sum(isinstance(block, Plot) for block in report.blocks) == 6


# What is read again.


def test_a_second_run_reads_nothing_and_has_the_same_readings(
    found: SessionCalibration, photo_session: SmallSession
) -> None:
    again = photo_session.read()
    assert (found.reading.kept, again.kept) == (0, ALL)
    assert again.excluded == ()
    for path, board in found.reading.boards.items():
        assert np.array_equal(again.boards[photo_session.folder / found.session.name_of(path)].pixel, board.pixel)
    for path, panel in found.reading.panels.items():
        other = again.panels[photo_session.folder / found.session.name_of(path)]
        assert np.array_equal(other.samples.panel_pixel, panel.samples.panel_pixel)


def with_another_corner(photograph: NDArray[Any]) -> NDArray[Any]:
    """One pixel far from the board is another: the file is not the same, and what is read in it is."""
    changed = np.copy(photograph)
    changed[0, 0] ^= 1
    return changed


def test_a_photograph_that_changed_is_read_again_and_no_other(
    found: SessionCalibration, photo_session: SmallSession
) -> None:
    name = "see_through/pose0_02.png"
    photo_session.repaint(name, with_another_corner)
    again = photo_session.read()
    assert again.kept == ALL - 1
    one, other = found.reading.boards[found.session.folder / name], again.boards[photo_session.folder / name]
    np.testing.assert_array_equal(one.pixel, other.pixel)


def test_a_changed_session_file_is_read_by_what_it_says_now(photo_session: SmallSession) -> None:
    """What was kept was read as of this panel, board and camera; of others it would be wrong."""
    photo_session.edit(lambda content: content["code"].update(min_confidence=0.2))
    assert photo_session.read().kept == ALL - 4
    photo_session.edit(lambda content: content["eyeball_camera"].update(width_px=640, height_px=480))
    assert "is 400 x 320 pixels, but its camera has 640 x 480" in photo_session.refusal()


def test_kept_readings_that_are_damaged_are_made_again(photo_session: SmallSession) -> None:
    kept = next((photo_session.out / "read").glob("bare__pose0_01.png-*.npz"))
    content = kept.read_bytes()
    kept.unlink()
    kept.write_bytes(content[:100])
    assert photo_session.read().kept == ALL - 1
    assert kept.stat().st_size == pytest.approx(len(content), rel=0.05)


def test_two_processes_write_what_one_writes_byte_by_byte(
    photo_session: SmallSession, monkeypatch: pytest.MonkeyPatch
) -> None:
    """OpenCV's threads once added up the views of a lens in another order in each run.

    The truth lies beside the session for verification only: without it calibration finds the same.
    """
    for name in ("simulation.toml", "device.toml"):
        (photo_session.folder / name).unlink()
    written = [photo_session.out / name for name in ("model.json", "station-right.json", "captures-right.npz")]
    before = [path.read_bytes() for path in written]
    monkeypatch.undo()
    for name in ("bare__pose0_00.png", "display__02"):
        (kept,) = (photo_session.out / "read").glob(f"{name}-*.npz")
        kept.unlink()
    again = calibrated(replace(photo_session.options, workers=2))
    save_models(photo_session.out, [each.fit for each in again.eyes.values()])
    assert again.reading.kept == ALL - 2
    assert [path.read_bytes() for path in written] == before

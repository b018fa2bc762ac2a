"""A session of photographs, simulated and calibrated: what comes out beside the truth, and what is read again."""

import json
import os
from dataclasses import replace

import numpy as np
import pytest
from browser import needs_browser, open_page

from wlr_render.calibration.bench.bench_file import load_station
from wlr_render.calibration.poses import motion_between
from wlr_render.captures.capture_file import load_captures
from wlr_render.diagnosis.observations import DISPLAY, SEE_THROUGH
from wlr_render.diagnosis.prediction import Explanation, Predictor
from wlr_render.geometry.directions import arcmin_between
from wlr_render.jobs.calibrate.photos import calibrated, report_of
from wlr_render.models.model_file import load_eye_model
from wlr_render.optics.device_writer import save_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.report.blocks import Plot
from wlr_render.simulation.measurements import load_measurements
from wlr_render.toml_files import read_toml

pytestmark = pytest.mark.slow  # the session that all of them copy takes some twenty seconds to make

ALL = 10 + 4 + 10 + 2 * 6 + 4  # photographs of the board, and sets of the panel


@pytest.fixture
def found(calibrated_session):
    return calibrated_session[1]


@pytest.fixture
def bench(calibrated_session):
    return calibrated_session[0].bench


def sigmas_off(true, pose):
    """How far a pose is from the true one, all six numbers together."""
    motion = motion_between(true, pose.b_from_a)
    return float(np.sqrt(motion @ np.linalg.solve(pose.covariance, motion)))


def test_the_station_lies_where_it_is_within_what_it_says_of_itself(found, bench):
    station = found.station
    reference = station.stage.reference
    assert sigmas_off(bench.camera_at(reference), station.pose_at(reference)) < 5
    for number, true in enumerate(bench.device_from_target):
        assert sigmas_off(true, station.device_from_target[number]) < 5
    assert all(check.ok for check in station.checks)
    assert station.unchecked == ()


def test_lenses_are_found_within_their_sigmas(found, bench):
    for lens, true in ((found.eyeball, bench.eyeball), (found.tracking, bench.tracking)):
        sigma = lens.calibration.sigma
        pairs = ((lens.camera.focal_px, true.camera.focal_px), (lens.camera.centre_px, true.camera.centre_px))
        off = np.concatenate([ours - theirs for ours, theirs in pairs])
        assert np.all(np.abs(off) < 5 * sigma[:4])


def camera_error_arcmin(station):
    """What the uncertainty of the camera's rotation does to every direction of a session alike."""
    return float(np.linalg.norm(station.pose_at(station.stage.reference).sigma_arcmin))


def test_captures_agree_with_the_devices_exact_mappings(found, bench):
    truth = traced_eye(bench.device, "right")
    allowed = 4 * camera_error_arcmin(found.station)
    assert allowed < 2
    display, see_through = found.captures.display, found.captures.see_through
    seen = truth.display.view_dir_of_pixel(display.pixel, display.viewpoint)
    assert seen.usable.all()
    assert np.median(arcmin_between(seen.value, display.view_dir)) < allowed
    seen = truth.see_through.view_dir_of_real_point(see_through.point, see_through.viewpoint)
    assert seen.usable.all()
    assert np.median(arcmin_between(seen.value, see_through.view_dir)) < allowed


def test_a_photographic_session_can_be_diagnosed(found, bench, photo_session, tmp_path):
    device = save_device(bench.device, tmp_path / "device.toml")
    nominal, session = load_measurements(photo_session.out, device=device)
    conditions = load_captures(photo_session.out / "captures-right.npz").see_through.conditions
    stage = np.array([each.stage for each in found.session.see_through])
    np.testing.assert_array_equal(conditions.stage, stage[conditions.visit])
    predictor = Predictor.of_session(nominal, session)
    observations, residual = predictor.observations, predictor.residual(Explanation())
    assert np.mean(observations.part == SEE_THROUGH) > 0.1
    for part in (DISPLAY, SEE_THROUGH):
        arcmin = np.linalg.norm(observations.arcminutes(residual, part), axis=1)
        assert np.median(arcmin) < 4 * camera_error_arcmin(found.station)


def test_a_flat_image_is_fitted_to_the_noise(found):
    fit = found.fit
    # The camera's pixel is nearly 6 arcminutes; a tenth of it is what averages over a window of pixels can leave.
    pixel = arcmin_between(*found.eyeball.camera.dir_of_pixel(np.array([[200.0, 160.0], [201.0, 160.0]])))
    for report in (fit.display.report, fit.see_through.report):
        assert report.residual_arcmin.rms < 0.1 * pixel
        # Four camera positions leave the model less sure beside them than at them.
        assert report.predicted_arcmin < 0.2 * pixel


def test_what_is_written_can_be_read_back_and_used(found, photo_session):
    out = photo_session.out
    station = load_station(out / "station-right.json")
    reading = found.session.see_through[1].stage
    assert np.allclose(station.device_from_camera(reading), found.station.device_from_camera(reading), atol=1e-12)
    assert np.array_equal(load_captures(out / "captures-right.npz").display.pixel, found.captures.display.pixel)
    viewpoint, pixel = np.zeros(3), np.array([160.0, 90.0])
    again = load_eye_model(out / "model.json").mappings.display.view_dir_of_pixel(pixel, viewpoint)
    assert np.allclose(again.value, found.fit.mappings.display.view_dir_of_pixel(pixel, viewpoint).value, atol=1e-9)


def test_the_report_tells_everything_in_the_order_of_the_procedure(found, photo_session):
    report = report_of(found, photo_session.options)
    assert all(path.is_file() and path.stat().st_size > 0 for path in report.files)
    for name in ("coverage", "decoding"):
        assert (photo_session.out / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    titles = [table.title for table in report.tables]
    assert "Excluded" not in titles  # nothing was, and an empty table says nothing
    assert titles[0] == "What was read"
    assert [row[1:3] for row in report.tables[0].rows] == [[10, 10], [4, 4], [10, 10], [4, 4]]
    record = json.loads((photo_session.out / "report.json").read_text(encoding="utf-8"))
    assert record["eye"] == "right"
    assert "every check of the station passed" in report.verdict
    assert report.faults == ()


def test_residuals_of_each_photograph_are_plotted(found, photo_session):
    plots = {each.title: each for each in report_of(found, photo_session.options).blocks if isinstance(each, Plot)}
    (bars,) = plots["Residual of the display, by camera position"].data
    assert bars["x"] == [f"display/0{number}" for number in range(4)]
    overall = found.fit.display.report.residual_arcmin.rms
    assert np.sqrt(np.mean(np.square(bars["y"]))) == pytest.approx(overall, rel=0.05)
    sigma = found.station.pose_at(found.station.stage.reference).sigma_mm
    plotted = [trace["y"][0] for trace in plots["Uncertainty of positions"].data]
    assert plotted == pytest.approx(list(sigma), rel=1e-3)


@needs_browser
def test_the_page_draws_its_plots(found, photo_session, tmp_path):
    report = report_of(found, photo_session.options)
    page = open_page(photo_session.out / "report.html", tmp_path)
    assert page.console == []
    assert page.plots == sum(isinstance(block, Plot) for block in report.blocks) == 8


# What is read again.


def test_a_second_run_reads_nothing_and_finds_the_same(found, photo_session):
    again = photo_session.calibrate()
    assert (found.reading.kept, again.reading.kept) == (0, ALL)
    assert again.reading.excluded == ()
    assert np.allclose(again.captures.display.view_dir, found.captures.display.view_dir, rtol=0, atol=1e-9)
    assert np.array_equal(again.captures.display.pixel, found.captures.display.pixel)


def test_a_photograph_that_changed_is_read_again_and_no_other(found, photo_session):
    photo_session.repaint("see_through/pose0_02.png", np.copy)
    again = photo_session.calibrate()
    assert again.reading.kept == ALL - 1
    one, other = (each.fit.see_through.report.residual_arcmin.rms for each in (found, again))
    assert one == pytest.approx(other, rel=1e-6)


def test_a_changed_session_file_is_read_by_what_it_says_now(photo_session):
    """What was kept was read as of this panel, board and camera; of others it would be wrong."""
    photo_session.edit(lambda content: content["code"].update(min_confidence=0.2))
    assert photo_session.calibrate().reading.kept == ALL - 4
    photo_session.edit(lambda content: content["eyeball_camera"].update(width_px=640, height_px=480))
    assert "is 400 x 320 pixels, but its camera has 640 x 480" in photo_session.refusal()


def test_kept_readings_that_are_damaged_are_made_again(photo_session):
    kept = photo_session.out / "read" / "bare__pose0_01.png.npz"
    content = kept.read_bytes()
    kept.unlink()
    kept.write_bytes(content[:100])
    assert photo_session.calibrate().reading.kept == ALL - 1
    assert kept.stat().st_size == pytest.approx(len(content), rel=0.05)


def test_processes_find_what_one_finds(photo_session, monkeypatch, found):
    monkeypatch.undo()
    for name in ("bare__pose0_00.png", "display__02"):
        os.remove(photo_session.out / "read" / f"{name}.npz")
    again = calibrated(replace(photo_session.options, workers=1))
    assert again.reading.kept == ALL - 2
    assert again.fit.display.report.residual_arcmin.rms == pytest.approx(
        found.fit.display.report.residual_arcmin.rms, rel=1e-6
    )


def test_calibration_knows_nothing_of_how_photographs_were_made(photo_session, found):
    """The truth lies beside the session for verification only."""
    (photo_session.folder / "simulation.toml").unlink()
    (photo_session.folder / "device.toml").unlink()
    again = photo_session.calibrate()
    assert again.fit.display.report.residual_arcmin.rms == pytest.approx(
        found.fit.display.report.residual_arcmin.rms, rel=1e-6
    )
    assert read_toml(photo_session.folder / "session.toml").keys()[:4] == ["format", "version", "unit", "frame"]

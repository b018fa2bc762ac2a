import json
from dataclasses import replace

import numpy as np
import pytest

from wlr_render.calibration.fit_eye import fit_eye
from wlr_render.captures.capture_file import load_captures, save_captures
from wlr_render.captures.correspondences import EyeCaptures
from wlr_render.captures.session import DisplayPlan, SeeThroughPlan, Session, SessionPlan
from wlr_render.errors import BadInputError
from wlr_render.evaluation import mapping_error
from wlr_render.geometry.transforms import rigid
from wlr_render.jobs.calibrate.captures import (
    FitOptions,
    SimulationOptions,
    calibrate_from_captures,
    calibrate_simulated,
    simulate,
)
from wlr_render.mappings import FieldOfView
from wlr_render.models.model_file import load_eye_model
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.simulation.bench import Bench, EyeballCamera, Stage, Target
from wlr_render.simulation.bench_file import save_bench
from wlr_render.simulation.session_folder import save_session
from wlr_render.simulation.simulate_session import simulate as read_off


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory):
    folder = tmp_path_factory.mktemp("calibration")
    simulation = SimulationOptions(viewpoints=12, camera_noise_arcmin=0.1, seed=4)
    return folder, calibrate_simulated("birdbath28", folder, simulation=simulation, fit=FitOptions("planar", 3, 2))


def truth_errors(calibration):
    return {row[0]: row[1] for row in calibration.tables[-1].rows}


@pytest.mark.parametrize("kind", ["planar", "volumetric"])
def test_noise_free_captures_of_an_image_that_the_model_can_hold_are_recovered(flat_image_headset, kind):
    captures = simulate(flat_image_headset, kind, SimulationOptions(viewpoints=12))
    fitted = fit_eye(captures, kind, 2, 2).mappings
    rng = np.random.default_rng(8)
    viewpoint = flat_image_headset.eye_box.at(rng.uniform(-1, 1, (20, 1, 3)))
    pixel = rng.uniform(0, 1, (20, 5, 2)) * [140, 100]
    seen = mapping_error.sightings_of_pixels(flat_image_headset.display, viewpoint, pixel)
    world = mapping_error.see_through_sightings(
        flat_image_headset.see_through, seen.viewpoint, seen.view_dir, rng.uniform(0.3, 5.0, 100)
    )
    if kind == "planar":
        # A flat image parallel to the plane, and a plate, are of degree 1 on it: the bundle holds them exactly.
        assert mapping_error.display_error(fitted.display, seen).forward_arcmin.max() < 1e-6
        assert mapping_error.see_through_error(fitted.see_through, world).backward_arcmin.max() < 1e-6
    else:
        assert mapping_error.display_error(fitted.display, seen).forward_arcmin.max() < 0.05
        assert mapping_error.see_through_error(fitted.see_through, world).backward_arcmin.max() < 0.05


def test_written_files_are_read_back(calibrated):
    folder, result = calibrated
    assert [path.name for path in result.files] == ["captures.npz", "model.json", "fit.md", "fit.json"]
    model = load_eye_model(folder / "model.json")
    assert (model.device, model.mappings.eye) == ("birdbath28", "right")
    viewpoint, pixel = model.mappings.eye_box.centre, np.array([900.0, 500.0])
    np.testing.assert_array_equal(
        model.mappings.display.view_dir_of_pixel(pixel, viewpoint).value,
        result.fit.mappings.display.view_dir_of_pixel(pixel, viewpoint).value,
    )
    captures = load_captures(folder / "captures.npz")
    assert len(np.unique(captures.display.capture)) == 12
    record = json.loads((folder / "fit.json").read_text())
    assert record["simulation"] == {"viewpoints": 12, "camera_noise_arcmin": 0.1, "stage_error_mm": 0.0, "seed": 4}
    assert "Against the traced truth" in (folder / "fit.md").read_text()


def test_a_calibrated_eye_is_near_the_truth(calibrated):
    errors = truth_errors(calibrated[1])
    assert 0.01 < errors["direction of a pixel (arcmin)"] < 0.5
    assert 0.005 < errors["direction of a real point (arcmin)"] < 0.3


def test_stage_error_spoils_the_calibration_by_its_pupil_swim(calibrated, tmp_path):
    simulation = SimulationOptions(viewpoints=12, stage_error_mm=0.3, seed=4)
    spoiled = calibrate_simulated("birdbath28", tmp_path, simulation=simulation, fit=FitOptions("planar", 3, 2))
    # 0.3 mm per axis at 6.3 arcmin per mm, somewhat averaged by the fit.
    assert 0.5 < truth_errors(spoiled)["direction of a pixel (arcmin)"] < 4.0


def test_captures_fit_to_the_model_that_they_were_simulated_for(calibrated, tmp_path):
    folder, result = calibrated
    again = calibrate_from_captures(folder / "captures.npz", tmp_path, FitOptions("planar", 3, 2))
    assert [path.name for path in again.files] == ["model.json", "fit.md", "fit.json"]
    assert again.fit.display == result.fit.display
    assert (tmp_path / "model.json").read_text() == (folder / "model.json").read_text()


def test_degrees_are_chosen_by_held_out_positions(calibrated, tmp_path):
    folder, _ = calibrated
    chosen = calibrate_from_captures(folder / "captures.npz", tmp_path, FitOptions("static", None, None))
    held_out = chosen.tables[1]
    for mapping in ("display", "see-through"):
        assert [row[-1] for row in held_out.rows if row[0] == mapping].count("chosen") == 1


def test_too_few_viewpoints_say_how_many_are_missing(tmp_path):
    with pytest.raises(BadInputError, match="at least 21 viewpoints"):
        calibrate_simulated("birdbath28", tmp_path, simulation=SimulationOptions(viewpoints=12))


def test_captures_of_the_display_alone_are_refused(calibrated, tmp_path):
    folder, _ = calibrated
    alone = EyeCaptures(load_captures(folder / "captures.npz").display)
    with pytest.raises(BadInputError, match="no see-through part"):
        calibrate_from_captures(save_captures(tmp_path / "alone.npz", alone), tmp_path)


@pytest.fixture(scope="module")
def night(tmp_path_factory):
    """Folder of a session of northstar whose stage went further than it said, and file of the bench as it was."""
    folder = tmp_path_factory.mktemp("night")
    camera = EyeballCamera(np.array([1280.0, 1024.0]), np.array([1350.0, 1350.0]), np.array([640.5, 512.5]), 0.1)
    poses = rigid(np.eye(3), np.array([[0.03, 0.0, -0.6], [0.03, 0.0, -1.1]]))
    device = load_device("northstar")
    centre = device.eyes["right"].eye_box.centre
    believed = Bench(device, "right", camera, Stage(centre), Target(poses, np.full(2, 0.02)))
    true = replace(believed, stage=Stage(centre, 1.1 * np.eye(3)))
    rng = np.random.default_rng(2)
    count, each = 16, 60
    capture = np.repeat(np.arange(count), each)
    stage = (centre + rng.uniform(-0.004, 0.004, (count, 3)) * [1, 1, 0])[capture]
    time_s, travel, pixel = (
        40.0 * capture,
        np.ones(count * each),
        rng.uniform([450, 350], [850, 650], (count * each, 2)),
    )
    display = DisplayPlan(capture, time_s, travel, stage, np.ones_like(capture), pixel)
    dot = rng.uniform(-0.15, 0.15, (count * each, 2))
    plan = SessionPlan(display, SeeThroughPlan(capture, time_s, travel, stage, capture % 2, dot))
    save_session(folder / "session", believed, Session("night", plan, read_off(true, plan)))
    return folder / "session", save_bench(true, folder / "true.toml")


def display_error(model):
    """Of a model against northstar as it is, rms in arcminutes, well inside the fit."""
    truth = traced_eye(load_device("northstar"))
    viewpoint = truth.eye_box.at(np.random.default_rng(3).uniform(-0.4, 0.4, (20, 1, 3)) * [1, 1, 0])
    middle = FieldOfView(np.full(2, -0.08), np.full(2, 0.08)).directions(5, 5)
    seen = mapping_error.sightings_of_dirs(truth.display, viewpoint, middle)
    return np.sqrt(np.mean(mapping_error.display_error(model.display, seen).forward_arcmin ** 2))


def test_a_session_is_calibrated_by_the_bench_that_is_believed(night, tmp_path):
    session, bench = night
    options = FitOptions("planar", 4, 2)
    believed = calibrate_from_captures(session, tmp_path / "believed", options)
    extended = calibrate_from_captures(session, tmp_path / "extended", options, bench)
    assert [path.name for path in extended.files] == ["model.json", "fit.md", "fit.json"]
    before, after = (display_error(load_eye_model(each.files[0]).mappings) for each in (believed, extended))
    assert after < 0.3 * before
    # The fit itself cannot tell: whoever believes the stage finds its captures in good order.
    assert believed.fit.display.residual_arcmin.rms < 1.1 * extended.fit.display.residual_arcmin.rms


def test_a_bench_of_another_headset_is_refused(night, tmp_path):
    session, bench = night
    other = tmp_path / "other.toml"
    other.write_text(bench.read_text().replace('"northstar"', '"freeform40"'))
    with pytest.raises(BadInputError, match=r"other.toml: is a bench of freeform40 \(right eye\), the session"):
        calibrate_from_captures(session, tmp_path, bench=other)


def test_a_bench_without_the_sessions_target_poses_is_refused(night, tmp_path):
    session, bench = night
    other = tmp_path / "other.toml"
    other.write_text(bench.read_text().rsplit("[[target_pose]]", 1)[0])
    with pytest.raises(BadInputError, match="names target_pose 1, but its bench has 1"):
        calibrate_from_captures(session, tmp_path, bench=other)


def test_a_bench_beside_a_capture_file_is_refused(calibrated, night, tmp_path):
    folder, _ = calibrated
    with pytest.raises(BadInputError, match=r"captures\.npz: is no session's folder"):
        calibrate_from_captures(folder / "captures.npz", tmp_path, bench=night[1])

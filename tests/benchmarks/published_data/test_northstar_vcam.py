"""A session drawn here in the foreign format: a rig of known poses before a monitor and before points in space."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from present import present

from benchmarks.__main__ import main
from benchmarks.published_data.northstar_vcam import PANEL, read_northstar_vcam
from wlr_render.captures.capture_file import load_captures
from wlr_render.geometry.directions import ARCMIN, arcmin_between, normalised
from wlr_render.numerics.arrays import FloatArray

SIZE_PX = 200
FOCAL_PX = 150.0
CENTRE_PX = 99.5  # from the middle of the first pixel
MONITOR_M = np.array([0.6, 0.4])
BASELINE_M, LIFT_M = 0.06, 0.02
# In the monitor's frame with y up and z towards the rig, from the monitor's middle.
EYE_X_M = {"left": -BASELINE_M / 2, "right": BASELINE_M / 2}
HEIGHT_M = {"D": 0.0, "U": LIFT_M}
RIG_DISTANCE_M = 0.35
IMAGE_DISTANCE_M = 0.5
IMAGE_M = np.array([0.4, 0.36])


def camera_dirs() -> FloatArray:
    """(rows, columns, 3) directions of all pixels, x right, y up, looking along -z."""
    u, v = np.meshgrid(np.arange(SIZE_PX), np.arange(SIZE_PX))
    return np.stack([(u - CENTRE_PX) / FOCAL_PX, -(v - CENTRE_PX) / FOCAL_PX, -np.ones(u.shape)], axis=-1)


def seen_fraction(
    viewpoint: FloatArray, centre: FloatArray, size_m: FloatArray, distance_m: float, v_runs_up: bool
) -> FloatArray:
    """Where each pixel of a camera looks on a flat screen `distance_m` in front; 0 where it misses it."""
    hit = viewpoint[:2] + camera_dirs()[..., :2] * distance_m
    fraction = (hit - centre) / size_m + 0.5
    if not v_runs_up:
        fraction[..., 1] = 1 - fraction[..., 1]
    inside = ((fraction > 0.01) & (fraction < 0.99)).all(axis=-1, keepdims=True)
    return np.where(inside, fraction, 0.0)


def write_session(folder: Path) -> Path:
    folder.mkdir()
    for height, y in HEIGHT_M.items():
        for kind in "MC":
            views = []
            for x in EYE_X_M.values():
                viewpoint = np.array([x, y])
                if kind == "M":
                    views.append(seen_fraction(viewpoint, np.zeros(2), MONITOR_M, RIG_DISTANCE_M, v_runs_up=True))
                else:
                    views.append(
                        seen_fraction(viewpoint, np.array([x, 0.0]), IMAGE_M, IMAGE_DISTANCE_M, v_runs_up=False)
                    )
            both = np.round(np.concatenate(views, axis=1) * 65535).astype(np.uint16)
            for axis, name in enumerate(("Width", "Height")):
                Image.fromarray(np.ascontiguousarray(both[..., axis])).save(
                    folder / f"{kind}{height}_{name}Calibration.png"
                )
    matrix = [FOCAL_PX, 0, CENTRE_PX, 0, FOCAL_PX, CENTRE_PX, 0, 0, 1]
    device = {"cameras": [{"cameraMatrix": matrix}] * 2, "baseline": BASELINE_M}
    calibration = {"deviceCalibrations": [device]}
    (folder / "cameraCalibration.json").write_text(json.dumps(calibration))
    area = {"CalibrationMonitorActiveAreaMeters": {"x": MONITOR_M[0], "y": MONITOR_M[1]}}
    (folder / "config.json").write_text(json.dumps(area))
    return folder


@pytest.fixture
def session(tmp_path: Path) -> Path:
    return write_session(tmp_path / "session")


def test_viewpoints_and_directions_are_those_of_the_rig(session: Path) -> None:
    found = read_northstar_vcam(session)
    for fit in found.monitor:
        assert fit.median_px < 0.02
        assert fit.height_scale == pytest.approx(1.0, abs=1e-4)
    for captures in (found.left, found.right):
        x = EYE_X_M[captures.eye]
        expected = np.array([[x, 0.0, 0.0], [x, LIFT_M, 0.0]])[captures.capture]
        np.testing.assert_allclose(captures.viewpoint, expected, atol=2e-5)
        on_image = (captures.pixel / PANEL.size_px - 0.5) * IMAGE_M * [1, -1] + [x, 0.0]
        point = np.column_stack([on_image, np.full(len(captures), -IMAGE_DISTANCE_M)])
        assert arcmin_between(normalised(point - expected), captures.view_dir).max() < 0.3
        # One step of 1/256 of the picture, rounded: a standard deviation of step / sqrt(12) on each axis.
        step = IMAGE_M / 256 / IMAGE_DISTANCE_M / ARCMIN
        assert captures.sigma_arcmin[0] == pytest.approx(np.sqrt(np.mean(step**2) / 12), rel=0.01)


def test_the_stated_baseline_is_checked_by_the_monitor(
    session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = read_northstar_vcam(session)
    np.testing.assert_allclose(found.baseline_m, BASELINE_M, atol=2e-5)
    assert found.stated_baseline_m == BASELINE_M
    assert main(["published-data", "northstar-vcam", str(session), "--out", str(tmp_path / "out")]) == 0
    assert "the rig states 60.00 mm (" in capsys.readouterr().out
    assert present(load_captures(tmp_path / "out" / "captures-left.npz").display).eye == "left"
    area = {"CalibrationMonitorActiveAreaMeters": {"x": 0.98 * MONITOR_M[0], "y": 0.98 * MONITOR_M[1]}}
    (session / "config.json").write_text(json.dumps(area))
    assert main(["published-data", "northstar-vcam", str(session), "--out", str(tmp_path / "out")]) == 0
    assert "The cameras' distance differs by -2.0" in capsys.readouterr().out

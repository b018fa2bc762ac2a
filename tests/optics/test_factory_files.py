"""Factory calibrations against the formulas that their readers publish, written out again here pixel by pixel."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from monado_vive import monados_directions

from wlr_render.errors import BadInputError
from wlr_render.exports.monado import Monado
from wlr_render.geometry.directions import arcmin_between, dir_of_tangents, normalised
from wlr_render.geometry.transforms import rotation_about
from wlr_render.jobs.budget import budget
from wlr_render.jobs.budget_options import BudgetOptions
from wlr_render.jobs.export import views_from_centres
from wlr_render.jobs.export_options import ExportOptions
from wlr_render.jobs.headset import is_model, open_colours, open_eye
from wlr_render.mappings import Status
from wlr_render.numerics.arrays import FloatArray

Content = dict[str, Any]


def steamvr() -> Content:
    """A headset with round lenses of less power for blue, as Vive and Index have them; eyes turned by 5 degrees."""

    def radial(change: float, centre: float) -> Content:
        coeffs = [-0.2 + change, 0.03, -0.01 - change, 0.02]
        return {"type": "DISTORT_DPOLY3_SCALED", "coeffs": coeffs, "center_x": centre, "center_y": 0.011}

    def eye(side: float) -> Content:
        return {
            "intrinsics": [[1.25, 0.0, 0.06 * side], [0.0, 1.12, 0.013], [0.0, 0.0, -1.0]],
            "eye_to_head": rotation_about("y", np.deg2rad(-5.0 * side)).tolist(),
            "distortion": radial(0.0, 0.07 * side),
            "distortion_red": radial(0.01, 0.071 * side),
            "distortion_blue": radial(-0.02, 0.069 * side),
            "grow_for_undistort": 0.4,
            "undistort_r2_cutoff": 1.1,
        }

    device = {"eye_target_width_in_pixels": 1080, "eye_target_height_in_pixels": 1200, "physical_aspect_x_over_y": 0.9}
    return {"device": device, "lens_separation": 0.063, "tracking_to_eye_transform": [eye(-1.0), eye(1.0)]}


def wmr() -> Content:
    """A headset whose eyes are halves of one picture, seen by a tracking camera that looks 20 degrees down."""

    def display(name: str, left_px: float, x_m: float) -> Content:
        def radial(change: float) -> Content:
            values = [left_px + 717.0 + change, 719.0 - change, (4.7 + change) * 1e-7, 1.0e-13, 1.25e-18]
            return {"ModelType": "CALIBRATION_DisplayDistortionModelPolynomial3K", "ModelParameters": values}

        turn = rotation_about("x", np.deg2rad(-20.0)) @ rotation_about("y", np.deg2rad(0.4 * np.sign(x_m)))
        place = np.array([x_m, 0.02, -0.05])
        return {
            "AssignedEye": f"CALIBRATION_DisplayEye{name}",
            "Affine": [886.0, 0.03, left_px + 717.2, 0.0, 896.0, 718.4, 0.0, 0.0, 1.0],
            "DisplayWidth": 2880,
            "DisplayHeight": 1440,
            "Rt": {"Rotation": turn.T.ravel().tolist(), "Translation": (-turn.T @ place).tolist()},
            **{
                f"Distortion{colour}": radial(change)
                for colour, change in (("Red", -1.0), ("Green", 0.0), ("Blue", 1.5))
            },
        }

    return {"CalibrationInformation": {"Displays": [display("Left", 0, -0.02), display("Right", 1440, 0.044)]}}


def xreal(is_distorted: bool = True) -> Content:
    """Glasses whose eyes are turned to each other by 74' and whose pixels are 1.1 % flatter than wide."""
    display: Content = {"resolution": [1920.0, 1080.0], "num_of_displays": 2, "target_type": "IMU"}
    grid: Content = {}
    for side, cx, half_turn, x_m in (("left", 965.0, 0.01076, -0.0592), ("right", 950.0, -0.01076, 0.0044)):
        display[f"k_{side}_display"] = [2705.0, 0.0, cx, 0.0, 2675.0, 571.0, 0.0, 0.0, 1.0]
        display[f"target_p_{side}_display"] = [x_m, 0.0187, -0.0193]
        display[f"target_q_{side}_display"] = [0.0, np.sin(half_turn / 2), 0.0, np.cos(half_turn / 2)]
        u, v = np.meshgrid(np.linspace(0, 1920, 61), np.linspace(0, 1080, 35))
        data = np.stack([u, v, *np.moveaxis(undistorted(np.stack([u, v], axis=-1)), -1, 0)], axis=-1)
        grid[f"{side}_display"] = {"type": 1, "num_col": 61, "num_row": 35, "data": data.ravel().tolist()}
    return {"FSN": "X", "display": display} | ({"display_distortion": grid} if is_distorted else {})


def undistorted(pixel: FloatArray) -> FloatArray:
    """A smooth distortion of some ten pixels that is neither round nor even."""
    x, y = np.moveaxis((pixel - [960.0, 540.0]) / 960.0, -1, 0)
    return pixel + 12.0 * np.stack([x * (x**2 + y**2) + 0.3 * y**2, y * (x**2 + y**2) - 0.2 * x * y], axis=-1)


def written(content: Content, folder: Path) -> Path:
    path = folder / "unit.json"
    path.write_text(json.dumps(content))
    return path


def device_dir(down_tangents: FloatArray, turn: FloatArray) -> FloatArray:
    """Directions in the device of tangents to the right and down, in a display turned by `turn` (OpenXR's axes)."""
    return np.asarray(dir_of_tangents(down_tangents * [1, -1]) @ turn.T)


def steamvr_dir(pixel: FloatArray, side: str, colour: int) -> FloatArray:
    """Monado's formula of Vive and Index."""
    return monados_directions(steamvr(), ("left", "right").index(side), colour, pixel)


def wmr_dir(pixel: FloatArray, side: str, colour: int) -> FloatArray:
    """Monado's `compute_distortion_wmr`."""
    view = ("left", "right").index(side)
    display = wmr()["CalibrationInformation"]["Displays"][view]
    cx, cy, k1, k2, k3 = display[f"Distortion{('Red', 'Green', 'Blue')[colour]}"]["ModelParameters"]
    x, y = (pixel[..., 0] / 1440 + view) * 1440 - cx, pixel[..., 1] - cy
    r2 = x * x + y * y
    d = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    place = np.stack([x * d + cx, y * d + cy, np.ones_like(x)], axis=-1)
    vp = place @ np.linalg.inv(np.array(display["Affine"]).reshape(3, 3)).T
    turn = rotation_about("y", np.deg2rad(-0.4 if side == "right" else 0.4))  # as seen in OpenXR's axes
    return device_dir(vp[..., :2] / vp[..., 2:], turn)


def xreal_dir(pixel: FloatArray, side: str, colour: int) -> FloatArray:
    """The pinhole of the undistorted picture."""
    place = undistorted(pixel)
    tangents = np.stack([(place[..., 0] - (965 if side == "left" else 950)) / 2705, (place[..., 1] - 571) / 2675], -1)
    return device_dir(tangents, rotation_about("y", -0.01076 if side == "left" else 0.01076))


FORMATS: dict[str, tuple[Callable[[], Content], Callable[[FloatArray, str, int], FloatArray], float, float]] = {
    "steamvr": (steamvr, steamvr_dir, 1e-8, 0.063),
    "wmr": (wmr, wmr_dir, 1e-8, 0.064),
    "xreal": (xreal, xreal_dir, 2e-3, 0.0636),
}
"""Content of a file, its published formula, arcminutes of interpolation, distance of the eyes."""


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("name", FORMATS)
def test_directions_of_pixels_are_those_of_the_published_formula(name: str, side: str, tmp_path: Path) -> None:
    content, formula, tolerance, apart = FORMATS[name]
    path = written(content(), tmp_path)
    pixel = np.random.default_rng(3).uniform(0.1, 0.9, (40, 2))
    for colour, eye in enumerate(open_colours(path, side)):
        at = pixel * eye.display.panel.size_px
        shown = eye.display.view_dir_of_pixel(at, eye.eye_box.centre)
        assert shown.ok.all()
        assert arcmin_between(shown.value, formula(at, side, colour)).max() < tolerance
        back = eye.display.pixel_of_view_dir(shown.value, eye.eye_box.centre)
        np.testing.assert_allclose(back.value, at, atol=1e-6)
        assert np.abs(eye.eye_box.centre) == pytest.approx([apart / 2, 0, 0], abs=1e-4)
        assert np.sign(eye.eye_box.centre[0]) == (1 if side == "right" else -1)
    assert open_eye(path, side).name == "unit (factory calibration)"
    assert not is_model(path)


def test_the_image_is_flat_and_two_metres_away(tmp_path: Path) -> None:
    eye = open_eye(written(xreal(False), tmp_path), "right")
    pixel = np.array([[100.0, 900.0], [1800.0, 30.0]])
    centre, moved = eye.eye_box.centre, eye.eye_box.centre + [1e-3, -2e-3, 1e-3]
    first, second = (eye.display.view_dir_of_pixel(pixel, viewpoint).value for viewpoint in (centre, moved))
    # Both rays of a pixel meet on a plane at a distance of 2 m along the display's axis, which is turned by 37'.
    axis = np.array([-np.sin(0.01076), 0.0, -np.cos(0.01076)])
    at = [p + d * (2.0 - (p - centre) @ axis) / (d @ axis)[:, None] for p, d in ((centre, first), (moved, second))]
    np.testing.assert_allclose(at[0], at[1], atol=1e-12)
    back = eye.display.pixel_of_view_dir(second, moved)
    np.testing.assert_allclose(back.value, pixel, atol=1e-7)
    point = np.array([0.1, 0.2, -1.0])
    straight = eye.see_through.view_dir_of_real_point(point, moved).value
    np.testing.assert_allclose(straight, normalised(point - moved), atol=1e-12)


def test_what_lies_beside_the_panel_or_behind_is_said(tmp_path: Path) -> None:
    eye = open_eye(written(steamvr(), tmp_path), "left")
    centre = eye.eye_box.centre
    assert eye.display.view_dir_of_pixel(np.array([-3.0, 100.0]), centre).status == Status.CLIPPED
    ahead, beside, behind = np.array([[0.0, 0, -1], [-0.95, 0.1, -0.2], [0, 0, 1]])
    for direction, status in ((ahead, Status.OK), (normalised(beside), Status.CLIPPED), (behind, Status.MISS)):
        assert eye.display.pixel_of_view_dir(direction, centre).status == status


@pytest.mark.slow
def test_monados_grid_is_read_as_it_was_written(tmp_path: Path) -> None:
    """A cubic spline through the 65 x 65 points is closer to the optics than Monado's straight lines (0.47')."""
    views = views_from_centres(ExportOptions("northstar", format="monado", eye="both", depth_m=2.0))
    (path,) = Monado().write(views.values(), tmp_path)
    pixel = np.random.default_rng(4).uniform(0.02, 0.98, (60, 2)) * [1440, 1600]
    for side, view in views.items():
        eye = open_eye(path, side)
        exact = view.tangents(np.moveaxis(view.rays_at("all", pixel), -1, 0))
        found = eye.display.view_dir_of_pixel(pixel, eye.eye_box.centre).value
        assert arcmin_between(found, dir_of_tangents(exact)).max() < 0.01


def test_a_budget_says_that_it_lacks_the_errors_of_the_calibration(tmp_path: Path) -> None:
    report = budget(BudgetOptions(str(written(xreal(False), tmp_path)), out=tmp_path / "out"))
    assert "factory calibration: its own errors are unknown" in report.warnings[0]


def without(content: Content, *keys: Any) -> Content:
    inner = content
    for key in keys[:-1]:
        inner = inner[key]
    del inner[keys[-1]]
    return content


def put(content: Content, value: Any, *keys: Any) -> Content:
    inner = content
    for key in keys[:-1]:
        inner = inner[key]
    inner[keys[-1]] = value
    return content


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (without(steamvr(), "lens_separation"), "key 'ipd' is missing"),
        (
            put(steamvr(), "DISTORT_FISHEYE", "tracking_to_eye_transform", 1, "distortion", "type"),
            "must be one of DISTORT",
        ),
        (put(steamvr(), [[0.0] * 3] * 3, "tracking_to_eye_transform", 1, "intrinsics"), "focal lengths 0 and 0"),
        (put(steamvr(), [[1.0] * 3] * 3, "tracking_to_eye_transform", 1, "eye_to_head"), "not a rotation matrix"),
        (put(steamvr(), 63.0, "lens_separation"), "63000 mm apart"),
        (put(steamvr(), 1e-12, "device", "physical_aspect_x_over_y"), "must be 0.1 or more, and at most 10"),
        (
            put(steamvr(), [1e6, 0.0, 0.0], "tracking_to_eye_transform", 1, "distortion_red", "coeffs"),
            "has directions of the right display that fold over or are mirrored",
        ),
        (put(wmr(), [], "CalibrationInformation", "Displays"), "'Displays' is empty"),
        (
            put(wmr(), "CALIBRATION_DisplayEyeLeft", "CalibrationInformation", "Displays", 1, "AssignedEye"),
            "is a second display of the left eye",
        ),
        (put(wmr(), [0.0] * 9, "CalibrationInformation", "Displays", 0, "Affine"), "'Affine' has no inverse"),
        (put(wmr(), [1.0], "CalibrationInformation", "Displays", 0, "DistortionRed", "ModelParameters"), "5 numbers"),
        (put(xreal(), [0.0] * 4, "display", "target_q_left_display"), "unit quaternion"),
        (put(xreal(), -2705.0, "display", "k_right_display", 0), "focal lengths -2705 and 2675; they must be positive"),
        (put(xreal(), [0.0, 1.0, 0.0, 0.0], "display", "target_q_right_display"), "179 degrees from straight ahead"),
        (put(xreal(), 90000.0, "display", "k_right_display", 2), "89 degrees from straight ahead"),
        (put(xreal(), -0.07, "display", "target_p_right_display", 0), "does not place the right eye to the right of"),
        (
            put(xreal(), 1900.0, "display_distortion", "right_display", "data", 4 * 61 * 3 + 6),
            "the points of 'data' fold over or are mirrored",
        ),
        (put(xreal(), [1.0], "display_distortion", "left_display", "data"), "'data' has 1 numbers"),
        (
            put(xreal(), [0.0] * 8540, "display_distortion", "right_display", "data"),
            "do not form a grid of ascending rows and columns",
        ),
        (
            {"num_grid_points_x": 3, "num_grid_points_y": 3, "baseline": 63, "left": {"grid": [1]}},
            "'grid' must be 3 rows",
        ),
    ],
)
def test_a_faulty_file_is_refused_with_a_sentence(content: Content, sentence: str, tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match=sentence):
        open_eye(written(content, tmp_path), "right")

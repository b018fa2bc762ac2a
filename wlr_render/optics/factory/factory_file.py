"""Read factory calibrations: SteamVR, Monado's North Star grid, Windows Mixed Reality, XREAL.

The meaning of the numbers follows Monado (github.com/alvr-org/Monado-ALVR at 4053401: `vive_config.c`,
`u_distortion_mesh.c`, `wmr_config.c`) for SteamVR's and WMR's files, SteamVR's documentation of its JSON file for
hardware makers, and public drivers of XREAL glasses. Pixel (0, 0) is the outer corner of the panel in all of them.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy

from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import normalised
from wlr_render.geometry.transforms import OPENXR_FROM_OPENCV, rigid, rotation_of_quaternion
from wlr_render.io.input_files import LIMITS, read_bytes, require_pixels
from wlr_render.io.toml_files import Table, read_json
from wlr_render.mappings import Eye, EyeBox, Panel
from wlr_render.numerics.arrays import BoolArray, FloatArray
from wlr_render.optics.device import EyeOptics, PlacedPanel
from wlr_render.optics.device import Path as RayPath
from wlr_render.optics.factory.factory_display import (
    IMAGE_M,
    FactoryDisplay,
    GridTangents,
    PixelTangents,
    RadialTangents,
    display_pose,
)
from wlr_render.optics.media import GREEN_UM
from wlr_render.optics.traced_mappings import TracedSeeThrough

_KIND = "a factory calibration"
_EYE_BOX_M = np.array([8e-3, 6e-3, 4e-3])
_SIDES = ("left", "right")
_NORTH_STAR_PX = (1440, 1600)
_MOST_APART_M = 0.1  # largest distance of an eye from the middle
_TESTED = 25  # pixels tested for folds, across and down
_LEAST_AHEAD = 0.5  # cosine of the angle between the middle of a display and straight ahead
_NO_DISTORTION = np.zeros(4)


@dataclass(frozen=True, eq=False)
class _Calibrated:
    """One eye: panel, rotation and place of the display in OpenCV's axes, tangents of one or of three colours."""

    panel: Panel
    rotation: FloatArray
    place: FloatArray
    tangents: tuple[PixelTangents, ...]


def is_factory_file(path: str | Path) -> bool:
    """Return whether a file is JSON with the keys of a factory calibration."""
    try:
        content = json.loads(read_bytes(path, LIMITS.data_bytes))
    except (BadInputError, ValueError, RecursionError):
        return False
    return isinstance(content, dict) and "format" not in content and any(key in content for key in _READERS)


def load_factory_eyes(path: str | Path, eye: str) -> tuple[Eye, ...]:
    """Return the mappings of one eye of a factory calibration: for all colours, or for red, green and blue.

    The display is a flat virtual image at `IMAGE_M`; the real world is seen without optics. The origin of the device is
    the middle between the eyes.

    Raises:
        BadInputError: a faulty file, or one without that eye.
    """
    table = read_json(path, _KIND, "name another file")
    reader = next((read for key, read in _READERS.items() if table.has(key)), None)
    if reader is None:
        raise table.fail(f"is not {_KIND}; name another file.")
    eyes = reader(table)
    if eye not in eyes:
        raise table.fail(f"has no display of the {eye} eye; choose the {next(iter(eyes))} eye.")
    found = eyes[eye]
    middle = np.mean([each.place for each in eyes.values()], axis=0) if len(eyes) > 1 else found.place
    place = found.place - middle
    if np.linalg.norm(place) > _MOST_APART_M:
        raise table.fail(f"places the eyes {2e3 * float(np.linalg.norm(place)):.0f} mm apart; correct their poses.")
    if len(eyes) > 1 and place[0] * (1.0 if eye == "right" else -1.0) <= 0:
        raise table.fail("does not place the right eye to the right of the left one; correct their poses.")
    require_pixels(str(path), found.panel.size_px, "correct the size of the panel")
    pose = display_pose(found.rotation, place)
    for each in found.tangents:
        ahead = -pose[2, :3] @ normalised(np.append(each(0.5 * found.panel.size_px), 1.0))
        if not ahead > _LEAST_AHEAD:
            off_deg = np.degrees(np.arccos(ahead))
            raise table.fail(
                f"shows the middle of the {eye} display {off_deg:.0f} degrees from straight ahead; correct its pose "
                "and its centre."
            )
        pixel = found.panel.grid(_TESTED, _TESTED).reshape(_TESTED, _TESTED, 2)
        inside = np.linalg.norm(2.0 * pixel / found.panel.size_px - 1.0, axis=-1) < 1.0
        if _is_folded(each(pixel), inside):
            raise table.fail(
                f"has directions of the {eye} display that fold over or are mirrored; correct its distortion."
            )
    box = EyeBox(pose[:3, 3], _EYE_BOX_M)
    image = PlacedPanel(pose @ rigid(np.eye(3), np.array([0.0, 0.0, IMAGE_M])), np.full(2, IMAGE_M), found.panel)
    world = TracedSeeThrough(EyeOptics(RayPath(), RayPath(), image, box), GREEN_UM)
    name = f"{Path(path).stem} (factory calibration)"
    return tuple(Eye(name, eye, FactoryDisplay(found.panel, each, pose), world, box) for each in found.tangents)


def _steamvr(table: Table) -> dict[str, _Calibrated]:
    device = table.table("device")
    panel = Panel(*(device.whole(f"eye_target_{side}_in_pixels", least=1) for side in ("width", "height")))
    aspect = device.number("physical_aspect_x_over_y", panel.width_px / panel.height_px, least=0.1, most=10)
    half_m = 0.5 * (
        table.number("lens_separation")
        if table.has("lens_separation")
        else 1e-3 * table.table("ipd").number("default_mm")
    )
    eyes = {}
    for side, sign, eye in zip(_SIDES, (-1.0, 1.0), table.tables("tracking_to_eye_transform", most=2), strict=False):
        intrinsics = eye.vectors("intrinsics", 3, rows=3)
        (fx, _, cx), (_, fy, cy) = intrinsics[0], intrinsics[1]
        if fx <= 0 or fy <= 0:
            raise eye.fail(f"'intrinsics' has the focal lengths {fx:g} and {fy:g}; they must be positive.")
        # Undistorted x and y / aspect run from -1 to 1 over the panel of a lens without distortion.
        plane = np.array([[1 / fx, 0, cx / fx], [0, aspect / fy, -cy / fy], [0, 0, 1]])
        names = [
            name if eye.has(name) else "distortion" for name in ("distortion_red", "distortion", "distortion_blue")
        ]
        rotation = eye.vectors("eye_to_head", 3, rows=3) if eye.has("eye_to_head") else np.eye(3)
        eyes[side] = _Calibrated(
            panel,
            _rotation(eye, "eye_to_head", OPENXR_FROM_OPENCV @ rotation @ OPENXR_FROM_OPENCV),
            np.array([sign * half_m, 0.0, 0.0]),
            tuple(_steamvr_radial(eye.table(name), panel, aspect, plane) for name in names),
        )
    return eyes


def _steamvr_radial(table: Table, panel: Panel, aspect: float, plane: FloatArray) -> RadialTangents:
    kinds = ("DISTORT_DPOLY3", "DISTORT_DPOLY3_SCALED", "DISTORT_POLY3")
    kind = table.text("type", kinds[0], choices=kinds)
    k = np.concatenate([table.numbers("coeffs"), _NO_DISTORTION])[:4]
    k[3] *= kind == kinds[1]
    half = 0.5 * panel.size_px
    centre = np.array([table.number("center_x"), table.number("center_y")])
    return RadialTangents(half, half * [1.0, aspect], centre, k, kind != kinds[2], plane)


def _wmr(table: Table) -> dict[str, _Calibrated]:
    eyes: dict[str, _Calibrated] = {}
    information = table.table("CalibrationInformation")
    for display in information.tables("Displays", most=2):
        names = {f"CALIBRATION_DisplayEye{side.capitalize()}": side for side in _SIDES}
        side = names[display.text("AssignedEye", choices=list(names))]
        if side in eyes:
            raise display.fail(f"is a second display of the {side} eye; correct 'AssignedEye'.")
        width, height = (display.number(f"Display{axis}", least=1, most=1e5) for axis in ("Width", "Height"))
        plane = _inverse(display, "Affine")
        origin = np.array([-0.5 * width * _SIDES.index(side), 0.0])  # both eyes are halves of one picture
        radial = []
        for colour in ("Red", "Green", "Blue"):
            model = display.table(f"Distortion{colour}")
            model.text("ModelType", choices=["CALIBRATION_DisplayDistortionModelPolynomial3K"])
            values = model.numbers("ModelParameters")
            if values.size < 5:
                raise model.fail(f"'ModelParameters' must have 5 numbers, not {values.size}.")
            k = np.append(values[2:5], 0.0)
            radial.append(RadialTangents(origin, np.ones(2), values[:2], k, False, plane))
        pose = display.table("Rt")
        display_from_camera = _rotation(pose, "Rotation", pose.vector("Rotation", 9).reshape(3, 3))
        place = -display_from_camera.T @ pose.vector("Translation", 3)
        panel = Panel(int(width) // 2, int(height))
        eyes[side] = _Calibrated(panel, display_from_camera.T, place, tuple(radial))
    if not eyes:
        raise information.fail("'Displays' is empty; name a file with the displays of a headset.")
    # The poses are relative to a tracking camera that looks down; straight ahead is the mean of the displays.
    middle = (
        scipy.spatial.transform.Rotation.from_matrix([each.rotation for each in eyes.values()]).mean().as_matrix().T
    )
    return {
        side: _Calibrated(each.panel, middle @ each.rotation, middle @ each.place, each.tangents)
        for side, each in eyes.items()
    }


def _xreal(table: Table) -> dict[str, _Calibrated]:
    display = table.table("display")
    panel = Panel(*map(int, display.vector("resolution", 2, least=1, most=1e5)))
    eyes = {}
    for side in _SIDES:
        plane = _inverse(display, f"k_{side}_display")
        tangents: PixelTangents = RadialTangents(np.zeros(2), np.ones(2), np.zeros(2), _NO_DISTORTION, False, plane)
        if table.has("display_distortion"):
            tangents = _xreal_grid(table.table("display_distortion").table(f"{side}_display"), plane)
        xyzw = display.vector(f"target_q_{side}_display", 4)
        if not 0.5 < np.linalg.norm(xyzw) < 2.0:
            raise display.fail(f"'target_q_{side}_display' must be a unit quaternion, not {xyzw.tolist()}.")
        place = display.vector(f"target_p_{side}_display", 3)
        eyes[side] = _Calibrated(panel, rotation_of_quaternion(xyzw / np.linalg.norm(xyzw)), place, (tangents,))
    return eyes


def _xreal_grid(grid: Table, plane: FloatArray) -> GridTangents:
    """Read rows of [u, v of the panel, u, v of the undistorted picture], row by row."""
    columns, rows = (grid.whole(f"num_{axis}", least=2, most=1000) for axis in ("col", "row"))
    data = grid.numbers("data")
    if data.size != 4 * rows * columns:
        raise grid.fail(f"'data' has {data.size} numbers; {rows} rows of {columns} points have {4 * rows * columns}.")
    data = data.reshape(rows, columns, 4)
    u, v = data[0, :, 0], data[:, 0, 1]
    regular = np.allclose(data[..., 0], u, atol=0.01) and np.allclose(data[..., 1], v[:, None], atol=0.01)
    if not regular or np.diff(u).min() <= 0 or np.diff(v).min() <= 0:
        raise grid.fail("the points of 'data' do not form a grid of ascending rows and columns; correct them.")
    if _is_folded(data[..., 2:]):
        raise grid.fail("the points of 'data' fold over or are mirrored; correct them.")
    return GridTangents(u, v, data[..., 2:], plane)


def _north_star(table: Table) -> dict[str, _Calibrated]:
    columns, rows = (table.whole(f"num_grid_points_{axis}", least=2, most=1000) for axis in "xy")
    panel, half_m = Panel(*_NORTH_STAR_PX), 5e-4 * table.number("baseline", above=0)
    eyes = {}
    for side, sign in zip(_SIDES, (-1.0, 1.0), strict=True):
        eye = table.table(side)
        try:
            grid = np.array(eye.raw("grid"), dtype=np.float64).reshape(rows, columns, 2)
        except (TypeError, ValueError):
            grid = np.full((rows, columns, 2), np.nan)
        if not np.isfinite(grid).all():
            raise eye.fail(f"'grid' must be {rows} rows of {columns} pairs of numbers; write the file again.")
        if _is_folded(grid):
            raise eye.fail("the points of 'grid' fold over or are mirrored; correct them.")
        u, v = (np.linspace(0.0, size, count) for size, count in zip(panel.size_px, (columns, rows), strict=True))
        tangents = GridTangents(u, v, grid, np.eye(3))
        eyes[side] = _Calibrated(panel, np.eye(3), np.array([sign * half_m, 0.0, 0.0]), (tangents,))
    return eyes


def _is_folded(point: FloatArray, inside: BoolArray | bool = True) -> bool:
    """Return whether a cell of the points (rows, columns, 2) is mirrored: the display would show a direction twice.

    Only cells that begin `inside` count: formulas may fold in corners that no lens shows.
    """
    along, down = np.diff(point, axis=1)[:-1], np.diff(point, axis=0)[:, :-1]
    area = along[..., 0] * down[..., 1] - along[..., 1] * down[..., 0]
    return not np.all((area > 0) | ~np.broadcast_to(inside, point.shape[:2])[:-1, :-1])


def _rotation(table: Table, key: str, matrix: FloatArray) -> FloatArray:
    if np.abs(matrix @ matrix.T - np.eye(3)).max() > 1e-3 or np.linalg.det(matrix) < 0:
        raise table.fail(f"'{key}' is not a rotation matrix; correct it.")
    return np.asarray(scipy.spatial.transform.Rotation.from_matrix(matrix).as_matrix(), np.float64)


def _inverse(table: Table, key: str) -> FloatArray:
    """Return the inverse of the 9 numbers of a matrix, row by row."""
    matrix = table.vector(key, 9).reshape(3, 3)
    if abs(np.linalg.det(matrix)) < 1e-9:
        raise table.fail(f"'{key}' has no inverse; correct it.")
    if matrix[0, 0] <= 0 or matrix[1, 1] <= 0:
        raise table.fail(f"'{key}' has the focal lengths {matrix[0, 0]:g} and {matrix[1, 1]:g}; they must be positive.")
    return np.linalg.inv(matrix).astype(np.float64)


_READERS: dict[str, Callable[[Table], dict[str, _Calibrated]]] = {
    "tracking_to_eye_transform": _steamvr,
    "CalibrationInformation": _wmr,
    "num_grid_points_x": _north_star,
    "display": _xreal,
}
"""Readers by the key that identifies their format."""

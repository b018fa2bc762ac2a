"""Gray-code captures of a North Star display through its combiner (J. Vincur, 3D-Calibration-VCam).

A stereo camera on a lift is at the position of the eyes, at two heights. At each height it decodes a bare monitor of
known size, which gives the camera's pose, and then the headset's two displays. So each display is known from two
viewpoints.

A map is a 16-bit image of the two cameras' views side by side; value / 65535 is the position on the monitor or on that
eye's half of the screen, and 0 means no data. The code has 8 bits, and the maps were smoothed after decoding.
"""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from wlr_render.captures.correspondences import DisplayCaptures
from wlr_render.errors import BadInputError
from wlr_render.geometry import directions, transforms
from wlr_render.io.input_files import read_image
from wlr_render.io.toml_files import Table, read_json
from wlr_render.mappings import EyeBox, Panel
from wlr_render.numerics.arrays import FloatArray

PANEL = Panel(1440, 1600)
"""One eye's half of the screen of a North Star headset; the maps state fractions of it."""

EYES = ("left", "right")
_HEIGHTS = ("D", "U")
_CODE_STEP = 1 / 256
_FULL_SCALE = 65535.0
_LARGEST_PX = 1e6
_MONITOR_M = (0.05, 5.0)  # smallest and largest width and height
_EDGE_PX = 12  # rim in which smoothing mixed the map with its empty surround; farther in, the roughness no longer falls
_EVERY_PX = 3  # sampling step on each axis; smoothing makes closer neighbours copies of one another
_MONITOR_EVERY_PX = 8
_TOLERANCE_PX = 1.0  # largest misfit of a monitor to its map; beyond it, another monitor was photographed


@dataclass(frozen=True)
class MonitorFit:
    """Fit of the monitor to its map from one camera position.

    Attributes:
        camera: e.g. "left camera, rig down".
        median_px: median distance between the map and the fitted monitor, camera pixels.
        height_scale: fitted over stated height of the monitor. The ratio of the camera's two focal lengths has the same
            effect: a monitor seen straight on cannot separate the two.
    """

    camera: str
    median_px: float
    height_scale: float


@dataclass(frozen=True)
class VcamCaptures:
    """Display captures of both eyes in one device frame.

    The device frame has the monitor's axes (x right, y up, -z towards the monitor) and its origin half way between the
    two cameras with the rig down. `capture` is 0 with the rig down and 1 with the rig up; display captures have the
    camera centres of the monitor captures, within the repeatability of the lift.

    Attributes:
        left, right: captures of each eye; sigma is the rounding to the code's steps, before the smoothing.
        monitor: (4,) fits of the left and right camera with the rig down, then up.
        stated_baseline_m: distance between the cameras in the rig's own calibration; None if not stated.
    """

    left: DisplayCaptures
    right: DisplayCaptures
    monitor: tuple[MonitorFit, ...]
    stated_baseline_m: float | None = None

    @property
    def baseline_m(self) -> FloatArray:
        """Distances (2,) between the two cameras by the monitor, with the rig down and up."""
        left, right = (
            np.stack([each.viewpoint[each.capture == height][0] for height in range(len(_HEIGHTS))])
            for each in (self.left, self.right)
        )
        return np.asarray(np.linalg.norm(right - left, axis=1))


@dataclass(frozen=True)
class _Camera:
    """A pinhole without distortion, OpenCV axes; pixels from the outer corner."""

    focal_px: FloatArray
    centre_px: FloatArray

    def tangents(self, pixel: FloatArray) -> FloatArray:
        return (pixel - self.centre_px) / self.focal_px


@dataclass(frozen=True)
class _Pose:
    """A camera in the monitor's frame: x right, y down, z away from the camera; origin in the top-left corner."""

    camera_from_monitor: FloatArray
    fit: MonitorFit


def read_northstar_vcam(folder: str | Path) -> VcamCaptures:
    """Read one session: `M` and `C` maps of the rig down (`D`) and up (`U`), cameraCalibration.json and config.json.

    Raises:
        BadInputError: a file is missing or in another form, a map has no data, or a monitor does not fit its map.
    """
    root = Path(folder)
    cameras = _cameras(root / "cameraCalibration.json")
    area = read_json(root / "config.json", "settings of the rig").table("CalibrationMonitorActiveAreaMeters")
    monitor_m = np.array([area.number(key, least=_MONITOR_M[0], most=_MONITOR_M[1]) for key in ("x", "y")])
    poses = {
        (eye, height): _pose(_map(root, "M" + height), eye, cameras[eye], monitor_m, height)
        for height in _HEIGHTS
        for eye in EYES
    }
    monitor_from_device = _monitor_from_device([poses[eye, "D"].camera_from_monitor for eye in EYES])
    device_from_camera = {
        key: transforms.inverse(pose.camera_from_monitor @ monitor_from_device) for key, pose in poses.items()
    }
    display_maps = [_map(root, "C" + height) for height in _HEIGHTS]
    left, right = (
        _captures(eye, display_maps, cameras[eye], [device_from_camera[eye, height] for height in _HEIGHTS])
        for eye in EYES
    )
    stated = _stated_baseline_m(root / "cameraCalibration.json")
    return VcamCaptures(left, right, tuple(pose.fit for pose in poses.values()), stated)


def _cameras(path: Path) -> dict[str, _Camera]:
    rig = _rig(path)
    cameras = rig.tables("cameras", most=len(EYES))
    if len(cameras) != len(EYES):
        raise rig.fail(
            f"'cameras' has {len(cameras)} entries; it must have two, left and right: calibrate the rig again."
        )
    matrices = [camera.vector("cameraMatrix", 9, least=-_LARGEST_PX, most=_LARGEST_PX) for camera in cameras]
    fx_fy_cx_cy = np.array(matrices)[:, [0, 4, 2, 5]]
    if fx_fy_cx_cy[:, :2].min() <= 1:
        raise rig.fail("the focal lengths of a 'cameraMatrix' must be above 1 pixel; calibrate the rig again.")
    # The calibration counts from the middle of the top-left pixel, as OpenCV does.
    return {eye: _Camera(row[:2], row[2:] + 0.5) for eye, row in zip(EYES, fx_fy_cx_cy, strict=True)}


def _stated_baseline_m(path: Path) -> float | None:
    rig = _rig(path)
    return rig.number("baseline", most=1.0, above=0.0) if rig.raw("baseline") is not None else None


def _rig(path: Path) -> Table:
    """Return the first two cameras of a calibration file."""
    rigs = read_json(path, "a calibration of two cameras").tables("deviceCalibrations")
    if not rigs:
        raise BadInputError(f"{path}: 'deviceCalibrations' is empty; calibrate the rig again.")
    return rigs[0]


def _map(root: Path, name: str) -> FloatArray:
    """Read a map (2 eyes, height, width, 2) of fractions, u right and v as stored; NaN marks missing data."""
    axes = []
    for axis in ("Width", "Height"):
        path = root / f"{name}_{axis}Calibration.png"
        axes.append(read_image(path, cv2.IMREAD_UNCHANGED).astype(np.float64))
    if axes[0].shape != axes[1].shape or axes[0].ndim != 2 or axes[0].shape[1] % 2:
        raise BadInputError(f"{root}: the two {name} maps must be grey images of one size, two views side by side.")
    both = np.stack(axes, axis=-1) / _FULL_SCALE
    both[(both == 0).any(axis=-1)] = np.nan
    return np.stack(np.split(both, 2, axis=1))


def _rows(view: FloatArray, every_px: int, what: str) -> tuple[FloatArray, FloatArray]:
    """Return camera pixels (n, 2) and the fractions (n, 2) decoded there, away from the edge of the data."""
    from scipy.ndimage import binary_erosion

    inside = binary_erosion(np.isfinite(view).all(axis=-1), iterations=_EDGE_PX)
    v, u = np.asarray(np.nonzero(inside[::every_px, ::every_px])) * every_px
    if len(u) < 100:
        raise BadInputError(f"{what}: the map holds only {len(u)} usable samples; check that it was decoded.")
    pixel: FloatArray = np.stack([u, v], axis=-1) + 0.5
    return pixel, view[v, u]


def _pose(maps: FloatArray, eye: str, camera: _Camera, monitor_m: FloatArray, height: str) -> _Pose:
    from scipy.optimize import least_squares
    from scipy.spatial.transform import Rotation

    name = f"{eye} camera, rig {'down' if height == 'D' else 'up'}"
    pixel, fraction = _rows(maps[EYES.index(eye)], _MONITOR_EVERY_PX, f"M{height}, {name}")
    # The monitor's v runs up.
    on_monitor = np.column_stack([fraction[:, 0], 1 - fraction[:, 1], np.zeros(len(pixel))]) * [*monitor_m, 0.0]
    seen = camera.tangents(pixel)

    def miss_px(unknown: FloatArray) -> FloatArray:
        point = Rotation.from_rotvec(unknown[:3]).apply(on_monitor * [1.0, unknown[6], 1.0]) + unknown[3:6]
        return np.asarray((point[:, :2] / point[:, 2:] - seen) * camera.focal_px)

    distance = on_monitor[:, 0].std() / seen[:, 0].std()
    offset = seen.mean(axis=0) * distance - on_monitor[:, :2].mean(axis=0)
    start = np.array([0.0, 0.0, 0.0, *offset, distance, 1.0])
    found = least_squares(lambda x: miss_px(x).ravel(), start, loss="soft_l1", f_scale=0.3, x_scale="jac").x
    median = float(np.median(np.linalg.norm(miss_px(found), axis=-1)))
    if not median < _TOLERANCE_PX:
        raise BadInputError(
            f"M{height}, {name}: the monitor misses its map by {median:.1f} px; check the cameras and its size."
        )
    rotation = Rotation.from_rotvec(found[:3]).as_matrix()
    return _Pose(transforms.rigid(rotation, found[3:6]), MonitorFit(name, median, float(found[6])))


def _monitor_from_device(camera_from_monitor: list[FloatArray]) -> FloatArray:
    centres = [transforms.inverse(matrix)[:3, 3] for matrix in camera_from_monitor]
    return transforms.rigid(transforms.OPENXR_FROM_OPENCV, np.mean(centres, axis=0))


def _captures(
    eye: str, maps: list[FloatArray], camera: _Camera, device_from_camera: list[FloatArray]
) -> DisplayCaptures:
    parts = [_rows(view[EYES.index(eye)], _EVERY_PX, f"C maps, {eye} eye") for view in maps]
    view_dirs = [
        transforms.rotate(pose, _dir_in_camera(camera, pixel))
        for pose, (pixel, _) in zip(device_from_camera, parts, strict=True)
    ]
    counts = [len(pixel) for pixel, _ in parts]
    viewpoints = np.stack([pose[:3, 3] for pose in device_from_camera])
    box = EyeBox(viewpoints.mean(axis=0), np.ptp(viewpoints, axis=0))
    return DisplayCaptures(
        device="northstar_vcam",
        eye=eye,
        eye_box=box,
        panel=PANEL,
        viewpoint=np.repeat(viewpoints, counts, axis=0),
        view_dir=np.concatenate(view_dirs),
        # Unlike the monitor's, the display's v as seen through the combiner runs down.
        pixel=np.concatenate([fraction for _, fraction in parts]) * PANEL.size_px,
        capture=np.repeat(np.arange(len(parts)), counts),
        sigma_arcmin=np.concatenate([_rounding_arcmin(camera, pixel, fraction) for pixel, fraction in parts]),
    )


def _dir_in_camera(camera: _Camera, pixel: FloatArray) -> FloatArray:
    tangents = camera.tangents(pixel)
    return directions.normalised(np.column_stack([tangents, np.ones(len(tangents))]))


def _rounding_arcmin(camera: _Camera, pixel: FloatArray, fraction: FloatArray) -> FloatArray:
    """Return the sigma (n,) of a direction per axis due to rounding the fractions, by the view's mean magnification."""
    spread = np.column_stack([np.ones(len(pixel)), fraction])
    slope = np.linalg.lstsq(spread, camera.tangents(pixel), rcond=None)[0][1:]
    variance = np.sum((slope * _CODE_STEP) ** 2) / 12 / 2
    return np.full(len(pixel), np.sqrt(variance) / directions.ARCMIN)

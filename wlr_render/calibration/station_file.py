"""Read and write station-EYE.json, the calibrated station.

Device frame (OpenXR), metres; cameras have OpenCV's axes and pixels count from the outer corner of the top-left pixel.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from wlr_render.calibration.poses import Pose
from wlr_render.calibration.station import Station
from wlr_render.errors import BadInputError
from wlr_render.files import write_text
from wlr_render.geometry import transforms
from wlr_render.geometry.lens_camera import DISTORTION_TERMS, LensCamera
from wlr_render.numerics.arrays import FloatArray
from wlr_render.toml_files import Table, read_json

FORMAT = "wlr-station"
VERSION = 1


@dataclass(frozen=True, eq=False)
class SavedStation:
    """Contents of station-EYE.json.

    Attributes:
        eyeball_camera, tracking_camera: the lenses.
        device_from_tracking: (4, 4).
        reference: (3,) stage reading.
        at_reference: (4, 4) device_from_camera there.
        axes: (3, 3) displacement in the device frame per reading; NaN columns for axes that were never moved.
    """

    eyeball_camera: LensCamera
    tracking_camera: LensCamera
    device_from_tracking: FloatArray
    reference: FloatArray
    at_reference: FloatArray
    axes: FloatArray

    def device_from_camera(self, reading: FloatArray) -> FloatArray:
        """(3,) stage reading -> (4, 4).

        Raises:
            BadInputError: a reading of an axis that calibration never saw moving.
        """
        travel = np.asarray(reading) - self.reference
        used = travel != 0
        if np.isnan(self.axes[:, used]).any():
            raise BadInputError("the stage is read along an axis that no photograph without the headset varies.")
        moved = self.at_reference[:3, 3] + self.axes[:, used] @ travel[used]
        return transforms.rigid(self.at_reference[:3, :3], moved)


def save_station(
    path: str | Path,
    station: Station,
    eyeball: LensCamera,
    tracking: LensCamera,
    device_from_tracking: FloatArray,
) -> Path:
    """Write station-EYE.json, with the uncertainty of every pose."""
    axes: list[Any] = [None] * 3
    for number, column in zip(station.stage.moved_axes, station.stage_axes_in_device.T, strict=True):
        axes[int(number)] = column.tolist()
    reference = station.stage.reference
    content = {
        "format": FORMAT,
        "version": VERSION,
        "frame": "openxr",
        "units": {"length": "m", "pixel": "px"},
        "eyeball_camera": _camera_record(eyeball),
        "tracking_camera": _camera_record(tracking),
        "device_from_tracking": device_from_tracking.tolist(),
        "stage": {
            "reference_m": reference.tolist(),
            "device_from_camera": _pose_record(station.pose_at(reference)),
            "axes_in_device": axes,
            "repeatability": {
                "translation_um": 1e6 * station.stage.jitter.translation_m,
                "rotation_urad": 1e6 * station.stage.jitter.rotation_rad,
            },
        },
        "device_from_target": {str(k): _pose_record(pose) for k, pose in station.device_from_target.items()},
        "checks": [
            {"step": check.step, "quantity": check.quantity, "ok": bool(check.ok), "sentence": check.sentence}
            for check in station.checks
        ],
    }
    return write_text(path, json.dumps(content, indent=1) + "\n")


def load_station(path: str | Path) -> SavedStation:
    """Read station-EYE.json.

    Raises:
        BadInputError: there is none, or it is of another kind.
    """
    table = read_json(path, "a station file", "`calibrate photos` writes it")
    table.text("format", choices=[FORMAT])
    if table.number("version") != VERSION:
        raise table.fail(f"has another version than {VERSION}; write it again.")
    stage = table.table("stage")
    return SavedStation(
        _camera(table.table("eyeball_camera")),
        _camera(table.table("tracking_camera")),
        table.vectors("device_from_tracking", 4),
        stage.vector("reference_m", 3),
        stage.table("device_from_camera").vectors("matrix", 4),
        _axes(stage),
    )


def _axes(stage: Table) -> FloatArray:
    """Of axes that were never moved the file has null."""
    columns = stage.unchecked("axes_in_device")
    try:
        axes = np.array([[np.nan] * 3 if column is None else column for column in columns], dtype=np.float64)
    except (TypeError, ValueError):
        axes = np.empty(0)
    if axes.shape != (3, 3):
        raise stage.fail(f"'axes_in_device' must be 3 columns of 3 numbers, or null, not {columns!r}.")
    return np.asarray(axes.T)


def _camera_record(camera: LensCamera) -> dict[str, Any]:
    return {
        "size_px": list(camera.size_px),
        "focal_px": camera.focal_px.tolist(),
        "centre_px": camera.centre_px.tolist(),
        "distortion": camera.distortion.tolist(),
    }


def _camera(table: Table) -> LensCamera:
    width, height = (int(side) for side in table.vector("size_px", 2))
    return LensCamera(
        (width, height),
        table.vector("focal_px", 2),
        table.vector("centre_px", 2),
        table.vector("distortion", len(DISTORTION_TERMS)),
    )


def _pose_record(pose: Pose) -> dict[str, Any]:
    return {
        "matrix": pose.b_from_a.tolist(),
        "sigma_arcmin": pose.sigma_arcmin.tolist(),
        "sigma_mm": pose.sigma_mm.tolist(),
    }

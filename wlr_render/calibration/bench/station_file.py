"""Read and write station-EYE.json, the calibrated bench.

Device frame (OpenXR), metres; cameras have OpenCV's axes and pixels count from the outer corner of the top-left pixel.
"""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from wlr_render.calibration.bench.bench_checks import Pull, prior_pulls, reading_pulls
from wlr_render.calibration.bench.board_shape import BOARD_SHAPE, BoardShape
from wlr_render.calibration.bench.board_views import EYEBALL, TRACKING
from wlr_render.calibration.bench.calibrate_bench import CalibratedBench
from wlr_render.calibration.bench.state import StageModel
from wlr_render.calibration.poses import Pose, adjoint
from wlr_render.captures.camera_lens_file import require_plausible_lens
from wlr_render.errors import BadInputError
from wlr_render.geometry.transforms import is_rotation
from wlr_render.io.atomic_files import write_text
from wlr_render.io.input_files import require_length, shown
from wlr_render.io.toml_files import Table, read_json
from wlr_render.lenses.lens import Lens
from wlr_render.lenses.lens_camera import LensCamera
from wlr_render.lenses.residual_lens import ResidualLens
from wlr_render.lenses.splined_lens import SplinedLens
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.smooth_field import SmoothField

_UNITS = {"length": "m", "angle": "rad", "pixel": "px"}
FORMAT = "wlr-station"
VERSION = 3
_MOST_AMPLITUDE_PX = 100.0  # far above the residual of any lens model
_MOST_WAVES = 20  # most half waves of a field along a side


@dataclass(frozen=True, eq=False)
class SavedStation:
    """Contents of station-EYE.json.

    Attributes:
        eyeball_camera, tracking_camera: the lenses; None for a tracking camera that there is not.
        device_from_tracking: (4, 4), or None.
        base: (4, 4) device_from_camera at the middle of the stage's readings; None without a stage.
        stage: how the stage carries the camera, or None.
        shape: of the board; None in files of version 1, which count it as flat.
    """

    eyeball_camera: Lens
    tracking_camera: Lens | None
    device_from_tracking: FloatArray | None
    base: FloatArray | None
    stage: StageModel | None
    shape: BoardShape | None

    def device_from_camera(self, reading: FloatArray) -> FloatArray:
        """(m,) stage reading -> (4, 4).

        Raises:
            BadInputError: there is no stage, or the reading is of an axis that calibration never saw moving.
        """
        if self.base is None or self.stage is None:
            raise BadInputError(
                "the calibrated bench has no stage, so a reading has no camera pose; calibrate with [stage]."
            )
        travel = np.asarray(reading) - self.stage.middle
        if np.any(travel[~self.stage.twists.any(axis=1)]):
            raise BadInputError(
                "the stage is read along an axis that no photograph without the headset varies; photograph the board "
                "along it, or leave the reading out."
            )
        return np.asarray(self.base @ self.stage.motion(np.asarray(reading)))


def save_station(path: str | Path, bench: CalibratedBench) -> Path:
    """Write station-EYE.json, with the uncertainty of every pose."""
    state, adjustment = bench.adjustment.state, bench.adjustment
    content: dict[str, Any] = {
        "format": FORMAT,
        "version": VERSION,
        "frame": "openxr",
        "units": _UNITS,
        "eyeball_camera": _lens_record(state.lens[EYEBALL]),
        "device_from_target": {str(k): _pose_record(pose) for k, pose in bench.targets.items()},
        "board": _shape_record(state.shape["board"]) if "board" in state.shape else None,
        "reduced_chi_squared": [_pull_record(each) for each in [*reading_pulls(adjustment), *prior_pulls(adjustment)]],
        "checks": [
            {"step": check.step, "quantity": check.quantity, "ok": bool(check.ok), "sentence": check.sentence}
            for check in bench.checks
        ],
    }
    if state.device_from_tracking is not None:
        content["tracking_camera"] = _lens_record(state.lens[TRACKING])
        content["device_from_tracking"] = state.device_from_tracking.tolist()
    if state.base:
        orientation = min(state.base)
        to_device = adjoint(state.base[orientation])
        covariance = to_device @ adjustment.covariance_of([("base", orientation)]) @ to_device.T
        stage, sizes = state.stage, adjustment.sizes
        content["stage"] = {
            "middle": stage.middle.tolist(),
            "half_range": stage.half_range.tolist(),
            "device_from_camera": _pose_record(Pose(state.base[orientation], covariance)),
            "twists": stage.twists.tolist(),
            "smooth_error": stage.smooth.tolist(),
            "repeatability": {"translation_um": 1e6 * sizes["shift"], "rotation_urad": 1e6 * sizes["turn"]},
            "smooth_size": {"translation_um": 1e6 * sizes["smooth shift"], "rotation_urad": 1e6 * sizes["smooth turn"]},
        }
    return write_text(path, json.dumps(content, indent=1) + "\n")


def load_station(path: str | Path) -> SavedStation:
    """Read station-EYE.json of this version or of version 1.

    Raises:
        BadInputError: there is none, or it is of another kind.
    """
    table = read_json(path, "a station file", "`calibrate` writes it, of photographs")
    table.text("format", choices=[FORMAT])
    if (version := table.number("version")) not in (1, VERSION):
        raise table.fail(f"has version {version:g}, and versions 1 and {VERSION} can be read; write it again.")
    table.text("frame", choices=["openxr"])
    if table.has("units") and table.raw("units") != _UNITS:
        raise table.fail(f"'units' must be {_UNITS}; convert the file, or write it again.")
    tracking, base, stage = None, None, None
    if table.has("tracking_camera"):
        tracking = _lens(table.table("tracking_camera"))
    if table.has("stage"):
        part = table.table("stage")
        base = _rigid(part.table("device_from_camera"), "matrix")
        stage = _stage_of_version_1(part, base) if version == 1 else _stage(part)
    return SavedStation(
        _lens(table.table("eyeball_camera")),
        tracking,
        _rigid(table, "device_from_tracking") if tracking is not None else None,
        base,
        stage,
        _shape(table.table("board")) if version > 1 and table.raw("board") else None,
    )


def _rigid(table: Table, key: str) -> FloatArray:
    """Return a rigid transform (4, 4)."""
    matrix = table.vectors(key, 4)
    if matrix.shape != (4, 4) or not is_rotation(matrix[:3, :3]) or np.any(matrix[3] != [0, 0, 0, 1]):
        raise table.fail(f"'{key}' must be a rigid transform of 4 x 4 numbers; write the file again.")
    require_length(f"{table.where}: '{key}'", matrix[:3, 3], 100.0)
    return matrix


def _stage(table: Table) -> StageModel:
    middle, half_range = table.numbers("middle"), table.numbers("half_range")
    twists, smooth = table.vectors("twists", 6), table.vectors("smooth_error", 6)
    if not len(middle) == len(half_range) == len(twists):
        raise table.fail("'middle', 'half_range' and 'twists' differ in their number of axes; write the file again.")
    if len(smooth) % max(len(twists), 1):
        raise table.fail(f"'smooth_error' has {len(smooth)} rows for {len(twists)} axes; write the file again.")
    for key, values in (("middle", middle), ("half_range", half_range), ("twists", twists), ("smooth_error", smooth)):
        if np.any(np.abs(values) > 1e3):
            raise table.fail(f"'{key}' has numbers above 1000 m or rad; write the file again.")
    return StageModel(middle, half_range, twists, smooth)


def _stage_of_version_1(table: Table, base: FloatArray) -> StageModel:
    """Axes in the device frame; null for those that were never moved."""
    columns = table.raw("axes_in_device")
    try:
        axes = np.array([[0.0] * 3 if column is None else column for column in columns], dtype=np.float64)
    except (TypeError, ValueError):
        axes = np.empty(0)
    if axes.shape != (3, 3):
        raise table.fail(
            f"'axes_in_device' must be 3 columns of 3 numbers, or null, not {shown(columns)}; write the file again."
        )
    twists = np.concatenate([np.zeros((3, 3)), axes @ base[:3, :3]], axis=1)
    return StageModel(table.vector("reference_m", 3), np.ones(3), twists, np.zeros((0, 6)))


def _shape(table: Table) -> BoardShape:
    fields, low = None, table.numbers("shape")
    if table.has("heights"):
        fields = _field(table.table("heights")), _field(table.table("printing_errors"))
    terms = len(BOARD_SHAPE) + (0 if fields is None else len(fields[0]) + 2 * len(fields[1]))
    if len(low) != terms:
        raise table.fail(f"'shape' has {len(low)} numbers, not {terms}; write the file again.")
    return BoardShape(
        table.vector("half_size_m", 2),
        low,
        table.vectors("feature", 2).astype(np.int64),
        table.vectors("feature_error_m", 3),
        fields,
    )


def _shape_record(shape: BoardShape) -> dict[str, Any]:
    record = {
        "half_size_m": shape.half_m.tolist(),
        "shape": shape.low.tolist(),
        "feature": shape.feature.tolist(),
        "feature_error_m": np.round(shape.place, 9).tolist(),
    }
    if shape.fields is not None:
        record |= dict(zip(("heights", "printing_errors"), map(asdict, shape.fields), strict=True))
    return record


def _field(table: Table) -> SmoothField:
    """Return a smooth field: its rectangle, and its half waves along both sides."""
    low, high = table.vector("low", 2), table.vector("high", 2)
    if np.any(high <= low):
        raise table.fail("'low' and 'high' must be corners; write the file again.")
    return SmoothField((low[0], low[1]), (high[0], high[1]), _counts(table))


def _counts(table: Table) -> tuple[int, int]:
    """Return the half waves of a field along both sides."""
    counts = table.vector("counts", 2)
    if np.any(counts != np.clip(counts.astype(int), 1, _MOST_WAVES)):
        raise table.fail(f"'counts' must be two whole numbers, 1 to {_MOST_WAVES}; write the file again.")
    return int(counts[0]), int(counts[1])


def _lens_record(lens: Lens) -> dict[str, Any]:
    record: dict[str, Any] = {"size_px": list(lens.size_px)}
    if isinstance(lens, ResidualLens):
        residual = {"counts": list(lens.counts), "amplitude_px": lens.residual_px.tolist()}
        return _lens_record(lens.model) | {"residual": residual}
    if isinstance(lens, LensCamera):
        return record | {
            "kind": lens.kind,
            "focal_px": lens.focal_px.tolist(),
            "centre_px": lens.centre_px.tolist(),
            "distortion": lens.distortion.tolist(),
        }
    assert isinstance(lens, SplinedLens)
    return record | {
        "kind": "splined",
        "focal_px": lens.focal_px.tolist(),
        "centre_px": lens.centre_px.tolist(),
        "knots": list(lens.control.shape[:2]),
        "control": lens.control.reshape(-1, 2).tolist(),
        "order": lens.order,
        "fov_x_deg": lens.fov_x_deg,
    }


def _lens(table: Table) -> Lens:
    size = table.vector("size_px", 2)
    width, height = (int(side) for side in size)
    if (width, height) != tuple(size):
        raise table.fail(f"'size_px' must be two whole numbers, not {size.tolist()}.")
    kind = table.text("kind", "brown")
    focal, centre = table.vector("focal_px", 2), table.vector("centre_px", 2)
    make: Callable[[], LensCamera | SplinedLens]
    if kind == "splined":
        (rows, columns), control = table.vector("knots", 2), table.vectors("control", 2)
        if rows != int(rows) or rows < 1 or rows * columns != len(control):
            raise table.fail(f"'control' has {len(control)} points, 'knots' {rows:g} x {columns:g}; write it again.")
        order, fov_x_deg = table.whole("order"), table.number("fov_x_deg")
        grid = control.reshape(int(rows), -1, 2)
        make = partial(SplinedLens, (width, height), focal, centre, grid, order, fov_x_deg)
    else:
        make = partial(LensCamera, (width, height), focal, centre, table.numbers("distortion"), kind)
    try:
        lens = make()
    except BadInputError as error:
        raise table.fail(str(error)) from error
    require_plausible_lens(table.where, lens)
    if not table.has("residual"):
        return lens
    part = table.table("residual")
    amplitude, counts = part.vectors("amplitude_px", 2), _counts(part)
    if not isinstance(lens, LensCamera):
        raise part.fail("a splined lens has no residual; write the file again.")
    if len(amplitude) != counts[0] * counts[1]:
        raise part.fail(
            f"'amplitude_px' must have {counts[0]} x {counts[1]} rows, not {len(amplitude)}; write the file again."
        )
    if np.any(np.abs(amplitude) > _MOST_AMPLITUDE_PX):
        raise part.fail(f"'amplitude_px' has numbers above {_MOST_AMPLITUDE_PX:g}; write the file again.")
    return ResidualLens(lens, amplitude, counts)


def _pose_record(pose: Pose) -> dict[str, Any]:
    return {
        "matrix": pose.b_from_a.tolist(),
        "sigma_arcmin": pose.sigma_arcmin.tolist(),
        "sigma_mm": pose.sigma_mm.tolist(),
    }


def _pull_record(pull: Pull) -> dict[str, Any]:
    return {"kind": pull.kind, "value": pull.reduced, "freedom": pull.freedom, "probability": pull.probability}

"""Read and write station-EYE.json, the calibrated bench.

Device frame (OpenXR), metres; cameras have OpenCV's axes and pixels count from the outer corner of the top-left pixel.
"""

from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from wlr_render.calibration.bench.board_shape import BoardShape
from wlr_render.calibration.bench.board_views import EYEBALL, TRACKING
from wlr_render.calibration.bench.calibrate_bench import CalibratedBench
from wlr_render.calibration.poses import Pose, adjoint
from wlr_render.captures.camera_lens_file import require_plausible_lens
from wlr_render.errors import BadInputError
from wlr_render.io.toml_files import Table, read_json, write_json
from wlr_render.lenses.lens import Lens
from wlr_render.lenses.lens_camera import LensCamera
from wlr_render.lenses.residual_lens import ResidualLens
from wlr_render.lenses.splined_lens import SplinedLens

_UNITS = {"length": "m", "angle": "rad", "pixel": "px"}
FORMAT = "wlr-station"
VERSION = 3
_MOST_AMPLITUDE_PX = 100.0  # largest amplitude of a residual, beyond any lens model's
_MOST_WAVES = 20  # most half waves of a residual along a side


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
    return write_json(path, content)


def read_station(path: str | Path) -> Table:
    """Return the content of station-EYE.json, of this version or of version 1.

    Raises:
        BadInputError: the file is missing, or its format, version, frame or units are wrong.
    """
    table = read_json(path, "a station file", "`calibrate` writes it, of photographs")
    table.text("format", choices=[FORMAT])
    if (version := table.number("version")) not in (1, VERSION):
        raise table.fail(f"has version {version:g}, and versions 1 and {VERSION} can be read; write it again.")
    table.text("frame", choices=["openxr"])
    if table.has("units") and table.raw("units") != _UNITS:
        raise table.fail(f"'units' must be {_UNITS}; convert the file, or write it again.")
    return table


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


def _counts(table: Table) -> tuple[int, int]:
    """Return the numbers of half waves of a residual along both sides."""
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


def read_lens(table: Table) -> Lens:
    """Return the lens of a camera of a station file.

    Raises:
        BadInputError: the table does not describe a valid lens.
    """
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

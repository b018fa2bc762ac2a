"""Write a session as a bench delivers it: bench.toml with display.csv.gz and seethrough.csv.gz, or runtime.csv.gz.

The bench file always states the bench as its makers believe it to be.
"""

import gzip
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from oracle.captures import (
    CAMERA_CENTRE_PX,
    CAMERA_FOCAL_PX,
    CAMERA_SIZE_PX,
    TARGET_DISTANCES_MM,
    Plan,
    device_from_target,
    stage_origin,
)
from oracle.devices import own_device
from oracle.effects import Effect
from oracle.nature import PERFECT, BenchNature
from oracle.run_time import RunTimePlan, RunTimeSession, observe_run_time
from oracle.session import observe
from wlr_render.io.atomic_files import output_folder, write_bytes, write_text

_DECIMALS = {"time_s": 1, "stage": 6, "target": 4, "pixel": 4}
_CAMERA_DECIMALS = {"display": 3, "seethrough": 4}


def write_session(
    folder: str | Path,
    plan: Plan,
    effects: Sequence[Effect],
    rng: np.random.Generator,
    nature: BenchNature = PERFECT,
) -> None:
    """Observe a bench and write what it delivers; points that were not seen are left out.

    Raises:
        BadInputError: the plan names a device that does not exist, or the folder cannot be written.
    """
    session = observe(plan, effects, rng, nature)
    out = output_folder(folder)
    write_text(out / "bench.toml", _bench_text(plan) + _poses_text(plan))
    _write_table(out, "display", session.display[np.isfinite(session.display["pixel_u"])])
    _write_table(out, "seethrough", session.seethrough[np.isfinite(session.seethrough["camera_u"])])


def write_run_time_session(
    folder: str | Path,
    plan: RunTimePlan,
    effects: Sequence[Effect],
    rng: np.random.Generator,
    nature: BenchNature = PERFECT,
) -> None:
    """Observe glasses in motion and write it; moments at which a dot was not seen are left out.

    Raises:
        BadInputError: the plan names a device that does not exist, or the folder cannot be written.
    """
    session = observe_run_time(plan, effects, rng, nature)
    out = output_folder(folder)
    write_text(out / "bench.toml", _bench_text(plan))
    seen = np.isfinite(session.virtual).all(axis=1) & np.isfinite(session.real).all(axis=1)
    columns = {name: values[seen] for name, values in _run_time_columns(session).items()}
    lines = [",".join(columns)]
    for row in zip(*columns.values(), strict=True):
        lines.append(",".join(f"{value:.12g}" for value in row))
    _write_lines(out, "runtime", lines)


def _run_time_columns(session: RunTimeSession) -> dict[str, NDArray[np.float64] | NDArray[np.int64]]:
    """The table's columns, by the names of the format."""
    motion = session.motion
    vectors = {
        "head_{}_mm": motion.place,
        "head_velocity_{}_mm_s": motion.velocity,
        "head_rate_{}_rad_s": motion.rate,
        "viewpoint_{}_mm": motion.viewpoint,
        "gaze_{}": motion.gaze,
        "dot_{}_mm": motion.dot,
    }
    quaternion = Rotation.from_matrix(motion.axes).as_quat()
    return {
        "capture": motion.recording,
        "time_s": motion.time_s,
        **{name.format(axis): values[:, i] for name, values in vectors.items() for i, axis in enumerate("xyz")},
        **{f"head_q{axis}": quaternion[:, i] for i, axis in enumerate("xyzw")},
        **{f"virtual_{axis}": session.virtual[:, i] for i, axis in enumerate("uv")},
        **{f"real_{axis}": session.real[:, i] for i, axis in enumerate("uv")},
    }


def _bench_text(plan: Plan | RunTimePlan) -> str:
    eye = own_device(plan.device).eye
    width, height = CAMERA_SIZE_PX
    cx, cy = CAMERA_CENTRE_PX
    return f"""# millimetres; x right, y down, z forward
format = "bench-session"
version = 1
frame = "opencv"
unit = "mm"
device = "{plan.device}"

[camera]
width = {width:.0f}
height = {height:.0f}
fx = {CAMERA_FOCAL_PX:.1f}
fy = {CAMERA_FOCAL_PX:.1f}
cx = {cx:.1f}
cy = {cy:.1f}
point_sigma_px = {plan.sigma_px:g}

[stage]
origin = {_list(stage_origin(eye))}
"""


def _poses_text(plan: Plan) -> str:
    eye = own_device(plan.device).eye
    return "".join(_pose_text(plan, k, eye) for k in range(len(TARGET_DISTANCES_MM)))


def _pose_text(plan: Plan, target_pose: int, eye: NDArray[np.float64]) -> str:
    rotation, translation = device_from_target(target_pose, eye)
    rows = ", ".join(_list(row) for row in rotation)
    return f"""
[[target_pose]]
rotation = [{rows}]
translation = {_list(translation)}
pitch_mm = {plan.pitch_mm(target_pose):g}
"""


def _list(values: NDArray[np.float64]) -> str:
    return f"[{', '.join(f'{value:.10g}' for value in values)}]"


def _write_table(folder: Path, name: str, table: NDArray[np.void]) -> None:
    columns = table.dtype.names or ()
    formats = [_format(column, name, table.dtype[column]) for column in columns]
    _write_lines(folder, name, [",".join(columns), *(",".join(formats) % tuple(row) for row in table.tolist())])


def _write_lines(folder: Path, name: str, lines: Sequence[str]) -> None:
    # No time stamp: the same session is the same file.
    write_bytes(folder / f"{name}.csv.gz", gzip.compress("\n".join([*lines, ""]).encode("ascii"), 6, mtime=0))


def _format(column: str, table: str, kind: np.dtype[np.generic]) -> str:
    if kind.kind == "i":
        return "%d"
    if column.startswith("camera"):
        return f"%.{_CAMERA_DECIMALS[table]}f"
    return next(f"%.{decimals}f" for start, decimals in _DECIMALS.items() if column.startswith(start))

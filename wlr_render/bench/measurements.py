"""Load the measurements of an eye, a bench session or captures, with the bench model that should explain them.

Captures state positions of the camera and directions of panel pixels and dots. They need no description of a real
camera or stage: `direction_bench` replaces both by an ideal pinhole camera of one arcminute per pixel.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import scipy

from wlr_render.bench.bench import Bench, EyeballCamera, Stage, Target
from wlr_render.bench.bench_file import load_bench
from wlr_render.bench.session_captures import LEAST_SIGMA_PX, session_of
from wlr_render.bench.session_folder import load_session
from wlr_render.captures.capture_file import load_observations
from wlr_render.captures.correspondences import Captures, SeeThroughCaptures
from wlr_render.captures.session import Session
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import ARCMIN, normalised, tangents_of_dir
from wlr_render.geometry.transforms import rigid
from wlr_render.io.atomic_files import shipped_names
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device import Device
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import TRACED

_MARGIN = 0.02  # margin of the camera's picture on each side, as a share of the range of directions
_LEAST_SPREAD_M = 1e-4  # least spread of points that determine a target's pose
_DECIMALS = 12


def load_measurements(
    path: str | Path, bench_file: str | Path | None = None, device: str | Path | None = None
) -> tuple[Bench, Session]:
    """Read a bench session, a capture file, or the captures in the output folder of a calibration.

    Args:
        path: folder of a bench session or of a calibration, or a capture file.
        bench_file: bench for the comparison. A session keeps its own target poses and the stated noise of its readings
            (`bench_for_session`); for captures, the file may lack target poses.
        device: name or file of the headset for a comparison with captures (default: the shipped one named in them).

    Raises:
        BadInputError: a file is missing or breaks its format, or bench, device and captures do not fit each other.
    """
    path = Path(path)
    file = path if path.is_file() else _captures_in(path, bench_file)
    if file is None:
        if device is not None:
            raise BadInputError(
                f"{path}: is neither a calibration's folder nor a capture file, so --device does not apply; name "
                "another bench by --bench."
            )
        return load_session(path, bench_file)
    if bench_file is not None and device is not None:
        raise BadInputError("--bench and --device both state the headset; give one of them.")
    measured = load_observations(file)
    name = measured.source.device.removesuffix(TRACED)
    if bench_file is None:
        bench = direction_bench(load_device(device) if device else _named_device(name, file), measured, file)
        stated, panel = measured.panel, bench.optics.panel.pixels
        if stated is not None and stated != panel:
            raise BadInputError(
                f"{file}: is of a panel of {stated.width_px} x {stated.height_px} pixels, but {bench.device.name} "
                f"has {panel.width_px} x {panel.height_px}; name the headset that was measured."
            )
        name = bench.device.name  # the captures may name the headset differently
    else:
        bench = load_bench(bench_file)
        if len(bench.target.pitch) == 0:
            bench = replace(bench, target=_target(measured.see_through, file))
    return bench, session_of(bench, measured.of_device(name), path.stem if path.is_file() else path.resolve().name)


def direction_bench(device: Device, captures: Captures, source: str | Path) -> Bench:
    """Return the bench of captures: the device, its targets, and a camera of one arcminute per pixel.

    Args:
        device: the nominal device.
        captures: the measured captures.
        source: name of the captures, for messages.

    Raises:
        BadInputError: the device has no such eye, or the points of a target pose do not fix its pose.
    """
    eye, parts = captures.source.eye, captures.parts
    if eye not in device.eyes:
        raise BadInputError(f"{source}: is of the {eye} eye, which {device.name} does not have.")
    turned, view_dir, sigma_arcmin = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("device_from_camera", "view_dir", "sigma_arcmin")
    )
    alike = np.isfinite(turned).all() and np.all(np.ptp(turned, axis=0) < 10.0**-_DECIMALS)
    device_from_camera = turned[0] if alike else np.eye(3)
    rotations = np.where(np.isfinite(turned), turned, device_from_camera)
    tangents = tangents_of_dir(np.einsum("nji,nj->ni", rotations, view_dir))
    low, high = tangents.min(axis=0), tangents.max(axis=0)
    margin = _MARGIN * (high - low) + ARCMIN
    size = np.ceil((high - low + 2.0 * margin) / ARCMIN)
    centre = np.array([margin[0] - low[0], high[1] + margin[1]]) / ARCMIN
    # Off the axis of a pinhole, an angle covers more pixels: geometric mean of the radial and tangential scale.
    per_arcmin = (1.0 + np.sum(tangents**2, axis=1)) ** 0.75
    sigma_px = max(LEAST_SIGMA_PX, float(np.sqrt(np.mean((sigma_arcmin * per_arcmin) ** 2))))
    camera = EyeballCamera(
        size, np.full(2, 1.0 / ARCMIN), centre, sigma_px, device_from_camera=np.asarray(device_from_camera)
    )
    stage = Stage(np.array(captures.source.eye_box.centre))
    return Bench(device, eye, camera, stage, _target(captures.see_through, source))


def _captures_in(folder: Path, bench_file: str | Path | None) -> Path | None:
    """Return the capture file in a calibration's output folder; None in another folder."""
    files = sorted(folder.glob("captures-*.npz"))
    if (folder / "bench.toml").exists() or not files:
        return None
    if len(files) > 1 and bench_file is not None:
        wanted = f"captures-{load_bench(bench_file).eye}.npz"
        files = [path for path in files if path.name == wanted] or files
    if len(files) > 1:
        raise BadInputError(f"{folder}: has {' and '.join(path.name for path in files)}; name one of these files.")
    return files[0]


def _named_device(name: str, source: Path) -> Device:
    if name in shipped_names("devices", ".toml"):
        return load_device(name)
    raise BadInputError(
        f"{source}: is of '{name}', which is not a shipped device; name its prescription by --device, "
        "or a bench by --bench."
    )


def _target(captures: SeeThroughCaptures | None, source: str | Path) -> Target:
    """Return the target at its observed poses; a pose without captures repeats the previous one."""
    if captures is None:
        return Target(np.zeros((0, 4, 4)), np.zeros(0))
    numbers = np.unique(captures.target_pose)
    poses, pitches = [], []
    for number in numbers:
        rows = captures.target_pose == number
        pose = _pose(captures.point[rows], captures.target_point[rows])
        if pose is None:
            raise BadInputError(f"{source}: target pose {number} has no three points off one line; leave it out.")
        poses.append(pose)
        pitches.append(_pitch(captures.point[rows]))
    of_number = np.searchsorted(numbers, np.arange(numbers[-1] + 1), side="right").clip(1) - 1
    return Target(np.stack(poses)[of_number], np.array(pitches)[of_number])


def _pose(point: FloatArray, on_target: FloatArray) -> FloatArray | None:
    """Fit the pose (4, 4) of a target to points (n, 3) in the device's and target's frames; None if undetermined.

    If the points in the target's frame are unknown, the pose is a least-squares plane, with x to the right.
    """
    centre = point.mean(axis=0)
    _, spread, axes = np.linalg.svd(point - centre, full_matrices=False)
    if len(point) < 3 or spread[1] / np.sqrt(len(point)) < _LEAST_SPREAD_M:
        return None
    defined = np.isfinite(on_target).all(axis=1)
    if defined.sum() >= 3:
        own_centre, at = on_target[defined].mean(axis=0), point[defined].mean(axis=0)
        there, here = on_target[defined] - own_centre, point[defined] - at
        rotation = scipy.spatial.transform.Rotation.align_vectors(here, there)[0].as_matrix()
        return rigid(rotation, at - rotation @ own_centre)
    normal = axes[2] * np.sign(axes[2, 2])
    right = normalised(np.array([1.0, 0.0, 0.0]) - normal[0] * normal)
    return rigid(np.column_stack([right, np.cross(normal, right), normal]), centre)


def _pitch(point: FloatArray) -> float:
    """Return the median distance of neighbouring points."""
    places = np.unique(np.round(point, 6), axis=0)
    return float(np.median(scipy.spatial.KDTree(places).query(places, k=2)[0][:, 1]))

"""Read and write bench files, the nominal bench as TOML (format: docs/bench-session.md)."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from wlr_render.bench.bench import (
    Bench,
    Clock,
    EyeballCamera,
    EyeTracking,
    Mount,
    PanelReadout,
    Stage,
    Target,
    Tracking,
)
from wlr_render.bench.bench_effects_file import effect_keys, effects_of
from wlr_render.bench.bench_keys import MATRIX, POINT, POSITIVE, ROTATION, SECTIONS, Entry
from wlr_render.captures.session_schema import MM
from wlr_render.errors import BadInputError
from wlr_render.geometry.transforms import FRAMES, rigid
from wlr_render.io.atomic_files import shipped_names
from wlr_render.io.toml_files import Table, read_toml, write_toml
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device import Device
from wlr_render.optics.device_file import load_device
from wlr_render.optics.device_writer import device_content, save_device

_MOST_POSES = 10_000
_MOST_SIGMA = 1e6
FORMAT = "bench-session"
VERSION = 1
WRITTEN_FRAME = "opencv"
"""Frame of the files that `save_bench` writes."""

_ROTATION = Entry("rotation", ("rotation",), "three rows", (3, 3), MATRIX, ROTATION)
_TRANSLATION = Entry("translation", ("translation",), "mm", (3,), POINT, largest=1e5)
_PITCH = Entry("pitch", ("pitch_mm",), "distance of neighbouring dots", rule=POSITIVE)


DEVICE_FILE = "device.toml"
"""Name of the device file next to the bench, for a headset that is not shipped."""


def load_bench(path: str | Path) -> Bench:
    """Read a bench file.

    Raises:
        BadInputError: the file or its device does not exist, or it breaks the format; the sentence says where.
    """
    return bench_of(read_toml(path), Path(path).parent)


def device_from_file(file: Table) -> FloatArray:
    """Return the rotation (3, 3) from the axes that an opened bench file states to the device frame's."""
    return FRAMES[file.text("frame", choices=sorted(FRAMES))]


def bench_of(file: Table, folder: Path) -> Bench:
    """Build a bench from an opened file; every key must be known.

    Args:
        file: the opened file.
        folder: folder that the path of a device file is relative to.
    """
    file.check_head(FORMAT, VERSION, "a bench file")
    axes = device_from_file(file)
    device = _device(file, folder)
    eye = file.text("eye", "right" if "right" in device.eyes else "left", choices=sorted(device.eyes))
    stated = {name: _section(file, name, axes) for name in SECTIONS}
    bench = Bench(
        device,
        eye,
        EyeballCamera(**stated["camera"]),
        Stage(**stated["stage"]),
        _target(file, stated["target"], axes),
        Tracking(_pose(file.table("tracking"), axes)) if file.has("tracking") else Tracking(),
        Mount(**stated["mount"]),
        PanelReadout(**stated["readout"]),
        EyeTracking(**stated["eye_tracking"]),
        Clock(**stated["clock"]),
    )
    priors, effects = _priors(file), effects_of(file, bench)
    file.finish()
    return replace(bench, **stated["light"], priors=priors, effects=effects)


def save_bench(bench: Bench, path: str | Path) -> Path:
    """Write a bench that `load_bench` reads back, to the rounding of its numbers.

    A device that differs from every shipped one is written next to it as device.toml.
    """
    path, axes = Path(path), FRAMES[WRITTEN_FRAME]
    head = {"format": FORMAT, "version": VERSION, "frame": WRITTEN_FRAME, "unit": "mm"}
    head |= {"device": _device_key(bench.device, path.parent), "eye": bench.eye}
    sections = _sections(bench, axes)
    poses = [
        _pose_keys(pose, axes) | {"pitch_mm": pitch / MM}
        for pose, pitch in zip(bench.target.device_from_target, bench.target.pitch, strict=True)
    ]
    content = head | {name: keys for name, keys in sections.items() if keys}
    content |= {"prior": bench.priors} if bench.priors else {}
    content |= {"effect": [effect_keys(effect) for effect in bench.effects]} if bench.effects else {}
    return write_toml(path, content | ({"target_pose": poses} if poses else {}), "docs/bench-session.md has the format")


def changed_keys(old: Bench, new: Bench) -> dict[str, dict[str, Any]]:
    """Return the keys of a bench file, by table, that turn the old bench into the new one, in frame `WRITTEN_FRAME`."""
    before, after = (_sections(bench, FRAMES[WRITTEN_FRAME]) for bench in (old, new))
    changed: dict[str, dict[str, Any]] = {}
    for table, keys in after.items():
        old_keys = before[table]
        changed[table] = {k: v for k, v in keys.items() if k not in old_keys or not np.array_equal(v, old_keys[k])}
    return {table: keys for table, keys in changed.items() if keys}


def _sections(bench: Bench, axes: FloatArray) -> dict[str, dict[str, Any]]:
    """Return the tables of a bench file with their keys, except device and target poses."""
    values = {name: bench if name == "light" else getattr(bench, name) for name in SECTIONS}
    sections = {name: section.written(values[name], axes) for name, section in SECTIONS.items()}
    reported = bench.tracking.true_from_reported
    sections["tracking"] = {} if np.array_equal(reported, np.eye(4)) else _pose_keys(reported, axes)
    return sections


def _device(file: Table, folder: Path) -> Device:
    spec = file.text("device")
    try:
        return load_device(file.path("device", folder) if spec.endswith(".toml") else spec)
    except BadInputError as error:
        raise file.fail(f"'device': {error}") from error


def _device_key(device: Device, folder: Path) -> str:
    shipped = device.name in shipped_names("devices", ".toml")
    if shipped and device_content(load_device(device.name)) == device_content(device):
        return device.name
    return save_device(device, folder / DEVICE_FILE).name


def _section(file: Table, name: str, axes: FloatArray) -> dict[str, Any]:
    """Return the attributes that the table states; [camera] and [stage] are required."""
    required = name in ("camera", "stage")
    return SECTIONS[name].read(file.table(name), axes) if required or file.has(name) else {}


def _priors(file: Table) -> dict[str, dict[str, tuple[float, float]]]:
    """Read the [prior.CAUSE] tables; their names are checked by the module that defines the causes."""
    if not file.has("prior"):
        return {}
    table = file.table("prior")
    return {cause: _priors_of_cause(table.table(cause)) for cause in table.keys()}  # noqa: SIM118 (a Table)


def _priors_of_cause(table: Table) -> dict[str, tuple[float, float]]:
    priors = {}
    for name in table.keys():  # noqa: SIM118 (a Table)
        if isinstance(table.raw(name), dict):
            pair = table.table(name)
            mean, sigma = pair.number("mean", 0.0), pair.number("sigma")
            pair.finish()
        else:
            mean, sigma = table.vector(name, 2).tolist()
        if not 0.0 < sigma < _MOST_SIGMA or abs(mean) > _MOST_SIGMA:
            raise table.fail(
                f"the mean and sigma of '{name}' are {mean:g} and {sigma:g}; they must be at most {_MOST_SIGMA:g}, and "
                "the sigma above 0."
            )
        priors[name] = (mean, sigma)
    return priors


def _target(file: Table, stated: dict[str, Any], axes: FloatArray) -> Target:
    tables = file.tables("target_pose", required=False, most=_MOST_POSES)
    pitch = [MM * float(_PITCH.read(table, axes)) for table in tables]
    poses = [_pose(table, axes) for table in tables]
    if len(stated.get("bow", [0])) not in (1, len(poses)):
        raise file.fail(f"'bow_per_m' in [target] must be one pair, or {len(poses)}: one for each [[target_pose]].")
    return Target(np.reshape(poses, (-1, 4, 4)), np.array(pitch), **stated)


def _pose(table: Table, axes: FloatArray) -> FloatArray:
    """Read a pose (4, 4) from `rotation` and `translation`, the last keys of their table."""
    pose = rigid(np.asarray(_ROTATION.read(table, axes)), np.asarray(_TRANSLATION.read(table, axes)))
    table.finish()
    return pose


def _pose_keys(pose: FloatArray, axes: FloatArray) -> dict[str, Any]:
    return _ROTATION.written(pose[:3, :3], axes) | _TRANSLATION.written(pose[:3, 3], axes)

"""Read and write bench files: the nominal bench as TOML (format: docs/bench-session.md)."""

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
    TargetPose,
    Tracking,
)
from wlr_render.bench.bench_effects_file import effect_keys, effects_of
from wlr_render.errors import BadInputError
from wlr_render.geometry.transforms import FRAMES
from wlr_render.io.atomic_files import shipped_names
from wlr_render.io.file_records import Place, read_record, record_keys
from wlr_render.io.toml_files import Table, read_toml, write_toml
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device import Device
from wlr_render.optics.device_file import device_content, load_device, save_device

_MOST_POSES = 10_000
_MOST_SIGMA = 1e6
FORMAT = "bench-session"
VERSION = 1
WRITTEN_FRAME = "opencv"
"""Frame of the files that `save_bench` writes."""
SECTIONS = {
    "camera": EyeballCamera,
    "stage": Stage,
    "target": Target,
    "mount": Mount,
    "readout": PanelReadout,
    "eye_tracking": EyeTracking,
    "clock": Clock,
    "light": Bench,
    "tracking": Tracking,
}
"""Classes of a bench file's tables, by name; [target] is without its poses, and [light] is for `Bench` itself."""
_WRITTEN = Place(axes=FRAMES[WRITTEN_FRAME])
DEVICE_FILE = "device.toml"
"""Name of the device file next to the bench, for a headset that is not shipped."""


def load_bench(path: str | Path) -> Bench:
    """Read a bench file.

    Raises:
        BadInputError: the file or its device does not exist, or it breaks the format; the message says where.
    """
    return bench_of(read_toml(path), Path(path).parent)


def device_from_file(file: Table) -> FloatArray:
    """Return the rotation (3, 3) from the axes of an opened bench file to the device frame's axes."""
    return FRAMES[file.text("frame", choices=sorted(FRAMES))]


def bench_of(file: Table, folder: Path) -> Bench:
    """Build a bench from an opened file; every key must be known.

    Args:
        file: the opened file.
        folder: folder to which the path of a device file is relative.
    """
    file.check_head(FORMAT, VERSION)
    file.check_unit("a bench file")
    place = Place(folder, device_from_file(file))
    device = _device(file, folder)
    eye = file.text("eye", "right" if "right" in device.eyes else "left", choices=sorted(device.eyes))
    parts: dict[str, Any] = {
        name: read_record(kind, file.table(name), place)
        for name, kind in SECTIONS.items()
        if name in ("camera", "stage") or (name not in ("target", "light") and file.has(name))
    }
    parts |= {"device": device, "eye": eye, "target": _target(file, place)}
    bench = read_record(Bench, _optional(file, "light"), **parts)
    bench = replace(bench, priors=_priors(file), effects=effects_of(file, bench))
    file.finish()
    return bench


def save_bench(bench: Bench, path: str | Path) -> Path:
    """Write a bench that `load_bench` reads back, except for rounding of its numbers.

    A device that differs from every shipped one is written next to it as device.toml.
    """
    path = Path(path)
    head = {"format": FORMAT, "version": VERSION, "frame": WRITTEN_FRAME, "unit": "mm"}
    head |= {"device": _device_key(bench.device, path.parent), "eye": bench.eye}
    poses = [
        record_keys(TargetPose(pose, pitch), _WRITTEN)
        for pose, pitch in zip(bench.target.device_from_target, bench.target.pitch, strict=True)
    ]
    content = head | {name: keys for name, keys in _sections(bench).items() if keys}
    content |= {"prior": bench.priors} if bench.priors else {}
    content |= {"effect": [effect_keys(effect) for effect in bench.effects]} if bench.effects else {}
    return write_toml(path, content | ({"target_pose": poses} if poses else {}), "docs/bench-session.md has the format")


def changed_keys(old: Bench, new: Bench) -> dict[str, dict[str, Any]]:
    """Return the keys of a bench file, by table, that differ in the new bench, in frame `WRITTEN_FRAME`."""
    before, after = _sections(old), _sections(new)
    changed: dict[str, dict[str, Any]] = {}
    for table, keys in after.items():
        old_keys = before[table]
        changed[table] = {k: v for k, v in keys.items() if k not in old_keys or not np.array_equal(v, old_keys[k])}
    return {table: keys for table, keys in changed.items() if keys}


def _sections(bench: Bench) -> dict[str, dict[str, Any]]:
    """Return the tables of a bench file with their keys, except device and target poses."""
    return {name: record_keys(getattr(bench, name, bench), _WRITTEN) for name in SECTIONS}


def _optional(file: Table, name: str) -> Table:
    return file.table(name) if file.has(name) else Table({}, file.where)


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


def _priors(file: Table) -> dict[str, dict[str, tuple[float, float]]]:
    """Read the [prior.CAUSE] tables; the module that defines the causes checks the names."""
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


def _target(file: Table, place: Place) -> Target:
    tables = file.tables("target_pose", required=False, most=_MOST_POSES)
    poses = [read_record(TargetPose, table, place) for table in tables]
    placed = {
        "device_from_target": np.reshape([each.device_from_target for each in poses], (-1, 4, 4)),
        "pitch": np.array([each.pitch for each in poses]),
    }
    target = read_record(Target, _optional(file, "target"), place, **placed)
    if len(target.bow) not in (1, len(poses)):
        raise file.fail(f"'bow_per_m' in [target] must be one pair, or {len(poses)}: one for each [[target_pose]].")
    return target

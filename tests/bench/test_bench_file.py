"""Bench files: what is saved is loaded, frames and units come out right, and faults are named in one sentence."""

from dataclasses import MISSING, fields, is_dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from wlr_render.bench.bench import (
    Bench,
    EyeballCamera,
    Stage,
    Target,
)
from wlr_render.bench.bench_effects import KINDS
from wlr_render.bench.bench_file import SECTIONS, load_bench, save_bench
from wlr_render.errors import BadInputError
from wlr_render.geometry.transforms import rigid
from wlr_render.io.file_records import attributes
from wlr_render.io.toml_files import read_toml
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device import Device
from wlr_render.optics.device_file import device_content, load_device

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Part = TypeVar("Part", bound="DataclassInstance")

DOCUMENT = Path(__file__).parents[2] / "docs" / "bench-session.md"
TOML = """
format = "bench-session"
version = 1
frame = "opencv"
unit = "mm"
device = "northstar"

[camera]
width = 1280
height = 1024
fx = 1350.0
fy = 1340.0
cx = 640.0
cy = 512.0
point_sigma_px = 0.1

[stage]
origin = [32, 1, 33]

[target]
bow_per_m = [[0.1, 0.2]]

[[target_pose]]
rotation = [[1, 0, 0], [0, 0.8, -0.6], [0, 0.6, 0.8]]
translation = [32, 2, 600]
pitch_mm = 21.6
"""


def written(tmp_path: Path, *changes: tuple[str, str]) -> Path:
    """Path of the file above with some text replaced: (old, new) pairs."""
    text = TOML
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    path = tmp_path / "bench.toml"
    path.write_text(text, encoding="utf-8")
    return path


def random_rigid(rng: np.random.Generator, *shape: int) -> FloatArray:
    count = int(np.prod(shape))
    return rigid(Rotation.random(count, rng=rng).as_matrix(), rng.normal(size=(count, 3))).reshape(*shape, 4, 4)


def disturbed(
    part: Part,
    rng: np.random.Generator,
) -> Part:
    """A copy of a bench or of a part of it with every number changed, and rotations for rotations."""
    changes: dict[str, Any] = {}
    for field in fields(part):
        value = getattr(part, field.name)
        if field.name in ("device", "eye", "size_px"):
            continue
        if field.name == "priors":
            changes[field.name] = {"latency": {"latency": tuple(rng.uniform(1.0, 2.0, 2).tolist())}}
        elif is_dataclass(value) and not isinstance(value, type):
            changes[field.name] = disturbed(value, rng)
        elif field.name == "device_from_camera":
            changes[field.name] = Rotation.random(rng=rng).as_matrix()
        elif field.name in ("device_from_target", "true_from_reported"):
            changes[field.name] = random_rigid(rng, *np.shape(value)[:-2])
        elif field.name == "slip_time_s":
            changes[field.name] = rng.uniform(0, 2000)
        else:
            other = np.asarray(value) + rng.uniform(0.01, 0.1, np.shape(value))
            changes[field.name] = other if isinstance(value, np.ndarray) else type(value)(other)
    return replace(part, **changes)


def plain_bench(device: Device, poses: int, rng: np.random.Generator) -> Bench:
    camera = EyeballCamera(np.array([640.0, 480.0]), np.array([700.0, 710.0]), np.array([320.0, 240.0]), 0.1)
    target = Target(random_rigid(rng, poses), np.full(poses, 0.02))
    return Bench(device, "left", camera, Stage(np.array([-0.032, 0.0, -0.033])), target)


def assert_same(
    found: object,
    expected: "DataclassInstance",
) -> None:
    for field in fields(expected):
        a, b = getattr(found, field.name), getattr(expected, field.name)
        if field.name == "device":
            assert device_content(a) == device_content(b)
        elif is_dataclass(b) and not isinstance(b, type):
            assert_same(a, b)
        elif isinstance(b, str | dict):
            assert a == b
        else:
            assert type(a) is type(b), field.name
            np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12, err_msg=field.name)


@pytest.mark.parametrize("seed", range(5))
def test_what_is_saved_is_loaded(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    bench = disturbed(plain_bench(load_device("northstar"), seed, rng), rng)
    assert_same(load_bench(save_bench(bench, tmp_path / "bench.toml")), bench)
    assert not (tmp_path / "device.toml").exists()


def test_a_bench_as_built_is_saved_without_further_keys(tmp_path: Path) -> None:
    bench = load_bench(written(tmp_path, ("[target]\nbow_per_m = [[0.1, 0.2]]\n", "")))
    path = save_bench(bench, tmp_path / "again.toml")
    content = read_toml(path)
    assert content.keys() == ["format", "version", "frame", "unit", "device", "eye", "camera", "stage", "target_pose"]
    assert content.table("stage").keys() == ["origin"]
    assert_same(load_bench(path), bench)


def test_a_changed_device_is_written_beside_its_bench(tmp_path: Path) -> None:
    bench = load_bench(written(tmp_path))
    optics = bench.optics.with_media(lambda medium: medium.shifted(0.001))
    changed = replace(bench, device=replace(bench.device, eyes=bench.device.eyes | {"right": optics}))
    path = save_bench(changed, tmp_path / "out" / "bench.toml")
    assert read_toml(path).text("device") == "device.toml"
    assert load_bench(path).optics.display.steps[0].medium.index(0.55) == optics.display.steps[0].medium.index(0.55)
    assert device_content(load_bench(path).device) != device_content(bench.device)


def test_units_frame_and_pixels_become_ours(tmp_path: Path) -> None:
    bench = load_bench(written(tmp_path))
    assert bench.eye == "right"
    np.testing.assert_allclose(bench.stage.origin, [0.032, -0.001, -0.033])
    np.testing.assert_allclose(bench.camera.focal_px, [1350.0, 1340.0])
    np.testing.assert_allclose(bench.camera.centre_px, [640.5, 512.5])
    np.testing.assert_allclose(bench.target.pitch, [0.0216])


def test_a_point_of_the_bowed_target_is_where_the_file_says(tmp_path: Path) -> None:
    target = load_bench(written(tmp_path)).target
    x, y = 0.3, 0.4
    rotation = np.array([[1, 0, 0], [0, 0.8, -0.6], [0, 0.6, 0.8]])
    in_file = rotation @ [x, y, 0.1 * x**2 + 0.2 * y**2] + [0.032, 0.002, 0.6]
    ours = np.array([x, -y, target.bow[0] @ np.square([x, -y]), 1.0])
    np.testing.assert_allclose(target.device_from_target[0] @ ours, [*(in_file * [1, -1, -1]), 1.0], atol=1e-15)


def test_in_the_openxr_frame_numbers_are_as_in_the_file(tmp_path: Path) -> None:
    bench = load_bench(written(tmp_path, ('"opencv"', '"openxr"')))
    np.testing.assert_allclose(bench.stage.origin, [0.032, 0.001, 0.033])
    np.testing.assert_allclose(bench.target.device_from_target[0, 1], [0, 0.8, -0.6, 0.002])
    np.testing.assert_allclose(bench.target.bow, [[0.1, 0.2]])


def test_priors_are_pairs_or_tables(tmp_path: Path) -> None:
    stated = "[prior.a]\nx = [1, 2]\ny = {mean = 3, sigma = 4}\n[prior.b]\nz = {sigma = 0.5}\n[target]"
    bench = load_bench(written(tmp_path, ("[target]", stated)))
    assert bench.priors == {"a": {"x": (1.0, 2.0), "y": (3.0, 4.0)}, "b": {"z": (0.0, 0.5)}}


EFFECT = """[[effect]]
station = "time"
displaces = "shift"
low = [0]
high = [5]
orders = [[1]]
coefficients = [[0.1, 0.2]]
[target]"""

CELLS = EFFECT.replace("low = [0]", "cell_size = 1").replace("high = [5]", "cells = [[2.5], [7.5]]")
CELLS = CELLS.replace("orders = [[1]]\n", "").replace("[[0.1, 0.2]]", "[[0.1, 0.2], [0.3, 0.4]]")
WAVE = EFFECT.replace("low = [0]", "along = 0").replace("high = [5]", "period = 2").replace("orders = [[1]]\n", "")


ELSEWHERE = EFFECT.replace('"time"', '"panel"').replace("[0]", "[-900, 0]").replace("[5]", "[-100, 9]")
ELSEWHERE = ELSEWHERE.replace("[[1]]", "[[1, 0]]")
ON_STAGE = EFFECT.replace('"time"', '"stage"').replace('"shift"', '"pose"')
ON_STAGE = ON_STAGE.replace("[0]", "[0, 0, 0]").replace("[5]", "[9, 9, 9]")


def with_covariance(rows: str) -> str:
    return EFFECT.replace("[target]", f"covariance = {rows}\n[target]")


FAULTS = {
    "unit": ('unit = "mm"', 'unit = "m"', "'unit' is 'm'; a bench file is in mm"),
    "version": ("version = 1", "version = 2", "has version 2; this program reads version 1"),
    "format": ('"bench-session"', '"scene"', "'format' is 'scene'"),
    "frame": ('"opencv"', '"opengl"', "'frame' is 'opengl'; it must be one of opencv, openxr"),
    "device": ('"northstar"', '"nothstar"', "Did you mean northstar?"),
    "device file": ('"northstar"', '"mine.toml"', "mine.toml: there is no such file"),
    "eye": ('"northstar"', '"northstar"\neye = "middle"', "'eye' is 'middle'; it must be one of left, right"),
    "sigma's unit": ("sigma_px", "sigma_mm", "key 'point_sigma_px' is missing (found 'point_sigma_mm' instead)"),
    "sigma is nan": ("sigma_px = 0.1", "sigma_px = nan", "'point_sigma_px' must be finite"),
    "rotation": ("[0, 0.6, 0.8]", "[0, 0.6, 0.9]", "it must be a rotation matrix"),
    "reflection": ("[[1, 0, 0]", "[[-1, 0, 0]", "it must be a rotation matrix"),
    "rows": (", [0, 0.6, 0.8]", "", "'rotation' must be 3 lists of 3 numbers, not 2"),
    "bow": ("[[0.1, 0.2]]", "[[0, 1], [1, 0]]", "'bow_per_m' in [target] must be one pair, or 1"),
    "unknown key": ("[stage]", "[stage]\nbacklash = [0, 0]", "unknown key 'backlash'; did you mean 'backlash_mm'?"),
    "prior's sigma": (
        "[target]",
        "[prior.a]\nb = [1, 0]\n[target]",
        "the mean and sigma of 'b' are 1 and 0; they must",
    ),
    "prior's pair": ("[target]", "[prior.a]\nb = 1.0\n[target]", "'b' must be a list of 2 numbers"),
    "prior's key": ("[target]", "[prior.a]\nb = {sgma = 1}\n[target]", "'sigma' is missing (found 'sgma' instead)"),
    "prior": ("[target]", "[prior]\na = 3\n[target]", "'a' must be a table"),
    "singular": (
        "origin = [32, 1, 33]",
        "origin = [32, 1, 33]\naxes = [[1,0,0],[1,0,0],[0,0,1]]",
        "a matrix of determ",
    ),
    "device elsewhere": ('"northstar"', '"../mine.toml"', "'../mine.toml' leads out of the folder"),
    "effect's station": (
        "[target]",
        '[[effect]]\nstation = "lens"\n[target]',
        "'station' is 'lens'; it must be one of",
    ),
    "effect's kind": (
        "[target]",
        '[[effect]]\nstation = "stage"\ndisplaces = "shift"\n[target]',
        "'displaces' is 'shift'; it must be one of pose",
    ),
    "effect's box": ("[target]", EFFECT.replace("[5]", "[0]"), "'low' must be below 'high' in each of time, s"),
    "effect's many waves": (
        "[target]",
        ON_STAGE.replace("orders = [[1]]", "waves = [[1, 1, 37]]"),
        "'waves' of 3 coordinates must have orders of at most 36",
    ),
    "effect's waves": (
        "[target]",
        EFFECT.replace("orders = [[1]]", "waves = [[0]]"),
        "'waves' must be at most 1000 lists of whole numbers from 1",
    ),
    "effect's orders": ("[target]", EFFECT.replace("[[1]]", "[[0.5]]"), "'orders' must be at most 1000 lists of whole"),
    "effect's terms": ("[target]", EFFECT.replace("[[1]]", "[[1], [2]]"), "one list of 2 numbers (decoded position u"),
    "effect's cells": ("[target]", CELLS.replace("[7.5]", "[2.6]"), "two of 'cells' lie in one cell of 'cell_size' 1"),
    "effect's cell values": ("[target]", CELLS.replace(", [0.3, 0.4]", ""), "each of the 2 lists of 'cells', not 1"),
    "effect's cell size": ("[target]", CELLS.replace("cell_size = 1", "cell_size = 0"), "'cell_size' has the value 0"),
    "effect of a height in cells": (
        "[target]",
        CELLS.replace('"time"', '"combiner"').replace('"shift"', '"all surfaces"'),
        "a height of the combiner needs slopes",
    ),
    "effect's place": (
        "[target]",
        EFFECT.replace('"time"', '"panel"')
        .replace("[0]", "[-900, 0]")
        .replace("[5]", "[-100, 9]")
        .replace("1]", "1, 0]"),
        "'low' and 'high' state coordinates from [-900, 0] to [-100, 9], outside the panel ([0, 0] to [1440, 1600])",
    ),
    "effect's period": ("[target]", WAVE.replace("2\n", "0\n"), "'period' has the value 0; it must be 1e-06 or more"),
    "effect's coordinate": ("[target]", WAVE.replace("g = 0", "g = 1"), "'along' must be a whole number from 0 to 0"),
    "effect's wave": ("[target]", WAVE, "(decoded position u, v, panel px) for the sine and the cosine, not 1"),
    "effect's colour": (
        "[target]",
        EFFECT.replace("low", "channel = 3\nlow"),
        "'channel' must be a whole number from 0 to 2",
    ),
    "effect's part": ("[target]", EFFECT.replace("low", 'part = "display"\nlow'), "unknown key 'part'; remove it"),
    "effect's covariance, size": ("[target]", with_covariance("[[1, 0]]"), "has 1 lists; it must have 2"),
    "effect's covariance, symmetry": ("[target]", with_covariance("[[1, 0.5], [0, 1]]"), "is not symmetric; write the"),
    "effect's covariance, variance": (
        "[target]",
        with_covariance("[[1, 2], [2, 1]]"),
        "'covariance' has the eigenvalue -1, so that it is not a covariance",
    ),
    "no stage": ("[stage]\norigin = [32, 1, 33]", "", "key 'stage' is missing"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_one_sentence_that_names_file_and_key(tmp_path: Path, fault: str) -> None:
    old, new, sentence = FAULTS[fault]
    path = written(tmp_path, (old, new))
    with pytest.raises(BadInputError) as caught:
        load_bench(path)
    assert str(caught.value).startswith(str(path))
    assert sentence in str(caught.value)


def test_the_documentation_has_every_key() -> None:
    lines = DOCUMENT.read_text(encoding="utf-8").splitlines()
    rows = [line.split(" | ") for line in lines if line.startswith("| `[")]
    documented = [(table, keys, meaning.startswith("optional; ")) for table, keys, meaning in rows]
    assert documented == [
        (f"| `[{name}]`", ", ".join(f"`{key}`" for key in each.form.names), each.default is not MISSING)
        for name, record in SECTIONS.items()
        for each in attributes(record)
    ]


def test_the_documentation_has_every_effect() -> None:
    text = DOCUMENT.read_text(encoding="utf-8")
    for (station, displaces), kind in KINDS.items():
        (row,) = (
            line
            for line in text.splitlines()
            if line.startswith(f'| "{station}" |') and f'"{displaces}"' in line.split("|")[2]
        )
        assert [cell.strip() for cell in row.split("|")[3:5]] == [kind.coordinates, kind.displacement]

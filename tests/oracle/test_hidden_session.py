"""The files that a session is written to, and the whole clean generator against a clean measured session."""

import gzip
import os
import tomllib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from present import present

from oracle.captures import Captures, Plan
from oracle.devices import NAMES, own_device
from oracle.effects import draw_effect
from oracle.own_tracer import unit
from oracle.session import display_table, see_through_table
from oracle.session_writer import write_session
from oracle.world import World
from wlr_render.errors import BadInputError
from wlr_render.numerics.arrays import FloatArray

SMALL = Plan(grid=(12, 9), dots=(9, 7))
STAGE = ["stage_x_mm", "stage_y_mm", "stage_z_mm"]

_ROOT = Path(__file__).resolve().parents[2]
CLEAN = Path(os.environ.get("WLR_DATA", _ROOT.parent / "shared")) / "measured" / "M3"


def read(folder: Path, name: str) -> NDArray[Any]:
    return np.genfromtxt(folder / f"{name}.csv.gz", delimiter=",", names=True)


def columns(table: NDArray[Any], names: Sequence[Any]) -> NDArray[Any]:
    return np.stack([table[name] for name in names], axis=-1)


def test_the_same_seed_writes_the_same_files_and_another_does_not(tmp_path: Path) -> None:
    effect = draw_effect("combiner_tilt", np.random.default_rng(9))
    for folder, seed in (("a", 1), ("b", 1), ("c", 2)):
        write_session(tmp_path / folder, SMALL, [effect], np.random.default_rng(seed))
    content = {
        f: [(tmp_path / f / n).read_bytes() for n in ("bench.toml", "display.csv.gz", "seethrough.csv.gz")]
        for f in "abc"
    }
    assert content["a"] == content["b"]
    assert content["a"][0] == content["c"][0]
    assert all(a != c for a, c in zip(content["a"][1:], content["c"][1:], strict=True))


@pytest.mark.parametrize("device", NAMES)
def test_plain_numpy_reads_a_session(tmp_path: Path, device: str) -> None:
    plan = replace(SMALL, device=device)
    write_session(tmp_path, plan, [], np.random.default_rng(1))
    display, seethrough = read(tmp_path, "display"), read(tmp_path, "seethrough")
    assert len(np.unique(display["capture"])) == 48
    np.testing.assert_array_equal(np.unique(display["time_s"]), 40.0 * np.arange(48))
    assert len(np.unique(columns(seethrough, ["target_pose", "capture"]), axis=0)) == 48
    pixels = own_device(device).panel.pixels
    assert np.all(columns(display, ["pixel_u", "pixel_v"]) > 0.0)
    assert np.all(columns(display, ["pixel_u", "pixel_v"]) < pixels)
    bench = tomllib.loads((tmp_path / "bench.toml").read_text(encoding="utf-8"))
    assert (bench["device"], bench["camera"]["point_sigma_px"], len(bench["target_pose"])) == (device, 0.1, 3)
    spacing = np.diff(np.unique(seethrough["target_x_mm"][seethrough["target_pose"] == 1]))
    np.testing.assert_allclose(spacing, bench["target_pose"][1]["pitch_mm"], atol=1e-3)


def test_three_colours_are_three_rows_per_point(tmp_path: Path) -> None:
    write_session(tmp_path, replace(SMALL, channels=(0, 1, 2)), [], np.random.default_rng(1))
    display = read(tmp_path, "display")
    np.testing.assert_array_equal(display["channel"][:6], [0, 1, 2, 0, 1, 2])
    assert len(np.unique(display["pixel_u"][:3])) == 3


def test_effects_leave_the_stated_bench_and_the_positions_alone(tmp_path: Path) -> None:
    for folder, effects in (("clean", []), ("moved", [draw_effect("stage_scale", np.random.default_rng(3))])):
        write_session(tmp_path / folder, SMALL, effects, np.random.default_rng(1))
    assert (tmp_path / "clean" / "bench.toml").read_text() == (tmp_path / "moved" / "bench.toml").read_text()
    stages = [np.unique(columns(read(tmp_path / f, "display"), STAGE), axis=0) for f in ("clean", "moved")]
    np.testing.assert_array_equal(stages[0], stages[1])


def test_an_unknown_device_ends_in_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="no device 'quest'"):
        write_session(tmp_path, Plan(device="quest"), [], np.random.default_rng(0))


clean_data = pytest.mark.skipif(not CLEAN.is_dir(), reason="the measured sessions are not here (WLR_DATA)")


def captures_of(table: NDArray[Any], pose: NDArray[Any]) -> Captures:
    _, first = np.unique(np.stack([pose, table["capture"]], axis=-1), axis=0, return_index=True)
    rows = table[first]
    travel = rows["travel"] if "travel" in present(table.dtype.names) else np.ones(len(rows))
    return Captures(
        pose[first].astype(int), rows["capture"].astype(int), rows["time_s"], travel.astype(int), columns(rows, STAGE)
    )


@clean_data
def test_the_format_is_that_of_measured_sessions(tmp_path: Path) -> None:
    write_session(tmp_path, Plan(), [], np.random.default_rng(1))
    ours, theirs = (tomllib.loads((f / "bench.toml").read_text(encoding="utf-8")) for f in (tmp_path, CLEAN))
    assert ours == theirs
    for name in ("display", "seethrough"):
        lines = [
            gzip.decompress((f / f"{name}.csv.gz").read_bytes()).decode().splitlines()[:2] for f in (tmp_path, CLEAN)
        ]
        assert lines[0][0] == lines[1][0]
        decimals = [[len(value.partition(".")[2]) for value in both[1].split(",")] for both in lines]
        assert decimals[0] == decimals[1]
        own, measured = read(tmp_path, name), read(CLEAN, name)
        assert len(own) == pytest.approx(len(measured), rel=0.005)
        planar = [
            np.unique(columns(t[t["capture"] < 36], ["capture", "time_s", *STAGE]), axis=0) for t in (own, measured)
        ]
        np.testing.assert_array_equal(planar[0], planar[1])


@clean_data
def test_a_clean_measured_display_is_predicted_to_the_noise() -> None:
    measured, device = read(CLEAN, "display"), own_device("northstar")
    plan = Plan(sigma_px=0.0)
    captures = captures_of(measured, np.full(len(measured), -1))
    own = display_table(World(device), plan, captures, np.random.default_rng(0))
    place = {(row["capture"], row["camera_u"], row["camera_v"]): i for i, row in enumerate(own)}
    rows = [place[(row["capture"], row["camera_u"], row["camera_v"])] for row in measured]
    left = columns(measured, ["pixel_u", "pixel_v"]) - columns(own[rows], ["pixel_u", "pixel_v"])

    def pixel(uv: FloatArray) -> FloatArray:
        tangents = (uv - [640.0, 512.0]) / 1350.0
        direction = unit(np.concatenate([tangents, np.ones((len(uv), 1))], axis=-1))
        return device.panel.pixel(*device.trace(device.display, columns(measured, STAGE), direction, 0.55))

    uv = columns(measured, ["camera_u", "camera_v"])
    jacobian = np.stack([pixel(uv + step) - pixel(uv - step) for step in 0.5 * np.eye(2)], axis=-1)
    noise = np.linalg.solve(jacobian, left[..., None])[..., 0]
    noise = noise[np.isfinite(noise[:, 0])]
    assert len(noise) >= len(measured) - 3  # points that the noise carried over the margin
    assert_is_noise(noise)


@clean_data
def test_a_clean_measured_see_through_is_predicted_to_the_noise() -> None:
    measured = read(CLEAN, "seethrough")
    captures = captures_of(measured, measured["target_pose"])
    own = see_through_table(World(own_device("northstar")), Plan(sigma_px=0.0), captures, np.random.default_rng(0))
    for name in ("target_pose", "capture", "target_x_mm", "target_y_mm"):
        np.testing.assert_allclose(own[name], measured[name], atol=1e-4)
    assert_is_noise(columns(measured, ["camera_u", "camera_v"]) - columns(own, ["camera_u", "camera_v"]))


def assert_is_noise(residual: NDArray[Any]) -> None:
    """Normal with 0.1 px per axis; the limits are four standard errors wide."""
    count = len(residual)
    np.testing.assert_allclose(residual.mean(axis=0), 0.0, atol=4 * 0.1 / np.sqrt(count))
    np.testing.assert_allclose(residual.std(axis=0), 0.1, atol=4 * 0.1 / np.sqrt(2 * count))
    assert np.abs(residual).max() < 0.55
    assert abs(np.mean(residual[:, 0] * residual[:, 1])) < 4 * 0.01 / np.sqrt(count)

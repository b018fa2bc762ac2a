"""Every key of every TOML and JSON file, with wrong values."""

import json
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from corpus.base_texts import DEVICES, OPTILAND, PHOTO_SESSION, RAYOPTICS, REPORT, SCENE_WITH_MESH, STATION
from corpus.case import Case
from corpus.cases.hostile_files import OPTICS
from corpus.damage import damaged, toml_text
from wlr_render.io.atomic_files import resource

RENDER = ("--backend", "cpu", "--out", "out")
TOLERANT = {
    ("optical_model", "attributes", "seq_model", "attributes", "ifcs", "__instance_type__"),
    ("surface_group", "surfaces", "geometry", "radius_y"),
    ("surface_group", "surfaces", "geometry", "coeffs_poly_y"),
}
"""Keys that may have almost any value: a class or terms that are not read are warned of, and a cylinder is straight."""
UNREAD = {
    *(("provenance", key) for key in ("command", "options")),
    ("provenance", "options", "--panel"),
    *(("tables", "rows", key) for key in ("surface", "index")),
    ("tables", "notes"),
    *((key,) for key in ("title", "advice", "warnings", "plots")),
}
"""Keys of a report that are not read, or whose values may be anything that a cell or an option is."""
SCENE_FILES = ("scene.toml", "box.obj")
BOARD = {
    "kind": "chessboard",
    "corner_columns": 7,
    "corner_rows": 5,
    "square_mm": 20.0,
    "margin_mm": 10.0,
    "scale_sigma": 0.0005,
    "flatness_mm": 0.3,
    "print_error_um": 20.0,
}
BENCH = """
format = "bench-session"
version = 1
frame = "opencv"
unit = "mm"
device = "northstar"
eye = "right"
camera = {width = 1280, height = 1024, fx = 900.0, fy = 900.0, cx = 640.0, cy = 300.0, point_sigma_px = 0.1, \
distortion = [0.01, 0.0], rotation = [[1, 0, 0], [0, 1, 0], [0, 0, 1]], pupil_offset_mm = [0, 0, 0]}
stage = {origin = [32, 0, 33], axes = [[1, 0, 0], [0, 1, 0], [0, 0, 1]], backlash_mm = [0, 0]}
target = {scale = [1, 1], bow_per_m = [[0, 0], [0, 0]]}
mount = {panel_creep_mm = [0, 0], warm_up_s = 10, slip_time_s = 5, slip_mm = [0, 0, 0], slip_rotation_deg = [0, 0, 0]}
readout = {origin_px = [0, 0], channel_scale = [1, 1, 1]}
eye_tracking = {bias_mm = [0, 0, 0], gaze_radius_mm = 0}
clock = {latency_s = 0, scanout_s = 0}
light = {channels_um = [0.61, 0.54, 0.46], target_um = 0.54}
tracking = {rotation = [[1, 0, 0], [0, 1, 0], [0, 0, 1]], translation = [0, 0, 0]}
prior = {latency = {latency = [0, 1]}}
target_pose = [{rotation = [[1, 0, 0], [0, 1, 0], [0, 0, 1]], translation = [32, 0, 600], pitch_mm = 30.0}, \
{rotation = [[1, 0, 0], [0, 1, 0], [0, 0, 1]], translation = [32, 0, 1200], pitch_mm = 70.0}]
"""


def save_toml(path: Path, content: Any) -> None:
    path.write_text(toml_text(content), encoding="utf-8")


def save_json(path: Path, content: Any) -> None:
    path.write_text(json.dumps(content), encoding="utf-8")


def cases() -> Iterator[Case]:
    yield from _devices()
    scene = ("render", "device.toml", "scene.toml", *RENDER)
    content = tomllib.loads(SCENE_WITH_MESH)
    yield from damaged("scene", content, "scene.toml", save_toml, scene, ("device.toml", *SCENE_FILES), set(), 3)
    photos = ("calibrate", "photos", "--workers", "1", "--out", "out")
    content = tomllib.loads(PHOTO_SESSION)
    yield from damaged("photo session", content, "photos/session.toml", save_toml, photos, ("photos",), set())
    pairs = ("verify", "pairs", "board.toml", "--calibration", "calibration", "--out", "out")
    files = ("pairs", "board.toml", "calibration")
    yield from damaged("station", STATION, "calibration/station-right.json", save_json, pairs, files, set())
    yield from damaged("board", BOARD, "board.toml", save_toml, pairs, files, set(), 4)
    predict = ("predict", "bench/bench.toml", "bench", "--out", "out")
    yield from damaged("bench", tomllib.loads(BENCH), "bench/bench.toml", save_toml, predict, ("bench",), set())
    for file, content in (("optiland.json", OPTILAND), ("rayoptics.roa", RAYOPTICS)):
        arguments: tuple[str, ...] = ("import-lens", file, *OPTICS)
        yield from damaged("optics", content, file, save_json, arguments, ("glasses.agf",), set(TOLERANT))
    arguments = ("import-lens", "lens.zmx", *OPTICS, "--against", "report.json")
    yield from damaged("report", REPORT, "report.json", save_json, arguments, ("lens.zmx", "glasses.agf"), set(UNREAD))


def _devices() -> Iterator[Case]:
    seen: set[tuple[str, ...]] = set()
    for name in DEVICES:
        text = resource("devices", f"{name}.toml").read_text(encoding="utf-8")
        content = tomllib.loads(re.sub(r"pixels = \[.*?\]", "pixels = [32, 18]", text))
        arguments = ("render", "device.toml", "scene.toml", *RENDER)
        yield from damaged("device", content, "device.toml", save_toml, arguments, SCENE_FILES, seen)

"""The valid files that cases spoil, as small as each reader takes them, written by the package itself."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import trimesh
from fitted_eyes import captures, thinned
from PIL import Image
from small_headsets import changed_device

from corpus.base_texts import (
    CAUSES,
    DEVICES,
    EYES,
    GAZE,
    GLASSES,
    HEAD,
    HEAD_CSV,
    LENS_KALIBR,
    LENS_MRCAL,
    LENS_ROS,
    LENS_SEQ,
    LENS_XML,
    LENS_YAML,
    LENS_ZMX,
    OPTILAND,
    PHOTO_SESSION,
    RAYOPTICS,
    RECORDING,
    REPORT,
    SCENE_WITH_MESH,
    STATION,
    TARGET_KALIBR,
)
from wlr_render.calibration.fit_eye import calibrate
from wlr_render.captures.boards.board_design import design_board
from wlr_render.captures.boards.board_drawing import write_board_png
from wlr_render.captures.boards.board_file import save_board
from wlr_render.captures.correspondences import Captures
from wlr_render.captures.patterns.catalogue import GrayCode
from wlr_render.captures.photographs import write_photograph
from wlr_render.io.atomic_files import resource
from wlr_render.mappings import Panel
from wlr_render.models.model_file import EyeModel, save_eye_models

GRAY_PANEL = Panel(64, 48)


def make_bases(folder: Path) -> Path:
    """Write one valid file or folder of each kind into a new folder, which is returned."""
    shutil.rmtree(folder, ignore_errors=True)  # of a process that was killed
    folder.mkdir()
    device = Path(changed_device(folder, "no_optics", ("[1280, 720]", "[32, 18]"))).rename(folder / "device.toml")
    for name in DEVICES:
        text = resource("devices", f"{name}.toml").read_text(encoding="utf-8")
        (folder / f"{name}.toml").write_text(re.sub(r"pixels = \[.*?\]", "pixels = [32, 18]", text), encoding="utf-8")
    _write_texts(folder)
    _write_meshes(folder)
    _write_photographs(folder)
    seen = captures(str(device))
    display, see_through = seen.both
    Captures(thinned(display), thinned(see_through)).save(folder / "captures.npz")
    fitted = calibrate(seen, "planar", 3, 2).mappings
    save_eye_models(folder / "model.json", [EyeModel(replace(fitted, name="fitted"), "no_optics")])
    _write_bench_session(folder / "bench")
    return folder


def _write_texts(folder: Path) -> None:
    texts = {
        "scene.toml": SCENE_WITH_MESH,
        "lens.yaml": LENS_YAML,
        "lens_ros.yaml": LENS_ROS,
        "camchain.yaml": LENS_KALIBR,
        "target.yaml": TARGET_KALIBR,
        "lens.xml": LENS_XML,
        "lens.cameramodel": LENS_MRCAL,
        "lens.zmx": LENS_ZMX,
        "lens.seq": LENS_SEQ,
        "glasses.agf": GLASSES,
        "optiland.json": json.dumps(OPTILAND),
        "rayoptics.roa": json.dumps(RAYOPTICS),
        "head.txt": HEAD,
        "head.csv": HEAD_CSV,
        "eyes.txt": EYES,
        "gaze.txt": GAZE,
        "recording.jsonl": RECORDING,
        "causes.py": CAUSES,
        "report.json": json.dumps(REPORT, indent=1),
    }
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    (folder / "calibration").mkdir()
    (folder / "calibration" / "station-right.json").write_text(json.dumps(STATION, indent=1), encoding="utf-8")


def _write_meshes(folder: Path) -> None:
    box = trimesh.creation.box((0.2, 0.2, 0.2))
    for kind in ("obj", "ply", "glb", "stl"):
        box.export(folder / f"box.{kind}")
    (folder / "box.ply").write_bytes(trimesh.exchange.ply.export_ply(box, encoding="ascii"))
    trimesh.Trimesh(box.vertices, box.faces).export(folder / "binary.ply", encoding="binary")
    (folder / "ascii.stl").write_text(trimesh.exchange.stl.export_stl_ascii(box))
    for name, content in trimesh.exchange.gltf.export_gltf(trimesh.Scene(box)).items():
        (folder / "gltf").mkdir(exist_ok=True)
        (folder / "gltf" / ("box.gltf" if name == "model.gltf" else name)).write_bytes(content)
    picture = Image.fromarray(np.full((8, 8, 3), 200, np.uint8))
    picture.save(folder / "texture.png")
    textured = trimesh.visual.TextureVisuals(uv=box.vertices[:, :2], image=picture)
    (folder / "textured").mkdir()
    trimesh.Trimesh(box.vertices, box.faces, visual=textured).export(folder / "textured" / "box.obj")
    trimesh.Trimesh(box.vertices, box.faces, visual=textured).export(folder / "textured.glb")


def _write_photographs(folder: Path) -> None:
    board = design_board(8, 7, 0.02)
    save_board(board, folder / "board.toml")
    session = folder / "photos"
    session.mkdir()
    (session / "session.toml").write_text(PHOTO_SESSION, encoding="utf-8")
    save_board(board, session / "board.toml")
    black = np.zeros((48, 64), np.uint8)
    for name in ("bare", "tracking", "through"):
        write_photograph(session / f"{name}.png", black)
    code = GrayCode(GRAY_PANEL)
    for index in range(len(code.names())):
        write_photograph(folder / "codes" / f"{index:02d}.png", code.image(index) // 2 + 20)
        write_photograph(session / "shown" / f"{index:02d}.png", black)
    write_board_png(board, folder / "board.png", 60)
    drawn = cv2.resize(cv2.imread(str(folder / "board.png"), cv2.IMREAD_GRAYSCALE), (320, 240))
    for name in ("a_off", "a_on"):
        write_photograph(folder / "pairs" / f"{name}.png", np.ascontiguousarray(drawn))


def _write_bench_session(folder: Path) -> None:
    from diagnosis.small_session import SIGMA_PX, measured, small_bench, small_plan

    from wlr_render.bench.session_folder import save_session

    bench = small_bench()
    save_session(folder, bench, measured(bench, small_plan(bench), SIGMA_PX).session)

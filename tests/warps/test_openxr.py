"""Example 10 with a real OpenXR runtime: Monado, with a simulated headset or one that stands still."""

import contextlib
import importlib.util
import json
import os
import re
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from present import present

from wlr_render.jobs.headset import open_eye
from wlr_render.tracking.eye_trajectory_file import read_eye_trajectory
from wlr_render.tracking.head_trajectory_file import read_head_trajectory

EXAMPLE = Path(__file__).resolve().parents[2] / "examples/10_openxr.py"
RUNTIME = Path("/usr/share/openxr/1/openxr_monado.json")
WINDOW = 960, 540  # of Monado for a headset of 1920 x 1080


def wait_for(condition: Callable[[], object], process: Any, log: Path, seconds: int = 60) -> None:
    """Wait until a process has come so far."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert process.poll() in (None, 0), log.read_text(errors="replace")
        assert time.monotonic() < deadline, f"{process.args[0]} takes more than {seconds} s"
        time.sleep(0.1)


@contextlib.contextmanager
def running(command: Sequence[Any], log: Path, **settings: Any) -> Iterator[Any]:
    with log.open("wb") as written:
        process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=written, stderr=written, **settings)
    try:
        yield process
    finally:
        process.terminate()
        process.wait(20)


@contextlib.contextmanager
def running_monado(config: dict[str, Any], **settings: str) -> Iterator[Any]:
    """Environment of a program that uses Monado; the test is skipped where it is not installed."""
    if importlib.util.find_spec("xr") is None:  # its import would choose PyOpenGL's platform for this process
        pytest.skip("pyopenxr is not installed; pip install '.[xr]'.")
    if shutil.which("monado-service") is None:
        pytest.skip("monado-service is not installed; Debian 13 has it.")
    with tempfile.TemporaryDirectory(prefix="xr") as name:  # a socket's path must be short
        folder = Path(name)
        Path(folder, "monado").mkdir()
        Path(folder, "monado/config_v0.json").write_text(json.dumps(config), encoding="utf-8")
        environment = os.environ | {"XDG_RUNTIME_DIR": name, "XDG_CONFIG_HOME": name}
        if RUNTIME.is_file():
            environment["XR_RUNTIME_JSON"] = str(RUNTIME)
        log = folder / "log"
        with running(["monado-service"], log, env=environment | {"XRT_NO_STDIN": "1"} | settings) as service:
            wait_for((folder / "monado_comp_ipc").exists, service, log)
            yield environment


@pytest.fixture(scope="module")
def swaying() -> Iterator[Any]:
    with running_monado({}, XRT_COMPOSITOR_NULL="1", SIMULATED_ENABLE="1") as environment:
        yield environment


def run(environment: dict[str, str], folder: Path, *arguments: str) -> tuple[Any, list[Any]]:
    """What the example prints, and its pictures of both eyes."""
    command = [sys.executable, str(EXAMPLE), *arguments]
    result = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=200)
    assert result.returncode == 0, result.stderr
    print(result.stdout)
    return result.stdout, [cv2.imread(str(folder / f"{eye}.png")) for eye in ("left", "right")]


def check_pictures(left: NDArray[np.uint8], right: NDArray[np.uint8]) -> None:
    """Cubes on black, seen by two eyes."""
    for picture in (left, right):
        assert 0.05 < (picture.max(axis=-1) > 50).mean() < 0.95
    assert (left != right).any(axis=-1).mean() > 0.02


def test_poses_of_a_headless_session_move_the_pictures(swaying: Any, tmp_path: Path) -> None:
    printed, pictures = run(swaying, tmp_path)
    assert float(present(re.search(r"20 frames; the head moved ([\d.]+) mm", printed))[1]) > 0.5
    assert "OpenGL: GL_NO_ERROR" in printed
    check_pictures(*pictures)


def test_what_the_runtime_locates_is_recorded_and_read_as_trajectories(swaying: Any, tmp_path: Path) -> None:
    printed, _ = run(swaying, tmp_path)
    recording = tmp_path / "recording.jsonl"
    head, eyes = read_head_trajectory(recording), read_eye_trajectory(recording)
    flags = {each.get("locationFlags") for each in map(json.loads, recording.read_text(encoding="utf-8").splitlines())}
    assert flags == {None, 7}  # Monado tracks no position of this headset; the header has no flags
    moved_mm = 1e3 * np.ptp(head.position_in_world, axis=0).max()
    assert len(head.time_s) == 20
    assert moved_mm == pytest.approx(float(present(re.search(r"the head moved ([\d.]+) mm", printed))[1]), abs=0.2)
    # Monado's simulated headset has its views 63 mm apart; the device has VIEW space midway between its eye boxes.
    boxes = [open_eye("northstar", eye).eye_box.centre for eye in ("left", "right")]
    left, right = (eyes.viewpoint_at(eye, head.time_s[3:5]) for eye in ("left", "right"))
    np.testing.assert_allclose(right - left, [[0.063, 0, 0]] * 2, atol=1e-4)
    np.testing.assert_allclose((left + right) / 2, [np.mean(boxes, axis=0)] * 2, atol=1e-4)


def test_the_swap_chain_holds_what_the_compositor_composed(swaying: Any, tmp_path: Path) -> None:
    printed, pictures = run(swaying, tmp_path, "swap-chain")
    differences = re.findall(r"differs from the compositor's by (\d+) codes", printed)
    assert len(differences) == 2
    assert max(map(int, differences)) <= 3
    assert "OpenGL: GL_NO_ERROR" in printed
    check_pictures(*pictures)


def screen(file: Path) -> NDArray[np.uint8]:
    """(height, width, 3) BGR of a screen of 24 bits in the XWD file that Xvfb keeps."""
    content = file.read_bytes()
    header = np.frombuffer(content[:100], ">u4")
    (width, height), line, colours = header[4:6], header[12], header[19]
    pixels = np.frombuffer(content, np.uint8, height * line, header[0] + 12 * colours)
    return pixels.reshape(height, -1, 4)[:, :width, :3]


def test_monado_shows_the_panels_unchanged_to_a_head_at_rest(tmp_path: Path) -> None:
    """With no distortion and nothing for its timewarp to do."""
    if shutil.which("Xvfb") is None:
        pytest.skip("Xvfb is not installed.")
    copied, log = tmp_path / "example.py", tmp_path / "log"
    text = EXAMPLE.read_text(encoding="utf-8")
    for old, new in (
        ("(360, 400), 20,", f"({WINDOW[0] // 2}, {WINDOW[1]}), 5,"),
        ("\nmoved_mm = ", "\ntime.sleep(120)\nmoved_mm = "),  # the runtime shows the last frame
    ):
        assert text.count(old) == 1
        text = text.replace(old, new)
    copied.write_text(text, encoding="utf-8")
    with socket.create_server(("localhost", 0)) as free:
        port = free.getsockname()[1]
    at_rest = {"active": "remote", "remote": {"version": 0, "port": port}}
    display = subprocess.Popen(
        ["Xvfb", "-displayfd", "1", "-screen", "0", "1280x800x24", "-fbdir", str(tmp_path)], stdout=subprocess.PIPE
    )
    try:
        number = present(display.stdout).readline().decode().strip()
        settings = {"DISPLAY": f":{number}", "XRT_COMPOSITOR_FORCE_XCB": "1"}
        with running_monado(at_rest, **settings) as environment:
            command = [sys.executable, str(copied), "swap-chain"]
            with running(command, log, cwd=tmp_path, env=environment) as client:
                wait_for((tmp_path / "right.png").exists, client, log)
                deadline = time.monotonic() + 30
                while time.monotonic() < deadline:
                    drawn = np.hstack([present(cv2.imread(str(tmp_path / f"{eye}.png"))) for eye in ("left", "right")])
                    shown = screen(tmp_path / "Xvfb_screen0")[: WINDOW[1], : WINDOW[0]]
                    if (shown == drawn).all():
                        break
                    time.sleep(0.5)
    finally:
        display.terminate()
        display.wait(20)
    equal = (shown == drawn).all(axis=-1).mean()
    print(f"{equal:.2%} of the pixels of Monado's window are the compositor's")
    assert equal == 1
    check_pictures(*np.hsplit(drawn, 2))

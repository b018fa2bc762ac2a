"""The examples run as they stand, each in a folder of its own, and print what they should.

Those that take long run in this process, of fewer readings or pixels than theirs.
"""

import os
import re
import runpy
import subprocess
import sys
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from present import present
from small_headsets import changed_device

import wlr_render as wlr
from wlr_render.bench.bench import Bench
from wlr_render.captures.session import Readings, Session, SessionPlan, select_rows
from wlr_render.diagnosis import improvement
from wlr_render.diagnosis.causes import CAUSES
from wlr_render.extras import install_command
from wlr_render.gl.native_contexts import OsMesaBinding
from wlr_render.jobs.frame_plan import motion_of, planned_frames
from wlr_render.jobs.headset import open_eye
from wlr_render.jobs.render_options import RenderOptions

EXAMPLES = sorted((Path(__file__).resolve().parent.parent / "examples").glob("[0-9][0-9]_*.py"))
WORDS_AND_FILES = {
    "01_world_rays": ("2304000 rays, 100.0% of them OK", set()),
    "02_calibrate": ("direction of a pixel (arcmin): 0.0", {"birdbath28.json"}),
    "03_render_a_frame": ("registration 0.000", {"raster.png", "raytrace.png", "warp.tiff"}),
    "04_moving_wearer": (
        "wrote right-500-ms.png",
        {"head.tum", "eyes.txt", *(f"{eye}-{time}-ms.png" for eye in ("left", "right") for time in (0, 500))},
    ),
    "05_diagnose": ("Explained: printed size of the target", {"out"}),
    "06_photographs": ("median decoding error 0.00", set()),
    "07_plug_into_pyrender": ("right eye: the drawn dot appears 0.", {"left.png", "right.png"}),
    "08_real_time": ("OpenGL state of the engine was left alone", {"panel.png"}),
    "09_own_warp": ("99 % of the pixels within 1, 0.0", {"panel.png"}),
    "11_self_calibration": ("arcmin rms; wrong clicks: (2,)", set()),
    "12_open3d": ("the middle pixel shows: ", {"distance.png"}),
    "13_warp": ("100.0% of 2304000 rays hit, from 0.3", {"normals.png"}),
    "14_newton": ("100.0% of 2304000 rays hit, from 0.3", {"panel.png"}),
    "15_blender": ("panel.png: 1440 x 1600 pixels", {"panel.png", "ray_map.exr"}),
}
TESTED_ELSEWHERE = {"10_openxr"}  # tests/warps/test_openxr.py
NEED_LIBRARY = {"12_open3d": "open3d", "13_warp": "warp", "14_newton": "newton", "15_blender": "bpy"}
NEED_WEBGPU = {"09_own_warp"}
NEED_EGL = {"07_plug_into_pyrender", "08_real_time"}
PIXELS = {"freeform40": ("[1920, 1080]", "[480, 270]"), "northstar": ("[1440, 1600]", "[180, 200]")}


def low_degrees(patch: pytest.MonkeyPatch, folder: object) -> None:
    """A quarter of the directions at each camera position, and models of lower degrees."""
    patch.setitem(present(wlr.simulate.__kwdefaults__), "grid", (13, 11))
    patch.setattr(wlr, "calibrate", partial(wlr.calibrate, display_degree=5, see_through_degree=4))


def few_readings(patch: pytest.MonkeyPatch, folder: object) -> None:
    """A third of the captures of a session, half of the readings of each, few causes, and small models in use."""
    load_session = wlr.load_session

    def third_of_session(path: str | Path) -> tuple[Bench, Session]:
        bench, session = load_session(path)
        display, see_through = present(session.plan.display), present(session.plan.see_through)
        rows = [np.flatnonzero(part.capture % 3 == 0)[::2] for part in (display, see_through)]
        plan = SessionPlan(select_rows(display, rows[0]), select_rows(see_through, rows[1]))
        readings = Readings(*(present(part)[kept] for part, kept in zip(session.readings.parts, rows, strict=False)))
        return bench, Session(session.name, plan, readings)

    patch.setattr(wlr, "load_session", third_of_session)
    causes = {name: CAUSES[name] for name in ("target_scale", "target_bow", "tracking_translation")}
    patch.setattr(wlr, "diagnose", partial(wlr.diagnose, causes=causes))
    patch.setattr(improvement, "_ROWS", 800)


def small_panels(patch: pytest.MonkeyPatch, folder: Path) -> None:
    """A fraction of the panel's pixels."""
    paths = {name: changed_device(folder, name, change) for name, change in PIXELS.items()}
    patch.setattr(wlr, "open_eye", lambda device, eye="right": open_eye(paths[device], eye))


SMALLER = {
    "02_calibrate": low_degrees,
    "03_render_a_frame": small_panels,
    "04_moving_wearer": small_panels,
    "05_diagnose": few_readings,
}


def path_of(name: str) -> Path:
    return next(path for path in EXAMPLES if path.stem == name)


def run(name: str, folder: Path, **environment: Any) -> None:
    path = path_of(name)
    command = [sys.executable, "-W", "error::RuntimeWarning", str(path)]
    given = os.environ | environment
    result = subprocess.run(command, cwd=folder, env=given, capture_output=True, text=True, timeout=300)
    assert result.returncode == 0, result.stderr
    assert_finished(name, result.stdout, folder)


def assert_finished(name: str, printed: str, folder: Path) -> None:
    words, files = WORDS_AND_FILES[name]
    assert words in printed
    assert {entry.name for entry in folder.iterdir()} == files


def require_library(name: str) -> None:
    if find_spec(name) is None:
        pytest.skip(f"{name} is not installed; docs/renderers.md has the command.")


def require_webgpu() -> None:
    wgpu = pytest.importorskip("wgpu", reason="wgpu is not installed.")
    try:
        wgpu.gpu.request_adapter_sync()
    except RuntimeError as error:
        pytest.skip(f"WebGPU finds no device; lavapipe of mesa-vulkan-drivers is one ({error}).")


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in WORDS_AND_FILES if name not in SMALLER])
def test_an_example_runs(name: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    if name in NEED_LIBRARY:
        require_library(NEED_LIBRARY[name])
    if name in NEED_WEBGPU:
        require_webgpu()
    if name in NEED_EGL and request.getfixturevalue("gl_context").backend != "egl":
        pytest.skip("EGL does not open here.")
    run(name, tmp_path)


@pytest.mark.slow
@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("name", SMALLER)
def test_a_long_example_runs_of_less(
    name: str,
    tmp_path: Path,
    tmp_path_factory: pytest.TempPathFactory,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    SMALLER[name](monkeypatch, tmp_path_factory.mktemp("devices"))
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(path_of(name)))
    assert_finished(name, capsys.readouterr().out, tmp_path)


@pytest.mark.parametrize(("name", "library"), (NEED_LIBRARY | {"09_own_warp": "wgpu", "10_openxr": "xr"}).items())
def test_without_its_library_an_example_ends_with_the_command(name: str, library: str, tmp_path: Path) -> None:
    (tmp_path / f"{library}.py").write_text(f"raise ModuleNotFoundError('not here', name='{library}')\n")
    path = path_of(name)
    given = os.environ | {"PYTHONPATH": str(tmp_path)}
    result = subprocess.run([sys.executable, str(path)], cwd=tmp_path, env=given, capture_output=True, text=True)
    (extra,) = re.findall(r'script_needs\("(\w+)"\)', path.read_text())
    assert result.returncode == 1
    assert result.stderr == f"{path.name}: {library} is not installed; install it: {install_command(extra)}\n"


@pytest.mark.slow
@pytest.mark.gl
def test_the_plug_in_works_without_egl_too(tmp_path: Path) -> None:
    try:
        OsMesaBinding()
    except OSError as error:
        pytest.skip(f"libosmesa6 is not installed ({error}).")
    run("07_plug_into_pyrender", tmp_path, PYOPENGL_PLATFORM="osmesa")


def test_the_trajectories_cover_three_seconds_inside_the_eye_boxes() -> None:
    data = EXAMPLES[0].parent / "data"
    options = RenderOptions(
        "northstar", "desk", head=data / "head.tum", eye_track=data / "eyes.txt", eye="both", frames_per_second=10.0
    )
    plan = planned_frames(motion_of(options), {eye: open_eye("northstar", eye) for eye in ("left", "right")})
    assert [(frame.time_s, frame.eye) for frame in plan[:: len(plan) - 1]] == [(0.0, "left"), (3.0, "right")]
    assert len(plan) == 62
    assert len({tuple(frame.viewpoint) for frame in plan}) > 20


def test_the_code_in_the_readme_makes_the_session_of_example_5(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Up to rounding differences between processors."""
    data = EXAMPLES[0].parent / "data"
    (code,) = re.findall(r"```python\n(.*?)```", (data / "README.md").read_text(encoding="utf-8"), re.DOTALL)
    monkeypatch.chdir(tmp_path)
    exec(code, {})
    assert Path("session/bench.toml").read_text(encoding="utf-8") == (data / "session/bench.toml").read_text("utf-8")
    for name in ("display.csv.gz", "seethrough.csv.gz"):
        made, kept = (
            np.genfromtxt(folder / name, delimiter=",", skip_header=1) for folder in (Path("session"), data / "session")
        )
        np.testing.assert_allclose(made, kept, rtol=0, atol=1e-3)


def test_every_example_is_tested() -> None:
    assert {path.stem for path in EXAMPLES} == set(WORDS_AND_FILES) | TESTED_ELSEWHERE

"""The script `wlr` with stand-ins for what it calls."""

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest
import yaml

from wlr_render.gl.context import GlContext
from wlr_render.gl.programs import GLSL_VERSION

ROOT = Path(__file__).resolve().parent.parent


def run_script(
    folder: Path, arguments: Sequence[Any], commands: Mapping[Any, Any], opengl: str | None = "gl\n"
) -> subprocess.CompletedProcess[str]:
    """Run a copy of `wlr` whose venv is complete, with `commands` (shell scripts by name) before all others."""
    bin_folder = folder / ".venv" / "bin"
    bin_folder.mkdir(parents=True)
    for name in ("wlr", "pyproject.toml", "constraints.txt"):
        shutil.copy(ROOT / name, folder)
    for name, text in commands.items():
        (bin_folder / name).write_text(f"#!/bin/sh\n{text}\n")
        (bin_folder / name).chmod(0o755)
    stamp = subprocess.run("cat pyproject.toml constraints.txt | cksum", shell=True, cwd=folder, capture_output=True)
    (folder / ".venv" / "wlr-stamp").write_bytes(stamp.stdout)
    if opengl is not None:
        (folder / ".venv" / "wlr-gl").write_text(opengl)
    environment = {**os.environ, "PATH": f"{bin_folder}:{os.environ['PATH']}", "WLR_NO_APT": "1"}
    return subprocess.run(
        [folder / "wlr", *arguments], capture_output=True, text=True, timeout=60, env=environment, check=True
    )


def test_readers_says_at_the_end_what_is_installed(tmp_path: Path) -> None:
    """No package can be installed, and mrcal is missing."""
    commands = {"python": "exit 0", "dpkg": '[ "$2" = python3-mrcal ] || echo Status: install ok installed'}
    *_, missing, last = run_script(tmp_path, ["readers"], commands).stderr.splitlines()
    assert missing == "wlr: could not install python3-mrcal; the tests that need it are skipped"
    assert last.startswith("wlr: installed: mitsuba,wgpu, chromium, ffmpeg, glslang-tools, libllvm19, ")
    assert "mrcal" not in last


def test_an_environment_of_another_checkout_is_not_installed_into(tmp_path: Path) -> None:
    other, here = tmp_path / "other", tmp_path / "here"
    other.mkdir()
    here.mkdir()
    (here / ".venv").symlink_to(other)
    for name in ("wlr", "pyproject.toml", "constraints.txt"):
        shutil.copy(ROOT / name, here)
    done = subprocess.run([here / "wlr", "--version"], capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    assert "is a link, and what it links belongs to another checkout; remove the link" in done.stderr
    assert not any(other.iterdir())


STAND_IN = 'printf "%s" "$(basename "$0")"; printf " [%s]" "$@"; echo'


@pytest.mark.parametrize(
    ("arguments", "called"),
    [
        ([], "wlr-render [demo]"),
        (["--eye", "left"], "wlr-render [demo] [--eye] [left]"),
        (["render", "a b", "desk"], "wlr-render [render] [a b] [desk]"),
        (["--version"], "wlr-render [--version]"),
        (["--help"], "wlr-render [--help]"),
        (["bench", "speed"], "python [-m] [benchmarks] [speed]"),
    ],
    ids=str,
)
def test_the_script_runs_the_verbs_of_the_program(arguments: Sequence[str], called: str, tmp_path: Path) -> None:
    result = run_script(tmp_path, arguments, {"wlr-render": STAND_IN, "python": STAND_IN})
    *own_help, last = result.stdout.splitlines()
    assert (last, result.stderr) == (called, "")
    described = [line.split("./wlr")[1].split()[0] for line in own_help if line.startswith("  ./wlr")]
    assert ({"test", "check", "bench", "VERB"} <= set(described)) == (arguments == ["--help"])


@pytest.mark.parametrize("verb", ["test", "check"])
def test_tests_run_in_one_process_per_core_and_take_arguments(tmp_path: Path, verb: str) -> None:
    commands = {name: "" for name in ("ruff", "mypy", "lint-imports")} | {"python": 'printf "[%s] " "$@"; echo'}
    *_, last = run_script(tmp_path, [verb, "tests/optics", "-k", "a b"], commands).stdout.splitlines()
    assert last == "[-m] [pytest] [-n] [auto] [--dist] [worksteal] [tests/optics] [-k] [a b] "


def test_hooks_of_a_commit_run_what_check_runs_before_the_tests(tmp_path: Path) -> None:
    commands = {name: f'echo .venv/bin/{name} "$@"' for name in ("ruff", "mypy", "lint-imports")}
    commands["python"] = 'case "$*" in *pdoc*) echo ./wlr docs ;; esac'
    run = run_script(tmp_path, ["check"], commands).stdout.splitlines()
    (local,) = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8"))["repos"]
    assert sorted(hook["entry"] for hook in local["hooks"]) == sorted(line.strip() for line in run)


@pytest.mark.gl
@pytest.mark.parametrize(("version", "found"), [("4.1", "gl\n"), ("3.3", "cpu\n")])
def test_opengl_4_1_is_enough(gl_context: GlContext, tmp_path: Path, version: str, found: str) -> None:
    python = f'[ "$1" = -c ] || exit 0\nMESA_GL_VERSION_OVERRIDE={version} exec {sys.executable} "$@"'
    said = run_script(tmp_path, ["demo"], {"python": python, "wlr-render": ""}, opengl=None).stderr
    assert (tmp_path / ".venv" / "wlr-gl").read_text() == found
    assert ("frames are drawn on the CPU" in said) == (found == "cpu\n")


def test_the_instructions_ask_for_the_version_of_the_shaders() -> None:
    texts = [(ROOT / name).read_text(encoding="utf-8") for name in ("wlr", "docs/install.md", "shaders/README.md")]
    named = [re.findall(r"OpenGL (\d\.\d)", text) for text in texts]
    assert named == [[f"{GLSL_VERSION // 100}.{GLSL_VERSION // 10 % 10}"]] * 3


def test_ci_fails_where_a_test_lacks_what_readers_install_and_passes_where_it_lacks_what_is_the_users(
    tmp_path: Path,
) -> None:
    node = "captures/patterns/test_show_server.py::test_a_window_smaller_than_the_panel_is_refused"
    users = "test_release.py::test_rattler_build_renders_the_recipe"
    (tmp_path / "rattler_build.py").write_text("raise ModuleNotFoundError('not here')\n")
    environment = os.environ | {"PATH": "", "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    command = [sys.executable, "-m", "pytest", "--readers", *(str(ROOT / "tests" / name) for name in (node, users))]
    result = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=60)
    assert result.returncode == 1
    assert "no Node here: install Debian's package nodejs" in result.stdout
    assert "1 skipped, 1 error" in result.stdout

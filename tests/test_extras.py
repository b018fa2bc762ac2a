"""The command that installs a missing library works as shown: for this interpreter, and without an index of ours."""

import importlib.metadata
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import NoReturn

import pytest

from wlr_render import extras
from wlr_render.extras import MissingExtraError, install_command, installed_by

ROOT = Path(__file__).resolve().parents[1]
EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["optional-dependencies"]


@pytest.mark.parametrize("extra", EXTRAS)
def test_the_command_names_this_interpreter_and_the_libraries_of_pyproject(extra: str) -> None:
    words = shlex.split(install_command(extra))
    pip = [sys.executable, "-m", "pip", "install"]
    assert words[: len(pip)] == pip
    assert sorted(words[len(pip) :]) == sorted(each.lower() for each in EXTRAS[extra])


def test_blender_is_installed_without_its_dependencies() -> None:
    """It asks for NumPy 1."""
    assert shlex.split(install_command("blender"))[4:] == ["--no-deps", "bpy>=5.0", "OpenEXR>=3.3"]


def test_pip_takes_the_command() -> None:
    """With a library that is installed, so that pip needs no index."""
    command = shlex.split(install_command("test"))
    pytest_itself = next(each for each in command if each.startswith("pytest>"))
    ran = subprocess.run([*command[:4], "--dry-run", "--no-deps", "--no-index", pytest_itself], capture_output=True)
    assert ran.returncode == 0, ran.stderr


def test_a_path_with_spaces_is_quoted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", "/a folder/python")
    assert install_command("exr") == "'/a folder/python' -m pip install 'openexr>=3.3'"


def test_a_checkout_that_is_not_installed_names_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> NoReturn:
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(importlib.metadata, "requires", missing)
    assert shlex.split(install_command("exr"))[4:] == [f"{ROOT}[exr]"]


def test_an_environment_without_pip_is_served_by_uv(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(extras, "find_spec", lambda name: None)
    words = shlex.split(install_command("exr"))
    assert words == ["uv", "pip", "install", "--python", sys.executable, "openexr>=3.3"]


def test_a_missing_library_is_named_with_the_command() -> None:
    with pytest.raises(MissingExtraError) as missing, installed_by("exr", "frame.exr"):
        importlib.import_module("no_such_library.part")
    assert str(missing.value) == (
        f"frame.exr: no_such_library is not installed; install it: {sys.executable} -m pip install 'openexr>=3.3'"
    )

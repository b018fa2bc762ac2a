"""Recipe, Dockerfile, instructions and the check of a release agree with pyproject.toml, `./wlr` and README.md."""

import importlib.util
import re
import tomllib
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from present import present

from wlr_render import __version__

ROOT = Path(__file__).resolve().parent.parent
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PROJECT = PYPROJECT["project"]
RECIPE = (ROOT / "release" / "recipe.yaml").read_text(encoding="utf-8")
DOCKERFILE = (ROOT / "release" / "Dockerfile").read_text(encoding="utf-8")
INSTALL = (ROOT / "docs" / "install.md").read_text(encoding="utf-8")
OF_CONDA = {"opencv-python-headless": "py-opencv", "matplotlib": "matplotlib-base"}
"""Packages that conda has under another name."""


def check_wheel() -> ModuleType:
    spec = importlib.util.spec_from_file_location("check_wheel", ROOT / "release" / "check_wheel.py")
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    present(spec.loader).exec_module(module)
    return module


def in_conda(requirement: Any) -> str:
    """A requirement of pyproject.toml as a recipe states it."""
    name, bound = present(re.fullmatch(r"([\w-]+)(>=[\w.]+)", requirement)).groups()
    bound = re.sub(r"(\d+\.\d+\.\d+)\.\d+$", r"\1", bound)  # a fourth number counts OpenCV's builds for pip
    return f"{OF_CONDA.get(name, name).lower()} {bound}"


def of_recipe(section: str) -> set[Any]:
    """The requirements that a section of the recipe lists."""
    block = present(re.search(rf"^  {section}:\n((?:    - .+\n)+)", RECIPE, re.MULTILINE))[1]
    return set(re.findall(r"^    - (.+)$", block, re.MULTILINE))


def apt_packages(text: str, installs: str) -> set[Any]:
    """System packages that a script names behind a command."""
    return set(present(re.search(rf"{installs} ((?:[a-z][\w.-]+ ?)+)", text))[1].split())


# The recipe for conda.


def test_the_recipe_has_the_dependencies_of_the_package() -> None:
    python = f"python {PROJECT['requires-python']}"
    assert of_recipe("run") == {python} | {in_conda(each) for each in PROJECT["dependencies"]}
    assert of_recipe("host") == {python, "pip"} | {in_conda(each) for each in PYPROJECT["build-system"]["requires"]}


def test_the_recipe_makes_the_same_commands() -> None:
    commands = re.findall(r"^      - ([\w-]+ = [\w.]+:\w+)$", RECIPE, re.MULTILINE)
    assert commands == [f"{name} = {target}" for name, target in PROJECT["scripts"].items()]


def test_rattler_build_renders_the_recipe() -> None:
    reason = "needs rattler-build: pip install py-rattler-build"
    rattler_build = pytest.importorskip("rattler_build", reason=reason)
    (rendered,) = rattler_build.Stage0Recipe.from_file(ROOT / "release" / "recipe.yaml").render()
    recipe = rendered.recipe.to_dict()
    assert (recipe["package"]["name"], recipe["package"]["version"]) == ("wlr-render", __version__)
    assert set(recipe["requirements"]["run"]) == of_recipe("run")


# The image for Docker.


def test_the_image_has_the_system_packages_that_wlr_installs() -> None:
    opengl = apt_packages((ROOT / "wlr").read_text(encoding="utf-8"), "if may_install && apt_install")
    assert opengl == {"libegl1", "libgl1"}
    image = apt_packages(DOCKERFILE, "install -y --no-install-recommends")
    assert image == opengl | {"python3-venv", "ca-certificates"}
    assert opengl <= apt_packages(INSTALL, "apt-get install")


def test_the_image_is_built_from_all_files_that_the_wheel_needs() -> None:
    copied = re.findall(r"^!(.+)$", (ROOT / "release" / "Dockerfile.dockerignore").read_text("utf-8"), re.MULTILINE)
    wheel = PYPROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]
    needed = {*wheel["packages"], *wheel["force-include"], *PROJECT["license-files"], PROJECT["readme"]}
    assert set(copied) == needed | {"pyproject.toml", "constraints.txt"}
    assert all((ROOT / name).exists() for name in copied)


# What a release states in several files.


def test_all_files_state_one_version() -> None:
    assert f'version: "{__version__}"' in RECIPE
    assert f"\nversion: {__version__}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    latest = re.search(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert present(latest)[1] == __version__


def test_the_instructions_list_every_extra() -> None:
    assert re.findall(r"^\| `\[(\w+)\]` \|", INSTALL, re.MULTILINE) == list(PROJECT["optional-dependencies"])


def test_a_library_of_two_extras_has_one_bound() -> None:
    bounds: dict[str, Any] = {}
    for requirements in PROJECT["optional-dependencies"].values():
        for requirement in requirements:
            name, bound = present(re.fullmatch(r"([\w-]+)(.*)", requirement)).groups()
            assert bounds.setdefault(name, bound) == bound


# The check of a wheel.


def test_the_check_finds_the_figures_of_readme() -> None:
    figures = check_wheel().readme_figures()
    assert list(figures) == ["naive", "static", "raster + warp", "ray traced"]
    for median, p95, maximum in figures.values():
        assert 0 < float(median) < float(p95) < float(maximum)


@pytest.mark.parametrize(
    ("found", "agrees"),
    [(["0.0225", "56.1"], True), (["0.0224", "56.1"], False), (["0.0235", "56.4"], True), (["0.023", "56.6"], False)],
)
def test_the_check_rounds_figures_as_readme_does(found: Sequence[str], agrees: bool) -> None:
    assert check_wheel().agree(found, ["0.023", "56"]) is agrees


def test_the_check_names_a_figure_that_differs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    module, folder = check_wheel(), tmp_path / "out" / "demo"
    folder.mkdir(parents=True)
    for name in ("alignment.png", "report.html"):
        (folder / name).touch()
    rows = {method: f"| {method} | {' | '.join(cells)} | 7000 |" for method, cells in module.readme_figures().items()}
    report = folder / "report.md"
    report.write_text("\n".join(rows.values()), encoding="utf-8")
    assert list(module.check_demo(tmp_path, "here")) == []
    rows["static"] = "| static | 57 | 92 | 116 | 7000 |"
    report.write_text("\n".join(rows.values()), encoding="utf-8")
    assert list(module.check_demo(tmp_path, "here")) == [
        "static: misalignment is 57, 92, 116; README.md says 56, 92, 116."
    ]
    report.write_text("", encoding="utf-8")
    assert list(module.check_demo(tmp_path, "here")) == ["the report has no table of misalignments."]
    assert "here: " in capsys.readouterr().out

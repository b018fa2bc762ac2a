"""Build the wheel, install it for some interpreters, and run the program from an empty folder.

    python release/check_wheel.py [PYTHON ...] [--lowest] [--pipx] [--wheel WHEEL] [--extras [EXTRA ...]]

The wheel is built from the sdist, as an installer that finds no wheel would build it. For each interpreter (default:
this one) a fresh venv gets the wheel with the newest versions of its dependencies, as a user gets them, and runs the
demo; its table must be that of README.md. `--lowest` takes the oldest versions that pyproject.toml allows, which have
wheels for Python 3.11 only. `--extras` installs each extra alone and prints its size, `--pipx` runs the
demo by `pipx run`. Needs network; takes one to three minutes for each interpreter.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from decimal import Decimal
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
METHODS = {
    "naive": "naive: a flat picture in space, no combiner",
    "static": "static: the best map for one pupil position",
    "raster + warp": "planar models, raster and warp",
    "ray traced": "planar models, ray traced",
}
"""Name of each method in the demo's table, and in README's."""


def main() -> int:
    """Run the checks; returns the number of faults."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pythons", nargs="*", default=[sys.executable], metavar="PYTHON", help="interpreters to check")
    parser.add_argument("--extras", nargs="*", metavar="EXTRA", help="install each of these (all) alone")
    parser.add_argument("--lowest", action="store_true", help="install the lower bounds of pyproject.toml")
    parser.add_argument("--pipx", action="store_true", help="run the demo by pipx as well")
    parser.add_argument("--wheel", type=Path, help="check this wheel; none is built")
    options = parser.parse_args()
    sys.stdout.reconfigure(line_buffering=True)  # in order with what pip says
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        wheel = options.wheel.resolve() if options.wheel else build(folder)
        bounds = lower_bounds() if options.lowest else []
        faults = [
            fault
            for number, python in enumerate(options.pythons)
            for fault in check_interpreter(python, [str(wheel), *bounds], folder / f"python-{number}")
        ]
        if options.pipx:
            faults += check_pipx(options.pythons[0], wheel, folder / "pipx")
        if options.extras is not None:
            faults += check_extras(options.pythons[0], wheel, options.extras or all_extras(), folder / "extras")
    for fault in faults:
        print(f"FAULT  {fault}")
    return len(faults)


def build(folder: Path) -> Path:
    """Build the sdist, and the wheel from it; returns the wheel's path."""
    python = make_venv(sys.executable, folder / "build", "build")
    run([python, "-m", "build", "--outdir", str(folder / "dist"), str(ROOT)], folder)
    for path in sorted((folder / "dist").iterdir()):
        print(f"built {path.name}: {path.stat().st_size / 1e6:.1f} MB")
    return next((folder / "dist").glob("*.whl"))


def lower_bounds() -> list[str]:
    """Return requirements for the oldest version of each dependency that pyproject.toml allows."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    return [requirement.replace(">=", "==") for requirement in project["dependencies"]]


def check_interpreter(python: str, requirements: list[str], folder: Path) -> Iterator[str]:
    """Install the wheel, the first requirement, for an interpreter and run the demo; yields faults."""
    wheel = Path(requirements[0])
    own = make_venv(python, folder / "venv", *requirements)
    version = run([own, "-c", "import platform; print(platform.python_version())"], folder).strip()
    place = folder / "empty"
    place.mkdir()
    said = run([str(Path(own).with_name("wlr-render")), "--version"], place).strip()
    if said not in wheel.name:
        yield f"{wheel.name} on Python {version} says that it is version {said}."
    run([str(Path(own).with_name("wlr-render")), "demo"], place)
    yield from (f"Python {version}: {fault}" for fault in check_demo(place, f"Python {version}"))


def check_demo(place: Path, what: str) -> Iterator[str]:
    """Compare the table of a demo that ran in the folder `place` with README's; yields what is wrong."""
    found, expected = demo_figures(place / "out" / "demo" / "report.md"), readme_figures()
    if not {"naive", "static", "ray traced"} <= found.keys():
        yield "the report has no table of misalignments."
    print(f"{what}: " + "; ".join(f"{method} {', '.join(cells)}" for method, cells in found.items()))
    for method, cells in found.items():
        if not agree(cells, expected[method]):
            yield f"{method}: misalignment is {', '.join(cells)}; README.md says {', '.join(expected[method])}."
    for file in ("alignment.png", "report.html", "report.md"):
        if not (place / "out" / "demo" / file).exists():
            yield f"the demo wrote no {file}."


def agree(found: list[str], expected: list[str]) -> bool:
    """Whether figures round to those expected, which have fewer digits."""
    pairs = [(Decimal(a), Decimal(b)) for a, b in zip(found, expected, strict=True)]
    return all(2 * abs(a - b) <= Decimal(1).scaleb(int(b.as_tuple().exponent)) for a, b in pairs)


def demo_figures(report: Path) -> dict[str, list[str]]:
    """Return median, 95 % and maximum in arcminutes of each method that the demo drew with."""
    text = report.read_text(encoding="utf-8")
    return {method: cells for method in METHODS if (cells := row_of(method, text))}


def readme_figures() -> dict[str, list[str]]:
    """Return median, 95 % and maximum in arcminutes of each method in README's table."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    return {method: row_of(name, text) for method, name in METHODS.items()}


def row_of(name: str, text: str) -> list[str]:
    """Return the first three cells behind `name` in a Markdown table, without units; none if no table has the row."""
    match = re.search(rf"^\| {re.escape(name)} \|(.+)\|$", text, re.MULTILINE)
    return [cell.strip().rstrip("'") for cell in match[1].split("|")[:3]] if match else []


def check_pipx(python: str, wheel: Path, folder: Path) -> Iterator[str]:
    """Run the demo by pipx from an empty folder, and yield the errors."""
    pipx = Path(make_venv(python, folder / "venv", "pipx")).with_name("pipx")
    place = folder / "empty"
    place.mkdir()
    homes = {"PIPX_HOME": str(folder / "home"), "PIPX_BIN_DIR": str(folder / "bin")}
    run([str(pipx), "run", "--spec", str(wheel), "wlr-render", "demo"], place, homes)
    yield from (f"pipx: {fault}" for fault in check_demo(place, "pipx"))


def all_extras() -> list[str]:
    """Return the extras of the package."""
    return list(tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["optional-dependencies"])


def check_extras(python: str, wheel: Path, extras: list[str], folder: Path) -> Iterator[str]:
    """Install the wheel alone and with each extra, and print what each adds; yields what is wrong."""
    bare = installed_bytes(make_venv(python, folder / "none", str(wheel)))
    print(f"no extra: {bare / 1e6:.0f} MB")
    for extra in extras:
        try:
            own = make_venv(python, folder / extra, f"{wheel}[{extra}]")
        except subprocess.CalledProcessError:
            yield f"[{extra}] cannot be installed on its own."
            continue
        print(f"[{extra}]: {(installed_bytes(own) - bare) / 1e6:.0f} MB more")
        shutil.rmtree(folder / extra)


def make_venv(python: str, folder: Path, *requirements: str) -> str:
    """Make a venv with requirements and their dependencies; returns the path of its interpreter."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    run([python, "-m", "venv", str(folder)], folder.parent)
    own = str(folder / "bin" / "python")
    run([own, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *requirements], folder.parent)
    return own


def installed_bytes(python: str) -> int:
    """Size of all that is installed in the venv of an interpreter."""
    root = Path(python).parent.parent
    return sum(path.stat().st_size for path in root.rglob("*") if path.is_file() and not path.is_symlink())


def run(command: list[str], place: Path, environment: dict[str, str] | None = None) -> str:
    """Return the standard output of a command, run in a folder without the checkout on Python's path."""
    clean = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"} | (environment or {})
    return subprocess.run(command, cwd=place, env=clean, check=True, text=True, stdout=subprocess.PIPE).stdout


if __name__ == "__main__":
    sys.exit(main())

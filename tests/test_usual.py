"""The table of ordinary equipment: every row has a unit, a source and a use, and docs/equipment.md prints it."""

import re
from functools import cache
from pathlib import Path

import pytest

from wlr_render import usual

ROOT = Path(__file__).resolve().parents[1]
ROWS = {name: size for name, size in vars(usual).items() if isinstance(size, usual.Size)}
UNITS = {"m", "rad", "deg", "arcmin", "px", "1", "s", "m/s", "deg/s"}


@cache
def words() -> dict[str, set[str]]:
    """Words of the package's modules but the table itself."""
    package = ROOT / "wlr_render"
    paths = [path for path in sorted(package.rglob("*.py")) if path.name != "usual.py"]
    return {
        str(path.relative_to(package).with_suffix("")): set(re.findall(r"\w+", path.read_text(encoding="utf-8")))
        for path in paths
    }


def users(name: str) -> list[str]:
    """Modules of the package that name a row."""
    return [module for module, found in words().items() if name in found]


def shown(size: usual.Size) -> str:
    """A value in the unit that an engineer would write: 3 um, 0.2 mm."""
    if size.unit in ("m", "rad"):
        scale, prefix = (1e3, "m") if size.value >= 2e-4 else (1e6, "u")
        return f"{scale * size.value:.3g} {prefix}{size.unit}"
    return f"{size.value:.3g}" if size.unit == "1" else f"{size.value:.3g} {size.unit}"


def row(name: str, size: usual.Size) -> str:
    spread = f"x {2.718281828**size.log_sigma:.2g}" if size.log_sigma else ""
    modules = ", ".join(f"`{each}`" for each in users(name))
    return f"| `{name}` | {shown(size)} | {spread} | {size.source} | {modules} |"


@pytest.mark.parametrize("name", ROWS)
def test_a_row_has_a_size_a_unit_and_a_source(name: str) -> None:
    size = ROWS[name]
    assert size.value > 0
    assert size.log_sigma >= 0
    assert size.unit in UNITS
    assert re.match("(data sheet|measured|assumption|the worse end|[A-Z])", size.source), size.source


def test_every_row_is_used() -> None:
    assert [name for name in ROWS if not users(name)] == []


def test_names_end_with_their_unit() -> None:
    suffix = {"m": "_M", "rad": "_RAD", "deg": "_DEG", "arcmin": "_ARCMIN", "px": "_PX", "s": "_S"}
    assert [name for name, size in ROWS.items() if size.unit in suffix and not name.endswith(suffix[size.unit])] == []


def test_the_documentation_prints_the_table() -> None:
    printed = (ROOT / "docs/equipment.md").read_text(encoding="utf-8").splitlines()
    table = [line for line in printed if line.startswith("| `")]
    expected = [row(name, size) for name, size in ROWS.items()]
    assert table == expected, "docs/equipment.md must have these rows:\n" + "\n".join(expected)

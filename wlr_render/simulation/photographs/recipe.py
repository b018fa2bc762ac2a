"""Read and write simulation.toml: the recipe of a simulated session's photographs."""

import hashlib
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, get_args

from wlr_render.errors import BadInputError
from wlr_render.io.atomic_files import write_bytes
from wlr_render.io.input_files import LIMITS, read_bytes
from wlr_render.io.toml_files import Table, read_toml, write_toml
from wlr_render.optics.device_file import load_device
from wlr_render.simulation.photographs.imperfections import BenchImperfections, LensKind
from wlr_render.simulation.photographs.photo_bench import (
    Family,
    PhotoBench,
    PhotoBenchOptions,
    Sampling,
    StageKind,
    design_photo_bench,
)

FILE = "simulation.toml"
_DEVICE_COPY = "device.toml"
_OWN_TYPES = (
    "imperfections",
    "stage",
    "sampling",
    "stated_axes_deg",
    "tracking_px",
    "places_mm",
    "family",
)  # fields other than required numbers


@dataclass(frozen=True)
class SimulationRecipe:
    """All inputs that determine the photographs of a simulated session.

    Attributes:
        device: a shipped device by name, or a device file.
        eye: "left" or "right".
        viewpoints: camera positions of the sweeps.
        pattern: name of the panel's code.
        bench: options of the bench.
    """

    device: str
    eye: str = "right"
    viewpoints: int = 25
    pattern: str = "gray-fringes"
    bench: PhotoBenchOptions = field(default_factory=PhotoBenchOptions)

    def build(self) -> PhotoBench:
        """Return the bench itself."""
        return design_photo_bench(load_device(self.device), self.eye, self.bench)


def save_recipe(folder: Path, recipe: SimulationRecipe) -> Path:
    """Write simulation.toml; a device file that is not shipped is copied next to it."""
    content = asdict(recipe)
    if not recipe.bench.places_mm:
        del content["bench"]["places_mm"]
    if Path(recipe.device).suffix == ".toml":
        write_bytes(folder / _DEVICE_COPY, read_bytes(recipe.device, LIMITS.text_bytes))
        content["device"] = _DEVICE_COPY
    return write_toml(folder / FILE, content, "how these photographs were simulated; calibration does not read this")


def load_recipe(folder: Path) -> SimulationRecipe:
    """Read simulation.toml.

    Raises:
        BadInputError: the file is missing, so the session is not simulated, or it breaks the format.
    """
    if not (folder / FILE).is_file():
        raise BadInputError(
            f"{folder}: has no {FILE}, so the session is not simulated; `wlr-render simulate` writes one."
        )
    file = read_toml(folder / FILE)
    table = file.table("bench")
    imperfections = _imperfections(table)
    numbers = [each.name for each in fields(PhotoBenchOptions) if each.name not in _OWN_TYPES]
    values: dict[str, Any] = {name: _value(table, name) for name in numbers}
    values["stage"] = table.text("stage", PhotoBenchOptions.stage, get_args(StageKind))
    values["sampling"] = table.text("sampling", PhotoBenchOptions.sampling, get_args(Sampling))
    values["family"] = table.text("family", PhotoBenchOptions.family, get_args(Family))
    values["stated_axes_deg"] = table.number("stated_axes_deg", PhotoBenchOptions.stated_axes_deg)
    if table.has("tracking_px"):
        values["tracking_px"] = _value(table, "tracking_px")
    if table.has("places_mm"):
        values["places_mm"] = tuple(map(tuple, table.vectors("places_mm", 3).tolist()))
    bench = PhotoBenchOptions(**values, imperfections=imperfections)
    table.finish()
    device = file.file_stem("device")
    recipe = SimulationRecipe(
        str(folder / device) if device == _DEVICE_COPY else device,
        file.text("eye"),
        int(file.number("viewpoints")),
        file.text("pattern"),
        bench,
    )
    file.finish()
    return recipe


def difference(first: SimulationRecipe, second: SimulationRecipe) -> str:
    """Describe the difference between two sessions' photographs, wherever a device file lies; empty if equal."""
    one, other = (_flat(recipe) for recipe in (first, second))
    return ", ".join(f"{key} {one[key]} there, {other[key]} here" for key in one if one[key] != other[key])


def _flat(recipe: SimulationRecipe) -> dict[str, Any]:
    content = asdict(recipe)
    bench = content.pop("bench")
    flat: dict[str, Any] = content | bench.pop("imperfections") | bench
    if places := recipe.bench.places_mm:
        flat["places_mm"] = f"{len(places)} places ({hashlib.sha256(repr(places).encode()).hexdigest()[:8]})"
    if Path(recipe.device).suffix == ".toml":
        digest = hashlib.sha256(read_bytes(recipe.device, LIMITS.text_bytes)).hexdigest()[:8]
        flat["device"] = f"a device file ({digest})"
    return flat


def _imperfections(bench: Table) -> BenchImperfections:
    """Read the table [bench]; sessions of an earlier version state the stage's repeatability only."""
    if bench.has("stage_error_um"):
        return replace(BenchImperfections.none(), repeatability_um=bench.number("stage_error_um"))
    table = bench.table("imperfections")
    sizes: dict[str, Any] = {
        each.name: table.number(each.name) for each in fields(BenchImperfections) if each.name != "lens"
    }
    sizes["lens"] = table.text("lens", choices=get_args(LensKind))
    imperfections = BenchImperfections(**sizes)
    table.finish()
    return imperfections


def _value(table: Table, name: str) -> Any:
    default = getattr(PhotoBenchOptions, name)
    if isinstance(default, tuple):
        return tuple(type(default[0])(value) for value in table.numbers(name))
    return type(default)(table.number(name))

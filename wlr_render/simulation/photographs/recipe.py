"""Read and write simulation.toml: the recipe of a simulated session's photographs."""

from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from wlr_render.errors import BadInputError
from wlr_render.io.atomic_files import write_bytes
from wlr_render.io.file_records import attributes, read_record
from wlr_render.io.input_files import LIMITS, read_bytes
from wlr_render.io.kept import file_of
from wlr_render.io.toml_files import Table, read_toml, write_toml
from wlr_render.optics.device_file import load_device
from wlr_render.simulation.photographs.imperfections import BenchImperfections
from wlr_render.simulation.photographs.photo_bench import PhotoBench, PhotoBenchOptions, design_photo_bench

FILE = "simulation.toml"
_DEVICE_COPY = "device.toml"
_LATER = ("stage", "sampling", "stated_axes_deg", "tracking_px", "places_mm", "family")  # keys of later versions


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
    device, table = file.file_stem("device"), file.table("bench")
    if table.has("stage_error_um"):  # sessions of an earlier version state the stage's repeatability only
        errors = replace(BenchImperfections.none(), repeatability_um=table.number("stage_error_um"))
    else:
        _require_all(table.table("imperfections"), BenchImperfections)
        errors = read_record(BenchImperfections, table.table("imperfections"))
    _require_all(table, PhotoBenchOptions)
    _require_all(file, SimulationRecipe)
    bench = read_record(PhotoBenchOptions, table, imperfections=errors)
    device = str(folder / device) if device == _DEVICE_COPY else device
    return read_record(SimulationRecipe, file, device=device, bench=bench)


def _require_all(table: Table, kind: type) -> None:
    """Refuse a table without a key that every recipe has: a default could differ from what was simulated."""
    for each in attributes(kind):
        if each.name not in _LATER and not table.has(each.name):
            raise table.fail(f"key '{each.name}' is missing; write it.")


def values_of(recipe: SimulationRecipe) -> dict[str, Any]:
    """Return all values by name, for `kept.recipe_of`; a device file counts as an input."""
    content = asdict(recipe)
    bench = content.pop("bench")
    device = file_of(recipe.device) if Path(recipe.device).suffix == ".toml" else recipe.device
    return dict(content | {"device": device} | bench.pop("imperfections") | bench)

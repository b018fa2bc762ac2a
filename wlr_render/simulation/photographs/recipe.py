"""Write simulation.toml: the recipe of a simulated session's photographs."""

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from wlr_render.io.atomic_files import write_bytes
from wlr_render.io.input_files import LIMITS, read_bytes
from wlr_render.io.kept import file_of
from wlr_render.io.toml_files import write_toml
from wlr_render.optics.device_file import load_device
from wlr_render.simulation.photographs.photo_bench import PhotoBench, PhotoBenchOptions, design_photo_bench

FILE = "simulation.toml"
DEVICE_COPY = "device.toml"


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
        """Return the simulated bench."""
        return design_photo_bench(load_device(self.device), self.eye, self.bench)


def save_recipe(folder: Path, recipe: SimulationRecipe) -> Path:
    """Write simulation.toml; a device file that is not shipped is copied next to it."""
    content = asdict(recipe)
    if not recipe.bench.places_mm:
        del content["bench"]["places_mm"]
    if Path(recipe.device).suffix == ".toml":
        write_bytes(folder / DEVICE_COPY, read_bytes(recipe.device, LIMITS.text_bytes))
        content["device"] = DEVICE_COPY
    return write_toml(folder / FILE, content, "how these photographs were simulated; calibration does not read this")


def values_of(recipe: SimulationRecipe) -> dict[str, Any]:
    """Return all values by name, for `kept.recipe_of`; a device file counts as an input."""
    content = asdict(recipe)
    bench = content.pop("bench")
    device = file_of(recipe.device) if Path(recipe.device).suffix == ".toml" else recipe.device
    return dict(content | {"device": device} | bench.pop("imperfections") | bench)

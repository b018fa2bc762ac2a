"""Read simulation.toml, the recipe of a simulated session's photographs, as `simulate` writes it."""

from pathlib import Path

from wlr_render.errors import BadInputError
from wlr_render.io.file_records import attributes, read_record
from wlr_render.io.toml_files import Table, read_toml
from wlr_render.simulation.photographs.imperfections import BenchImperfections
from wlr_render.simulation.photographs.photo_bench import PhotoBenchOptions
from wlr_render.simulation.photographs.recipe import DEVICE_COPY, FILE, SimulationRecipe


def load_recipe(folder: Path) -> SimulationRecipe:
    """Return the recipe of a session.

    Raises:
        BadInputError: the file is missing, so the session is not simulated, or it breaks the format.
    """
    if not (folder / FILE).is_file():
        raise BadInputError(
            f"{folder}: has no {FILE}, so the session is not simulated; `wlr-render simulate` writes one."
        )
    file = read_toml(folder / FILE)
    device, table = file.file_stem("device"), file.table("bench")
    tables = {SimulationRecipe: file, PhotoBenchOptions: table, BenchImperfections: table.table("imperfections")}
    for kind, each in tables.items():
        _require_all(each, kind)
    errors = read_record(BenchImperfections, tables[BenchImperfections])
    bench = read_record(PhotoBenchOptions, table, imperfections=errors)
    device = str(folder / device) if device == DEVICE_COPY else device
    return read_record(SimulationRecipe, file, device=device, bench=bench)


def _require_all(table: Table, kind: type) -> None:
    """Refuse a table without a key that every recipe has: a default could differ from the simulated value."""
    for each in attributes(kind):
        if each.name != "places_mm" and not table.has(each.name):
            raise table.fail(f"key '{each.name}' is missing; write it.")

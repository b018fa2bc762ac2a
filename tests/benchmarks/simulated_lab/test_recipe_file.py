import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.simulated_lab.recipe_file import load_recipe
from wlr_render.errors import BadInputError
from wlr_render.io.atomic_files import resource
from wlr_render.simulation.photographs.imperfections import BenchImperfections
from wlr_render.simulation.photographs.photo_bench import PhotoBenchOptions
from wlr_render.simulation.photographs.recipe import SimulationRecipe, save_recipe

BENCH = PhotoBenchOptions(
    (640, 512),
    imperfections=replace(BenchImperfections().scaled(0.5), lens="thin-prism"),
    stage="x",
    tracking_px=(800, 600),
    places_mm=((1.0, 0.0, 0.0), (-1.0, 0.5, 0.0)),
)


@pytest.mark.parametrize(
    "recipe",
    [
        SimulationRecipe("birdbath28", eye="left", viewpoints=3),
        SimulationRecipe("birdbath28", bench=PhotoBenchOptions(sampling="volumetric", stated_axes_deg=0.1)),
        SimulationRecipe("plane_plate", pattern="gray", bench=PhotoBenchOptions(family="workshop")),
        SimulationRecipe("birdbath28", bench=BENCH),
    ],
)
def test_a_recipe_is_read_as_it_was_written(recipe: SimulationRecipe, tmp_path: Path) -> None:
    save_recipe(tmp_path, recipe)
    assert load_recipe(tmp_path) == recipe


def test_a_device_file_is_kept_beside_the_recipe(tmp_path: Path) -> None:
    mine = tmp_path / "mine.toml"
    shutil.copy(resource("devices", "birdbath28.toml"), mine)
    save_recipe(tmp_path, SimulationRecipe(str(mine)))
    mine.unlink()
    assert load_recipe(tmp_path).device == str(tmp_path / "device.toml")
    assert (tmp_path / "device.toml").is_file()


@pytest.mark.parametrize(
    ("before", "after", "complaint"),
    [("snr = ", "snr = 'much' #", "'snr' must be a number"), ("seed", "sead", "key 'seed' is missing")],
)
def test_a_recipe_that_was_spoilt_is_refused(before: str, after: str, complaint: str, tmp_path: Path) -> None:
    path = save_recipe(tmp_path, SimulationRecipe("birdbath28"))
    content = path.read_text(encoding="utf-8")
    path.unlink()
    path.write_text(content.replace(before, after, 1), encoding="utf-8")
    assert before in content
    with pytest.raises(BadInputError, match=complaint):
        load_recipe(tmp_path)

"""Fixtures: small headsets and a small scene, so that whole jobs run in seconds."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from memo import memoised, shared_folder

from benchmarks.speed.workload import bench_model
from wlr_render.io.atomic_files import resource
from wlr_render.mappings import DisplayMapping, Eye, Panel, QueryResult, Status
from wlr_render.models.model_file import EyeModel, save_eye_models
from wlr_render.numerics.arrays import FloatArray

SCENE = """
format = "wlr-scene"
version = 1
frame = "openxr"
ambient = [0.3, 0.3, 0.3]
background = [0.0, 0.1, 0.0]

[[light]]
kind = "directional"
direction = [0.3, -0.8, -0.5]
colour = [0.6, 0.6, 0.6]

[[object]]
name = "ball"
shape = "ball"
radius_m = 0.06
position_m = [0.03, 0.01, -0.5]

[[object]]
name = "wall"
shape = "plane"
width_m = 4
height_m = 3
position_m = [0, 0, -1.5]
"""


def changed_device(folder: Path, name: str, *changes: tuple[str, str]) -> str:
    """Path of a copy of a shipped device with some text replaced: (old, new) pairs."""
    text = resource("devices", f"{name}.toml").read_text(encoding="utf-8")
    for old, new in changes:
        assert text.count(old) == 1
        text = text.replace(old, new)
    path = folder / f"{name}.toml"
    path.write_text(text, encoding="utf-8")
    return str(path)


@dataclass(frozen=True)
class LeftHalf:
    """A display whose right half shows nothing."""

    whole: DisplayMapping

    @property
    def panel(self) -> Panel:
        return self.whole.panel

    def pixel_of_view_dir(
        self, view_dir: FloatArray, viewpoint: FloatArray, warm_start: FloatArray | None = None
    ) -> QueryResult:
        return self.whole.pixel_of_view_dir(view_dir, viewpoint, warm_start)

    def view_dir_of_pixel(self, pixel: FloatArray, viewpoint: FloatArray, warm_start: object = None) -> QueryResult:
        found: QueryResult = self.whole.view_dir_of_pixel(pixel, viewpoint)
        is_dark = np.broadcast_to(np.asarray(pixel)[..., 0] > 0.5 * self.whole.panel.width_px, found.status.shape)
        value = np.where(is_dark[..., None], np.nan, found.value)
        return replace(found, value=value, status=np.where(is_dark, Status.MISS, found.status).astype(np.uint8))


@pytest.fixture(scope="session")
def small_northstar(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Path of northstar with an eighth of the pixels across and down."""
    return changed_device(tmp_path_factory.mktemp("device"), "northstar", ("[1440, 1600]", "[180, 200]"))


@pytest.fixture(scope="session")
def small_prism(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Path of a prism whose glass has the colours of PMMA, 160 x 120 pixels."""
    return prism_of_plastic(tmp_path_factory.mktemp("device"), 160, 120)


def prism_of_plastic(folder: Path, width: int, height: int) -> str:
    glass = ("index = 1.492", 'formula = "pmma_sultanova_2009"')
    return changed_device(folder, "prism5701202", glass, ("[1280, 960]", f"[{width}, {height}]"))


@pytest.fixture(scope="session")
def straight_device(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Path of a device without optics for both eyes, 64 x 36 pixels: everything about it is a straight line."""
    both_eyes = ('side = "right"', 'side = "right"\nalso_mirrored = true')
    return changed_device(tmp_path_factory.mktemp("device"), "no_optics", ("[1280, 720]", "[64, 36]"), both_eyes)


@pytest.fixture(scope="session")
def small_panel_model(tmp_path_factory: pytest.TempPathFactory) -> Eye:
    """Mappings of northstar's right eye, fitted, with a panel of 90 x 100 pixels and few terms."""
    return memoised(bench_model, shared_folder(tmp_path_factory))(Panel(90, 100), degrees=(7, 5))


@pytest.fixture(scope="session")
def model_file(tmp_path_factory: pytest.TempPathFactory, small_panel_model: Eye) -> str:
    """Path of the same as a model file."""
    path = tmp_path_factory.mktemp("model") / "model.json"
    return str(save_eye_models(path, [EyeModel(replace(small_panel_model, name="fitted"), "northstar")]))


@pytest.fixture(scope="session")
def scene_file(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Path of a ball before a wall."""
    path = tmp_path_factory.mktemp("scene") / "ball.toml"
    path.write_text(SCENE, encoding="utf-8")
    return str(path)

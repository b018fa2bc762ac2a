"""SteamVR's JSON file, read by Monado's published formula and by our own reader."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from monado_vive import COLOURS, monados_directions

from wlr_render.exports.steamvr import SteamVr
from wlr_render.geometry.directions import arcmin_between, dir_of_tangents
from wlr_render.geometry.transforms import rotation_about
from wlr_render.jobs.export import views_from_centres
from wlr_render.jobs.export_options import ExportOptions
from wlr_render.jobs.headset import open_colours


def round_lenses(turn_deg: float) -> dict[str, Any]:
    """A headset with round lenses, turned about x and y, whose colours differ by 1 % at the border."""

    def eye(side: float) -> dict[str, Any]:
        x, y = 0.07 * side, 0.011
        colours = {
            name: {"type": "DISTORT_DPOLY3", "coeffs": [-0.2 + c, 0.03, -0.01], "center_x": x + 0.1 * c, "center_y": y}
            for name, c in zip(COLOURS, (0.01, 0.0, -0.02), strict=True)
        }
        turn = rotation_about("y", np.deg2rad(-turn_deg * side)) @ rotation_about("x", np.deg2rad(0.3 * turn_deg))
        return colours | {"intrinsics": [[1.25, 0, -x], [0, 1.12, 0.9 * y], [0, 0, -1]], "eye_to_head": turn.tolist()}

    device = {"eye_target_width_in_pixels": 180, "eye_target_height_in_pixels": 200}
    return {"device": device, "lens_separation": 0.063, "tracking_to_eye_transform": [eye(-1.0), eye(1.0)]}


@pytest.fixture(scope="module")
def unit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("unit") / "unit.json"
    path.write_text(json.dumps(round_lenses(6.0)))
    return path


@pytest.mark.parametrize("per_colour", [True, False])
def test_round_lenses_survive_in_all_colours(unit: Path, per_colour: bool, tmp_path: Path) -> None:
    options = ExportOptions(str(unit), format="steamvr", eye="both", per_colour=per_colour)
    views = views_from_centres(options)
    (path,) = SteamVr().write(views.values(), tmp_path)
    content = json.loads(path.read_text())
    assert content["lens_separation"] == pytest.approx(0.063)
    pixel = np.random.default_rng(7).uniform(0.05, 0.95, (50, 2)) * [180, 200]
    for number, side in enumerate(("left", "right")):
        exact, ours = open_colours(unit, side), open_colours(path, side)
        for colour in range(3):
            wanted = exact[colour if per_colour else 1]
            expected = wanted.display.view_dir_of_pixel(pixel, wanted.eye_box.centre).value
            assert arcmin_between(monados_directions(content, number, colour, pixel), expected).max() < 1e-3
            found = ours[colour].display.view_dir_of_pixel(pixel, ours[colour].eye_box.centre).value
            assert arcmin_between(found, expected).max() < 1e-3
        loss = SteamVr().interpolation(views[side], views[side].middle_colour)
        assert loss.max_arcmin is not None
        assert loss.max_arcmin < 1e-3


def test_what_is_not_round_is_stated_as_the_loss(tmp_path: Path) -> None:
    """An off-axis combiner: the file's own directions are as wrong as `about` says, and one colour serves all."""
    views = views_from_centres(ExportOptions("northstar", format="steamvr", eye="both"))
    (path,) = SteamVr().write(views.values(), tmp_path)
    content = json.loads(path.read_text())
    (loss,) = (each for each in content["about"]["left"]["loses"] if each["case"] == "radial distortion")
    edges = np.linspace(0.0, 1.0, 25)
    pixel = np.stack(np.meshgrid(edges * 1440, edges * 1600), axis=-1).reshape(-1, 2)
    view = views["left"]
    exact = dir_of_tangents(view.tangents(np.moveaxis(view.rays_at("all", pixel), -1, 0)))
    shown = monados_directions(content, 0, 2, pixel) @ view.source.device_from_camera
    assert float(arcmin_between(shown, exact).max()) == pytest.approx(loss["max_arcmin"], rel=1e-6)
    assert loss["max_arcmin"] > 10.0

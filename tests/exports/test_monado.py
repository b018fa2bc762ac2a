import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from wlr_render.errors import BadInputError
from wlr_render.exports.export_view import ExportedView
from wlr_render.exports.monado import Monado
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.jobs.export import views_from_centres
from wlr_render.jobs.export_options import ExportOptions
from wlr_render.numerics.arrays import FloatArray

N = 65


@pytest.fixture(scope="module")
def northstar_views() -> list[ExportedView]:
    """Both eyes with all pixels of the panel, as the driver demands."""
    return list(views_from_centres(ExportOptions("northstar", format="monado", eye="both", depth_m=2.0)).values())


@pytest.fixture(scope="module")
def config(northstar_views: Sequence[ExportedView], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    (path,) = Monado().write(northstar_views, tmp_path_factory.mktemp("monado"))
    content: dict[str, Any] = json.loads(path.read_text())
    return content


def as_the_driver_reads(config: dict[str, Any], eye: str) -> FloatArray:
    """(N, N, 2) positions in the eye's picture, 0 to 1 from the top left, by the driver's formula for grid points."""
    left, right, up, down = np.tan(config["fov"])
    x, y = np.moveaxis(np.array(config[eye]["grid"]), -1, 0)
    return np.stack([(x - left) / (right - left), (y - down) / (up - down)], axis=-1)


def test_the_driver_reads_the_places_in_the_source_picture(
    config: dict[str, Any], northstar_views: Sequence[ExportedView]
) -> None:
    for view in northstar_views:
        u, v = np.linspace(0, 1440, N), np.linspace(0, 1600, N)
        exact = view.tangents(np.moveaxis(view.rays_at("all", np.stack(np.meshgrid(u, v), axis=-1)), -1, 0))
        camera = view.source.camera
        expected = camera.pixel_of_tangents(exact) / camera.size_px
        assert np.abs(as_the_driver_reads(config, view.eye) - expected).max() < 1e-9
        assert ((expected > 0) & (expected < 1)).all()


def test_both_eyes_have_one_symmetric_picture_in_the_devices_axes(
    config: dict[str, Any], northstar_views: Sequence[ExportedView]
) -> None:
    left, right, up, down = config["fov"]
    assert (left, down) == (-right, -up)
    assert config["baseline"] == pytest.approx(64.0)
    for view in northstar_views:
        assert (view.source.device_from_camera == np.eye(3)).all()
        tangents = config["about"][view.eye]["source_camera"]["tangents"]
        assert np.arctan([tangents["left"], tangents["top"]]).tolist() == pytest.approx([left, up])


def test_the_file_says_what_it_loses(config: dict[str, Any]) -> None:
    for eye in ("left", "right"):
        about = config["about"][eye]
        assert about["eye"] == eye
        assert about["depth_m"] == 2.0
        assert 0.2 < about["linear_between_points_max_arcmin"] < 0.6
        assert 0.5 < about["used_share_of_the_source_picture"]["height"] < 0.6
        assert np.abs(about["source_camera_from_where_monado_places_it_m"]).max() < 1e-12
        assert "pupil displaced by 2 mm" in [loss["case"] for loss in about["loses"]]


def test_pupils_that_monado_cannot_place_are_stated(northstar_views: Sequence[ExportedView], tmp_path: Path) -> None:
    left, right = northstar_views
    source = replace(right.source, position_in_device=right.source.position_in_device + [0, 0.002, 0])
    (path,) = Monado().write([left, replace(right, source=source)], tmp_path)
    about = json.loads(path.read_text())["about"]
    assert about["right"]["source_camera_from_where_monado_places_it_m"] == pytest.approx([0, 0.001, 0])
    assert about["left"]["source_camera_from_where_monado_places_it_m"] == pytest.approx([0, -0.001, 0])


@pytest.mark.parametrize("flag", [{"per_colour": True}, {"pupils": 3}])
def test_colours_and_a_moving_pupil_are_refused(flag: Mapping[str, Any]) -> None:
    with pytest.raises(BadInputError, match=r"monado has one .*; leave out"):
        ExportOptions("northstar", format="monado", eye="both", **flag)


def test_another_panel_is_refused(northstar_view: ExportedView, tmp_path: Path) -> None:
    views = [northstar_view, replace(northstar_view, channels=northstar_view.channels)]
    views[0] = replace(views[0], channels=(replace(views[0].channels[0], eye="left"),))
    with pytest.raises(BadInputError, match=r"1440 x 1600 pixels for each eye, and the panel of .* has 180 x 200"):
        list(Monado().write(views, tmp_path))


def test_a_panel_without_all_rays_is_refused(northstar_views: Sequence[ExportedView], tmp_path: Path) -> None:
    left, right = northstar_views
    object.__setattr__(holed := replace(right), "rays_at", lambda *_: np.full((N, N, 4), np.nan))
    with pytest.raises(BadInputError, match=r"100\.0% of the right panel of northstar .* has no ray"):
        list(Monado().write([left, holed], tmp_path))


def test_eyes_of_different_fields_get_one_camera(straight_device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    left = Pinhole(100, 100, np.array([-0.5, -0.3]), np.array([0.2, 0.4]))
    right = Pinhole(200, 100, np.array([-0.1, -0.6]), np.array([0.3, 0.1]))
    for size, expected in ((None, (500, 172)), ((64, 48), (64, 48))):
        cameras = iter([left, right])
        monkeypatch.setattr("wlr_render.exports.export_view.intermediate_camera", lambda *_, of=cameras: next(of))
        views = views_from_centres(ExportOptions(straight_device, format="monado", eye="both", source_size=size))
        for view in views.values():
            camera = view.source.camera
            assert (camera.tangent_min.tolist(), camera.tangent_max.tolist()) == ([-0.5, -0.6], [0.5, 0.6])
            assert camera.size_px == expected

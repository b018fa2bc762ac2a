import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from wlr_render.exports.export_view import ExportedView
from wlr_render.exports.pixel_maps import Npz, Rays
from wlr_render.geometry import transforms
from wlr_render.numerics.arrays import Float32Array

PIXEL = np.array([[20.5, 30.5], [90.5, 100.5], [170.5, 20.5], [11.5, 190.5]])
DEPTHS_M = (0.3, 1.0, 20.0)


def error_px(rays: Float32Array, facts: dict[str, Any], view: ExportedView) -> float:
    """Distance in panel pixels between those of `PIXEL` and those that the eye sees their rays' points with.

    The points are computed as the page tells a receiver; the exact optics are asked backwards.
    """
    camera = facts["source_camera"]
    device_from_camera = transforms.rigid(np.array(camera["device_from_camera"]), camera["position_in_device_m"])
    viewpoint = np.array(facts["viewpoint_in_device_m"])
    column, row = PIXEL.astype(int).T
    a, b, c, d = rays[:, row, column].astype(float)
    worst = 0.0
    for depth_m in DEPTHS_M:
        point = np.stack([a * depth_m + c, b * depth_m + d, np.full_like(a, -depth_m)], axis=-1)
        in_device = transforms.apply(device_from_camera, point)
        seen = view.channels[0].see_through.view_dir_of_real_point(in_device, viewpoint)
        pixel = view.channels[0].display.pixel_of_view_dir(seen.value, viewpoint)
        worst = max(worst, float(np.linalg.norm(pixel.value - PIXEL, axis=-1).max()))
    return worst


@pytest.mark.parametrize("camera", ["viewpoint", "nearest"])
def test_points_of_a_ray_file_appear_at_their_pixels_at_every_depth(
    camera: str, view: ExportedView, nearest_view: ExportedView, tmp_path: Path
) -> None:
    oiio = pytest.importorskip("OpenImageIO", reason="OpenImageIO reads the rays: pip install OpenImageIO")
    chosen = view if camera == "viewpoint" else nearest_view
    (path,) = Rays().write([chosen], tmp_path)
    opened = oiio.ImageBuf(str(path))
    assert opened.spec().channelnames == ("R", "G", "B", "A")
    header = {each.name: each.value for each in opened.spec().extra_attribs}
    facts = {name: json.loads(header[f"wlr:{name}"]) for name in ("source_camera", "viewpoint_in_device_m")}
    assert header["wlr:depth_m"] == "every"
    assert error_px(np.moveaxis(opened.get_pixels(), -1, 0), facts, chosen) < 0.005


@pytest.mark.parametrize("camera", ["viewpoint", "nearest"])
def test_points_of_an_array_file_appear_at_their_pixels_at_every_depth(
    camera: str, view: ExportedView, nearest_view: ExportedView, tmp_path: Path
) -> None:
    chosen = view if camera == "viewpoint" else nearest_view
    (path,) = Npz().write([chosen], tmp_path)
    with np.load(path) as data:
        rays, facts, colours = data["rays"], json.loads(str(data["facts"])), data["colours"].tolist()
    assert colours == ["all"]
    assert facts["depth_m"] == "every"
    assert [loss["case"] for loss in facts["loses"]] == [
        "points at any depth, as the file is made for",
        "red light, 615 nm",
        "blue light, 464 nm",
        "pupil displaced by 2 mm",
    ]
    assert error_px(rays[0], facts, chosen) < 0.005
    moved_px = np.linalg.norm(chosen.source.position_in_device - chosen.viewpoint)
    assert (moved_px > 1e-4) == (camera == "nearest")

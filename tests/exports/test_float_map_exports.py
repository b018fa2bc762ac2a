import json
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import pytest
from present import present

from benchmarks.exports.readers import our_warp, smooth_picture
from wlr_render.exports.export_view import ExportedView
from wlr_render.exports.pixel_maps import FloatMap
from wlr_render.scene.image_files import read_map


@pytest.mark.parametrize("name", ["pfm", "tiff"])
def test_opencv_draws_what_our_own_warp_draws(name: Literal["pfm", "tiff"], view: ExportedView, tmp_path: Path) -> None:
    path, facts = FloatMap(name).write([view], tmp_path)
    picture = smooth_picture(view.source.camera.size_px)
    positions = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    warped = cv2.remap(picture, present(positions)[..., 2] - 0.5, present(positions)[..., 1] - 0.5, cv2.INTER_LINEAR)
    ours, inside = our_warp(picture, view)
    assert inside.all()
    assert np.abs(warped - ours).max() <= 0.01
    assert json.loads(facts.read_text(encoding="utf-8"))["kind"] == name


@pytest.mark.parametrize("name", ["pfm", "tiff"])
def test_openimageio_reads_the_channels_in_order(
    name: Literal["pfm", "tiff"], view: ExportedView, tmp_path: Path
) -> None:
    oiio = pytest.importorskip("OpenImageIO", reason="OpenImageIO reads the map: pip install OpenImageIO")
    path, _ = FloatMap(name).write([view], tmp_path)
    settings = oiio.ImageSpec()
    settings.attribute("pnm:pfmflip", 1)  # the top row first: version 3.2.2 needs to be told
    read = oiio.ImageInput.open(str(path), settings).read_image()
    np.testing.assert_array_equal(read[..., :2], view.source_px("all"))


def test_third_channel_is_the_inverse_depth(near_view: ExportedView, view: ExportedView, tmp_path: Path) -> None:
    for chosen, expected in ((view, 0.0), (near_view, 2.0)):
        path, _ = FloatMap("tiff").write([chosen], tmp_path)
        assert np.unique(read_map(path)[..., 2]) == [expected]


def test_depth_moves_the_positions_as_the_headset_does(near_view: ExportedView, view: ExportedView) -> None:
    moved_px = np.linalg.norm(near_view.source_px("all") - view.source_px("all"), axis=-1)
    arcmin = moved_px / np.mean(view.source.camera.focal_px) * 60 * 180 / np.pi
    assert 0.5 < np.median(arcmin) < 2.5  # the page states 1.36' rms between infinity and 0.5 m


def test_facts_state_what_the_map_of_their_own_colour_loses(coloured_view: ExportedView, tmp_path: Path) -> None:
    facts = [path for path in FloatMap("tiff").write([coloured_view], tmp_path) if path.suffix == ".json"]
    stated = [json.loads(path.read_text(encoding="utf-8"))["loses"][-1]["rms_arcmin"] for path in facts]
    assert len(set(stated)) == len(coloured_view.colours) == 3

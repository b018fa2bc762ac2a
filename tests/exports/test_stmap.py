import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks.exports.readers import our_warp, smooth_picture, warped_by_openimageio
from wlr_render.exports.export_view import ExportedView
from wlr_render.exports.pixel_maps import StMap
from wlr_render.scene.exr_file import read_exr


def written(view: ExportedView, folder: Path) -> Path:
    (path,) = StMap().write([view], folder)
    return path


def test_openimageio_draws_what_our_own_warp_draws(view: ExportedView, tmp_path: Path) -> None:
    pytest.importorskip("OpenImageIO", reason="st_warp of OpenImageIO: pip install OpenImageIO")
    picture = smooth_picture(view.source.camera.size_px)
    ours, inside = our_warp(picture, view)
    warped = warped_by_openimageio(picture, written(view, tmp_path), view.panel_size_px)
    assert inside.all()
    assert np.abs(warped - ours).max() <= 0.01  # of 255


def test_header_says_what_a_receiver_must_know(view: ExportedView, tmp_path: Path) -> None:
    _, texts = read_exr(written(view, tmp_path))
    assert texts["eye"] == "right"
    assert texts["depth_m"] == "infinity"
    (sha256,) = json.loads(texts["sha256"]).values()
    assert len(sha256) == 64
    assert json.loads(texts["viewpoint_in_device_m"]) == view.viewpoint.tolist()
    camera = json.loads(texts["source_camera"])
    assert camera["size_px"] == list(view.source.camera.size_px)
    assert camera["tangents"]["left"] == view.source.camera.tangent_min[0]
    cases = {loss["case"]: loss["rms_arcmin"] for loss in json.loads(texts["loses"])}
    assert cases["points 0.5 m deep"] == pytest.approx(1.37, abs=0.02)
    assert cases["pupil displaced by 2 mm"] == pytest.approx(30, abs=0.5)


def test_panel_pixels_without_a_ray_read_outside_the_picture(holed_view: ExportedView, tmp_path: Path) -> None:
    channels, _ = read_exr(written(holed_view, tmp_path))
    assert np.argwhere(channels["R"] == -1).tolist() == [[5, 7]]
    assert np.argwhere(channels["G"] == -1).tolist() == [[5, 7]]
    assert np.isfinite(channels["R"]).all()

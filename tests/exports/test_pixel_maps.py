"""Maps of pixels as OpenImageIO, OpenCV, NumPy and FFmpeg read and draw them."""

import json
import shutil
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from present import present

from benchmarks.exports.readers import drawn_by_ffmpeg, our_warp, smooth_picture, warped_by_openimageio
from wlr_render.draw.sampling import remap
from wlr_render.exports.export_view import ExportedView
from wlr_render.exports.pixel_maps import FFMPEG_NO_RAY, Ffmpeg, FloatMap, Npz, Rays, StMap
from wlr_render.geometry import transforms
from wlr_render.numerics.arrays import Float32Array
from wlr_render.scene.exr_file import read_exr
from wlr_render.scene.image_files import read_map


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


needs_ffmpeg = pytest.mark.skipif(
    shutil.which("ffmpeg") is None, reason="ffmpeg is not installed: apt-get install ffmpeg"
)


def nearest(picture: NDArray[np.uint8], view: ExportedView, colour: str) -> NDArray[np.uint8]:
    column, row = np.moveaxis(np.floor(np.nan_to_num(view.source_px(colour))).astype(int), -1, 0)
    return np.asarray(picture[row, column])


def test_pair_names_whole_pixels(view: ExportedView, tmp_path: Path) -> None:
    across, down, _ = Ffmpeg().write([view], tmp_path)
    column_row = np.stack([present(cv2.imread(str(path), cv2.IMREAD_UNCHANGED)) for path in (across, down)], axis=-1)
    assert column_row.dtype == np.uint16
    assert across.read_bytes()[:2] == b"P5"
    off_px = np.abs(column_row + 0.5 - view.source_px("all"))
    assert off_px.max() <= 0.5
    assert off_px.mean() == pytest.approx(0.25, abs=0.01)


def test_pixels_without_a_ray_are_left_to_the_fill(holed_view: ExportedView, tmp_path: Path) -> None:
    across, down, _ = Ffmpeg().write([holed_view], tmp_path)
    for path in (across, down):
        values = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        assert np.argwhere(values == FFMPEG_NO_RAY).tolist() == [[5, 7]]


@needs_ffmpeg
def test_ffmpeg_draws_the_nearest_pixels_bit_for_bit(holed_view: ExportedView, tmp_path: Path) -> None:
    list(Ffmpeg().write([holed_view], tmp_path))
    picture = smooth_picture(holed_view.source.camera.size_px).astype(np.uint8)
    pair = ["-i", "right-x.pgm", "-i", "right-y.pgm", "-lavfi", "remap=fill=black"]
    drawn = drawn_by_ffmpeg(tmp_path, picture, pair, "ffmpeg")
    expected = nearest(picture, holed_view, "all")
    expected[5, 7] = 0
    np.testing.assert_array_equal(drawn, expected)
    assert not np.array_equal(remap(picture, holed_view.source_px("all"))[0], expected)  # which interpolates


@needs_ffmpeg
def test_ffmpeg_draws_each_colour_by_its_own_map(coloured_view: ExportedView, tmp_path: Path) -> None:
    list(Ffmpeg().write([coloured_view], tmp_path))
    picture = smooth_picture(coloured_view.source.camera.size_px).astype(np.uint8)
    pairs = [part for name in coloured_view.colours for axis in "xy" for part in ("-i", f"right-{name}-{axis}.pgm")]
    drawn = drawn_by_ffmpeg(tmp_path, picture, [*pairs, "-filter_complex", PER_COLOUR], "ffmpeg")
    for plane, name in enumerate(coloured_view.colours):
        np.testing.assert_array_equal(drawn[..., plane], nearest(picture, coloured_view, name)[..., plane])
    assert not np.array_equal(drawn[..., 0], nearest(picture, coloured_view, "blue")[..., 0])


PER_COLOUR = next(step for step in Ffmpeg.use if "mergeplanes" in step).split('"')[1]

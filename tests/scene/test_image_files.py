from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from browser import needs_browser, open_page
from present import present

from wlr_render.errors import BadInputError
from wlr_render.scene import image_files
from wlr_render.scene.exr_file import read_exr, write_exr

FLOATS: Any = [np.zeros((32, 48, 3))]  # no pictures to the functions
NOTHING: Any = None


def test_png_keeps_red_red(tmp_path: Path) -> None:
    image = np.zeros((4, 6, 3), np.uint8)
    image[0, 0] = [200, 100, 50]
    path = image_files.write_png(tmp_path / "a.png", image)
    np.testing.assert_array_equal(image_files.read_png(path), image)
    assert present(cv2.imread(str(path)))[0, 0].tolist() == [50, 100, 200]


@pytest.mark.parametrize("suffix", [".tiff", ".pfm"])
def test_float_maps_round_trip_bit_for_bit_with_their_holes(tmp_path: Path, suffix: str) -> None:
    values = np.random.default_rng(0).normal(size=(7, 5, 3)).astype(np.float32)
    values[2, 3] = np.nan
    path = image_files.write_map(tmp_path / f"map{suffix}", values)
    np.testing.assert_array_equal(image_files.read_map(path), values)


def test_pfm_follows_its_format(tmp_path: Path) -> None:
    values = np.arange(12, dtype=np.float32).reshape(2, 2, 3)
    head, size, scale, *rest = image_files.write_map(tmp_path / "m.pfm", values).read_bytes().split(b"\n", 3)
    assert (head, size) == (b"PF", b"2 2")
    order = "<f4" if float(scale) < 0 else ">f4"
    np.testing.assert_array_equal(np.frombuffer(rest[0], order).reshape(2, 2, 3)[::-1], values)


def test_video_has_its_frames(tmp_path: Path) -> None:
    frames = [np.full((32, 48, 3), 40 * k, np.uint8) for k in range(5)]
    path = image_files.write_video(tmp_path / "v.mp4", frames, 30.0)
    video = cv2.VideoCapture(str(path))
    brightness = []
    while (read := video.read())[0]:
        brightness.append(read[1].mean())
    np.testing.assert_allclose(brightness, [0, 40, 80, 120, 160], atol=3)


@needs_browser
def test_a_browser_plays_the_video(tmp_path: Path) -> None:
    image_files.write_video(tmp_path / "v.mp4", [np.full((32, 48, 3), 40 * k, np.uint8) for k in range(5)], 10.0)
    page = tmp_path / "page.html"
    page.write_text(
        """<!doctype html><body><video muted preload="auto" src="v.mp4"></video><script>
        const video = document.querySelector("video");
        video.onloadeddata = () => {
            document.body.title = `${video.videoWidth} x ${video.videoHeight}, ${video.duration} s`;
        };
        </script></body>"""
    )
    assert 'title="48 x 32, 0.5 s"' in open_page(page, tmp_path).dom


@pytest.mark.parametrize(
    ("write", "name"),
    [
        (lambda path: image_files.write_png(path, FLOATS[0]), "a.png"),
        (lambda path: image_files.write_png(path, np.zeros((4, 6, 4), np.uint8)), "a.png"),
        (lambda path: image_files.write_png(path, np.zeros((0, 6, 3), np.uint8)), "a.png"),
        (lambda path: image_files.write_png(path, NOTHING), "a.png"),
        (lambda path: image_files.write_map(path, np.zeros((4, 6), np.float32)), "a.tiff"),
        (lambda path: image_files.write_map(path, np.zeros((4, 6, 3), complex)), "a.tiff"),
        (lambda path: image_files.write_video(path, [np.zeros((32, 48, 3), np.uint8)], 0.0), "a.mp4"),
        (lambda path: image_files.write_video(path, [np.zeros((32, 48, 3), np.uint8)], np.nan), "a.mp4"),
        (lambda path: image_files.write_video(path, [np.zeros((n, 48, 3), np.uint8) for n in (32, 16)], 9.0), "a.mp4"),
        (lambda path: image_files.write_video(path, FLOATS, 9.0), "a.mp4"),
    ],
)
def test_what_opencv_would_convert_or_crash_on_is_refused(tmp_path: Path, write: Callable[..., Any], name: str) -> None:
    with pytest.raises(BadInputError, match=name):
        write(tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_a_map_of_one_channel_is_no_map(tmp_path: Path) -> None:
    path = tmp_path / "m.tiff"
    cv2.imwrite(str(path), np.ones((3, 4), np.float32))
    with pytest.raises(BadInputError, match=r"m\.tiff: is not a float map of three channels"):
        image_files.read_map(path)


@pytest.mark.parametrize(("height", "width"), [(1, 1), (1, 16), (16, 1)])
def test_a_video_of_one_row_of_pixels_is_refused_for_its_size(tmp_path: Path, height: int, width: int) -> None:
    sentence = rf"v\.mp4: a video of {width} x {height} pixels cannot be encoded, for VP9 needs 2 or more each way"
    with pytest.raises(BadInputError, match=sentence):
        image_files.write_video(tmp_path / "v.mp4", [np.zeros((height, width, 3), np.uint8)], 30.0)
    assert image_files.write_video(tmp_path / "w.mp4", [np.zeros((3, 2, 3), np.uint8)], 30.0).is_file()


def test_faults_name_the_file(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="no frames"):
        image_files.write_video(tmp_path / "v.mp4", [], 30.0)
    with pytest.raises(BadInputError, match=r"m\.exr.*tiff or \.pfm"):
        image_files.write_map(tmp_path / "m.exr", np.zeros((2, 2, 3), np.float32))
    with pytest.raises(BadInputError, match=r"none\.png"):
        image_files.read_png(tmp_path / "none.png")
    assert list(tmp_path.iterdir()) == []


def test_what_is_written_is_read(tmp_path: Path) -> None:
    pytest.importorskip("OpenEXR")
    depth = np.array([[1.5, np.nan, np.inf], [-0.0, 2e-30, 7.0]], np.float32)
    channels: dict[str, Any] = {"depth.Z": depth, "instance": np.arange(6, dtype=np.uint32).reshape(2, 3) << 29}
    path = write_exr(tmp_path / "frame.exr", channels, {"viewpoint": "0.03 0 0"})
    read, texts = read_exr(path)
    assert texts == {"viewpoint": "0.03 0 0"}
    assert {name: each.dtype for name, each in read.items()} == {"depth.Z": np.float32, "instance": np.uint32}
    for name, values in channels.items():
        np.testing.assert_array_equal(read[name], values)


@pytest.mark.parametrize(
    ("channels", "named"),
    [
        ({}, "not none"),
        ({"a": np.zeros((2, 3), np.float32), "b": np.zeros((3, 2), np.float32)}, "a (2, 3), b (3, 2)"),
        ({"a": np.zeros((2, 3))}, "channel 'a', float64 (2, 3)"),
    ],
)
def test_what_no_exr_file_holds_is_refused(tmp_path: Path, channels: dict[str, Any], named: str) -> None:
    pytest.importorskip("OpenEXR")
    with pytest.raises(BadInputError) as refused:
        write_exr(tmp_path / "frame.exr", channels)
    assert named in str(refused.value)
    assert not list(tmp_path.iterdir())


def test_a_full_disk_is_named(tmp_path: Path, file_size_limit: Any) -> None:
    pytest.importorskip("OpenEXR")
    noise = np.random.default_rng(1).normal(size=(300, 300)).astype(np.float32)
    with file_size_limit(1000), pytest.raises(BadInputError, match=r"frame\.exr: cannot be written \(.*\); free space"):
        write_exr(tmp_path / "frame.exr", {"depth.Z": noise})
    assert not list(tmp_path.iterdir())


def test_a_file_of_another_kind_is_named(tmp_path: Path) -> None:
    pytest.importorskip("OpenEXR")
    (tmp_path / "frame.exr").write_text("no picture")
    with pytest.raises(BadInputError, match=r"frame\.exr: cannot be read as an OpenEXR file"):
        read_exr(tmp_path / "frame.exr")
    with pytest.raises(BadInputError, match=r"absent\.exr: there is no such file"):
        read_exr(tmp_path / "absent.exr")

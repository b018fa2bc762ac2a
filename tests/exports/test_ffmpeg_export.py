import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from present import present

from benchmarks.exports.readers import drawn_by_ffmpeg, smooth_picture
from wlr_render.draw.sampling import remap
from wlr_render.exports.export_view import ExportedView
from wlr_render.exports.pixel_maps import FFMPEG_NO_RAY, Ffmpeg

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

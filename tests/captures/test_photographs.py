"""Photographs on disk: depth, order, size, and what is said of faulty ones."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy import unsignedinteger

from wlr_render.captures.photograph_format import PhotographFormat
from wlr_render.captures.photographs import (
    BadPhotographError,
    check_photograph,
    photographs_in,
    read_each,
    read_photograph,
    write_photograph,
)
from wlr_render.errors import BadInputError


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_grey_values_survive_writing_and_reading(tmp_path: Path, kind: type[unsignedinteger]) -> None:
    image = np.random.default_rng(1).integers(0, np.iinfo(kind).max, (20, 30), dtype=kind, endpoint=True)
    assert np.array_equal(read_photograph(write_photograph(tmp_path / "a.png", image)), image)


def test_numbers_in_names_count_as_numbers(tmp_path: Path) -> None:
    for name in ("10.png", "9.png", "b2.png", "B1.txt", ".hidden.png"):
        write_photograph(tmp_path / name, np.zeros((4, 4), np.uint8)) if name.endswith("png") else None
    assert [path.name for path in photographs_in(tmp_path)] == ["9.png", "10.png", "b2.png"]


def test_a_folder_that_is_empty_or_missing_is_named(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="holds no photographs"):
        photographs_in(tmp_path)
    with pytest.raises(BadInputError, match="nowhere"):
        photographs_in(tmp_path / "nowhere")


def test_a_file_cut_short_is_a_bad_photograph(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n and no more")
    with pytest.raises(BadPhotographError, match=r"a\.png: cannot be read"):
        read_photograph(tmp_path / "a.png")


def test_photographs_of_a_set_must_have_one_size(tmp_path: Path) -> None:
    first = write_photograph(tmp_path / "1.png", np.zeros((10, 20), np.uint8))
    other = write_photograph(tmp_path / "2.png", np.zeros((10, 21), np.uint8))
    with pytest.raises(BadInputError, match=r"2\.png: is 21 x 10 pixels of 8 bits, but 1\.png is 20 x 10"):
        list(read_each([first, other]))


def test_a_colour_photograph_among_grey_ones_is_refused(tmp_path: Path) -> None:
    first = write_photograph(tmp_path / "1.png", np.zeros((10, 20), np.uint8))
    cv2.imwrite(str(other := tmp_path / "2.png"), np.zeros((10, 20, 3), np.uint8))
    with pytest.raises(BadInputError, match=r"2\.png: is 20 x 10 pixels of 8 bits in colour, but 1\.png is"):
        list(read_each([first, other]))


def test_what_a_camera_cannot_have_given_is_refused() -> None:
    grey = np.full((10, 20), 100, np.uint16)
    check_photograph(grey, (20, 10), PhotographFormat(bits=8), "a")
    with pytest.raises(BadInputError, match="20 x 10 pixels, but its camera has 10 x 20"):
        check_photograph(grey, (10, 20), PhotographFormat(bits=8), "a")
    with pytest.raises(BadInputError, match="values up to 5000, beyond the camera's 4095"):
        PhotographFormat(bits=12).convert(grey * 50, "a")
    with pytest.raises(BadPhotographError, match="black"):
        check_photograph(grey, (20, 10), PhotographFormat(bits=16), "a")
    with pytest.raises(BadPhotographError, match="blown out"):
        check_photograph(np.full((10, 20), 255, np.uint8), (20, 10), PhotographFormat(8), "a")

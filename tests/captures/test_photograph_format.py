"""Stored values of a camera's files become linear values, and saturation is seen where it happens."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from wlr_render.captures.photograph_format import PhotographFormat
from wlr_render.captures.photographs import BadPhotographError, read_photograph
from wlr_render.errors import BadInputError
from wlr_render.io.toml_files import Table

SHAPE = (20, 30)
RAMP = np.linspace(3, 250, 600).reshape(SHAPE)


def noisy(largest: int, seed: int = 0) -> NDArray[Any]:
    rng = np.random.default_rng(seed)
    return np.clip(np.rint(RAMP / 255 * largest + rng.normal(0, 2, SHAPE)), 0, largest).astype(np.uint16)


def test_red_that_is_clipped_is_saturated_though_its_grey_value_is_not(tmp_path: Path) -> None:
    image = np.full((*SHAPE, 3), 180, np.uint8)
    image[:, 10:, 2] = 255  # cv2 writes blue, green, red
    cv2.imwrite(str(tmp_path / "a.png"), image)
    read = read_photograph(tmp_path / "a.png")
    assert (read[:, 10:] == 255).all()
    assert (read[:, :10] == 180).all()
    green = read_photograph(tmp_path / "a.png", PhotographFormat(8, channel="green"))
    assert (green == 180).all()
    assert (read_photograph(tmp_path / "a.png", PhotographFormat(8, channel="red"))[:, 10:] == 255).all()


@pytest.mark.parametrize("bits", [10, 12, 14])
def test_values_in_the_upper_bits_are_shifted_down_in_dark_pictures_too(tmp_path: Path, bits: int) -> None:
    for share in (1.0, 0.02):
        right = (noisy(2**bits - 1) * share).astype(np.uint16)
        np.save(tmp_path / "left.npy", right << (16 - bits))
        np.save(tmp_path / "right.npy", right)
        kind = PhotographFormat(bits=bits)
        assert np.array_equal(read_photograph(tmp_path / "left.npy", kind), right)
        assert np.array_equal(read_photograph(tmp_path / "right.npy", kind), right)
    with pytest.raises(BadInputError, match="beyond the camera's"):
        read_photograph(tmp_path / "left.npy", PhotographFormat(bits=8))


def test_twelve_bits_stated_as_sixteen_are_saturated_at_65520(tmp_path: Path) -> None:
    image = noisy(4095) << 4
    image[:5] = 65520
    np.save(tmp_path / "a.npy", image)
    assert (read_photograph(tmp_path / "a.npy", PhotographFormat(bits=16))[:5] == 65535).all()
    assert np.count_nonzero(read_photograph(tmp_path / "a.npy", PhotographFormat(bits=16)) == 65535) == 5 * 30


def test_a_stated_saturation_level_and_none_for_synthetic_pictures(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.array([[10, 239, 240, 255]], np.uint8))
    kind = PhotographFormat(8, saturation=240)
    assert kind.full_scale == 240
    assert read_photograph(tmp_path / "a.npy", kind).tolist() == [[10, 239, 240, 240]]
    assert read_photograph(tmp_path / "a.npy", PhotographFormat(8, synthetic=True)).tolist() == [[10, 239, 240, 255]]


def test_gamma_and_a_table_give_light(tmp_path: Path) -> None:
    stored = np.arange(256, dtype=np.uint8).reshape(16, 16)
    np.save(tmp_path / "a.npy", stored)
    light = (np.arange(256) / 255) ** 2.2
    np.savetxt(tmp_path / "table.txt", light)
    table = Table({"bits": 8, "linearisation": "table.txt"}, "session.toml [eyeball_camera]")
    for kind in (PhotographFormat(8, gamma=2.2), PhotographFormat.from_table(table, tmp_path)):
        read = read_photograph(tmp_path / "a.npy", kind).ravel()
        assert kind.full_scale == 65535
        assert read[255] == 65535
        assert read[:255].max() < 65535
        np.testing.assert_allclose(read / 65535, light, atol=2e-5)


@pytest.mark.parametrize(
    "text",
    ["0;0,0\r\n100;0,3\r\n255;1,0\r\n", "# value light\n0 0\n100 0,3\n255\t1\n", "0, 0\n100, 0.3\n255, 1\n"],
)
@pytest.mark.parametrize("name", ["curve.csv", "curve.txt"])
def test_a_linearisation_may_have_any_separator(tmp_path: Path, text: str, name: str) -> None:
    (tmp_path / name).write_bytes(text.encode())
    table = Table({"bits": 8, "linearisation": name}, "session.toml [eyeball_camera]")
    assert PhotographFormat.from_table(table, tmp_path).linearisation == ((0.0, 0.0), (100.0, 0.3), (255.0, 1.0))


def test_a_black_level_is_taken_off_before_gamma() -> None:
    kind = PhotographFormat(8, gamma=2.0, black_level=55)
    stored = np.array([[0, 55, 155, 254]], np.uint8)
    np.testing.assert_allclose(kind.convert(stored, "a") / 65535, [[0, 0, 0.25, 0.99]], atol=0.003)


def test_colours_of_a_mosaic(tmp_path: Path) -> None:
    colours = {"r": 40, "g": 120, "b": 200}
    for mosaic in ("rggb", "bggr", "grbg", "gbrg"):
        cell = np.array([colours[letter] for letter in mosaic], np.uint8).reshape(2, 2)
        raw = np.tile(cell, (10, 12))
        np.save(tmp_path / "a.npy", raw)
        for channel, value in (("red", 40), ("green", 120), ("blue", 200)):
            whole = read_photograph(tmp_path / "a.npy", PhotographFormat(8, mosaic=mosaic, channel=channel))
            assert whole.shape == (20, 24)
            assert (whole[2:-2, 2:-2] == value).all()
    raw[10, 10] = 255
    assert np.count_nonzero(PhotographFormat(8, mosaic="gbrg").convert(raw, "a") == 255) == 9


def test_a_tag_of_orientation_does_not_turn_the_pixels(tmp_path: Path) -> None:
    image = Image.fromarray(RAMP.astype(np.uint8))
    tags = image.getexif()
    tags[274] = 3
    image.save(tmp_path / "a.jpg", exif=tags, quality=100)
    assert read_photograph(tmp_path / "a.jpg")[0, 0] < 50


def test_files_that_are_none(tmp_path: Path) -> None:
    (tmp_path / "a.npy").write_bytes(b"no array")
    with pytest.raises(BadPhotographError, match=r"a\.npy: cannot be read as a photograph"):
        read_photograph(tmp_path / "a.npy")
    np.save(tmp_path / "a.npy", np.array([{}]))
    with pytest.raises(BadPhotographError, match="Object arrays cannot be loaded"):
        read_photograph(tmp_path / "a.npy")
    np.save(tmp_path / "a.npy", np.zeros((0, 5), np.uint8))
    with pytest.raises(BadPhotographError, match="has no pixels"):
        read_photograph(tmp_path / "a.npy")
    np.save(tmp_path / "a.npy", np.zeros((1, 100_000), np.uint8))
    with pytest.raises(BadInputError, match="has 100000x1 pixels, more than"):
        read_photograph(tmp_path / "a.npy")
    np.save(tmp_path / "b.npy", np.zeros(SHAPE))
    with pytest.raises(BadInputError, match="float64"):
        read_photograph(tmp_path / "b.npy")
    with pytest.raises(BadInputError, match="remove 'mosaic'"):
        PhotographFormat(8, mosaic="rggb").convert(np.zeros((4, 4, 3), np.uint8), "c.png")
    with pytest.raises(BadInputError, match="is grey"):
        PhotographFormat(8, channel="red").convert(np.zeros((4, 4), np.uint8), "c.png")


@pytest.mark.parametrize(
    ("keys", "sentence"),
    [
        ({"bits": 8, "saturation": 300}, "at most 255"),
        ({"bits": 8, "gamma": 2.2, "linearisation": "a.txt"}, "either 'gamma' or"),
        ({"bits": 8, "linearisation": "a.txt"}, "a.txt: there is no such file"),
        ({"bits": 8, "linearisation": "../a.txt"}, "'linearisation': '../a.txt' leads out of the folder"),
    ],
)
def test_keys_that_cannot_be_right(tmp_path: Path, keys: dict[str, Any], sentence: str) -> None:
    with pytest.raises(BadInputError, match=sentence):
        PhotographFormat.from_table(Table(keys, "session.toml [eyeball_camera]"), tmp_path)

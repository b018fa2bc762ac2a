import dataclasses
import json

import numpy as np
import pytest

from wlr_render.captures.capture_file import load_captures, save_captures
from wlr_render.captures.correspondences import DisplayCaptures, EyeCaptures, SeeThroughCaptures
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import dir_of_tangents
from wlr_render.mappings import EyeBox, Panel

RNG = np.random.default_rng(1)
EYE_BOX = EyeBox(np.array([0.03, 0.0, 0.02]), np.array([0.010, 0.008, 0.006]))
VIEW_DIR = dir_of_tangents(RNG.uniform(-0.4, 0.4, (20, 2)))
DISPLAY = DisplayCaptures(
    "toy",
    "left",
    EYE_BOX,
    Panel(10, 8),
    RNG.normal(0, 0.01, (20, 3)),
    VIEW_DIR,
    RNG.uniform(0, 8, (20, 2)),
    np.arange(20) // 4,
    RNG.uniform(0.5, 2, 20),
)
SEE_THROUGH = SeeThroughCaptures(
    "toy",
    "left",
    dataclasses.replace(EYE_BOX, size=EYE_BOX.size * 0.5),
    np.zeros((20, 3)),
    VIEW_DIR,
    VIEW_DIR * 2,
    np.arange(20) // 4,
    np.arange(20) % 2,
    0.0,
)


def assert_same(first, second):
    assert type(first) is type(second)
    for field in dataclasses.fields(first):
        a, b = getattr(first, field.name), getattr(second, field.name)
        if dataclasses.is_dataclass(a):
            assert_same(a, b)
        else:
            np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("captures", [EyeCaptures(DISPLAY), EyeCaptures(DISPLAY, SEE_THROUGH)], ids=["display", "both"])
def test_captures_come_back_exactly(tmp_path, captures):
    read = load_captures(save_captures(tmp_path / "eye.npz", captures))
    assert_same(read.display, captures.display)
    assert (read.see_through is None) == (captures.see_through is None)
    if captures.see_through is not None:
        assert_same(read.see_through, captures.see_through)


def rewritten(tmp_path, header, arrays):
    """A capture file with some header keys or arrays replaced; an array of None is left out."""
    path = save_captures(tmp_path / "eye.npz", EyeCaptures(DISPLAY, SEE_THROUGH))
    with np.load(path) as archive:
        content = dict(archive)
    content["header"] = np.array(json.dumps(json.loads(str(content["header"])) | header))
    content |= arrays
    np.savez(path, **{name: value for name, value in content.items() if value is not None})
    return path


@pytest.mark.parametrize(
    ("header", "arrays", "sentence"),
    [
        ({"format": "other"}, {}, "is not a capture file"),
        ({"version": 9}, {}, "has version 9; this program reads version 1"),
        ({"frame": "opencv"}, {}, "must be in frame 'openxr'"),
        ({"eye": "middle"}, {}, "'eye' is 'middle'"),
        ({"eye_box": {"centre_m": [0, 0, 0]}}, {}, "key 'size_m' is missing"),
        ({}, {"header": None}, "without the header"),
        ({}, {"header": np.array("{")}, "without the header"),
        ({}, {"display_pixel": None}, "the array 'display_pixel' is missing"),
        ({}, {"display_pixel": np.zeros((3, 2))}, r"'pixel' must have shape \(20, 2\)"),
        ({}, {"see_through_point": None}, "the array 'see_through_point' is missing"),
    ],
)
def test_a_fault_in_a_file_is_one_sentence_with_its_name(tmp_path, header, arrays, sentence):
    path = rewritten(tmp_path, header, arrays)
    with pytest.raises(BadInputError, match=sentence) as caught:
        load_captures(path)
    assert str(caught.value).startswith(str(path))


def test_files_that_are_cut_short_foreign_or_absent(tmp_path):
    path = save_captures(tmp_path / "eye.npz", EyeCaptures(DISPLAY))
    path.write_bytes(path.read_bytes()[:700])
    with pytest.raises(BadInputError, match="cut short or is not a capture file"):
        load_captures(path)
    path.write_text("u,v,x,y,z\n")
    with pytest.raises(BadInputError, match="cut short or is not a capture file"):
        load_captures(path)
    path.write_bytes(b"")
    with pytest.raises(BadInputError, match=str(path)):
        load_captures(path)
    with pytest.raises(BadInputError, match="No such file"):
        load_captures(tmp_path / "none.npz")
    array = tmp_path / "array.npy"
    np.save(array, np.zeros(3))
    with pytest.raises(BadInputError, match="is not a capture file"):
        load_captures(array)


def test_other_suffixes_are_refused(tmp_path):
    with pytest.raises(BadInputError, match=r"must be named \*\.npz"):
        save_captures(tmp_path / "eye.json", EyeCaptures(DISPLAY))

import dataclasses
import json

import numpy as np
import pytest

from wlr_render.captures.capture_file import load_captures, load_observations, save_captures
from wlr_render.captures.correspondences import (
    CaptureMotionPrior,
    Conditions,
    DisplayCaptures,
    EyeCaptures,
    SeeThroughCaptures,
)
from wlr_render.captures.observation_table import observation_table
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
RECORDED = Conditions.recorded(
    20,
    visit=np.arange(20) // 4,
    channel=np.arange(20) % 3,
    time_s=40.0 * (np.arange(20) // 4),
    travel=1.0,
    stage=RNG.normal(0, 0.01, (20, 2)),
)

MOTION = CaptureMotionPrior(np.arange(9), RNG.uniform(0, 1e-5, (9, 6)), 0.2)
WITH_MOTION = EyeCaptures(dataclasses.replace(DISPLAY, motion=MOTION), dataclasses.replace(SEE_THROUGH, motion=MOTION))


def assert_same(first, second):
    assert type(first) is type(second)
    for field in dataclasses.fields(first):
        a, b = getattr(first, field.name), getattr(second, field.name)
        if dataclasses.is_dataclass(a):
            assert_same(a, b)
        else:
            np.testing.assert_array_equal(a, b)


def assert_same_captures(read, captures):
    """Equal but for conditions, which a file of captures without any reads as not recorded."""
    for part in ("display", "see_through"):
        found, expected = getattr(read, part), getattr(captures, part)
        assert (found is None) == (expected is None)
        if expected is not None:
            bare = {"conditions": None} | ({"target_point": None} if part == "see_through" else {})
            assert_same(dataclasses.replace(found, **bare), dataclasses.replace(expected, **bare))


@pytest.mark.parametrize(
    "captures",
    [EyeCaptures(DISPLAY), EyeCaptures(DISPLAY, SEE_THROUGH), WITH_MOTION],
    ids=["display", "both", "with motion"],
)
def test_captures_come_back_exactly(tmp_path, captures):
    read = load_captures(save_captures(tmp_path / "eye.npz", captures))
    assert_same_captures(read, captures)
    assert np.isnan(read.display.conditions.time_s).all()


def test_a_table_comes_back_with_its_conditions_and_all_colours(tmp_path):
    table = observation_table(dataclasses.replace(DISPLAY, conditions=RECORDED), SEE_THROUGH)
    path = save_captures(tmp_path / "eye.npz", table)
    read = load_observations(path)
    assert_same(read, table)
    assert_same(read.display().conditions, RECORDED)
    assert np.isnan(read.see_through().conditions.stage).all()
    green = load_captures(path).display
    np.testing.assert_array_equal(green.pixel, DISPLAY.pixel[RECORDED.channel == 1])


@pytest.mark.parametrize("panel", [None, Panel(10, 8)])
def test_targets_alone_come_back_with_the_panel_if_it_is_known(tmp_path, panel):
    path = save_captures(tmp_path / "eye.npz", observation_table(None, SEE_THROUGH, panel))
    assert load_observations(path).panel == panel
    read = load_captures(path)
    assert read.display is None
    assert len(read.see_through) == 20
    with pytest.raises(BadInputError, match="neither of the panel nor of a target"):
        observation_table(None, None)


def of_version_1(captures):
    """Arrays of a file as version 1 had them."""
    box = {"centre_m": EYE_BOX.centre.tolist(), "size_m": EYE_BOX.size.tolist()}
    half = box | {"size_m": (EYE_BOX.size * 0.5).tolist()}
    header = {
        "format": "wlr-captures",
        "version": 1,
        "frame": "openxr",
        "units": {"length": "m", "sigma": "arcmin", "pixel": "px"},
        "device": "toy",
        "eye": "left",
        "panel": {"width_px": 10, "height_px": 8},
        "eye_box": box,
        "see_through_eye_box": None if captures.see_through is None else half,
    }
    arrays = {"header": np.array(json.dumps(header))}
    for part in ("display", "see_through"):
        rows = vars(getattr(captures, part)) if getattr(captures, part) else {}
        arrays |= {f"{part}_{name}": value for name, value in rows.items() if isinstance(value, np.ndarray)}
    return arrays


@pytest.mark.parametrize("captures", [EyeCaptures(DISPLAY), EyeCaptures(DISPLAY, SEE_THROUGH)], ids=["display", "both"])
def test_files_of_version_1_are_read(tmp_path, captures):
    np.savez(tmp_path / "eye.npz", **of_version_1(captures))
    assert_same_captures(load_captures(tmp_path / "eye.npz"), captures)


def rewritten(tmp_path, header, arrays):
    """A capture file with some header keys or arrays replaced; an array of None is left out."""
    path = save_captures(tmp_path / "eye.npz", WITH_MOTION)
    with np.load(path) as archive:
        content = dict(archive)
    if "display_pixel" in arrays or "see_through_point" in arrays:
        content = of_version_1(EyeCaptures(DISPLAY, SEE_THROUGH))
    content["header"] = np.array(json.dumps(json.loads(str(content["header"])) | header))
    content |= arrays
    np.savez(path, **{name: value for name, value in content.items() if value is not None})
    return path


@pytest.mark.parametrize(
    ("header", "arrays", "sentence"),
    [
        ({}, {"display_motion_capture": None}, "the array 'display_motion_capture' is missing"),
        ({}, {"see_through_motion_size": -MOTION.size}, "capture motions: 'size' has negative"),
        ({}, {"display_motion_log_sigma": np.ones(2)}, "'log_sigma' is"),
        ({"format": "other"}, {}, "is not a capture file"),
        ({"version": 9}, {}, "has version 9; this program reads versions 1 and 2"),
        ({"frame": "opencv"}, {}, "must be in frame 'openxr'"),
        ({"eye": "middle"}, {}, "'eye' is 'middle'"),
        ({"eye_box": {"centre_m": [0, 0, 0]}}, {}, "key 'size_m' is missing"),
        ({}, {"header": None}, "without the header"),
        ({}, {"header": np.array("{")}, "without the header"),
        ({}, {"display_pixel": None}, "the array 'display_pixel' is missing"),
        ({}, {"display_pixel": np.zeros((3, 2))}, r"'pixel' must have shape \(20, 2\)"),
        ({}, {"see_through_point": None}, "the array 'see_through_point' is missing"),
        ({}, {"feature": None}, "the array 'feature' is missing"),
        ({}, {"feature": np.zeros((40, 2))}, r"'feature' must have shape \(40, 3\)"),
        ({}, {"viewpoint": np.zeros((3, 3))}, "columns differ in length"),
        ({}, {"time_s": np.zeros(3)}, r"'time_s' must have shape \(40,\)"),
        ({}, {"kind": np.full(40, 7)}, "'kind' must be 0"),
        ({"see_through_eye_box": None}, {}, "there are real points, but no 'see_through_eye_box'"),
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

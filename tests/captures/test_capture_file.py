import dataclasses
import json
import resource
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from present import present

from wlr_render.captures.capture_checks import place_warnings
from wlr_render.captures.capture_file import load_captures, load_observations
from wlr_render.captures.correspondences import Captures, DisplayCaptures, SeeThroughCaptures, select
from wlr_render.captures.feature_captures import CaptureMotionPrior
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import dir_of_tangents
from wlr_render.mappings import EyeBox, Panel
from wlr_render.numerics.arrays import FloatArray, IntArray

RNG = np.random.default_rng(1)
EYE_BOX = EyeBox(np.array([0.03, 0.0, 0.02]), np.array([0.010, 0.008, 0.006]))
VIEW_DIR = dir_of_tangents(RNG.uniform(-0.4, 0.4, (20, 2)))
DISPLAY = DisplayCaptures(
    device="toy",
    eye="left",
    eye_box=EYE_BOX,
    panel=Panel(10, 8),
    viewpoint=EYE_BOX.centre + np.repeat(RNG.normal(0, 0.01, (5, 3)), 4, axis=0),
    view_dir=VIEW_DIR,
    pixel=RNG.uniform(0, 8, (20, 2)),
    capture=np.arange(20) // 4,
    sigma_arcmin=RNG.uniform(0.5, 2, 20),
)
SEE_THROUGH = SeeThroughCaptures(
    device="toy",
    eye="left",
    eye_box=dataclasses.replace(EYE_BOX, size=EYE_BOX.size * 0.5),
    viewpoint=EYE_BOX.centre,
    view_dir=VIEW_DIR,
    point=VIEW_DIR * 2,
    capture=np.arange(20) // 4,
    target_pose=np.arange(20) % 2,
    sigma_arcmin=np.asarray(0.0),
)
RECORDED = dataclasses.replace(
    DISPLAY,
    visit=np.arange(20) // 4,
    channel=np.arange(20) % 3,
    time_s=np.asarray(40.0 * (np.arange(20) // 4)),
    travel=np.asarray(1.0),
    stage=RNG.normal(0, 0.01, (20, 2)),
)

MOTION = CaptureMotionPrior(np.arange(9), RNG.uniform(0, 1e-5, (9, 6)), 0.2)
WITH_MOTION = Captures(dataclasses.replace(DISPLAY, motion=MOTION), dataclasses.replace(SEE_THROUGH, motion=MOTION))


def documented_header() -> dict[str, Any]:
    """The header that docs/files.md has to copy."""
    text = (Path(__file__).parents[2] / "docs" / "files.md").read_text()
    header: dict[str, Any] = json.loads(text.partition("```json\n")[2].partition("```")[0])
    return header


def test_the_documented_header_is_read(tmp_path: Path) -> None:
    header = documented_header()
    centre = np.array(header["eye_box"]["centre_m"])
    arrays = {
        "kind": np.array([0, 0, 1, 1]),
        "capture": np.array([0, 1, 0, 1]),
        "target_pose": np.array([-1, -1, 0, 0]),
        "feature": np.array([[1.0, 2.0, np.nan], [3.0, 4.0, np.nan], [0, 0, -1], [0.1, 0, -1]]),
        "target_point": np.full((4, 3), np.nan),
        "viewpoint": centre + np.array([[0.004, 0, 0], [-0.004, 0, 0]] * 2),
        "view_dir": np.tile([0.0, 0, -1], (4, 1)),
        "sigma_arcmin": np.full(4, 0.5),
    }
    np.savez(tmp_path / "own.npz", header=np.array(json.dumps(header)), **arrays)
    shown, seen = load_observations(tmp_path / "own.npz").both
    assert (shown.device, shown.eye, shown.panel) == ("my headset", "right", Panel(1440, 1600))
    np.testing.assert_array_equal(seen.eye_box.size, header["see_through_eye_box"]["size_m"])


@pytest.mark.parametrize(("scale", "named"), [(1.0, 0), (0.1, 2), (0.0, 2)])
def test_places_that_span_little_of_the_eye_box_are_named(scale: float, named: int) -> None:
    apart = EYE_BOX.centre + scale * 0.5 * EYE_BOX.size * np.linspace(-1, 1, 20)[:, None]
    shown = dataclasses.replace(DISPLAY, viewpoint=apart, eye_box=EYE_BOX)
    seen = dataclasses.replace(SEE_THROUGH, viewpoint=apart, eye_box=EYE_BOX)
    warnings = place_warnings(Captures(shown, seen))
    assert len(warnings) == named
    assert all("span" in warning and "eye box of 10 mm" in warning for warning in warnings)
    alone = dataclasses.replace(shown, capture=np.zeros(20, int))
    assert place_warnings(Captures(alone, None)) == []


def assert_same(first: Any, second: Any) -> None:
    assert type(first) is type(second)
    for field in dataclasses.fields(first):
        a, b = getattr(first, field.name), getattr(second, field.name)
        if dataclasses.is_dataclass(a):
            assert_same(a, b)
        else:
            np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize(
    "captures",
    [Captures(DISPLAY), Captures(DISPLAY, SEE_THROUGH), WITH_MOTION],
    ids=["display", "both", "with motion"],
)
def test_captures_come_back_exactly(tmp_path: Path, captures: Captures) -> None:
    read = load_captures(captures.save(tmp_path / "eye.npz"))
    assert_same(read, captures)
    assert np.isnan(present(read.display).time_s).all()


def test_captures_come_back_with_what_was_recorded_and_all_colours(tmp_path: Path) -> None:
    path = Captures(RECORDED, SEE_THROUGH).save(tmp_path / "eye.npz")
    shown, seen = load_observations(path).both
    assert_same(shown, RECORDED)
    assert np.isnan(seen.stage).all()
    green = load_captures(path).display
    np.testing.assert_array_equal(present(green).pixel, DISPLAY.pixel[RECORDED.channel == 1])


@pytest.mark.parametrize("panel", [None, Panel(10, 8)])
def test_targets_alone_come_back_with_the_panel_if_it_is_known(tmp_path: Path, panel: Panel | None) -> None:
    path = Captures(None, SEE_THROUGH, panel).save(tmp_path / "eye.npz")
    assert load_observations(path).panel == panel
    read = load_captures(path)
    assert read.display is None
    assert len(present(read.see_through)) == 20
    with pytest.raises(BadInputError, match="none of the panel or of a target"):
        Captures(None, None)


def of_version_1(captures: Captures) -> dict[str, NDArray[Any]]:
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


@pytest.mark.parametrize("captures", [Captures(DISPLAY), Captures(DISPLAY, SEE_THROUGH)], ids=["display", "both"])
def test_files_of_version_1_are_read(tmp_path: Path, captures: Captures) -> None:
    np.savez(tmp_path / "eye.npz", allow_pickle=False, **of_version_1(captures))
    assert_same(load_captures(tmp_path / "eye.npz"), captures)


def rewritten(tmp_path: Path, header: dict[Any, Any], arrays: Mapping[str, Any]) -> Path:
    """A capture file with some header keys or arrays replaced; an array of None is left out."""
    path = WITH_MOTION.save(tmp_path / "eye.npz")
    with np.load(path) as archive:
        content = dict(archive)
    if "display_pixel" in arrays or "see_through_point" in arrays:
        content = of_version_1(Captures(DISPLAY, SEE_THROUGH))
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
        ({"format": "other"}, {}, "it must be one of wlr-captures"),
        ({"version": 9}, {}, "has version 9; this program reads versions 1 to 2"),
        ({"frame": "opencv"}, {}, "must be in frame 'openxr'"),
        ({"eye": "middle"}, {}, "'eye' is 'middle'"),
        ({"eye_box": {"centre_m": [0, 0, 0]}}, {}, "key 'size_m' is missing"),
        ({}, {"header": None}, "the array 'header' is missing"),
        ({}, {"header": np.array("{")}, "cannot be read as a capture file with a JSON 'header'"),
        ({}, {"display_pixel": None}, "the array 'display_pixel' is missing"),
        ({}, {"display_pixel": np.zeros((3, 2))}, r"'pixel' must have shape \(20, 2\)"),
        ({}, {"feature": None}, "the array 'feature' is missing"),
        ({}, {"feature": np.zeros((40, 2))}, r"'feature' must have shape \(40, 3\)"),
        ({}, {"viewpoint": np.zeros((3, 3))}, r"'viewpoint' must have shape \(40, 3\), not \(3, 3\)"),
        ({}, {"kind": np.full(40, 7)}, "'kind' must be 0"),
        ({}, {"kind": np.array(["a"] * 40)}, "'kind' holds <U1 values, not numbers"),
        ({}, {"feature": np.array([{}] * 40)}, "Object arrays cannot be loaded"),
        ({}, {"viewpoint": np.full((40, 3), 1j)}, "holds complex128 values"),
        ({}, {"viewpoint": np.full((40, 3), np.nan)}, "'viewpoint' has numbers that are not finite"),
        ({}, {"viewpoint": np.full((40, 3), 32.0)}, "'viewpoint', from .* is it in millimetres"),
        ({"eye_box": {"centre_m": [0, 0, 0], "size_m": [10, 8, 6]}}, {}, "'eye_box' has a length of 10 m"),
        ({"eye_box": {"centre_m": [0, 0, 0], "size_m": [0.01, -0.01, 0]}}, {}, "'eye_box' has a negative size"),
        ({"panel": {"width_px": 10**9, "height_px": 8}}, {}, "'panel': has 1000000000x8 pixels, more than"),
        ({"panel": {"width_px": 5, "height_px": 4}}, {}, r"\d% of the panel pixels are outside the panel of 5 x 4"),
        ({}, {"display_pixel": np.full((20, 2), 1e6)}, "of the panel pixels are outside"),
        ({}, {"sigma_arcmin": np.full(40, 1e9)}, "'sigma_arcmin' has the value 1e.09; it should be between 0 and 600"),
        (
            {"panel": {"width_px": 9, "height_px": 8}},
            {"display_pixel": np.eye(20, 2) * 99},
            "10.0% of the panel",
        ),
        ({}, {"sigma_arcmin": np.full(40, 1e-12)}, "'sigma_arcmin' has the value 1e-12, less than 1e-06"),
        ({}, {"sigma_arcmin": np.append(np.ones(39), 1e-5)}, "'sigma_arcmin' is 1e-05 in row 39 and 1 in row 0"),
        ({}, {"capture": np.zeros(40, int)}, "'capture' is 0 in all rows, and their viewpoints are .* mm apart"),
        ({"eye_box": {"centre_m": [0, 0, 0], "size_m": [1e-5] * 3}}, {}, "'eye_box' has the size .* in metres"),
        ({}, {"target_pose": np.full(40, -1)}, "'target_pose' has the value -1; it should be between 0 and"),
        ({}, {"travel": np.full(40, 0.3)}, "'travel' has values other than -1, 0 and 1"),
        ({}, {"display_motion_size": None}, "the array 'display_motion_size' is missing"),
        ({}, {"channel": np.full(40, 3)}, "'channel' has the value"),
        ({}, {"time_s": np.arange(40) * 1e10}, "'time_s' has the value 1.1e.11; it should be between -1e\\+11"),
        ({}, {"temperature_c": np.full(40, 293.0)}, "'temperature_c' has the value 293"),
        ({}, {"stage": np.full((40, 3), 32.0)}, "'stage' has the value 32"),
        ({}, {"stage": np.zeros((40, 17))}, "'stage' has 17 axes"),
        ({}, {"device_from_camera": np.full((40, 3, 3), 0.5)}, "matrices that are not rotations"),
        ({}, {"see_through_motion_size": MOTION.size + 2}, "'see_through_motion_size' has the value"),
        ({}, {"header": np.array("[" * 100_000)}, "nested too deeply"),
        ({}, {"header": np.array('{"version": %s}' % ("9" * 5000))}, "cannot be read as a capture file"),
        ({}, {"header": np.array('{"version": 2, "version": 2}')}, "key 'version' is there twice"),
        ({}, {"kind": np.array(1)}, r"'kind' must have shape \(1,\), not \(\)"),
        ({}, {"stage": np.zeros(1000)}, "'stage' has 1000 axes"),
        ({}, {"device_from_camera": np.zeros((40, 40))}, r"must have shape \(40, 3, 3\), not \(40, 40\)"),
        ({"see_through_eye_box": None}, {}, "there are real points, but no 'see_through_eye_box'"),
        (
            {},
            {"viewpoint": np.zeros((40, 3))},
            r"middle of the display positions lies \[-30.0, 0.0, -20.0\] mm from the",
        ),
        (
            {"see_through_eye_box": {"centre_m": [0, 0, 0], "size_m": [0.01, 0.008, 0]}},
            {},
            r"middle of the see-through positions lies \[30.0, 0.0, 20.0\] mm",
        ),
        (
            {},
            {"visit": np.append(np.arange(20) // 8, np.full(20, -1))},
            "'visit' 0 of the panel is at two camera positions: 'capture' is 0 in row 0 and 1 in row 4; give each",
        ),
        (
            {},
            {"visit": np.append(np.full(20, -1), np.arange(20) // 8)},
            "'visit' 0 of target pose 0 is at two camera positions: 'capture' is 0 in row 20 and 1 in row 24",
        ),
        (
            {},
            {"visit": np.tile(np.arange(20) // 4, 2), "viewpoint": EYE_BOX.centre + 0.01 * np.eye(40, 3)},
            r"'visit' 0 of the panel is at two camera positions: 'viewpoint' is \[0.04, 0.0, 0.02\] in row 0 and",
        ),
        (
            {},
            {"visit": np.tile(np.arange(20) // 4, 2), "time_s": np.where(np.arange(40) == 3, 50.0, np.arange(40))},
            "'time_s' goes back: 'visit' 1 of the panel begins at 4 s, before 'visit' 0 of the panel ends at 50 s",
        ),
    ],
)
def test_a_fault_in_a_file_is_one_sentence_with_its_name(
    tmp_path: Path, header: dict[str, Any], arrays: Mapping[str, NDArray[Any] | None], sentence: str
) -> None:
    path = rewritten(tmp_path, header, arrays)
    with pytest.raises(BadInputError, match=sentence) as caught:
        load_captures(path)
    assert str(caught.value).startswith(str(path))


@pytest.mark.parametrize(
    "arrays",
    [
        {"visit": np.append(np.arange(20) // 4, np.full(20, -1))},
        {"visit": np.tile(4 - np.arange(20) // 4, 2), "time_s": 10.0 * np.tile(np.arange(20) // 4, 2)},
        {"visit": np.tile(np.arange(20) // 4, 2), "time_s": np.zeros(40)},
        {"visit": np.tile(np.arange(20) // 4, 2), "time_s": np.where(np.arange(40) % 3, np.nan, np.arange(40) // 4)},
        {"time_s": np.arange(40)[::-1].astype(float)},
    ],
    ids=["one side", "numbered by place", "no clock", "gaps", "without visits"],
)
def test_visits_and_times_that_do_not_contradict_are_read(
    tmp_path: Path, arrays: Mapping[str, FloatArray | IntArray]
) -> None:
    assert len(present(load_captures(rewritten(tmp_path, {}, arrays)).display)) == 20


def test_points_in_kilometres_and_captures_numbered_by_row_are_refused(tmp_path: Path) -> None:
    near = dataclasses.replace(SEE_THROUGH, point=SEE_THROUGH.viewpoint - [0, 0, 1e-3])
    with pytest.raises(BadInputError, match="real point 1 mm from its viewpoint"):
        load_captures(Captures(DISPLAY, near).save(tmp_path / "near.npz"))
    rows = np.zeros(2001, int)
    many = dataclasses.replace(select(DISPLAY, rows), capture=np.arange(2001), pixel=np.linspace([0, 0], [5, 4], 2001))
    with pytest.raises(BadInputError, match="'capture' has 2001 different numbers"):
        load_captures(Captures(many).save(tmp_path / "many.npz"))


def test_files_that_are_cut_short_foreign_or_absent(tmp_path: Path) -> None:
    path = Captures(DISPLAY).save(tmp_path / "eye.npz")
    path.write_bytes(path.read_bytes()[:700])
    with pytest.raises(BadInputError, match="cannot be read as a capture file"):
        load_captures(path)
    path.write_text("u,v,x,y,z\n")
    with pytest.raises(BadInputError, match="cannot be read as a capture file"):
        load_captures(path)
    path.write_bytes(b"")
    with pytest.raises(BadInputError, match=str(path)):
        load_captures(path)
    with pytest.raises(BadInputError, match="no such file"):
        load_captures(tmp_path / "none.npz")
    array = tmp_path / "array.npy"
    np.save(array, np.zeros(3))
    with pytest.raises(BadInputError, match="cannot be read as a capture file"):
        load_captures(array)


def test_rows_of_both_kinds_may_be_mixed_and_are_named_by_their_place_in_the_file(tmp_path: Path) -> None:
    path = Captures(RECORDED, SEE_THROUGH).save(tmp_path / "eye.npz")
    with np.load(path) as archive:
        content = dict(archive)
    order = np.arange(40).reshape(2, 20).T.ravel()
    mixed = {name: values[order] if values.ndim else values for name, values in content.items()}
    np.savez(path, **mixed)
    shown, seen = load_observations(path).both
    assert_same(shown, RECORDED)
    np.testing.assert_array_equal(seen.point, SEE_THROUGH.point)
    twice = {name: np.append(values, values[3:4], axis=0) if values.ndim else values for name, values in mixed.items()}
    np.savez(path, **twice)
    with pytest.raises(BadInputError, match="row 40 repeats row 3"):
        load_captures(path)


def test_more_rows_than_are_read_are_refused_before_they_take_memory(tmp_path: Path) -> None:
    many = np.zeros((20_000_000, 3), dtype=np.int8)
    path = rewritten(tmp_path, {}, {})
    with np.load(path) as archive:
        content = dict(archive)
    np.savez_compressed(path, **content | {"viewpoint": many})
    del many
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(BadInputError, match=r"'viewpoint' has the shape \(20000000, 3\); at most 2000000 rows"):
        load_captures(path)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 300_000  # kB: 480 000 in floats


def test_other_suffixes_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match=r"must be named \*\.npz"):
        Captures(DISPLAY).save(tmp_path / "eye.json")

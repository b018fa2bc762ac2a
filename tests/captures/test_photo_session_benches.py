"""Kinds of benches in session.toml: each is written and read back the same; contradictions are one sentence each."""

import re
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from present import narrowed, present

from wlr_render.captures.boards.board import Board, BoardObservation
from wlr_render.captures.boards.board_design import design_board
from wlr_render.captures.boards.board_file import board_table, save_board
from wlr_render.captures.boards.dot_board import DotBoard
from wlr_render.captures.decoded import DecodeOptions
from wlr_render.captures.patterns.catalogue import make_pattern
from wlr_render.captures.photo_session import (
    BoardPhotograph,
    CodeSet,
    CodeTable,
    GivenPose,
    PhotoSession,
    SessionCamera,
    SessionPanel,
    StageAxis,
    StageDescription,
)
from wlr_render.captures.photo_session_entries import with_places
from wlr_render.captures.photo_session_file import FILE, load_photo_session, save_photo_session
from wlr_render.captures.photograph_format import PhotographFormat
from wlr_render.captures.photographs import write_photograph
from wlr_render.captures.session_reading import Reading
from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.io.atomic_files import resource
from wlr_render.io.toml_files import write_toml
from wlr_render.lenses.lens_camera import LensCamera
from wlr_render.mappings import EyeBox, Panel
from wlr_render.numerics.arrays import FloatArray

LENS = LensCamera((640, 480), np.array([700.0, 701.0]), np.array([321.0, 239.5]), np.array([0.1, 0.0, 0.0, 0, 0]))
POSE = transforms.rigid(
    transforms.rotation_about("x", 0.1) @ transforms.OPENXR_FROM_OPENCV, np.array([0.01, 0.04, -0.05])
)
PANEL = SessionPanel(make_pattern("gray-fringes", Panel(320, 200)))
KNOWN = SessionCamera((640, 480), PhotographFormat(8), calibrated=LENS)
TILTED = np.array([0.0, 0.6, -0.8])


def box(x_mm: int) -> EyeBox:
    return EyeBox(np.array([1e-3 * x_mm, 0.0, 0.0]), np.array([0.01, 0.008, 0.006]))


def readings(*rows: Sequence[float]) -> list[FloatArray]:
    return [np.array(row, dtype=np.float64) for row in rows]


GRID = readings([0.0, 0.0, 0.0], [0.002, 0.0, 0.001], [0.0, 0.003, 0.0])


def three_axes(folder: Path) -> PhotoSession:
    board = design_board(8, 7, 0.02)
    save_board(board, folder / "board.toml")
    return PhotoSession(
        folder=folder,
        device="a headset",
        eyes=("right",),
        eye_boxes={"right": box(0)},
        panels={"right": PANEL},
        decoding=DecodeOptions(full_scale=255),
        board=board,
        eyeball_camera=KNOWN,
        see_through=tuple(BoardPhotograph(folder, f"s{k}.png", 0, stage=stage) for k, stage in enumerate(GRID)),
        display=tuple(CodeSet(folder / f"d{k}", stage=stage) for k, stage in enumerate(GRID)),
        bare=tuple(BoardPhotograph(folder, f"b{k}.png", 0, stage=stage) for k, stage in enumerate(GRID)),
        tracking=(BoardPhotograph(folder, "t.png", 0),),
        tracking_camera=KNOWN,
        device_from_tracking=POSE,
    )


def rotary(folder: Path) -> PhotoSession:
    axes = (
        StageAxis("linear", TILTED, np.radians(0.2)),
        StageAxis("rotary", np.array([0.0, 1.0, 0.0]), np.radians(1.0), np.array([0.0, 0.001, -0.002])),
        StageAxis("rotary"),
    )
    turned = readings([0.0, 0.0, 0.0], [0.002, np.radians(20), 0.1], [0.0, np.radians(-20), -0.1])
    session = three_axes(folder)
    moved: dict[str, Any] = {
        name: tuple(replace(each, stage=stage) for each, stage in zip(getattr(session, name), turned, strict=True))
        for name in ("bare", "see_through", "display")
    }
    return replace(session, stage=StageDescription(axes), **moved)


def by_hand(folder: Path) -> PhotoSession:
    session = three_axes(folder)
    return replace(
        session,
        stage=None,
        bare=(),
        beside=tuple(BoardPhotograph(folder, f"p{k}.png", 0, place=f"hand {k}") for k in range(3)),
        see_through=tuple(replace(each, stage=None, place=f"hand {k}") for k, each in enumerate(session.see_through)),
        display=tuple(replace(each, stage=None, place=f"hand {k}") for k, each in enumerate(session.display)),
    )


def in_one_picture(folder: Path) -> PhotoSession:
    """Through the optics and past them in one photograph; the second target pose is tied by the first."""
    session = by_hand(folder)
    regions = np.array([[0.0, 0.0, 100.0, 480.0], [600.0, 0.0, 640.0, 480.0]])
    beside = tuple(replace(each, name=f"s{k}.png", regions=regions) for k, each in enumerate(session.beside))
    through = tuple(replace(each, other_regions=regions) for each in session.see_through)
    other = replace(beside[0], name="other.png", target_pose=1, regions=None)
    return replace(session, beside=(*beside, other), see_through=through, display=())


def fiducials(folder: Path) -> PhotoSession:
    small = design_board(6, 6, 0.005)
    save_board(small, folder / "small.toml")
    session = three_axes(folder)
    bare = tuple(replace(each, name=f"f{k}.png", target_pose=7) for k, each in enumerate(session.bare))
    return replace(
        session,
        tracking=(),
        tracking_camera=None,
        device_from_tracking=None,
        targets={7: GivenPose(POSE, (np.radians(0.05), 0.0003), small, "small.toml")},
        bare=(*session.bare, *bare),
    )


def optics_alone(folder: Path) -> PhotoSession:
    session = three_axes(folder)
    axes = tuple(StageAxis("linear", direction) for direction in np.eye(3))
    return replace(
        session,
        stage=StageDescription(axes),
        gauge="camera",
        bare=(),
        see_through=(),
        tracking=(),
        tracking_camera=None,
        device_from_tracking=None,
    )


def one_bare_photograph(folder: Path) -> PhotoSession:
    """The stage's axes are known against the camera."""
    session = three_axes(folder)
    axes = tuple(
        StageAxis("linear", direction, np.radians(0.2), is_in_camera=True) for direction in (TILTED, *np.eye(3)[1:])
    )
    return replace(session, stage=StageDescription(axes), bare=session.bare[:1])


def first_target(folder: Path) -> PhotoSession:
    session = three_axes(folder)
    return replace(session, gauge="target 0", display=(), tracking=(), tracking_camera=None, device_from_tracking=None)


def both_eyes(folder: Path, other: SessionPanel = PANEL) -> PhotoSession:
    session = three_axes(folder)
    left = tuple(replace(each, name=f"l{each.name}", eye="left") for each in session.see_through)
    display = tuple(replace(each, folder=folder / f"l{each.folder.name}", eye="left") for each in session.display)
    return replace(
        session,
        eyes=("left", "right"),
        eye_boxes={"left": box(-32), "right": box(32)},
        panels={"left": PANEL, "right": other},
        see_through=(*session.see_through, *left),
        display=(*session.display, *display),
        bare=tuple(replace(each, eye="left") for each in session.bare),
        tracking=tuple(replace(each, eye="left") for each in session.tracking),
    )


def two_panels(folder: Path) -> PhotoSession:
    return both_eyes(folder, SessionPanel(make_pattern("gray-fringes", Panel(640, 400))))


def colour(folder: Path) -> PhotoSession:
    session = three_axes(folder)
    offsets = {"red": np.array([-0.333, 0.0]), "blue": np.array([0.333, 0.25])}
    panel = SessionPanel(PANEL.pattern, offsets)
    sets = [replace(each, channel=channel) for each in session.display for channel in ("red", "green", "blue")]
    display = tuple(replace(each, folder=folder / f"c{k}") for k, each in enumerate(sets))
    return replace(session, panels={"right": panel}, display=display)


def with_all_else(folder: Path) -> PhotoSession:
    """Orientations, times, sigmas, formats and kinds of lenses, places by name, an order of photographs."""
    session = three_axes(folder)
    fisheye = LensCamera((640, 480), np.array([300.0, 301.0]), np.array([321.0, 239.5]), np.full(4, 0.01), "fisheye")
    form = PhotographFormat(12, saturation=4000.0, gamma=2.2, channel="green")
    (folder / "order.csv").write_text("0.png,white\n")
    return replace(
        session,
        decoding=DecodeOptions(full_scale=form.full_scale),
        eyeball_camera=SessionCamera((640, 480), form, calibrated=fisheye, calibrated_sigma=np.arange(1.0, 9.0)),
        tracking_camera=replace(KNOWN, calibrated_sigma=np.array([0.5, 0.5, 1.0, 1.0, 0, 0, 0, 0, 0])),
        tracking_sigma=(np.radians(0.05), 0.0003),
        bare=tuple(
            replace(each, orientation=turn, name=f"{turn}{each.name}") for each in session.bare for turn in (0, 1)
        ),
        see_through=tuple(
            replace(each, time_s=60.0 * k, temperature_c=21.5 + k) for k, each in enumerate(session.see_through)
        ),
        display=tuple(replace(each, orientation=1, time_s=9.0, place="turned") for each in session.display[:1]),
        tracking=(replace(session.tracking[0], time_s=5.0),),
        code=CodeTable("opencv", folder / "order.csv"),
        place_tolerance=5e-6,
    )


BENCHES = (
    three_axes,
    rotary,
    by_hand,
    in_one_picture,
    fiducials,
    optics_alone,
    one_bare_photograph,
    first_target,
    both_eyes,
    two_panels,
    colour,
    with_all_else,
)


def differences(ours: object, theirs: object, where: str = "session") -> list[str]:
    """Where two values of dataclasses, tables, lists and arrays differ; boards by their files."""
    if isinstance(ours, Board) and isinstance(theirs, Board):
        return [] if board_table(ours) == board_table(theirs) else [where]
    if is_dataclass(ours) and type(ours) is type(theirs):
        parts = [(each.name, getattr(ours, each.name), getattr(theirs, each.name)) for each in fields(ours)]
        return [line for name, one, other in parts for line in differences(one, other, f"{where}.{name}")]
    if isinstance(ours, dict) and isinstance(theirs, dict) and ours.keys() == theirs.keys():
        return [line for key in ours for line in differences(ours[key], theirs[key], f"{where}[{key}]")]
    if isinstance(ours, tuple) and isinstance(theirs, tuple) and len(ours) == len(theirs):
        pairs = enumerate(zip(ours, theirs, strict=True))
        return [line for k, (one, other) in pairs for line in differences(one, other, f"{where}[{k}]")]
    if isinstance(ours, np.ndarray | float) and isinstance(theirs, np.ndarray | float):
        close = np.shape(ours) == np.shape(theirs) and np.allclose(ours, theirs, rtol=0, atol=1e-11)
        return [] if close else [f"{where}: {ours} and {theirs}"]
    return [] if ours == theirs else [f"{where}: {ours} and {theirs}"]


def saved(session: PhotoSession) -> Path:
    save_photo_session(session, {"pattern": "gray-fringes"}, "board.toml")
    return session.folder


@pytest.mark.parametrize("bench", BENCHES)
def test_what_is_written_is_read_back(bench: Callable[..., Any], tmp_path: Path) -> None:
    session = with_places(bench(tmp_path))
    again = load_photo_session(saved(session))
    assert differences(session, again) == []


@pytest.mark.parametrize("bench", BENCHES)
def test_it_is_read_the_same_in_other_axes(bench: Callable[..., Any], tmp_path: Path) -> None:
    """A file in OpenXR's axes with vectors turned by hand describes the same bench."""
    session = with_places(bench(tmp_path))
    content = tomllib.loads((saved(session) / FILE).read_text())
    content["frame"] = "openxr"

    def turn(table: dict[str, Any], keys: Sequence[Any]) -> None:
        for key in set(keys) & table.keys():
            table[key] = (transforms.OPENXR_FROM_OPENCV @ np.array(table[key])).tolist()

    boxes = content["eye_box"]
    for table in boxes.values() if "left" in boxes else [boxes]:
        turn(table, ["centre_mm"])
    for table in (content.get("tracking_camera", {}), *content.get("target", [])):
        turn(table, ["rotation", "translation_mm"])
    stage = content.get("stage", {})
    for table in stage.get("axes", []) if stage.get("directions_in") != "camera" else []:
        turn(table, ["direction", "pivot_mm"])
    for name in ("bare", "beside", "see_through", "display"):
        for table in content.get(name, []):
            turn(table, ["stage_mm"])
    write_toml(tmp_path / FILE, content)
    again = load_photo_session(tmp_path)
    named = [line for line in differences(session, again) if ".place:" not in line]
    assert named == []  # places are named as the file writes readings


def test_readings_within_the_tolerance_are_one_place(tmp_path: Path) -> None:
    session = three_axes(tmp_path)
    rng = np.random.default_rng(1)
    noisy = [replace(each, stage=present(each.stage) + rng.uniform(-5e-7, 5e-7, 3)) for each in session.display]
    again = load_photo_session(saved(replace(session, display=tuple(noisy))))
    assert [each.place for each in again.display] == [each.place for each in again.see_through]
    assert len({each.place for each in again.bare}) == 3
    exact = load_photo_session(saved(replace(session, display=tuple(noisy), place_tolerance=1e-9)))
    assert not {each.place for each in exact.display} & {each.place for each in exact.see_through}


def test_an_entry_without_a_place_joins_the_named_one_at_its_reading(tmp_path: Path) -> None:
    session = three_axes(tmp_path)
    named = tuple(replace(each, place=f"corner {k}") for k, each in enumerate(session.display))
    again = load_photo_session(saved(replace(session, display=named)))
    assert [each.place for each in again.bare] == ["corner 0", "corner 1", "corner 2"]


def test_two_names_at_one_reading_stay_two_places(tmp_path: Path) -> None:
    session = three_axes(tmp_path)
    named = tuple(replace(each, place=f"before {k}") for k, each in enumerate(session.see_through))
    later = tuple(replace(each, place=f"after {k}") for k, each in enumerate(session.display))
    again = load_photo_session(saved(replace(session, see_through=named, display=later)))
    assert [each.place for each in (*again.see_through, *again.display)] == [each.place for each in (*named, *later)]
    assert [each.place for each in again.bare] == ["0 0 0", "2 0 -1", "0 -3 0"]


MODEL = """{
    'lensmodel': 'LENSMODEL_OPENCV8',
    'extrinsics': [0, 0, 0, 0, 0, 0],
    'intrinsics': [700.0, 701.0, 320.5, 239.0, 0.1, 0, 0, 0, 0, 0.01, 0, 0],
    'imagersize': [640, 480],
}
"""


def test_a_lens_of_another_program_is_read(tmp_path: Path) -> None:
    (tmp_path / "eye.cameramodel").write_text(MODEL)
    session = three_axes(tmp_path)
    folder = saved(session)
    content = tomllib.loads((folder / FILE).read_text())
    camera = content["eyeball_camera"]
    for key in ("focal_px", "opencv_centre_px", "distortion"):
        del camera[key]
    camera |= {"lens_file": "eye.cameramodel", "focal_sigma_px": 0.5, "centre_sigma_px": 1.5}
    write_toml(folder / FILE, content)
    found = load_photo_session(folder)
    known = narrowed(found.eyeball_camera.calibrated, LensCamera)
    assert known.kind == "rational"
    assert np.allclose(known.values[:4], [700.0, 701.0, 321.0, 239.5])
    assert np.allclose(present(found.eyeball_camera.calibrated_sigma), [0.5, 0.5, 1.5, 1.5] + [0] * 8)
    assert differences(found, load_photo_session(saved(found))) == []
    write_toml(folder / FILE, content | {"eyeball_camera": camera | {"width_px": 1280}})
    with pytest.raises(BadInputError, match=r"1280 x 480 pixels, but the lens in .* was calibrated for 640 x 480"):
        load_photo_session(folder)
    write_toml(folder / FILE, content | {"eyeball_camera": camera | {"lens": "brown"}})
    with pytest.raises(BadInputError, match="'lens' is given as well as 'lens_file'"):
        load_photo_session(folder)


def test_one_eye_shares_what_is_of_both(tmp_path: Path) -> None:
    session = load_photo_session(saved(two_panels(tmp_path)))
    right = session.for_eye("right")
    assert (right.eye, right.pattern.panel) == ("right", Panel(640, 400))
    assert np.allclose(right.eye_box.centre, [0.032, 0, 0])
    assert {each.eye for each in (*right.see_through, *right.display)} == {"right"}
    assert right.bare == session.bare
    assert right.tracking == session.tracking
    with pytest.raises(ValueError, match="too many values"):
        _ = session.eye
    with pytest.raises(ValueError, match="too many values"):
        _ = session.pattern
    assert load_photo_session(saved(both_eyes(tmp_path))).pattern == PANEL.pattern


def test_dots_in_a_region_are_seen_past_the_optics_and_not_through_them(tmp_path: Path) -> None:
    session = load_photo_session(saved(in_one_picture(tmp_path)))
    pixel = np.array([[50.0, 200.0], [300.0, 200.0], [620.0, 479.0], [100.0, 480.0]])
    dots = BoardObservation(np.zeros((4, 2), dtype=np.int64), pixel, np.full(4, 0.1))
    reading = Reading({each.path: dots for each in (*session.beside, *session.see_through, *session.tracking)})
    seen = {each: observation.pixel[:, 0].tolist() for each, observation in reading.views_of(session.beside)}
    assert seen[session.beside[0]] == [50, 620, 100]
    assert len(seen[session.beside[-1]]) == 4
    assert [each.pixel[:, 0].tolist() for _, each in reading.views_of(session.see_through)] == [[300]] * 3
    (tracked,) = reading.views_of(session.tracking)
    assert len(tracked[1]) == 4
    past = Reading({session.see_through[0].path: dots.only(pixel[:, 0] == 50)})
    assert past.views_of(session.see_through) == []


def test_a_target_may_have_a_board_of_its_own(tmp_path: Path) -> None:
    session = load_photo_session(saved(fiducials(tmp_path)))
    assert [narrowed(session.board_of(pose), DotBoard).columns for pose in (7, 0)] == [6, 8]


TEXT = resource("docs", "photo-session.md").read_text(encoding="utf-8")
KINDS = TEXT.split("## Kinds of benches\n")[1].split("\n## ")[0]
EXAMPLES = dict(re.findall(r"### ([^\n]+)\n(?:[^`#]|`[^`]|``[^`])*?```toml\n(.*?)```", KINDS, re.DOTALL))
REPLACED = {
    "Rotation about the pupil": [],
    "Known stage axes": [],
    "Robot arm or hand": ["bare"],
    "No tracking camera": ["tracking_camera", "tracking"],
    "Display only": ["tracking_camera", "tracking", "bare", "see_through"],
    "Both eyes": ["eye", "eye_box"],
    "Colour": [],
}


def test_the_manual_has_these_benches() -> None:
    assert EXAMPLES.keys() == REPLACED.keys()


@pytest.mark.parametrize("name", REPLACED)
def test_an_example_of_the_manual_is_read(name: str, tmp_path: Path) -> None:
    save_board(design_board(8, 7, 0.02), tmp_path / "board.toml")
    save_board(design_board(6, 6, 0.005), tmp_path / "fiducials.toml")
    for camera in ("eyeball", "tracking"):
        write_photograph(tmp_path / "intrinsics" / camera / "0.png", np.zeros((4, 4), np.uint8))
    usual = tomllib.loads(TEXT.split("```toml\n")[1].split("```")[0])
    content = {key: value for key, value in usual.items() if key not in REPLACED[name]} | tomllib.loads(EXAMPLES[name])
    write_toml(tmp_path / FILE, content)
    session = load_photo_session(tmp_path)
    assert session.display


# Contradictions.


def each_of(name: str, **keys: Sequence[int] | int | str) -> Callable[[Any], None]:
    def change(content: dict[str, Any]) -> None:
        for table in content[name]:
            table.update(keys)

    return change


def without(name: str, *keys: str) -> Callable[[Any], None]:
    def change(content: dict[str, Any]) -> None:
        for table in content[name] if isinstance(content[name], list) else [content[name]]:
            for key in keys:
                del table[key]

    return change


def put(*path_and_value: Any) -> Callable[[Any], None]:
    *path, key, value = path_and_value

    def change(content: dict[str, Any]) -> None:
        for step in path:
            content = content[step]
        content[key] = value

    return change


def drop(*names: str) -> Callable[[Any], None]:
    def change(content: dict[str, Any]) -> None:
        for name in names:
            del content[name]

    return change


@pytest.mark.parametrize(
    ("bench", "change", "complaint"),
    [
        (three_axes, drop("tracking_camera", "tracking"), r"nothing fixes the device frame: add \[tracking_camera\].*"
         r"\[\[target\]\].*gauge = \"target 0\""),
        (three_axes, drop("tracking_camera"), r"\[\[tracking\]\] photographs, but no \[tracking_camera\]"),
        (three_axes, drop("tracking"), r"'tracking' is empty"),
        (three_axes, drop("see_through", "display"), "'see_through' and 'display' are both empty"),
        (three_axes, drop("bare"), r"\[\[see_through\]\] number 1: 'bare' is empty; the camera's pose"),
        (three_axes, put("gauge", "target 0"), r"'gauge' and \[tracking_camera\] both fix the device frame"),
        (three_axes, put("gauge", "target one"), "'gauge' is 'target one'; it must be"),
        (three_axes, put("eyes", ["left"]), "give either 'eye' or 'eyes'"),
        (three_axes, put("stage", {"kind": "none"}), "'stage_mm' is a stage reading, but .* kind = \"none\""),
        (three_axes, put("stage", {"axes": []}), "'axes' is empty; list an axis, or write kind"),
        (three_axes, put("stage", {"axes": [{}, {}]}), "'stage_mm' must be a list of 2 numbers"),
        (three_axes, put("stage", {"axes": [{}, {}, {"kind": "rotary"}]}), "'stage_mm' cannot hold the angle"),
        (three_axes, put("stage", {"axes": [{"pivot_mm": [0, 0, 0]}]}), "'pivot_mm' is for rotary axes"),
        (three_axes, put("stage", {"axes": [{"direction": [0, 0, 0]}]}), "it must be a vector along the axis"),
        (three_axes, put("stage", {"axes": [{"direction_sigma_deg": 1}]}), "is given without 'direction'"),
        (three_axes, put("stage", {"directions_in": "camera"}), "'directions_in' is given, but no axis"),
        (three_axes, put("stage", {"axes": [{"direction": [1, 0, 0], "direction_sigma_deg": 0}]}), "must be above 0"),
        (three_axes, put("stage", {"place_tolerance_um": -1}), "'place_tolerance_um' has the value -1"),
        (three_axes, put("bare", 0, "stage", [0.0, 0.0, 0.0]), "give either 'stage' or 'stage_mm'"),
        (three_axes, each_of("bare", place="one"), "place 'one' has entries of several stage readings or orientations"),
        (three_axes, without("bare", "stage_mm"), "key 'stage_mm' is missing"),
        (three_axes, each_of("tracking", stage_mm=[0, 0, 0]), "unknown key 'stage_mm'"),
        (three_axes, put("display", 0, "orientation", 1), r"\[\[display\]\] number 1: the camera's pose at "
         "orientation 1 is unknown"),
        (three_axes, put("display", 0, "eye", "left"), "'eye' is 'left'; it must be one of right"),
        (three_axes, put("tracking_camera", "sigma_mm", 0.3), "'sigma_deg' is missing"),
        (three_axes, put("tracking_camera", "sigma", [1.0]), "'sigma' must be a list of 9 numbers"),
        (three_axes, put("tracking_camera", "focal_sigma_px", 0.3), "'centre_sigma_px' is missing"),
        (three_axes, put("tracking_camera", "distortion", [0.1, 0, 0, 0]), "'distortion' has 4 terms; state"),
        (three_axes, put("tracking_camera", "lens", "fisheye"), "'distortion' has 5 terms, but a lens of kind 'fish"),
        (three_axes, put("tracking_camera", "lens", "wide"), "'lens' is 'wide'; it must be one of auto, brown"),
        (three_axes, put("panel", "primary_offsets_px", {"red": [3.0, 0.0]}), "'red' has the value 3"),
        (rotary, without("bare", "stage"), "key 'stage' is missing"),
        (rotary, put("bare", 0, "stage", [0.0, 0.0]), "'stage' must be a list of 3 numbers"),
        (by_hand, without("see_through", "place"), "key 'place' is missing; without a stage each entry names"),
        (by_hand, put("display", 1, "place", "elsewhere"), "the position of place 'elsewhere' is unknown"),
        (by_hand, each_of("beside", target_pose=4), r"\[\[beside\]\] number 1 is of target pose 4, which has"),
        (by_hand, lambda content: (drop("tracking_camera", "tracking")(content), content.update(gauge="camera")),
         "but there is no stage; name a target"),
        (in_one_picture, put("beside", 0, "region_px", [[5, 5, 4, 9]]), "it must be lists .u0, v0, u1, v1. with"),
        (in_one_picture, put("beside", 0, "region_px", [[0, 0, 700, 9]]), "lies outside the picture of 640 x 480"),
        (in_one_picture, lambda content: content["beside"][0].pop("region_px"), "say with 'region_px' which part"),
        (in_one_picture, put("beside", 0, "place", "hand 1"), "is also a .* photograph, of another place"),
        (fiducials, put("target", 0, "pose", 8), "names target pose 8, which has no photographs"),
        (fiducials, lambda content: content["target"].append(content["target"][0]), "target pose 7 is given twice"),
        (fiducials, put("bare", 3, "photograph", "b0.png"), "b0.png is listed with target poses 0 and 7; a photograph"),
        (optics_alone, without("stage", "axes"), "stage axis 1 moves in an unknown"),
        (first_target, put("gauge", "target 5"), "names target pose 5, which has no photographs"),
        (both_eyes, put("eyes", ["left", "left"]), "must hold \"left\", \"right\", or both"),
        (both_eyes, put("eye_box", {"centre_mm": [0, 0, 0], "size_mm": [9, 9, 9]}), "is one table for both eyes"),
        (both_eyes, without("display", "eye"), "'eye' is missing; in a session of both eyes"),
        (both_eyes, lambda content: [each.update(eye="left") for each in content["see_through"] + content["display"]],
         "no .* of the right eye"),
    ],
)  # fmt: skip
def test_each_contradiction_is_named(
    bench: Callable[..., Any], change: Callable[..., Any], complaint: str, tmp_path: Path
) -> None:
    folder = saved(bench(tmp_path))
    content = tomllib.loads((folder / FILE).read_text())
    change(content)
    write_toml(folder / FILE, content)
    with pytest.raises(BadInputError, match=complaint) as caught:
        load_photo_session(folder)
    assert "\n" not in str(caught.value)
    assert str(folder / FILE) in str(caught.value)

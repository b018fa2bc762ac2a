import hashlib
import json
import re
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from html import unescape
from pathlib import Path
from typing import Any, get_args

import cv2
import numpy as np
import pytest
from command_line import refused
from fitted_eyes import captures, with_source
from present import as_number, narrowed, present
from small_headsets import LeftHalf

from wlr_render.budget.error_sizes import ErrorSizes
from wlr_render.budget.registration_budget import registration_covariance
from wlr_render.calibration.fit_eye import calibrate
from wlr_render.cli import main
from wlr_render.errors import BadInputError
from wlr_render.exports import export_view as view
from wlr_render.exports.formats import FORMATS, FormatName
from wlr_render.extras import MissingExtraError
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.io.escapes import markdown_text
from wlr_render.io.kept import Kept
from wlr_render.jobs.export import export, views_from_centres
from wlr_render.jobs.export_options import ExportOptions
from wlr_render.jobs.headset import open_colours, open_eye
from wlr_render.jobs.render import render
from wlr_render.jobs.render_options import RenderOptions
from wlr_render.jobs.trace import TraceOptions, trace
from wlr_render.mappings import Eye
from wlr_render.models.display_model import DisplayModel
from wlr_render.models.model_file import EyeModel, load_eye_model, save_eye_models
from wlr_render.numerics.srgb import decode_srgb, encode_srgb
from wlr_render.report.blocks import Report
from wlr_render.scene.exr_file import read_exr
from wlr_render.scene.image_files import read_map, read_png
from wlr_render.warp.ray_map import RayMap, ray_map


def exported(form: FormatName, model: str, folder: Path, **options: Any) -> Report:
    return export(ExportOptions(model, format=form, out=folder, **options))


@pytest.mark.slow
def test_every_format_has_a_name_a_page_and_files(straight_device: str, model_file: str, tmp_path: Path) -> None:
    assert tuple(form.name for form in FORMATS) == get_args(FormatName)
    for name, form in zip(get_args(FormatName), FORMATS, strict=True):
        if not form.holds.every_pixel:
            continue  # takes seconds, and has tests of its own
        report = exported(name, model_file if form.holds.every_pupil else straight_device, tmp_path / name)
        page = (tmp_path / name / "report.md").read_text(encoding="utf-8")
        assert all(path.is_file() for path in report.files)
        steps = [step.replace("NAME", "right").replace("WxH", "64x36") for step in form.use]
        assert all(markdown_text(sentence) in page for sentence in (*form.convention, *steps))
        assert {"check-source.png", "check-panel.png"} <= {path.name for path in report.files}


@pytest.mark.slow
def test_page_states_what_the_map_loses(small_northstar: str, tmp_path: Path) -> None:
    report = exported("stmap", small_northstar, tmp_path, depth_m=2.0)
    (table,) = [each for each in report.tables if each.title.startswith("Misalignment")]
    own, at_half_a_metre, at_infinity, red, blue, aside = table.rows
    assert own[1] == "points 2 m deep, as the file is made for"
    assert as_number(own[3]) < 0.01
    assert at_half_a_metre[2] == pytest.approx(1.37 * (1 / 0.5 - 1 / 2) / (1 / 0.5), rel=0.03)
    assert at_infinity[2] == pytest.approx(1.37 * (1 / 2) / (1 / 0.5), rel=0.03)
    assert [row[1] for row in (red, blue)] == ["red light, 615 nm", "blue light, 464 nm"]
    assert 0.02 < as_number(red[2]) < as_number(blue[2]) < 0.3
    parallax = 60 * np.rad2deg(0.002 / 2.0)  # between a point at infinity, for which it is 30', and one 2 m deep
    assert 30 - parallax < as_number(aside[2]) < 30


def test_check_picture_is_what_opencv_draws_from_the_file(small_northstar: str, tmp_path: Path) -> None:
    exported("tiff", small_northstar, tmp_path, source_camera="nearest")
    source, panel = read_png(tmp_path / "check-source.png"), read_png(tmp_path / "check-panel.png")
    u, v, _ = np.moveaxis(read_map(tmp_path / "right-map.tiff"), -1, 0)
    drawn = encode_srgb(cv2.remap(decode_srgb(source), u - 0.5, v - 0.5, cv2.INTER_LINEAR))
    assert np.abs(drawn.astype(int) - panel).max() <= 1
    assert np.ptp(panel) > 100


def test_source_picture_has_the_size_that_is_asked_for(straight_device: str, tmp_path: Path) -> None:
    exported("stmap", straight_device, tmp_path / "own")
    exported("stmap", straight_device, tmp_path / "sized", source_size=(320, 100))
    assert read_png(tmp_path / "sized" / "check-source.png").shape == (100, 320, 3)
    own, sized = (read_exr(tmp_path / name / "right-stmap.exr")[0] for name in ("own", "sized"))
    np.testing.assert_allclose(own["R"], sized["R"], atol=1e-6)  # the same borders


def test_device_axes_turn_the_source_camera(small_northstar: str, tmp_path: Path) -> None:
    report = exported("stmap", small_northstar, tmp_path, source_axes="device")
    (cameras,) = [each for each in report.tables if each.title == "Source cameras"]
    assert str(cameras.rows[0][-1]).startswith("1.000000 0.000000 0.000000;")


def test_a_grid_of_pupils_has_a_map_for_each_pupil_and_eye(straight_device: str, tmp_path: Path) -> None:
    report = exported("pfm", straight_device, tmp_path, eye="both", pupils=2)
    maps = sorted(path.stem for path in report.files if path.suffix == ".pfm")
    assert maps == [
        f"{eye}-row{row}-column{column}-map" for eye in ("left", "right") for row in (0, 1) for column in (0, 1)
    ]
    box = open_eye(straight_device, "right").eye_box
    for corner, unit in (("row0-column0", [-1, 1, 0]), ("row1-column1", [1, -1, 0])):
        facts = json.loads((tmp_path / f"right-{corner}-map.json").read_text(encoding="utf-8"))
        assert facts["viewpoint_in_device_m"] == pytest.approx(box.at(np.array(unit)))
        assert facts["source_camera"]["position_in_device_m"] == pytest.approx(box.at(np.array(unit)))
    first, last = (read_map(tmp_path / f"{stem}.pfm") for stem in maps[-4::3])
    assert np.abs(first - last).max() > 1  # px


def test_a_trajectory_has_a_map_for_each_frame(small_northstar: str, tmp_path: Path) -> None:
    track = Path("examples/data/eyes.txt").resolve()
    report = exported("npz", small_northstar, tmp_path, eye_track=track, fps=2, frame_limit=3)
    assert sorted(path.name for path in report.files if path.suffix == ".npz") == [
        f"right-00000{index}-rays.npz" for index in range(3)
    ]
    (views,) = [each for each in report.tables if each.title == "Views"]
    assert [row[2] for row in views.rows] == [0.0, 0.5, 1.0]
    rays = [np.load(tmp_path / f"right-00000{index}-rays.npz")["rays"] for index in range(3)]
    assert np.abs(rays[0] - rays[2]).max() > 1e-3


def test_each_colour_has_its_map(small_prism: str, tmp_path: Path) -> None:
    report = exported("ffmpeg", small_prism, tmp_path, per_colour=True)
    pairs = {path.name for path in report.files if path.suffix == ".pgm"}
    assert pairs == {f"right-{colour}-{axis}.pgm" for colour in ("red", "green", "blue") for axis in "xy"}
    red, blue = (cv2.imread(str(tmp_path / f"right-{colour}-y.pgm"), -1) for colour in ("red", "blue"))
    assert not np.array_equal(present(red), present(blue))


def test_files_of_an_earlier_export_are_removed_and_no_others(straight_device: str, tmp_path: Path) -> None:
    exported("pfm", straight_device, tmp_path, pupils=2)
    (tmp_path / "notes.txt").touch()
    report = exported("stmap", straight_device, tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"notes.txt", *(path.name for path in report.files)}
    assert report.warnings[-1] == f"8 files of an earlier export were removed from {tmp_path}."


def test_a_file_that_was_changed_after_an_export_is_left(straight_device: str, tmp_path: Path) -> None:
    exported("pfm", straight_device, tmp_path)
    (tmp_path / "right-map.json").write_text("mine", encoding="utf-8")
    report = exported("stmap", straight_device, tmp_path)
    assert not (tmp_path / "right-map.pfm").exists()
    assert (tmp_path / "right-map.json").read_text(encoding="utf-8") == "mine"
    assert report.warnings[-1] == (
        f"{tmp_path / 'right-map.json'}: was changed after an earlier export, and is left; remove it."
    )


def test_the_frames_of_render_are_no_earlier_export(straight_device: str, scene_file: str, tmp_path: Path) -> None:
    render(RenderOptions(straight_device, scene_file, method="raytrace", out=tmp_path))
    with pytest.raises(BadInputError, match="belongs to other options: job was render and is export; choose another"):
        exported("stmap", straight_device, tmp_path)
    assert list(tmp_path.glob("*.png"))


def test_an_export_that_is_refused_leaves_the_earlier_one(
    straight_device: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    exported("pfm", straight_device, tmp_path)
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    monkeypatch.setitem(sys.modules, "OpenEXR", None)
    with pytest.raises(MissingExtraError):
        exported("stmap", straight_device, tmp_path)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_a_job_of_another_kind_does_not_replace_the_page(straight_device: str, tmp_path: Path) -> None:
    exported("pfm", straight_device, tmp_path)
    page = (tmp_path / "report.md").read_bytes()
    with pytest.raises(BadInputError, match="belongs to other options: job was export and is trace; choose another"):
        trace(TraceOptions(straight_device, out=tmp_path))
    assert (tmp_path / "report.md").read_bytes() == page


def test_commands_of_the_page_can_be_copied(straight_device: str, tmp_path: Path) -> None:
    exported("ffmpeg", straight_device, tmp_path, per_colour=True)
    page, html = ((tmp_path / f"report.{end}").read_text(encoding="utf-8") for end in ("md", "html"))
    (command,) = re.findall(r"`(ffmpeg [^`]*mergeplanes[^`]*)`", page)
    assert command in unescape(present(re.search(r"<code>(ffmpeg [^<]*mergeplanes[^<]*)</code>", html))[1])
    assert [name for name in shlex.split(command) if name.endswith(".pgm")] == [
        f"right-{colour}-{axis}.pgm" for colour in ("red", "green", "blue") for axis in "xy"
    ]


class Killed(BaseException):
    """What nothing catches."""


@pytest.mark.parametrize(("form", "after"), [("stmap", 2), ("ffmpeg", 4), ("npz", 0)])
def test_an_export_that_was_killed_goes_on_where_it_ended(
    form: FormatName, after: int, straight_device: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    few = {"eye": "both", "pupils": 2}
    whole = exported(form, straight_device, tmp_path / "whole", **few)
    written = Kept.add
    adds: list[Mapping[Path, Any]] = []

    def add_until_killed(finished: Kept, files: Mapping[Path, Any], facts: Any = None) -> None:
        if len(adds) == after:
            raise Killed
        adds.append(files)
        written(finished, files, facts)

    with monkeypatch.context() as patch:
        patch.setattr(Kept, "add", add_until_killed)
        with pytest.raises(Killed):
            exported(form, straight_device, tmp_path / "cut", **few)
    before = {path: path.stat().st_mtime_ns for paths in adds for path in paths}
    report = exported(form, straight_device, tmp_path / "cut", **few)
    assert report.warnings == whole.warnings
    for path in whole.files:
        if not path.name.startswith(("report", "finished")):
            assert (tmp_path / "cut" / path.name).read_bytes() == path.read_bytes()
    complete = after // (3 if form == "ffmpeg" else 1)
    assert (f"({complete} kept from an earlier run)" in report.verdict) == bool(complete)
    again = {path: path.stat().st_mtime_ns for path in before}
    kept = complete * (3 if form == "ffmpeg" else 1)
    assert list(again.values())[:kept] == list(before.values())[:kept]


def test_a_map_is_written_again_when_a_file_or_an_option_has_changed(straight_device: str, tmp_path: Path) -> None:
    device = tmp_path / "device.toml"
    text = Path(straight_device).read_text(encoding="utf-8")
    device.write_text(text, encoding="utf-8")
    for depth_m, is_kept in ((1.0, False), (1.0, True), (2.0, False)):
        assert ("kept" in exported("pfm", str(device), tmp_path / "out", depth_m=depth_m).verdict) == is_kept
    device.write_text(text + "\n# other notes\n", encoding="utf-8")
    assert "kept" not in exported("pfm", str(device), tmp_path / "out", depth_m=2.0).verdict


def test_each_view_is_solved_once(straight_device: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    solved = []

    def counted(mappings: Eye, *given: Any) -> RayMap:
        solved.append(given)
        return ray_map(mappings, *given)

    monkeypatch.setattr(view, "ray_map", counted)
    exported("stmap", straight_device, tmp_path, eye="both", pupils=2)
    assert len(solved) == 8


def test_panel_pixels_without_a_ray_are_counted(
    straight_device: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    eye = open_eye(straight_device)
    half = replace(eye, display=LeftHalf(eye.display))
    monkeypatch.setattr("wlr_render.jobs.headset.open_eye", lambda spec, name: half)
    report = exported("stmap", straight_device, tmp_path)
    assert report.warnings[-1] == "right: 50.000% of the panel pixels have no ray."


def test_positions_beside_the_source_picture_are_counted(
    straight_device: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    narrow = Pinhole(64, 36, np.array([-0.01, -1.0]), np.array([1.0, 1.0]))
    monkeypatch.setattr("wlr_render.exports.export_view.intermediate_camera", lambda *_: narrow)
    warning = exported("stmap", straight_device, tmp_path).warnings[-1]
    assert warning.endswith("% of the panel pixels lie outside the source picture.")


def test_pupil_aside_costs_what_parallax_costs(straight_device: str, tmp_path: Path) -> None:
    """Without optics the panel itself is seen, half a metre away, where it should show what is at infinity."""
    report = exported("stmap", straight_device, tmp_path)
    (table,) = [each for each in report.tables if each.title.startswith("Misalignment")]
    assert table.rows[-1][3] == pytest.approx(60 * np.rad2deg(0.002 / 0.5), rel=0.01)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"fps": 30.0}, "--fps is used with --eye-track only"),
        ({"format": "rays", "depth_m": 1.0}, "--depth-m has no effect with rays"),
        ({"viewpoint_mm": (32.0, 0.0, -30.0), "pupils": 3}, "--viewpoint-mm and --pupils exclude each other"),
        ({"pupils": 3, "eye_track": Path("eyes.txt")}, "--pupils and --eye-track exclude each other"),
        ({"viewpoint_mm": (0.0, 0.0, 0.0), "eye": "both"}, "--viewpoint-mm has 3 numbers; give 6: x y z of the left"),
        ({"viewpoint_mm": (0.0, 0.0)}, "--viewpoint-mm has 2 numbers; give 3: x y z of the right eye"),
        ({"format": "monado"}, "monado holds both eyes in one file; give --eye both"),
        ({"format": "monado", "eye": "both", "source_axes": "field"}, "leave out --source-axes"),
        ({"frame_limit": 3}, "--frames is used with --eye-track only"),
        ({"red_model": Path("red.json")}, "--red-model is used with --blue-model only; leave it out, or give"),
        ({"blue_model": Path("blue.json")}, "--blue-model is used with --red-model only; leave it out, or give"),
        ({"source_size": (100, 100), "resolution": 2.0}, "--resolution has no effect with --source-size"),
    ],
)
def test_what_does_not_go_together_is_refused(options: dict[str, Any], words: str) -> None:
    with pytest.raises(BadInputError, match=r"^[^\n]*$") as refusal:
        ExportOptions(**{"format": "stmap", "headset": "northstar", **options})
    assert words in str(refusal.value)


def test_a_pupil_outside_the_eye_box_is_refused(
    small_northstar: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    place = ["--viewpoint-mm", "-60", "0", "-30", "--out", str(tmp_path / "out")]
    assert "outside the eye box" in refused(["export", small_northstar, "--format", "stmap", *place], capsys)
    assert not (tmp_path / "out").exists()


def test_the_command_line_takes_a_pupil_position(
    small_northstar: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    place = ["--viewpoint-mm", "33.5", "-0.5", "-30", "--out", str(tmp_path)]
    assert main(["export", small_northstar, "--format", "stmap", *place]) == 0
    assert "33.500, -0.500, -30.000" in (tmp_path / "report.md").read_text(encoding="utf-8")
    assert "Misalignment by a map" in capsys.readouterr().out


def test_models_of_one_name_keep_their_own_hashes(straight_device: str, tmp_path: Path) -> None:
    """Even in folders of one name."""
    files = [tmp_path / colour / "fit" / "model.json" for colour in ("green", "red", "blue")]
    for number, file in enumerate(files):
        file.parent.mkdir(parents=True)
        fitted = calibrate(captures(straight_device), "planar", 2 + number, 2).mappings
        save_eye_models(file, [EyeModel(fitted, "no_optics")])
    options = ExportOptions(str(files[0]), format="npz", red_model=files[1], blue_model=files[2])
    sha256 = views_from_centres(options)["right"].origin.sha256
    contents = dict(zip(("green", "red", "blue"), (file.read_bytes() for file in files), strict=True))
    assert sha256 == {f"{name}: model.json": hashlib.sha256(text).hexdigest() for name, text in contents.items()}


def test_page_and_facts_state_the_predicted_error_by_source(model_file: str, tmp_path: Path) -> None:
    model = load_eye_model(model_file)
    path = tmp_path / "model.json"
    printed = with_source(model.mappings, "printing errors of the board")
    left_out = [{"captures": 5, "rms_arcmin": 0.5, "expected_arcmin": 0.3} for _ in range(3)]  # by 0.4'
    save_eye_models(path, [replace(model, mappings=printed, report={"display": {"held_out": left_out}})])
    report = exported("tiff", str(path), tmp_path / "out", depth_m=0.8)
    stated = json.loads((tmp_path / "out" / "right-map.json").read_text(encoding="utf-8"))["predicted_error"]
    assert stated["depth_m"] == 0.8
    names = [each["name"] for each in stated["sources"]]
    assert names == ["model: printing errors of the board", "model: truncation", "model: noise and stage"]
    assert stated["sources"][1]["rms_arcmin"] == pytest.approx(0.4)
    assert np.linalg.norm([each["rms_arcmin"] for each in stated["sources"]]) == pytest.approx(stated["rms_arcmin"])
    viewpoint = printed.eye_box.centre
    covariance = registration_covariance(printed, printed.display.panel.grid(18, 16), viewpoint, 0.8, ErrorSizes())
    assert stated["sources"][0]["rms_arcmin"] == pytest.approx(
        np.sqrt(np.mean(np.trace(covariance.by_source[names[0]], axis1=-2, axis2=-1)))
    )
    (table,) = [each for each in report.tables if each.title == "Predicted error by source"]
    assert [row[1] for row in table.rows] == [*names, "all"]
    assert table.rows[0][3] == "Print the board on glass, measure its dots, or turn it by 90 degrees at one pose."
    assert "printing errors of the board" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


def test_a_file_for_every_pupil_takes_no_pupil(model_file: str, tmp_path: Path) -> None:
    report = exported("c", model_file, tmp_path)
    assert {"right.wlr", "wlr_render.h"} <= {path.name for path in report.files}
    assert not any("pupil" in warning for warning in report.warnings)
    assert "The eye's pupil may be anywhere in the eye box" in (tmp_path / "report.md").read_text(encoding="utf-8")
    for option in ({"pupils": 2}, {"viewpoint_mm": (0.0, 0.0, 0.0)}, {"source_camera": "nearest"}):
        with pytest.raises(BadInputError, match="has no effect with c: its file serves every position of the pupil"):
            exported("c", model_file, tmp_path, **option)


def test_headsets_without_covariance_have_no_predicted_error(
    straight_device: str, model_file: str, tmp_path: Path
) -> None:
    model = load_eye_model(model_file)
    display = narrowed(model.mappings.display, DisplayModel)
    bare = replace(model.mappings, display=replace(display, spread=None))
    old = str(save_eye_models(tmp_path / "old.json", [replace(model, mappings=bare)]))
    for number, headset in enumerate((straight_device, old)):
        report = exported("pfm", headset, tmp_path / str(number))
        facts = json.loads((tmp_path / str(number) / "right-map.json").read_text(encoding="utf-8"))
        assert facts["predicted_error"] is None
        assert "Predicted error by source" not in [each.title for each in report.tables]


def test_pixels_that_one_colour_lacks_are_counted(
    small_prism: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    red, green, blue = open_colours(small_prism)
    channels = replace(red, display=LeftHalf(red.display)), green, blue
    monkeypatch.setattr("wlr_render.jobs.export.open_channels", lambda *_: {"right": channels})
    report = exported("stmap", small_prism, tmp_path, per_colour=True, pupils=2)
    assert report.warnings[-1].startswith("right-row0-column0-red: 50.")
    assert report.warnings[-1].endswith("% of the panel pixels have no ray. It is the worst of 4 such maps.")


@pytest.mark.parametrize(
    ("form", "options", "words"),
    [
        ("stmap", [], ["no moving pupil", "one depth", "One map, made in light of 550 nm, serves all colours"]),
        ("rays", ["--per-colour"], ["no moving pupil"]),
        ("ffmpeg", [], ["up to half a pixel off"]),
        ("monado", ["--eye", "both"], ["no asymmetric field of view", "its reader interpolates, or evaluates"]),
    ],
)
def test_what_a_format_loses_is_in_the_file_on_the_page_and_on_the_terminal(
    form: FormatName,
    options: Sequence[str],
    words: Sequence[str],
    small_northstar: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    device = "northstar" if form == "monado" else small_northstar  # its driver demands all pixels
    assert main(["export", device, "--format", form, *options, "--out", str(tmp_path)]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    page = (tmp_path / "report.md").read_text(encoding="utf-8")
    held = next(path for path in sorted(tmp_path.glob("[!r]*.json")) + sorted(tmp_path.glob("right*.[ej]*")))
    if held.suffix == ".exr":
        stated = json.loads(read_exr(held)[1]["does_not_hold"])
    else:
        content = json.loads(held.read_text(encoding="utf-8"))
        stated = content.get("about", {"left": content})["left"]["does_not_hold"]
    for sentence in stated:
        assert sentence in shown
        assert markdown_text(sentence) in page
    for each in words:
        assert any(each in sentence for sentence in stated)


def test_both_eyes_have_pupils_of_their_own(straight_device: str, tmp_path: Path) -> None:
    box = {eye: open_eye(straight_device, eye).eye_box for eye in ("left", "right")}
    chosen = np.concatenate([box["left"].at(np.array([0.5, 0, 0])), box["right"].at(np.array([0, -0.5, 0]))])
    exported("npz", straight_device, tmp_path, eye="both", viewpoint_mm=tuple(1e3 * chosen))
    for eye, expected in zip(("left", "right"), np.split(chosen, 2), strict=True):
        facts = json.loads(str(np.load(tmp_path / f"{eye}-rays.npz")["facts"]))
        assert facts["viewpoint_in_device_m"] == pytest.approx(expected)

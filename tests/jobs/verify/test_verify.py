"""The on-device experiment on a small session: the target drawn over itself, both photographed, and compared."""

import json
import os
import shutil
import tomllib
from dataclasses import replace

import numpy as np
import pytest

from wlr_render.captures.photographs import read_photograph
from wlr_render.cli import main
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import ARCMIN
from wlr_render.jobs.verify import session_photographs
from wlr_render.jobs.verify.session import METHODS, VerifySessionOptions, verify_session
from wlr_render.models.model_file import load_eye_model, save_eye_models
from wlr_render.report.blocks import Plot
from wlr_render.simulation.photographs.take_photographs import take
from wlr_render.toml_files import write_toml

pytestmark = pytest.mark.slow  # the session that all of them copy takes some twenty seconds to make

DEPTH_M = 0.6


@pytest.fixture
def options(photo_session, tmp_path):
    return VerifySessionOptions(
        photo_session.folder,
        calibration=(photo_session.out,),
        out=tmp_path / "verify",
        viewpoints=2,
        depths_m=(DEPTH_M,),
        backend="auto",
    )


def test_drawn_dots_cover_real_ones(options):
    """The models fit to 0.2 arcminutes, the camera's pose is known to 0.4, and one display pixel is nearly 7.

    Dots that the panel's edge cuts are found off their places, by arcminutes; hence medians.
    """
    result = verify_session(options)
    overall, each = result.tables
    assert [row[0] for row in overall.rows] == list(METHODS)
    assert [row[:3] for row in each.rows] == [[DEPTH_M, view, method] for view in (0, 1) for method in METHODS]
    for row in each.rows:
        dots, median = row[3:5]
        assert dots >= 20
        assert 0 < median < 1.0
        assert row[-1] is None
    assert all(path.is_file() and path.stat().st_size > 0 for path in result.files)
    assert {path.name for path in result.files} >= {"misalignment.png", "close_up.png", "report.html"}
    record = json.loads((options.out / "report.json").read_text(encoding="utf-8"))
    assert record["session"] == str(options.session)


def test_without_opengl_no_row_says_that_frames_were_rasterised(options):
    result = verify_session(replace(options, viewpoints=1, backend="cpu"))
    assert [row[0] for row in result.tables[0].rows] == ["ray traced"]
    assert "frames are ray traced" in result.warnings[0]


def test_photographs_of_an_earlier_verification_are_taken_again(options):
    """They show what other models drew."""
    stale = options.out / "photographs" / "600mm_view00_off.png"
    stale.parent.mkdir(parents=True)
    options = replace(options, viewpoints=1)
    stale.write_bytes(b"of other models")
    result = verify_session(options)
    assert read_photograph(stale).shape == (320, 400)
    assert all(row[-1] is None for row in result.tables[1].rows)


def displace_display(calibration):
    """By the model every display pixel lies 0.005 aside, as a tangent."""
    path = calibration / "model.json"
    model = load_eye_model(path)
    forward = model.mappings.display.forward
    coefficients = np.array(forward.coefficients)
    coefficients[0, 0] += 0.005  # the constant term of tx
    display = replace(model.mappings.display, forward=replace(forward, coefficients=coefficients))
    os.remove(path)
    save_eye_models(path, [replace(model, mappings=replace(model.mappings, display=display))])


def test_an_error_of_the_display_model_is_measured(options, photo_session):
    """By the model every display pixel lies 0.005 aside, as a tangent: dots are drawn as far to the other side."""
    displace_display(photo_session.out)
    result = verify_session(replace(options, viewpoints=1))
    medians = [row[4] for row in result.tables[1].rows]
    # The field reaches 18 degrees: a tangent there is 0.9 of an angle.
    assert medians == pytest.approx([0.005 / ARCMIN] * 2, rel=0.1)


def test_several_calibrations_are_compared_on_the_same_dots_by_target(options, photo_session, tmp_path):
    """The target faces the eye, is tilted and is shifted; one calibration has the error of the test before."""
    other = tmp_path / "displaced"
    shutil.copytree(photo_session.out, other)
    displace_display(other)
    result = verify_session(replace(options, calibration=(photo_session.out, other), viewpoints=1))
    overall, by_target, each = result.tables
    assert [row[:2] for row in overall.rows] == [[name, method] for name in ("out", "displaced") for method in METHODS]
    assert [row[1:4] for row in by_target.rows] == [
        [pose, name, method]
        for pose in ("frontal", "tilted", "shifted")
        for name in ("out", "displaced")
        for method in METHODS
    ]
    assert len(each.rows) == 12
    for row in by_target.rows:
        dots, median = row[4:6]
        assert dots == next(one[4] for one in by_target.rows if one[1] == row[1])
        assert dots >= 20
        assert median == pytest.approx(0.005 / ARCMIN, rel=0.15) if row[2] == "displaced" else median < 1.0
    assert len({row[4] for row in by_target.rows}) > 1  # the poses do differ
    assert any(isinstance(block, Plot) for block in result.blocks)
    assert "out, ray traced: drawn dots lie" in result.verdict


def test_photographs_are_taken_on_the_bench_as_it_is(options, photo_session, monkeypatch):
    """The camera misses its reading by the stage's errors at each visit; photographs are blurred and hazy."""
    taken = []
    monkeypatch.setattr(session_photographs, "take", lambda pose: taken.append(pose) or take(pose))
    verify_session(options)
    tracking, *eyeball = taken
    sizes = photo_session.bench.options.imperfections
    assert {(each.vibration_px, each.stray_light) for each in taken} == {(sizes.vibration_px, sizes.stray_light)}
    assert tracking.optics is None
    nominal = photo_session.bench.camera_at(np.zeros(3))[:3, 3]
    off_um = 1e6 * np.linalg.norm(eyeball[0].frame_from_camera[:3, 3] - nominal)
    assert 1 < off_um < 5 * sizes.repeatability_um


def test_a_stage_that_became_loose_since_the_session_shows(options, photo_session):
    """Display and target are 0.1 m apart: a millimetre aside moves one over the other by an arcminute."""
    medians = [row[2] for row in verify_session(options).tables[0].rows]
    path = photo_session.folder / "simulation.toml"
    content = tomllib.loads(path.read_text(encoding="utf-8"))
    content["bench"]["imperfections"]["repeatability_um"] = 1000.0
    path.unlink()
    write_toml(path, content)
    loose = [row[2] for row in verify_session(options).tables[0].rows]
    assert min(loose) > max(medians) + 0.3


def without(name):
    def spoil(session, options):
        os.remove(session.out / name)
        return options

    return spoil


def not_simulated(session, options):
    os.remove(session.folder / "simulation.toml")
    return options


def of_another_device(session, options):
    model = load_eye_model(session.out / "model.json")
    os.remove(session.out / "model.json")
    save_eye_models(session.out / "model.json", [replace(model, device="birdbath28")])
    return options


@pytest.mark.parametrize(
    ("spoil", "complaint"),
    [
        (not_simulated, "has no simulation.toml, so the session is not simulated"),
        (without("model.json"), "holds no model.json; run `wlr-render calibrate photos"),
        (without("station-right.json"), "`calibrate` writes it"),
        (of_another_device, "is a calibration of birdbath28, right eye, .* and not of"),
        (lambda session, options: replace(options, depths_m=(0.05,)), "tracking_50mm.png"),
        (lambda session, options: replace(options, calibration=(session.out,) * 2), "names .*out twice"),
        (lambda session, options: replace(options, calibration=()), "--calibration is empty"),
    ],
)
def test_what_cannot_be_verified_is_refused_in_one_sentence(photo_session, options, spoil, complaint):
    with pytest.raises(BadInputError, match=complaint) as caught:
        verify_session(spoil(photo_session, options))
    assert "\n" not in str(caught.value)


def test_the_command_line_ends_with_status_2(photo_session, tmp_path, capsys):
    calibration = ["--calibration", str(tmp_path / "none"), "--out", str(tmp_path / "verify")]
    assert main(["verify", "session", str(photo_session.folder), *calibration]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"wlr-render: {tmp_path / 'none'}: holds no model.json; run")

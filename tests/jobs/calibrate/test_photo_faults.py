"""Sessions with something wrong: what is named, what is left out, and what comes out all the same."""

import json
import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from present import present
from small_photo_session import BLACK, SmallSession, blown_out

from benchmarks.simulated_lab.saved_station import load_station
from wlr_render.calibration.calibrate_session import SessionCalibration
from wlr_render.calibration.photograph_captures import sound_captures
from wlr_render.calibration.poses import motion_between
from wlr_render.captures.boards.board_design import design_board
from wlr_render.captures.boards.board_file import save_board
from wlr_render.captures.photo_session_file import load_photo_session
from wlr_render.cli import main
from wlr_render.errors import BadInputError
from wlr_render.report.blocks import Report

pytestmark = pytest.mark.slow  # the session that all of them copy takes some twenty seconds to make

SEEN = "see_through/pose0_02.png"
SET = "display/01"
ELSEWHERE = "bare/pose0_02.png"
RESULTS = ("model.json", "captures-right.npz", "station-right.json", "report.html")


def command_line(
    session: SmallSession, capsys: pytest.CaptureFixture[str], *options: str
) -> tuple[int, str, list[str]]:
    """Exit status, tables and complaints, without the progress bar, of a calibration that has no results yet."""
    for name in RESULTS:
        (session.out / name).unlink()
    status = main(["calibrate", str(session.folder), "--out", str(session.out), *options])
    printed = capsys.readouterr()
    assert "Traceback" not in printed.out + printed.err
    return status, printed.out, [line for line in printed.err.splitlines() if line.startswith("wlr-render: ")]


# One photograph that failed: the work goes on.


FAILED = {
    "bare/pose0_01.png": "cannot be read as a picture",
    "intrinsics/eyeball/03.png": "is blown out",
    "tracking/pose0_after.png": "is black",
}


def photographs_that_failed(session: SmallSession) -> None:
    """Nothing can be read from them, which is no fault of the session."""
    session.cut_short("bare/pose0_01.png")
    session.repaint("intrinsics/eyeball/03.png", blown_out)
    session.repaint("tracking/pose0_after.png", BLACK)


@pytest.mark.parametrize("spoil", [BLACK, blown_out])
def test_it_is_no_fault_of_the_session(photo_session: SmallSession, spoil: Callable[..., Any]) -> None:
    photo_session.repaint(SEEN, spoil)
    assert [(each.name, each.fault) for each in photo_session.read().excluded] == [(SEEN, False)]


# The session is not what session.toml says: named, exit status 2, and everything else calibrated.


def without_a_board(session: SmallSession) -> None:
    os.remove(session.folder / SEEN)
    os.link(session.folder / SET / "000_white.png", session.folder / SEEN)


def another_size(session: SmallSession) -> None:
    session.repaint(SEEN, lambda image: image[:200])


def missing(session: SmallSession) -> None:
    os.remove(session.folder / SEEN)


def a_pipe(session: SmallSession) -> None:
    """In place of a photograph that an earlier run has read, which nobody writes into."""
    session.read()
    os.remove(session.folder / SEEN)
    os.mkfifo(session.folder / SEEN)


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (without_a_board, "show more of the board"),
        (another_size, "is 400 x 200 pixels, but its camera has 400 x 320"),
        (missing, "there is no such file; take the photograph"),
        pytest.param(a_pipe, "is a pipe", marks=pytest.mark.skipif(os.name == "nt", reason="makes a pipe")),
    ],
)
def test_a_board_photograph_that_is_not_what_it_should_be_is_a_fault(
    photo_session: SmallSession, spoil: Callable[..., Any], reason: str
) -> None:
    spoil(photo_session)
    found = photo_session.read()
    (aside,) = found.excluded
    assert (aside.name, aside.fault) == (SEEN, True)
    assert reason in aside.reason
    assert len(found.boards) == 47


def paths(session: SmallSession) -> list[Path]:
    return sorted((session.folder / SET).iterdir())


def each_of_the_set(session: SmallSession, paint: Callable[..., Any]) -> None:
    for path in paths(session):
        session.repaint(path.relative_to(session.folder), paint)


def no_picture_left(session: SmallSession) -> None:
    for path in paths(session):
        path.unlink()


def one_too_many(session: SmallSession) -> None:
    os.link(paths(session)[-1], session.folder / SET / "999.png")


def swapped(first: int, second: int) -> Callable[[Any], None]:
    def spoil(session: SmallSession) -> None:
        found = paths(session)
        session.swap(found[first].relative_to(session.folder), found[second].relative_to(session.folder))

    return spoil


def without_a_bit(session: SmallSession) -> None:
    for path in paths(session)[4:6]:
        path.unlink()


SET_FAULTS: dict[str, tuple[Callable[[SmallSession], None], str]] = {
    "both of a bit missing": (without_a_bit, "one of the two is needed to read"),
    "one too many": (one_too_many, "999.png: its name states no picture of the code"),
    "all missing": (no_picture_left, "holds no photographs"),
    "folder missing": (lambda s: shutil.rmtree(s.folder / SET), "there is no such folder"),
    "bits exchanged": (swapped(4, 7), "photograph 4 ('u bit 4')"),
    "one of another size": (
        lambda s: s.repaint(f"{SET}/003_u_bit_5_inverse.png", lambda image: image[:200]),
        "003_u_bit_5_inverse.png: is 400 x 200 pixels",
    ),
    "all of another size": (lambda s: each_of_the_set(s, lambda image: image[:200]), "its camera has 400 x 320"),
    "one cut short": (lambda s: s.cut_short(f"{SET}/003_u_bit_5_inverse.png"), "003_u_bit_5_inverse.png: cannot be"),
    "one black": (lambda s: s.repaint(f"{SET}/000_white.png", BLACK), "000_white.png: is black"),
}


@pytest.mark.parametrize("place", [0, 5, -1])
def test_a_panel_set_is_read_without_one_of_its_photographs(photo_session: SmallSession, place: int) -> None:
    missing = paths(photo_session)[place]
    missing.unlink()
    found = photo_session.read()
    assert not found.excluded
    (note,) = found.notes
    assert missing.stem[4:].replace("_", " ").split(" px")[0] in note


@pytest.mark.parametrize("fault", SET_FAULTS)
def test_a_panel_set_that_is_not_what_it_should_be_is_a_fault(photo_session: SmallSession, fault: str) -> None:
    spoil, reason = SET_FAULTS[fault]
    spoil(photo_session)
    found = photo_session.read()
    (aside,) = found.excluded
    assert (aside.name, aside.fault) == (SET, True)
    assert reason in aside.reason
    assert str(photo_session.folder) not in aside.reason  # names as in session.toml
    assert len(found.panels) == 3


def test_faults_end_with_status_2_after_everything_else_is_done(
    photo_session: SmallSession, capsys: pytest.CaptureFixture[str]
) -> None:
    """One of the faults is that a photograph was taken at another stage reading than session.toml says."""
    photographs_that_failed(photo_session)
    missing(photo_session)
    swapped(0, 1)(photo_session)
    photo_session.edit(lambda content: content["bare"][2]["stage_mm"].__setitem__(0, 7.0))
    status, out, err = command_line(photo_session, capsys)
    assert status == 2
    assert err == [f"wlr-render: 3 faulty item(s) were left out: {ELSEWHERE}, {SET}, {SEEN}."]
    assert "1. Compare the excluded photographs with their entries in session.toml" in out
    assert "Gain of one more row of positions" in out  # three of the display are left
    record = json.loads((photo_session.out / "report.json").read_text(encoding="utf-8"))
    tables = record["tables"]
    (aside,) = [table["rows"] for table in tables if table["title"] == "Excluded"]
    reasons = {row["photograph"]: row["reason"] for row in aside}
    assert reasons[SEEN].startswith("there is no such file; take the photograph")
    assert reasons[SET].startswith("photograph 0 ('white')")
    (checks,) = [json.dumps(table) for table in tables if table["title"] == "Checks of the bench"]
    assert "or its stage reading is another; the photograph was rejected" in checks
    assert reasons.keys() == {SEEN, SET, ELSEWHERE, *FAILED}
    for name, reason in FAILED.items():
        assert reason in reasons[name]
        assert any(name in line and reason in line for line in out.splitlines())
        assert name in (photo_session.out / "report.html").read_text(encoding="utf-8")
    (fits,) = [table["rows"] for table in tables if table["title"] == "Fit"]
    (sizes,) = [table["rows"] for table in tables if table["title"] == "Sizes"]
    assert [size["viewpoints"] for size in sizes] == [3, 4]
    assert all(fit["residual rms (arcmin)"] < 0.5 for fit in fits)
    assert all((photo_session.out / name).is_file() for name in RESULTS)
    place = present(load_photo_session(photo_session.folder).display[0].stage)
    found = load_station(photo_session.out / "station-right.json").device_from_camera(place)
    assert np.linalg.norm(motion_between(photo_session.bench.camera_at(place), found)[3:]) < 1e-3


# Steps that contradict each other.


def kept(session: SmallSession) -> dict[Any, Any]:
    return {path.name: path.stat().st_mtime_ns for path in (session.out / "read").iterdir()}


def other_target_pose(session: SmallSession) -> None:
    os.remove(session.folder / "tracking/pose0_before.png")
    os.link(session.folder / "tracking/pose1_before.png", session.folder / "tracking/pose0_before.png")


def test_a_refused_run_leaves_no_results_of_an_earlier_one(
    photo_session: SmallSession, capsys: pytest.CaptureFixture[str]
) -> None:
    """The bench as it was found, and the report of it, stay for the user to look at; they are this run's."""
    other_target_pose(photo_session)
    before, readings = (photo_session.out / "station-right.json").stat().st_mtime_ns, kept(photo_session)
    photo_session.cut_short("bare/pose0_01.png")
    status, _, (sentence,) = command_line(photo_session, capsys)
    assert status == 2
    assert "tracking/pose0_after.png and tracking/pose0_before.png fit worst: are they of the target" in sentence
    assert {name for name in readings if not name.startswith("bare__pose0_01")} <= kept(photo_session).keys()
    left = {path.name for path in photo_session.out.iterdir()}
    assert left.isdisjoint({"model.json", "captures-right.npz", "coverage.png"})
    report = json.loads((photo_session.out / "report.json").read_text(encoding="utf-8"))
    assert report["is_refused"] is True
    assert report["sentence"].removeprefix("Refused: ") in sentence
    tables = {table["title"]: table["rows"] for table in report["tables"]}
    assert [row["photograph"] for row in tables["Excluded"]] == ["bare/pose0_01.png"]
    assert any(row["check"] == "FAILED" for row in tables["Checks of the bench"])
    assert report["advice"]
    assert "FAILED" in (photo_session.out / "report.md").read_text(encoding="utf-8")
    assert (photo_session.out / "report.html").is_file()
    assert (photo_session.out / "station-right.json").stat().st_mtime_ns != before
    record = json.loads((photo_session.out / "station-right.json").read_text(encoding="utf-8"))
    assert not all(check["ok"] for check in record["checks"])


def test_cameras_far_from_the_eye_box_are_refused(
    calibrated_session: tuple[SmallSession, SessionCalibration, Report],
) -> None:
    """As where the tracking camera is placed wrongly, or the frame is another than the file states."""
    _, found, _ = calibrated_session
    own = found.session.for_eye("right")
    elsewhere = replace(own.eye_box, centre=own.eye_box.centre + [0.0, 0.05, 0.0])
    with pytest.raises(
        BadInputError,
        match=r"the camera places lie \(.*\) mm .* from the middle of \[eye_box\]; check \[tracking_camera\].* 'frame'",
    ):
        sound_captures(replace(own, eye_boxes={"right": elsewhere}), found.reading, found.bench)


# What session.toml may not say.


def in_metres(content: dict[str, Any]) -> None:
    for name in ("bare", "see_through", "display"):
        for item in content[name]:
            item["stage_mm"] = [value / 1000 for value in item["stage_mm"]]


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (in_metres, r"'stage_mm' (travel of [[bare]]) should be between 0.5 and 500 mm"),
        (lambda content: content["eyeball_camera"].update(bits=12), "check its 'bits'"),
        (lambda content: content.pop("bare"), "add [[bare]] photographs of a target"),
    ],
)
def test_a_session_file_with_a_fault_is_refused_in_one_sentence(
    photo_session: SmallSession, capsys: pytest.CaptureFixture[str], change: Callable[..., Any], complaint: str
) -> None:
    photo_session.edit(change)
    before = kept(photo_session)
    status, _, err = command_line(photo_session, capsys)
    assert status == 2
    (line,) = err
    assert complaint in line
    assert kept(photo_session).keys() == before.keys()


def test_a_long_list_of_what_was_excluded_is_in_the_report(photo_session: SmallSession) -> None:
    (photo_session.folder / "board.toml").unlink()
    save_board(design_board(16, 8, 0.041, seed=7), photo_session.folder / "board.toml")
    for path in photo_session.folder.glob("intrinsics/tracking/*"):
        path.unlink() if path.stem > "03" else None
    photo_session.edit(lambda content: content.update(bare=content["bare"][:3], see_through=content["see_through"][:2]))
    sentence = photo_session.refusal()
    assert "[eyeball_camera]: a camera needs 3 or more photographs of the board" in sentence
    assert "is it another board?" in sentence
    assert sentence.count("intrinsics/eyeball") == 3
    assert "Excluded before, 3 of 19: " in sentence
    assert sentence.endswith(f"What was read and found is in {photo_session.out / 'report.html'}.")
    report = json.loads((photo_session.out / "report.json").read_text(encoding="utf-8"))
    (excluded,) = (table["rows"] for table in report["tables"] if table["title"] == "Excluded")
    assert len(excluded) == 19


def test_photographs_of_the_lens_that_are_not_there(photo_session: SmallSession) -> None:
    folder = photo_session.folder / "intrinsics" / "eyeball"
    for path in folder.iterdir():
        path.unlink()
    assert f"{folder}: holds no photographs" in photo_session.refusal()
    folder.rmdir()
    assert f"{folder}: there is no such folder of photographs" in photo_session.refusal()

"""Photographs that a lab has taken with the display off and on, judged without drawing anything."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from present import as_number, narrowed
from small_photo_session import SmallSession

from wlr_render.calibration.bench.station_file import read_lens, read_station
from wlr_render.captures.photographs import read_photograph, write_photograph
from wlr_render.cli import main
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import arcmin_between
from wlr_render.jobs.verify import VerifyOptions, verify
from wlr_render.lenses.residual_lens import ResidualLens

pytestmark = pytest.mark.slow  # the session that all of them copy takes some twenty seconds to make

SHIFT_PX = 3


@pytest.fixture
def pairs(photo_session: SmallSession, tmp_path: Path) -> Path:
    """One photograph of the target as `off`, and moved by whole pixels as two ways of `on`."""
    photograph = read_photograph(photo_session.folder / "bare" / "pose1_00.png")
    folder = tmp_path / "pairs"
    write_photograph(folder / "left_off.png", photograph)
    write_photograph(folder / "left_on_traced.png", photograph)
    write_photograph(folder / "left_on_warped.png", np.roll(photograph, SHIFT_PX, axis=1))
    return folder


def options(session: SmallSession, pairs: Path, folder: Path) -> VerifyOptions:
    return VerifyOptions(pairs, session.folder / "board.toml", calibration=session.out, out=folder / "out")


def test_a_known_displacement_is_measured(photo_session: SmallSession, pairs: Path, tmp_path: Path) -> None:
    report = verify(options(photo_session, pairs, tmp_path))
    overall, each = report.tables
    assert [row[:2] for row in each.rows] == [["left", "traced"], ["left", "warped"]]
    medians = {row[0]: row[2] for row in overall.rows}
    camera = narrowed(
        read_lens(read_station(photo_session.out / "station-right.json").table("eyeball_camera")), ResidualLens
    )
    middle = camera.centre_px
    one_shift = float(arcmin_between(camera.dir_of_pixel(middle), camera.dir_of_pixel(middle + [SHIFT_PX, 0.0])))
    assert as_number(medians["traced"]) < 0.01
    assert medians["warped"] == pytest.approx(one_shift, rel=0.1)  # an angle off the axis is somewhat smaller
    assert all(path.is_file() for path in report.files)


def test_the_command_line_judges_pairs(
    photo_session: SmallSession, pairs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["--calibration", str(photo_session.out), "--out", str(tmp_path / "verified")]
    assert main(["verify", str(pairs), *given]) == 2
    assert "needs BOARD" in capsys.readouterr().err
    board = str(photo_session.folder / "board.toml")
    assert main(["verify", str(pairs), board, *given, "--eye", "left"]) == 2
    assert "station-left.json" in capsys.readouterr().err
    assert not (tmp_path / "verified").exists()
    assert main(["verify", str(pairs), board, *given]) == 0
    assert "drawn dots lie" in capsys.readouterr().out
    record = json.loads((tmp_path / "verified" / "report.json").read_text(encoding="utf-8"))
    assert record["provenance"]["options"]["--photographs"]["file"] == str(pairs)


@pytest.mark.parametrize(
    ("damage", "sentence"),
    [
        (lambda path: path.write_bytes(path.read_bytes()[:900]), "cannot be read as a"),
        (
            lambda path: write_photograph(path, np.full((40, 30), 99, np.uint8)),
            "is 30 x 40 pixels of 8 bits, but its camera",
        ),
    ],
    ids=["cut", "another size"],
)
def test_a_photograph_that_cannot_be_compared_is_named_before_anything_is_written(
    photo_session: SmallSession, pairs: Path, tmp_path: Path, damage: Callable[..., Any], sentence: str
) -> None:
    damage(pairs / "left_on_warped.png")
    with pytest.raises(BadInputError, match=rf"left_on_warped\.png: {sentence}"):
        verify(options(photo_session, pairs, tmp_path))
    assert not (tmp_path / "out" / "misalignment.png").exists()


def test_what_is_no_pair_is_named(photo_session: SmallSession, pairs: Path, tmp_path: Path) -> None:
    given = options(photo_session, pairs, tmp_path)
    (pairs / "left_off.png").unlink()
    with pytest.raises(BadInputError, match=r"left_on_traced\.png: its photograph with the display off is missing"):
        verify(given)
    for path in pairs.glob("*_on_*"):
        path.unlink()
    write_photograph(pairs / "x.png", np.zeros((4, 4), np.uint8))
    with pytest.raises(BadInputError, match="holds no pairs of photographs"):
        verify(given)

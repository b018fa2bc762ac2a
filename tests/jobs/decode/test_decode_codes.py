"""A folder of code photographs, from files to tables, pictures and positions."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from wlr_render.captures.decoded import Rejection
from wlr_render.captures.patterns.catalogue import GrayCode
from wlr_render.captures.photographs import write_photograph
from wlr_render.errors import BadInputError
from wlr_render.jobs.decode import DecodeVerbOptions, decode
from wlr_render.jobs.show_pattern import PatternOptions
from wlr_render.jobs.show_pattern import pattern as show_pattern
from wlr_render.mappings import Panel


@pytest.fixture
def photographed(tmp_path: Path) -> tuple[Path, GrayCode]:
    """The panel itself, as a camera with its very pixels would see it, and what it shows."""
    pattern = GrayCode(Panel(96, 64))
    folder = tmp_path / "photographs"
    for index in range(len(pattern.names())):
        write_photograph(folder / f"{index}.png", pattern.image(index) // 2 + 20)
    return folder, pattern


def test_positions_tables_and_pictures_are_written(photographed: tuple[Path, GrayCode], tmp_path: Path) -> None:
    folder, pattern = photographed
    result = decode(DecodeVerbOptions(folder, panel=(96, 64), pattern="gray", out=tmp_path / "out"))
    assert all(path.stat().st_size > 100 for path in result.files)
    with np.load(tmp_path / "out" / "decoded.npz") as decoded:
        accepted = decoded["rejection"] == Rejection.ACCEPTED
        assert accepted.mean() > 0.9
        np.testing.assert_allclose(decoded["pixel"][accepted], pattern.panel.pixel_centres()[accepted], atol=0.02)
    fate, strength = json.loads((tmp_path / "out" / "report.json").read_text())["tables"]
    assert sum(row["pixels"] for row in fate["rows"]) == 96 * 64
    assert [row["bit"] for row in strength["rows"]] == [name for name in pattern.names()[2:] if "inverse" not in name]
    assert all(row["median"] == 1.0 and row["verdict"] == "" for row in strength["rows"])


def test_photographs_of_another_panel_are_refused(photographed: tuple[Path, GrayCode], tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="photograph"):
        decode(DecodeVerbOptions(photographed[0], panel=(300, 64), pattern="gray", out=tmp_path / "out"))
    assert not (tmp_path / "out").exists()
    with pytest.raises(BadInputError, match=f"^{photographed[0]}: photograph 0"):
        decode(DecodeVerbOptions(photographed[0], panel=(96, 64), pattern="gray", order="opencv", out=tmp_path / "out"))


def test_light_that_dims_between_whites_is_repaired_and_reported(tmp_path: Path) -> None:
    code = GrayCode(Panel(96, 64))
    options = PatternOptions(panel=(96, 64), pattern="gray", white_every=4, out=tmp_path / "page")
    show_pattern(options)
    shown = sorted((tmp_path / "page").glob("*.png"))
    assert [path.stem for path in shown[:8]] == [
        f"{number:03d}_{name}"
        for number, name in enumerate(
            ["white", "black", "white", "u_bit_6", "u_bit_6_inverse", "u_bit_5", "u_bit_5_inverse", "white"]
        )
    ]
    for number, path in enumerate(shown):
        light = 1.0 - 0.3 * np.sin(np.pi * number / len(shown)) ** 2
        picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        (tmp_path / "set").mkdir(exist_ok=True)
        write_photograph(tmp_path / "set" / path.name, (20 + 0.7 * light * picture).astype(np.uint8))
    result = decode(DecodeVerbOptions(tmp_path / "set", panel=(96, 64), pattern="gray", out=tmp_path / "out"))
    assert result.warnings[0].startswith("White photographs taken again differ by -29.")
    with np.load(tmp_path / "out" / "decoded.npz") as decoded:
        accepted = decoded["rejection"] == Rejection.ACCEPTED
        assert accepted.mean() > 0.9
        np.testing.assert_allclose(decoded["pixel"][accepted], code.panel.pixel_centres()[accepted], atol=0.02)

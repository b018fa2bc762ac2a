"""Options check themselves: the command line and scripts are refused the same values in the same words."""

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pytest

from wlr_render.cli import main
from wlr_render.errors import BadInputError
from wlr_render.io.input_files import shown
from wlr_render.jobs.options import OnlyWith, Options, Range, described
from wlr_render.jobs.print_board import BoardOptions


@dataclass(frozen=True)
class DrawOptions(Options):
    scene: Annotated[str, described("A scene.")]
    _: KW_ONLY
    method: Annotated[Literal["raster", "rays"], described("Method.")] = "raster"
    shadows: Annotated[bool, described("Shadows.", flag=True), OnlyWith("method", ("rays",))] = False
    rate: Annotated[float, described("Rate.", name="--fps"), Range(above=0)] = 30.0
    depths_m: Annotated[tuple[float, ...], described("Depths."), Range(at_least=0.1, at_most=10)] = (1.0, 2.0)
    limit: Annotated[int | None, described("Limit."), Range(at_least=1)] = None
    size: Annotated[tuple[int, int], described("Size."), Range(1, 5000, product=1_000_000)] = (640, 480)


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"rate": 0.0}, "--fps is 0.0; it must be a finite number above 0."),
        ({"rate": np.nan}, "--fps is nan; it must be a finite number above 0."),
        ({"depths_m": (1.0, 11.0)}, "--depths-m is 11.0; it must be between 0.1 and 10."),
        ({"limit": -(10**400)}, f"--limit is {shown(-(10**400))}; it must be a finite number of 1 or more."),
        ({"method": "paint"}, "--method is paint; choose from raster, rays."),
        ({"size": (4000, 3000)}, "--size is 4000x3000; it must be at most 1000000 in all."),
        ({"shadows": True}, "--shadows is used with --method rays only; leave it out, or give --method rays."),
    ],
)
def test_values_out_of_range_and_unused_options_are_refused(values: dict[str, Any], sentence: str) -> None:
    with pytest.raises(BadInputError) as refused:
        DrawOptions("desk", **values)
    assert str(refused.value) == sentence


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["board", "--columns", "1000", "--rows", "999"], "999000 shapes; it must be at most 100000"),
        (
            ["simulate", "northstar", "--depths-m", *map(str, range(1, 22))],
            "--depths-m 21 are 21 distances; it must be at most",
        ),
        (
            ["simulate", "northstar", "--viewpoints", "1000", "--depths-m", *map(str, range(1, 11))],
            "are 10000 photographs",
        ),
        (["plan", "northstar", "--depths-m", *map(str, range(1, 22))], "--depths-m 21 are 21 distances"),
        (["pattern", "--panel", "8x8", "--photograph", "nowhere {path}"], "the program 'nowhere' is not installed"),
        (["decode", "s", "--panel", "8x8", "--bits", "12", "--camera", "c.toml"], "both state the bits"),
    ],
)
def test_requests_out_of_range_are_refused_before_work_begins(
    arguments: Sequence[str],
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    assert words in " ".join(capsys.readouterr().err.split())
    assert not list(tmp_path.iterdir())


def test_only_the_output_folder_in_use_must_be_usable(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "out").write_text("a file")
    monkeypatch.chdir(tmp_path)
    BoardOptions()  # as import of the job does, for its default argument
    assert main(["board", "--out", "elsewhere"]) == 0
    assert main(["board"]) == 2
    assert "out/board: cannot write to this output folder" in capsys.readouterr().err

"""The command line's verbs about photographs."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import refused

from wlr_render.captures.photographs import read_photograph, write_photograph
from wlr_render.cli import main
from wlr_render.jobs import simulate
from wlr_render.simulation.photographs.imperfections import BenchImperfections
from wlr_render.simulation.photographs.photo_bench import PhotoBenchOptions
from wlr_render.simulation.photographs.recipe import SimulationRecipe
from wlr_render.simulation.photographs.simulate_photo_session import TakenPhotographs
from wlr_render.work.workers import WorkerPool


def test_options_of_the_command_line_make_the_bench(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    given = []

    def simulate_nothing(*arguments: object) -> TakenPhotographs:
        given.append(arguments[:3])
        return TakenPhotographs(7, 3, ())

    monkeypatch.setattr(simulate, "simulate_photo_session", simulate_nothing)
    chosen = ["northstar", "--eye", "left", "--viewpoints", "6", "--pattern", "gray", "--camera", "640x480"]
    bench_options = ["--bits", "12", "--pupil-mm", "2", "--focus-m", "0.7", "--snr", "20"]
    sizes = ["--perfect", "--repeatability-um", "3", "--bow-mm", "0.1", "--stage", "xyz"]
    camera_places = ["--sampling", "volumetric", "--stated-axes-deg", "0.1", "--tracking-camera", "800x600"]
    depths = ["--depths-m", "0.5", "0.8", "2"]
    given_bench = [*chosen, *bench_options, *sizes, *camera_places, *depths]
    assert main(["simulate", *given_bench, "--out", "there", "--seed", "4", "--workers", "1"]) == 0
    imperfections = replace(BenchImperfections.none(), repeatability_um=3.0, bow_mm=0.1)
    made_of = PhotoBenchOptions(
        (640, 480), 12, 2.0, 0.7, 20.0, (0.5, 0.8, 2.0), 4, imperfections, "xyz", "volumetric", 0.1, (800, 600)
    )
    assert given == [(Path("there"), SimulationRecipe("northstar", "left", 6, "gray", made_of), WorkerPool(1))]
    printed = capsys.readouterr().out
    assert "7 photographs taken, 3 kept from an earlier run: there" in printed
    assert "wlr-render calibrate there" in printed


def expose_less(folder: Path) -> None:
    """Pictures as a camera takes them: white is below the end of the scale."""
    for path in folder.glob("*.png"):
        image = (0.8 * read_photograph(path)).astype(np.uint8)
        path.unlink()
        write_photograph(path, image)


def test_well_exposed_pictures_of_a_code_decode_to_themselves(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    panel = ["--panel", "160x100", "--pattern", "fringes"]
    assert main(["pattern", *panel, "--out", str(tmp_path / "shown")]) == 0
    assert "show.html" in capsys.readouterr().out
    expose_less(tmp_path / "shown")
    assert main(["decode", str(tmp_path / "shown"), *panel, "--out", str(tmp_path / "out")]) == 0
    assert "Written: " in capsys.readouterr().out
    decoded = np.load(tmp_path / "out" / "decoded.npz")
    accepted = decoded["rejection"] == 0
    assert accepted.mean() > 0.9
    centres = np.stack(np.meshgrid(np.arange(160) + 0.5, np.arange(100) + 0.5), axis=-1)
    assert np.abs(decoded["pixel"] - centres)[accepted].max() < 0.02


def test_pictures_at_the_end_of_the_scale_are_refused_as_over_exposed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nothing tells the pictures themselves from photographs that are clipped."""
    assert main(["pattern", "--panel", "64x40", "--out", str(tmp_path / "shown")]) == 0
    capsys.readouterr()
    decode = ["decode", str(tmp_path / "shown"), "--panel", "64x40", "--out", str(tmp_path / "out")]
    assert "('white') is over-exposed: 100% of it is at the end of the scale (255)" in refused(decode, capsys)


@pytest.mark.parametrize("size", ["1920", "wide x high"])
def test_sizes_that_make_no_sense_are_refused(size: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sentence = refused(["pattern", "--panel", size, "--out", str(tmp_path / "out")], capsys)
    assert f"--panel: '{size}' is not width and height in pixels" in sentence
    assert not (tmp_path / "out").exists()

"""`python -m benchmarks`: options that reach a benchmark, what is printed, what is refused."""

from functools import wraps
from pathlib import Path

import pytest

from benchmarks.__main__ import BENCHMARKS, main
from benchmarks.soak import study
from benchmarks.soak.wearer import Wearer
from wlr_render.report.blocks import Report, ReportTable
from wlr_render.work.progress import Progress


def test_soak_options_reach_the_benchmark_and_its_tables_are_printed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    given: list[study.SoakOptions] = []
    table = ReportTable("A title", ("what", "how long (ms)"), [["this", 1.25]], ("A note.",))

    @wraps(study.run)
    def run(options: study.SoakOptions, progress: Progress) -> Report:
        given.append(options)
        return Report("", blocks=[table])

    monkeypatch.setattr(study, "run", run)
    assert main(["soak", "northstar", "desk"]) == 0
    files = ["--head", "h.tum", "--eye-track", "e.txt"]
    numbers = ["--frames", "9", "--fps", "72", "--size", "640x480", "--late-ms", "10", "--seed", "4"]
    choices = ["--eye", "both", "--backend", "osmesa", "--out", "there"]
    assert main(["soak", "both.json", "dots", *files, *numbers, *choices]) == 0
    assert given == [
        study.SoakOptions("northstar", "desk"),
        study.SoakOptions(
            "both.json",
            "dots",
            eye="both",
            head=Path("h.tum"),
            eye_track=Path("e.txt"),
            seed=4,
            frames=9,
            frames_per_second=72.0,
            late_ms=10.0,
            size=(640, 480),
            backend="osmesa",
            out=Path("there"),
        ),
    ]
    assert given[1].wearer == Wearer(Path("h.tum"), Path("e.txt"), 4)
    printed = capsys.readouterr().out
    assert all(text in printed for text in ("A title", "how long (ms)", "1.25", "A note."))


@pytest.mark.parametrize("name", BENCHMARKS)
def test_every_benchmark_has_help(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([name, "--help"]) == 0
    printed = capsys.readouterr().out
    assert BENCHMARKS[name][:30] in printed
    assert "--out" in printed
    assert "None" not in printed


def test_a_stream_that_cannot_be_is_told_in_one_line_and_leaves_nothing_behind(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    track = tmp_path / "eyes.txt"
    header = ("# format: wlr-eye-trajectory 1", "# kind: viewpoint", "# frame: openxr-device", "# units: s m")
    track.write_text("\n".join([*header, "0.0 right 0.03 0 -0.03", "0.1 right 0.03 0 -0.03"]) + "\n")
    out = tmp_path / "out"
    for arguments, sentence in (
        (["--eye-track", str(track)], "eyes.txt: together they cover 0.100 s, which is 10 frames at 90 per second"),
        (["--eye-track", str(track), "--eye", "left"], "eyes.txt: has no left eye, only the right one"),
        (["--frames", "1"], "it must be a finite number of 2 or more"),
    ):
        assert main(["soak", "northstar", "dots", *arguments, "--out", str(out)]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith("benchmarks: ")
        assert sentence in line
        assert not list(tmp_path.glob("out/*"))


def test_a_benchmark_refuses_the_options_of_another(capsys: pytest.CaptureFixture[str]) -> None:
    for arguments in (["speed", "--trials", "3"], ["diagnosis", "--record", "kept"], ["raster", "a", "--seed", "1"]):
        assert main(arguments) == 2
        assert arguments[-2] in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("accuracy --part densty", "densty"),
        ("accuracy --draws 0", "--draws is 0"),
        ("accuracy --part stage --counts 3", "--counts is used with --part camera-positions"),
        ("accuracy --part time --stuck 5", "--stuck is used with --part stuck"),
        ("accuracy --box 10 8 0", "--box is 0.0; it must be a finite number above 0"),
        ("accuracy no-such-device", "no-such-device"),
        ("accuracy no_optics --eye left", "no left eye"),
        ("design --headsets vive", "vive"),
        ("design --sessions 1", "--sessions is 1; it must be between 2 and 1000."),
        ("paper --degrees 13", "--degrees is 13"),
        ("paper no-such-device", "no-such-device"),
        ("published-data itoh .", "itoh-seethrough"),
        ("rivals --measured .", "holds none of itoh_hmd_calibration/dataset"),
        ("rivals --measured none", "none: there is no such folder"),
        ("rivals --sets views", "--sets is used with --measured only"),
    ],
)
def test_impossible_studies_are_refused_before_they_start(
    arguments: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main([*arguments.split(), "--out", "out"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert words in line
    assert not list(tmp_path.glob("out/*"))

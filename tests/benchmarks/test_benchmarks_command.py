"""`python -m benchmarks`: options that reach a benchmark, what is printed, what is refused."""

from pathlib import Path

import pytest

from benchmarks.__main__ import main
from benchmarks.soak import study
from benchmarks.soak.wearer import Wearer
from wlr_render.report.blocks import ReportTable


def test_soak_options_reach_the_benchmark_and_its_tables_are_printed(monkeypatch, capsys):
    given = []
    table = ReportTable("A title", ("what", "how long (ms)"), [["this", 1.25]], ("A note.",))
    result = study.Result((table,), (Path("there/soak.png"),))
    monkeypatch.setattr(study, "run", lambda options, progress: given.append(options) or result)
    assert main(["soak", "northstar", "desk"]) == 0
    files = ["--head", "h.tum", "--eye-track", "e.txt"]
    numbers = ["--frames", "9", "--fps", "72", "--size", "640x480", "--late-ms", "10", "--seed", "4"]
    choices = ["--eye", "both", "--solve", "pixels", "--backend", "osmesa", "--out", "there"]
    assert main(["soak", "l.json", "r.json", "dots", *files, *numbers, *choices]) == 0
    assert given == [
        study.Options(("northstar",), "desk"),
        study.Options(
            headset=("l.json", "r.json"),
            scene="dots",
            eyes=("left", "right"),
            wearer=Wearer(Path("h.tum"), Path("e.txt"), 4),
            frames=9,
            frames_per_second=72.0,
            late_ms=10.0,
            size=(640, 480),
            context="osmesa",
            solve="pixels",
            out=Path("there"),
        ),
    ]
    printed = capsys.readouterr().out
    assert all(text in printed for text in ("A title", "how long (ms)", "1.25", "A note.", "Written into there"))


def test_a_stream_that_cannot_be_is_told_in_one_line_and_leaves_nothing_behind(tmp_path, capsys):
    track = tmp_path / "eyes.txt"
    header = ("# format: wlr-eye-trajectory 1", "# kind: viewpoint", "# frame: openxr-device", "# units: s m")
    track.write_text("\n".join([*header, "0.0 right 0.03 0 -0.03", "0.1 right 0.03 0 -0.03"]) + "\n")
    out = tmp_path / "out"
    for arguments, sentence in (
        (["--eye-track", str(track)], "eyes.txt: together they cover 0.100 s, which is 10 frames at 90 per second"),
        (["--eye-track", str(track), "--eye", "left"], "eyes.txt: has no left eye, only the right one"),
        (["--frames", "1"], "ask for 2 or more"),
        (["--solve", "pixels", "--frames", "2", "--size", "16x16"], "only planar models"),
    ):
        assert main(["soak", "northstar", "dots", *arguments, "--out", str(out)]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith("benchmarks: ")
        assert sentence in line
        assert not list(tmp_path.glob("out/*"))


def test_a_benchmark_refuses_the_options_of_another(capsys):
    for arguments in (["speed", "--trials", "3"], ["diagnosis", "--record", "kept"], ["two-views", "x", "--seed", "1"]):
        with pytest.raises(SystemExit) as left:
            main(arguments)
        assert left.value.code == 2
        assert "unrecognized arguments" in capsys.readouterr().err

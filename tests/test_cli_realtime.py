"""The command line of the real-time path: what reaches its jobs, what is printed, what is refused."""

from pathlib import Path

from command_line import refused

from wlr_render.cli import main
from wlr_render.evaluation.report import ReportTable
from wlr_render.studies.streaming import study
from wlr_render.studies.streaming.wearer import Wearer


def test_stream_options_reach_the_job_and_its_tables_are_printed(monkeypatch, capsys):
    given = []
    table = ReportTable("A title", ("what", "how long (ms)"), [["this", 1.25]], ("A note.",))
    result = study.Result((table,), (Path("there/stream.png"),))
    monkeypatch.setattr(study, "run", lambda options, progress: given.append(options) or result)
    assert main(["stream", "northstar", "desk"]) == 0
    files = ["--head", "h.tum", "--eye-track", "e.txt"]
    numbers = ["--frames", "9", "--fps", "72", "--size", "640x480", "--late-ms", "10", "--seed", "4"]
    choices = ["--eye", "both", "--solve", "pixels", "--backend", "osmesa", "--out", "there"]
    assert main(["stream", "l.json", "r.json", "dots", *files, *numbers, *choices]) == 0
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
    assert all(text in printed for text in ("A title", "how long (ms)", "1.25", "A note.", "there/stream.png"))


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
        assert sentence in refused(["stream", "northstar", "dots", *arguments, "--out", str(out)], capsys)
        assert not list(tmp_path.glob("out/*"))

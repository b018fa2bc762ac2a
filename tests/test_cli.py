"""The command line: what it prints, what it refuses and how, and that it starts quickly."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from command_line import refused

from wlr_render.cli import main
from wlr_render.errors import MissingGlError
from wlr_render.files import resource
from wlr_render.jobs import demo as alignment_demo
from wlr_render.jobs import render as render_sequence
from wlr_render.rendering import gl
from wlr_render.report.blocks import Report, ReportTable
from wlr_render.report.terminal import print_report

VERBS = (
    "demo",
    "trace",
    "board",
    "pattern",
    "simulate",
    "decode",
    "verify",
    "calibrate",
    "evaluate",
    "render",
    "compare",
    "diagnose",
    "hold-out",
    "import",
)
TABLE = ReportTable("A title", ("what", "how much (arcmin)"), [["this", 1.25]], ("A note.",))


def device(folder, *changes):
    """A device without optics, 48 x 27 pixels, with some more text replaced: (old, new) pairs."""
    text = resource("devices", "no_optics.toml").read_text(encoding="utf-8")
    for old, new in (("[1280, 720]", "[48, 27]"), *changes):
        assert old in text
        text = text.replace(old, new)
    path = folder / "device.toml"
    path.write_text(text, encoding="utf-8")
    return str(path)


@pytest.fixture(scope="module")
def model_file(tmp_path_factory):
    """A model that the command line itself has calibrated."""
    out = tmp_path_factory.mktemp("calibrated")
    simulated = ["--simulate", "birdbath28", "--viewpoints", "12", "--degree", "3", "--see-through-degree", "2"]
    assert main(["calibrate", *simulated, "--out", str(out)]) == 0
    return out / "model.json"


def run_python(code, *arguments):
    return subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, timeout=60)


def test_starting_loads_nothing_heavy():
    heavy = ("numpy", "scipy", "cv2", "trimesh", "pyrender", "moderngl", "matplotlib", "embreex", "rich")
    code = f"import sys, wlr_render.cli; print(*(name for name in {heavy} if name in sys.modules))"
    result = run_python(code)
    assert (result.returncode, result.stdout.split()) == (0, [])


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_explains_itself(verb, capsys):
    with pytest.raises(SystemExit) as left:
        main([verb, "--help"])
    text = capsys.readouterr().out
    assert left.value.code == 0
    assert all(option in text for option in ("--debug", f"wlr-render {verb}"))
    assert ("--out" in text) == (verb != "simulate")  # which writes into the folder that it is given


def test_help_lists_all_verbs_and_what_a_headset_and_a_scene_are(capsys):
    with pytest.raises(SystemExit):
        main(["--help"])
    text = capsys.readouterr().out
    assert all(f"    {verb}" in text for verb in VERBS)
    assert "HEADSET is" in text
    assert "SCENE a" in text


def test_without_a_verb_it_says_how_to_use_it(capsys):
    with pytest.raises(SystemExit) as left:
        main([])
    assert left.value.code == 2
    assert "VERB" in capsys.readouterr().err


# What is refused.


def empty_mesh(folder):
    path = folder / "empty.ply"
    header = ("ply", "format ascii 1.0", "element vertex 0", "property float x", "property float y", "property float z")
    faces = ("element face 0", "property list uchar int vertex_indices", "end_header")
    path.write_text("\n".join([*header, *faces]) + "\n")
    return str(path)


def mesh_with_nan(folder):
    path = folder / "nan.ply"
    header = ("ply", "format ascii 1.0", "element vertex 3", "property float x", "property float y", "property float z")
    faces = ("element face 1", "property list uchar int vertex_indices", "end_header")
    path.write_text("\n".join([*header, *faces, "0 0 0", "1 nan 0", "0 1 0", "3 0 1 2"]) + "\n")
    return str(path)


def empty_obj(folder):
    path = folder / "empty.obj"
    path.write_text("# nothing\n")
    return str(path)


def text_file(folder, name, *lines):
    path = folder / name
    path.write_text("\n".join(lines) + "\n")
    return str(path)


def disordered_head(folder):
    return text_file(folder, "head.tum", "0.0 0 0 0 0 0 0 1", "0.2 0 0 0 0 0 0 1", "0.1 0 0 0 0 0 0 1")


def eyes_outside(folder):
    header = ("# format: wlr-eye-trajectory 1", "# kind: viewpoint", "# frame: openxr-device", "# units: s m")
    return text_file(folder, "eyes.txt", *header, "0.0 right 0.02 0 0", "0.1 right 0.02 0 0")


FAULTS = {
    "unknown device": (lambda f: ["trace", "nothstar"], "'nothstar' is neither a file nor one of the shipped devices"),
    "unknown key": (
        lambda f: ["trace", device(f, ("size_mm = [320.0, 180.0]", "size_mm = [320.0, 180.0]\ncolor = 3"))],
        "unknown key 'color'",
    ),
    "wrong unit": (
        lambda f: ["trace", device(f, ("centre_mm = [0.0, 0.0, 500.0]", "centre_m = [0.0, 0.0, 0.5]"))],
        "key 'centre_mm' is missing (found 'centre_m' instead)",
    ),
    "no TOML": (lambda f: ["trace", text_file(f, "broken.toml", "name = ")], "broken.toml"),
    "eye that is not there": (lambda f: ["trace", "no_optics", "--eye", "left"], "has no left eye; choose right"),
    "unknown scene": (lambda f: ["render", device(f), "dest"], "Did you mean desk"),
    "empty PLY": (lambda f: ["render", device(f), empty_mesh(f)], "empty.ply"),
    "empty OBJ": (lambda f: ["compare", device(f), empty_obj(f)], "empty.obj"),
    "NaN in a mesh": (lambda f: ["render", device(f), mesh_with_nan(f)], "nan.ply: mesh"),
    "times out of order": (
        lambda f: ["render", device(f), "dots", "--head", disordered_head(f)],
        "head.tum line 3: time 0.1 does not come after the row before it",
    ),
    "viewpoint outside in a track": (
        lambda f: ["render", device(f), "dots", "--eye-track", eyes_outside(f)],
        "eyes.txt at 0.0000 s, right eye: the viewpoint (20.00, 0.00, 0.00) mm lies outside the eye box",
    ),
    "viewpoint outside": (
        lambda f: ["compare", device(f), "dots", "--viewpoint-offset-mm", "0", "0", "9"],
        "--viewpoint-offset-mm: the viewpoint (0.00, 0.00, 9.00) mm lies outside",
    ),
    "contradiction": (lambda f: ["render", device(f), "dots", "--shadows"], "need the method raytrace"),
    "endless frame rate": (lambda f: ["render", device(f), "dots", "--fps", "inf"], "The frame rate is inf"),
    "too few viewpoints": (lambda f: ["demo", "--viewpoints", "4"], "--viewpoints is 4"),
    "too few captures": (
        lambda f: ["calibrate", "--simulate", "birdbath28", "--viewpoints", "3", "--degree", "5"],
        "viewpoints",
    ),
    "no captures": (lambda f: ["calibrate", "--captures", str(f / "none.npz")], "none.npz"),
    "no model": (lambda f: ["render", str(f / "none.json"), "dots"], "none.json: cannot be read"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_told_in_one_line_and_leaves_nothing_behind(fault, tmp_path, capsys):
    make, sentence = FAULTS[fault]
    out = tmp_path / "out"
    assert sentence in refused([*make(tmp_path), "--out", str(out)], capsys)
    assert not out.exists() or not list(out.iterdir())


def test_model_files_that_cannot_be_read_are_refused(model_file, tmp_path, capsys):
    text = model_file.read_text(encoding="utf-8")
    short = text_file(tmp_path, "short.json", text[: len(text) // 2])
    newer = text_file(tmp_path, "newer.json", json.dumps(json.loads(text) | {"version": 99}))
    for path, sentence in ((short, "cut short"), (newer, "has version 99; this program reads version 1")):
        assert sentence in refused(["compare", path, "dots", "--out", str(tmp_path / "out")], capsys)
    left = refused(["render", str(model_file), "dots", "--eye", "left", "--out", str(tmp_path / "out")], capsys)
    assert "is a model of the right eye" in left
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("verb", ["trace", "render", "compare", "demo", "calibrate"])
def test_an_output_folder_that_is_a_file_is_refused(verb, tmp_path, capsys):
    arguments = {
        "trace": [device(tmp_path)],
        "render": [device(tmp_path), "dots"],
        "compare": [device(tmp_path), "dots"],
        "demo": ["--device", device(tmp_path)],
        "calibrate": ["--simulate", device(tmp_path), "--viewpoints", "5"],
    }
    text_file(tmp_path, "taken", "a file")
    sentence = refused([verb, *arguments[verb], "--out", str(tmp_path / "taken")], capsys)
    assert "taken: cannot write to this output folder" in sentence
    assert (tmp_path / "taken").read_text() == "a file\n"


@pytest.mark.parametrize("verb", ["render", "compare"])
def test_missing_opengl_is_told_and_leaves_nothing_behind(verb, tmp_path, capsys, monkeypatch):
    def refuse(backend="auto"):
        raise MissingGlError("No OpenGL: install libegl1, or draw with the CPU backend.")

    monkeypatch.setattr(gl, "open_context", refuse)
    out = tmp_path / "out"
    assert "install libegl1" in refused([verb, device(tmp_path), "dots", "--backend", "egl", "--out", str(out)], capsys)
    assert not out.exists() or not list(out.iterdir())


def test_numbers_that_make_no_sense_are_refused_by_the_parser(tmp_path, capsys):
    for arguments in (["demo", "--viewpoints", "0"], ["calibrate", "--simulate", "x", "--noise-px", "-1"]):
        with pytest.raises(SystemExit) as left:
            main(arguments)
        assert left.value.code == 2
        assert f"argument {arguments[-2]}" in capsys.readouterr().err


def test_debug_shows_where_a_fault_comes_from():
    code = "import sys; from wlr_render.cli import main; sys.exit(main(sys.argv[1:]))"
    result = run_python(code, "trace", "nothstar", "--debug")
    assert result.returncode == 1
    assert "Traceback" in result.stderr
    assert "BadInputError" in result.stderr
    quiet = run_python(code, "trace", "nothstar")
    assert (quiet.returncode, quiet.stdout) == (2, "")
    assert quiet.stderr.count("\n") == 1


def test_an_interruption_has_its_own_status(monkeypatch, capsys):
    def interrupt(*arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr("wlr_render.jobs.trace.trace", interrupt)
    assert main(["trace", "northstar"]) == 130
    assert capsys.readouterr().err == "wlr-render: interrupted; what is finished is kept.\n"


# What is printed, and what reaches the jobs.


def test_trace_prints_its_figures_and_where_the_drawing_is(tmp_path, capsys):
    assert main(["trace", device(tmp_path), "--out", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr().out
    assert "pupil swim per mm in x" in printed
    assert str(tmp_path / "out" / "no_optics-right.png") in printed.replace("\n", "")


def test_calibrate_writes_a_model_that_render_takes(model_file, tmp_path, capsys):
    assert sorted(path.name for path in model_file.parent.iterdir()) == [
        "captures.npz",
        "fit.json",
        "fit.md",
        "model.json",
    ]
    out = tmp_path / "again"
    captures = str(model_file.parent / "captures.npz")
    degrees = ["--degree", "3", "--see-through-degree", "2"]
    assert main(["calibrate", "--captures", captures, *degrees, "--out", str(out)]) == 0
    assert (out / "model.json").read_text() == model_file.read_text()
    assert "Written: " in capsys.readouterr().out


def test_render_says_what_it_drew_and_what_it_kept(tmp_path, capsys):
    arguments = ["render", device(tmp_path), "dots", "--backend", "cpu", "--out", str(tmp_path / "out")]
    assert main(arguments) == 0
    assert "1 frames drawn, 0 kept from an earlier run" in capsys.readouterr().out
    assert main(arguments) == 0
    assert "0 frames drawn, 1 kept from an earlier run" in capsys.readouterr().out


def test_compare_prints_its_table(tmp_path, capsys):
    offset = ["--viewpoint-offset-mm", "1", "-1", "0.5"]
    arguments = ["compare", device(tmp_path), "dots", *offset, "--backend", "cpu", "--out", str(tmp_path / "out")]
    assert main(arguments) == 0
    assert "raster + warp" in capsys.readouterr().out
    record = json.loads((tmp_path / "out" / "compare.json").read_text())
    np.testing.assert_allclose(record["viewpoint_in_device_m"], [0.001, -0.001, 0.0005])


def test_render_options_reach_the_job(monkeypatch):
    given = []
    monkeypatch.setattr(
        render_sequence,
        "run",
        lambda options, progress: given.append(options) or render_sequence.Rendered(0, 0, options.out, ()),
    )
    files = ["--head", "h.tum", "--eye-track", "e.txt"]
    drawing = ["--method", "raytrace", "--supersample", "2", "--shadows", "--fps", "72", "--frames", "9"]
    assert main(["render", "l.json", "r.json", "desk", "--eye", "both", *files, *drawing, "--video"]) == 0
    warping = ["--materials", "gltf", "--resolution", "1.5", "--map-from", "mesh", "--maps", "pfm", "--per-colour"]
    assert main(["render", "northstar", "desk", *warping, "--backend", "osmesa", "--out", "elsewhere"]) == 0
    assert given == [
        render_sequence.Options(
            headset=("l.json", "r.json"),
            scene="desk",
            head=Path("h.tum"),
            eyes_file=Path("e.txt"),
            eyes=("left", "right"),
            method="raytrace",
            frames_per_second=72.0,
            frame_limit=9,
            supersample=2,
            shadows=True,
            video=True,
        ),
        render_sequence.Options(
            headset=("northstar",),
            scene="desk",
            materials="gltf",
            resolution=1.5,
            map_from="mesh",
            maps="pfm",
            per_colour=True,
            backend="osmesa",
            out=Path("elsewhere"),
        ),
    ]


def test_demo_options_reach_the_job_and_its_tables_are_printed(monkeypatch, capsys):
    given = []
    result = alignment_demo.Result([TABLE], Path("out/demo/alignment.png"))
    monkeypatch.setattr(alignment_demo, "run", lambda options, progress: given.append(options) or result)
    assert main(["demo"]) == 0
    chosen = ["--device", "birdbath28", "--scene", "desk", "--eye", "left", "--viewpoints", "9", "--seed", "4"]
    assert main(["demo", *chosen, "--backend", "cpu", "--out", "elsewhere"]) == 0
    expected = alignment_demo.Options("birdbath28", "desk", "left", 9, 4, "cpu", Path("elsewhere"))
    assert given == [alignment_demo.Options(), expected]
    printed = capsys.readouterr().out
    assert all(text in printed for text in ("A title", "how much (arcmin)", "1.25", "A note.", "alignment.png"))


def test_tables_are_whole_in_a_pipe(monkeypatch, capsys):
    wide = ReportTable("Wide", ("what", *("a long column head (arcmin)",) * 4), [["row", 1.0, 2.0, None, 12345.0]])
    monkeypatch.setenv("COLUMNS", "40")
    print_report(Report("", blocks=[wide]))
    row = next(line for line in capsys.readouterr().out.splitlines() if "12345" in line)
    assert all(text in row for text in ("row", "1", "2", "-"))


@pytest.mark.parametrize(("before", "after"), [(None, "1"), ("3", "3")])
def test_blas_threads_are_off_unless_asked_for(monkeypatch, before, after):
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", before or "")
    if before is None:
        monkeypatch.delenv("OPENBLAS_NUM_THREADS")
    main(["trace", "nothstar"])
    assert os.environ["OPENBLAS_NUM_THREADS"] == after

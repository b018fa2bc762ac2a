"""The command line: what it prints, what it refuses and how, and that it starts quickly."""

import dataclasses
import importlib
import inspect
import json
import math
import os
import re
import shutil
import subprocess
import sys
import typing
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NoReturn

import pytest
from command_line import refused
from cyclopts import Parameter, UnknownOptionError

from wlr_render import __version__
from wlr_render.cli import RENAMED, VERBS, Verb, main, make_app
from wlr_render.errors import MissingGlError
from wlr_render.gl import gl
from wlr_render.io.atomic_files import resource
from wlr_render.jobs.demo import DemoOptions
from wlr_render.jobs.options import Range, flag_of
from wlr_render.jobs.render_options import RenderOptions
from wlr_render.report.blocks import Report, ReportTable
from wlr_render.report.terminal import print_report

ROOT = Path(__file__).resolve().parent.parent
every_verb = pytest.mark.parametrize("verb", VERBS, ids=lambda verb: verb.words)
HEAVY = (
    *("numpy", "scipy", "cv2", "trimesh", "pyrender", "moderngl", "matplotlib", "embreex", "jinja2", "plotly"),
    *("OpenEXR", "distributed", "mitsuba", "optiland", "pdoc"),  # of extras
)


def device(folder: Path, *changes: tuple[str, str]) -> str:
    """A device without optics, 48 x 27 pixels, with some more text replaced: (old, new) pairs."""
    text = resource("devices", "no_optics.toml").read_text(encoding="utf-8")
    for old, new in (("[1280, 720]", "[48, 27]"), *changes):
        assert old in text
        text = text.replace(old, new)
    path = folder / "device.toml"
    path.write_text(text, encoding="utf-8")
    return str(path)


def run_python(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, *arguments], capture_output=True, text=True, timeout=60)


def printed_by(arguments: Sequence[Any], capsys: pytest.CaptureFixture[str]) -> str:
    """What a command that succeeds prints, with single spaces."""
    assert main(arguments) == 0
    printed = capsys.readouterr()
    assert printed.err == ""
    return " ".join(printed.out.split())


# Start and help.


@pytest.mark.parametrize("then", ["make_app()", "main(['--help'])", "main(['--version'])", "main(['nonsense'])"])
def test_starting_loads_nothing_heavy(then: str) -> None:
    code = f"import sys; from wlr_render.cli import main, make_app; {then}"
    result = run_python("-c", f"{code}; print(*('loaded: ' + n for n in {HEAVY} if n in sys.modules))")
    assert result.returncode == 0, result.stderr
    assert "loaded" not in result.stdout


def test_the_package_runs_as_a_module_and_states_its_version() -> None:
    for module in ("wlr_render", "wlr_render.cli"):
        result = run_python("-m", module, "--version")
        assert (result.returncode, result.stdout, result.stderr) == (0, f"{__version__}\n", "")


@pytest.mark.parametrize("arguments", [["--help"], ["-h"], []], ids=str)
def test_help_lists_the_verbs_in_their_groups(arguments: Sequence[str], capsys: pytest.CaptureFixture[str]) -> None:
    text = printed_by(arguments, capsys)
    places = [text.index(f"─ {group} ─") for group in dict.fromkeys(verb.group for verb in VERBS)]
    assert places == sorted(places)
    assert all(f"{verb.words.split()[0]} " in text for verb in VERBS)
    assert all(part in text for part in ("HEADSET is a shipped device", "SCENE is a shipped scene", "--debug"))
    assert "--install-completion" in text


def test_completion_knows_the_verbs_and_their_options() -> None:
    script = make_app().generate_completion(shell="bash")
    assert all(word in script for word in ("render", "--supersample", "raytrace"))


def options_of(verb: Verb) -> Any:
    """The dataclass of a verb's options."""
    module, function = verb.function.split(":")
    job = getattr(importlib.import_module(f"wlr_render.jobs.{module}"), function)
    return typing.get_type_hints(inspect.unwrap(job))["options"]


def fields_of(options: Any) -> Iterator[Any]:
    """Fields with their notes, those of options within options among them: (options, field, type, notes)."""
    hints = typing.get_type_hints(options, include_extras=True)
    for field in dataclasses.fields(options):
        if dataclasses.is_dataclass(hints[field.name]):
            yield from fields_of(hints[field.name])
        else:
            yield options, field, typing.get_args(hints[field.name])[0], hints[field.name].__metadata__


@every_verb
def test_every_verb_explains_itself(
    verb: Verb, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "400")
    text = printed_by([*verb.words.split(), "--help"], capsys)
    assert text.startswith(f"Usage: wlr-render {verb.words} ")
    assert verb.help in text
    assert "default: None" not in text
    assert "default: False" not in text
    for _, field, _, notes in fields_of(options_of(verb)):
        (described,) = (note for note in notes if isinstance(note, Parameter))
        assert described.help is not None
        assert described.help[0].isupper(), field.name
        assert described.help.endswith("."), field.name
        assert described.help in text, field.name
        assert all(f" Range: {limits.short()}." in described.help for limits in notes if isinstance(limits, Range))


@every_verb
def test_the_help_of_every_verb_fits_on_two_screens(
    verb: Verb, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert main([*verb.words.split(), "--help"]) == 0
    assert len(capsys.readouterr().out.splitlines()) <= 100


def test_no_two_verbs_replace_each_others_reports_by_default() -> None:
    out = {
        verb.words: field.default
        for verb in VERBS
        for _, field, _, _ in fields_of(options_of(verb))
        if field.name == "out"
    }
    assert len(set(out.values())) == len(out)


STAND_IN = '#!/bin/sh\nprintf "%s" "$(basename "$0")"; printf " [%s]" "$@"; echo\n'


@pytest.mark.parametrize(
    ("arguments", "called"),
    [
        ([], "wlr-render [demo]"),
        (["--eye", "left"], "wlr-render [demo] [--eye] [left]"),
        (["render", "a b", "desk"], "wlr-render [render] [a b] [desk]"),
        (["--version"], "wlr-render [--version]"),
        (["--help"], "wlr-render [--help]"),
        (["bench", "speed"], "python [-m] [benchmarks] [speed]"),
    ],
    ids=str,
)
def test_the_script_beside_the_package_runs_the_verbs(arguments: Sequence[str], called: str, tmp_path: Path) -> None:
    """With stand-ins for the program and for what is installed already."""
    bin_folder = tmp_path / ".venv" / "bin"
    bin_folder.mkdir(parents=True)
    for name in ("wlr", "pyproject.toml", "constraints.txt"):
        shutil.copy(ROOT / name, tmp_path)
    for name in ("wlr-render", "python"):
        (bin_folder / name).write_text(STAND_IN)
        (bin_folder / name).chmod(0o755)
    stamp = subprocess.run("cat pyproject.toml constraints.txt | cksum", shell=True, cwd=tmp_path, capture_output=True)
    (tmp_path / ".venv" / "wlr-stamp").write_bytes(stamp.stdout)
    (tmp_path / ".venv" / "wlr-gl").write_text("egl\n")
    result = subprocess.run([tmp_path / "wlr", *arguments], capture_output=True, text=True, timeout=60)
    assert (result.returncode, result.stderr) == (0, "")
    *own_help, last = result.stdout.splitlines()
    assert last == called
    described = [line.split("./wlr")[1].split()[0] for line in own_help if line.startswith("  ./wlr")]
    assert ({"test", "check", "bench", "VERB"} <= set(described)) == (arguments == ["--help"])


# What is refused.


@every_verb
def test_every_verb_refuses_an_option_that_it_does_not_have(
    verb: Verb, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    needed = {
        "pattern": ["--panel", "64x48"],
        "export": ["--format", "stmap"],
        "import-lens": ["--panel", "64x48", "--panel-mm", "8x6"],
    }.get(verb.words, [])
    sentence = refused([*verb.words.split(), *needed, "--nonsense"], capsys)
    assert sentence.startswith("wlr-render: Unknown option: --nonsense.")
    assert not list(tmp_path.iterdir())


@every_verb
def test_every_verb_refuses_values_that_are_no_choice_or_out_of_range(
    verb: Verb, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    fields = list(fields_of(options_of(verb)))
    good, named = {}, {}
    for options, field, kind, _ in fields:
        if field.default is field.default_factory is dataclasses.MISSING:
            value = (
                (typing.get_args(kind) or [field.name])[0] if typing.get_origin(kind) is typing.Literal else field.name
            )
            if field.kw_only:
                named[field.name] = [flag_of(options, field.name), value if value != field.name else "64x48"]
            else:
                good[field.name] = value
    for options, field, kind, notes in fields:
        limits = next((note for note in notes if isinstance(note, Range)), None)
        flag, others = (
            flag_of(options, field.name),
            [word for name in named if name != field.name for word in named[name]],
        )
        if limits is not None:
            tried = [(words, (flag, "must be")) for words in beyond(flag, kind, limits)]
        elif typing.get_origin(kind) is typing.Literal and isinstance(typing.get_args(kind)[0], str):
            tried = [([flag, "nonsense"], ('Invalid value "nonsense"', flag))]
        else:
            assert not re.search(r"\b(int|float)\b", str(kind)), f"{flag} has no limits"
            continue
        for words, sentences in tried:
            sentence = refused([*verb.words.split(), *good.values(), *others, *words], capsys)
            assert all(each in sentence for each in sentences), f"{' '.join(words)}: {sentence}"
    assert not list(tmp_path.iterdir())


def beyond(flag: str, kind: object, limits: Range) -> Iterator[list[str]]:
    """Words of values beyond each limit of an option, and beyond the product of a size."""
    assert math.isfinite(max(limits.at_least, limits.above))
    assert math.isfinite(limits.at_most)
    numbers = re.findall(r"\b(int|float)\b(?!, \.)", str(kind)) or ["float"]
    below, above = math.floor(max(limits.at_least, limits.above)) - 1, 2 * math.ceil(limits.at_most) + 1
    for wrong in (below, above, *([] if "int" in numbers else ["nan", "inf", "1e308"])):
        yield [flag, *[str(wrong)] * 3] if len(numbers) == 3 else [f"{flag}={'x'.join([str(wrong)] * len(numbers))}"]
    if math.isfinite(limits.product):
        yield [f"{flag}={math.ceil(limits.at_most)}x{math.ceil(limits.at_most)}"]
    if limits.least_size:
        yield [flag, str(0.5 * limits.least_size)]


@pytest.mark.parametrize("arguments", [["rendr"], ["--nonsense"]], ids=str)
def test_an_unknown_verb_is_refused(arguments: Sequence[str], capsys: pytest.CaptureFixture[str]) -> None:
    sentence = refused(arguments, capsys)
    assert f'Unknown command "{arguments[-1]}".' in sentence
    assert ('Did you mean "render"?' in sentence) == (arguments == ["rendr"])


@pytest.mark.parametrize(("old", "new"), RENAMED.items(), ids=str)
def test_an_old_name_of_a_verb_is_answered_with_the_new_one(
    old: str, new: str, capsys: pytest.CaptureFixture[str]
) -> None:
    program = "./wlr" if new.startswith("bench ") else "wlr-render"
    assert f"'{old}' has another name now: {program} {new}" in refused([*old.split(), "something"], capsys)


def test_an_argument_too_many_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert refused(["trace", "northstar", "desk"], capsys) == (
        "wlr-render: Unexpected argument 'desk'; add --help for the arguments of this verb."
    )


@pytest.mark.parametrize(
    ("arguments", "needs"),
    [
        (["import-lens", "lens.zmx"], "import-lens needs --panel"),
        (["import-lens", "lens.zmx", "--panel", "800x600"], "import-lens needs --panel-mm"),
        (["export", "--format", "stmap"], "export needs HEADSET"),
        (["calibrate"], "calibrate needs PATH"),
    ],
)
def test_a_missing_argument_is_called_missing(
    arguments: Sequence[str], needs: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert refused(arguments, capsys) == f"wlr-render: {needs}; add --help for the arguments of this verb."


def test_an_option_without_its_value_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert refused(["trace", "northstar", "--out"], capsys).endswith("--out requires an argument.")


@pytest.mark.parametrize("argument", [["--out", ""], ["--out="], ["--out= "]], ids=str)
def test_an_empty_value_is_refused(
    argument: Sequence[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    sentence = refused(["trace", "northstar", *argument], capsys)
    assert sentence == "wlr-render: --out is empty; give it a value, or leave it out."
    assert not list(tmp_path.iterdir())


def empty_mesh(folder: Path) -> str:
    path = folder / "empty.ply"
    header = ("ply", "format ascii 1.0", "element vertex 0", "property float x", "property float y", "property float z")
    faces = ("element face 0", "property list uchar int vertex_indices", "end_header")
    path.write_text("\n".join([*header, *faces]) + "\n")
    return str(path)


def mesh_with_nan(folder: Path) -> str:
    path = folder / "nan.ply"
    header = ("ply", "format ascii 1.0", "element vertex 3", "property float x", "property float y", "property float z")
    faces = ("element face 1", "property list uchar int vertex_indices", "end_header")
    path.write_text("\n".join([*header, *faces, "0 0 0", "1 nan 0", "0 1 0", "3 0 1 2"]) + "\n")
    return str(path)


def empty_obj(folder: Path) -> str:
    path = folder / "empty.obj"
    path.write_text("# nothing\n")
    return str(path)


def text_file(folder: Path, name: str, *lines: str) -> str:
    path = folder / name
    path.write_text("\n".join(lines) + "\n")
    return str(path)


def disordered_head(folder: Path) -> str:
    return text_file(folder, "head.tum", "0.0 0 0 0 0 0 0 1", "0.2 0 0 0 0 0 0 1", "0.1 0 0 0 0 0 0 1")


def eyes_outside(folder: Path) -> str:
    header = ("# format: wlr-eye-trajectory 1", "# kind: viewpoint", "# frame: openxr-device", "# units: s m")
    return text_file(folder, "eyes.txt", *header, "0.0 right 0.02 0 0", "0.1 right 0.02 0 0")


FAULTS: dict[str, tuple[Callable[[Path], list[str]], str]] = {
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
    "empty OBJ": (lambda f: ["render", device(f), empty_obj(f)], "empty.obj"),
    "NaN in a mesh": (lambda f: ["render", device(f), mesh_with_nan(f)], "nan.ply: mesh"),
    "times out of order": (
        lambda f: ["render", device(f), "dots", "--head", disordered_head(f)],
        "head.tum line 3: time 0.1 does not come after the row before it",
    ),
    "viewpoint outside in a track": (
        lambda f: ["render", device(f), "dots", "--eye-track", eyes_outside(f)],
        "eyes.txt at 0.0000 s, right eye: the viewpoint (20.00, 0.00, 0.00) mm lies outside the eye box",
    ),
    "contradiction": (
        lambda f: ["render", device(f), "dots", "--shadows"],
        "--shadows is used with --method raytrace only; leave it out, or give --method raytrace.",
    ),
    "endless frame rate": (
        lambda f: ["render", device(f), "dots", "--fps", "inf"],
        "--fps is inf; it must be a finite number above 0 and at most 1000.",
    ),
    "one colour of three": (
        lambda f: ["render", device(f), "dots", "--red-model", "red.json"],
        "--red-model and --blue-model go together; give both or neither.",
    ),
    "unknown choice": (lambda f: ["render", device(f), "dots", "--eye", "third"], '"third" for --eye'),
    "no number": (lambda f: ["demo", "--viewpoints", "many"], "'many' is not a whole number"),
    "fewer numbers": (lambda f: ["export", device(f), "--format", "npz", "--viewpoint-mm", "1"], "--viewpoint-mm"),
    "too few viewpoints": (lambda f: ["demo", "--viewpoints", "4"], "--viewpoints is 4"),
    "no model": (lambda f: ["render", str(f / "none.json"), "dots"], "none.json: there is no such file"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_told_in_one_line_and_leaves_nothing_behind(
    fault: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    make, sentence = FAULTS[fault]
    out = tmp_path / "out"
    assert sentence in refused([*make(tmp_path), "--out", str(out)], capsys)
    assert not out.exists() or not list(out.iterdir())


def test_model_files_that_cannot_be_read_are_refused(
    model_file: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = Path(model_file).read_text(encoding="utf-8")
    short = text_file(tmp_path, "short.json", text[: len(text) // 2])
    newer = text_file(tmp_path, "newer.json", json.dumps(json.loads(text) | {"version": 99}))
    for path, sentence in ((short, "cannot be read as a model"), (newer, "has version 99; this program reads version")):
        assert sentence in refused(["render", path, "dots", "--out", str(tmp_path / "out")], capsys)
    left = refused(["render", model_file, "dots", "--eye", "left", "--out", str(tmp_path / "out")], capsys)
    assert "is a model of the right eye" in left
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("verb", ["trace", "render", "demo"])
def test_an_output_folder_that_is_a_file_is_refused(
    verb: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = {
        "trace": [device(tmp_path)],
        "render": [device(tmp_path), "dots"],
        "demo": ["--device", device(tmp_path)],
    }
    text_file(tmp_path, "taken", "a file")
    sentence = refused([verb, *arguments[verb], "--out", str(tmp_path / "taken")], capsys)
    assert "taken: cannot write to this output folder" in sentence
    assert (tmp_path / "taken").read_text() == "a file\n"


def test_missing_opengl_is_told_and_leaves_nothing_behind(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(backend: object = "auto") -> NoReturn:
        raise MissingGlError("No OpenGL: install libegl1, or draw ray-traced frames.")

    monkeypatch.setattr(gl, "open_context", refuse)
    out = tmp_path / "out"
    given = ["render", device(tmp_path), "dots", "--backend", "egl", "--out", str(out)]
    assert "install libegl1" in refused(given, capsys)
    assert not out.exists() or not list(out.iterdir())


@pytest.mark.slow
def test_debug_shows_where_a_fault_comes_from() -> None:
    result = run_python("-m", "wlr_render", "trace", "nothstar", "--debug")
    assert result.returncode == 1
    assert "Traceback" in result.stderr
    assert "BadInputError" in result.stderr
    with pytest.raises(UnknownOptionError):
        main(["trace", "--nonsense", "--debug"])


def test_an_interruption_has_its_own_status(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupt(*arguments: object, **options: object) -> NoReturn:
        raise KeyboardInterrupt

    monkeypatch.setattr("wlr_render.jobs.trace.load_device", interrupt)
    assert main(["trace", "northstar"]) == 130
    assert capsys.readouterr().err == "wlr-render: interrupted; finished files are kept.\n"


# What is printed, and what reaches the jobs.


def test_trace_prints_its_figures_and_where_the_drawing_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["trace", device(tmp_path), "--out", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr().out
    assert "pupil swim per mm in x" in printed
    assert str(tmp_path / "out" / "no_optics-right.png") in printed


def test_render_says_what_it_drew_and_what_it_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["render", device(tmp_path), "dots", "--backend", "cpu", "--out", str(tmp_path / "out")]
    assert main(arguments) == 0
    assert "1 frame drawn, 0 kept from an earlier run" in capsys.readouterr().out
    assert main(arguments) == 0
    assert "0 frames drawn, 1 kept from an earlier run" in capsys.readouterr().out


def options_given_by(arguments: Sequence[str]) -> object:
    """The options that a command line makes."""
    _, bound, _ = make_app().parse_args(arguments, exit_on_error=False, print_error=False)
    return bound.arguments.get("options")


def test_options_reach_the_jobs() -> None:
    files = ["--head", "h.tum", "--eye-track", "e.txt"]
    drawing = ["--method", "raytrace", "--supersample", "3", "--shadows", "--fps", "72", "--frames", "9", "--video"]
    assert options_given_by(["render", "l.json", "desk", "--eye", "both", *files, *drawing]) == RenderOptions(
        "l.json",
        "desk",
        head=Path("h.tum"),
        eye_track=Path("e.txt"),
        eye="both",
        method="raytrace",
        frames_per_second=72.0,
        frame_limit=9,
        supersample=3,
        shadows=True,
        video=True,
    )
    warping = ["--materials", "gltf", "--resolution", "1.5", "--maps", "pfm", "--per-colour"]
    colours = ["--red-model", "r.json", "--blue-model", "b.json", "--backend", "osmesa", "--out", "elsewhere"]
    assert options_given_by(["render", "g.json", "desk", *warping, *colours]) == RenderOptions(
        "g.json",
        "desk",
        materials="gltf",
        resolution=1.5,
        maps="pfm",
        per_colour=True,
        red_model=Path("r.json"),
        blue_model=Path("b.json"),
        backend="osmesa",
        out=Path("elsewhere"),
    )
    chosen = ["--device", "birdbath28", "--scene", "desk", "--eye", "left", "--viewpoints", "9", "--seed", "4"]
    assert options_given_by(["demo", *chosen, "--backend", "cpu", "--out", "elsewhere"]) == DemoOptions(
        device="birdbath28", scene="desk", eye="left", viewpoints=9, seed=4, backend="cpu", out=Path("elsewhere")
    )


def test_tables_are_whole_in_a_pipe(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    wide = ReportTable("Wide", ("what", *("a long column head (arcmin)",) * 4), [["row", 1.0, 2.0, None, 12345.0]])
    monkeypatch.setenv("COLUMNS", "40")
    print_report(Report("", blocks=[wide]))
    row = next(line for line in capsys.readouterr().out.splitlines() if "12345" in line)
    assert all(text in row for text in ("row", "1", "2", "-"))


@pytest.mark.parametrize(("before", "after"), [(None, "1"), ("3", "3")])
def test_blas_threads_are_off_unless_asked_for(monkeypatch: pytest.MonkeyPatch, before: str | None, after: str) -> None:
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", before or "")
    if before is None:
        monkeypatch.delenv("OPENBLAS_NUM_THREADS")
    main(["trace", "nothstar"])
    assert os.environ["OPENBLAS_NUM_THREADS"] == after

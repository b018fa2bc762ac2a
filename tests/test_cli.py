"""The command line: what it prints, what it refuses and how, and that it starts quickly."""

import dataclasses
import importlib
import inspect
import math
import os
import re
import subprocess
import sys
import typing
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from command_line import refused
from cyclopts import Parameter, UnknownOptionError
from small_headsets import changed_device

from wlr_render import __version__
from wlr_render.cli import RENAMED, VERBS, Verb, main, make_app
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


def device(folder: Path) -> str:
    """A device without optics, 48 x 27 pixels."""
    return changed_device(folder, "no_optics", ("[1280, 720]", "[48, 27]"))


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


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["trace", "nothstar"], "'nothstar' is neither a file nor one of the shipped devices"),
        (["demo", "--viewpoints", "many"], "'many' is not a whole number"),
        (["export", "no_optics", "--format", "npz", "--viewpoint-mm", "1"], "--viewpoint-mm"),
        (
            ["render", "no_optics", "dots", "--shadows"],
            "--shadows is used with --method raytrace only; leave it out, or give --method raytrace.",
        ),
    ],
)
def test_a_fault_is_told_in_one_line_and_leaves_nothing_behind(
    arguments: Sequence[str], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert sentence in refused([*arguments, "--out", str(tmp_path / "out")], capsys)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_debug_shows_where_a_fault_comes_from() -> None:
    result = run_python("-m", "wlr_render", "trace", "nothstar", "--debug")
    assert result.returncode == 1
    assert "Traceback" in result.stderr
    assert "BadInputError" in result.stderr
    with pytest.raises(UnknownOptionError):
        main(["trace", "--nonsense", "--debug"])


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

"""Files, classes, constants, verbs and options that the documents and messages name exist."""

import re
import tomllib
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from cyclopts import CycloptsError
from cyclopts.core import App

from benchmarks.__main__ import make_app as make_benchmarks
from wlr_render.cli import make_app
from wlr_render.errors import BadInputError

ROOT = Path(__file__).resolve().parent.parent
FOLDERS = ("benchmarks", "devices", "docs", "examples", "scenes", "shaders")
TEXTS = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    ROOT / "CHANGELOG.md",
    *(path for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*.md"))),
]
CODE = [
    path
    for folder in ("wlr_render", "benchmarks", "examples")
    for path in sorted((ROOT / folder).rglob("*.py"))
    if re.search(r"\./wlr|wlr-render", path.read_text(encoding="utf-8"))
]
FILE = re.compile(r"`([\w./-]+\.(?:py|md|glsl|frag|vert|toml))`")
LINK = re.compile(r"\]\(([^)#:]+)\)")
ANCHOR = re.compile(r"\]\(([^)#:]*)#([^)]+)\)")
HEADING = re.compile(r"^#+ (.+)$", re.MULTILINE)
# Files of users, not of ours.
THEIRS = {
    "session.toml",
    "simulation.toml",
    "bench.toml",
    "board.toml",
    "device.toml",
    "manifest.toml",
    "report.md",
}
PLACES = [
    ROOT,
    ROOT / "wlr_render",
    ROOT / "shaders",
    ROOT / "docs",
    *(p for p in (ROOT / "wlr_render").rglob("*") if p.is_dir()),
    *(p for p in (ROOT / "benchmarks").rglob("*") if p.is_dir()),
]
PROGRAM = r"(?:\./wlr|wlr-render)(?: |$)"
SPAN = re.compile(r"`([^`\n]+)`")
CODE_SUFFIXES = {".py", ".h", ".glsl", ".frag", ".vert"}
CLASS_OR_CONSTANT = re.compile(r"\b(?:[A-Z]+_[A-Z_]+|[A-Z][a-z]+[A-Z]\w*)\b")
# Of environments and of other programs.
THEIR_NAMES = {"OPENBLAS_NUM_THREADS", "OffscreenRenderer", "PYOPENGL_PLATFORM", "XDG_RUNTIME_DIR", "WLR_DATA"} | {
    *(
        "ArrayMesh",
        "CommandBuffer",
        "DllImport",
        "FPSemantics",
        "FPSemanticsMode",
        "FSceneViewExtensionBase",
    ),  # of engines
    *("IndexFormat", "LayoutKind", "StructLayout", "SubViewport"),
    *("ComputeDistortion", "SubmitLayer", "TRANSFER_SRC", "XrCompositionLayerDisplayImageMNDX"),  # of XR runtimes
}
WORDS_OF_THE_SCRIPT = {"test", "check", "readers", "docs", "bench"}
PLACEHOLDERS = {"VERB", "NAME"}
VERBS, BENCHMARKS = make_app(), make_benchmarks()


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


@pytest.mark.parametrize("text", TEXTS, ids=name_of)
def test_files_that_a_text_names_exist(text: Path) -> None:
    content = text.read_text(encoding="utf-8")
    named = {name for name in FILE.findall(content) if "NAME" not in name} - THEIRS
    lost = {name for name in named if not any((place / name).exists() for place in [text.parent, *PLACES])}
    lost |= {link for link in LINK.findall(content) if not (text.parent / link).exists()}
    assert not lost


def anchors_of(path: Path) -> set[Any]:
    """Of the headings of a Markdown file, as GitHub makes them."""
    words = (re.sub(r"[^\w\- ]", "", heading.lower()) for heading in HEADING.findall(path.read_text(encoding="utf-8")))
    return {each.strip().replace(" ", "-") for each in words}


@pytest.mark.parametrize("text", TEXTS, ids=name_of)
def test_sections_that_a_text_links_exist(text: Path) -> None:
    found = {
        (name, anchor)
        for name, anchor in ANCHOR.findall(text.read_text(encoding="utf-8"))
        if anchor not in anchors_of(text.parent / name if name else text)
    }
    assert not found


def app_of(app: App, words: list[str]) -> tuple[Any, Any]:
    """The parser of the verb that some words begin with, and the words behind it."""
    words = list(words)
    while words and not words[0].startswith("-") and words[0] in app:
        app = app[words.pop(0)]
    return app, words


def fault_of_command(text: str, *, complete: bool, of_script: bool) -> str:
    """What is wrong with a command as a text names it, without the program's name; empty if nothing is.

    Args:
        text: what follows `./wlr` or `wlr-render`.
        complete: whether the command must be accepted as it stands, and not only its verb and its options' names.
        of_script: whether the words of the script `wlr` are meant too.
    """
    app, words = VERBS, re.sub(r"\"[^\"]*\"", "TEXT", text.split("#")[0]).split()
    if of_script and words and words[0] in WORDS_OF_THE_SCRIPT:
        if words[0] != "bench":
            return ""
        app, words = BENCHMARKS, words[1:]
    if not words or words[0] in PLACEHOLDERS or (words[0].startswith("-") and words[0] in app):
        return ""
    verb, rest = app_of(app, words)
    if verb is app or (verb.default_command is None and rest):  # the latter is a verb that only has verbs of its own
        return f"'{' '.join(words[: len(words) - len(rest) + 1])}' is not a verb"
    if verb.default_command is None:
        return ""
    if complete:
        try:
            app.parse_args(words, exit_on_error=False, print_error=False)
        except (CycloptsError, BadInputError) as error:
            return str(error)
    known = {name for argument in verb.assemble_argument_collection() for name in argument.names} | {"--help"}
    lost = [word for word in rest if word.startswith("--") and word.split("=")[0] not in known]
    return f"no option {', '.join(lost)}" if lost else ""


def faults_of_text(content: str) -> dict[Any, Any]:
    """Commands in a Markdown text that the command line does not take: those of code blocks as they stand."""
    faults = {}
    blocks = re.findall(r"^```\w*\n(.*?)^```|((?:^    .*\n)+)", content, flags=re.M | re.S)
    for line in "\n".join(a or b for a, b in blocks).splitlines():
        if match := re.match(rf" *{PROGRAM}(.*)", line):
            faults[line] = fault_of_command(match[1], complete=True, of_script="./wlr" in line)
    for span in SPAN.findall(re.sub(r"^```.*?^```", "", content, flags=re.M | re.S)):
        faults[span] = fault_of_span(span)
    return {command: fault for command, fault in faults.items() if fault}


def fault_of_span(span: str) -> str:
    """What is wrong with a span of code if it is a command: with the program's name, or a verb with options."""
    if match := re.match(rf"{PROGRAM}(.*)", span):
        return fault_of_command(match[1], complete=False, of_script=span.startswith("./wlr"))
    is_verb = app_of(VERBS, span.split())[0] is not VERBS and " --" in span
    return fault_of_command(span, complete=False, of_script=False) if is_verb else ""


@cache
def sources() -> str:
    """All source files of the program as one text."""
    folders = (ROOT / name for name in ("wlr_render", "benchmarks", "shaders", "tests/oracle"))
    return "".join(
        path.read_text("utf-8") for folder in folders for path in folder.rglob("*.*") if path.suffix in CODE_SUFFIXES
    )


@pytest.mark.parametrize("text", [text for text in TEXTS if text.name != "CHANGELOG.md"], ids=name_of)
def test_classes_and_constants_that_a_text_names_exist(text: Path) -> None:
    names = {
        name for span in SPAN.findall(text.read_text(encoding="utf-8")) for name in CLASS_OR_CONSTANT.findall(span)
    }
    assert {name for name in names - THEIR_NAMES if not re.search(rf"\b{name}\b", sources())} == set()


@pytest.mark.parametrize("text", [text for text in TEXTS if text.name != "CHANGELOG.md"], ids=name_of)
def test_commands_that_a_text_names_are_accepted(text: Path) -> None:
    assert faults_of_text(text.read_text(encoding="utf-8")) == {}


@pytest.mark.parametrize("path", CODE, ids=name_of)
def test_commands_that_messages_and_docstrings_name_exist(path: Path) -> None:
    joined = re.sub(r'"\s*\n\s*f?"', "", path.read_text(encoding="utf-8"))
    faults = {span: fault_of_span(span) for span in SPAN.findall(joined)}
    assert {span: fault for span, fault in faults.items() if fault} == {}


@pytest.mark.parametrize(
    "text",
    [
        "`./wlr rendr`",
        "`wlr-render bench`",
        "`./wlr bench speed --recrod DIR`",
        "`render --shadow`",
        "```\n./wlr render northstar\n```\n",
        "```\n./wlr render northstar desk --maps jpeg  # a comment\n```\n",
        "    ./wlr render northstar desk --eyes left\n",
    ],
)
def test_wrong_commands_are_found(text: str) -> None:
    assert len(faults_of_text(text)) == 1


def test_the_picture_of_the_rooms_has_the_layers_of_the_contract() -> None:
    contract = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"][
        "contracts"
    ][0]
    picture = (ROOT / "docs/architecture.md").read_text(encoding="utf-8").split("```")[1].partition("\n\n")[0]
    rows = [re.split(r"\s{2,}", line[12:])[0] for line in picture.strip().splitlines()]
    assert ["__main__", *rows] == contract["layers"]

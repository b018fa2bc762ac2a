"""What files of others say cannot control the terminal."""

import ast
from pathlib import Path

import pytest

from wlr_render.cli import main
from wlr_render.report.blocks import Report, ReportTable
from wlr_render.report.terminal import print_report, say, terminal_progress

ROOT = Path(__file__).resolve().parents[2]
# An escape sequence, C1's own, a bell, a line that overwrites, text that runs backwards, a lone surrogate.
CONTROLS = "\x1b[2J\x9b31m\a\rgone\u202e\udc80"
ESCAPED = r"\x1b[2J\x9b31m\x07\rgone\u202e\udc80"
MARKUP = "[red]warm[/red] :smile: [/]"


def test_lines_are_escaped_and_ordinary_text_stays(capsys: pytest.CaptureFixture[str]) -> None:
    say("Größe 5 µm, p~ ≤ 1\u00a0px", CONTROLS + MARKUP, Path("a b"))
    say(CONTROLS, error=True)
    printed = capsys.readouterr()
    assert printed.out.split("\n") == ["Größe 5 µm, p~ ≤ 1\u00a0px", ESCAPED + MARKUP, "a b", ""]
    assert printed.err == ESCAPED + "\n"


@pytest.mark.parametrize("place", ["title", "columns", "cell", "note"])
def test_tables_are_escaped_wherever_the_text_stands(capsys: pytest.CaptureFixture[str], place: str) -> None:
    parts = dict.fromkeys(("title", "columns", "cell", "note"), "as wide as the title" * 4) | {place: CONTROLS + MARKUP}
    table = ReportTable(parts["title"], [parts["columns"]], [[parts["cell"]]], [parts["note"]])
    print_report(Report("", blocks=[table]))
    printed = capsys.readouterr().out
    assert ESCAPED + MARKUP in printed
    assert not set("\x1b\x9b\a\r\u202e") & set(printed)


def test_progress_is_for_terminals_only(capsys: pytest.CaptureFixture[str]) -> None:
    with terminal_progress() as progress:
        assert list(progress(range(2), 2, "label")) == [0, 1]
        progress.say("words")
    assert capsys.readouterr().err == ""


def test_progress_is_escaped(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "200")
    with terminal_progress() as progress:
        assert list(progress(range(2), 2, CONTROLS + MARKUP)) == [0, 1]
    assert ESCAPED + MARKUP in capsys.readouterr().err


def test_a_status_is_escaped(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "200")
    with terminal_progress() as progress:
        progress.say(CONTROLS + MARKUP)
    assert ESCAPED + MARKUP in capsys.readouterr().err


def test_an_error_about_a_file_is_escaped(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "evil.toml"
    path.write_text('frame = "\\u001b[2J\\u0007"\n', encoding="utf-8")
    assert main(["trace", str(path)]) == 2
    assert r"'frame' is '\x1b[2J\x07'" in capsys.readouterr().err


def test_only_the_terminal_module_prints() -> None:
    for path in (*(ROOT / "wlr_render").rglob("*.py"), *(ROOT / "benchmarks").rglob("*.py")):
        if path.name == "terminal.py":
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            assert not (isinstance(node, ast.Name) and node.id == "print"), f"{path}:{node.lineno}: call terminal.say"


def test_long_tables_are_cut_and_say_so(capsys: pytest.CaptureFixture[str]) -> None:
    print_report(Report("", blocks=[ReportTable("T", ["n"], [[f"row {n}"] for n in range(30)])]))
    printed = capsys.readouterr().out
    assert "row 19 " in printed
    assert "row 20 " not in printed
    assert "10 more rows are in the report's files." in printed

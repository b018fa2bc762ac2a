"""A report says the same in HTML, Markdown, JSON and the terminal, and where it comes from."""

import dataclasses
import enum
import hashlib
import json
import os
import pickle
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import needs_browser, open_page
from matplotlib.figure import Figure

from wlr_render import __version__
from wlr_render.io.atomic_files import write_figure
from wlr_render.io.input_files import LIMITS
from wlr_render.io.toml_files import write_json
from wlr_render.report.blocks import Block, Estimate, Number, Picture, Plot, Report, ReportTable, Section, Text, table
from wlr_render.report.plots import bars
from wlr_render.report.records import to_jsonable
from wlr_render.report.save import markdown_table, save_report
from wlr_render.scene.image_files import write_png

TABLE = ReportTable("Errors", ["name", "error (arcmin)"], [["a", 0.24321], ["b|<i>", np.nan], ["c", 3e-6]], ["A note."])
CURVE = Plot(
    "Curve", [{"type": "scatter", "x": np.arange(3), "y": [1.0, np.nan, 2.0]}], {"xaxis": {"title": "time (s)"}}
)


@pytest.fixture
def saved(tmp_path: Path) -> Report:
    picture = write_png(tmp_path / "dots.png", np.full((4, 5, 3), 77, np.uint8)) or tmp_path / "dots.png"
    source = tmp_path / "input.toml"
    source.write_text("a = 1\n")
    report = Report(
        "Report of <session> & co",
        "It works to 0.2'.",
        advice=["Type `scale = 0.997`."],
        warnings=["Few captures."],
        blocks=[Section("First"), Text("Words.", ["one"]), TABLE, Section("Second"), Picture("Dots", picture), CURVE],
        inputs=[source],
        record={"sigma": np.float64(0.5)},
    )
    return save_report(report, tmp_path / "out", "report")


def test_three_files_are_written_and_named(saved: Report, tmp_path: Path) -> None:
    assert [path.name for path in saved.files] == ["report.html", "report.md", "report.json"]
    assert all(path.is_file() for path in saved.files)


def test_json_holds_the_record_full_precision_and_provenance(saved: Report, tmp_path: Path) -> None:
    record = json.loads(saved.files[2].read_text())
    assert record["sigma"] == 0.5
    assert record["tables"][0]["rows"][0] == {"name": "a", "error (arcmin)": 0.24321}
    assert record["tables"][0]["rows"][1]["error (arcmin)"] is None
    assert record["plots"][0]["data"][0]["y"] == [1.0, None, 2.0]
    origin = record["provenance"]
    assert origin["version"] == __version__
    assert origin["inputs"][0]["sha256"] == hashlib.sha256(b"a = 1\n").hexdigest()


def test_a_changed_file_in_a_folder_changes_its_hash(tmp_path: Path) -> None:
    folder = tmp_path / "session"
    folder.mkdir()
    hashes = []
    for content in ("1", "2"):
        (folder / "a").write_text(content)
        report = save_report(Report("T", inputs=[folder]), tmp_path, "report")
        hashes.append(json.loads(report.files[2].read_text())["provenance"]["inputs"][0]["sha256"])
    assert hashes[0] != hashes[1]


def input_hash(out: Path, inputs: Sequence[Any]) -> str:
    report = save_report(Report("T", inputs=inputs), out, "report")
    return str(json.loads(report.files[2].read_text())["provenance"]["inputs"][0]["sha256"])


def test_a_report_inside_its_input_does_not_change_the_hash(tmp_path: Path) -> None:
    (tmp_path / "session").mkdir()
    (tmp_path / "session" / "a").write_text("1")
    inside = tmp_path / "session" / "out"
    assert input_hash(inside, [tmp_path / "session"]) == input_hash(inside, [tmp_path / "session"])


def test_an_input_that_is_gone_loses_no_report(tmp_path: Path) -> None:
    assert input_hash(tmp_path, [tmp_path / "gone"]) == "not readable (No such file or directory)"


def test_a_file_that_is_too_large_to_be_read_is_not_hashed(tmp_path: Path) -> None:
    assert max(size for name, size in vars(LIMITS).items() if name.endswith("_bytes")) == LIMITS.picture_bytes
    (tmp_path / "session").mkdir()
    big = tmp_path / "session" / "big.png"
    big.touch()
    os.truncate(big, 2 << 30)
    assert input_hash(tmp_path, [big]) == "not read (2147483648 bytes)"
    as_it_was = input_hash(tmp_path / "out", [big.parent])
    os.truncate(big, 3 << 30)
    assert input_hash(tmp_path / "out", [big.parent]) != as_it_was


def test_a_cell_of_several_lines_stays_in_its_row() -> None:
    assert "| a b |" in markdown_table(ReportTable("T", ["n"], [["a\nb"]]))


def test_markdown_links_pictures_and_escapes_bars(saved: Report) -> None:
    text = saved.files[1].read_text()
    assert "](../dots.png)" in text
    assert "| b\\|\\<i> | - |" in text
    assert "1. Type `scale = 0.997`." in text


HOSTILE = "a</script><img src=x>|[b](javascript:c)\x1b\u202e`<i>\udc80$\\frac$"


def test_text_of_files_forges_no_markup_anywhere(tmp_path: Path) -> None:
    picture = write_png(tmp_path / "a (b).png", np.full((4, 5, 3), 77, np.uint8)) or tmp_path / "a (b).png"
    blocks: list[Block] = [
        Section(HOSTILE),
        Text(HOSTILE, [HOSTILE]),
        ReportTable(HOSTILE, [HOSTILE], [[HOSTILE], ["x\ny"]], [HOSTILE]),
        Picture(HOSTILE, picture, HOSTILE),
        bars(HOSTILE, [HOSTILE], {HOSTILE: [1.0]}, HOSTILE, caption=HOSTILE),
    ]
    saved = save_report(Report(HOSTILE, HOSTILE, [HOSTILE], [HOSTILE], blocks), tmp_path, "report")
    page, text, record = (path.read_text() for path in saved.files)
    assert "<img src=x" not in page
    assert "&lt;/script&gt;" in page
    figure = json.loads(page.split('data-plot="plot1">')[1].split("</script>")[0])
    assert figure["data"][0]["name"].startswith("a&lt;/script&gt;&lt;img")
    assert "<" not in json.dumps(figure)
    assert not set("\x1b\u202e\udc80") & set(page + text)
    assert not re.search(r"(?<!\\)<|(?<![\\!])\[", text)
    assert "(a%20%28b%29.png)" in text
    assert json.loads(record)["title"] == HOSTILE


def test_words_of_a_figure_are_no_formula(tmp_path: Path) -> None:
    figure = Figure()
    axes = figure.subplots()
    axes.set(title=HOSTILE, xlabel=HOSTILE, yscale="log")
    axes.plot([1, 2], [1, 1000], label=HOSTILE)
    axes.legend()
    written = write_figure(tmp_path / "figure.svg", figure).read_bytes()
    assert len(written) > 1000
    assert axes.yaxis.get_ticklabels()[1].get_parse_math()


def test_long_tables_are_folded(tmp_path: Path) -> None:
    tables = [ReportTable(f"Table of {count}", ["n"], [[n] for n in range(count)]) for count in (20, 21)]
    page = save_report(Report("T", blocks=tables), tmp_path, "report").files[0].read_text()
    assert page.count("<details>") == page.count("</details>") == 1
    assert page.index("Table of 21") < page.index("<details><summary>21 rows</summary>")


def test_a_page_without_plots_carries_no_script(tmp_path: Path) -> None:
    page = save_report(Report("T", blocks=[TABLE]), tmp_path, "report").files[0]
    assert "<script" not in page.read_text()


def test_cells_have_three_digits() -> None:
    text = markdown_table(TABLE)
    assert "| a | 0.243 |" in text
    assert "| c | 3.0e-06 |" in text


class Verdict(enum.Enum):
    GOOD = "good"


@dataclasses.dataclass(frozen=True)
class Inner:
    path: Path
    verdict: Verdict
    hidden: object = dataclasses.field(default=object(), metadata={"json": False})


def test_records_become_json_by_their_fields() -> None:
    record = to_jsonable([Inner(Path("a/b"), Verdict.GOOD), (np.inf, np.bool_(True), np.int8(3)), {1: None}])
    assert record == [{"path": "a/b", "verdict": "good"}, [None, True, 3], {"1": None}]
    with pytest.raises(TypeError, match="object"):
        to_jsonable(object())


def test_numbers_of_a_list_share_a_line(tmp_path: Path) -> None:
    value = {"x": [1.0, 2.5], "y": [], "z": [{"a": ["[ b\n  c", "]"]}], "w": [[1, 2], [3, 4]]}
    text = write_json(tmp_path / "a.json", value).read_text()
    assert json.loads(text) == value
    assert '"x": [1.0,2.5],' in text


@pytest.mark.parametrize(
    ("value", "error", "digits", "text"),
    [
        (0.12152, 0.000803, 1, "0.1215 +- 0.0008"),
        (11.7, 2.0, 1, "12 +- 2"),
        (9.04, 0.97, 1, "9 +- 1"),
        (-0.304421, 0.000604, 2, "-0.30442 +- 0.00060"),
        (123.0, 45.0, 2, "123 +- 45"),
        (0.108, float("nan"), 1, "0.108"),
        (1290.0, 0.0, 2, "1290"),
    ],
)
def test_a_value_is_rounded_by_its_error(value: float, error: float, digits: int, text: str) -> None:
    assert str(Estimate(value, error, digits=digits)) == text
    assert str(Estimate(value, error, "mm", digits)) == f"{text} mm"


def test_a_number_with_a_format_of_its_own_is_whole_in_the_json_file(tmp_path: Path) -> None:
    table = ReportTable("T", ["x (mm)"], [[Number(0.12345, "+.3f")], [Number(np.nan, "+.3f")]])
    table = pickle.loads(pickle.dumps(table))
    saved = save_report(Report("T", blocks=[table]), tmp_path)
    assert [row["x (mm)"] for row in json.loads(saved.files[2].read_text())["tables"][0]["rows"]] == [0.12345, None]
    assert "| +0.123 |\n| - |" in saved.files[1].read_text()


def test_a_value_with_its_error_is_a_number_in_the_json_file(tmp_path: Path) -> None:
    table = ReportTable("T", ["pose", "size"], [["a", Estimate(9.123, 0.3, "mm", 2)], ["b", Estimate(np.nan, 0.3)]])
    saved = save_report(Report("T", blocks=[Section("First"), table]), tmp_path)
    (written,) = json.loads(saved.files[2].read_text())["tables"]
    assert written["section"] == "First"
    assert [row["size"] for row in written["rows"]] == [
        {"value": 9.123, "error": 0.3, "unit": "mm"},
        {"value": None, "error": 0.3, "unit": ""},
    ]
    assert "| a | 9.12 +- 0.30 mm |" in saved.files[1].read_text()


def test_a_table_of_records_has_a_row_each(saved: Report) -> None:
    made = table("Files", saved.files, {"name": "name", "stem is": lambda path: path.stem.upper()}, ["A note."])
    assert made == ReportTable(
        "Files", ("name", "stem is"), [[path.name, "REPORT"] for path in saved.files], ["A note."]
    )


@needs_browser
def test_the_page_opens_in_a_browser_with_every_figure(saved: Report, tmp_path: Path) -> None:
    page = open_page(saved.files[0], tmp_path)
    assert page.console == []
    assert page.plots == 1
    assert 'data-plots="1"' in page.dom
    assert re.search(r'class="xtitle"[^>]*>time \(s\)<', page.dom)


@needs_browser
def test_the_browser_reports_a_broken_page(tmp_path: Path) -> None:
    path = tmp_path / "broken.html"
    path.write_text("<!doctype html><body><script>nothingOfThatName()</script></body>")
    assert any("nothingOfThatName" in line for line in open_page(path, tmp_path).console)


def test_columns_of_one_name_are_all_in_the_json_file(tmp_path: Path) -> None:
    table = ReportTable("twice", ("a", "interval", "interval (2)", "interval"), [[1, "2 to 3", 4, "5 to 6"]])
    saved = save_report(Report("Twice", blocks=[table]), tmp_path)
    (rows,) = json.loads(saved.files[2].read_text())["tables"]
    assert rows["rows"] == [{"a": 1, "interval": "2 to 3", "interval (2)": 4, "interval (3)": "5 to 6"}]


@pytest.mark.parametrize(
    ("arguments", "command"),
    [
        (["/opt/bin/wlr-render", "plan", "a/b.toml"], "wlr-render plan a/b.toml"),
        (["/x/ipykernel_launcher.py", "-f", "/home/me/kernel-1.json"], "Python, without a command line"),
        (["-c"], "Python, without a command line"),
        ([""], "Python, without a command line"),
    ],
)
def test_a_report_states_the_command_line_where_there_is_one(
    arguments: Sequence[str], command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.argv", arguments)
    saved = save_report(Report("Any"), tmp_path)
    assert json.loads(saved.files[2].read_text())["provenance"]["command"] == command

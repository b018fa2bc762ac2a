"""A report against an earlier one of the same verb: which figures are compared, and how."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from wlr_render.errors import BadInputError
from wlr_render.report.blocks import Block, Cell, Estimate, Report, ReportTable, Section
from wlr_render.report.comparison import read_report
from wlr_render.report.save import save_report

COLUMNS = ("eye", "source", "rms (arcmin)", "size", "model")


def report(
    *rows: Sequence[Cell],
    title: str = "Errors at 1 m",
    options: Mapping[str, object] | None = None,
    more: Sequence[Block] = (),
    inputs: Sequence[Path] = (),
    columns: Sequence[str] = COLUMNS,
    sentence: str = "Good.",
) -> Report:
    blocks = [Section("Both eyes"), ReportTable(title, columns, rows), *more]
    return Report("T", sentence, blocks=blocks, verb="budget", options=options or {}, inputs=inputs)


BEFORE = report(
    ["left", "noise", 0.2, Estimate(10.0, 0.3, "um"), "planar"],
    ["left", "bias", 1, None, "planar"],
    ["right", "noise", 0.5, Estimate(1.0, 0.1), "planar"],
    options={"--depth-m": 1.0, "--eye": "both"},
)


def compared(before: Report, now: Report, folder: Path, name: str = "report") -> tuple[dict[str, Any], str]:
    """The comparison in the JSON file, and the lines of the Markdown file; the earlier report is in `name`.json."""
    save_report(before, folder, name)
    saved = save_report(now, folder, before=(folder, read_report(folder, "budget")))
    found = json.loads(saved.files[2].read_text())["comparison"]["tables"]
    return {table["title"]: table for table in found}, saved.files[1].read_text()


def test_figures_are_matched_by_table_row_and_column(tmp_path: Path) -> None:
    now = report(
        ["right", "noise", 0.5, Estimate(1.0, 0.1), "planar"],
        ["left", "noise", 0.1, Estimate(11.0, 0.4, "um"), "volumetric"],
        ["left", "bias", 1, 2.0, "planar"],
        options={"--depth-m": 1.0, "--eye": "both"},
    )
    tables, text = compared(BEFORE, now, tmp_path)
    rms, size, model, filled = tables["Errors at 1 m"]["rows"]
    assert rms == {
        "eye": "left",
        "source": "noise",
        "figure": "rms (arcmin)",
        "before": 0.2,
        "now": 0.1,
        "difference": pytest.approx(-0.1),
        "now / before": pytest.approx(0.5),
        "sigmas": None,
    }
    assert (size["figure"], size["now / before"], size["sigmas"]) == ("size", pytest.approx(1.1), pytest.approx(2.0))
    assert size["before"] == {"value": 10.0, "error": 0.3, "unit": "um"}
    assert (model["before"], model["now"], model["difference"]) == ("planar", "volumetric", None)
    assert (filled["source"], filled["before"], filled["now"], filled["now / before"]) == ("bias", None, 2.0, None)
    assert "| left | noise | size | 10.0 +- 0.3 um | 11.0 +- 0.4 um | 1 | 1.1 | 2 |" in text
    assert "Of 9 figures that both reports have, 4 differ by more than a millionth" in text
    assert "independent measurements" in text


def test_a_table_with_another_option_in_its_title_is_the_same_table(tmp_path: Path) -> None:
    now = report(["left", "noise", 0.4, None, "planar"], title="Errors at 2 m", options={"--depth-m": 2.0})
    tables, text = compared(BEFORE, now, tmp_path)
    (first, *_) = tables["Errors at 2 m (before: Errors at 1 m)"]["rows"]
    assert (first["before"], first["now"]) == (0.2, 0.4)
    options = tables["Options and inputs that differ"]["rows"][1:]
    assert [list(row.values()) for row in options] == [["--depth-m", "1.0", "2.0"], ["--eye", "both", "None"]]
    assert "Only in the earlier report: Errors at 1 m: left, bias; Errors at 1 m: right, noise." in text


def test_rows_columns_and_tables_of_one_report_are_named(tmp_path: Path) -> None:
    other = [ReportTable("Others", ["n", "m"], [[k, k] for k in range(3)])]
    now = report(["left", "noise", 0.2, "z"], columns=("eye", "source", "rms (arcmin)", "kind"), more=other)
    _, text = compared(BEFORE, now, tmp_path)
    assert "Only in the report of this run: table 'Others'; Errors at 1 m: column 'kind'." in text
    assert "Errors at 1 m: column 'size'; Errors at 1 m: column 'model'; Errors at 1 m: left, bias" in text
    many = report(*([f"eye {k}", "noise", 1.0, None, "planar"] for k in range(12)))
    _, text = compared(BEFORE, many, tmp_path / "many")
    assert "Errors at 1 m: eye 9, noise; and 2 more." in text


def test_rows_of_one_label_are_matched_in_their_order(tmp_path: Path) -> None:
    before, now = (report(*(("left", "noise", 0.2, k * factor, "planar") for k in (1, 2))) for factor in (1, 3))
    tables, _ = compared(before, now, tmp_path)
    assert [(row["before"], row["now"]) for row in tables["Errors at 1 m"]["rows"]] == [(1, 3), (2, 6)]


def test_figures_that_differ_by_rounding_are_the_same(tmp_path: Path) -> None:
    before, now = (report(["left", "noise", value, Estimate(value, 0.1), "m"]) for value in (0.2, 0.2 * (1 + 1e-12)))
    tables, text = compared(before, now, tmp_path)
    assert list(tables) == ["Options and inputs that differ"]
    assert "Of 4 figures that both reports have, 0 differ" in text


def test_rounding_about_zero_is_no_difference(tmp_path: Path) -> None:
    before, now = (
        report(["left", "noise", small, None, "m"], ["right", "noise", 1.0, None, "m"]) for small in (1e-17, -3e-17)
    )
    _, text = compared(before, now, tmp_path)
    assert "Of 8 figures that both reports have, 0 differ" in text


def test_a_figure_in_another_unit_differs_by_no_number(tmp_path: Path) -> None:
    before, now = (report(["left", "noise", 0.2, Estimate(1.0, 0.1, unit), "m"]) for unit in ("mm", "um"))
    tables, _ = compared(before, now, tmp_path)
    (size,) = tables["Errors at 1 m"]["rows"]
    assert (size["difference"], size["now / before"]) == (None, None)
    assert "sigmas" not in size


def test_a_column_of_labels_may_be_called_as_one_of_the_comparison(tmp_path: Path) -> None:
    before, now = (report(["left", value], columns=("figure", "now"), title="x" * 3000) for value in (1.0, 2.0))
    tables, _ = compared(before, now, tmp_path)
    (row,) = tables["x" * 3000]["rows"]
    assert (row["figure (row)"], row["figure"], row["before"], row["now"]) == ("left", "now", 1.0, 2.0)


def test_tables_of_one_title_are_told_by_their_sections(tmp_path: Path) -> None:
    def of_both(size: float) -> Report:
        tables = [
            (Section(f"The {eye} eye"), ReportTable("Fit", ["n", "m"], [["a", size]])) for eye in ("left", "right")
        ]
        return Report("T", blocks=[block for pair in tables for block in pair], verb="budget")

    tables, _ = compared(of_both(1.0), of_both(2.0), tmp_path)
    assert {"The left eye: Fit", "The right eye: Fit"} < set(tables)


def test_inputs_are_compared_by_content(tmp_path: Path) -> None:
    paths = [tmp_path / name for name in ("a.toml", "b.toml")]
    for path, content in zip(paths, "12", strict=True):
        path.write_text(content)
    before, now = (report(["left", "noise", 1.0, None, "m"], inputs=[path]) for path in paths)
    tables, _ = compared(before, now, tmp_path / "out")
    _, (name, *values) = (list(row.values()) for row in tables["Options and inputs that differ"]["rows"])
    assert name == "input 1"
    assert [value.partition(" (SHA-256 ")[0] for value in values] == [str(path) for path in paths]


def test_the_earlier_report_may_be_named_by_any_of_its_files(tmp_path: Path) -> None:
    files = save_report(BEFORE, tmp_path, "budget").files
    assert all(read_report(path, "budget") == read_report(tmp_path, "budget") for path in files)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"version": 2}, "has version 2; this program reads version 1: run budget again to write it"),
        (
            {"format": "x"},
            "'format' is not 'wlr-report', as in a report of this version; name a report of budget",
        ),
        ({"provenance": {"verb": "trace"}}, "is a report of trace; name a report of budget"),
        ({"provenance": {"verb": "budget"}}, "key 'inputs' is missing"),
        ({"tables": [{"section": "", "title": "t", "rows": [{"a": 1}, {"b": 1}]}]}, "has other columns than the first"),
        (
            {"tables": [{"section": "", "title": "t", "rows": [{"a": [1]}]}]},
            "'a' is .1.; it must be a finite number",
        ),
    ],
)
def test_what_is_no_report_of_the_verb_is_refused(tmp_path: Path, change: dict[str, Any], sentence: str) -> None:
    path = save_report(BEFORE, tmp_path).files[2]
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(BadInputError, match=f"report.json.*: {sentence}"):
        read_report(tmp_path, "budget")


def test_a_folder_without_one_report_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="holds no report; name a report of budget"):
        read_report(tmp_path, "budget")
    for stem in ("diagnosis", "signature"):
        save_report(BEFORE, tmp_path, stem)
    with pytest.raises(BadInputError, match=r"holds several reports \(diagnosis.json, signature.json\); name a report"):
        read_report(tmp_path, "budget")

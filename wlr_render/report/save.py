"""Writing of a report: an HTML page, a Markdown file and a JSON file with one stem."""

import dataclasses
import os
import urllib.parse
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

from wlr_render.io.atomic_files import write_text
from wlr_render.io.escapes import markdown_text
from wlr_render.io.toml_files import Table, write_json
from wlr_render.report.blocks import Block, Picture, Plot, Report, ReportTable, Section, Text
from wlr_render.report.comparison import FORMAT, VERSION, RecordedReport, comparison
from wlr_render.report.html import html_page
from wlr_render.report.provenance import Provenance, provenance
from wlr_render.report.records import fields_of, to_jsonable


def save_report(
    report: Report, folder: Path, stem: str = "", before: tuple[Path, RecordedReport] | None = None
) -> Report:
    """Write FOLDER/STEM.html, .md and .json, by default with the report's stem; return the report with these files.

    The JSON file has the fields of `report.record` in addition to the fields of every report. With `before`, path and
    content of an earlier report, all files end with a comparison of both reports.

    Raises:
        BadInputError: a file cannot be written.
    """
    stem = stem or report.stem
    origin = provenance(report, folder)
    record = _record(report, origin)
    if before is not None:
        path, earlier = before
        added = comparison(earlier, RecordedReport.of(Table(cast(Any, to_jsonable(record)), "this report")), path)
        tables = _table_records(added)
        record["comparison"] = {"file": path, "date": earlier.date, "version": earlier.version, "tables": tables}
        report = dataclasses.replace(report, blocks=[*report.blocks, *added])
    written = [
        write_text(folder / f"{stem}.html", html_page(report, origin)),
        write_text(folder / f"{stem}.md", markdown(report, folder)),
        write_json(folder / f"{stem}.json", to_jsonable(record)),
    ]
    return dataclasses.replace(report, files=(*report.files, *written))


def _record(report: Report, origin: Provenance) -> dict[str, object]:
    """Return the content of the JSON file."""
    record = {
        "format": FORMAT,
        "version": VERSION,
        "provenance": origin,
        "title": report.title,
        "sentence": report.verdict,
        "advice": report.advice,
        "warnings": report.warnings,
        "tables": _table_records(report.blocks),
        "plots": [{"title": plot.title, "data": plot.data} for plot in report.blocks if isinstance(plot, Plot)],
    }
    of_job = fields_of(report.record) if dataclasses.is_dataclass(report.record) else dict(report.record)
    assert not record.keys() & of_job.keys(), "a job's record must not replace fields of every report"
    return record | of_job


def _table_records(blocks: Sequence[Block]) -> list[dict[str, object]]:
    """Return section, title, rows as objects with full-precision numbers, and notes of each table among the blocks."""
    section, records = "", list[dict[str, object]]()
    for block in blocks:
        if isinstance(block, Section):
            section = block.title
        elif isinstance(block, ReportTable):
            keys = _unique(block.columns)
            rows = [dict(zip(keys, row, strict=True)) for row in block.rows]
            records.append({"section": section, "title": block.title, "rows": rows, "notes": block.notes})
    return records


def _unique(columns: Sequence[str]) -> list[str]:
    """Return names of columns as keys of an object; a repeated name gets a number, e.g. "interval (2)"."""
    keys: list[str] = []
    for column in columns:
        key, number = column, 1
        while key in keys:
            number += 1
            key = f"{column} ({number})"
        keys.append(key)
    return keys


def markdown(report: Report, folder: Path) -> str:
    """Return the report as Markdown, with links relative to `folder`."""
    parts = [f"# {markdown_text(report.title)}\n"]
    parts += [f"{markdown_text(sentence)}\n" for sentence in (report.verdict, *report.warnings) if sentence]
    parts += (
        ["".join(f"{number}. {markdown_text(step)}\n" for number, step in enumerate(report.advice, 1))]
        if report.advice
        else []
    )
    parts += [_markdown_block(block, folder) for block in report.blocks]
    return "\n".join(parts)


def _markdown_block(block: Block, folder: Path) -> str:
    match block:
        case Section():
            return f"## {markdown_text(block.title)}\n"
        case Text():
            return "\n".join([markdown_text(block.text), *(f"- {markdown_text(item)}" for item in block.items)]) + "\n"
        case ReportTable():
            return markdown_table(block)
        case Picture():
            target = urllib.parse.quote(os.path.relpath(block.path, folder), errors="replace")
            return f"![{markdown_text(block.caption or block.title)}]({target})\n"
        case Plot():
            title, caption = markdown_text(block.title), markdown_text(block.caption)
            return f"*{title}*: an interactive plot in the HTML page. {caption}\n"


def markdown_table(table: ReportTable) -> str:
    """Return a Markdown table with its title and notes."""
    lines = [f"### {markdown_text(table.title)}", "", _line(table.columns), _line(["---"] * len(table.columns))]
    lines += [_line(row) for row in table.text_rows()]
    lines += ["", *map(markdown_text, table.notes)] if table.notes else []
    return "\n".join(lines) + "\n"


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(markdown_text(cell).replace("|", "\\|") for cell in cells) + " |"

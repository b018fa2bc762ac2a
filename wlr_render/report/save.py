"""Writing of a report: an HTML page, a Markdown file and a JSON file with one stem, and their provenance."""

import dataclasses
import datetime
import hashlib
import os
import shlex
import sys
import urllib.parse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from wlr_render import __version__
from wlr_render.io.atomic_files import write_text
from wlr_render.io.escapes import markdown_text
from wlr_render.report.blocks import Block, Picture, Plot, Report, ReportTable, Section, Text
from wlr_render.report.html import html_page
from wlr_render.report.records import fields_of, json_text


@dataclass(frozen=True)
class InputFile:
    """An input of a result: its name and the SHA-256 of its content.

    The hash of a folder covers the sorted list of its files' relative names and hashes, except files of an output
    folder inside it. An input that can no longer be read has the reason in place of its hash.
    """

    name: str
    sha256: str


@dataclass(frozen=True)
class Provenance:
    """Date, version, command line and inputs of a result."""

    date: str
    version: str
    command: str
    inputs: tuple[InputFile, ...]


def save_report(report: Report, folder: Path, stem: str = "") -> Report:
    """Write FOLDER/STEM.html, .md and .json, by default with the report's own stem, and return it with these files.

    The JSON file has the fields of `report.record` in addition to the fields of every report.

    Raises:
        BadInputError: a file cannot be written.
    """
    stem = stem or report.stem
    origin = provenance(report.inputs, folder)
    record = {
        "provenance": origin,
        "title": report.title,
        "sentence": report.verdict,
        "advice": report.advice,
        "warnings": report.warnings,
        "tables": [table_record(table) for table in report.tables],
        "plots": [{"title": plot.title, "data": plot.data} for plot in report.blocks if isinstance(plot, Plot)],
    }
    of_job = fields_of(report.record) if dataclasses.is_dataclass(report.record) else dict(report.record)
    assert not record.keys() & of_job.keys(), "a job's record must not replace fields of every report"
    written = [
        write_text(folder / f"{stem}.html", html_page(report, origin)),
        write_text(folder / f"{stem}.md", markdown(report, folder)),
        write_text(folder / f"{stem}.json", json_text(record | of_job)),
    ]
    return dataclasses.replace(report, files=(*report.files, *written))


def provenance(inputs: Sequence[Path], output: Path) -> Provenance:
    """Return date, version, command line and input hashes of the running program, which writes to folder `output`."""
    now = datetime.datetime.now().astimezone().isoformat(timespec="seconds")
    hashes = (_sha256(path, output) for path in inputs)
    return Provenance(now, __version__, _command(), tuple(map(InputFile, map(str, inputs), hashes)))


def _command() -> str:
    """Return the command line, or words for a notebook or a prompt, whose command line does not describe the job."""
    started, arguments = Path(sys.argv[0]), sys.argv[1:]
    if started.stem == "ipykernel_launcher" or started.name in ("", "-c"):
        return "Python, without a command line"
    program = ["python", "-m", started.parent.name] if started.name == "__main__.py" else [started.name]
    return shlex.join([*program, *arguments])


def _sha256(path: Path, output: Path) -> str:
    try:
        if not path.is_dir():
            return _file_sha256(path)
        files = [item for item in path.rglob("*") if item.is_file()]
        if path.resolve() in output.resolve().parents:
            files = [item for item in files if not item.resolve().is_relative_to(output.resolve())]
        total = hashlib.sha256()
        for file in sorted(files):
            total.update(f"{file.relative_to(path).as_posix()} {_file_sha256(file)}\n".encode())
        return total.hexdigest()
    except OSError as error:
        # An input that was removed during the job must not prevent its report.
        return f"not readable ({error.strerror})"


def _file_sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def table_record(table: ReportTable) -> dict[str, object]:
    """Return the title, rows as objects with full-precision numbers, and notes of a table."""
    keys = _unique(table.columns)
    rows = [dict(zip(keys, row, strict=True)) for row in table.rows]
    return {"title": table.title, "rows": rows, "notes": table.notes}


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
            picture = f"![{markdown_text(block.caption or block.title)}]({target})"
            return f"[{picture}]({urllib.parse.quote(block.link)})\n" if block.link else f"{picture}\n"
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

"""What a calibration from photographs says of itself: tables, pictures, and one page that holds both."""

import html
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from wlr_render.files import output_folder, write_text
from wlr_render.jobs.calibrate import pictures
from wlr_render.jobs.calibrate.photos import SessionCalibration
from wlr_render.jobs.calibrate.tables import headline, session_tables
from wlr_render.report.blocks import ReportTable, tables_as_json


@dataclass(frozen=True)
class Told:
    """Tables in the order of telling, and the files written."""

    tables: tuple[ReportTable, ...]
    files: tuple[Path, ...]


def write(found: SessionCalibration, out: str | Path) -> Told:
    """Write report.html, calibration.md, calibration.json and the pictures."""
    into = output_folder(out)
    tables = session_tables(found)
    drawn = [
        (pictures.draw_coverage(into / "coverage.png", found), "Where the cameras stood, and what they saw"),
        (pictures.draw_fates(into / "decoding.png", found), "What became of the camera's pixels, set by set"),
        (pictures.draw_display_residuals(into / "display_residuals.png", found), "What the display model leaves"),
        (pictures.draw_see_through_residuals(into / "see_through_residuals.png", found), "What see-through leaves"),
        (pictures.draw_degrees(into / "degrees.png", found), "Why these degrees"),
    ]
    context = {"device": found.session.device, "eye": found.session.eye}
    files = [
        write_text(into / "report.html", _page(found, tables, drawn)),
        write_text(into / "calibration.md", "\n".join(table.markdown() for table in tables)),
        write_text(into / "calibration.json", tables_as_json(tables, **context)),
        *(into / name for name in ("model.json", "captures.npz", "station.json")),
    ]
    return Told(tables, tuple(files))


def _page(found: SessionCalibration, tables: Sequence[ReportTable], drawn: Sequence[tuple[Path, str]]) -> str:
    body = [f"<h1>{html.escape(found.fit.mappings.name)}</h1>", f"<p>{html.escape(headline(found))}</p>"]
    body += [
        f'<figure><img src="{path.name}" alt=""><figcaption>{html.escape(title)}</figcaption></figure>'
        for path, title in drawn
    ]
    body += [_table(table) for table in tables]
    return _HTML.format(title=html.escape(found.session.device), body="\n".join(body))


def _table(table: ReportTable) -> str:
    head = "".join(f"<th>{html.escape(column)}</th>" for column in table.columns)
    rows = "\n".join(
        "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in table.text_rows()
    )
    notes = "".join(f"<p>{html.escape(note)}</p>" for note in table.notes)
    return f"<h2>{html.escape(table.title)}</h2>\n<table><tr>{head}</tr>\n{rows}</table>{notes}"


_HTML = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>Calibration of {title}</title>
<style>
body {{ font: 15px/1.45 system-ui, sans-serif; margin: 2rem auto; max-width: 75rem; padding: 0 1rem; color: #1b1b1b; }}
img {{ max-width: 100%; }}
figure {{ margin: 1.5rem 0; }}
figcaption {{ color: #555; }}
table {{ border-collapse: collapse; margin: .5rem 0 1rem; }}
th, td {{ border-bottom: 1px solid #ddd; padding: .2rem .6rem; text-align: right; }}
th:first-child, td:first-child {{ text-align: left; }}
</style></head><body>
{body}
</body></html>
"""

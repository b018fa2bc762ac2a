"""Short HTML of an object for notebooks, which call `_repr_html_`: a title, sentences and tables; no scripts, no files.

Names may come from untrusted files: everything is escaped here, so that callers pass plain text.
"""

import html
from collections.abc import Sequence
from typing import NamedTuple

from wlr_render.io.escapes import printable_lines

MOST_ROWS = 20
"""Rows of a table that a summary shows."""


class SummaryTable(NamedTuple):
    """Rows of text under named columns, units included.

    Attributes:
        columns: heads; empty if each row is a name and its value.
        rows: one text per column.
        title: one line, or empty.
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    title: str = ""


def html_summary(title: str, sentences: Sequence[str], tables: Sequence[SummaryTable]) -> str:
    """Return an HTML fragment of plain text, all of it escaped."""
    return "\n".join(
        [
            "<div>",
            f"<p><b>{_escaped(title)}</b></p>",
            *(f"<p>{_escaped(sentence)}</p>" for sentence in sentences),
            *(_table(table) for table in tables),
            "</div>",
        ]
    )


def _table(table: SummaryTable) -> str:
    heads = _row("th", table.columns) if table.columns else ""
    caption = f"<p>{_escaped(table.title)}</p>" if table.title else ""
    rows = "\n".join(_row("td", row) for row in table.rows[:MOST_ROWS])
    more = len(table.rows) - MOST_ROWS
    return f"{caption}<table>{heads}\n{rows}</table>" + (f"<p>{more} more rows are not shown.</p>" if more > 0 else "")


def _row(tag: str, cells: Sequence[str]) -> str:
    # Jupyter's style aligns cells to the right.
    drawn = "".join(f'<{tag} style="text-align: left">{_escaped(cell)}</{tag}>' for cell in cells)
    return f"<tr>{drawn}</tr>"


def _escaped(text: str) -> str:
    return html.escape(printable_lines(text))

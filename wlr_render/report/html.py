"""A report as one HTML page that works as a local file, without a network."""

import base64
import functools
import gzip
import importlib.resources
import json
from typing import TYPE_CHECKING

from wlr_render.io.escapes import html_code, html_text, plotly_text
from wlr_render.report.blocks import Picture, Plot, Report, ReportTable, Section, Text
from wlr_render.report.provenance import Provenance
from wlr_render.report.records import to_jsonable

if TYPE_CHECKING:
    import jinja2


def html_page(report: Report, provenance: Provenance) -> str:
    """Return the page as text, with its pictures and, if it has plots, Plotly embedded.

    Raises:
        OSError: a picture cannot be read.
    """
    has_plots = any(isinstance(block, Plot) for block in report.blocks)
    return _template().render(
        report=report,
        sections=[block.title for block in report.blocks if isinstance(block, Section)],
        provenance=provenance,
        plotly=_plotly_base64() if has_plots else "",
        kind=_kind,
    )


def _kind(block: object) -> str:
    """Return the name of the template's branch for a block."""
    return {Section: "section", Text: "text", ReportTable: "table", Picture: "picture", Plot: "plot"}[type(block)]


@functools.cache
def _template() -> "jinja2.Template":
    import jinja2
    import markupsafe

    environment = jinja2.Environment(
        autoescape=True, finalize=html_text, undefined=jinja2.StrictUndefined, trim_blocks=True
    )
    environment.filters["code"] = lambda text: markupsafe.Markup(html_code(text))
    environment.filters["png"] = lambda path: base64.b64encode(path.read_bytes()).decode("ascii")
    environment.filters["figure"] = _figure_json
    return environment.from_string(importlib.resources.files(__package__).joinpath("page.html.j2").read_text("utf-8"))


def _figure_json(plot: Plot) -> str:
    """Return Plotly's figure as JSON that is safe inside a script element."""
    text = json.dumps(plotly_text(to_jsonable({"data": plot.data, "layout": plot.layout})), allow_nan=False)
    return text.replace("<", "\\u003c")


@functools.cache
def _plotly_base64() -> str:
    """Return plotly.min.js as gzip in base64; browsers decompress it, so that a page has 2 MB instead of 5 MB."""
    script = importlib.resources.files("plotly").joinpath("package_data/plotly.min.js").read_bytes()
    return base64.b64encode(gzip.compress(script, mtime=0)).decode("ascii")

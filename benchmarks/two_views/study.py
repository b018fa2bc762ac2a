"""What captures of a display from two viewpoints say about display models: from a folder to tables."""

from collections.abc import Sequence
from pathlib import Path

from benchmarks.published_data.northstar_vcam import read_northstar_vcam
from benchmarks.two_views.evidence import viewpoint_evidence
from benchmarks.two_views.tables import tables
from wlr_render.files import output_folder, write_text
from wlr_render.report.blocks import ReportTable, tables_as_json


def run(folder: Path, out: Path) -> Sequence[ReportTable]:
    """Judge the captures of both eyes; writes two-views.md and two-views.json.

    Args:
        folder: with captures of the kind that `read_northstar_vcam` reads.
        out: for the tables.

    Raises:
        BadInputError: faulty captures, or an output folder that cannot be written.
    """
    captures = read_northstar_vcam(folder)
    out = output_folder(out)
    found = tables(viewpoint_evidence([captures.left, captures.right]))
    write_text(out / "two-views.md", "\n".join(table.markdown() for table in found))
    write_text(out / "two-views.json", tables_as_json(found, captures=folder.name))
    return found

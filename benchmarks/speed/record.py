"""Record tables in a file named after the machine's renderer."""

import re
from collections.abc import Sequence
from pathlib import Path

from wlr_render.errors import BadInputError
from wlr_render.io.atomic_files import write_text
from wlr_render.report.blocks import Report, ReportTable
from wlr_render.report.save import markdown


def record(tables: Sequence[ReportTable], folder: str | Path, renderer: str) -> Path:
    """Write the tables as `folder`/RENDERER.md, replacing the file of an earlier run on the same renderer.

    Args:
        tables: the tables, in the order of the file.
        folder: created if it does not exist.
        renderer: OpenGL's name of the renderer, `GlContext.renderer`; the file's name has only its letters and digits.

    Raises:
        BadInputError: the name has neither letters nor digits, or the folder cannot be written.
    """
    slug = re.sub(r"[^a-z0-9]+", "-", renderer.lower()).strip("-")
    if not slug:
        raise BadInputError(f"the renderer's name '{renderer}' gives no file name; name the device in letters.")
    return write_text(
        Path(folder) / f"{slug}.md", markdown(Report(f"Measured on {renderer}", blocks=tables), Path(folder))
    )

"""Draw a device and state its figures."""

from dataclasses import dataclass
from pathlib import Path

from wlr_render.evaluation.device_figures import figures_table
from wlr_render.evaluation.lateral_colour import lateral_colour_table
from wlr_render.evaluation.report import ReportTable, tables_as_json
from wlr_render.files import output_folder, write_text
from wlr_render.optics.device_file import load_device
from wlr_render.optics.drawing import draw_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.studies.headset import open_channels

FRAUNHOFER_F_D_C_UM = (0.4861, 0.5876, 0.6563)
"""Wavelengths of blue, yellow and red light: the figures are stated for the middle one, colour between the others."""


@dataclass(frozen=True)
class Traced:
    """The figures, and where the drawing lies."""

    tables: tuple[ReportTable, ...]
    drawing: Path


def run(spec: str, eye: str, out: Path) -> Traced:
    """Trace one eye of a device; writes NAME-EYE.png, .md and .json into `out`.

    Raises:
        BadInputError: a faulty device, an eye that it does not have, or an output folder that cannot be written.
    """
    device = load_device(spec)
    blue, middle, red = (traced_eye(device, eye, line) for line in FRAUNHOFER_F_D_C_UM)
    folder = output_folder(out)
    stem = f"{device.name}-{eye}"
    tables = figures_table(middle, blue, red), lateral_colour_table([open_channels([spec], eye)])
    drawing = folder / f"{stem}.png"
    draw_device(device, eye, drawing)
    write_text(folder / f"{stem}.md", "\n".join(table.markdown() for table in tables))
    write_text(folder / f"{stem}.json", tables_as_json(tables, device=device.name, eye=eye))
    return Traced(tables, drawing)

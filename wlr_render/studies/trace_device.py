"""Draw a device and state its figures."""

from dataclasses import dataclass
from pathlib import Path

from wlr_render.evaluation.report import ReportTable, tables_as_json
from wlr_render.files import output_folder, write_text
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import traced_eye


@dataclass(frozen=True)
class Traced:
    """The figures, and where the drawing lies."""

    table: ReportTable
    drawing: Path


def run(spec: str, eye: str, out: Path) -> Traced:
    """Trace one eye of a device; writes NAME-EYE.png, .md and .json into `out`."""
    from wlr_render.evaluation.device_figures import figures_table
    from wlr_render.optics.drawing import draw_device

    device = load_device(spec)
    folder = output_folder(out)
    stem = f"{device.name}-{eye}"
    blue_mappings, mappings, red_mappings = (traced_eye(device, eye, line) for line in FRAUNHOFER_F_D_C_UM)
    table = figures_table(mappings, blue_mappings, red_mappings)
    drawing = folder / f"{stem}.png"
    draw_device(device, eye, drawing)
    write_text(folder / f"{stem}.md", table.markdown())
    write_text(folder / f"{stem}.json", tables_as_json([table], device=device.name, eye=eye))
    return Traced(table, drawing)


FRAUNHOFER_F_D_C_UM = (0.4861, 0.5876, 0.6563)
"""Wavelengths between which colour is judged."""

"""Draw a device with its rays and tabulate its optical figures."""

from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated

from wlr_render.errors import BadInputError
from wlr_render.evaluation.device_figures import DeviceFigures, device_figures, figures_table
from wlr_render.evaluation.lateral_colour import lateral_colour_table
from wlr_render.files import output_folder
from wlr_render.jobs.headset import open_colours
from wlr_render.jobs.job import job
from wlr_render.jobs.options import Eyes, Options, ProgressArgument, described, eyes_of
from wlr_render.optics.device_file import device_path, load_device
from wlr_render.optics.drawing import draw_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.progress import SILENT
from wlr_render.report.blocks import Block, Picture, Report, Section, cell_text
from wlr_render.report.save import save_report

FRAUNHOFER_F_D_C_UM = (0.4861, 0.5876, 0.6563)
"""Wavelengths of blue, yellow and red light: the figures are stated for the middle one, colour between the others."""

MIN_PANEL_SHARE = 0.5
"""A prescription that shows less of its nominal field than this most likely has a wrong sign."""


@dataclass(frozen=True)
class TraceOptions(Options):
    """Options of `trace`."""

    device: Annotated[str, described("A shipped device or a device file (.toml).")]
    _: KW_ONLY
    eye: Annotated[Eyes, described("Eyes to trace.")] = "right"
    out: Annotated[Path, described("Output folder.")] = Path("out/trace")


@job
def trace(options: TraceOptions, *, progress: ProgressArgument = SILENT) -> Report:
    """Trace a device; writes a drawing of each eye, and the report, into `options.out`.

    Raises:
        BadInputError: a faulty device, an eye that the device does not have, or a folder that cannot be written.
    """
    device = load_device(options.device)
    eyes = eyes_of(options.eye)
    traced = {eye: [traced_eye(device, eye, line) for line in FRAUNHOFER_F_D_C_UM] for eye in eyes}
    figures = {eye: device_figures(middle, blue, red) for eye, (blue, middle, red) in traced.items()}
    for eye, of_eye in figures.items():
        if of_eye.panel_share == 0:
            raise BadInputError(
                f"{options.device}: no direction of the nominal field of the {eye} eye meets the panel; check the "
                "surfaces, the panel and 'field_deg'."
            )
    folder = output_folder(options.out)
    blocks: list[Block] = []
    for eye in progress(eyes, len(eyes), "eyes"):
        _, middle, _ = traced[eye]
        drawing = folder / f"{device.name}-{eye}.png"
        draw_device(device, eye, drawing)
        blocks += [
            Section(f"The {eye} eye"),
            figures_table(middle, figures[eye]),
            lateral_colour_table([open_colours(options.device, eye)]),
            Picture(f"Rays through {device.name}", drawing, "Side view and top view with surfaces, panel and rays."),
        ]
    drawings = tuple(block.path for block in blocks if isinstance(block, Picture))
    report = Report(
        f"Optics of {device.name}",
        " ".join(_summary(device.name, eye, of_eye) for eye, of_eye in figures.items()),
        warnings=[warning for eye, of_eye in figures.items() for warning in _warnings(eye, of_eye)],
        blocks=blocks,
        inputs=[device_path(options.device)],
        files=drawings,
        record=figures,
    )
    return save_report(report, folder)


def _summary(name: str, eye: str, figures: DeviceFigures) -> str:
    angles = figures.field_angles
    return (
        f"{name}, {eye} eye: {cell_text(round(angles.right_deg - angles.left_deg, 0))} x "
        f"{cell_text(round(angles.up_deg - angles.down_deg, 0))} degrees, "
        f"{figures.pixel_arcmin:.2g}' per pixel, virtual image about {figures.image_distance_m[0]:.2g} m away, real "
        f"world deviated by {cell_text(figures.deviation_far.mean)}' on average."
    )


def _warnings(eye: str, figures: DeviceFigures) -> list[str]:
    if figures.panel_share >= MIN_PANEL_SHARE:
        return []
    return [
        f"Only {figures.panel_share:.0%} of the nominal field of the {eye} eye meets the panel: check the sign of each "
        "radius_mm, the apertures, and field_deg in the device file."
    ]

"""Draw a device with its rays and tabulate its optical figures."""

import math
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.evaluation.device_figures import DeviceFigures, device_figures, figures_table
from wlr_render.evaluation.lateral_colour import lateral_colour_table
from wlr_render.io.atomic_files import output_folder
from wlr_render.jobs.headset import open_colours
from wlr_render.jobs.job import job
from wlr_render.jobs.options import Against, EyeName, Eyes, Options, ProgressArgument, described, eyes_of
from wlr_render.optics.device import Device, EyeOptics
from wlr_render.optics.device_file import device_path, load_device
from wlr_render.optics.drawing import draw_device
from wlr_render.optics.first_order import FirstOrder, first_order
from wlr_render.optics.media import FRAUNHOFER_F_D_C_UM
from wlr_render.optics.ray_losses import SurfaceLosses, curvature_changes, display_losses, helpful_changes, on_panel
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.report.blocks import Block, Cell, Columns, Picture, Report, ReportTable, Section, cell_text, table
from wlr_render.work.progress import SILENT

MIN_PANEL_SHARE = 0.5
"""A prescription that shows less of its nominal field than this most likely has a wrong sign."""

_MANY_LOST = 0.2  # smallest share of all rays that a surface loses for the report to name it
_FAR_PER_M = 1e-3  # vergence below which an image, farther than a kilometre, is at infinity
_TOO_NEAR_PER_M = 8.0  # nearest focus of an image, dioptres; few adults focus nearer
_BEHIND_THE_EYE_PER_M = 0.25  # largest focus beyond infinity, dioptres, that eyes and designs tolerate
_ASTIGMATIC = 0.1  # difference of x and y, in dioptres or as a share of the vergence, above which both are stated


@dataclass(frozen=True)
class TraceOptions(Options):
    """Options of `trace`."""

    device: Annotated[str, described("A shipped device or a device file (.toml).")]
    _: KW_ONLY
    eye: Annotated[Eyes, described("Eyes to trace.")] = "right"
    out: Annotated[Path, described("Output folder.")] = Path("out/trace")
    against: Against = None


@job
def trace(options: TraceOptions, *, progress: ProgressArgument = SILENT) -> Report:
    """Trace a device; writes a drawing of each eye, and the report, into `options.out`.

    A device is drawn even if no ray reaches its panel, with the surfaces where the rays are lost.

    Raises:
        BadInputError: a faulty device, an eye that the device does not have, or a folder that cannot be written.
    """
    device = load_device(options.device)
    eyes = eyes_of(options.eye)
    for eye in eyes:
        device.optics(eye)  # fails before anything is written
    folder = output_folder(options.out)
    traced = [_trace_eye(options.device, device, eye, folder) for eye in progress(eyes, len(eyes), "eyes")]
    blocks = [block for each in traced for block in each.blocks]
    return Report(
        f"Optics of {device.name}",
        " ".join(each.verdict for each in traced),
        warnings=[warning for each in traced for warning in each.warnings],
        blocks=blocks,
        inputs=[device_path(options.device)],
        files=[block.path for block in blocks if isinstance(block, Picture)],
        record={eye: record for each in traced for eye, record in each.record.items()},
    )


def _trace_eye(spec: str, device: Device, eye: EyeName, folder: Path) -> Report:
    """Return the part of the report on one eye."""
    optics, middle_um = device.eyes[eye], FRAUNHOFER_F_D_C_UM[1]
    losses = display_losses(optics, middle_um)
    drawing = folder / f"{device.name}-{eye}.png"
    draw_device(device, eye, drawing)
    picture = Picture(f"Rays through {device.name}", drawing, "Side view and top view with surfaces, panel and rays.")
    blocks: list[Block] = [Section(f"The {eye} eye")]
    if _bends_nothing_yet(optics, losses):
        verdict = (
            f"{device.name}, {eye} eye: nothing bends the rays yet, for display_path is empty, and the panel does not "
            "stand straight ahead: see the drawing."
        )
        record: dict[str, Any] = {"figures": None, "losses": list(losses), "imaging": None}
        return Report("", verdict, blocks=[*blocks, picture], record={eye: record})
    imaging = first_order(optics, middle_um)
    warnings = loss_warnings(optics, eye, losses) + imaging_warnings(optics, eye, imaging)
    warnings += orientation_warnings(eye, imaging)
    figures: DeviceFigures | None = None
    try:
        figures, tables = _figures(spec, device, eye)
    except BadInputError as error:
        warnings.append(str(error))
        verdict = (
            f"{device.name}, {eye} eye: {losses[-1].passed} of {losses[0].reached} rays reach the panel, too few for "
            "other figures."
        )
    else:
        blocks += tables
        verdict = _summary(device.name, eye, figures, imaging)
    if imaging is not None:
        blocks.append(_imaging_table(imaging))
    blocks += [_losses_table(optics, losses), picture]
    record = {"figures": figures, "losses": list(losses), "imaging": imaging}
    return Report("", verdict, warnings=warnings, blocks=blocks, record={eye: record})


def _figures(spec: str, device: Device, eye: EyeName) -> tuple[DeviceFigures, list[Block]]:
    """Return the figures of one eye, and their tables.

    Raises:
        BadInputError: no direction of the nominal field reaches the panel, or the mappings cannot be computed.
    """
    blue, middle, red = (traced_eye(device, eye, line) for line in FRAUNHOFER_F_D_C_UM)
    figures = device_figures(middle, blue, red)
    if figures.panel_share == 0:
        raise BadInputError(
            f"{spec}: no direction of the nominal field of the {eye} eye meets the panel; check the surfaces, the "
            "panel and 'field_deg'."
        )
    return figures, [figures_table(middle, figures), lateral_colour_table(open_colours(spec, eye))]


def _bends_nothing_yet(optics: EyeOptics, losses: tuple[SurfaceLosses, ...]) -> bool:
    """Return whether a device has no display path yet: no surface, and a panel that is not viewed directly."""
    if optics.display.steps:
        return False
    ahead = optics.panel.pixel_of_ray(optics.eye_box.centre, np.array([0.0, 0.0, -1.0]))
    covers_field = optics.field is not None and losses[-1].passed >= MIN_PANEL_SHARE * losses[0].reached
    return not (on_panel(optics, ahead) or covers_field)


def _summary(name: str, eye: str, figures: DeviceFigures, imaging: FirstOrder | None) -> str:
    angles = figures.field_angles
    width, height = angles.right_deg - angles.left_deg, angles.up_deg - angles.down_deg
    if math.isfinite(width) and math.isfinite(height):
        field = f"{cell_text(round(width, 0))} x {cell_text(round(height, 0))} degrees"
    else:
        field = "panel not seen straight ahead"
    image = "" if imaging is None else f"virtual image {image_place(imaging)}, picture {_appearance(imaging)[0]}, "
    return (
        f"{name}, {eye} eye: {field}, {figures.pixel_arcmin:.2g}' per pixel, {image}real world deviated by "
        f"{cell_text(figures.deviation_far.mean)}' on average."
    )


def image_place(imaging: FirstOrder) -> str:
    """Return the place of the virtual image mid-field as words to follow "virtual image" or "would lie"."""
    x, y = imaging.vergence_per_m
    middle = 0.5 * (x + y)
    if abs(x - y) <= _ASTIGMATIC * max(1.0, abs(middle)):
        return _place_of(middle)
    return f"{_place_of(x)} along x and {_place_of(y)} along y"


def _place_of(vergence: float) -> str:
    dioptres = f"({vergence:.2g} dioptres)"
    if abs(vergence) <= _FAR_PER_M:
        return "at infinity"
    if vergence > 0:
        return f"{1.0 / vergence:.2g} m away {dioptres}"
    if vergence > -_BEHIND_THE_EYE_PER_M:
        return f"beyond infinity {dioptres}"
    return f"{-1.0 / vergence:.2g} m behind the eye {dioptres}"


_APPEARANCES = {
    (True, False): ("upright", "u runs to the wearer's right, v downwards: the picture is upright", ""),
    (True, True): ("bottom up", "v runs upwards in the view: rows of a picture appear bottom up", "reverse v_axis"),
    (False, False): ("mirrored", "u runs to the wearer's left: a picture appears mirrored", "reverse u_axis"),
    (False, True): (
        "turned by 180 degrees",
        "u runs to the wearer's left and v upwards: a picture appears turned by 180 degrees",
        "reverse u_axis and v_axis",
    ),
}
"""Appearance of the panel's picture by whether u runs right and v up: see `_appearance`."""


def _appearance(imaging: FirstOrder) -> tuple[str, str, str]:
    """Describe the appearance of the picture from the directions of u and v at the middle of the field.

    Returns:
        Two words, a sentence without a full stop, and the change of the device file for a panel that is mounted
        differently (empty for an upright picture).
    """
    (u_right, u_up), (v_right, v_up) = imaging.u_direction, imaging.v_direction
    if abs(u_right) + abs(v_up) >= abs(u_up) + abs(v_right):
        return _APPEARANCES[u_right > 0, v_up >= 0]
    u, v = "upwards" if u_up > 0 else "downwards", "right" if v_right > 0 else "left"
    short = "turned by 90 degrees" + (" and mirrored" if u_right * v_up > u_up * v_right else "")
    remedy = "choose u_axis to the wearer's right and v_axis downwards, and size_mm and pixels with them"
    return short, f"u runs {u} in the view, v to the wearer's {v}: a picture appears {short}", remedy


def orientation_warnings(eye: EyeName, imaging: FirstOrder | None) -> list[str]:
    """Warn of a picture that is not upright: it is right for some devices and a mistake for others."""
    _, sentence, remedy = ("", "", "") if imaging is None else _appearance(imaging)
    mounted = "Rendering allows for it; if the panel is not mounted so"
    return [f"{eye.capitalize()} eye: {sentence}. {mounted}, {remedy}."] if remedy else []


def _losses_table(optics: EyeOptics, losses: tuple[SurfaceLosses, ...]) -> ReportTable:
    """Tabulate the number of rays that reach each surface of the display path."""
    over = "the nominal field" if optics.field else "22 degrees to each side of straight ahead; no field_deg is stated"
    columns: Columns = {
        "surface": "name",
        "does": "interaction",
        "reached by": "reached",
        "go on": "passed",
        "lost": lambda each: each.sentence() or None,
    }
    notes = (f"{losses[0].reached} rays from the middle of the eye box over {over}; the panel comes last.",)
    return table("Rays along the display path", losses, columns, notes)


def _imaging_table(imaging: FirstOrder) -> ReportTable:
    distance = [1.0 / each if abs(each) > _FAR_PER_M else math.inf for each in imaging.vergence_per_m]
    magnification = [
        each if math.isfinite(away) else math.inf for each, away in zip(imaging.magnification, distance, strict=True)
    ]
    rows: list[list[Cell]] = [
        ["focal length (mm)", *(1e3 * each for each in imaging.focal_length_m)],
        ["distance of the virtual image (m)", *distance],
        ["its vergence (dioptres)", *imaging.vergence_per_m],
        ["magnification, virtual image to panel", *magnification],
        ["distortion, rms (%)", 100.0 * imaging.distortion_rms, None],
        ["distortion, largest (%)", 100.0 * imaging.distortion_max, None],
    ]
    notes = (
        "At the middle of the field that is seen. Focal length: distance on the panel for a tangent of 1. Distortion: "
        "departure from that scale, over the distance of the farthest ray from the middle. An image farther than a "
        "kilometre has no distance.",
        f"Orientation: {_appearance(imaging)[1]}.",
    )
    return ReportTable("Imaging of the panel", ("figure", "along x", "along y"), rows, notes)


def loss_warnings(optics: EyeOptics, eye: str, losses: tuple[SurfaceLosses, ...]) -> list[str]:
    """Warn of the surface that first loses rays, and suggest single changes of the device that would let them pass."""
    total, arriving = losses[0].reached, losses[-1].passed
    if arriving >= (MIN_PANEL_SHARE * total if optics.field else 1):
        return []
    first = next((each for each in losses if each.lost > _MANY_LOST * total), max(losses, key=lambda each: each.lost))
    over = (
        f"over the nominal field of the {eye} eye" if optics.field else f"within 22 degrees of the {eye} eye's forward"
    )
    few = f"Only {arriving}" if arriving else "None"
    warnings = [
        f"{few} of {total} rays {over} reach the panel. The first to lose many is "
        f"'{first.name}': of {first.reached} rays that reach it, {first.sentence()}."
    ]
    warnings += [
        f"{change.condition}, {count} of {total} rays would reach the panel: {change.check}."
        for change, count in helpful_changes(optics, FRAUNHOFER_F_D_C_UM[1])
    ]
    return warnings


def imaging_warnings(optics: EyeOptics, eye: str, imaging: FirstOrder | None) -> list[str]:
    """Warn of a virtual image where no eye can focus, and name the surfaces that could move it."""
    if imaging is None or _can_focus(imaging):
        return []
    vergence = min(imaging.vergence_per_m)
    vergence = vergence if vergence < -_BEHIND_THE_EYE_PER_M else max(imaging.vergence_per_m)
    side = "behind" if vergence < 0 else "before"
    hints, changes = [], list(curvature_changes(optics))
    for change in changes:
        other = first_order(change.optics, FRAUNHOFER_F_D_C_UM[1])
        if other is not None and _can_focus(other):
            hints.append(
                f"{change.condition}, the virtual image would lie {image_place(other)}, where an eye can focus: "
                f"{change.check}."
            )
    if hints:
        check = "check the signs of the radii, and the distance of the panel"
    else:
        check = "check the distance of the panel (its centre_mm)" + (" first, then the radii" if changes else "")
    return [
        f"The virtual image of the {eye} eye lies {abs(1.0 / vergence):.2g} m {side} the eye, where nobody can focus: "
        f"{check}.",
        *hints,
    ]


def _can_focus(imaging: FirstOrder) -> bool:
    return all(-_BEHIND_THE_EYE_PER_M < each < _TOO_NEAR_PER_M for each in imaging.vergence_per_m)

"""Convert a sequential prescription of Zemax, CODE V, Optiland or rayoptics into a device file."""

import re
import shlex
from dataclasses import KW_ONLY, dataclass, fields
from pathlib import Path
from typing import Annotated, Literal

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.io.atomic_files import output_folder
from wlr_render.io.toml_files import Table
from wlr_render.jobs import limits
from wlr_render.jobs.job import job
from wlr_render.jobs.options import (
    Against,
    EyeName,
    Options,
    ProgressArgument,
    Range,
    described,
    described_size,
    option_group,
)
from wlr_render.optics.device import Device
from wlr_render.optics.device_file import device_content, device_of, save_device
from wlr_render.optics.lens_files.glass_catalogues import GlassCatalogue
from wlr_render.optics.lens_files.headset_of_lens import HeadsetChoices, ImportedHeadset, headset_of_lens
from wlr_render.optics.lens_files.lens_file import read_lens_file
from wlr_render.optics.lens_files.sequence import Ignored, LensFile
from wlr_render.optics.surfaces import Shape
from wlr_render.report.blocks import Cell, Columns, Report, ReportTable, table
from wlr_render.work.progress import SILENT

_MOST_NAMED = 8  # most surfaces named in one sentence
_SIDE_MM = Range(at_least=0.1, at_most=200, unit="millimetres")
_NUMBER = Range(at_least=0, at_most=1000)
_PLACE_MM = Range(at_least=-1000, at_most=1000, unit="millimetres")
_HEADSET = option_group("Headset", 1)
_FILE = option_group("Reading of the file", 2)


@dataclass(frozen=True)
class ImportLensOptions(Options):
    """Options of `import-lens`."""

    file: Annotated[
        Path, described("Lens file: Zemax (.zmx, sequential), CODE V (.seq), Optiland (.json), rayoptics (.roa).")
    ]
    _: KW_ONLY
    panel: Annotated[
        tuple[int, int], described_size("Pixels of the panel, e.g. 1920x1080.", group=_HEADSET), limits.PIXELS
    ]
    panel_mm: Annotated[
        tuple[float, float],
        described_size("Lit area of the panel in mm, e.g. 10.1x5.7.", in_mm=True, group=_HEADSET),
        _SIDE_MM,
    ]
    eye_box_mm: Annotated[
        tuple[float, float, float],
        described("Size of the eye box in mm: to the right, up and back; the pupil is its centre.", group=_HEADSET),
        _SIDE_MM,
    ] = (8.0, 6.0, 4.0)
    eye_centre_mm: Annotated[
        tuple[float, float, float],
        described("Place of the pupil in the device in mm (x right, y up, z back).", group=_HEADSET),
        _PLACE_MM,
    ] = (0.0, 0.0, 0.0)
    eye: Annotated[EyeName, described("Side of the eye.", group=_HEADSET)] = "right"
    starts_at: Annotated[
        Literal["eye", "panel"],
        described("Where the light of the file begins; most designs are traced from the eye.", group=_FILE),
    ] = "eye"
    pupil_surface: Annotated[
        int | None,
        described("Number of the surface at the eye's pupil (default: the aperture stop).", group=_FILE),
        _NUMBER,
    ] = None
    eye_relief_mm: Annotated[
        float | None,
        described(
            "Distance of the pupil from the first surface that bends rays, in place of --pupil-surface.", group=_FILE
        ),
        Range(at_least=1, at_most=500, unit="millimetres"),
    ] = None
    panel_surface: Annotated[
        int | None,
        described("Number of the panel's surface (default: the image, or the object).", group=_FILE),
        _NUMBER,
    ] = None
    glasses: Annotated[
        tuple[Path, ...],
        described(
            "Glass catalogues of Zemax (.agf), searched in this order before the common glasses of the program.",
            flag=True,
            many=True,
            group=_FILE,
        ),
    ] = ()
    semi_diameters: Annotated[
        bool,
        described("Take the semi-diameters up to which surfaces are drawn as clear apertures.", flag=True, group=_FILE),
    ] = False
    out: Annotated[Path, described("Output folder.")] = Path("out/import-lens")
    against: Against = None


@job
def import_lens(options: ImportLensOptions, *, progress: ProgressArgument = SILENT) -> Report:
    """Convert a lens file into a device file, NAME.toml in `options.out`.

    Raises:
        BadInputError: the file is faulty, names an unknown glass, or does not identify eye and panel; or the folder
            cannot be written.
    """
    progress.say("reading the lens file")
    program, lens = read_lens_file(options.file, GlassCatalogue(options.glasses))
    headset = headset_of_lens(options.file, lens, _choices(options, program, lens))
    _require_readable(options, headset.device)
    folder = output_folder(options.out)
    written = save_device(headset.device, folder / f"{headset.device.name}.toml")
    return Report(
        f"Import of {options.file.name}",
        f"{_not_the_lens(headset)}{len(headset.path)} surfaces of {program}'s {options.file.name} are the display "
        f"path of '{headset.device.name}': the pupil stands {headset.pupil_text}, the panel is surface "
        f"{headset.panel_number}.",
        advice=[
            "Draw it and find where rays are lost: "
            + shlex.join(["wlr-render", "trace", str(written), "--eye", options.eye]),
            "Add the keys that no lens file has: see_through_path (the real world is seen past the optics now), "
            "field_deg, and also_mirrored for the other eye (devices/README.md).",
        ],
        warnings=_warnings(headset),
        blocks=[_surface_table(lens, headset), *_ignored_table(headset)],
        inputs=[options.file, *options.glasses],
        files=[written],
        record={"ignored": list(headset.ignored), "path": headset.path, "passed_over": headset.passed_over},
    )


def _choices(options: ImportLensOptions, program: str, lens: LensFile) -> HeadsetChoices:
    name = re.sub(r"[^\w.-]", "_", options.file.stem).lstrip("-.")[:60] or "lens"
    title = f": {lens.title}" if lens.title else ""
    same = {each.name: getattr(options, each.name) for each in fields(HeadsetChoices) if hasattr(options, each.name)}
    return HeadsetChoices(name=name, source=f"{program} file {options.file.name}{title}", **same)


def _require_readable(options: ImportLensOptions, device: Device) -> None:
    """Refuse a device that `load_device` would refuse; called before anything is written."""
    try:
        device_of(Table(device_content(device), f"{options.file}, as a device"))
    except BadInputError as error:
        if options.semi_diameters:
            raise
        raise BadInputError(f"{error} Or keep to the part that is drawn in the file: --semi-diameters.") from error


def _not_the_lens(headset: ImportedHeadset) -> str:
    """Return the start of the verdict if the file has surfaces of unsupported types; else empty."""
    unread = _unread(headset)
    if not unread:
        return ""
    substitute = (
        "a simpler surface" if all(note.surface in headset.path for note in unread) else "a simpler one or none"
    )
    listed = ", ".join(f"surface {note.surface} ({note.value})" for note in unread[:_MOST_NAMED])
    more = f" and {len(unread) - _MOST_NAMED} more" if len(unread) > _MOST_NAMED else ""
    return (
        f"The device does not trace as the lens does: the type of {listed}{more} is not read, and {substitute} "
        "stands in its place. "
    )


def _unread(headset: ImportedHeadset) -> list[Ignored]:
    """Return notes on surfaces that bend rays and whose types are not supported."""
    return [note for note in headset.ignored if note.part == "shape" and note.bends_rays]


def _warnings(headset: ImportedHeadset) -> list[str]:
    warnings = []
    changed = sorted({note.surface for note in headset.ignored if note.bends_rays and note.surface is not None})
    if changed:
        listed = ", ".join(map(str, changed))
        warnings.append(
            f"Rays differ from the file's because of surface {listed}: the table of ignored keys gives the reasons."
        )
    warnings += [
        f"{note.key} {note.value}: {note.reason}."
        for note in headset.ignored
        if note.surface is None and note.bends_rays
    ]
    glasses: dict[tuple[str, str], list[str]] = {}
    for note in headset.ignored:
        if note.part == "glass":
            glasses.setdefault((note.value, note.reason), []).append(str(note.surface))
    warnings += [
        f"Glass {value} of surface {', '.join(numbers)} is taken approximately: {reason}."
        for (value, reason), numbers in glasses.items()
    ]
    if not headset.is_reached:
        warnings.append(
            "Rays from the middle of the pupil do not reach the panel, which is turned as in the file: trace the "
            "device to find where they are lost."
        )
    return warnings


def _surface_table(lens: LensFile, headset: ImportedHeadset) -> ReportTable:
    """Tabulate the surfaces of the file and their use in the device."""
    optics = headset.device.eyes[next(iter(headset.device.eyes))]
    steps = dict(zip(headset.path, optics.display.steps, strict=True))
    unread = {note.surface for note in _unread(headset)}
    rows: list[list[Cell]] = []
    for surface in lens.surfaces:
        step = steps.get(surface.number)
        if step is not None:
            what, name = str(step.interaction), step.surface.name
        elif surface.number == headset.panel_number:
            what, name = "panel", "panel"
        elif surface.number in unread:
            what, name = "left out: its type is not read", None
        else:
            what, name = "left out: bends no ray" if surface.number in headset.passed_over else "not between them", None
        medium = step.medium.name if step is not None else None
        rows.append([surface.number, surface.label or None, name, _shape_text(surface.shape), what, medium])
    columns = ("surface", "comment", "name in the device", "shape", "becomes", "into, from the eye")
    return ReportTable("Surfaces of the file", columns, rows)


def _shape_text(shape: Shape) -> str:
    curvature = getattr(shape, "curvature", None)
    kind = re.sub(r"(?<!^)(?=[A-Z][a-z])", " ", type(shape).__name__).lower()
    if isinstance(curvature, float):
        return "plane" if kind == "conic" and curvature == 0.0 else f"{kind}, radius {_radius_text(curvature)}"
    return kind


def _radius_text(curvature: float) -> str:
    return f"{1e3 / curvature:.6g} mm" if curvature and np.isfinite(1.0 / curvature) else "none"


def _ignored_table(headset: ImportedHeadset) -> list[ReportTable]:
    columns: Columns = {
        "surface": lambda note: "all" if note.surface is None else str(note.surface),
        "key": "key",
        "value": "value",
        "bends rays": lambda note: "yes" if note.bends_rays else "no",
        "reason": "reason",
    }
    notes = ("Keys of drawing, coating and tolerances, of fields and wavelengths, and Zemax's solves are not listed.",)
    title = "Keys ignored, or read otherwise than the file states them"
    return [table(title, headset.ignored, columns, notes)] if headset.ignored else []

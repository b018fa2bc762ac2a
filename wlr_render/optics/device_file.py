"""Read device prescriptions (format: devices/README.md). Converts millimetres and degrees to metres and radians."""

from pathlib import Path as FilePath

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.geometry.transforms import FRAMES
from wlr_render.io.atomic_files import named_or_path
from wlr_render.io.file_records import MM, Place, read_part, read_record
from wlr_render.io.input_files import require_pixels, shown
from wlr_render.io.toml_files import Table, read_toml
from wlr_render.optics.device import (
    ClearAperture,
    Device,
    EyeOptics,
    Interaction,
    Path,
    PlacedPanel,
    PlacedSurface,
    Step,
    mirrored,
)
from wlr_render.optics.device_keys import EYE_BOX, FIELD, SurfacePose
from wlr_render.optics.device_media import read_medium
from wlr_render.optics.device_shapes import SAG_SHAPES, SHAPES, read_shape
from wlr_render.optics.media import AIR, Medium
from wlr_render.optics.raised import FormError, Offset, nesting, raised
from wlr_render.optics.sag_surfaces import SagSurface
from wlr_render.optics.surfaces import Shape

_OPEN_MM = 10.0  # least half width of a surface without an aperture
_STEEPEST_SLOPE = 20.0  # largest slope of a surface given by its sag: 87 degrees
_MOST = 100  # most surfaces, steps of a path, media, or form errors
_DEEPEST = 6  # deepest nesting of surfaces based on others: the time for a ray grows exponentially with it
_OTHER_SIDE = {"right": "left", "left": "right"}


def load_device(spec: str | FilePath) -> Device:
    """Read a device by its shipped name or by the path of its file.

    Raises:
        BadInputError: the file does not exist, is not TOML, or breaks the format; the sentence says where.
    """
    return device_of(read_toml(device_path(spec)))


def device_path(spec: str | FilePath) -> FilePath:
    """Return the path of a device file, given a shipped device's name or a path.

    Raises:
        BadInputError: the device does not exist, or the file holds JSON, as fitted models do.
    """
    path = named_or_path("devices", spec)
    if path.suffix.lower() == ".json":
        raise BadInputError(
            f"{path}: is a model file, or another JSON file, and a device is needed: name a shipped device or a device "
            "file (.toml). Fitted models are taken by render, export and budget."
        )
    return path


def device_of(file: Table) -> Device:
    """Build a device from an opened file; every key must be known."""
    place = Place(axes=FRAMES[file.text("frame", choices=sorted(FRAMES))])
    media = _media(file)
    eyes: dict[str, EyeOptics] = {}
    for table in file.tables("eye"):
        side = table.text("side", choices=sorted(_OTHER_SIDE))
        wanted = [side, _OTHER_SIDE[side]] if table.flag("also_mirrored", default=False) else [side]
        for name in wanted:
            if name in eyes:
                raise table.fail(f"the {name} eye is already given; give each side once.")
        eye = _eye(table, place, media)
        eyes.update(zip(wanted, [eye, mirrored(eye)], strict=False))
    if not eyes:
        raise file.fail("there is no [[eye]]; give at least one.")
    device = Device(file.file_stem("name"), file.text("source"), eyes)
    file.finish()
    return device


def _media(file: Table) -> dict[str, Medium]:
    media = {AIR.name: AIR}
    for table in file.tables("medium", required=False, most=_MOST):
        name = table.text("name")
        if name in media:
            raise table.fail(f"there is already a medium '{name}'; choose another name.")
        media[name] = read_medium(table, name)
        table.finish()
    return media


def _eye(table: Table, place: Place, media: dict[str, Medium]) -> EyeOptics:
    surfaces: dict[str, PlacedSurface] = {}
    bases: dict[str, str] = {}
    for entry in table.tables("surface", required=False, most=_MOST):
        surface = _surface(entry, place, surfaces, bases)
        surfaces[surface.name] = surface
    display = _path(table.tables("display_path", most=_MOST), surfaces, media)
    see_through = _path(table.tables("see_through_path", most=_MOST), surfaces, media)
    if see_through.steps and see_through.steps[-1].medium is not AIR:
        raise table.fail("'see_through_path' must end in air.")
    panel_table, box_table = table.table("panel"), table.table("eye_box")
    panel, eye_box = read_record(PlacedPanel, panel_table, place), EYE_BOX.read(box_table, place)
    require_pixels(f"{panel_table.where} 'pixels'", panel.pixels.size_px, "correct them")
    box_table.finish()
    field = FIELD.read(table, place) if table.has("field_deg") else None
    eye = EyeOptics(display, see_through, panel, eye_box, field)
    used = {surface.name for surface in eye.surfaces()}
    for name in reversed(surfaces):
        used |= {bases[name]} if name in used and name in bases else set()
    for name in surfaces:
        if name not in used:
            raise table.fail(f"surface '{name}' is in no path; remove it or use it.")
    table.finish()
    return eye


def _surface(table: Table, place: Place, earlier: dict[str, PlacedSurface], bases: dict[str, str]) -> PlacedSurface:
    """Read one [[eye.surface]].

    Args:
        table: the table.
        place: axes of the file.
        earlier: surfaces that may be its base.
        bases: names of the bases of displaced surfaces; the base of this one is added.
    """
    name = table.text("name")
    if name in earlier:
        raise table.fail(f"there is already a surface '{name}'; choose another name.")
    kind = table.text("shape", choices=[*SHAPES, "offset", "raised"])
    if kind in SHAPES:
        surface = read_record(PlacedSurface, table, place, shape=read_shape(table, kind))
    else:
        bases[name] = _named(table, "of", "earlier surface", earlier)
        base = earlier[bases[name]]
        if nesting(base.shape) >= _DEEPEST:
            raise table.fail(f"'of' leads through more than {_DEEPEST} surfaces; state this one by an earlier surface.")
        if kind == "offset":
            shape: Shape = read_part(Offset, table, base=base.shape)
        else:
            shape = raised(base.shape, *(_form_error(each, place, base) for each in table.tables("error", most=_MOST)))
        surface = read_record(PlacedSurface, table, shape=shape, device_from_surface=base.device_from_surface)
    if isinstance(surface.shape, SagSurface):
        _require_smooth(table, surface.shape, surface.aperture)
    return surface


def _require_smooth(table: Table, shape: SagSurface, aperture: ClearAperture) -> None:
    """Refuse a sag too steep for optics within the aperture, or near the vertex along an axis that is open.

    Newton's method does not converge on it, and takes minutes to fail for every pixel.
    """
    low, high = (
        np.where(np.isinf(side), np.sign(side) * MM * _OPEN_MM, side)[:2] for side in (aperture.low, aperture.high)
    )
    x, y = np.meshgrid(*(low + (high - low) * (np.arange(8.0)[:, None] + 0.5) / 8).T)
    with np.errstate(all="ignore"):  # NaN beyond the edge of the shape
        slopes = np.abs(shape.sag_and_slopes(x.ravel(), y.ravel())[1:])
    steepest = np.nanmax(slopes, initial=0.0)
    if steepest > _STEEPEST_SLOPE:
        raise table.fail(
            f"rises {steepest:.3g} mm per mm within its aperture, more than the plausible {_STEEPEST_SLOPE:g}; are its "
            "numbers in powers of millimetres?"
        )


def _form_error(table: Table, place: Place, base: PlacedSurface) -> FormError:
    """Return one [[eye.surface.error]], a shape z(x, y) with its pose."""
    sag = read_shape(table, table.text("shape", choices=SAG_SHAPES))
    error = FormError(sag, base.surface_from_device @ SurfacePose().read(table, place))
    table.finish()
    return error


def _named(entry: Table, key: str, kind: str, choices: dict[str, PlacedSurface] | dict[str, Medium]) -> str:
    """Return a key that names something defined in the file."""
    name = entry.text(key)
    if name not in choices:
        raise entry.fail(
            f"'{key}' names the {kind} {shown(name)}, which is not defined "
            f"({', '.join(choices) or 'none is'}); correct it."
        )
    return name


def _path(entries: list[Table], surfaces: dict[str, PlacedSurface], media: dict[str, Medium]) -> Path:
    """Read steps written as { at = surface, do = interaction, into = medium }; `into` is for refractions only."""
    medium = AIR
    steps = []
    for entry in entries:
        surface = surfaces[_named(entry, "at", "surface", surfaces)]
        interaction = Interaction(entry.text("do", choices=[str(each) for each in Interaction]))
        if interaction is Interaction.REFRACT:
            medium = media[_named(entry, "into", "medium", media)]
        entry.finish()
        steps.append(Step(surface, interaction, medium))
    return Path(tuple(steps))

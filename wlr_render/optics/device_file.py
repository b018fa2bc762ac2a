"""Read and write device prescriptions (format: devices/README.md). Files have millimetres and degrees."""

from dataclasses import replace
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.geometry.transforms import FRAMES
from wlr_render.io.atomic_files import named_or_path
from wlr_render.io.file_records import MM, Place, read_part, read_record, record_keys
from wlr_render.io.input_files import require_pixels, shown
from wlr_render.io.toml_files import Table, read_toml, write_toml
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
from wlr_render.optics.device_media import medium_content, read_medium
from wlr_render.optics.media import AIR, Medium
from wlr_render.optics.raised import FormError, Offset, base_of, nesting, raised
from wlr_render.optics.sag_surfaces import (
    AnamorphicAsphere,
    Asphere,
    GaussianBump,
    SagSurface,
    SumOfProfiles,
    Toroid,
    XYPolynomial,
)
from wlr_render.optics.surfaces import Conic, Ellipsoid, Shape

_OPEN_MM = 10.0  # least half width of a surface without an aperture
_STEEPEST_SLOPE = 20.0  # largest slope of a surface given by its sag: 87 degrees
_MOST = 100  # largest number of surfaces, steps of a path, media, or form errors
_DEEPEST = 6  # deepest nesting of surfaces based on others: the time for a ray grows exponentially with it
_OTHER_SIDE = {"right": "left", "left": "right"}
_SHAPES: dict[str, type[Shape]] = {
    "plane": Conic,
    "conic": Conic,
    "ellipsoid": Ellipsoid,
    "toroid": Toroid,
    "asphere": Asphere,
    "xy_polynomial": XYPolynomial,
    "sum_of_profiles": SumOfProfiles,
    "anamorphic": AnamorphicAsphere,
    "bump": GaussianBump,
}
"""Classes of the shapes that are stated without another surface, by their names in a device file."""
_SAG_SHAPES = sorted(kind for kind, made in _SHAPES.items() if issubclass(made, SagSurface))
"""Shapes that are heights over x and y, as form errors are."""


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
            "file (.toml). Fitted models and factory calibrations are taken by render, export and budget."
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
        place: pose and axes of the file.
        earlier: surfaces that may be its base.
        bases: names of the bases of displaced surfaces; the base of this one is added.
    """
    name = table.text("name")
    if name in earlier:
        raise table.fail(f"there is already a surface '{name}'; choose another name.")
    kind = table.text("shape", choices=[*_SHAPES, "offset", "raised"])
    if kind in _SHAPES:
        surface = read_record(PlacedSurface, table, place, shape=_read_shape(table, kind))
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


def _read_shape(table: Table, kind: str) -> Any:
    """Read the keys of one kind of shape."""
    if kind == "plane":
        return Conic(0.0)
    shape = read_part(_SHAPES[kind], table)
    if table.has("conic") and not table.has("radius_mm"):
        raise table.fail("'conic' is there without 'radius_mm'; write both, or neither.")
    if isinstance(shape, AnamorphicAsphere | SumOfProfiles) and not any(shape.curvature):
        raise table.fail("neither radius_x_mm nor radius_y_mm is there; write at least one.")
    return shape


def _require_smooth(table: Table, shape: SagSurface, aperture: ClearAperture) -> None:
    """Refuse a sag that is too steep for optics within the aperture, or near the vertex along an unlimited axis.

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
    sag = _read_shape(table, table.text("shape", choices=_SAG_SHAPES))
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


def save_device(device: Device, path: str | FilePath) -> FilePath:
    """Write a device that `load_device` reads back, to the rounding of its numbers.

    Media of the same name that differ between the eyes get the side appended to the name. A displaced surface gets a
    separate base if its base has another pose or is not in a path.
    """
    return write_toml(path, device_content(device))


def device_content(device: Device) -> dict[str, Any]:
    """Return the content that `save_device` writes; two devices are the same if it is equal."""
    names = _medium_names(device)
    head = {"name": device.name, "source": device.source, "frame": "openxr"}
    media = [medium_content(name, medium) for medium, name in names.items() if medium != AIR]
    eyes = _eye_tables(device, names)
    return head | ({"medium": media} if media else {}) | {"eye": eyes}


def _medium_names(device: Device) -> dict[Medium, str]:
    """Return a name for each medium in use: its own name, unless another medium has it."""
    names = {AIR: AIR.name}
    for side, eye in device.eyes.items():
        for step in eye.display.steps + eye.see_through.steps:
            name = step.medium.name
            while name in names.values() and step.medium not in names:
                name = f"{name}_{side}"
            names.setdefault(step.medium, name)
    return names


def _eye_tables(device: Device, names: dict[Medium, str]) -> list[dict[str, Any]]:
    """Return one table for both eyes if one is the mirror image of the other, else one for each."""
    first, *others = device.eyes
    tables = {side: _eye_content(eye, names) for side, eye in device.eyes.items()}
    if others and tables[others[0]] == _eye_content(mirrored(device.eyes[first]), names):
        return [{"side": first, "also_mirrored": True} | tables[first]]
    return [{"side": side} | table for side, table in tables.items()]


def _eye_content(eye: EyeOptics, names: dict[Medium, str]) -> dict[str, Any]:
    return {
        "display_path": _path_content(eye.display, names),
        "see_through_path": _path_content(eye.see_through, names),
        **({} if eye.field is None else FIELD.keys(eye.field, Place())),
        "eye_box": EYE_BOX.keys(eye.eye_box, Place()),
        "panel": record_keys(eye.panel),
        **_surface_tables(eye.surfaces()),
    }


def _path_content(path: Path, names: dict[Medium, str]) -> list[dict[str, Any]]:
    return [
        {"at": step.surface.name, "do": str(step.interaction)}
        | ({"into": names[step.medium]} if step.interaction is Interaction.REFRACT else {})
        for step in path.steps
    ]


def _surface_tables(surfaces: tuple[PlacedSurface, ...]) -> dict[str, Any]:
    """Return all surfaces and the bases that displaced ones need, each base before the surfaces that refer to it."""
    placed, bases = list(surfaces), dict[str, str]()
    for surface in placed:  # grows by the bases, which may be displaced too
        if (shape := base_of(surface.shape)) is None:
            continue
        base = _placed_base(surface, shape, placed)
        bases[surface.name] = base.name
        if base not in placed:
            placed.append(base)
    ordered = sorted(placed, key=lambda surface: nesting(surface.shape))
    return {"surface": [_surface_content(surface, bases) for surface in ordered]} if placed else {}


def _placed_base(surface: PlacedSurface, shape: Shape, placed: list[PlacedSurface]) -> PlacedSurface:
    """Return the surface that is the base of a displaced one: an existing surface in its place, or a new one."""
    for other in placed:
        if other.shape == shape and np.array_equal(other.device_from_surface, surface.device_from_surface):
            return other
    name = f"{surface.name}_base"
    while any(name == other.name for other in placed):
        name += "_base"
    return replace(surface, name=name, shape=shape)


def _surface_content(surface: PlacedSurface, bases: dict[str, str]) -> dict[str, Any]:
    shape, keys = surface.shape, record_keys(surface)
    if not isinstance(shape, Offset):
        return {"name": surface.name} | _shape_content(shape) | keys
    content: dict[str, Any] = {"name": surface.name, "shape": "offset", "of": bases[surface.name]}
    if shape.errors:
        content |= {"shape": "raised", "error": [_error_content(surface, each) for each in shape.errors]}
    else:
        content |= record_keys(shape)
    return content | {key: keys[key] for key in keys if key.startswith("aperture")}


def _error_content(surface: PlacedSurface, error: FormError) -> dict[str, Any]:
    pose = surface.device_from_surface @ error.surface_from_error
    return _shape_content(error.sag) | SurfacePose().keys(pose, Place())


def _shape_content(shape: Shape) -> dict[str, Any]:
    """Return the keys that `_read_shape` reads, with the kind as `shape`."""
    if isinstance(shape, Conic) and not shape.curvature:
        return {"shape": "plane"}
    (kind,) = (kind for kind, made in _SHAPES.items() if type(shape) is made and kind != "plane")
    return {"shape": kind} | record_keys(shape)

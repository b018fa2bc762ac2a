"""Read device prescriptions (format: devices/README.md). Converts millimetres and degrees to metres and radians."""

from pathlib import Path as FilePath

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import normalised
from wlr_render.geometry.transforms import FRAMES, rigid, rotation_about
from wlr_render.io.atomic_files import named_or_path
from wlr_render.io.input_files import require_eye_box, require_pixels, shown
from wlr_render.io.toml_files import Table, read_toml
from wlr_render.mappings import EyeBox, FieldOfView, Panel
from wlr_render.numerics.arrays import FloatArray
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
from wlr_render.optics.device_media import read_medium
from wlr_render.optics.device_shapes import FAR_MM, MM, SAG_SHAPES, SHAPES, length, lengths, read_shape
from wlr_render.optics.media import AIR, Medium
from wlr_render.optics.raised import FormError, Offset, nesting, raised
from wlr_render.optics.sag_surfaces import SagSurface
from wlr_render.optics.surfaces import Shape

_MIRROR_Y = np.diag([1.0, -1.0, 1.0])

_OPEN_MM = 10.0  # least half width of a surface without an aperture
_STEEPEST_SLOPE = 20.0  # largest slope of a surface given by its sag: 87 degrees
_EYE_BOX_LEAST_MM = 0.1
_PANEL_LEAST_MM = 0.5
_STEEPEST_DEG = 89.0  # largest angle of a field of view, which is described by tangents
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
    frame = FRAMES[file.text("frame", choices=sorted(FRAMES))]
    media = _media(file)
    eyes: dict[str, EyeOptics] = {}
    for table in file.tables("eye"):
        side = table.text("side", choices=sorted(_OTHER_SIDE))
        wanted = [side, _OTHER_SIDE[side]] if table.flag("also_mirrored", default=False) else [side]
        for name in wanted:
            if name in eyes:
                raise table.fail(f"the {name} eye is already given; give each side once.")
        eye = _eye(table, frame, media)
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


def _eye(table: Table, frame: FloatArray, media: dict[str, Medium]) -> EyeOptics:
    surfaces: dict[str, PlacedSurface] = {}
    bases: dict[str, str] = {}
    for entry in table.tables("surface", required=False, most=_MOST):
        surface = _surface(entry, frame, surfaces, bases)
        surfaces[surface.name] = surface
    display = _path(table.tables("display_path", most=_MOST), surfaces, media)
    see_through = _path(table.tables("see_through_path", most=_MOST), surfaces, media)
    if see_through.steps and see_through.steps[-1].medium is not AIR:
        raise table.fail("'see_through_path' must end in air.")
    panel, eye_box = _panel(table.table("panel"), frame), _eye_box(table.table("eye_box"), frame)
    eye = EyeOptics(display, see_through, panel, eye_box, _field(table))
    used = {surface.name for surface in eye.surfaces()}
    for name in reversed(surfaces):
        used |= {bases[name]} if name in used and name in bases else set()
    for name in surfaces:
        if name not in used:
            raise table.fail(f"surface '{name}' is in no path; remove it or use it.")
    table.finish()
    return eye


def _surface(
    table: Table, frame: FloatArray, earlier: dict[str, PlacedSurface], bases: dict[str, str]
) -> PlacedSurface:
    """Read one [[eye.surface]].

    Args:
        table: the table.
        frame: turns the file's axes into the device's.
        earlier: surfaces that may be its base.
        bases: names of the bases of displaced surfaces; the base of this one is added.
    """
    name = table.text("name")
    if name in earlier:
        raise table.fail(f"there is already a surface '{name}'; choose another name.")
    kind = table.text("shape", choices=[*SHAPES, "offset", "raised"])
    aperture = _aperture(table)
    if kind in SHAPES:
        placed = PlacedSurface(name, read_shape(table, kind), _pose(table, frame), aperture)
    else:
        bases[name] = _named(table, "of", "earlier surface", earlier)
        base = earlier[bases[name]]
        if nesting(base.shape) >= _DEEPEST:
            raise table.fail(f"'of' leads through more than {_DEEPEST} surfaces; state this one by an earlier surface.")
        if kind == "offset":
            shape: Shape = Offset(base.shape, length(table, "distance_mm"))
        else:
            shape = raised(base.shape, *(_form_error(each, frame, base) for each in table.tables("error", most=_MOST)))
        placed = PlacedSurface(name, shape, base.device_from_surface, aperture)
    if isinstance(placed.shape, SagSurface):
        _require_smooth(table, placed.shape, aperture)
    table.finish()
    return placed


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


def _form_error(table: Table, frame: FloatArray, base: PlacedSurface) -> FormError:
    """Return one [[eye.surface.error]], a shape z(x, y) with its pose."""
    sag = read_shape(table, table.text("shape", choices=SAG_SHAPES))
    error = FormError(sag, base.surface_from_device @ _pose(table, frame))
    table.finish()
    return error


def _aperture(table: Table) -> ClearAperture:
    """Read `aperture_x_mm`, `aperture_y_mm`, `aperture_z_mm`; open along an axis that is left out."""
    keys = [f"aperture_{axis}_mm" for axis in "xyz"]
    sides = [lengths(table, key, 2) if table.has(key) else np.array([-np.inf, np.inf]) for key in keys]
    low, high = np.stack(sides, axis=1)
    if not np.all(low < high):
        raise table.fail("each 'aperture_*_mm' must be [low, high] with low below high.")
    return ClearAperture(low, high)


def _pose(table: Table, frame: FloatArray) -> FloatArray:
    """Read `origin_mm`, the axes by `rotate_x_deg` or by the vectors `x_axis` and `z_axis`, and `mirrored`."""
    if table.has("z_axis"):
        rotation = _axes(table, "z_axis", "x_axis")[:, [1, 2, 0]]
    else:
        rotation = rotation_about("x", np.deg2rad(table.number("rotate_x_deg", default=0.0)))
    if table.flag("mirrored", default=False):
        rotation = rotation @ _MIRROR_Y
    return rigid(frame @ rotation, frame @ lengths(table, "origin_mm", 3))


def _axes(table: Table, first: str, second: str) -> FloatArray:
    """Return the right-handed unit axes in columns: `first`, `second` made orthogonal to it, and their product."""
    a, b = table.vector(first, 3), table.vector(second, 3)
    lengths = np.linalg.norm(a) * np.linalg.norm(b)
    if lengths == 0 or abs(a @ b) > 1e-3 * lengths:
        raise table.fail(f"'{first}' and '{second}' must be perpendicular and not zero.")
    a = normalised(a)
    b = normalised(b - (a @ b) * a)
    return np.stack([a, b, np.cross(a, b)], axis=1)


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


def _panel(table: Table, frame: FloatArray) -> PlacedPanel:
    counts = table.vector("pixels", 2)
    if not np.all((counts >= 1) & (counts == np.round(counts))):
        raise table.fail("'pixels' must be two whole numbers of at least 1, width and height.")
    require_pixels(f"{table.where} 'pixels'", counts, "correct them")
    size = MM * table.vector("size_mm", 2, least=_PANEL_LEAST_MM, most=FAR_MM)
    pose = rigid(frame @ _axes(table, "u_axis", "v_axis"), frame @ lengths(table, "centre_mm", 3))
    curvature = table.vector("curvature_per_m", 2, default=(0.0, 0.0))
    panel = PlacedPanel(pose, size, Panel(int(counts[0]), int(counts[1])), curvature)
    table.finish()
    return panel


def _field(table: Table) -> FieldOfView | None:
    """Read the angles from the wearer's view, right and up positive, whatever the file's axes."""
    if not table.has("field_deg"):
        return None
    angles = table.vector("field_deg", 4, least=-_STEEPEST_DEG, most=_STEEPEST_DEG)
    left, right, down, up = np.tan(np.deg2rad(angles))
    if not (left < right and down < up):
        raise table.fail("'field_deg' must be left, right, down, up, each pair ascending; right and up are positive.")
    return FieldOfView(np.array([left, down]), np.array([right, up]))


def _eye_box(table: Table, frame: FloatArray) -> EyeBox:
    size = table.vector("size_mm", 3, above=0.0)
    require_eye_box(f"{table.where}: 'size_mm'", size, "mm")
    box = EyeBox(frame @ lengths(table, "centre_mm", 3), MM * size)
    if size.max() < _EYE_BOX_LEAST_MM:
        raise table.fail(f"'size_mm' is below {_EYE_BOX_LEAST_MM:g} mm on every axis; is it in metres? Convert it.")
    table.finish()
    return box

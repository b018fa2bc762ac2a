"""Read device prescriptions (format: devices/README.md). Converts millimetres and degrees to metres and radians."""

import re
from collections.abc import Callable
from pathlib import Path as FilePath

import numpy as np

from wlr_render.files import named_or_path
from wlr_render.geometry.directions import normalised
from wlr_render.geometry.transforms import FRAMES, rigid, rotation_about
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
from wlr_render.optics.media import AIR, FORMULAS, Medium
from wlr_render.optics.raised import FormError, Raised, RaisedSag, raised
from wlr_render.optics.sag_surfaces import (
    AnamorphicAsphere,
    AnamorphicTerm,
    GaussianBump,
    SagSurface,
    Toroid,
    XYPolynomial,
)
from wlr_render.optics.surfaces import Conic, Ellipsoid, Offset, Shape
from wlr_render.toml_files import Table, read_toml

MM = 1e-3
"""One millimetre in metres."""

_MIRROR_Y = np.diag([1.0, -1.0, 1.0])

_GREEN_UM = 0.55
_OTHER_SIDE = {"right": "left", "left": "right"}


def placed_surface(table: Table, frame: FloatArray, earlier: dict[str, PlacedSurface]) -> PlacedSurface:
    """Read one [[eye.surface]]; `frame` turns the file's axes into the device's, `earlier` surfaces may be bases."""
    name = table.text("name")
    if name in earlier:
        raise table.fail(f"there is already a surface '{name}'; choose another name.")
    kind = table.text("shape", choices=[*_SHAPES, "offset", "raised"])
    aperture = _aperture(table)
    if kind in ("offset", "raised"):
        base = earlier[named(table, "of", "earlier surface", earlier)]
        if kind == "offset":
            shape: Shape = Offset(base.shape, MM * nonzero(table, "distance_mm"))
        else:
            shape = raised(base.shape, *(_form_error(each, frame, base) for each in table.tables("error")))
        placed = PlacedSurface(name, shape, base.device_from_surface, aperture)
    else:
        placed = PlacedSurface(name, _SHAPES[kind](table), _pose(table, frame), aperture)
    table.finish()
    return placed


def _form_error(table: Table, frame: FloatArray, base: PlacedSurface) -> FormError:
    """One [[eye.surface.error]], a shape z(x, y) with its pose."""
    sag = _SAG_SHAPES[table.text("shape", choices=sorted(_SAG_SHAPES))](table)
    error = FormError(sag, base.surface_from_device @ _pose(table, frame))
    table.finish()
    return error


def _aperture(table: Table) -> ClearAperture:
    """`aperture_x_mm`, `aperture_y_mm`, `aperture_z_mm`; open along an axis that is left out."""
    keys = [f"aperture_{axis}_mm" for axis in "xyz"]
    sides = [MM * table.vector(key, 2) if table.has(key) else np.array([-np.inf, np.inf]) for key in keys]
    low, high = np.stack(sides, axis=1)
    if not np.all(low < high):
        raise table.fail("each 'aperture_*_mm' must be [low, high] with low below high.")
    return ClearAperture(low, high)


def _pose(table: Table, frame: FloatArray) -> FloatArray:
    """`origin_mm`, the axes by `rotate_x_deg` or by the two vectors `x_axis` and `z_axis`, and `mirrored`."""
    if table.has("z_axis"):
        rotation = axes(table, "z_axis", "x_axis")[:, [1, 2, 0]]
    else:
        rotation = rotation_about("x", np.deg2rad(table.number("rotate_x_deg", default=0.0)))
    if table.flag("mirrored", default=False):
        rotation = rotation @ _MIRROR_Y
    return rigid(frame @ rotation, frame @ (MM * table.vector("origin_mm", 3)))


def axes(table: Table, first: str, second: str) -> FloatArray:
    """Right-handed unit axes in columns: `first`, `second` made orthogonal to it, and their product."""
    a, b = table.vector(first, 3), table.vector(second, 3)
    lengths = np.linalg.norm(a) * np.linalg.norm(b)
    if lengths == 0 or abs(a @ b) > 1e-3 * lengths:
        raise table.fail(f"'{first}' and '{second}' must be perpendicular and not zero.")
    a = normalised(a)
    b = normalised(b - (a @ b) * a)
    return np.stack([a, b, np.cross(a, b)], axis=1)


def _ellipsoid(table: Table) -> Shape:
    semi_axes = MM * table.vector("semi_axes_mm", 3)
    if not np.all(semi_axes > 0):
        raise table.fail("'semi_axes_mm' must be positive.")
    return Ellipsoid(semi_axes)


def _xy_polynomial(table: Table) -> XYPolynomial:
    sag = table.table("sag_mm")
    powers = {key: _powers(sag, key) for key in sag.keys()}  # noqa: SIM118 (a Table is no dictionary)
    if not powers:
        raise sag.fail("there is no coefficient; give at least one, such as x2.")
    coefficients = np.zeros(np.max(list(powers.values()), axis=0) + 1)
    for key, (m, n) in powers.items():
        coefficients[m, n] = sag.number(key) * MM ** (1 - m - n)
    if not table.has("radius_mm"):
        return XYPolynomial(coefficients)
    base = 1.0 / (MM * nonzero(table, "radius_mm"))
    return XYPolynomial(coefficients, base, table.number("conic", default=0.0))


def _powers(sag: Table, key: str) -> tuple[int, int]:
    """Powers of x and y that a key such as "x2y", "y3" stands for."""
    match = re.fullmatch(r"(?:x(\d*))?(?:y(\d*))?", key)
    if not key or match is None:
        raise sag.fail(f"'{key}' is no term in x and y; write x2, xy3, y4 and so on.")
    m, n = (0 if power is None else int(power or 1) for power in match.groups())
    return m, n


def _anamorphic(table: Table) -> AnamorphicAsphere:
    curvature = tuple(1.0 / (MM * nonzero(table, key)) for key in ("radius_x_mm", "radius_y_mm"))
    conic = tuple(table.number(key, default=0.0) for key in ("conic_x", "conic_y"))
    terms = []
    for entry in table.tables("term", required=False):
        order = entry.number("order")
        if order not in (4, 6, 8, 10):
            raise entry.fail(f"'order' is {order:g}; it must be 4, 6, 8 or 10.")
        amplitude = entry.number("sag_mm") * MM ** (1 - order)
        terms.append(AnamorphicTerm(amplitude, entry.number("asymmetry", default=0.0), int(order) // 2))
        entry.finish()
    return AnamorphicAsphere((curvature[0], curvature[1]), (conic[0], conic[1]), tuple(terms))


_SAG_SHAPES: dict[str, Callable[[Table], SagSurface]] = {
    "toroid": lambda table: Toroid(MM * nonzero(table, "radius_x_mm"), MM * nonzero(table, "radius_y_mm")),
    "xy_polynomial": _xy_polynomial,
    "anamorphic": _anamorphic,
    "bump": lambda table: GaussianBump(MM * table.number("height_mm"), MM * positive(table, "width_mm")),
}
_SHAPES: dict[str, Callable[[Table], Shape]] = {
    "plane": lambda _: Conic(0.0),
    "conic": lambda table: Conic(1.0 / (MM * nonzero(table, "radius_mm")), table.number("conic", default=0.0)),
    "ellipsoid": _ellipsoid,
    **_SAG_SHAPES,
}


def base_chain(shape: Shape) -> list[Shape]:
    """The shape itself and, if it is displaced from a base, its base, and so on."""
    return [shape, *base_chain(shape.base)] if isinstance(shape, Offset | Raised | RaisedSag) else [shape]


def named(entry: Table, key: str, kind: str, choices: dict[str, PlacedSurface] | dict[str, Medium]) -> str:
    """A key that refers to something defined in the file by its name."""
    name = entry.text(key)
    if name not in choices:
        raise entry.fail(
            f"'{key}' names the {kind} '{name}', which is not defined ({', '.join(choices) or 'none is'})."
        )
    return name


def positive(table: Table, key: str) -> float:
    """A number above 0."""
    value = table.number(key)
    if value <= 0:
        raise table.fail(f"'{key}' must be positive, not {value}.")
    return value


def nonzero(table: Table, key: str) -> float:
    """A number other than 0."""
    value = table.number(key)
    if value == 0:
        raise table.fail(f"'{key}' must not be 0.")
    return value


def load_device(spec: str | FilePath) -> Device:
    """Read a device by its shipped name or by the path of its file.

    Raises:
        BadInputError: the file does not exist, is not TOML, or breaks the format; the sentence says where.
    """
    return device_of(read_toml(device_path(spec)))


def device_path(spec: str | FilePath) -> FilePath:
    """Path of a device file, given a shipped device's name or a path.

    Raises:
        BadInputError: there is no such device.
    """
    return named_or_path("devices", spec)


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
    for table in file.tables("medium", required=False):
        name = table.text("name")
        if name in media:
            raise table.fail(f"there is already a medium '{name}'; choose another name.")
        media[name] = _medium(table, name)
        table.finish()
    return media


def _medium(table: Table, name: str) -> Medium:
    if table.has("formula"):
        medium = Medium(name, FORMULAS[table.text("formula", choices=sorted(FORMULAS))])
    else:
        medium = Medium.constant(name, positive(table, "index"))
    medium = medium.shifted(table.number("index_shift", default=0.0))
    if medium.index(_GREEN_UM) <= 0:
        raise table.fail("'index_shift' makes the refractive index negative; it must stay positive.")
    return medium


def _eye(table: Table, frame: FloatArray, media: dict[str, Medium]) -> EyeOptics:
    surfaces: dict[str, PlacedSurface] = {}
    for entry in table.tables("surface", required=False):
        surface = placed_surface(entry, frame, surfaces)
        surfaces[surface.name] = surface
    display = _path(table.tables("display_path"), surfaces, media)
    see_through = _path(table.tables("see_through_path"), surfaces, media)
    if see_through.steps and see_through.steps[-1].medium is not AIR:
        raise table.fail("'see_through_path' must end in air.")
    panel, eye_box = _panel(table.table("panel"), frame), _eye_box(table.table("eye_box"), frame)
    eye = EyeOptics(display, see_through, panel, eye_box, _field(table))
    used = [shape for surface in eye.surfaces() for shape in base_chain(surface.shape)]
    for name, surface in surfaces.items():
        if not any(shape is surface.shape for shape in used):
            raise table.fail(f"surface '{name}' is in no path; remove it or use it.")
    table.finish()
    return eye


def _path(entries: list[Table], surfaces: dict[str, PlacedSurface], media: dict[str, Medium]) -> Path:
    """Steps written as { at = surface, do = interaction, into = medium }; `into` belongs to refractions only."""
    medium = AIR
    steps = []
    for entry in entries:
        surface = surfaces[named(entry, "at", "surface", surfaces)]
        interaction = Interaction(entry.text("do", choices=[str(each) for each in Interaction]))
        if interaction is Interaction.REFRACT:
            medium = media[named(entry, "into", "medium", media)]
        entry.finish()
        steps.append(Step(surface, interaction, medium))
    return Path(tuple(steps))


def _panel(table: Table, frame: FloatArray) -> PlacedPanel:
    counts = table.vector("pixels", 2)
    if not np.all((counts >= 1) & (counts == np.round(counts))):
        raise table.fail("'pixels' must be two whole numbers of at least 1, width and height.")
    size = MM * table.vector("size_mm", 2)
    if not np.all(size > 0):
        raise table.fail("'size_mm' must be positive.")
    pose = rigid(frame @ axes(table, "u_axis", "v_axis"), frame @ (MM * table.vector("centre_mm", 3)))
    curvature = table.vector("curvature_per_m", 2, default=(0.0, 0.0))
    panel = PlacedPanel(pose, size, Panel(int(counts[0]), int(counts[1])), curvature)
    table.finish()
    return panel


def _field(table: Table) -> FieldOfView | None:
    """Angles as the wearer has them, right and up positive, whatever the file's axes."""
    if not table.has("field_deg"):
        return None
    left, right, down, up = np.tan(np.deg2rad(table.vector("field_deg", 4)))
    if not (left < right and down < up):
        raise table.fail("'field_deg' must be left, right, down, up, each pair ascending; right and up are positive.")
    return FieldOfView(np.array([left, down]), np.array([right, up]))


def _eye_box(table: Table, frame: FloatArray) -> EyeBox:
    box = EyeBox(frame @ (MM * table.vector("centre_mm", 3)), MM * table.vector("size_mm", 3))
    if not np.all(box.size > 0):
        raise table.fail("'size_mm' must be positive.")
    table.finish()
    return box

"""Reads the surfaces of a device file: shape, place and clear aperture."""

import re

import numpy as np

from wlr_render.files import Table
from wlr_render.geometry.directions import normalised
from wlr_render.geometry.transforms import rigid, rotation_about
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device import ClearAperture, PlacedSurface
from wlr_render.optics.media import Medium
from wlr_render.optics.sag_surfaces import AnamorphicAsphere, AnamorphicTerm, Toroid, XYPolynomial
from wlr_render.optics.surfaces import Conic, Ellipsoid, Offset, Shape

MM = 1e-3
"""One millimetre in metres."""

_MIRROR_Y = np.diag([1.0, -1.0, 1.0])


def placed_surface(table: Table, frame: FloatArray, earlier: dict[str, PlacedSurface]) -> PlacedSurface:
    """Read one [[eye.surface]]; `frame` turns the file's axes into the device's, an offset names an earlier surface."""
    name = table.text("name")
    if name in earlier:
        raise table.fail(f"there is already a surface '{name}'; choose another name.")
    kind = table.text("shape", choices=[*_SHAPES, "offset"])
    aperture = _aperture(table)
    if kind == "offset":
        base = earlier[named(table, "of", "earlier surface", earlier)]
        shape: Shape = Offset(base.shape, MM * nonzero(table, "distance_mm"))
        placed = PlacedSurface(name, shape, base.device_from_surface, aperture)
    else:
        placed = PlacedSurface(name, _SHAPES[kind](table), _pose(table, frame), aperture)
    table.finish()
    return placed


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


def _conic(table: Table) -> Shape:
    return Conic(1.0 / (MM * nonzero(table, "radius_mm")), table.number("conic", default=0.0))


def _plane(_: Table) -> Shape:
    return Conic(0.0)


def _ellipsoid(table: Table) -> Shape:
    semi_axes = MM * table.vector("semi_axes_mm", 3)
    if not np.all(semi_axes > 0):
        raise table.fail("'semi_axes_mm' must be positive.")
    return Ellipsoid(semi_axes)


def _toroid(table: Table) -> Shape:
    return Toroid(MM * nonzero(table, "radius_x_mm"), MM * nonzero(table, "radius_y_mm"))


def _xy_polynomial(table: Table) -> Shape:
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


def _anamorphic(table: Table) -> Shape:
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


_SHAPES = {
    "plane": _plane,
    "conic": _conic,
    "ellipsoid": _ellipsoid,
    "toroid": _toroid,
    "xy_polynomial": _xy_polynomial,
    "anamorphic": _anamorphic,
}


def offset_chain(shape: Shape) -> list[Shape]:
    """The shape itself and, if it is an offset, its base, and so on."""
    return [shape, *offset_chain(shape.base)] if isinstance(shape, Offset) else [shape]


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

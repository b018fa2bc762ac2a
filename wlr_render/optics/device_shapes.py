"""Shapes of the surfaces in device files (devices/README.md), read and written."""

import re
from collections.abc import Callable
from typing import Any

import numpy as np

from wlr_render.io.input_files import require_length, shown
from wlr_render.io.toml_files import Table
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.sag_surfaces import (
    AnamorphicAsphere,
    AnamorphicTerm,
    Asphere,
    GaussianBump,
    SagSurface,
    SumOfProfiles,
    Toroid,
    XYPolynomial,
)
from wlr_render.optics.surfaces import Conic, Ellipsoid, Shape

MM = 1e-3
"""One millimetre in metres."""
FAR_MM = 2000.0
"""Largest distance of a part of a headset from the origin."""

Content = dict[str, Any]
"""A table of the file, in plain lists and numbers, so that two tables can be compared."""

_FLAT_MM = 1e12  # radius written for a practically flat surface
_HIGHEST_POWER = 20  # highest total power of x and y
_MOST_TERMS = 100


def length(table: Table, key: str, at_most_mm: float = FAR_MM) -> float:
    """Read a length other than 0 in metres; `key` is in millimetres."""
    value = table.number(key)
    if value == 0:
        raise table.fail(f"'{key}' must not be 0.")
    require_length(f"{table.where}: '{key}'", value, at_most_mm, "mm")
    return MM * value


def lengths(table: Table, key: str, size: int, at_most_mm: float = FAR_MM) -> FloatArray:
    """Read (size,) lengths in metres; `key` is in millimetres."""
    values = table.vector(key, size)
    require_length(f"{table.where}: '{key}'", values, at_most_mm, "mm")
    return MM * values


def in_mm(metres: FloatArray) -> list[float]:
    """Return lengths in millimetres, as they are written."""
    millimetres: list[float] = (metres / MM).tolist()
    return millimetres


def _radius(table: Table, key: str) -> float:
    """Read a radius as a curvature in 1/m."""
    return 1.0 / length(table, key, _FLAT_MM)


def _base_conic(table: Table) -> tuple[float, float]:
    """Return the curvature in 1/m and the conic of a base; zeros without a radius."""
    return (_radius(table, "radius_mm"), table.number("conic", default=0.0)) if table.has("radius_mm") else (0.0, 0.0)


def _base_conic_content(shape: Conic | Asphere | XYPolynomial) -> Content:
    return {"radius_mm": 1.0 / shape.curvature / MM, "conic": shape.conic} if shape.curvature else {}


def _ellipsoid(table: Table) -> Ellipsoid:
    semi_axes = lengths(table, "semi_axes_mm", 3, _FLAT_MM)
    if not np.all(semi_axes > 0):
        raise table.fail("'semi_axes_mm' must be positive.")
    return Ellipsoid(semi_axes)


def _terms(table: Table, powers_of: Callable[[Table, str], tuple[int, ...]], example: str) -> FloatArray:
    """Read the coefficients of `sag_mm` in metres, by the powers of their keys."""
    sag = table.table("sag_mm")
    powers = {key: powers_of(sag, key) for key in sag.keys()}  # noqa: SIM118 (a Table is no dictionary)
    if not powers:
        raise sag.fail(f"the coefficients are missing; give at least one, such as {example}.")
    coefficients = np.zeros(np.max(list(powers.values()), axis=0) + 1)
    for key, power in powers.items():
        coefficients[power] = sag.number(key) * MM ** (1 - sum(power))
    return coefficients


def _terms_content(coefficients: FloatArray, key_of: Callable[..., str], none: str) -> Content:
    """Return the non-zero coefficients by their keys; one zero term if all vanish."""
    powers = map(tuple, np.argwhere(coefficients).tolist())
    return {"sag_mm": {key_of(*p): float(coefficients[p]) / MM ** (1 - sum(p)) for p in powers} or {none: 0.0}}


def _powers(sag: Table, key: str) -> tuple[int, int]:
    """Return the powers of x and y in a key such as "x2y" or "y3"."""
    match = re.fullmatch(r"(?:x(\d*))?(?:y(\d*))?", key)
    if not key or match is None:
        raise sag.fail(f"{shown(key)} is not a term in x and y; write x2, xy3, y4 and so on.")
    m, n = (0 if power is None else int((power or "1")[:9]) for power in match.groups())
    if m + n > _HIGHEST_POWER:
        raise sag.fail(f"{shown(key)} is of order {m + n}; {_HIGHEST_POWER} is the highest that is read.")
    return m, n


def _key_of_powers(m: int, n: int) -> str:
    """Return the key of a term, such as x2y3 or y4; x0 for the constant."""
    return f"x{m}" * (m > 0) + f"y{n}" * (n > 0) or "x0"


def _power_of_r(sag: Table, key: str) -> tuple[int]:
    match = re.fullmatch(r"r(\d{1,2})", key)
    if match is None or not 2 <= int(match[1]) <= _HIGHEST_POWER:
        raise sag.fail(f"{shown(key)} is not a term of an asphere; write r2, r4 and so on, up to r{_HIGHEST_POWER}.")
    return (int(match[1]),)


def _biconic(table: Table) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the curvatures in 1/m and conics along x and y; a profile without a radius is straight."""
    keys = "radius_x_mm", "radius_y_mm"
    if not any(map(table.has, keys)):
        raise table.fail(f"neither {' nor '.join(keys)} is there; write at least one.")
    x, y = (_radius(table, key) if table.has(key) else 0.0 for key in keys)
    return (x, y), (table.number("conic_x", default=0.0), table.number("conic_y", default=0.0))


def _biconic_content(shape: AnamorphicAsphere | SumOfProfiles) -> Content:
    """Return the radii of the profiles that have one, and conics."""
    radii = {
        f"radius_{axis}_mm": 1.0 / curvature / MM
        for axis, curvature in zip("xy", shape.curvature, strict=True)
        if curvature
    }
    return radii | {"conic_x": shape.conic[0], "conic_y": shape.conic[1]}


def _anamorphic(table: Table) -> AnamorphicAsphere:
    terms = []
    for entry in table.tables("term", required=False, most=_MOST_TERMS):
        order = entry.number("order")
        if order not in (4, 6, 8, 10):
            raise entry.fail(f"'order' is {order:g}; it must be 4, 6, 8 or 10.")
        amplitude = entry.number("sag_mm") * MM ** (1 - order)
        terms.append(AnamorphicTerm(amplitude, entry.number("asymmetry", default=0.0), int(order) // 2))
        entry.finish()
    return AnamorphicAsphere(*_biconic(table), tuple(terms))


def _anamorphic_content(shape: AnamorphicAsphere) -> Content:
    terms = [
        {"order": 2 * each.power, "sag_mm": each.amplitude / MM ** (1 - 2 * each.power), "asymmetry": each.asymmetry}
        for each in shape.terms
    ]
    return _biconic_content(shape) | ({"term": terms} if terms else {})


_KINDS: dict[str, tuple[type, Callable[[Table], Shape], Callable[[Any], Content]]] = {
    "plane": (Conic, lambda _: Conic(0.0), lambda _: {}),
    "conic": (
        Conic,
        lambda table: Conic(_radius(table, "radius_mm"), table.number("conic", default=0.0)),
        _base_conic_content,
    ),
    "ellipsoid": (Ellipsoid, _ellipsoid, lambda shape: {"semi_axes_mm": in_mm(shape.semi_axes)}),
    "toroid": (
        Toroid,
        lambda table: Toroid(*(length(table, f"radius_{axis}_mm", _FLAT_MM) for axis in "xy")),
        lambda shape: {"radius_x_mm": shape.radius_x / MM, "radius_y_mm": shape.radius_y / MM},
    ),
    "asphere": (
        Asphere,
        lambda table: Asphere(tuple(_terms(table, _power_of_r, "r4")[2:].tolist()), *_base_conic(table)),
        lambda shape: (
            _base_conic_content(shape) | _terms_content(np.array([0.0, 0.0, *shape.coefficients]), "r{}".format, "r2")
        ),
    ),
    "xy_polynomial": (
        XYPolynomial,
        lambda table: XYPolynomial(_terms(table, _powers, "x2"), *_base_conic(table)),
        lambda shape: _base_conic_content(shape) | _terms_content(shape.coefficients, _key_of_powers, "x0"),
    ),
    "sum_of_profiles": (SumOfProfiles, lambda table: SumOfProfiles(*_biconic(table)), _biconic_content),
    "anamorphic": (AnamorphicAsphere, _anamorphic, _anamorphic_content),
    "bump": (
        GaussianBump,
        lambda table: GaussianBump(MM * table.number("height_mm"), MM * table.number("width_mm", above=0)),
        lambda shape: {"height_mm": shape.height / MM, "width_mm": shape.width / MM},
    ),
}
"""Class, reader and writer of each kind of shape."""

SHAPES = list(_KINDS)
"""Kinds of shapes that are stated without another surface."""
SAG_SHAPES = sorted(kind for kind, (shape, *_) in _KINDS.items() if issubclass(shape, SagSurface))
"""Kinds of shapes that are heights over x and y, as form errors are."""


def read_shape(table: Table, kind: str) -> Any:
    """Read the keys of one kind of shape."""
    return _KINDS[kind][1](table)


def shape_content(shape: Shape) -> Content:
    """Return the keys that `read_shape` reads, with the kind as `shape`."""
    for kind, (made, _, content) in _KINDS.items():
        if type(shape) is made and (kind != "plane" or shape == Conic(0.0)):
            return {"shape": kind} | content(shape)
    raise TypeError(f"a device file has no shape {type(shape).__name__}.")

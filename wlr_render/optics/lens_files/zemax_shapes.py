"""Shapes of the surfaces of Zemax lens files, by the type of surface."""

from collections.abc import Callable

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.optics.lens_files.sequence import conic_or_asphere
from wlr_render.optics.lens_files.zemax_lines import MOST_NUMBERED, SurfaceLines, ZemaxReading
from wlr_render.optics.sag_surfaces import AnamorphicAsphere, SumOfProfiles, Toroid, XYPolynomial
from wlr_render.optics.surfaces import Conic, Shape

_MOST_POWER = 20  # largest power of a coordinate in a device file
_NORMS = 1e-9, 1e9
_CONIC_WITHOUT_TERMS = {
    *("BINARY_1", "BINARY_2", "DGRATING", "FZERNPHA", "FZERNSAG", "IRREGULA", "QED_TYPE", "SZERNPHA", "SZERNSAG"),
    *("XODDASPH",),
}
"""Unsupported types that equal their conic if all their parameters are 0. Others, such as FRESNELS and PARAXIAL,
bend rays in another way even then."""


def shape_of(reading: ZemaxReading, surface: SurfaceLines, kind: str) -> Shape:
    """Return the shape of a surface by its type; an unsupported type is noted and replaced by its conic."""
    curvature, conic = reading.value(surface, "CURV"), reading.value(surface, "CONI")
    read = _SHAPES.get(kind)
    base = Conic(curvature / reading.unit, conic)
    if read is None:
        parameters = [*reading.numbered(surface, "PARM").values(), *reading.numbered(surface, "XDAT").values()]
        bends = kind not in _CONIC_WITHOUT_TERMS or any(parameters)
        reading.ignore(surface, "TYPE", kind, "this type is not read: its conic stands in its place", bends, "shape")
        return base
    return read(reading, surface, base)


def _even_asphere(reading: ZemaxReading, surface: SurfaceLines, base: Conic) -> Shape:
    values = reading.numbered(surface, "PARM")
    terms = [0.0] * (2 * max(values, default=1) - 1)
    for place, value in values.items():
        terms[2 * place - 2] = value
    return _asphere(reading, surface, base, terms)


def _odd_asphere(reading: ZemaxReading, surface: SurfaceLines, base: Conic) -> Shape:
    values = reading.numbered(surface, "PARM")
    if values.get(1, 0.0):
        reading.ignore(surface, "PARM 1", values[1], "the term in r, which makes a tip on the axis, is not read", True)
    return _asphere(reading, surface, base, [values.get(place, 0.0) for place in range(2, max(values, default=1) + 1)])


def _extended_asphere(reading: ZemaxReading, surface: SurfaceLines, base: Conic) -> Shape:
    """Return the terms of (r / normalisation)^2, ^4, ... from `XDAT`, added to the terms of an even asphere."""
    values = reading.numbered(surface, "XDAT")
    count, norm = _terms_and_norm(reading, surface, values)
    low = reading.numbered(surface, "PARM")
    terms = [0.0] * (2 * max(count, max(low, default=1)) - 1)
    for place, value in low.items():
        terms[2 * place - 2] += value
    for place in range(count):
        # Higher powers are left out, and would overflow.
        terms[2 * place] += values.get(3 + place, 0.0) / norm ** min(2 * place + 2, _MOST_POWER)
    return _asphere(reading, surface, base, terms)


def _terms_and_norm(reading: ZemaxReading, surface: SurfaceLines, values: dict[int, float]) -> tuple[int, float]:
    """Return the number of terms in `XDAT`, and the length that divides their coordinates."""
    norm = values.get(2, 1.0) or 1.0
    if not _NORMS[0] <= abs(norm) <= _NORMS[1]:
        raise BadInputError(
            f"{reading.path}: surface {surface.number}: XDAT 2 is {norm:g}; a normalisation radius lies between "
            f"{_NORMS[0]:g} and {_NORMS[1]:g} lens units: correct it."
        )
    return int(min(max(values.get(1, 0.0), 0.0), MOST_NUMBERED)), norm


def _asphere(reading: ZemaxReading, surface: SurfaceLines, base: Conic, terms: list[float]) -> Shape:
    if any(terms[_MOST_POWER - 1 :]):
        reading.ignore(
            surface, "terms", f"above r{_MOST_POWER}", "powers of r that a device file does not have are left out", True
        )
    return conic_or_asphere(base.curvature * reading.unit, base.conic, terms[: _MOST_POWER - 1], reading.unit)


def _biconic(reading: ZemaxReading, surface: SurfaceLines, base: Conic) -> Shape:
    """Read a biconic: `CURV` and `CONI` along y, the first two `PARM` radius and conic along x (radius 0: straight)."""
    values = reading.numbered(surface, "PARM")
    radius = reading.unit * values.get(1, 0.0)
    if not radius and not base.curvature:
        return base
    return AnamorphicAsphere((1.0 / radius if radius else 0.0, base.curvature), (values.get(2, 0.0), base.conic))


def _toroid(reading: ZemaxReading, surface: SurfaceLines, base: Conic) -> Shape:
    """Read a toroid: `CURV` along y, the first `PARM` the radius of rotation (0: a cylinder), then terms of y."""
    values = reading.numbered(surface, "PARM")
    radius = reading.unit * values.get(1, 0.0)
    further = {place: value for place, value in values.items() if place > 1 and value}
    if further:
        places = ", ".join(f"PARM {place}" for place in further)
        reading.ignore(surface, places, list(further.values()), "terms of y of a toroid are not read", True)
    if not radius:
        return SumOfProfiles((0.0, base.curvature), (0.0, base.conic)) if base.curvature else Conic(0.0)
    if not base.curvature:
        return SumOfProfiles((1.0 / radius, 0.0))
    if base.conic:
        reading.ignore(surface, "CONI", base.conic, "the conic of a toroid is not read: it is a circle", True)
    return Toroid(radius, 1.0 / base.curvature)


def _extended_polynomial(reading: ZemaxReading, surface: SurfaceLines, base: Conic) -> Shape:
    """Return the terms x, y, x^2, xy, y^2, ... of coordinates over the normalisation, from the third `XDAT` on."""
    values = reading.numbered(surface, "XDAT")
    count, norm = _terms_and_norm(reading, surface, values)
    coefficients = np.zeros((_MOST_POWER + 1, _MOST_POWER + 1))
    powers = [(order - n, n) for order in range(1, _MOST_POWER + 1) for n in range(order + 1)]
    if count > len(powers):
        reading.ignore(surface, "XDAT 1", count, f"only the terms up to order {_MOST_POWER} are read", True)
    for place, (m, n) in enumerate(powers[:count]):
        coefficients[m, n] = values.get(3 + place, 0.0) * reading.unit * (norm * reading.unit) ** (-m - n)
    if not coefficients.any():
        return base
    size = 1 + np.max(np.argwhere(coefficients), axis=0)
    return XYPolynomial(coefficients[: size[0], : size[1]], base.curvature, base.conic if base.curvature else 0.0)


_SHAPES: dict[str, Callable[[ZemaxReading, SurfaceLines, Conic], Shape]] = {
    "STANDARD": lambda reading, surface, base: base,
    "EVENASPH": _even_asphere,
    "ODDASPHE": _odd_asphere,
    "XASPHERE": _extended_asphere,
    "BICONICX": _biconic,
    "TOROIDAL": _toroid,
    "XPOLYNOM": _extended_polynomial,
}
"""Readers by type of surface; other types are read as their conic, with a note."""

"""Shapes of the surfaces of Zemax lens files, by the type of surface."""

from collections.abc import Callable

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.optics.lens_files.sequence import MOST_POWER, asphere, toroid
from wlr_render.optics.lens_files.zemax_lines import MOST_NUMBERED, ZemaxSurface
from wlr_render.optics.sag_surfaces import AnamorphicAsphere, XYPolynomial
from wlr_render.optics.surfaces import Conic, Shape

_NORMS = 1e-9, 1e9
_CONIC_WITHOUT_TERMS = {
    *("BINARY_1", "BINARY_2", "DGRATING", "FZERNPHA", "FZERNSAG", "IRREGULA", "QED_TYPE", "SZERNPHA", "SZERNSAG"),
    *("XODDASPH",),
}
"""Unsupported types that equal their conic if all their parameters are 0. Others, such as FRESNELS and PARAXIAL,
bend rays in another way even then."""


def shape_of(surface: ZemaxSurface, kind: str) -> Shape:
    """Return the shape of a surface by its type; an unsupported type is noted and replaced by its conic."""
    curvature, conic = surface.value("CURV"), surface.value("CONI")
    base = Conic(curvature / surface.reading.unit, conic)
    if kind in _SHAPES:
        return _SHAPES[kind](surface, base)
    bends = kind not in _CONIC_WITHOUT_TERMS or any(
        value for key in ("PARM", "XDAT") for value in surface.numbered(key).values()
    )
    surface.reading.ignore("TYPE", kind, "this type is not read: its conic stands in its place", bends, "shape")
    return base


def _even_asphere(surface: ZemaxSurface, base: Conic) -> Shape:
    return _asphere(surface, base, {2 * place: value for place, value in surface.numbered("PARM").items()})


def _odd_asphere(surface: ZemaxSurface, base: Conic) -> Shape:
    terms = surface.numbered("PARM")
    if tip := terms.pop(1, 0.0):
        surface.reading.ignore("PARM 1", tip, "the term in r, which makes a tip on the axis, is not read", True)
    return _asphere(surface, base, terms)


def _extended_asphere(surface: ZemaxSurface, base: Conic) -> Shape:
    """Return the terms of (r / normalisation)^2, ^4, ... from `XDAT`, added to the terms of an even asphere."""
    values = surface.numbered("XDAT")
    count, norm = _terms_and_norm(surface, values)
    terms = {2 * place: value for place, value in surface.numbered("PARM").items()}
    for power in range(2, 2 * count + 1, 2):
        # Higher powers are left out, and would overflow.
        term = values.get(2 + power // 2, 0.0) / norm ** min(power, MOST_POWER)
        terms[power] = terms.get(power, 0.0) + term
    return _asphere(surface, base, terms)


def _terms_and_norm(surface: ZemaxSurface, values: dict[int, float]) -> tuple[int, float]:
    """Return the number of terms in `XDAT`, and the length that divides their coordinates."""
    norm = values.get(2, 1.0) or 1.0
    if not _NORMS[0] <= abs(norm) <= _NORMS[1]:
        raise BadInputError(
            f"{surface.reading.path}: surface {surface.number}: XDAT 2 is {norm:g}; a normalisation radius lies "
            f"between {_NORMS[0]:g} and {_NORMS[1]:g} lens units: correct it."
        )
    return int(min(max(values.get(1, 0.0), 0.0), MOST_NUMBERED)), norm


def _asphere(surface: ZemaxSurface, base: Conic, terms: dict[int, float]) -> Shape:
    if any(term for power, term in terms.items() if power > MOST_POWER):
        reason = "powers of r that a device file does not have are left out"
        surface.reading.ignore("terms", f"above r{MOST_POWER}", reason, True)
    return asphere(base, terms, surface.reading.unit)


def _biconic(surface: ZemaxSurface, base: Conic) -> Shape:
    """Read a biconic: `CURV` and `CONI` along y, the first two `PARM` radius and conic along x (radius 0: straight)."""
    values = surface.numbered("PARM")
    radius = surface.reading.unit * values.get(1, 0.0)
    if not radius and not base.curvature:
        return base
    return AnamorphicAsphere((1.0 / radius if radius else 0.0, base.curvature), (values.get(2, 0.0), base.conic))


def _toroid(surface: ZemaxSurface, base: Conic) -> Shape:
    """Read a toroid: `CURV` along y, the first `PARM` the radius of rotation (0: a cylinder), then terms of y."""
    values = surface.numbered("PARM")
    radius = surface.reading.unit * values.get(1, 0.0)
    further = {place: value for place, value in values.items() if place > 1 and value}
    if further:
        places = ", ".join(f"PARM {place}" for place in further)
        surface.reading.ignore(places, list(further.values()), "terms of y of a toroid are not read", True)
    if radius and base.curvature and base.conic:
        surface.reading.ignore("CONI", base.conic, "the conic of a toroid is not read: it is a circle", True)
    return toroid((1.0 / radius if radius else 0.0, base.curvature), (0.0, base.conic))


def _extended_polynomial(surface: ZemaxSurface, base: Conic) -> Shape:
    """Return the terms x, y, x^2, xy, y^2, ... of coordinates over the normalisation, from the third `XDAT` on."""
    values, unit = surface.numbered("XDAT"), surface.reading.unit
    count, norm = _terms_and_norm(surface, values)
    coefficients = np.zeros((MOST_POWER + 1, MOST_POWER + 1))
    powers = [(order - n, n) for order in range(1, MOST_POWER + 1) for n in range(order + 1)]
    if count > len(powers):
        surface.reading.ignore("XDAT 1", count, f"only the terms up to order {MOST_POWER} are read", True)
    for place, (m, n) in enumerate(powers[:count]):
        coefficients[m, n] = values.get(3 + place, 0.0) * unit * (norm * unit) ** (-m - n)
    if not coefficients.any():
        return base
    size = 1 + np.max(np.argwhere(coefficients), axis=0)
    return XYPolynomial(coefficients[: size[0], : size[1]], base.curvature, base.conic if base.curvature else 0.0)


_SHAPES: dict[str, Callable[[ZemaxSurface, Conic], Shape]] = {
    "STANDARD": lambda surface, base: base,
    "EVENASPH": _even_asphere,
    "ODDASPHE": _odd_asphere,
    "XASPHERE": _extended_asphere,
    "BICONICX": _biconic,
    "TOROIDAL": _toroid,
    "XPOLYNOM": _extended_polynomial,
}
"""Readers by type of surface; other types are read as their conic, with a note."""

"""Shapes of the surfaces of Zemax lens files, by the type of surface."""

from collections.abc import Callable

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.optics.device_keys import MOST_POWER
from wlr_render.optics.lens_files.sequence import NORMS, conic, xy_powers
from wlr_render.optics.lens_files.zemax_lines import MOST_NUMBERED, ZemaxSurface
from wlr_render.optics.sag_surfaces import AnamorphicAsphere
from wlr_render.optics.surfaces import Conic, Shape

_CONIC_WITHOUT_TERMS = {
    *("BINARY_1", "BINARY_2", "DGRATING", "FZERNPHA", "FZERNSAG", "IRREGULA", "QED_TYPE", "SZERNPHA", "SZERNSAG"),
    *("XODDASPH",),
}
"""Unsupported types that equal their conic if all their parameters are 0. Other types, such as FRESNELS and
PARAXIAL, bend rays in another way even then."""


def shape_of(surface: ZemaxSurface, kind: str) -> Shape:
    """Return the shape of a surface by its type; an unsupported type is noted and replaced by its conic."""
    base = conic(surface.value("CURV") / surface.reading.unit, surface.value("CONI"))
    if kind in _SHAPES:
        return _SHAPES[kind](surface, base)
    bends = kind not in _CONIC_WITHOUT_TERMS or any(
        value for key in ("PARM", "XDAT") for value in surface.numbered(key).values()
    )
    surface.reading.unread_shape("TYPE", kind, bends)
    return base


def _even_asphere(surface: ZemaxSurface, base: Conic) -> Shape:
    terms = {2 * place: value for place, value in surface.numbered("PARM").items()}
    return surface.reading.asphere(base, terms, "PARM")


def _extended_asphere(surface: ZemaxSurface, base: Conic) -> Shape:
    """Return the terms of (r / normalisation)^2, ^4, ... from `XDAT`, added to the terms of an even asphere."""
    values = surface.numbered("XDAT")
    count, norm = _terms_and_norm(surface, values)
    terms = {2 * place: value for place, value in surface.numbered("PARM").items()}
    for power in range(2, 2 * count + 1, 2):
        # Higher powers would overflow, and are left out.
        term = values.get(2 + power // 2, 0.0) / norm ** min(power, MOST_POWER)
        terms[power] = terms.get(power, 0.0) + term
    return surface.reading.asphere(base, terms, "XDAT")


def _terms_and_norm(surface: ZemaxSurface, values: dict[int, float]) -> tuple[int, float]:
    """Return the number of terms in `XDAT`, and the length that divides their coordinates."""
    norm = values.get(2, 1.0) or 1.0
    if not NORMS[0] <= abs(norm) <= NORMS[1]:
        raise BadInputError(
            f"{surface.reading.path}: surface {surface.number}: XDAT 2 is {norm:g}; a normalisation radius lies "
            f"between {NORMS[0]:g} and {NORMS[1]:g} lens units: correct it."
        )
    return int(min(max(values.get(1, 0.0), 0.0), MOST_NUMBERED)), norm


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
    radius = surface.reading.unit * values.pop(1, 0.0)
    curvature = 1.0 / radius if radius else 0.0, base.curvature
    return surface.reading.toroid(curvature, (0.0, base.conic), list(values.values()), ("CONI", "PARM"))


def _extended_polynomial(surface: ZemaxSurface, base: Conic) -> Shape:
    """Return the terms x, y, x^2, xy, y^2, ... of coordinates over the normalisation, from the third `XDAT` on."""
    values = surface.numbered("XDAT")
    count, norm = _terms_and_norm(surface, values)
    terms = np.zeros((MOST_POWER + 1, MOST_POWER + 1))
    powers = xy_powers()
    if count > len(powers):
        surface.reading.ignore("XDAT 1", count, f"only the terms up to order {MOST_POWER} are read", True)
    for place, (m, n) in enumerate(powers[:count]):
        terms[m, n] = values.get(3 + place, 0.0) * norm ** (-m - n)
    return surface.reading.polynomial(base, terms, "XDAT")


_SHAPES: dict[str, Callable[[ZemaxSurface, Conic], Shape]] = {
    "STANDARD": lambda surface, base: base,
    "EVENASPH": _even_asphere,
    "ODDASPHE": lambda surface, base: surface.reading.asphere(base, surface.numbered("PARM"), "PARM"),
    "XASPHERE": _extended_asphere,
    "BICONICX": _biconic,
    "TOROIDAL": _toroid,
    "XPOLYNOM": _extended_polynomial,
}
"""Readers by type of surface; other types are read as their conic, with a note."""

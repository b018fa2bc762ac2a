"""Shapes of the surfaces of CODE V lens files, by the command that states the type of surface."""

import re

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.optics.device_keys import MOST_POWER
from wlr_render.optics.lens_files.codev_commands import CodevSurface, number_of
from wlr_render.optics.lens_files.sequence import NORMS, conic, xy_powers
from wlr_render.optics.sag_surfaces import AnamorphicAsphere, AnamorphicTerm
from wlr_render.optics.surfaces import Conic, Shape

_MM = 1e-3
_LETTERS = "ABCDEFGHJ"
"""Commands of the terms of an asphere in r^4, r^6, ... r^20."""
_TYPES = {"SPH", "CON", "ASP", "CYL", "XTO", "YTO", "AAS", "SPS", "SPL"}
_CONIC_WITHOUT_TERMS = {"SPS ZRN", "SPS ZFR", "SPS QBF", "SPS QCN", "SPS ASP"}
"""Unsupported types that equal their conic if all their coefficients are 0."""


def shape_of(surface: CodevSurface) -> Shape:
    """Return the shape of a surface; an unsupported type is noted and replaced by its conic.

    Raises:
        BadInputError: a value is not a number.
    """
    kind = next((key for key in reversed(surface.commands) if key.split()[0] in _TYPES), "SPH")
    surface.used.add(kind)
    curvature = _curvature(surface, "Y")
    if kind == "SPH":
        return Conic(curvature)
    if kind == "AAS":
        return _anamorphic(surface, curvature)
    if kind in ("CYL", "XTO", "YTO"):
        return _toroid(surface, curvature, kind)
    if not kind.startswith("SP"):
        terms = {2 * place: surface.value(key) for place, key in enumerate(_LETTERS, 2) if kind == "ASP"}
        return surface.reading.asphere(conic(curvature, surface.value("K")), terms, "A to J")
    constant = surface.value("SCO K") or surface.value("SCO C1")
    if kind in ("SPS ODD", "SPS XYP"):
        return (_odd if kind == "SPS ODD" else _polynomial)(surface, conic(curvature, constant), kind)
    coefficients = [key for key in surface.commands if key.startswith("SCO ")]
    bends = kind not in _CONIC_WITHOUT_TERMS or any(
        surface.value(key) for key in coefficients if key not in ("SCO K", "SCO C1", "SCO NRADIUS")
    )
    surface.used.update(coefficients)
    surface.reading.unread_shape(kind.split()[0], kind.split()[-1], bends)
    return conic(curvature, constant)


def _curvature(surface: CodevSurface, axis: str) -> float:
    """Return the curvature along an axis in 1/m, from the last command that states it, or from the line S for y."""
    keys = [key for key in surface.commands if key in (f"CU{axis}", f"RD{axis}")]
    if keys:
        surface.used.update(keys)
        value, is_radius = surface.value(keys[-1]), keys[-1].startswith("RD")
    elif axis == "X":
        surface.reading.ignore("CUX", "not stated", "the surface is straight along x", True)
        return 0.0
    else:
        value = number_of(surface.reading, surface.line, surface.line.words[1:], 0)
        is_radius = surface.has_radius
    if is_radius:
        return 1.0 / (surface.reading.unit * value) if value else 0.0
    return value / surface.reading.unit


def _anamorphic(surface: CodevSurface, curvature: float) -> Shape:
    scale = surface.reading.unit / _MM
    terms = []
    for order, letter in zip((4, 6, 8, 10), "ABCD", strict=True):
        sag, asymmetry = surface.value(f"{letter}R"), surface.value(f"{letter}P")
        if sag:
            terms.append(AnamorphicTerm(order, sag * scale ** (1 - order), asymmetry))
    conics = surface.value("KX"), surface.value("KY")
    return AnamorphicAsphere((_curvature(surface, "X"), curvature), conics, tuple(terms))


def _toroid(surface: CodevSurface, curvature: float, kind: str) -> Shape:
    """Read a profile along y (along x for `XTO`), rotated about an axis parallel to it."""
    curvatures = _curvature(surface, "X"), curvature
    if kind != "YTO" and all(curvatures):
        surface.reading.ignore(kind, kind, "taken as a profile along y, rotated about an axis along y", True)
    constant = surface.value("K")
    conics = (constant, 0.0) if kind == "XTO" else (0.0, constant)
    return surface.reading.toroid(curvatures, conics, [surface.value(key) for key in "ABCD"], ("K", "A to D"))


def _norm(surface: CodevSurface, kind: str) -> float:
    """Return the length that divides the coordinates: 1 if it is missing or 0."""
    key = "SCO NRADIUS" if "SCO NRADIUS" in surface.commands else kind
    norm = surface.value(key) if surface.words(key) else 0.0
    if norm and not NORMS[0] <= abs(norm) <= NORMS[1]:
        raise BadInputError(
            f"{surface.reading.path}: line {surface.commands[key].line}: NRADIUS is {norm:g}; a normalisation radius "
            f"lies between {NORMS[0]:g} and {NORMS[1]:g} lens units: correct it."
        )
    return norm or 1.0


def _odd(surface: CodevSurface, base: Conic, kind: str) -> Shape:
    """Read the terms r, r^2, ...: `AR1`, `AR2`, ... or `C2`, `C3`, ..."""
    norm, terms = _norm(surface, kind), {}
    for key in list(surface.commands):
        if match := re.fullmatch(r"SCO (AR|C)(\d{1,2})", key):
            power = int(match[2]) - (match[1] == "C")
            if 1 <= power <= 30:
                # Higher powers would overflow, and are left out.
                terms[power] = surface.value(key) / norm ** min(power, MOST_POWER)
    return surface.reading.asphere(base, terms, "SCO")


def _polynomial(surface: CodevSurface, base: Conic, kind: str) -> Shape:
    """Read the terms x, y, x^2, xy, y^2, ... of coordinates over the normalisation: `C2`, `C3`, ... or `X`, `X2Y`."""
    norm, powers = _norm(surface, kind), xy_powers()
    terms = np.zeros((MOST_POWER + 1, MOST_POWER + 1))
    for key in list(surface.commands):
        if match := re.fullmatch(r"SCO C(\d{1,3})", key):
            place = int(match[1]) - 2
        elif (match := re.fullmatch(r"SCO (?=.)(X\d{0,2})?(Y\d{0,2})?", key)) is not None:
            m, n = (int(each[1:] or 1) if each else 0 for each in match.groups())
            place = powers.index((m, n)) if (m, n) in powers else -1
        else:
            continue
        if 0 <= place < len(powers):
            m, n = powers[place]
            terms[m, n] = surface.value(key) * norm ** (-m - n)
    return surface.reading.polynomial(base, terms, "SCO")

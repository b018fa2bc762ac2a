"""Read Zemax lens files (.zmx): text, sequential mode."""

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.geometry.transforms import rigid, rotation_about
from wlr_render.input_files import LIMITS, read_bytes, shown
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device import ClearAperture
from wlr_render.optics.lens_files.glass_catalogues import (
    GlassCatalogue,
    model_glass,
    unknown_glass_remedy,
)
from wlr_render.optics.lens_files.lens_text import decode_lens_text, lines_of
from wlr_render.optics.lens_files.sequence import (
    UNITS_M,
    LensFile,
    LensSurface,
    Notes,
    Part,
    box_aperture,
    conic_or_asphere,
    finite,
    ignore,
    require_surfaces,
    shift,
)
from wlr_render.optics.media import AIR, Medium
from wlr_render.optics.sag_surfaces import AnamorphicAsphere, SumOfProfiles, Toroid, XYPolynomial
from wlr_render.optics.surfaces import Conic, Shape

_KIND = "a Zemax lens file"
_TAKEN = {
    "TYPE",
    "CURV",
    "CONI",
    "DISZ",
    "GLAS",
    "STOP",
    "COMM",
    "PARM",
    "XDAT",
    "DIAM",
    "CLAP",
    "FLAP",
    "SQAP",
    "ELAP",
    "OBDC",
}
_HARMLESS = {
    *("HIDE", "MIRR", "SLAB", "POPS", "MEMA", "VDSZ", "FIMP", "BLNK", "PPAR", "PKUP", "VPAR", "COAT", "EDGE", "MAZH"),
    *("OPDX", "SCOL", "SDMA", "PZUP", "TCED", "CSOP", "GCOL", "RSCE", "VCON", "MEAS"),
}
"""Keys of a surface that say how it is drawn, coated, solved for or optimised."""
_BENDING_KEYS = {
    "SCBD": (3, "a tilt or shift of the surface's properties is not read: write a coordinate break"),
    "IGNR": (0, "the file ignores this surface, which is taken: delete it from the file"),
}
"""Keys of a surface that are not read, and bend rays if one of their numbers from a place on is not 0."""
_NOT_STATED = (1.5, 40.0), (0.0, 0.0)
"""Index and Abbe number of a `GLAS` line that does not state them."""
_CONIC_WITHOUT_TERMS = {
    *("BINARY_1", "BINARY_2", "DGRATING", "FZERNPHA", "FZERNSAG", "IRREGULA", "QED_TYPE", "SZERNPHA", "SZERNSAG"),
    *("XODDASPH",),
}
"""Types that are not read and are their conic if all their parameters are 0. Others, such as FRESNELS and PARAXIAL,
bend rays in another way even then."""
_MODEL_GLASS = "1"
_ROOM = 20.0, 1.0
"""Temperature in degrees Celsius and pressure in atmospheres that the indices of catalogues are stated for."""
_MOST_POWER = 20
_NORMS = 1e-9, 1e9
_MOST_NUMBERED = 500  # parameters of a surface


@dataclass
class _Lines:
    """The lines of one surface: words after each key, with the line's number."""

    number: int
    lines: list[tuple[str, list[str], int]] = field(default_factory=list)

    def last(self, key: str) -> tuple[list[str], int] | None:
        """Words and line number of the last line with a key."""
        found = [(words, line) for each, words, line in self.lines if each == key]
        return found[-1] if found else None


@dataclass
class _Reading:
    """The state of reading one file."""

    path: Path
    catalogue: GlassCatalogue
    unit: float = 1e-3
    manufacturers: tuple[str, ...] = ()
    notes: Notes = field(default_factory=list)
    unknown_glasses: dict[str, list[int]] = field(default_factory=dict)

    def number(self, words: list[str], place: int, line: int, key: str, infinite: bool = False) -> float:
        """A number of a line, with a point or a comma."""
        word = words[place].replace(",", ".") if place < len(words) else ""
        word = "inf" if infinite and word.upper() == "INFINITY" else word
        return finite(word, f"{self.path}: line {line}: value {place + 1} of {key}", infinite)

    def value(self, surface: _Lines, key: str, default: float = 0.0, infinite: bool = False) -> float:
        """The first number of a surface's key."""
        found = surface.last(key)
        return default if found is None else self.number(*found[:1], 0, found[1], key, infinite)

    def numbered(self, surface: _Lines, key: str) -> dict[int, float]:
        """The values of `PARM` or `XDAT`, by their number."""
        values = {}
        for each, words, line in surface.lines:
            if each == key:
                place = self.number(words, 0, line, key)
                if not 0 <= place <= _MOST_NUMBERED:
                    raise BadInputError(f"{self.path}: line {line}: {key} has the number {place:g}; correct it.")
                values[int(place)] = self.number(words, 1, line, key)
        values.pop(0, None)  # means nothing to any surface that is read
        return values

    def ignore(
        self,
        surface: _Lines | None,
        key: str,
        value: object,
        reason: str,
        bends_rays: bool = False,
        part: Part = "other",
    ) -> None:
        """Note a key of a surface, or of the head, that is not read as it stands."""
        ignore(self.notes, None if surface is None else surface.number, key, value, reason, bends_rays, part)


def read_zemax(path: Path, catalogue: GlassCatalogue) -> LensFile:
    """Read a .zmx file of sequential mode.

    Raises:
        BadInputError: the file is not one, is not sequential, has a value that is not a number, or names a
            glass that is in no catalogue.
    """
    reading = _Reading(path, catalogue)
    header, surfaces = _split(path, decode_lens_text(path, read_bytes(path, LIMITS.text_bytes), _KIND))
    require_surfaces(path, len(surfaces))
    title = _read_header(reading, header)
    taken: list[LensSurface] = []
    pose, medium = np.eye(4), AIR
    for surface in surfaces:
        _list_other_keys(reading, surface)
        kind = _kind(surface)
        thickness = reading.unit * reading.value(surface, "DISZ", 0.0, infinite=surface.number == 0)
        if kind == "COORDBRK":
            pose = pose @ _coordinate_break(reading, surface) @ shift(z=thickness)
            continue
        reflects, medium = _glass(reading, surface, medium)
        # The object stands before the first surface, where the file's frame begins.
        placed = pose @ shift(z=-thickness) if surface.number == 0 and np.isfinite(thickness) else pose
        taken.append(
            LensSurface(
                surface.number,
                " ".join((surface.last("COMM") or ([], 0))[0])[:100],
                _shape(reading, surface, kind),
                np.full((4, 4), np.nan) if np.isinf(thickness) else placed,
                medium,
                reflects,
                surface.last("STOP") is not None,
                _aperture(reading, surface),
                reading.unit * reading.value(surface, "DIAM", np.nan) if surface.last("DIAM") else np.nan,
            )
        )
        if surface.number:
            pose = pose @ shift(z=thickness)
    _refuse_unknown_glasses(reading)
    return LensFile(title, tuple(taken), tuple(reading.notes))


def _split(path: Path, text: str) -> tuple[dict[str, tuple[list[str], int]], list[_Lines]]:
    """Keys of the head, and the lines of each surface."""
    header: dict[str, tuple[list[str], int]] = {}
    surfaces: list[_Lines] = []
    within = False
    for number, line in enumerate(lines_of(text), 1):
        key, *words = line.split() or [""]
        if key == "SURF":
            found = words[0] if words else ""
            if found != str(len(surfaces)):
                raise BadInputError(f"{path}: line {number}: surface {shown(found)} follows {len(surfaces) - 1}.")
            surfaces.append(_Lines(len(surfaces)))
            within = True
        elif surfaces and key and (key in _TAKEN or (within and line[:1].isspace())):
            surfaces[-1].lines.append((key, words, number))
        elif key:
            within = False
            header.setdefault(key, (words, number))
    if not surfaces:
        raise BadInputError(f"{path}: has no line 'SURF', so this is not {_KIND}; name a .zmx file saved as text.")
    return header, surfaces


def _read_header(reading: _Reading, header: dict[str, tuple[list[str], int]]) -> str:
    words, line = header.get("MODE", (["SEQ"], 0))
    if words[:1] != ["SEQ"]:
        raise BadInputError(
            f"{reading.path}: line {line}: MODE is {shown(' '.join(words))}; only sequential files (SEQ) can be read."
        )
    words, line = header.get("UNIT", (["MM"], 0))
    name = words[0].lower() if words else ""
    if name not in UNITS_M:
        raise BadInputError(f"{reading.path}: line {line}: UNIT is {shown(name)}; it must be MM, CM, IN or METER.")
    reading.unit = UNITS_M[name]
    reading.manufacturers = tuple(header.get("GCAT", ([], 0))[0])
    words, line = header.get("MNUM", (["1"], 0))
    if words and words[0].isdecimal() and int(words[0]) > 1:
        reading.ignore(
            None, "MNUM", words[0], "the file has several configurations; the one saved as current is taken", True
        )
    _note_environment(reading, header)
    return " ".join(header.get("NAME", ([], 0))[0])[:200]


def _note_environment(reading: _Reading, header: dict[str, tuple[list[str], int]]) -> None:
    """Note a temperature and pressure at which the glasses have other indices than in their catalogues."""
    words, line = header.get("ENVD", ([], 0))
    if len(words) > 1 and tuple(reading.number(words, place, line, "ENVD") for place in (0, 1)) != _ROOM:
        reason = "the indices are those at 20 degrees Celsius and 1 atmosphere; another environment is not read"
        reading.ignore(None, "ENVD", " ".join(words), reason, True)


def _kind(surface: _Lines) -> str:
    found = surface.last("TYPE")
    return found[0][0].upper() if found and found[0] else "STANDARD"


def _list_other_keys(reading: _Reading, surface: _Lines) -> None:
    """Note the keys that are not read, unless they say nothing about the rays."""
    for key, words, _ in surface.lines:
        if key in _TAKEN or key in _HARMLESS:
            continue
        first, reason = _BENDING_KEYS.get(key, (len(words), ""))
        bends = any(word.strip("-+0.eE") for word in words[first:])
        reading.ignore(surface, key, " ".join(words), reason if bends else "this key is not read", bends)


def _coordinate_break(reading: _Reading, surface: _Lines) -> FloatArray:
    """Shift, then turns about the new x, y and z, or with a flag in the opposite order."""
    values = reading.numbered(surface, "PARM")
    x, y, *degrees = (values.get(place, 0.0) for place in range(1, 6))
    about_x, about_y, about_z = (rotation_about(axis, np.deg2rad(a)) for axis, a in zip("xyz", degrees, strict=True))
    shifted = shift(reading.unit * x, reading.unit * y)
    if values.get(6, 0.0) == 0.0:
        return shifted @ rigid(about_x @ about_y @ about_z, np.zeros(3))
    return rigid(about_z @ about_y @ about_x, np.zeros(3)) @ shifted


def _glass(reading: _Reading, surface: _Lines, before: Medium) -> tuple[bool, Medium]:
    """Return whether the surface is a mirror, and the medium behind it."""
    found = surface.last("GLAS")
    if found is None or not found[0]:
        return False, AIR
    words, line = found
    name = words[0]
    if name.upper() == "MIRROR":
        return True, before
    model = words[1:2] == [_MODEL_GLASS] or re.fullmatch("_+BLANK", name.upper()) is not None
    glass = None if model else reading.catalogue.find(name, reading.manufacturers)
    if glass is not None:
        glass.tell(reading.notes, surface.number, "GLAS", name)
        return False, glass.medium
    medium = _stated_glass(reading, surface, words, line, model)
    if medium is None:
        reading.unknown_glasses.setdefault(name, []).append(surface.number)
        return False, Medium(name)
    return False, medium


def _stated_glass(reading: _Reading, surface: _Lines, words: list[str], line: int, model: bool) -> Medium | None:
    """The glass by the index and Abbe number in its line, or by a name of six digits; None without them."""
    name, where = words[0], f"{reading.path}: line {line}: glass {shown(words[0])}"
    if len(words) > 4:
        index, abbe = (reading.number(words, place, line, "GLAS") for place in (3, 4))
        deviation = reading.number(words, 5, line, "GLAS") if len(words) > 5 else 0.0
        if model:
            return model_glass(index, abbe, where, deviation=deviation)
        if (index, abbe) not in _NOT_STATED:
            reason = f"in no catalogue: taken by its index {index:g} and Abbe number {abbe:g}"
            reading.ignore(surface, "GLAS", name, reason, part="glass")
            return model_glass(index, abbe, where, name, deviation)
    if re.fullmatch(r"\d{6}", name) is None:
        return None
    index, abbe = 1.0 + int(name[:3]) / 1000.0, int(name[3:]) / 10.0
    reason = f"a six-digit code: taken by its index {index:g} and Abbe number {abbe:g}"
    reading.ignore(surface, "GLAS", name, reason, part="glass")
    return model_glass(index, abbe, where)


def _refuse_unknown_glasses(reading: _Reading) -> None:
    if reading.unknown_glasses:
        names = "; ".join(
            f"{name} (surface {', '.join(map(str, numbers))})" for name, numbers in reading.unknown_glasses.items()
        )
        raise BadInputError(f"{reading.path}: no catalogue has these glasses: {names[:300]}. {unknown_glass_remedy()}")


def _aperture(reading: _Reading, surface: _Lines) -> ClearAperture:
    """The aperture that stops rays: circles by the square around them."""
    x, y = 0.0, 0.0
    if found := surface.last("OBDC"):
        x, y = (reading.number(found[0], place, found[1], "OBDC") for place in (0, 1))
    for key in ("CLAP", "FLAP", "SQAP", "ELAP"):
        if found := surface.last(key):
            first, second = (reading.number(found[0], place, found[1], key) for place in (0, 1))
            half = (first, second) if key in ("SQAP", "ELAP") else (second, second)
            if key == "ELAP":
                reading.ignore(surface, key, f"{first:g} {second:g}", "an ellipse: the rectangle around it is clear")
            elif key != "SQAP":
                reading.ignore(surface, key, f"{second:g}", "a circle: the square around it is the clear aperture")
                if first > 0:
                    reading.ignore(surface, key, f"{first:g}", "inner radius of a ring: rays pass its middle")
            if min(half) <= 0:
                continue
            scaled = np.array(half) * reading.unit
            centre = reading.unit * np.array([x, y])
            return box_aperture((centre - scaled).tolist(), (centre + scaled).tolist())
    return box_aperture((-np.inf, -np.inf), (np.inf, np.inf))


def _shape(reading: _Reading, surface: _Lines, kind: str) -> Shape:
    curvature, conic = reading.value(surface, "CURV"), reading.value(surface, "CONI")
    read = _SHAPES.get(kind)
    base = Conic(curvature / reading.unit, conic)
    if read is None:
        parameters = [*reading.numbered(surface, "PARM").values(), *reading.numbered(surface, "XDAT").values()]
        bends = kind not in _CONIC_WITHOUT_TERMS or any(parameters)
        reading.ignore(surface, "TYPE", kind, "this type is not read: its conic stands in its place", bends, "shape")
        return base
    return read(reading, surface, base)


def _even_asphere(reading: _Reading, surface: _Lines, base: Conic) -> Shape:
    values = reading.numbered(surface, "PARM")
    terms = [0.0] * (2 * max(values, default=1) - 1)
    for place, value in values.items():
        terms[2 * place - 2] = value
    return _asphere(reading, surface, base, terms)


def _odd_asphere(reading: _Reading, surface: _Lines, base: Conic) -> Shape:
    values = reading.numbered(surface, "PARM")
    if values.get(1, 0.0):
        reading.ignore(surface, "PARM 1", values[1], "the term in r, which makes a tip on the axis, is not read", True)
    return _asphere(reading, surface, base, [values.get(place, 0.0) for place in range(2, max(values, default=1) + 1)])


def _extended_asphere(reading: _Reading, surface: _Lines, base: Conic) -> Shape:
    """Terms of (r / normalisation)^2, ^4, ... from `XDAT`, added to the terms of an even asphere."""
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


def _terms_and_norm(reading: _Reading, surface: _Lines, values: dict[int, float]) -> tuple[int, float]:
    """Number of terms in `XDAT`, and the length that divides their coordinates."""
    norm = values.get(2, 1.0) or 1.0
    if not _NORMS[0] <= abs(norm) <= _NORMS[1]:
        raise BadInputError(
            f"{reading.path}: surface {surface.number}: XDAT 2 is {norm:g}; a normalisation radius lies between "
            f"{_NORMS[0]:g} and {_NORMS[1]:g} lens units: correct it."
        )
    return int(min(max(values.get(1, 0.0), 0.0), _MOST_NUMBERED)), norm


def _asphere(reading: _Reading, surface: _Lines, base: Conic, terms: list[float]) -> Shape:
    if any(terms[_MOST_POWER - 1 :]):
        reading.ignore(
            surface, "terms", f"above r{_MOST_POWER}", "powers of r that a device file does not have are left out", True
        )
    return conic_or_asphere(base.curvature * reading.unit, base.conic, terms[: _MOST_POWER - 1], reading.unit)


def _biconic(reading: _Reading, surface: _Lines, base: Conic) -> Shape:
    """`CURV` and `CONI` are along y, the first two `PARM` radius and conic along x; a radius of 0 is straight."""
    values = reading.numbered(surface, "PARM")
    radius = reading.unit * values.get(1, 0.0)
    if not radius and not base.curvature:
        return base
    return AnamorphicAsphere((1.0 / radius if radius else 0.0, base.curvature), (values.get(2, 0.0), base.conic))


def _toroid(reading: _Reading, surface: _Lines, base: Conic) -> Shape:
    """`CURV` is along y, the first `PARM` the radius of rotation, 0 for a cylinder; further ones terms of y."""
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


def _extended_polynomial(reading: _Reading, surface: _Lines, base: Conic) -> Shape:
    """Terms x, y, x^2, xy, y^2, ... of coordinates over the normalisation, from the third `XDAT` on."""
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


_SHAPES: dict[str, Callable[[_Reading, _Lines, Conic], Shape]] = {
    "STANDARD": lambda reading, surface, base: base,
    "EVENASPH": _even_asphere,
    "ODDASPHE": _odd_asphere,
    "XASPHERE": _extended_asphere,
    "BICONICX": _biconic,
    "TOROIDAL": _toroid,
    "XPOLYNOM": _extended_polynomial,
}
"""By type of surface; all others are read as their conic, and noted."""

"""Read Zemax lens files (.zmx): text, sequential mode."""

import re
from pathlib import Path

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.geometry.transforms import rigid, rotation_about
from wlr_render.io.input_files import shown
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device import ClearAperture
from wlr_render.optics.lens_files.glass_catalogues import GlassCatalogue, model_glass
from wlr_render.optics.lens_files.sequence import UNITS_M, LensFile, LensSurface, box_aperture, require_surfaces, shift
from wlr_render.optics.lens_files.zemax_lines import ZemaxReading, ZemaxSurface
from wlr_render.optics.lens_files.zemax_shapes import shape_of
from wlr_render.optics.media import AIR, Medium

_KIND = "a Zemax lens file"
_TAKEN = {
    *("TYPE", "CURV", "CONI", "DISZ", "GLAS", "STOP", "COMM", "PARM", "XDAT", "DIAM", "CLAP", "FLAP", "SQAP", "ELAP"),
    "OBDC",
}
_HARMLESS = {
    *("HIDE", "MIRR", "SLAB", "POPS", "MEMA", "VDSZ", "FIMP", "BLNK", "PPAR", "PKUP", "VPAR", "COAT", "EDGE", "MAZH"),
    *("OPDX", "SCOL", "SDMA", "PZUP", "TCED", "CSOP", "GCOL", "RSCE", "VCON", "MEAS", "OEMA", "SSID"),
}
"""Keys of a surface for drawing, coating, solves and optimisation."""
_BENDING_KEYS = {
    "SCBD": (3, "a tilt or shift of the surface's properties is not read: write a coordinate break"),
    "IGNR": (0, "the file ignores this surface, which is taken: delete it from the file"),
}
"""Unread keys of a surface, by the index from which on a number other than 0 bends rays."""
_NOT_STATED = (1.5, 40.0), (0.0, 0.0)
"""Default index and Abbe number of a `GLAS` line."""
_MODEL_GLASS = "1"
_ROOM = 20.0, 1.0
"""Temperature in degrees Celsius and pressure in atmospheres for which catalogues state indices."""


def read_zemax(path: Path, lines: list[str], catalogue: GlassCatalogue) -> LensFile:
    """Read the lines of a .zmx file of sequential mode.

    Raises:
        BadInputError: the file is not a Zemax file, is not sequential, has a value that is not a number, or names a
            glass that no catalogue has.
    """
    reading = ZemaxReading(path, catalogue)
    header, surfaces = _split(reading, lines)
    require_surfaces(path, len(surfaces))
    title = _read_header(reading, header)
    taken: list[LensSurface] = []
    pose, medium = np.eye(4), AIR
    for surface in surfaces:
        reading.surface = surface.number
        _list_other_keys(surface)
        kind = _kind(surface)
        thickness = reading.unit * surface.value("DISZ", infinite=surface.number == 0)
        if kind == "COORDBRK":
            pose = pose @ _coordinate_break(surface) @ shift(z=thickness)
            continue
        reflects, medium = _glass(surface, medium)
        # The object lies before the first surface, where the file's frame begins.
        placed = pose @ shift(z=-thickness) if surface.number == 0 and np.isfinite(thickness) else pose
        taken.append(
            LensSurface(
                surface.number,
                " ".join((surface.last("COMM") or ([], 0))[0])[:100],
                shape_of(surface, kind),
                np.full((4, 4), np.nan) if np.isinf(thickness) else placed,
                medium,
                reflects,
                surface.last("STOP") is not None,
                _aperture(surface),
                reading.unit * surface.value("DIAM", np.nan),
            )
        )
        if surface.number:
            pose = pose @ shift(z=thickness)
    return reading.lens_file(title, taken)


def _split(reading: ZemaxReading, lines: list[str]) -> tuple[dict[str, tuple[list[str], int]], list[ZemaxSurface]]:
    """Return the keys of the header, and the lines of each surface."""
    header: dict[str, tuple[list[str], int]] = {}
    surfaces: list[ZemaxSurface] = []
    within, path = False, reading.path
    for number, line in enumerate(lines, 1):
        key, *words = line.split() or [""]
        if key == "SURF":
            stated = words[0] if words else ""
            if stated != str(len(surfaces)):
                raise BadInputError(f"{path}: line {number}: surface {shown(stated)} follows {len(surfaces) - 1}.")
            surfaces.append(ZemaxSurface(reading, len(surfaces)))
            within = True
        elif surfaces and key and (key in _TAKEN or (within and line[:1].isspace())):
            surfaces[-1].lines.append((key, words, number))
        elif key:
            within = False
            header.setdefault(key, (words, number))
    if not surfaces:
        raise BadInputError(f"{path}: has no line 'SURF', so this is not {_KIND}; name a .zmx file saved as text.")
    return header, surfaces


def _read_header(reading: ZemaxReading, header: dict[str, tuple[list[str], int]]) -> str:
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
        reading.ignore("MNUM", words[0], "the file has several configurations; the one saved as current is taken", True)
    _note_environment(reading, header)
    return " ".join(header.get("NAME", ([], 0))[0])[:200]


def _note_environment(reading: ZemaxReading, header: dict[str, tuple[list[str], int]]) -> None:
    """Note a temperature and pressure at which the indices differ from the catalogues."""
    words, line = header.get("ENVD", ([], 0))
    if len(words) > 1 and tuple(reading.number(words, place, line, "ENVD") for place in (0, 1)) != _ROOM:
        reading.other_environment("ENVD", " ".join(words))


def _kind(surface: ZemaxSurface) -> str:
    last = surface.last("TYPE")
    return last[0][0].upper() if last and last[0] else "STANDARD"


def _list_other_keys(surface: ZemaxSurface) -> None:
    """Note the keys that are not read, unless they do not affect rays."""
    for key, words, _ in surface.lines:
        if key in _TAKEN or key in _HARMLESS:
            continue
        first, reason = _BENDING_KEYS.get(key, (len(words), ""))
        bends = any(word.strip("-+0.eE") for word in words[first:])
        surface.reading.ignore(key, " ".join(words), reason if bends else "this key is not read", bends)


def _coordinate_break(surface: ZemaxSurface) -> FloatArray:
    """Return the pose of a coordinate break: shift, then rotations about x, y and z; with a flag, in reverse order."""
    values, unit = surface.numbered("PARM"), surface.reading.unit
    x, y, *degrees = (values.get(place, 0.0) for place in range(1, 6))
    about_x, about_y, about_z = (rotation_about(axis, np.deg2rad(a)) for axis, a in zip("xyz", degrees, strict=True))
    shifted = shift(unit * x, unit * y)
    if values.get(6, 0.0) == 0.0:
        return shifted @ rigid(about_x @ about_y @ about_z, np.zeros(3))
    return rigid(about_z @ about_y @ about_x, np.zeros(3)) @ shifted


def _glass(surface: ZemaxSurface, before: Medium) -> tuple[bool, Medium]:
    """Return whether the surface is a mirror, and the medium behind it."""
    entry, reading = surface.last("GLAS"), surface.reading
    if entry is None or not entry[0]:
        return False, AIR
    words, line = entry
    name = words[0]
    if name.upper() == "MIRROR":
        return True, before
    is_model = words[1:2] == [_MODEL_GLASS] or re.fullmatch("_+BLANK", name.upper()) is not None
    medium = None if is_model else reading.glass("GLAS", name, reading.manufacturers)
    return False, medium or _stated_glass(reading, words, line, is_model) or reading.unknown_glass(name)


def _stated_glass(reading: ZemaxReading, words: list[str], line: int, is_model: bool) -> Medium | None:
    """Return the glass from the index and Abbe number in its line, or from a six-digit name; None without them."""
    name, where = words[0], f"{reading.path}: line {line}: glass {shown(words[0])}"
    if len(words) > 4:
        index, abbe = (reading.number(words, place, line, "GLAS") for place in (3, 4))
        deviation = reading.number(words, 5, line, "GLAS") if len(words) > 5 else 0.0
        if is_model:
            return model_glass(index, abbe, where, deviation=deviation)
        if (index, abbe) not in _NOT_STATED:
            reason = f"in no catalogue: taken by its index {index:g} and Abbe number {abbe:g}"
            reading.ignore("GLAS", name, reason, part="glass")
            return model_glass(index, abbe, where, name, deviation)
    if re.fullmatch(r"\d{6}", name) is None:
        return None
    index, abbe = 1.0 + int(name[:3]) / 1000.0, int(name[3:]) / 10.0
    reason = f"a six-digit code: taken by its index {index:g} and Abbe number {abbe:g}"
    reading.ignore("GLAS", name, reason, part="glass")
    return model_glass(index, abbe, where)


def _aperture(surface: ZemaxSurface) -> ClearAperture:
    """Return the aperture that stops rays; a circle becomes the square around it."""
    ignore = surface.reading.ignore
    centre = surface.pair("OBDC") or (0.0, 0.0)
    for key in ("CLAP", "FLAP", "SQAP", "ELAP"):
        if pair := surface.pair(key):
            first, second = pair
            if key == "ELAP":
                ignore(key, f"{first:g} {second:g}", "an ellipse: the rectangle around it is clear")
            elif key != "SQAP" and first > 0:
                ignore(key, f"{first:g}", "inner radius of a ring: rays pass its middle")
            if key in ("CLAP", "FLAP") and second > 0:
                return surface.reading.circle(key, f"{second:g}", centre, second)
            if key in ("SQAP", "ELAP") and min(pair) > 0:
                return surface.reading.rectangle(centre, pair)
    return box_aperture()

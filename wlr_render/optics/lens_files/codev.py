"""Read CODE V lens files (.seq).

The commands are documented in CODE V's reference manuals. Signs and order of decentres follow rayoptics
(`codev/cmdproc.py`, `elem/surface.py`), checked with its three-mirror telescope, which is in focus. The thickness of
the image is a defocus, as in CODE V's listing of that telescope.
"""

import re
from pathlib import Path

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.io.input_files import shown
from wlr_render.optics.device import ClearAperture
from wlr_render.optics.glass_files import SCHOTT_POWERS
from wlr_render.optics.lens_files.codev_commands import CodevFile, CodevSurface, Command, commands_of, number_of
from wlr_render.optics.lens_files.codev_shapes import shape_of
from wlr_render.optics.lens_files.glass_catalogues import GlassCatalogue, require_glass
from wlr_render.optics.lens_files.sequence import (
    INFINITE,
    UNITS_M,
    Decentre,
    LensFile,
    LensReading,
    LensSurface,
    Part,
    box_aperture,
    require_surfaces,
    shift,
)
from wlr_render.optics.media import AIR, Medium

_UNITS = {"M": "mm", "C": "cm", "I": "in"}
_DECENTRES = {"DAR": "dec and return", "BEN": "bend", "REV": "reverse"}
_SOLVES = {"PIM", "PIK", "RED"}
_SOLVED = {"THI", "CUY", "CUX", "RDY", "RDX"}
"""Commands that state a solve if they have a qualifier, such as THI HMY."""
_BENDING = {
    *("RET", "GLB", "XOD", "YOD", "ZOD", "NSS", "INS", "DEL", "SCA", "FLY", "IN", "RES", "CUF", "GRC", "BIR", "INT"),
    *("AP", "BP", "CP", "DP", "CUX", "RDX", "GL1", "GL2", "XDE", "YDE", "ZDE", "ADE", "BDE", "CDE"),
    *("SCO", "PAR", "K", *"ABCDEFGHJ"),
}
"""Unread commands that bend rays, unless their numbers are 0."""
_MORE_THAN_A_SHAPE = {"DIF", "HOE", "GRT", "GRI", "MOD", "FRN"}
_PREFIXES = {"SCHOTT": "N", "OHARA": "S", "HIKARI": "J", "CDGM": "HD"}
"""First letters of glass names, by maker, before a dash; CODE V omits the dash."""
_ROOM = {"TEM": (20.0, 22.0), "PRE": (760.0,)}
"""Temperatures in degrees Celsius and pressure in millimetres of mercury for which catalogues state indices."""
_PRIVATE_UM = 0.1, 100.0
_EXACT = 1e-9  # largest error of an index that counts as exact
_PRIVATE_POWERS = 0.0, -2.0, -4.0, 2.0, -6.0, -8.0


def read_codev(path: Path, lines: list[str], catalogue: GlassCatalogue) -> LensFile:
    """Read the lines of a .seq file.

    Raises:
        BadInputError: the surfaces are not in their order, a value is not a number, or no catalogue has a glass.
    """
    reading = LensReading(path, catalogue)
    file = CodevFile(reading, CodevSurface(reading, 0, Command(("",), 0)))
    for command in commands_of(path, lines):
        file.take(command)
    file.end()
    require_surfaces(path, len(file.surfaces))
    title = _read_whole(file.whole)
    surfaces: list[LensSurface] = []
    pose, medium, thickness, before = np.eye(4), AIR, 0.0, Decentre()
    for surface in file.surfaces:
        reading.surface = number = surface.number
        decentre, gap = _decentre(surface), reading.unit * _thickness(surface)
        if surface is file.surfaces[-1]:
            thickness += gap  # a defocus: distance of the image behind the paraxial image
        pose = pose @ before.step(thickness, decentre)
        reflects, medium = _glass(file, surface, medium)
        is_far = number == 0 and np.isinf(gap)
        surfaces.append(
            LensSurface(
                number,
                " ".join(surface.words("SLB"))[:100],
                shape_of(surface),
                np.full((4, 4), np.nan) if is_far else pose @ shift(z=-gap) if number == 0 else pose,
                medium,
                reflects,
                "STO" in surface.commands,
                _aperture(surface),
                reading.unit * surface.value("CIR EDG", np.nan),
            )
        )
        surface.used.add("STO")
        _list_others(surface)
        thickness, before = (gap, decentre) if number else (0.0, Decentre())
    return reading.lens_file(title, surfaces)


def _read_whole(whole: CodevSurface) -> str:
    """Read the unit of length and the environment, note other commands, and return the title."""
    reading = whole.reading
    unit = whole.words("DIM")
    if unit and unit[0][:1].upper() not in _UNITS:
        line = whole.commands["DIM"].line
        raise BadInputError(f"{reading.path}: line {line}: DIM is {shown(unit[0])}; it must be M (mm), C (cm) or I.")
    if not unit:
        reading.ignore("DIM", "not stated", "lengths are taken as millimetres")
    reading.unit = UNITS_M[_UNITS[unit[0][0].upper() if unit else "M"]]
    for key, usual in _ROOM.items():
        if (value := whole.value(key, usual[0])) not in usual:
            reading.other_environment(key, f"{value:g}")
    title = " ".join(whole.words("TIT")).strip("'\" ")[:200]
    _list_others(whole)
    return title


def _list_others(surface: CodevSurface) -> None:
    """Note the commands that are not read."""
    for key, command in surface.commands.items():
        name, words = key.split()[0], command.words[1:]
        numbers = [word for word in words if re.match(r"[-+.\d]", word)]
        is_zero = bool(numbers) and not any(word.strip("-+0.eE") for word in numbers)
        if key in surface.used or (name == "TIT" and key != name) or (name in _BENDING and is_zero):
            continue
        reason, bends = "this command is not read", name in _BENDING
        part: Part = "shape" if name in _MORE_THAN_A_SHAPE else "other"
        if name in _SOLVES or (name in _SOLVED and key != name):
            reason = "a solve, pickup or zoom position: the value that the surface states is taken"
        elif name == "ZOO":
            reason, bends = "the file has several zoom positions; the one that the surfaces state is taken", True
        elif re.match(r"(CIR|RE[XY]|EL[XY]) (OBS|HOL)", key):
            reason = "rays pass an obscuration or a hole"
        elif name in _MORE_THAN_A_SHAPE:
            reason, bends = "bends rays by more than its shape: not read", True
        surface.reading.ignore(name, " ".join(words) or name, reason, bends, part)


def _thickness(surface: CodevSurface) -> float:
    """Return the thickness behind a surface in file units; infinite for a far object."""
    words, place, command = list(surface.line.words[1:]), 1, surface.line
    if "THI" in surface.commands:
        words, place, command = surface.words("THI"), 0, surface.commands["THI"]
    try:
        is_far = surface.number == 0 and abs(float(words[place])) >= INFINITE
    except (ValueError, IndexError):
        is_far = False
    return np.inf if is_far else number_of(surface.reading, command, words, place)


def _decentre(surface: CodevSurface) -> Decentre:
    kinds = [key for key in surface.commands if key in _DECENTRES]
    surface.used.update(kinds)
    place = [surface.reading.unit * surface.value(key) for key in ("XDE", "YDE", "ZDE")]
    degrees = [surface.value(key) for key in ("ADE", "BDE", "CDE")]
    if "BEN" in kinds[-1:] and (degrees[2] or all(degrees[:2])):
        reason = "of tilts about several axes, or about z, all are applied again behind the mirror: check the next ones"
        surface.reading.ignore("BEN", ", ".join(f"{angle:g}" for angle in degrees), reason, True)
    return Decentre.of(_DECENTRES[kinds[-1]] if kinds else "decenter", place, degrees)


def _glass(file: CodevFile, surface: CodevSurface, before: Medium) -> tuple[bool, Medium]:
    """Return whether the surface is a mirror, and the medium behind it."""
    values, first, command = list(surface.line.words[1:]), 2, surface.line
    if "GLA" in surface.commands:
        values, first, command = surface.words("GLA"), 0, surface.commands["GLA"]
    words = values[first:]
    mode = [*words[1:], *surface.words("RMD")]
    if [each for each in (*words[:1], *mode) if each.upper() in ("REFL", "TIR")]:
        return True, before
    if not "".join(words[:1]):
        return False, AIR
    name, reading = words[0], surface.reading
    where = f"{reading.path}: line {command.line}: glass {shown(name)}"
    if name.upper() in file.glasses:
        return False, _private_glass(reading, *file.glasses[name.upper()])
    if code := re.fullmatch(r"(\d{3})(\d{3})|(\d{3,9})\.(\d{1,9})", name):
        index, abbe = (digits for digits in code.groups() if digits)
        return False, reading.model_glass("GLA", 1.0 + float(f"0.{index}"), 100.0 * float(f"0.{abbe}"), where)
    if re.match(r"[-+.\d]", name):
        places = range(first, first + min(len(words), 2))
        numbers = [number_of(reading, command, values, place) for place in places]
        return False, reading.model_glass("GLA", numbers[0], numbers[1] if len(numbers) > 1 else 0.0, where)
    name, _, maker = name.partition("_") if name.strip("_") == name else (name, "", "")
    if name[0].upper() in _PREFIXES.get(maker.upper(), ""):
        name = f"{name[0]}-{name[1:]}"
    return False, reading.required_glass("GLA", name, (maker,) if maker else ())


def _private_glass(reading: LensReading, stated: Command, wavelengths: Command | None) -> Medium:
    """Return a private glass, by Laurent's formula or by its indices at the wavelengths of `PWL`."""
    name, *words = stated.words
    where = f"{reading.path}: line {stated.line}: glass {shown(name)}"
    formula = words.pop(0).upper() if words and re.match("[A-Za-z]", words[0]) else ""
    values, waves_nm = (
        np.array([number_of(reading, command, each, place) for place in range(len(each))])
        for command, each in ((stated, words), (wavelengths or stated, wavelengths.words[1:] if wavelengths else ()))
    )
    if formula == "LAU" and 0 < len(values) <= len(SCHOTT_POWERS):
        return require_glass(Medium.squared(name, (), zip(values, SCHOTT_POWERS, strict=False)), where)
    waves = 1e-3 * waves_nm
    is_stated = not formula and len(values) == len(waves) > 0 and len(set(waves)) == len(waves)
    if not is_stated or not all(_PRIVATE_UM[0] <= each <= _PRIVATE_UM[1] for each in waves):
        raise BadInputError(
            f"{where}: a private glass is read by LAU and up to {len(SCHOTT_POWERS)} coefficients, or by one index for "
            "each wavelength (nm) of PWL; give it in a catalogue file (.agf) and name it in the line S."
        )
    powers = _PRIVATE_POWERS[: len(values)]
    factors = np.linalg.lstsq(waves[:, None] ** np.array(powers), values**2, rcond=None)[0]
    medium = require_glass(Medium.squared(name, (), zip(factors.tolist(), powers, strict=True)), where)
    off = max(abs(medium.index(wave) - index) for wave, index in zip(waves.tolist(), values.tolist(), strict=True))
    reason = f"interpolated between {len(values)} indices" + (f", maximum error {off:.1g}" if off > _EXACT else "")
    reading.ignore("PRV", name, reason, part="glass")
    return medium


def _aperture(surface: CodevSurface) -> ClearAperture:
    """Return the aperture that stops rays; circles and ellipses become their bounding rectangles."""
    reading, halves = surface.reading, [np.inf, np.inf]
    for name, axes in (("CIR", (0, 1)), ("REX", (0,)), ("REY", (1,)), ("ELX", (0,)), ("ELY", (1,))):
        if name not in surface.commands:
            continue
        half = surface.value(name)
        if half <= 0:
            line = surface.commands[name].line
            raise BadInputError(f"{reading.path}: line {line}: {name} is {half:g}; it must be larger than 0.")
        for axis in axes:
            halves[axis] = min(halves[axis], half)
        if name not in ("REX", "REY"):
            reading.ignore(name, f"{half:g}", "the rectangle around the circle or ellipse is the clear aperture")
    if halves == [np.inf, np.inf]:
        return box_aperture()
    if surface.value("ARO"):
        reading.ignore("ARO", f"{surface.value('ARO'):g}", "a turned aperture: taken unturned")
    return reading.rectangle([surface.value("ADX"), surface.value("ADY")], halves)

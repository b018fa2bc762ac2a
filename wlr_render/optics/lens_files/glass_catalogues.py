"""Glasses by name: Zemax catalogue files (.agf), and the refractiveindex.info database that Optiland brings."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.extras import MissingExtraError, installed_by
from wlr_render.input_files import LIMITS, read_bytes, read_text, reason_of, shown
from wlr_render.optics.lens_files.lens_text import decode_lens_text
from wlr_render.optics.media import Medium

_GREEN_UM = 0.55
_INDICES = 1.0, 5.0
_SELLMEIER_PAIRS = {2: 3, 6: 4, 11: 5}
"""Terms of the formulas of Zemax that are sums of K L^2 / (L^2 - pole), by the formula's number."""
_SCHOTT = 1
SCHOTT_POWERS = (0.0, 2.0, -2.0, -4.0, -6.0, -8.0)
"""Powers of the wavelength in Schott's formula: formula 1 of Zemax, and that of several makers of glass."""


@dataclass(frozen=True)
class GlassCatalogue:
    """Where glasses are looked up by name.

    Attributes:
        files: catalogue files (.agf), searched first, in this order.
        found: what was found so far, by name and manufacturers.
    """

    files: tuple[Path, ...] = ()
    found: dict[tuple[str, tuple[str, ...]], Medium | None] = field(default_factory=dict)

    def find(self, name: str, manufacturers: Sequence[str] = ()) -> Medium | None:
        """A glass by its name, of one of the manufacturers if any are given; None if it is in no catalogue.

        Raises:
            BadInputError: a catalogue cannot be read, or states the glass by a formula that is not known here.
        """
        key = (name.upper(), tuple(each.lower() for each in manufacturers))
        if key not in self.found:
            in_files = (_glass_of_file(path, name) for path in self.files)
            medium = next((each for each in in_files if each is not None), None)
            self.found[key] = medium or _glass_of_optiland(name, key[1])
        return self.found[key]


def sellmeier(name: str, strengths: Sequence[float], poles: Sequence[float], constant: float = 0.0) -> Medium:
    """A medium of n^2 = 1 + constant + sum of strength L^2 / (L^2 - pole)."""
    terms = [(float(s), float(p)) for s, p in zip(strengths, poles, strict=True) if s]
    return Medium(name, tuple(terms + ([(float(constant), 0.0)] if constant else [])))


def schott(name: str, factors: Sequence[float], powers: Sequence[float]) -> Medium:
    """A medium of n^2 = sum of factor L^power."""
    pairs = [(float(f), float(p)) for f, p in zip(factors, powers, strict=False) if f]
    constant = sum(factor for factor, power in pairs if power == 0.0)
    return Medium(name, powers=((constant - 1.0, 0.0), *(pair for pair in pairs if pair[1] != 0.0)))


def require_glass(medium: Medium, where: str) -> Medium:
    """The medium, if its index in green light is one of a glass."""
    low, high = _INDICES
    index = medium.index(_GREEN_UM)
    if not low <= index <= high:
        raise BadInputError(f"{where} has an index of {index:g} in green light; a glass has one from 1 to 5.")
    return medium


def _glass_of_file(path: Path, name: str) -> Medium | None:
    """A glass of a Zemax catalogue: `NM name formula ...`, and its coefficients in the line `CD` that follows."""
    lines = decode_lens_text(path, read_bytes(path, LIMITS.text_bytes), "a glass catalogue").splitlines()
    formula = None
    for number, line in enumerate(lines, 1):
        words = line.split()
        if not words:
            continue
        if words[0] == "NM" and len(words) > 2:
            formula = words[2] if words[1].upper() == name.upper() else None
        elif words[0] == "CD" and formula is not None:
            where = f"{path}: line {number}: glass {shown(name)}"
            try:
                values = [float(word) for word in words[1:]]
                kind = int(float(formula))
            except (ValueError, OverflowError) as error:
                raise BadInputError(f"{where} has coefficients that are no numbers ({reason_of(error)}).") from error
            return require_glass(_of_zemax_formula(name, kind, values, where), where)
    return None


def _of_zemax_formula(name: str, kind: int, values: list[float], where: str) -> Medium:
    if kind in _SELLMEIER_PAIRS and len(values) >= 2 * _SELLMEIER_PAIRS[kind]:
        pairs = values[: 2 * _SELLMEIER_PAIRS[kind]]
        return sellmeier(name, pairs[::2], pairs[1::2])
    if kind == _SCHOTT:
        return schott(name, values, SCHOTT_POWERS)
    raise BadInputError(
        f"{where} is stated by formula {kind} with {len(values)} coefficients; formulas 1 (Schott), 2, 6 and 11 "
        "(Sellmeier) are read: give the glass in another catalogue file, or fit one of these."
    )


def _glass_of_optiland(name: str, manufacturers: tuple[str, ...]) -> Medium | None:
    """A glass of the database in Optiland; None if it is not there, or Optiland is not installed."""
    try:
        with installed_by("glasses", f"glass {shown(name)}"):
            from optiland.materials import Material
    except MissingExtraError:
        return None
    for manufacturer in (*manufacturers, None):
        try:
            material = Material(name, reference=manufacturer) if manufacturer else Material(name)
            file = str(material.to_dict()["filename"])
        except (ValueError, KeyError):
            continue
        # Optiland takes the nearest name if it has no such glass: N-SF5 for SF5, which is another one.
        found = Path(file).stem
        return require_glass(_of_database_file(file, name if found.upper() == name.upper() else found), file)
    return None


def stand_in(name: str, medium: Medium) -> str | None:
    """What to say of a glass that was found by a similar name only; None if it is the one that was asked for."""
    if medium.name.upper() == name.upper():
        return None
    return f"no catalogue has a glass of exactly this name: {medium.name} stands in its place; check its index"


def _of_database_file(path: str, name: str) -> Medium:
    """A medium of a refractiveindex.info file: its first formula."""
    text = read_text(path, "a file of refractiveindex.info")
    match = re.search(r"type:\s*formula (\d+)\s.*?coefficients:\s*([-+.\deE ]+)", text, re.DOTALL)
    if match is None:
        raise BadInputError(f"{path}: states no formula, only a table; give the glass in a catalogue file (.agf).")
    kind, values = int(match[1]), [float(each) for each in match[2].split()]
    constant, first, second = values[0], values[1::2], values[2::2]
    match kind:
        case 1:
            return sellmeier(name, first, np.square(second).tolist(), constant)
        case 2:
            return sellmeier(name, first, second, constant)
        case 3:
            return schott(name, [constant, *first], [0.0, *second])
        case 5:
            return Medium.cauchy(name, ((constant, 0.0), *zip(first, second, strict=True)))
    raise BadInputError(
        f"{path}: states formula {kind}; formulas 1, 2, 3 and 5 are read: give a catalogue file (.agf)."
    )

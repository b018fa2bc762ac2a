"""Glasses by name: Zemax catalogue files (.agf), and the refractiveindex.info database that Optiland brings."""

import functools
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.extras import MissingExtraError, install_command, installed_by
from wlr_render.input_files import LIMITS, read_bytes, read_text, reason_of, shown
from wlr_render.optics.lens_files.lens_text import decode_lens_text
from wlr_render.optics.media import Medium

_KIND = "a glass catalogue"
_GREEN_UM = 0.55
_INDICES = 1.0, 5.0
_SCHOTT = 1
_COEFFICIENTS = {_SCHOTT: 6, 2: 6, 6: 8, 11: 10}
"""Coefficients of Zemax' formulas by number: Schott's, and sums of 3, 4 and 5 terms K L^2 / (L^2 - pole)."""
SCHOTT_POWERS = (0.0, 2.0, -2.0, -4.0, -6.0, -8.0)
"""Powers of the wavelength in Schott's formula: formula 1 of Zemax, and that of several makers of glass."""


@dataclass(frozen=True)
class GlassCatalogue:
    """Where glasses are looked up by name.

    Attributes:
        files: catalogue files (.agf), searched first, in this order.
        found: glasses looked up so far, by name and manufacturers.
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
            entry = self._entries.get(key[0])
            self.found[key] = _of_entry(name, *entry) if entry else _glass_of_optiland(name, key[1])
        return self.found[key]

    def require(self, name: str, where: str, manufacturers: Sequence[str] = ()) -> Medium:
        """As `find`, and refuses a glass that no catalogue has; `where` begins the sentence."""
        medium = self.find(name, manufacturers)
        if medium is None:
            raise BadInputError(f"{where}: no catalogue has the glass {shown(name)}. {unknown_glass_remedy()}")
        return medium

    @functools.cached_property
    def _entries(self) -> dict[str, tuple[str, str, list[str]]]:
        """Place, formula and coefficients of the glasses in the files, by name; of two with one name the first."""
        entries: dict[str, tuple[str, str, list[str]]] = {}
        for path in self.files:
            text = decode_lens_text(path, read_bytes(path, LIMITS.text_bytes), _KIND)
            name, formula = "", ""
            for number, line in enumerate(text.splitlines(), 1):
                key, *words = line.split() or [""]
                if key == "NM" and len(words) > 1:
                    name, formula = words[0].upper(), words[1]
                elif key == "CD" and name:
                    entries.setdefault(name, (f"{path}: line {number}", formula, words))
            if not name:
                raise BadInputError(f"{path}: has no line 'NM' of a glass, so this is not {_KIND}; name another file.")
        return entries


def sellmeier(name: str, strengths: Sequence[float], poles: Sequence[float], constant: float = 0.0) -> Medium:
    """A medium of n^2 = 1 + constant + sum of strength L^2 / (L^2 - pole)."""
    terms = [(float(s), float(p)) for s, p in zip(strengths, poles, strict=True) if s]
    return Medium(name, tuple(terms + ([(float(constant), 0.0)] if constant else [])))


def schott(name: str, factors: Sequence[float], powers: Sequence[float]) -> Medium:
    """A medium of n^2 = sum of factor L^power."""
    pairs = [(float(f), float(p)) for f, p in zip(factors, powers, strict=True) if f]
    constant = sum(factor for factor, power in pairs if power == 0.0)
    return Medium(name, powers=((constant - 1.0, 0.0), *(pair for pair in pairs if pair[1] != 0.0)))


def require_glass(medium: Medium, where: str) -> Medium:
    """The medium, if its index in green light is one of a glass."""
    low, high = _INDICES
    index = medium.index(_GREEN_UM)
    if not low <= index <= high:
        raise BadInputError(f"{where} has an index of {index:g} in green light; a glass has one from 1 to 5.")
    return medium


def model_glass(index: float, abbe: float, where: str, name: str = "") -> Medium:
    """A glass by n_d and V_d, without dispersion if V_d is not positive."""
    name = name or f"nd{index:g}_vd{abbe:g}"
    return require_glass(Medium.abbe(name, index, abbe) if abbe > 0 else Medium.constant(name, index), where)


def unknown_glass_remedy() -> str:
    """Sentence that says how to give a glass that no catalogue has."""
    return (
        "Name Zemax's catalogue file with --glasses FILE.agf, or install the database of refractiveindex.info "
        f"(1.3 GB): {install_command('glasses')}"
    )


def _of_entry(name: str, place: str, formula: str, words: list[str]) -> Medium:
    """A glass of a Zemax catalogue: `NM name formula ...`, and its ten coefficients in the line `CD` that follows."""
    where = f"{place}: glass {shown(name)}"
    try:
        values = [float(word) for word in words]
        kind = int(float(formula))
    except (ValueError, OverflowError) as error:
        raise BadInputError(f"{where} has coefficients that are no numbers ({reason_of(error)}).") from error
    if kind not in _COEFFICIENTS:
        raise BadInputError(
            f"{where} is stated by formula {kind}; formulas 1 (Schott), 2, 6 and 11 (Sellmeier) are read: give the "
            "glass in another catalogue file, or fit one of these."
        )
    count = _COEFFICIENTS[kind]
    if len(values) < count or any(values[count:]):
        raise BadInputError(
            f"{where} has {len(values)} coefficients; formula {kind} has {count}, and zeros up to ten: correct the "
            "number of the formula or the coefficients."
        )
    values = values[:count]
    medium = schott(name, values, SCHOTT_POWERS) if kind == _SCHOTT else sellmeier(name, values[::2], values[1::2])
    return require_glass(medium, where)


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


def substitution_note(name: str, medium: Medium) -> str | None:
    """Note on a glass that was found by a similar name only; None if it has the name that was asked for."""
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

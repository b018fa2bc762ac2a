"""Look up glasses by name: in Zemax catalogues (.agf), the shipped catalogue, and the database of Optiland."""

import functools
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.extras import MissingExtraError, install_command, installed_by
from wlr_render.io.input_files import read_text, shown
from wlr_render.optics.glass_files import GlassEntry, herzberger, read_glass_file, shipped_entries
from wlr_render.optics.media import AIR, Medium

_ALSO = {
    "BK7": "N-BK7",
    "PC": "POLYCARB",
    "POLYCARBONATE": "POLYCARB",
    "PS": "POLYSTYR",
    "POLYSTYRENE": "POLYSTYR",
    "TOPAS": "COC",
    "ZEONEXE48R": "E48R",
    "FSILICA": "SILICA",
    "FUSEDSILICA": "SILICA",
    "SIO2": "SILICA",
    "C7980": "SILICA",
    "AL2O3": "SAPPHIRE",
}
"""Other names of shipped glasses, in letters and digits."""
_OTHER_MAKERS = {"F2": ("cdgm", "hikari"), "BAF2": ("cdgm",)}
"""Makers of a different glass with the same name, by the name of a shipped glass."""
_VISIBLE_UM = 0.45, 0.65


@dataclass(frozen=True)
class Glass:
    """Result of looking up a glass.

    Attributes:
        medium: the glass.
        note: source of the glass, unless the user named the catalogue; may be empty.
        is_other: True if its index may differ from the index of the named glass.
    """

    medium: Medium
    note: str = ""
    is_other: bool = False


@dataclass(frozen=True)
class GlassCatalogue:
    """Catalogues in which glasses are looked up by name.

    Attributes:
        files: catalogue files (.agf), searched first, in this order.
        cache: glasses looked up so far, by name and manufacturers.
    """

    files: tuple[Path, ...] = ()
    cache: dict[tuple[str, tuple[str, ...]], Glass | None] = field(default_factory=dict)

    def find(self, name: str, manufacturers: Sequence[str] = ()) -> Glass | None:
        """Find a glass by name, from one of the manufacturers if any are given; None if no catalogue has it.

        Raises:
            BadInputError: a catalogue cannot be read, or the glass in it is faulty.
        """
        key = (name.upper(), tuple(each.lower() for each in manufacturers))
        if key not in self.cache:
            self.cache[key] = self._find(name, key[1])
        return self.cache[key]

    def _find(self, name: str, manufacturers: tuple[str, ...]) -> Glass | None:
        if name.upper() in ("AIR", "VACUUM"):
            return Glass(AIR)
        for entries in self._in_order(manufacturers):
            if entry := _by_name(entries, name):
                return _glass_of(entry, name)
        shipped = _by_name(shipped_entries(), _ALSO.get(_letters(name), name))
        others = _OTHER_MAKERS.get(shipped.name, ()) if shipped else ()
        if shipped and not any(other in maker for other in others for maker in manufacturers):
            return _glass_of(shipped, name, f"from this program's catalogue ({shipped.source})")
        medium = _glass_of_optiland(name, manufacturers)
        if medium is None:
            return None
        if medium.name.upper() == name.upper():
            return Glass(medium)
        text = f"no catalogue has a glass of exactly this name: {medium.name} stands in its place; check its index"
        return Glass(medium, text, True)

    def _in_order(self, manufacturers: tuple[str, ...]) -> list[dict[str, GlassEntry]]:
        """Return the glasses of each file, first of files named after manufacturers, in the manufacturers' order."""
        places = {maker: place for place, maker in enumerate(manufacturers)}
        ordered = sorted(self.files, key=lambda path: places.get(path.stem.lower(), len(places)))
        return [self._entries[path] for path in ordered]

    @functools.cached_property
    def _entries(self) -> dict[Path, dict[str, GlassEntry]]:
        """Return the glasses of each file."""
        return {path: read_glass_file(path) for path in self.files}


def _letters(name: str) -> str:
    """Return the letters and digits of a name in capitals: spaces and dashes do not distinguish glasses."""
    return re.sub(r"[\W_]", "", name).upper()


def _by_name(entries: dict[str, GlassEntry], name: str) -> GlassEntry | None:
    """Return the glass with a name, or with a name that differs in spaces and dashes only."""
    if name.upper() in entries:
        return entries[name.upper()]
    return next((entry for each, entry in entries.items() if _letters(each) == _letters(name)), None)


def _glass_of(entry: GlassEntry, name: str, *source: str) -> Glass:
    """Return the glass of an entry that was found for a name, with a note on its source and on how it differs."""
    notes = [f"taken as {entry.name}"] if entry.name.upper() != name.upper() else []
    notes += source
    try:
        low, high = (float(word.replace(",", ".")) for word in entry.range_um[:2])
    except ValueError:
        low, high = _VISIBLE_UM
    is_outside = low > _VISIBLE_UM[0] or high < _VISIBLE_UM[1]
    if is_outside:
        notes.append(f"its formula is stated from {low:g} to {high:g} um only, and is used beyond them")
    return Glass(entry.medium(), ", ".join(notes), is_outside)


def model_glass(index: float, abbe: float, where: str, name: str = "", deviation: float = 0.0) -> Medium:
    """Return the glass with an index n_d, an Abbe number V_d and a deviation from the normal line.

    Without a positive V_d it has no dispersion, and is air if its index is 1.

    Raises:
        BadInputError: no glass has such numbers; `where` begins the sentence.
    """
    if abbe > 0:
        return require_glass(Medium.abbe(name or f"nd{index:g}_vd{abbe:g}", index, abbe, deviation), where)
    return AIR if index == 1.0 else require_glass(Medium.constant(name or f"n{index:g}", index), where)


def require_glass(medium: Medium, where: str) -> Medium:
    """Return the medium; refuse it if its index in visible light is implausible."""
    if fault := medium.fault():
        raise BadInputError(f"{where}: {fault}")
    return medium


def unknown_glass_remedy() -> str:
    """Return the remedy for a glass that no catalogue has."""
    return (
        "Name Zemax's catalogue file with --glasses FILE.agf, or install the database of refractiveindex.info "
        f"(1.3 GB): {install_command('glasses')}"
    )


def _glass_of_optiland(name: str, manufacturers: tuple[str, ...]) -> Medium | None:
    """Return a glass of the database in Optiland; None if it is not there, or Optiland is not installed."""
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
        # Optiland takes the nearest name if it has no such glass: N-SF5 for SF5, which is another glass.
        stem = Path(file).stem
        return require_glass(_of_database_file(file, name if stem.upper() == name.upper() else stem), file)
    return None


def _of_database_file(path: str, name: str) -> Medium:
    """Return the medium of a refractiveindex.info file, by its first formula."""
    text = read_text(path, "a file of refractiveindex.info")
    match = re.search(r"type:\s*formula (\d+)\s.*?coefficients:\s*([-+.\deE ]+)", text, re.DOTALL)
    if match is None:
        raise BadInputError(f"{path}: states no formula, only a table; give the glass in a catalogue file (.agf).")
    kind, values = int(match[1]), [float(each) for each in match[2].split()]
    constant, pairs = values[0], list(zip(values[1::2], values[2::2], strict=False))
    match kind:
        case 1:
            return Medium.squared(name, [(b, np.square(c).item()) for b, c in pairs], [(1.0 + constant, 0.0)])
        case 2:
            return Medium.squared(name, pairs, [(1.0 + constant, 0.0)])
        case 3:
            return Medium.squared(name, (), [(constant, 0.0), *pairs])
        case 4 if {values[2], *values[6:7]} <= {0.0, 2.0}:
            return _of_fractions(name, values)
        case 5:
            return Medium.cauchy(name, ((constant, 0.0), *pairs))
        case 7:
            return herzberger(name, *values, *[0.0] * (6 - len(values)))
    raise BadInputError(f"{path}: states formula {kind}; formulas 1 to 5 and 7 are read: give a catalogue file (.agf).")


def _of_fractions(name: str, values: list[float]) -> Medium:
    """Return the medium of formula 4: n^2 = c1 + c2 L^c3 / (L^2 - c4^c5) + c6 L^c7 / (L^2 - c8^c9) + c10 L^c11 + ..."""
    values = [*values, *[0.0] * (9 - len(values))]
    powers = [(values[0], 0.0), *zip(values[9::2], values[10::2], strict=False)]
    poles = [(strength, power, base**exponent) for strength, power, base, exponent in (values[1:5], values[5:9])]
    terms = [(strength, pole) for strength, power, pole in poles if power]
    fractions = [(strength, pole) for strength, power, pole in poles if not power]
    return Medium.squared(name, terms, powers, fractions)

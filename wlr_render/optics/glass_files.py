"""Glass catalogues of Zemax (.agf): all thirteen dispersion formulas, and the catalogue of this package."""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from wlr_render.errors import BadInputError
from wlr_render.io.input_files import hashes_of_inputs, reason_of, shown
from wlr_render.optics.lens_text import read_lens_lines
from wlr_render.optics.media import Medium

SHIPPED = Path(__file__).with_name("glasses.agf")
"""Common glasses, plastics and crystals, with the source of each."""
SCHOTT_POWERS = (0.0, 2.0, -2.0, -4.0, -6.0, -8.0)
"""Powers of the wavelength in Schott's formula, which several glass makers use."""
NIKON_POWERS = (0.0, 2.0, 4.0, -2.0, -4.0, -6.0, -8.0, -10.0, -12.0)
"""Powers of the wavelength in the formula of Nikon and Hikari, which is Zemax's Extended 3."""

_KIND = "a glass catalogue"
_HERZBERGER_POLE = 0.028  # square micrometres, the same for every glass
_MOST_POWER = 20.0  # largest power of the wavelength in a device file


@dataclass
class GlassEntry:
    """One glass of a catalogue, as its lines NM, GC, CD and LD state it.

    Attributes:
        name: name of the glass.
        formula: number of the dispersion formula.
        place: file and line, for messages.
        source: comment with the source.
        coefficients: coefficients of the formula.
        range_um: shortest and longest wavelength of the formula.
    """

    name: str
    formula: str
    place: str
    source: str = ""
    coefficients: Sequence[str] = field(default_factory=list)
    range_um: Sequence[str] = field(default_factory=list)

    def medium(self) -> Medium:
        """Return the glass.

        Raises:
            BadInputError: its formula or coefficients are faulty, or its index is implausible in visible light.
        """
        where = f"{self.place}: glass {shown(self.name)}"
        try:
            values = [float(word.replace(",", ".")) for word in self.coefficients]
            number = int(float(self.formula.replace(",", ".")))
        except (ValueError, OverflowError) as error:
            raise BadInputError(f"{where} has coefficients that are not numbers ({reason_of(error)}).") from error
        if number not in _FORMULAS:
            raise BadInputError(f"{where} has the formula {number}; Zemax has formulas 1 to 13: correct the number.")
        title, count, build = _FORMULAS[number]
        if len(values) < count or any(values[count:]):
            raise BadInputError(
                f"{where} has {len(values)} coefficients; formula {number} ({title}) has {count}, and zeros up to ten: "
                "correct the number of the formula or the coefficients."
            )
        medium = build(self.name, *values[:count])
        if fault := medium.fault():
            raise BadInputError(f"{where}: {fault}")
        return medium


def read_glass_file(path: Path) -> dict[str, GlassEntry]:
    """Read a catalogue as glasses by name in capitals; of glasses with the same name, the first is used.

    Raises:
        BadInputError: the file cannot be read, or is not a catalogue.
    """
    entries: dict[str, GlassEntry] = {}
    entry = None
    for number, line in enumerate(read_lens_lines(path, _KIND), 1):
        key, *words = line.split() or [""]
        if key == "NM" and len(words) > 1:
            entry = GlassEntry(words[0], words[1], f"{path}: line {number}")
            entries.setdefault(words[0].upper(), entry)
        elif entry is None:
            continue
        elif key == "CD":
            entry.coefficients, entry.place = words, f"{path}: line {number}"
        elif key == "GC":
            entry.source = " ".join(words)
        elif key == "LD":
            entry.range_um = words
    if not entries:
        raise BadInputError(f"{path}: has no line 'NM' of a glass, so this is not {_KIND}; name another file.")
    return entries


@functools.cache
def shipped_entries() -> dict[str, GlassEntry]:
    """Return the glasses of this package by name in capitals."""
    with hashes_of_inputs():  # the file is part of the program, not an input of the run that reads it first
        return read_glass_file(SHIPPED)


@functools.cache
def shipped_glasses() -> dict[str, Medium]:
    """Return the glasses of this package by name."""
    return {entry.name: entry.medium() for entry in shipped_entries().values()}


def herzberger(name: str, a: float, b: float, c: float, *rest: float) -> Medium:
    """Return the medium with n = A + B M + C M^2 + D L^2 + E L^4 + F L^6 with M = 1 / (L^2 - 0.028).

    M is expanded in powers of 0.028 / L^2 up to L^-20: from 0.4 micrometres on, n is exact to 1e-7.
    """
    factors = [(a, 0.0), *zip(rest, (2.0, 4.0, 6.0), strict=True)]
    for k in range(10):
        factors.append((b * _HERZBERGER_POLE**k, -2.0 * k - 2.0))
        factors.append((c * (k + 1) * _HERZBERGER_POLE**k, -2.0 * k - 4.0))
    medium = Medium.cauchy(name, tuple(factors))
    return Medium(name, powers=tuple(pair for pair in medium.powers if pair[1] >= -_MOST_POWER))


def _of_powers(*powers: float) -> Callable[..., Medium]:
    """Return a function from coefficients to the medium with n^2 = sum of coefficient L^power."""
    return lambda name, *values: Medium.squared(name, (), zip(values, powers, strict=True))


def _sellmeier(name: str, *values: float) -> Medium:
    """Return the medium with n^2 = 1 + sum of K L^2 / (L^2 - pole), from K, pole, K, pole and so on."""
    return Medium.squared(name, zip(values[::2], values[1::2], strict=True), [(1.0, 0.0)])


_FORMULAS: dict[int, tuple[str, int, Callable[..., Medium]]] = {
    1: ("Schott", 6, _of_powers(*SCHOTT_POWERS)),
    2: ("Sellmeier 1", 6, _sellmeier),
    3: ("Herzberger", 6, herzberger),
    # n^2 = 1 + A + B L^2 / (L^2 - p^2) + C / (L^2 - q^2)
    4: (
        "Sellmeier 2",
        5,
        lambda name, a, b, p, c, q: Medium.squared(name, [(b, p * p)], [(1.0 + a, 0.0)], [(c, q * q)]),
    ),
    # n = A + B / L + C / L^3.5
    5: ("Conrady", 3, lambda name, *abc: Medium.cauchy(name, tuple(zip(abc, (0.0, -1.0, -3.5), strict=True)))),
    6: ("Sellmeier 3", 8, _sellmeier),
    # n^2 = A + B / (L^2 - C) - D L^2
    7: ("Handbook of Optics 1", 4, lambda name, a, b, c, d: Medium.squared(name, (), [(a, 0.0), (-d, 2.0)], [(b, c)])),
    # n^2 = A + B L^2 / (L^2 - C) - D L^2
    8: ("Handbook of Optics 2", 4, lambda name, a, b, c, d: Medium.squared(name, [(b, c)], [(a, 0.0), (-d, 2.0)])),
    # n^2 = A + B L^2 / (L^2 - C) + D L^2 / (L^2 - E)
    9: ("Sellmeier 4", 5, lambda name, a, b, c, d, e: Medium.squared(name, [(b, c), (d, e)], [(a, 0.0)])),
    10: ("Extended", 8, _of_powers(*SCHOTT_POWERS, -10.0, -12.0)),
    11: ("Sellmeier 5", 10, _sellmeier),
    12: ("Extended 2", 8, _of_powers(*SCHOTT_POWERS, 4.0, 6.0)),
    13: ("Extended 3", 9, _of_powers(*NIKON_POWERS)),
}
"""Zemax's dispersion formulas by number: name, count of coefficients, reader. L is in micrometres."""

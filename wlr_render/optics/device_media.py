"""Media of device files (devices/README.md), read and written."""

import difflib
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from wlr_render.io.input_files import shown
from wlr_render.io.toml_files import Table
from wlr_render.optics.glass_files import shipped_glasses
from wlr_render.optics.media import INDICES, Medium

_ABBE_NUMBERS = 5.0, 200.0
_HIGHEST_POWER = 20  # highest power of the wavelength
_MOST = 100  # largest number of terms


def read_medium(table: Table, name: str) -> Medium:
    """Read the index of a [[medium]]; refuse an index that no transparent medium has in visible light."""
    given = [key for key in _MEDIA if table.has(key)]
    readers = {_MEDIA[key] for key in given}
    if len(readers) != 1:
        raise table.fail(f"give the index by one of {', '.join(_MEDIA)}; {' and '.join(given) or 'none'} is there.")
    medium = readers.pop()(table, name).shifted(table.number("index_shift", default=0.0))
    if fault := medium.fault():
        raise table.fail(fault)
    return medium


def _named_glass(table: Table, name: str) -> Medium:
    formula = table.text("formula")
    glasses = shipped_glasses()
    if formula not in glasses:
        like = difflib.get_close_matches(formula.upper(), glasses, 3, 0.0)
        raise table.fail(
            f"'formula' is {shown(formula)}; choose one of the glasses that devices/README.md lists, such as "
            f"{', '.join(like)}, or give any glass by 'sellmeier', or by 'nd' and 'vd'."
        )
    return replace(glasses[formula], name=name)


def _squared(table: Table, name: str) -> Medium:
    """Read n^2 as terms of Sellmeier, as powers of the wavelength, or as the sum of both."""
    pairs = {key: table.vectors(key, 2) if table.has(key) else np.empty((0, 2)) for key in ("sellmeier", "schott")}
    for key, given in pairs.items():
        if len(given) > _MOST:
            raise table.fail(f"'{key}' has {len(given)} terms; {_MOST} is the most that is read.")
    if np.any(np.abs(pairs["schott"][:, 1]) > _HIGHEST_POWER):
        raise table.fail(
            f"'schott' must be pairs [factor, power of the wavelength], at most {_MOST}, powers within "
            f"{_HIGHEST_POWER}."
        )
    terms, powers = ([(float(first), float(second)) for first, second in given] for given in pairs.values())
    return Medium.squared(name, terms, powers if table.has("schott") else [(1.0, 0.0)])


def _cauchy(table: Table, name: str) -> Medium:
    factors = table.numbers("cauchy")
    if not 1 <= len(factors) <= _HIGHEST_POWER // 4:
        raise table.fail(f"'cauchy' must be 1 to {_HIGHEST_POWER // 4} numbers: A, B, C of n = A + B / L^2 + C / L^4.")
    return Medium.cauchy(name, tuple((factor, -2.0 * place) for place, factor in enumerate(factors.tolist())))


def _abbe(table: Table, name: str) -> Medium:
    return Medium.abbe(name, _index(table, "nd"), table.number("vd", least=_ABBE_NUMBERS[0], most=_ABBE_NUMBERS[1]))


_MEDIA: dict[str, Callable[[Table, str], Medium]] = {
    "index": lambda table, name: Medium.constant(name, _index(table, "index")),
    "formula": _named_glass,
    "sellmeier": _squared,
    "schott": _squared,
    "cauchy": _cauchy,
    "nd": _abbe,
}


def _index(table: Table, key: str) -> float:
    return table.number(key, least=INDICES[0], most=INDICES[1])


def medium_content(name: str, medium: Medium) -> dict[str, Any]:
    """Return a [[medium]] that `read_medium` reads."""
    shift = {"index_shift": medium.index_shift} if medium.index_shift else {}
    for glass in shipped_glasses().values():
        if (medium.terms, medium.powers) == (glass.terms, glass.powers):
            return {"name": name, "formula": glass.name} | shift
    poles = [list(term) for term in medium.terms if term[1]]
    # A Sellmeier term with a pole of 0 is a constant of n^2, and so is a factor of the power 0.
    constant = sum(strength for strength, pole in medium.terms if not pole)
    constant += sum(factor for factor, power in medium.powers if not power)
    powers = [[factor, power] for factor, power in medium.powers if power]
    if powers:
        sellmeier = {"sellmeier": poles} if poles else {}
        return {"name": name} | sellmeier | {"schott": [[1.0 + constant, 0.0], *powers]} | shift
    if poles:
        return {"name": name, "sellmeier": [*poles, *([[constant, 0.0]] if constant else [])]} | shift
    return {"name": name, "index": replace(medium, index_shift=0.0).index(1.0)} | shift

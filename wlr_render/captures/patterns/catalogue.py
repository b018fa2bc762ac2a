"""Codes shown on a panel. Each family is one file that implements `pattern.Pattern`; to add one, name it here."""

from dataclasses import fields

from wlr_render.captures.patterns.fringes import Fringes
from wlr_render.captures.patterns.gray_code import GrayCode
from wlr_render.captures.patterns.gray_fringes import GrayFringes
from wlr_render.captures.patterns.pattern import Pattern
from wlr_render.errors import BadInputError
from wlr_render.mappings import Panel

PATTERNS: dict[str, type[Pattern]] = {
    "gray": GrayCode,
    "fringes": Fringes,
    "gray-fringes": GrayFringes,
}


def make_pattern(name: str, panel: Panel, **numbers: int) -> Pattern:
    """Return the pattern `name` for a panel.

    Args:
        name: one of `PATTERNS`.
        panel: panel that shows it.
        **numbers: parameters of the pattern, named in `pattern_keys`; missing ones have their defaults.

    Raises:
        BadInputError: the code or a parameter is unknown, or a parameter is invalid.
    """
    keys = pattern_keys(name)
    for key in numbers:
        if key not in keys:
            choice = f"it has {', '.join(keys)}" if keys else "it has none"
            raise BadInputError(f"The code '{name}' has no number '{key}'; {choice}.")
    return PATTERNS[name](panel, **numbers)


def pattern_keys(name: str) -> tuple[str, ...]:
    """Return the names of the parameters of a pattern.

    Raises:
        BadInputError: the code is unknown.
    """
    if name not in PATTERNS:
        raise BadInputError(f"Unknown code '{name}'; it must be one of {', '.join(PATTERNS)}.")
    return tuple(field.name for field in fields(PATTERNS[name]) if field.name != "panel")

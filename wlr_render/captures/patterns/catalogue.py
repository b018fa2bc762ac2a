"""Make patterns by name."""

from dataclasses import fields
from typing import Any

from wlr_render.captures.patterns import PATTERNS
from wlr_render.captures.patterns.pattern import Pattern
from wlr_render.errors import BadInputError
from wlr_render.mappings import Panel


def make_pattern(name: str, panel: Panel, **numbers: int) -> Pattern:
    """Return the pattern `name` for a panel.

    Args:
        name: one of `PATTERNS`.
        panel: to show it on.
        **numbers: its own numbers, those of `pattern_keys`; the others have their defaults.

    Raises:
        BadInputError: there is no such code, it has no such number, or the number makes no code.
    """
    keys = pattern_keys(name)
    for key in numbers:
        if key not in keys:
            choice = f"it has {', '.join(keys)}" if keys else "it has none"
            raise BadInputError(f"The code '{name}' has no number '{key}'; {choice}.")
    family: Any = PATTERNS[name]
    pattern: Pattern = family(panel, **numbers)
    return pattern


def pattern_keys(name: str) -> tuple[str, ...]:
    """Names of the parameters of a pattern.

    Raises:
        BadInputError: there is no such code.
    """
    if name not in PATTERNS:
        raise BadInputError(f"There is no code '{name}'; it must be one of {', '.join(PATTERNS)}.")
    family: Any = PATTERNS[name]
    return tuple(field.name for field in fields(family) if field.name != "panel")

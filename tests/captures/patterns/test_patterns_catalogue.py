from collections.abc import Mapping

import pytest

from wlr_render.captures.patterns.catalogue import PATTERNS, GrayFringes, make_pattern, pattern_keys
from wlr_render.errors import BadInputError
from wlr_render.mappings import Panel

PANEL = Panel(64, 48)


def test_names_and_their_numbers() -> None:
    assert {name: pattern_keys(name) for name in PATTERNS} == {
        "gray": (),
        "fringes": ("period_px", "steps"),
        "gray-fringes": ("period_px", "steps"),
    }
    assert make_pattern("gray-fringes", PANEL, period_px=24) == GrayFringes(PANEL, 24, 6)


@pytest.mark.parametrize(
    ("name", "numbers", "hint"),
    [
        ("stripes", {}, "must be one of gray, fringes, gray-fringes"),
        ("gray", {"steps": 6}, "it has none"),
        ("fringes", {"period": 16}, "period_px, steps"),
        ("fringes", {"period_px": 3}, "at least 4"),
        ("fringes", {"steps": 2}, "at least 3"),
        ("gray-fringes", {"period_px": 15}, "must be even"),
    ],
)
def test_what_makes_no_code_is_refused(name: str, numbers: Mapping[str, int], hint: str) -> None:
    with pytest.raises(BadInputError, match=hint):
        make_pattern(name, PANEL, **numbers)

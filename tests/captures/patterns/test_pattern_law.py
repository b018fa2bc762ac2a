"""The law of every family: decoding its own pictures gives every panel pixel's centre."""

from collections.abc import Mapping

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wlr_render.captures.decoded import Decoded, DecodeOptions
from wlr_render.captures.patterns.catalogue import PATTERNS, make_pattern
from wlr_render.captures.patterns.pattern import Pattern
from wlr_render.mappings import Panel

# Pictures have 8 bits: a fringe of 16 px rounds to about 16 / (2 pi) * 1 / 127 px.
ROUNDING_PX = {"gray": 1e-4, "fringes": 0.02, "gray-fringes": 0.02}
SIZES = st.one_of(st.integers(1, 9), st.integers(10, 70))


def decoded(pattern: Pattern) -> Decoded:
    shown = (pattern.image(index) for index in range(len(pattern.names())))
    return pattern.decode(shown, DecodeOptions(end_of_scale=np.inf))


@pytest.mark.parametrize("name", PATTERNS)
@given(width=SIZES, height=SIZES)
@settings(max_examples=25, deadline=None)
def test_own_pictures_decode_to_pixel_centres(name: str, width: int, height: int) -> None:
    panel = Panel(width, height)
    result = decoded(make_pattern(name, panel))
    assert result.accepted.all()
    assert np.abs(result.pixel - panel.pixel_centres()).max() <= ROUNDING_PX[name]


@pytest.mark.parametrize("name", PATTERNS)
@pytest.mark.parametrize("size", [(257, 3), (1, 300), (640, 480)])
def test_sizes_around_powers_of_two_and_lines(name: str, size: tuple[int, int]) -> None:
    panel = Panel(*size)
    result = decoded(make_pattern(name, panel))
    assert result.accepted.all()
    assert np.abs(result.pixel - panel.pixel_centres()).max() <= ROUNDING_PX[name]


@pytest.mark.parametrize(
    ("name", "numbers"), [("fringes", {"period_px": 9, "steps": 5}), ("gray-fringes", {"steps": 4})]
)
def test_other_periods_and_steps(name: str, numbers: Mapping[str, int]) -> None:
    panel = Panel(90, 61)
    result = decoded(make_pattern(name, panel, **numbers))
    assert np.abs(result.pixel - panel.pixel_centres()).max() <= 0.02


@pytest.mark.parametrize(("name", "count"), [("gray", 46), ("fringes", 50), ("gray-fringes", 46)])
def test_number_of_pictures_for_a_common_panel(name: str, count: int) -> None:
    pattern = make_pattern(name, Panel(1920, 1080))
    assert len(pattern.names()) == len(set(pattern.names())) == count
    assert pattern.names()[:2] == ("white", "black")


def test_gray_pictures_are_bits_and_inverses_from_coarse_to_fine() -> None:
    pattern = make_pattern("gray", Panel(5, 3))
    assert pattern.names()[2:] == tuple(
        f"{axis} bit {bit}{inverse}"
        for axis, top in (("u", 2), ("v", 1))
        for bit in range(top, -1, -1)
        for inverse in ("", " inverse")
    )
    assert (pattern.image(2)[0] // 255).tolist() == [0, 0, 0, 0, 1]
    assert (pattern.image(4)[0] // 255).tolist() == [0, 0, 1, 1, 1]
    assert (pattern.image(6)[0] // 255).tolist() == [0, 1, 1, 0, 0]
    assert (pattern.image(9)[:, 0] // 255).tolist() == [1, 1, 0]

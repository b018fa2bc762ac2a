"""A bit that was shown too faintly is the one that is named."""

from collections.abc import Iterator, Mapping
from typing import Any, cast

import numpy as np
import pytest

from wlr_render.captures.patterns.bit_strength import bit_strengths
from wlr_render.captures.patterns.pattern import Pattern
from wlr_render.errors import BadInputError

NAMES = (
    "white",
    "black",
    "u bit 1",
    "u bit 1 inverse",
    "u bit 2",
    "u bit 2 inverse",
    "fringe",
    "v bit 1",
    "v bit 1 inverse",
)


class Named:
    def names(self) -> tuple[str, ...]:
        return NAMES


NAMED = cast(Pattern, Named())  # the strength of bits takes nothing from a pattern but its names


def photographs(
    strength: Mapping[Any, Any], shape: tuple[int, int] = (40, 50), light: float = 200.0, dark: float = 10.0
) -> Iterator[Any]:
    """Every pixel of a bit's picture is at random bright or dark, by the bit's strength of full contrast."""
    rng, bright = np.random.default_rng(3), np.ones(shape, dtype=bool)
    for name in NAMES:
        bit = name.removesuffix(" inverse")
        if name == bit:
            bright = rng.random(shape) < 0.5
        sign = np.where(bright, 0.5, -0.5) * (-1.0 if name.endswith("inverse") else 1.0)
        level = {"white": 1.0, "black": 0.0}.get(name, 0.5 + sign * strength.get(bit, 1.0))
        yield np.round(dark + (light - dark) * np.broadcast_to(level, shape)).astype(np.uint8)


def test_the_dimmed_bit_is_named_with_its_strength() -> None:
    found = bit_strengths(photographs({"u bit 2": 0.05, "v bit 1": 0.6}), NAMED)
    assert [bit.name for bit in found] == ["u bit 1", "u bit 2", "v bit 1"]
    assert [bit.name for bit in found if bit.weak] == ["u bit 2"]
    np.testing.assert_allclose([bit.median for bit in found], [1.0, 0.05, 0.6], atol=0.006)
    np.testing.assert_array_equal([bit.unsure_share for bit in found], [0.0, 1.0, 0.0])


def test_a_bit_that_is_faint_in_a_corner_shows_in_its_percentiles_and_share() -> None:
    images = list(photographs({}))
    for index in (2, 3):
        images[index][:4] = 105
    first = bit_strengths(images, NAMED)[0]
    assert first.unsure_share == pytest.approx(0.1)
    assert not first.weak
    assert first.percentile_5 == 0.0
    assert first.median == pytest.approx(1.0)


def test_pixels_without_the_panels_light_do_not_count() -> None:
    images = list(photographs({}))
    for image in images:
        image[20:] = 10 + (image[20:] > 100) * 12  # darker surroundings, in which everything is too coarse to tell
        image[20:, ::2] = 22
    assert [bit.unsure_share for bit in bit_strengths(images, NAMED)] == [0.0, 0.0, 0.0]


def test_a_photograph_too_few_is_refused() -> None:
    with pytest.raises(BadInputError, match="'v bit 1 inverse'"):
        bit_strengths(list(photographs({}))[:-1], NAMED)

"""Random damage to a valid file gives a sentence or a correct result, whatever the reader."""

import os
import re
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from corpus.case import Case
from corpus.readers import READERS
from wlr_render.errors import BadInputError

EXAMPLES = int(os.environ.get("WLR_DAMAGE_EXAMPLES", "25"))
"""Random damages of each file: few in every run of the tests, more when a reader has changed."""


ENDLESS = ("aperture.low", "aperture.high", "mount.slip_time_s")
"""Results that are infinite where the file states none."""
WRONG = (b"nan", b"inf", b"-inf", b"1e308", b"-1", b"0", b"9" * 400, b'"text"', b"[]", b"{}", b"null", b"1e39", b"")
NUMBER = re.compile(rb"-?\d+(\.\d+)?([eE][-+]?\d+)?")


@st.composite
def damages(draw: Callable[..., Any]) -> Callable[[bytes], bytes]:
    """A function of a file's content that flips, cuts, doubles or replaces something at a random place."""
    kind = draw(st.sampled_from(["flip", "cut", "double", "drop", "number", "number", "number"]))
    place, length = draw(st.floats(0, 1)), draw(st.integers(1, 60))
    wrong: bytes = draw(st.sampled_from(WRONG))
    bit = draw(st.integers(0, 7))

    def damage(content: bytes) -> bytes:
        at = int(place * (len(content) - 1))
        if kind == "flip":
            return content[:at] + bytes([content[at] ^ 1 << bit]) + content[at + 1 :]
        if kind == "cut":
            return content[:at]
        if kind == "double":
            return content[: at + length] + content[at:]
        found = NUMBER.search(content, at) or NUMBER.search(content)
        if kind == "drop" or found is None:
            return content[:at] + content[at + length :]
        return content[: found.start()] + wrong + content[found.end() :]

    return damage


def infinite(value: Any, place: str = "result") -> Iterator[str]:
    """Places of a result that hold an infinite number; NaN stands for what is not recorded, and readers check it."""
    if isinstance(value, np.ndarray) and value.dtype.kind in "fc":
        yield from [place] if np.isinf(value).any() else []
    elif isinstance(value, float):
        yield from [place] if np.isinf(value) else []
    elif is_dataclass(value) and not isinstance(value, type):
        for field in fields(value):
            yield from infinite(getattr(value, field.name), f"{place}.{field.name}")
    elif isinstance(value, dict | list | tuple):
        for key, part in value.items() if isinstance(value, dict) else enumerate(value):
            yield from infinite(part, f"{place}.{key}")


def wrongly_infinite(value: Any) -> list[str]:
    return [place for place in infinite(value) if not place.endswith(ENDLESS)]


@pytest.mark.parametrize("name", READERS)
def test_damage_ends_in_a_sentence_or_a_result(name: str, bases: Path, tmp_path: Path) -> None:
    # The lenses and boards of a session are beside it, a mesh finds its textures, and a lens its glasses.
    Case("", (), tuple(path.name for path in bases.iterdir() if path.name == name.split("/")[0])).build(bases, tmp_path)
    for neighbour in ("box.obj", "lens.zmx", "glasses.agf"):
        (tmp_path / neighbour).write_bytes((bases / neighbour).read_bytes())
    path = tmp_path / name
    valid = path.read_bytes()
    assert wrongly_infinite(READERS[name](path)) == []

    @settings(
        max_examples=EXAMPLES,
        deadline=None,
        database=None,
        derandomize="WLR_DAMAGE_EXAMPLES" not in os.environ,
        suppress_health_check=list(HealthCheck),
    )
    @given(damages())
    def check(damage: Callable[..., Any]) -> None:
        path.write_bytes(damage(valid))
        try:
            result = READERS[name](path)
        except BadInputError as error:
            sentence = str(error)
            assert "\n" not in sentence, sentence
            assert len(sentence) < 1000, sentence
            assert path.name in sentence or path.parent.name in sentence, sentence
        else:
            assert wrongly_infinite(result) == [], damage(valid)[:2000]

    check()

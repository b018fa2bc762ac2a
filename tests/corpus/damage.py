"""Systematic damage to structured files: every key of a valid file is given wrong values, without naming any key."""

import copy
import math
import random
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from corpus.case import Case, Change

Keys = tuple[str | int, ...]
MISSING = object()
HUGE = 10**400
ESCAPES = "a\x1b[31m\nforged: \u202e line"

# By name: the value, and whether no key of any file may take it.
NUMBERS: dict[str, tuple[Any, bool]] = {
    "nan": (math.nan, True),
    "inf": (math.inf, True),
    "text": ("twelve", True),
    "list": ([], True),
    "table": ({"a": 1}, True),
    "1e308": (1e308, True),
    "huge": (HUGE, True),
    "minus": (-1, False),
    "zero": (0, False),
}
VECTORS: dict[str, tuple[Any, bool]] = {
    "nan inside": (math.nan, True),
    "inf inside": (-math.inf, True),
    "text inside": ("x", True),
    "1e308 inside": (1e308, True),
    "huge inside": (HUGE, True),
    "list inside": ([1.0, [2.0]], True),
    "table inside": ({}, True),
}
TEXTS: dict[str, tuple[Any, bool]] = {
    "number": (5, True),
    "list": ([], True),
    "empty": ("", False),
    "escapes": (ESCAPES, False),
    "parents": ("../../x", False),
    "long": ("x" * 20_000, False),
    "nul": ("a\x00b", False),
}


def leaves(content: Any, keys: Keys = ()) -> Iterator[tuple[Keys, Any]]:
    """Keys and value of everything in a structure that is no table or list of tables."""
    if isinstance(content, Mapping) and content:
        for key, value in content.items():
            yield from leaves(value, (*keys, key))
    elif isinstance(content, list) and content and isinstance(content[0], Mapping):
        for index, value in enumerate(content):
            yield from leaves(value, (*keys, index))
    else:
        yield keys, content


def with_value(content: Any, keys: Keys, value: Any) -> Any:
    """A copy of a structure with another value, or without it if `MISSING`."""
    changed = copy.deepcopy(content)
    parent = changed
    for key in keys[:-1]:
        parent = parent[key]
    if value is MISSING:
        del parent[keys[-1]]
    else:
        parent[keys[-1]] = value
    return changed


def toml_text(value: Any) -> str:
    """A structure as TOML: one line for each key of the top level."""
    return "".join(f"{key} = {_inline(each)}\n" for key, each in value.items())


def _inline(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        safe = value.replace("\\", "\\\\").replace('"', '\\"')
        return '"' + "".join(char if char.isprintable() else f"\\u{ord(char):04x}" for char in safe) + '"'
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_inline(key)} = {_inline(each)}" for key, each in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_inline, value)) + "]"
    return repr(value)


def damaged(
    kind: str,
    content: Any,
    file: str,
    save: Callable[[Path, Any], object],
    arguments: Sequence[str],
    files: Sequence[str],
    seen: set[tuple[str, ...]],
    count: int = 2,
) -> Iterator[Case]:
    """Cases in which one key of a file is wrong.

    Args:
        kind: of input, the first part of their names.
        content: of the valid file.
        file: its name.
        save: writes a content to a path.
        arguments: of the command that reads the file.
        files: valid files that it needs.
        seen: keys without indices that have had their cases; kept up to date.
        count: wrong values for each key, chosen in turn.
    """
    for keys, value in leaves(content):
        plain = tuple(key for key in keys if isinstance(key, str))
        if plain in seen:
            continue
        seen.add(plain)
        dotted = ".".join(plain)
        for title, wrong, sure in _choice(dotted, value, count):
            yield Case(
                f"{kind}/{dotted} {title}",
                tuple(arguments),
                tuple(files),
                _saving(file, save, with_value(content, keys, wrong)),
                (Path(file).name, f"{plain[-1]}|NaN|Infinity")
                if sure and "1e308" not in title and "huge" not in title
                else (),
                "refused" if sure else "read" if wrong is MISSING else "any",
                file,
            )


def _saving(file: str, save: Callable[[Path, Any], object], content: Any) -> Change:
    return lambda folder: save(folder / file, content)


def _choice(dotted: str, value: Any, count: int) -> Iterator[tuple[str, Any, bool]]:
    """Some wrong values for a key, by a choice that depends on its name alone, and its absence."""
    rng = random.Random(zlib.crc32(dotted.encode()))
    is_vector = isinstance(value, list)
    table = TEXTS if isinstance(value, str) else VECTORS if is_vector else NUMBERS
    for title in rng.sample(sorted(table), count):
        wrong, sure = table[title]
        yield title, _with_element(value, wrong, rng) if is_vector else wrong, sure
    if rng.random() < 0.5:
        yield "missing", MISSING, False


def _with_element(vector: list[Any], wrong: Any, rng: random.Random) -> list[Any]:
    changed = copy.deepcopy(vector)
    inner = changed
    while inner and isinstance(inner[0], list):
        inner = inner[rng.randrange(len(inner))]
    if inner:
        inner[rng.randrange(len(inner))] = wrong
    else:
        inner.append(wrong)
    return changed

"""State of reading a Zemax lens file: the lines of each surface, and their numbers."""

from dataclasses import dataclass, field

from wlr_render.errors import BadInputError
from wlr_render.optics.lens_files.sequence import LensReading, finite

MOST_NUMBERED = 500
"""Largest number of a parameter of a surface."""


@dataclass
class ZemaxReading(LensReading):
    """State of reading one Zemax file.

    Attributes:
        manufacturers: names of glass catalogues in the header.
    """

    manufacturers: tuple[str, ...] = ()

    def number(self, words: list[str], place: int, line: int, key: str, infinite: bool = False) -> float:
        """Return a number of a line, with a point or a comma."""
        word = words[place].replace(",", ".") if place < len(words) else ""
        word = "inf" if infinite and word.upper() == "INFINITY" else word
        return finite(word, f"{self.path}: line {line}: value {place + 1} of {key}", infinite)


@dataclass
class ZemaxSurface:
    """The lines of one surface: words after each key, with the line's number."""

    reading: ZemaxReading
    number: int
    lines: list[tuple[str, list[str], int]] = field(default_factory=list)

    def last(self, key: str) -> tuple[list[str], int] | None:
        """Return the words and line number of the last line with a key."""
        lines = [(words, line) for each, words, line in self.lines if each == key]
        return lines[-1] if lines else None

    def value(self, key: str, default: float = 0.0, infinite: bool = False) -> float:
        """Return the first number of a key."""
        line = self.last(key)
        return default if line is None else self.reading.number(line[0], 0, line[1], key, infinite)

    def pair(self, key: str) -> tuple[float, float] | None:
        """Return the first two numbers of a key; None without it."""
        line = self.last(key)
        if line is None:
            return None
        first, second = (self.reading.number(line[0], place, line[1], key) for place in (0, 1))
        return first, second

    def numbered(self, key: str) -> dict[int, float]:
        """Return the values of `PARM` or `XDAT`, by their number."""
        values = {}
        for name, words, line in self.lines:
            if name == key:
                place = self.reading.number(words, 0, line, key)
                if not 0 <= place <= MOST_NUMBERED:
                    raise BadInputError(
                        f"{self.reading.path}: line {line}: {key} has the number {place:g}; correct it."
                    )
                values[int(place)] = self.reading.number(words, 1, line, key)
        values.pop(0, None)  # number 0 has no meaning for the surfaces that are read
        return values

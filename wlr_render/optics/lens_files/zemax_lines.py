"""State of reading a Zemax lens file: the lines of each surface, numbers, and notes."""

from dataclasses import dataclass, field
from pathlib import Path

from wlr_render.errors import BadInputError
from wlr_render.optics.lens_files.glass_catalogues import GlassCatalogue
from wlr_render.optics.lens_files.sequence import Notes, Part, finite, ignore

MOST_NUMBERED = 500
"""Largest number of a parameter of a surface."""


@dataclass
class SurfaceLines:
    """The lines of one surface: words after each key, with the line's number."""

    number: int
    lines: list[tuple[str, list[str], int]] = field(default_factory=list)

    def last(self, key: str) -> tuple[list[str], int] | None:
        """Return the words and line number of the last line with a key."""
        lines = [(words, line) for each, words, line in self.lines if each == key]
        return lines[-1] if lines else None


@dataclass
class ZemaxReading:
    """The state of reading one file."""

    path: Path
    catalogue: GlassCatalogue
    unit: float = 1e-3
    manufacturers: tuple[str, ...] = ()
    notes: Notes = field(default_factory=list)
    unknown_glasses: dict[str, list[int]] = field(default_factory=dict)

    def number(self, words: list[str], place: int, line: int, key: str, infinite: bool = False) -> float:
        """Return a number of a line, with a point or a comma."""
        word = words[place].replace(",", ".") if place < len(words) else ""
        word = "inf" if infinite and word.upper() == "INFINITY" else word
        return finite(word, f"{self.path}: line {line}: value {place + 1} of {key}", infinite)

    def value(self, surface: SurfaceLines, key: str, default: float = 0.0, infinite: bool = False) -> float:
        """Return the first number of a surface's key."""
        line = surface.last(key)
        return default if line is None else self.number(line[0], 0, line[1], key, infinite)

    def numbered(self, surface: SurfaceLines, key: str) -> dict[int, float]:
        """Return the values of `PARM` or `XDAT`, by their number."""
        values = {}
        for name, words, line in surface.lines:
            if name == key:
                place = self.number(words, 0, line, key)
                if not 0 <= place <= MOST_NUMBERED:
                    raise BadInputError(f"{self.path}: line {line}: {key} has the number {place:g}; correct it.")
                values[int(place)] = self.number(words, 1, line, key)
        values.pop(0, None)  # has no meaning for the surfaces that are read
        return values

    def ignore(
        self,
        surface: SurfaceLines | None,
        key: str,
        value: object,
        reason: str,
        bends_rays: bool = False,
        part: Part = "other",
    ) -> None:
        """Note a key of a surface, or of the header, that is not read as it stands."""
        ignore(self.notes, None if surface is None else surface.number, key, value, reason, bends_rays, part)

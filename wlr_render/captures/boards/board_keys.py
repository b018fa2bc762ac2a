"""Lengths in board files: millimetres, or pixels of the monitor that shows the board."""

from dataclasses import dataclass
from typing import Any

from wlr_render.io.file_records import MM, Key, Place, scaled
from wlr_render.io.toml_files import Table

_LARGEST_M = 2.0  # largest square, dot or gap; a larger one is in another unit


@dataclass(frozen=True, eq=False)
class BoardPlace(Place):
    """Place of a board file, with the name of its unit of length, "mm" or "px" of a monitor, and the unit in metres."""

    unit: str = "mm"
    unit_m: float = MM


@dataclass(frozen=True)
class BoardLength(Key):
    """Key of a length of a board, whose name ends in the unit of the file; `least` is in metres."""

    least: float | None = 5e-5

    @property
    def names(self) -> tuple[str, ...]:
        """The key in each unit."""
        return f"{self.name}_mm", f"{self.name}_px"

    def _key(self, place: Place) -> Key:
        assert isinstance(place, BoardPlace)
        least, most = (self.least or 0.0) / place.unit_m, _LARGEST_M / place.unit_m
        return Key(f"{self.name}_{place.unit}", scaled(place.unit_m), least=least, most=most, digits=9)

    def read(self, table: Table, place: Place) -> Any:
        """Return the length in metres; raises as `Key.read`."""
        return self._key(place).read(table, place)

    def keys(self, value: Any, place: Place) -> dict[str, Any]:
        """Return the key and value of a length in metres."""
        return self._key(place).keys(value, place)


MARGIN = BoardLength("margin", least=0)
"""Key of a margin, which may be 0."""
MOST_FEATURES = 2000
"""Most rows or columns of features."""

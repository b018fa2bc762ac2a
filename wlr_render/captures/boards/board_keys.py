"""Lengths in board files: millimetres, or pixels of the monitor that shows the board."""

from dataclasses import dataclass
from typing import Any

from wlr_render.io.file_records import MM, Key, Place, scaled
from wlr_render.io.toml_files import Table

_LARGEST_M = 2.0  # largest square, dot or gap: above, lengths are in another unit


@dataclass(frozen=True, eq=False)
class BoardPlace(Place):
    """Place of a board's file, and the unit of its lengths: millimetres, or pixels ("px") of a monitor, metres."""

    unit: str = "mm"
    unit_m: float = MM


@dataclass(frozen=True)
class BoardLength(Key):
    """A length of a board under a key with the unit of its file; `least` is in metres."""

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
        """Return the key of a length."""
        return self._key(place).keys(value, place)


MARGIN = BoardLength("margin", least=0)
"""Form of a margin, which may be 0."""
MOST_FEATURES = 2000
"""Most rows or columns of features."""

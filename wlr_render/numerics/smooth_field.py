"""Smooth random fields over a rectangle: waves whose prior sizes fall with their frequency.

The waves have no part that is linear in the place, because poses and scales have that part.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from wlr_render.numerics.arrays import FloatArray, IntArray

_BEYOND = 1.15  # ratio of the waves' extent, at whose ends all sines vanish, to the rectangle
_GRID = np.stack(np.meshgrid(*[np.linspace(-1.0, 1.0, 15)] * 2), axis=-1).reshape(-1, 2)


@dataclass(frozen=True)
class SmoothField:
    """Sine waves over a rectangle, minus their linear part.

    Attributes:
        low, high: (2,) corners of the rectangle; outside, the field has the value of the nearest point of its edge.
        counts: largest number of half waves along each side.
        fall: decrease of the logarithm of a wave's size per half wave.
    """

    low: tuple[float, float]
    high: tuple[float, float]
    counts: tuple[int, int]
    fall: float = 0.25

    @classmethod
    def over(cls, low: FloatArray, high: FloatArray, finest: float, most: int) -> "SmoothField":
        """Return the field with half waves down to `finest`, at most `most` of them along a side."""
        counts = [int(count) for count in np.clip(np.ceil(_BEYOND * (high - low) / finest), 2, most)]
        return cls((float(low[0]), float(low[1])), (float(high[0]), float(high[1])), (counts[0], counts[1]))

    def __len__(self) -> int:
        return self.counts[0] * self.counts[1]

    @cached_property
    def sizes(self) -> FloatArray:
        """(k,) prior sizes of the coefficients of a field with an rms of 1 over the rectangle."""
        size = np.exp(-self.fall * self._orders.sum(axis=1))
        waves = self._products(_GRID) - np.column_stack([np.ones(len(_GRID)), _GRID]) @ self._linear
        return np.asarray(size / np.sqrt(np.sum(np.mean((waves * size) ** 2, axis=0))))

    def waves(self, place: FloatArray) -> FloatArray:
        """Return the waves (n, k) at places (n, 2)."""
        middle, half = 0.5 * (np.array(self.high) + self.low), 0.5 * (np.array(self.high) - self.low)
        unit = np.clip((place - middle) / half, -1.0, 1.0)
        return np.asarray(self._products(unit) - np.column_stack([np.ones(len(unit)), unit]) @ self._linear)

    @property
    def _orders(self) -> IntArray:
        """(k, 2) numbers of half waves along x and y."""
        along = np.meshgrid(*(np.arange(1, count + 1) for count in self.counts), indexing="ij")
        return np.stack(along, axis=-1).reshape(-1, 2)

    def _products(self, unit: FloatArray) -> FloatArray:
        """Return the waves (n, k) with their linear part, at places (n, 2) from -1 to 1 over the rectangle."""
        sides = [
            np.sin(0.5 * np.pi * (at[:, None] / _BEYOND + 1.0) * np.arange(1, count + 1))
            for at, count in zip(unit.T, self.counts, strict=True)
        ]
        return np.asarray((sides[0][:, :, None] * sides[1][:, None]).reshape(len(unit), len(self)))

    @cached_property
    def _linear(self) -> FloatArray:
        """(3, k) constant and slopes of each wave over the rectangle, for places from -1 to 1."""
        return np.asarray(
            np.linalg.lstsq(np.column_stack([np.ones(len(_GRID)), _GRID]), self._products(_GRID), rcond=None)[0]
        )

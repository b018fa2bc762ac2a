"""Smooth random fields over a rectangle: waves whose prior sizes fall with their frequency.

Waves without the part that is linear in the place: poses and scales have that part.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from wlr_render.numerics.arrays import FloatArray, IntArray

_BEYOND = 1.15  # extent of the waves over that of the rectangle: all sines vanish at their edge
_GRID = 15  # places along each side at which the linear part is fitted
_FALL = 0.25  # fall of the logarithm of a wave's size for each half wave


@dataclass(frozen=True)
class SmoothField:
    """Sine waves over a rectangle, less their linear part.

    Attributes:
        low, high: (2,) corners of the rectangle. Beyond it the field continues to its edge and is constant.
        counts: half waves along each side, 1 to this many.
    """

    low: tuple[float, float]
    high: tuple[float, float]
    counts: tuple[int, int]

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
        size = np.exp(-_FALL * self._orders.sum(axis=1))
        side = [np.linspace(low, high, _GRID) for low, high in zip(self.low, self.high, strict=True)]
        rms = np.sqrt(np.mean((self.waves(np.stack(np.meshgrid(*side), axis=-1).reshape(-1, 2)) @ np.diag(size)) ** 2, 0))
        return np.asarray(size / np.sqrt(np.sum(rms**2)))

    def waves(self, place: FloatArray) -> FloatArray:
        """Return the waves (n, k) at places (n, 2)."""
        (along_x, along_y), unit = self._sides(place)
        waves = (along_x[:, :, None] * along_y[:, None]).reshape(len(place), -1)
        return np.asarray(waves - np.column_stack([np.ones(len(unit)), unit]) @ self._linear)

    def slopes(self, place: FloatArray) -> FloatArray:
        """Return the derivatives (n, k, 2) of the waves by the place."""
        (along_x, along_y), _ = self._sides(place)
        by_x, by_y = self._sides(place, slope=True)[0]
        both = [by_x[:, :, None] * along_y[:, None], along_x[:, :, None] * by_y[:, None]]
        slopes = np.stack([each.reshape(len(place), -1) for each in both], axis=-1)
        return np.asarray(slopes - self._linear[1:].T / self._half)

    @property
    def _half(self) -> FloatArray:
        return 0.5 * (np.array(self.high) - self.low)

    @property
    def _orders(self) -> IntArray:
        """(k, 2) half waves along x and y."""
        along = np.meshgrid(*(np.arange(1, count + 1) for count in self.counts), indexing="ij")
        return np.stack(along, axis=-1).reshape(-1, 2)

    def _sides(self, place: FloatArray, slope: bool = False) -> tuple[list[FloatArray], FloatArray]:
        """Return the waves (n, count) along each side, or their slopes, and the places (n, 2) from -1 to 1."""
        unit = np.clip((place - 0.5 * (np.array(self.low) + self.high)) / self._half, -_BEYOND, _BEYOND)
        sides = []
        for axis, count in enumerate(self.counts):
            rate = 0.5 * np.pi * np.arange(1, count + 1) / _BEYOND
            angle = (unit[:, axis, None] + _BEYOND) * rate
            sides.append(np.cos(angle) * rate / self._half[axis] if slope else np.sin(angle))
        return sides, unit

    @cached_property
    def _linear(self) -> FloatArray:
        """(3, k) constant and slopes of each wave over the rectangle, by places from -1 to 1."""
        side = np.linspace(-1.0, 1.0, _GRID)
        unit = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
        (along_x, along_y), _ = self._sides(0.5 * (np.array(self.low) + self.high) + unit * self._half)
        waves = (along_x[:, :, None] * along_y[:, None]).reshape(len(unit), -1)
        return np.asarray(np.linalg.lstsq(np.column_stack([np.ones(len(unit)), unit]), waves, rcond=None)[0])

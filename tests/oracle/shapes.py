"""Shapes that are no estimator's: plane waves at random, and smoothed random walks."""

import numpy as np

from oracle.own_tracer import FloatArray

_WAVES = 6
_SMOOTHED = 25  # steps of a walk


class PlaneWaves:
    """A sum of random plane waves over a unit box, of unit rms, and its gradient."""

    def __init__(self, seed: float, shortest: float = 0.8) -> None:
        """Wavelengths are `shortest` to five times as long; the box is 2 wide."""
        rng = np.random.default_rng(int(seed))
        direction = rng.uniform(0.0, 2.0 * np.pi, _WAVES)
        number = 2.0 * np.pi / (shortest * rng.uniform(1.0, 5.0, _WAVES))
        self._number = number[:, None] * np.stack([np.cos(direction), np.sin(direction)], axis=1)
        self._phase, size = rng.uniform(0.0, 2.0 * np.pi, _WAVES), rng.normal(size=_WAVES)
        self._size = size * np.sqrt(2.0) / np.linalg.norm(size)

    def __call__(self, place: FloatArray) -> FloatArray:
        """Heights (n,) at places (n, 2)."""
        return np.asarray(np.sin(place @ self._number.T + self._phase) @ self._size)

    def gradient(self, place: FloatArray) -> FloatArray:
        """Gradients (n, 2) at places (n, 2)."""
        return np.asarray((np.cos(place @ self._number.T + self._phase) * self._size) @ self._number)


class RandomWalks:
    """Smoothed random walks in time, each of mean 0 and rms 1."""

    def __init__(self, seed: float, count: int, duration_s: float, step_s: float) -> None:
        """So many walks; they are smoothed over 25 steps."""
        rng, self._times = np.random.default_rng(int(seed)), np.arange(0.0, duration_s, step_s)
        window = np.hanning(_SMOOTHED) / np.hanning(_SMOOTHED).sum()
        walks = np.cumsum(rng.normal(size=(count, len(self._times))), axis=1)
        walks = np.stack([np.convolve(np.pad(walk, _SMOOTHED // 2, "edge"), window, "valid") for walk in walks])
        self._walks = (walks - walks.mean(axis=1, keepdims=True)) / walks.std(axis=1, keepdims=True)

    def __call__(self, time_s: FloatArray) -> FloatArray:
        """Values (n, count) at times (n,)."""
        return np.stack([np.interp(time_s, self._times, walk) for walk in self._walks], axis=1)

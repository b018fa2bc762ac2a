from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from wlr_render.captures.decoded import Decoded
from wlr_render.captures.patterns.pattern import Pattern
from wlr_render.mappings import Panel
from wlr_render.numerics.arrays import BoolArray, Float32Array, FloatArray


@dataclass(frozen=True)
class ToyCamera:
    """A camera that sees a panel through a smooth map; each pixel averages the panel over its own area.

    Attributes:
        panel: seen.
        size_px: width, height of the photographs.
        scale: panel pixels per camera pixel in the middle.
        turn: radians.
        perspective: relative change of the scale over the picture.
        black, white: grey values of the dark and the lit panel, number or (h, w).
        noise: standard deviation, grey values.
        panel_gamma, camera_gamma: light = value ** panel_gamma, grey = light ** (1 / camera_gamma).
        samples: of the area, along each axis.
    """

    panel: Panel
    size_px: tuple[int, int] = (160, 128)
    scale: float = 1.5
    turn: float = 0.02
    perspective: float = 0.05
    black: float | np.ndarray = 20.0
    white: float | np.ndarray = 180.0
    noise: float = 0.0
    panel_gamma: float = 1.0
    camera_gamma: float = 1.0
    samples: int = 6

    def position(self, x: FloatArray, y: FloatArray) -> tuple[Any, Any]:
        """Panel positions of places in the picture."""
        x, y = x - self.size_px[0] / 2, y - self.size_px[1] / 2
        across, down = np.cos(self.turn) * x - np.sin(self.turn) * y, np.sin(self.turn) * x + np.cos(self.turn) * y
        depth = 1 + self.perspective * (x / self.size_px[0] + 0.5 * y / self.size_px[1])
        return (
            self.panel.width_px / 2 + self.scale * across / depth,
            self.panel.height_px / 2 + self.scale * down / depth,
        )

    def truth(self) -> NDArray[Any]:
        """(h, w, 2) panel position at the pixel centres."""
        x, y = np.meshgrid(np.arange(self.size_px[0]) + 0.5, np.arange(self.size_px[1]) + 0.5)
        return np.stack(self.position(x, y), axis=-1)

    def whole(self) -> BoolArray:
        """(h, w) where a pixel and the ring around it lie on the panel."""
        margin = 1.5 * self.scale
        truth = self.truth()
        return np.asarray(np.all((truth > margin) & (truth < self.panel.size_px - margin), axis=-1))

    def photographs(self, pattern: Pattern, seed: int = 0) -> Iterator[Any]:
        """Yield 8-bit photographs of all pictures of a pattern."""
        rng = np.random.default_rng(seed)
        places = self._places()
        for index in range(len(pattern.names())):
            light = (pattern.image(index) / 255) ** self.panel_gamma
            part = self._average(light, places) ** (1 / self.camera_gamma)
            grey = self.black + (np.asarray(self.white) - self.black) * part
            yield np.clip(np.round(grey + rng.normal(0, self.noise, grey.shape)), 0, 255).astype(np.uint8)

    def _places(self) -> list[tuple[Any, Any]]:
        """For each sample of a pixel's area: (h, w) index of a panel pixel, and whether it is on the panel."""
        steps = np.arange(self.samples) / self.samples
        rng = np.random.default_rng(0)
        width, height = self.panel.width_px, self.panel.height_px
        found = []
        for dx, dy in ((dx, dy) for dx in steps for dy in steps):
            x, y = np.meshgrid(np.arange(self.size_px[0]) + dx, np.arange(self.size_px[1]) + dy)
            x, y = (place + rng.uniform(0, 1 / self.samples, x.shape) for place in (x, y))
            u, v = (np.floor(place).astype(np.int32) for place in self.position(x, y))
            inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
            found.append((np.clip(v, 0, height - 1) * width + np.clip(u, 0, width - 1), inside))
        return found

    def _average(self, light: FloatArray, places: Sequence[tuple[Any, Any]]) -> Float32Array:
        flat = light.ravel().astype(np.float32)
        return np.asarray(sum(flat[index] * inside for index, inside in places) / len(places))


@pytest.fixture(scope="session")
def toy_camera() -> Callable[..., Any]:
    return ToyCamera


@pytest.fixture(scope="session")
def errors_of() -> Callable[[Any, Decoded], tuple[Any, Any]]:
    """Errors (n,) of accepted pixels along the worse axis, and the accepted part of the pixels on the panel."""

    def errors(camera: ToyCamera, decoded: Decoded) -> tuple[Any, Any]:
        off = np.abs(decoded.pixel - camera.truth()).max(axis=-1)
        return off[decoded.accepted], np.mean(decoded.accepted[camera.whole()])

    return errors

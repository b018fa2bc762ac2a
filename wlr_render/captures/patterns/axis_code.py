"""Codes of one axis of a panel, and a panel's code made of two of them."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.decoded import Decoded
from wlr_render.captures.patterns.pattern import DEFAULT_OPTIONS, DecodeOptions
from wlr_render.captures.patterns.photometry import Light, NoiseMeter, read_light
from wlr_render.captures.patterns.settle import AxisReading, settle
from wlr_render.captures.patterns.shots import Shots
from wlr_render.captures.photographs import Photograph
from wlr_render.mappings import Panel


class AxisCode(Protocol):
    """Pictures that vary along one axis only, and what their photographs say."""

    def names(self) -> list[str]:
        """Names of its pictures in the order of showing."""

    def line(self, index: int) -> NDArray[np.uint8]:
        """(length of the axis in panel pixels,) what picture `index` of `names` shows."""

    def read(self, shots: Shots, light: Light, noise: NoiseMeter) -> AxisReading:
        """Take one photograph per picture; `noise` learns from them.

        Raises:
            BadInputError: a photograph is missing or not in the order of showing.
        """


@dataclass(frozen=True)
class PanelCode(ABC):
    """White, black, then the code of u, then that of v: a `Pattern` of which a family says only how one axis is coded.

    Attributes:
        panel: it is made for.
    """

    panel: Panel

    @abstractmethod
    def axis(self, name: str, length_px: int) -> AxisCode:
        """The code of the axis "u" or "v" of so many panel pixels."""

    def names(self) -> tuple[str, ...]:
        """What the pictures show, in the order of showing: see `Pattern.names`."""
        return "white", "black", *self._u.names(), *self._v.names()

    def image(self, index: int) -> NDArray[np.uint8]:
        """(panel height, panel width) grey picture number `index`."""
        size = self.panel.height_px, self.panel.width_px
        if index < 2:
            return np.full(size, 255 * (1 - index), dtype=np.uint8)
        of_u = len(self._u.names())
        line = self._u.line(index - 2) if index - 2 < of_u else self._v.line(index - 2 - of_u)[:, None]
        return np.array(np.broadcast_to(line, size))

    def decode(self, photographs: Iterable[Photograph], options: DecodeOptions = DEFAULT_OPTIONS) -> Decoded:
        """Panel positions from one photograph per picture; see `Pattern.decode`."""
        shots = Shots(photographs, self.names())
        light = read_light(shots, options)
        noise = NoiseMeter(light)
        readings: Sequence[AxisReading] = [axis.read(shots, light, noise) for axis in (self._u, self._v)]
        shots.finish()
        return settle(readings, light, shots.peak, noise.variance(), options, self.panel)

    @property
    def _u(self) -> AxisCode:
        return self.axis("u", self.panel.width_px)

    @property
    def _v(self) -> AxisCode:
        return self.axis("v", self.panel.height_px)

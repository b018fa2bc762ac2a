"""Codes of one axis of a panel, and a panel's code made of two of them."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.decoded import Decoded
from wlr_render.captures.patterns.pattern import DecodeOptions
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
class PanelCode:
    """White, black, then the code of u, then that of v."""

    panel: Panel
    u: AxisCode
    v: AxisCode

    def names(self) -> tuple[str, ...]:
        """See `Pattern.names`."""
        return "white", "black", *self.u.names(), *self.v.names()

    def image(self, index: int) -> NDArray[np.uint8]:
        """See `Pattern.image`."""
        size = self.panel.height_px, self.panel.width_px
        if index < 2:
            return np.full(size, 255 * (1 - index), dtype=np.uint8)
        of_u = len(self.u.names())
        line = self.u.line(index - 2) if index - 2 < of_u else self.v.line(index - 2 - of_u)[:, None]
        return np.array(np.broadcast_to(line, size))

    def decode(self, photographs: Iterable[Photograph], options: DecodeOptions) -> Decoded:
        """See `Pattern.decode`."""
        shots = Shots(photographs, self.names())
        light = read_light(shots, options)
        noise = NoiseMeter(light)
        readings: Sequence[AxisReading] = [axis.read(shots, light, noise) for axis in (self.u, self.v)]
        shots.finish()
        return settle(readings, light, shots.peak, noise.variance(), options, self.panel)

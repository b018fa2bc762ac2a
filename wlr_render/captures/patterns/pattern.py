"""Patterns: images shown on a panel, coded axis by axis, and the decoding of their photographs."""

from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.decoded import DEFAULT_OPTIONS, Decoded, DecodeOptions
from wlr_render.captures.patterns.axis_code import AxisCode
from wlr_render.captures.patterns.photometry import NoiseMeter, PhotographReader, read_light
from wlr_render.captures.patterns.pixel_rejection import combine_axes
from wlr_render.captures.photographs import CodeImage
from wlr_render.mappings import Panel


@dataclass(frozen=True)
class Pattern(ABC):
    """A code for a whole panel: white, black, the code of u and the code of v; subclasses define the code of one axis.

    Decoding the pictures of any pattern gives the centre of every panel pixel.

    Attributes:
        panel: panel of the pattern.
    """

    panel: Panel

    @abstractmethod
    def axis(self, name: str, length_px: int) -> AxisCode:
        """Return the code of axis "u" or "v", `length_px` panel pixels long."""

    def names(self) -> tuple[str, ...]:
        """Return the names of the pictures in the order of showing, e.g. "white", "black", "u bit 10"."""
        return "white", "black", *self._u.names(), *self._v.names()

    def image(self, index: int) -> NDArray[np.uint8]:
        """Return the grey picture number `index`, (panel height, panel width)."""
        size = self.panel.height_px, self.panel.width_px
        if index < 2:
            return np.full(size, 255 * (1 - index), dtype=np.uint8)
        of_u = len(self._u.names())
        line = self._u.line(index - 2) if index - 2 < of_u else self._v.line(index - 2 - of_u)[:, None]
        return np.array(np.broadcast_to(line, size))

    def decode(self, photographs: Iterable[CodeImage | None], options: DecodeOptions = DEFAULT_OPTIONS) -> Decoded:
        """Decode one photograph per picture, in the order of showing.

        Photographs are read one at a time and not kept, so that the iterable may read them from disk. None stands for a
        missing photograph: decoding can do without a bit or its inverse, one step of a fringe, and white or black if a
        bit and its inverse follow.

        Raises:
            BadInputError: too few or too many photographs, sizes that differ, a set that is over- or under-exposed or
                not in the order of showing; the message names the photograph's number and its picture.
        """
        reader = PhotographReader(photographs, self.names())
        light = read_light(reader, options)
        noise = NoiseMeter(light)
        readings = [axis.read(reader, light, noise) for axis in (self._u, self._v)]
        reader.finish()
        return combine_axes(readings, light, reader.peak, noise.variance(), options, self.panel)

    @property
    def _u(self) -> AxisCode:
        return self.axis("u", self.panel.width_px)

    @property
    def _v(self) -> AxisCode:
        return self.axis("v", self.panel.height_px)

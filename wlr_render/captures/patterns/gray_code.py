"""Gray code with inverses: the number of each panel pixel, bit by bit."""

from dataclasses import dataclass

import numpy as np

from wlr_render.captures.decoded import Rejection
from wlr_render.captures.patterns.gray_bits import GrayAxis, read_gray
from wlr_render.captures.patterns.pattern import AxisCode, Pattern
from wlr_render.captures.patterns.photometry import NoiseMeter, PanelContrast, PhotographReader
from wlr_render.captures.patterns.pixel_rejection import AxisReading

_COARSEST = 3  # most unreadable bits, i.e. cells of 8 panel pixels; a coarser position is useless


@dataclass(frozen=True)
class GrayCode(Pattern):
    """Binary-reflected Gray code of columns and rows, each bit followed by its inverse; 46 pictures for 1920 x 1080.

    The shares of two neighbouring panel pixels in a camera pixel follow from the grey value of the bit that changes
    between them, so that positions are finer than a panel pixel. Where the finest bits cannot be read, the position is
    known to a cell of 2, 4 or 8 panel pixels, with a larger standard deviation. The code is best if a camera pixel is
    one to two panel pixels wide, and the camera's grey values are linear in light.
    """

    def axis(self, name: str, length_px: int) -> AxisCode:
        """Return the code of one axis: bits from coarse to fine, each followed by its inverse."""
        return _GrayPixels(name, length_px)


class _GrayPixels(GrayAxis):
    """Code of one axis; the cells are panel pixels."""

    def read(self, reader: PhotographReader, light: PanelContrast, noise: NoiseMeter) -> AxisReading:
        reading = read_gray(self, reader, light, noise, coarsest=_COARSEST)
        return AxisReading(
            position=reading.position.astype(np.float64),
            noise_gain=reading.noise_gain,
            evidence=reading.evidence,
            weak=np.full(light.lit.shape, Rejection.UNSURE_BIT, dtype=np.uint8),
            contradiction=np.zeros(light.lit.shape, dtype=np.bool_),
            cell_px=reading.cell_size,
            blur_px=reading.blur,
            is_counted=True,
        )

"""Code of one axis of a panel: a Gray code that numbers cells, fringes from long to short, or both in this order."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.decoded import Rejection
from wlr_render.captures.patterns.gray_bits import GrayAxis, read_gray
from wlr_render.captures.patterns.phase_steps import FringeAxis, read_fringe
from wlr_render.captures.patterns.photometry import NoiseMeter, PanelContrast, PhotographReader
from wlr_render.captures.patterns.pixel_rejection import AxisReading

_COARSEST = 3  # most unreadable fine bits, i.e. cells of 8 panel pixels; a coarser position is useless


@dataclass(frozen=True)
class AxisCode:
    """Pictures that vary along one axis, and their decoding.

    Attributes:
        length_px: panel pixels along the axis.
        gray: Gray code of the cells, or None.
        cell_px: width of a cell, panel pixels.
        fringes: fringes from long to short; the Gray code or the previous fringe identifies the period of each.
        far: largest distance of a fringe's position from the previous position, in periods; beyond it, the two
            contradict each other.
    """

    length_px: int
    gray: GrayAxis | None = None
    cell_px: int = 1
    fringes: tuple[FringeAxis, ...] = ()
    far: float = np.inf

    def names(self) -> list[str]:
        """Return the names of the pictures in the order of showing."""
        return self._bit_names() + [name for fringe in self.fringes for name in fringe.names()]

    def _bit_names(self) -> list[str]:
        return [] if self.gray is None else self.gray.names()

    def line(self, index: int) -> NDArray[np.uint8]:
        """Return the line of picture `index` of `names`, one value per panel pixel of the axis."""
        bits = len(self._bit_names())
        if self.gray is not None and index < bits:
            return np.repeat(self.gray.line(index), self.cell_px)[: self.length_px]
        number, step = divmod(index - bits, self.fringes[0].steps)
        return self.fringes[number].line(step)

    def read(self, reader: PhotographReader, light: PanelContrast, noise: NoiseMeter) -> AxisReading:
        """Decode one photograph per picture, and update `noise` from them.

        Raises:
            BadInputError: a photograph is missing or not in the order of showing.
        """
        shape, far = light.lit.shape, self.far
        if self.gray is None:
            # The first fringe covers the panel, so that its phase alone determines the position.
            position, far = np.full(shape, 0.5 * self.length_px), np.inf
            cell_px, blur = np.ones(shape, dtype=np.uint8), np.zeros(shape, dtype=np.float32)
            of_bits = gain = np.full(shape, np.inf, dtype=np.float32)
        else:
            code = read_gray(self.gray, reader, light, noise, 0 if self.fringes else _COARSEST)
            position, cell_px, of_bits, gain = code.position, code.cell_size, code.evidence, code.noise_gain
            blur = code.blur * np.float32(self.cell_px)
            if self.fringes:
                position, cell_px = (code.cell + 0.5) * self.cell_px, np.ones(shape, dtype=np.uint8)
        of_fringes, contradiction = np.full(shape, np.inf, dtype=np.float32), np.zeros(shape, dtype=np.bool_)
        for fringe in self.fringes:
            phase = read_fringe(fringe, reader, light, np.asarray(position, dtype=np.float64), far)
            if self.gray is None:  # with a Gray code, the bits and their inverses measure the noise
                noise.add(phase.steady, light.lit)
            position, gain, far = phase.position, phase.noise_gain, self.far
            contradiction |= phase.is_far
            of_fringes = np.minimum(of_fringes, phase.evidence)
        return AxisReading(
            position=position.astype(np.float64),
            noise_gain=gain,
            evidence=np.minimum(of_bits, of_fringes),
            weak=np.where(of_bits < of_fringes, Rejection.UNSURE_BIT, Rejection.WEAK_FRINGE).astype(np.uint8),
            contradiction=contradiction,
            cell_px=cell_px,
            blur_px=blur,
            is_counted=not self.fringes,
        )

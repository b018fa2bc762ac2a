"""What was found of a board in one photograph."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError


class BoardNotFoundError(BadInputError):
    """The photograph shows no board, or too little of it to tell which part; the sentence says which of the two."""


@dataclass(frozen=True, eq=False)
class BoardSighting:
    """Identified dots.

    Attributes:
        index: (n, 2) column and row of each dot on the board.
        pixel: (n, 2) where the dot's *centre* is seen, camera pixels from the outer corner of the top-left pixel; the
            bias of a perspective view of a disc is taken out.
        sigma_px: (n,) estimated standard deviation of `pixel` per axis.
        unidentified: number of dots that were seen but not told apart.
        disagreeing: number of dots whose size is not what the board has there.
    """

    index: NDArray[np.int64]
    pixel: NDArray[np.float64]
    sigma_px: NDArray[np.float64]
    unidentified: int = 0
    disagreeing: int = 0

    def only(self, rows: NDArray[np.bool_]) -> "BoardSighting":
        """Some of the dots, by mask (n,)."""
        return replace(self, index=self.index[rows], pixel=self.pixel[rows], sigma_px=self.sigma_px[rows])

    def __len__(self) -> int:
        return len(self.index)

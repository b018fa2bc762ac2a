"""What warping an intermediate image into the display gives, on any backend."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray


class WarpStatus(IntEnum):
    """What a display pixel shows."""

    SEEN = 0
    DISOCCLUDED = 1
    OUTSIDE = 2
    NO_RAY = 3

    @property
    def sentence(self) -> str:
        """The status in words."""
        return _SENTENCES[self]


_SENTENCES = {
    WarpStatus.SEEN: "the bent ray meets a surface, or the background, that the intermediate image shows",
    WarpStatus.DISOCCLUDED: "the bent ray passes an edge that hides from the intermediate image what it meets behind; "
    "the farther side of that edge stands in",
    WarpStatus.OUTSIDE: "the bent ray leads outside the intermediate image",
    WarpStatus.NO_RAY: "the display pixel has no ray into the world",
}


@dataclass(frozen=True, eq=False)
class WarpedImage:
    """A picture in display pixels.

    Attributes:
        colour: (height, width, 3) uint8 sRGB; the background where the status is OUTSIDE or NO_RAY.
        status: (height, width) uint8, one `WarpStatus` each.
        source: (height, width, 2) float32 pull map, position (u, v) in the intermediate image, NaN where the status is
            OUTSIDE or NO_RAY; None when not asked for.
    """

    colour: NDArray[np.uint8]
    status: NDArray[np.uint8]
    source: NDArray[np.float32] | None = None

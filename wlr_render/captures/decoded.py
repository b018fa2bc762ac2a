"""What a set of code photographs says: for every camera pixel which panel position it shows, how surely, or why not."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray


class Rejection(IntEnum):
    """Why a camera pixel has no panel position."""

    ACCEPTED = 0
    DARK = 1
    SATURATED = 2
    UNSURE_BIT = 3
    WEAK_FRINGE = 4
    CONTRADICTION = 5
    OUTSIDE_PANEL = 6
    ISOLATED = 7
    PARTLY_LIT = 8

    @property
    def sentence(self) -> str:
        """The reason in words."""
        return _SENTENCES[self]


_SENTENCES = {
    Rejection.ACCEPTED: "the pixel shows a panel position",
    Rejection.DARK: "the panel's light is too weak there to be told from noise",
    Rejection.SATURATED: "a photograph is at the end of its scale there",
    Rejection.UNSURE_BIT: "a bit of the code is too faint to be read",
    Rejection.WEAK_FRINGE: "the fringes are too faint for their phase",
    Rejection.CONTRADICTION: "code and fringes contradict each other",
    Rejection.OUTSIDE_PANEL: "the decoded position lies outside the panel",
    Rejection.ISOLATED: "the decoded position does not fit those of its neighbours",
    Rejection.PARTLY_LIT: "most of the light that its neighbour gets is missing: the pixel sees past an edge",
}


@dataclass(frozen=True, eq=False)
class Decoded:
    """A decoded set of photographs of one camera position.

    Attributes:
        pixel: (h, w, 2) float32 panel position that each camera pixel shows; NaN where rejected.
        sigma_px: (h, w) float32 estimated standard deviation of `pixel` per axis, panel pixels; NaN where rejected.
        confidence: (h, w) float32, 0 to 1: the weakest evidence that was needed, as a part of full contrast.
        rejection: (h, w) uint8, one `Rejection` each.
    """

    pixel: NDArray[np.float32]
    sigma_px: NDArray[np.float32]
    confidence: NDArray[np.float32]
    rejection: NDArray[np.uint8]

    @property
    def accepted(self) -> NDArray[np.bool_]:
        """(h, w) where there is a panel position."""
        return np.asarray(self.rejection == Rejection.ACCEPTED)

    def counts(self) -> dict[Rejection, int]:
        """How many camera pixels have which fate, without those that none has."""
        number = np.bincount(self.rejection.ravel(), minlength=len(Rejection))
        return {reason: int(number[reason]) for reason in Rejection if number[reason]}

"""What a family of panel codes does: shown pictures in, photographs out, panel positions back."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.decoded import Decoded
from wlr_render.captures.photographs import Photograph
from wlr_render.mappings import Panel


@dataclass(frozen=True)
class DecodeOptions:
    """When a camera pixel is believed.

    Attributes:
        full_scale: the largest value that the camera can give: 255, 1023, 4095, 65535.
        min_contrast: of white over black, as a part of the full scale: below, a pixel is dark. It is also dark where
            white over black is not well above the noise that the set itself shows.
        min_confidence: of the weakest evidence needed, as a part of full contrast.
    """

    full_scale: int = 255
    min_contrast: float = 0.02
    min_confidence: float = 0.1


DEFAULT_OPTIONS = DecodeOptions()


class Pattern(Protocol):
    """A code for a whole panel. The law: decoding its own pictures gives every panel pixel's centre."""

    @property
    def panel(self) -> Panel:
        """The panel it is made for."""

    def names(self) -> tuple[str, ...]:
        """What the pictures show, e.g. "white", "black", "u bit 10", "u bit 10 inverse", in the order of showing."""

    def image(self, index: int) -> NDArray[np.uint8]:
        """(panel height, panel width) grey picture number `index`."""

    def decode(self, photographs: Iterable[Photograph], options: DecodeOptions = DEFAULT_OPTIONS) -> Decoded:
        """Panel positions from one photograph per picture, in the order of showing.

        Photographs are taken one at a time and not kept, so that the iterable may read them from disk.

        Raises:
            BadInputError: too few or too many photographs, sizes that differ, a set that is over- or under-exposed or
                not in the order of showing; the sentence names the photograph's number and what it should show.
        """

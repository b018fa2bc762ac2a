"""Warping an intermediate image along bent rays: the rule that all backends follow, and what it gives.

For each display pixel the ray field has (a, b, c, d): in the camera frame of the intermediate image the world ray
passes through (c, d, 0) with tangents (a, b). A point of it at inverse depth w appears in the image at

    s(w) = (f_u (a + c w) + c_u, -f_v (b + d w) + c_v),

and what is visible there has inverse depth D(s). The ray meets what the image shows where D(s(w)) = w. The rule:

1. The search starts from the largest inverse depth W of the whole image, w = D(s(W)) of the nearest texel: where a
   near and a far surface both satisfy the equation, the near one hides the far one, and it is come to first.
2. w <- D(s(w)) until s moves by less than SETTLED_PX: the last s is the source position, SEEN. On a surface whose
   inverse depth rises by g per pixel the step shrinks by |f c g| (about 1e-3) each time: one step mostly does.
3. After MAX_STEPS without settling, s goes to and fro across an edge between two surfaces, neither of which the ray
   meets: it goes behind the near one, to what the image does not show. Of the last two positions that one is taken
   where the image shows the farther surface: DISOCCLUDED.
4. A position outside 0..width, 0..height is OUTSIDE; a NaN in the field is NO_RAY.

D is bilinear where its four texels differ by at most SURFACE_STEP of the largest (exact for planes, whose inverse
depth is linear in the pixel), else the nearest texel; beyond the border it repeats the border's texels. The background
has w = 0 and is met at (a, b). Colour is bilinear in the 8-bit sRGB values, as cv2.remap does, by four texel reads:
the hardware's own filter has 8-bit weights.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

MAX_STEPS = 6
SETTLED_PX = 0.01
SURFACE_STEP = 0.02


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

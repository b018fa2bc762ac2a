"""Warping an intermediate image along bent rays: the rule that all backends follow, and what it gives.

For each display pixel the ray field has (a, b, c, d); `moved_rays.in_camera_frame` tells it in the camera frame of the
intermediate image. There the world ray passes through (c, d, 0) with tangents (a, b). A point of it at inverse depth w
appears in the image at

    s(w) = (f_u (a + c w) + c_u, -f_v (b + d w) + c_v),

and what is visible there has inverse depth D(s). While D(s(w)) < w the ray is in front of what the image shows; it
meets it where D(s(w)) = w. The rule:

1. The path goes from the largest to the smallest inverse depth that the image shows along it, in equal turns of at
   most STEP_PX in the image (and at most MAX_MARCH turns). Both bounds come from tiles of TILE px: those within one
   tile of the path's middle if the path from the whole image's largest w to 0 is at most 2 TILE long, else from the
   whole image. Most paths are one turn long, because most tiles show one smooth surface.
2. A turn may hold the meeting if the ray is in front at its near end and comes past one of the two surfaces seen from
   its ends (either may end within the turn: thin things), or if it is behind at its near end and comes past the surface
   seen from its far end (it leaves what hid it and meets what is there).
3. There w <- D(s(w)), from the nearer of those two surfaces, which hides the other, if its w is within the turn or a
   turn beside it, else from the farther one. When s moves by less than SETTLED_PX, that place is the source, SEEN. On a
   surface whose inverse depth rises by g per pixel the step shrinks by |f c g| (about 1e-3) each time: one step mostly
   does.
4. If w leaves the turn and its neighbours, or does not settle in MAX_STEPS, the ray has passed an edge: it is now
   behind the near surface, or beside it. The search goes on with the next turns.
5. If nothing is met, the ray ended behind the edge that it passed last, where the image shows nothing of it:
   DISOCCLUDED. The farther side of that edge stands in: s at the nearer of the last two w that were tried.
6. A position outside 0..width, 0..height is OUTSIDE; a NaN in the field, or a ray that does not lead forwards, is
   NO_RAY.

D is bilinear where its four texels differ by at most SURFACE_STEP of the largest (exact for planes, whose inverse
depth is linear in the pixel), else the nearest texel; beyond the border it repeats the border's texels. The first one
asked for, at a path's near end, is the nearest texel. The background has w = 0 and is met at (a, b).

Colour is bilinear in the 8-bit sRGB values, as cv2.remap does, by four texel reads: the hardware's own filter has 8-bit
weights. Where the map minifies, `samples_per_axis` > 1 takes the mean of the square of that number of such samples,
spread evenly over what the display pixel covers in the image: `raster_camera.py` says how many are needed. The sides of
a display pixel in the image are differences of s(0) in blocks of 2 x 2 pixels, as GPUs take them; next
to a hole they count as 0.

With one field per colour channel (red, green, blue) each channel follows its own rays; the status is the worst of the
three (the largest), the source that of green.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

STEP_PX = 1.0
MAX_MARCH = 64
MAX_STEPS = 6
SETTLED_PX = 0.01
SURFACE_STEP = 0.02
TILE = 16


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

    @classmethod
    def of_channels(cls, images: Sequence["WarpedImage"]) -> "WarpedImage":
        """One picture of one for all colours, or of three whose red, green and blue are taken in this order.

        The pictures may hold all colours or, each, the grey values (height, width) of its own.
        """
        if len(images) == 1:
            return images[0]
        colours = [each.colour if each.colour.ndim == 2 else each.colour[..., k] for k, each in enumerate(images)]
        status = np.max([each.status for each in images], axis=0)
        return cls(np.stack(colours, axis=-1), status, images[1].source)

"""The backward warp of an intermediate image along rays: the algorithm that all backends implement, and its result.

For each display pixel the ray map holds (a, b, c, d); `view.image_from_ray_map` transforms it to the camera frame of
the intermediate image. There the world ray passes through (c, d, 0) with tangents (a, b). A point of the ray at inverse
depth w is projected to the image position

    s(w) = (f_u (a + c w) + c_u, -f_v (b + d w) + c_v),

where the image has inverse depth D(s). While D(s(w)) < w the ray is in front of the imaged surface; it intersects the
surface where D(s(w)) = w. The algorithm:

1. The path runs from the largest to the smallest inverse depth of the image along it. The bounds of all paths of a cell
   of the warp grid come from a pyramid of the smallest and largest values. Where they differ by less than DIRECT_PX in
   the image for a whole cell, the source is s(D(s(w))) with w midway between them, without the following steps.
2. The path is followed from its near end, texel by texel. A tile of TILE x TILE px is skipped if the ray is in front
   of all its surfaces, or behind one surface that fills it: no texel that could matter, and that the path crosses over
   more than a thousandth of a pixel, is left out. Only the part of the path in the image and a margin around it is
   followed: a point close to the lens may move the path's near end 100,000 px away.
3. The ray meets a texel's surface whose inverse depth lies between those at which it enters and leaves the texel. It
   also meets a surface between two texels if it was in front at the first and is behind at the second, and if both are
   of one surface: their inverse depths differ by at most SURFACE_STEP of the larger one, or open less than half a
   pixel. The position is refined by w <- D(s(w)), twice; on planes these steps shrink by a constant factor, which gives
   their limit. The position is the source, SEEN.
4. If the ray is behind at the second and the texels are not of one surface, the ray has passed a depth edge. The search
   continues: the ray may leave the occluder and meet the surface behind.
5. Without an intersection the ray ends behind the last depth edge that it crossed, in a region hidden from the image:
   DISOCCLUDED. The farther side of that edge is shown instead: s at the nearer of the edge's two inverse depths. Where
   an older picture shows the hidden surface, it is shown.
6. A position outside 0..width, 0..height is OUTSIDE; a NaN in the ray map, or a ray that does not lead forwards, is
   NO_RAY.

D is bilinear where its four texels differ by at most SURFACE_STEP of the largest (exact for planes, whose inverse
depth is linear in the pixel), otherwise the nearest texel; beyond the border it repeats the border's texels. The
background has w = 0 and is intersected at (a, b).

Colour is bilinear in linear light, and encoded once in the end; hardware filters have 8-bit weights, an error of at
most one code of 255. Where rays are followed, texels of a surface other than the one that the ray meets are ignored,
unless they lie within half a pixel of it: an edge that has moved leaves no trace at its old position. Where the map
minifies, several such samples are averaged, spread evenly over the area that the display pixel covers in the image:
along each axis as many as a spacing of SPACING_PX requires, at most `samples_per_axis`, for each cell of the warp grid.
The sides of a display pixel in the image are differences of s(0) in blocks of 2 x 2 pixels, as on GPUs.

With one ray map per colour channel (red, green, blue) each channel follows its own rays; the status is the worst of the
three (the largest), and the source is green's.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

SURFACE_STEP = 0.02
TILE = 8
DIRECT_PX = 0.05
SPACING_PX = 1.25
"""Largest spacing of bilinear samples that covers every texel: each sample reaches one pixel to either side."""


class WarpStatus(IntEnum):
    """Status of a display pixel after the warp."""

    SEEN = 0
    """The bent ray meets a surface, or the background, that the intermediate image shows."""
    DISOCCLUDED = 1
    """The bent ray meets a surface that an edge hides from the intermediate image; the edge's farther side is shown."""
    OUTSIDE = 2
    """The bent ray points outside the intermediate image."""
    NO_RAY = 3
    """The display pixel has no ray into the world."""


@dataclass(frozen=True, eq=False)
class WarpedImage:
    """A display image and its status per pixel.

    Attributes:
        colour: (height, width, 3) uint8 sRGB; the background where the status is OUTSIDE or NO_RAY.
        status: (height, width) uint8, one `WarpStatus` each.
        source: (height, width, 2) float32 pull map, position (u, v) in the intermediate image, NaN where the status is
            OUTSIDE or NO_RAY; None if not requested.
    """

    colour: NDArray[np.uint8]
    status: NDArray[np.uint8]
    source: NDArray[np.float32] | None = None

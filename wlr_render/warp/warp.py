"""The backward warp of an intermediate image along rays: the algorithm that all backends implement, and its result.

For each display pixel the ray map holds (a, b, c, d); `view.image_from_ray_map` takes it to the camera frame of the
intermediate image. There the world ray passes through (c, d, 0) with tangents (a, b). A point of the ray at inverse
depth w is projected to the image position

    s(w) = (f_u (a + c w) + c_u, -f_v (b + d w) + c_v),

where the image has inverse depth D(s). While D(s(w)) < w the ray is in front of the imaged surface; it intersects the
surface where D(s(w)) = w. The algorithm:

1. The path runs from the largest to the smallest inverse depth of the image along it, in equal steps of at most STEP_PX
   in the image (and at most MAX_STEPS steps). The bounds come from a pyramid whose finest texels hold the smallest and
   the largest value of TILE x TILE px: first for all paths of a cell of the warp grid, then for each pixel. Long
   paths are divided into parts, and the parts in front of the first and behind the last possible intersection are left
   out. Most paths have one step. Where the bounds differ by less than DIRECT_PX in the image for a whole cell, the
   source is s(D(s(w))) with w midway between them, and the following does not apply.
2. A step may contain the intersection if the ray is in front at its near end and crosses one of the two surfaces seen
   at its ends (either surface may end within the step: thin objects), or if it is behind at its near end and crosses
   the surface seen at its far end (it leaves the occluder and reaches the surface behind).
3. Such a step is refined by w <- D(s(w)), starting from the nearer of those two surfaces, which hides the other, if its
   w is within the step or an adjacent one, otherwise from the farther one. When s changes by less than CONVERGED_PX,
   that position is the source, SEEN. On a surface whose inverse depth rises by g per pixel each refinement shrinks the
   error by |f c g| (about 1e-3): one refinement is usually enough.
4. If w leaves the step and its neighbours, or does not converge in MAX_REFINEMENTS, the ray has crossed a depth edge:
   it is now behind the near surface, or has passed it. The search continues with the next steps.
5. Without an intersection the ray ends behind the last depth edge that it crossed, in a region hidden from the image:
   DISOCCLUDED. The farther side of that edge is shown instead: s at the nearer of the last two w tried.
6. A position outside 0..width, 0..height is OUTSIDE; a NaN in the ray map, or a ray that does not lead forwards, is
   NO_RAY.

D is bilinear where its four texels differ by at most SURFACE_STEP of the largest (exact for planes, whose inverse
depth is linear in the pixel), otherwise the nearest texel; beyond the border it repeats the border's texels. The first
query, at a path's near end, reads the nearest texel. The background has w = 0 and is intersected at (a, b).

Colour is bilinear in linear light, and encoded once in the end; hardware filters have 8-bit weights, which is worth a
code of 255 at most. Where the map minifies, `samples_per_axis` > 1 averages samples_per_axis squared such samples,
spread evenly over the area that the display pixel covers in the image: `raster_camera.py` says how many are needed. The
sides of a display pixel in the image are differences of s(0) in blocks of 2 x 2 pixels, as on GPUs. Cells of the warp
grid in which the map minifies by less than SPACING_PX have one sample.

With one ray map per colour channel (red, green, blue) each channel follows its own rays; the status is the worst of the
three (the largest), and the source is green's.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

STEP_PX = 1.0
MAX_STEPS = 256
MAX_REFINEMENTS = 6
CONVERGED_PX = 0.01
SURFACE_STEP = 0.02
TILE = 16
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
    """The bent ray leads outside the intermediate image."""
    NO_RAY = 3
    """The display pixel has no ray into the world."""


@dataclass(frozen=True, eq=False)
class WarpedImage:
    """A display image and its status per pixel.

    Attributes:
        colour: (height, width, 3) uint8 sRGB; the background where the status is OUTSIDE or NO_RAY.
        status: (height, width) uint8, one `WarpStatus` each.
        source: (height, width, 2) float32 pull map, position (u, v) in the intermediate image, NaN where the status is
            OUTSIDE or NO_RAY; None when not asked for.
    """

    colour: NDArray[np.uint8]
    status: NDArray[np.uint8]
    source: NDArray[np.float32] | None = None

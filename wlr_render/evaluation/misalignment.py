"""How far a virtual point appears from the real one that it should lie on, as the eye sees both."""

import numpy as np

from wlr_render.geometry import directions
from wlr_render.mappings import EyeMappings
from wlr_render.numerics.arrays import FloatArray


def misalignment_arcmin(truth: EyeMappings, viewpoint: FloatArray, pixel: FloatArray, point: FloatArray) -> FloatArray:
    """Angle between where the eye sees a panel pixel and where it sees the real point that the pixel shows.

    Both directions come from `truth`: the pixel's by its display, the point's through its combiner. A picture drawn
    with those very mappings has zero misalignment everywhere.

    Args:
        truth: the mappings that the eye looks through.
        viewpoint: (..., 3) device frame; one for all, or one each.
        pixel: (..., 2) panel pixels.
        point: (..., 3) device frame, the real point that the picture has at that pixel; NaN where it shows nothing.

    Returns:
        (...) arcminutes; NaN where the picture shows nothing or the eye sees one of the two not at all.
    """
    shown = truth.display.view_dir_of_pixel(pixel, viewpoint)
    real = truth.see_through.view_dir_of_real_point(point, viewpoint)
    angle = directions.arcmin_between(shown.value, real.value)
    return np.where(shown.usable & real.usable, angle, np.nan)

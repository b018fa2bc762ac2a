"""Misalignment between virtual and real points, as the eye sees them."""

import numpy as np

from wlr_render.geometry import directions
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import FloatArray


def misalignment_arcmin(truth: Eye, viewpoint: FloatArray, pixel: FloatArray, point: FloatArray) -> FloatArray:
    """Return the angle at the viewpoint between a panel pixel and the real point that the pixel shows.

    Both directions come from `truth`: the pixel's from its display mapping, the point's from its see-through mapping. A
    picture drawn with these mappings has zero misalignment.

    Args:
        truth: the true mappings of the eye.
        viewpoint: (..., 3) device frame, metres; broadcasts.
        pixel: (..., 2) panel pixels.
        point: (..., 3) real point that the picture shows at that pixel, device frame, metres; NaN for background.

    Returns:
        (...) arcminutes; NaN for background and where the eye cannot see both pixel and point.
    """
    shown = truth.display.view_dir_of_pixel(pixel, viewpoint)
    real = truth.see_through.view_dir_of_real_point(point, viewpoint)
    angle = directions.arcmin_between(shown.value, real.value)
    return np.where(shown.usable & real.usable, angle, np.nan)

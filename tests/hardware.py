"""What a GPU rounds: the units from which tests derive the tolerances of pictures that a GPU draws.

llvmpipe places vertices and mixes texels more finely: in its contexts the tests keep the bounds that it reaches.
"""

from typing import TypeVar

import cv2
import numpy as np

from wlr_render.geometry.directions import arcmin_between
from wlr_render.gl.context import GlContext
from wlr_render.numerics.arrays import FloatArray

VERTEX_SNAP_PX = 1 / 256
"""Step of the positions of vertices, in pixels along each axis: a pixel shows what lies up to a step from it."""
FILTER_WEIGHT = 1 / 256
"""Step of the weights by which a texture filter mixes two texels, along each axis."""
HALF_FLOAT = 2.0**-10
"""Largest step of half floats, relative to the number."""
SRGB_DECODE = 0.5
"""Error, in sRGB codes of 8 bits, with which a texture unit may decode a texel (Direct3D 11.3 allows it)."""

_Bound = TypeVar("_Bound", float, FloatArray)


def allowed(context: GlContext, software: float, by_gpu: _Bound) -> float | _Bound:
    """Return the bound of a software renderer, to which what a GPU rounds is added on a GPU."""
    return software if context.is_software else software + by_gpu


def snap_arcmin(direction: FloatArray) -> float:
    """Largest angle between what pixels with rays (rows, columns, 3) show when vertices are placed in steps."""
    down = float(np.nanmax(arcmin_between(direction[1:], direction[:-1])))
    across = float(np.nanmax(arcmin_between(direction[:, 1:], direction[:, :-1])))
    return VERTEX_SNAP_PX * float(np.hypot(down, across))


def snap_of(image: FloatArray) -> FloatArray:
    """Change of a smooth picture (rows, columns, ...) by a step of its vertices along both axes, per pixel."""
    down, across = np.gradient(image, axis=(0, 1))
    return np.asarray(VERTEX_SNAP_PX * (np.abs(down) + np.abs(across)))


def filter_of(light: FloatArray) -> FloatArray:
    """Largest error of light that is filtered between a texel of (rows, columns, channels) and its neighbours.

    Along each axis the place is off by a step of the vertices and the weight by a step of the filter.
    """
    window = np.ones((3, 3), np.uint8)
    contrast = cv2.dilate(light, window) - cv2.erode(light, window)
    return np.asarray(2 * (VERTEX_SNAP_PX + FILTER_WEIGHT) * contrast)


def codes_of(light: FloatArray, error: FloatArray | float) -> FloatArray:
    """Largest change of the sRGB code of light (0 to 1), 0 to 255, by an error of the light."""
    darker, exact = (np.clip(each, 0, 1) for each in (light - error, light))
    return _code(exact) - _code(darker)  # the curve is concave: towards the dark codes change most


def _code(light: FloatArray) -> FloatArray:
    return np.asarray(255 * np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055))

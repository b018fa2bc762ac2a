"""Homographies: maps between two pictures of a plane."""

import cv2
import numpy as np

from wlr_render.numerics.arrays import FloatArray

_LEAST_POINTS = 4  # fewest points that determine a homography


def by_homography(place: FloatArray, pixel: FloatArray, at: FloatArray, method: int = 0) -> FloatArray | None:
    """Return the pixels (..., 2) of positions `at` (..., 2), by the best homography from `place` to `pixel`.

    Args:
        place: (n, 2) positions on the plane.
        pixel: (n, 2) pixels of these positions.
        at: (..., 2) further positions.
        method: 0 for least squares, or `cv2.LMEDS`.

    Returns:
        The pixels; None without a homography, i.e. for fewer than four points, or points in a line.
    """
    homography = cv2.findHomography(place, pixel, method)[0] if len(place) >= _LEAST_POINTS else None
    if homography is None:
        return None
    if not at.size:
        return np.zeros(at.shape)
    return np.asarray(cv2.perspectiveTransform(at.reshape(-1, 1, 2), homography)).reshape(at.shape)

"""Registration error of a warped frame against the ray-traced frame, per display pixel, from geometry.

`disocclusion.py` finds the pixels for which the warp has no data.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render.geometry import directions

EDGE_STEP = 0.02
"""Relative difference of inverse distance between neighbouring pixels from which they belong to different surfaces."""


@dataclass(frozen=True, eq=False)
class RasterError:
    """Per display pixel, (height, width).

    Attributes:
        registration_arcmin: angle, seen from the viewpoint, between the point that the warped frame shows and the one
            that the ray-traced frame shows; NaN where either shows nothing.
        only_one: exactly one of the two frames shows something.
    """

    registration_arcmin: NDArray[np.float64]
    only_one: NDArray[np.bool_]


def raster_error(
    warped_position: NDArray[np.floating], traced_position: NDArray[np.floating], eye_in_world: NDArray[np.float64]
) -> RasterError:
    """Compare a warped frame with the ray-traced frame of the same viewpoint.

    Args:
        warped_position: (height, width, 3) world points that the warped frame shows, NaN where nothing.
        traced_position: (height, width, 3) world points that the ray-traced frame shows.
        eye_in_world: (3,) the viewpoint, where angles are measured.
    """
    warped, traced = np.asarray(warped_position, np.float64), np.asarray(traced_position, np.float64)
    has_warped, has_traced = np.isfinite(warped[..., 0]), np.isfinite(traced[..., 0])
    both = has_warped & has_traced
    angle = np.full(both.shape, np.nan)
    angle[both] = directions.arcmin_between(
        directions.normalised(warped[both] - eye_in_world), directions.normalised(traced[both] - eye_in_world)
    )
    return RasterError(angle, has_warped != has_traced)


def near_silhouettes(
    position: NDArray[np.floating], eye_in_world: NDArray[np.float64], reach_px: int
) -> NDArray[np.bool_]:
    """Mask of pixels near edges between surfaces at different distances.

    Args:
        position: (height, width, 3) world points that a frame shows, NaN where nothing.
        eye_in_world: (3,) the viewpoint.
        reach_px: distance from the edge, along rows and columns.

    Returns:
        (height, width). Neighbours belong to different surfaces if their inverse distances differ by more than
        `EDGE_STEP` of the larger; background is at infinity.
    """
    distance = np.linalg.norm(np.asarray(position, np.float64) - eye_in_world, axis=-1)
    nearness = np.where(np.isfinite(distance), 1.0 / distance, 0.0).astype(np.float32)
    square = np.ones((3, 3), np.uint8)
    low, high = np.asarray(cv2.erode(nearness, square)), np.asarray(cv2.dilate(nearness, square))
    edge = (high - low > EDGE_STEP * high).astype(np.uint8)
    return np.asarray(cv2.dilate(edge, np.ones((2 * reach_px + 1, 2 * reach_px + 1), np.uint8))) > 0

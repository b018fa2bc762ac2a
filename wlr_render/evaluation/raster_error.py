"""What rasterisation + warp gets wrong against the ray-traced frame, per display pixel and from geometry.

The intermediate image is drawn from the viewpoint by a camera that does not know that see-through rays are bent. Where
a bent ray sees what the straight camera cannot, the warp has nothing right to show: disocclusion. The paper notes
this error; here it is measured.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render.geometry import directions, transforms
from wlr_render.rendering.view import View

EDGE_STEP = 0.02
"""Relative difference of inverse distance between neighbouring pixels from which they belong to different surfaces."""

SAME_DEPTH = 0.01
"""Relative difference of inverse depth up to which the intermediate image is taken to show the same point."""


@dataclass(frozen=True, eq=False)
class RasterError:
    """Per display pixel, (height, width).

    Attributes:
        registration_arcmin: angle, seen from the viewpoint, between the point that the warped frame shows and the one
            that the ray-traced frame shows; NaN where either shows nothing.
        disoccluded: the ray-traced point is hidden in the intermediate image.
        only_one: exactly one of the two frames shows something.
    """

    registration_arcmin: NDArray[np.float64]
    disoccluded: NDArray[np.bool_]
    only_one: NDArray[np.bool_]


def raster_error(
    view: View,
    inverse_depth: NDArray[np.float32],
    warped_position: NDArray[np.floating],
    traced_position: NDArray[np.floating],
    eye_in_world: NDArray[np.float64],
) -> RasterError:
    """Compare a warped frame with the ray-traced frame of the same viewpoint.

    Args:
        view: of the intermediate image, which need not have been drawn from the viewpoint, nor at the same time.
        inverse_depth: (rows, columns) of the intermediate image, 1/m.
        warped_position: (height, width, 3) world points that the warped frame shows, NaN where nothing.
        traced_position: (height, width, 3) world points that the ray-traced frame shows.
        eye_in_world: (3,) the viewpoint, where angles are measured.
    """
    eye = eye_in_world
    warped, traced = np.asarray(warped_position, np.float64), np.asarray(traced_position, np.float64)
    has_warped, has_traced = np.isfinite(warped[..., 0]), np.isfinite(traced[..., 0])
    both = has_warped & has_traced
    angle = np.full(both.shape, np.nan)
    angle[both] = directions.arcmin_between(
        directions.normalised(warped[both] - eye), directions.normalised(traced[both] - eye)
    )
    disoccluded = np.zeros(both.shape, bool)
    disoccluded[has_traced] = _hidden(view, inverse_depth, traced[has_traced])
    return RasterError(angle, disoccluded, has_warped != has_traced)


def near_silhouettes(
    position: NDArray[np.floating], eye_in_world: NDArray[np.float64], reach_px: int
) -> NDArray[np.bool_]:
    """Where a pixel lies within some pixels of an edge between surfaces that are at different distances.

    Args:
        position: (height, width, 3) world points that a frame shows, NaN where nothing.
        eye_in_world: (3,) from where.
        reach_px: how far, along rows and columns.

    Returns:
        (height, width). Neighbours belong to two surfaces if the inverses of their distances differ by more than
        `EDGE_STEP` of the larger, nothing being at infinity.
    """
    distance = np.linalg.norm(np.asarray(position, np.float64) - eye_in_world, axis=-1)
    nearness = np.where(np.isfinite(distance), 1.0 / distance, 0.0).astype(np.float32)
    square = np.ones((3, 3), np.uint8)
    low, high = np.asarray(cv2.erode(nearness, square)), np.asarray(cv2.dilate(nearness, square))
    edge = (high - low > EDGE_STEP * high).astype(np.uint8)
    return np.asarray(cv2.dilate(edge, np.ones((2 * reach_px + 1, 2 * reach_px + 1), np.uint8))) > 0


def _hidden(view: View, inverse_depth: NDArray[np.float32], point: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether the intermediate image shows something else than `point` (n, 3) at all four pixels around it."""
    in_camera = transforms.apply(transforms.inverse(view.world_from_camera), point)
    depth = -in_camera[:, 2]
    pixel = view.camera.pixel_of_tangents(in_camera[:, :2] / depth[:, None])
    hidden = np.ones(len(point), bool)
    rows, columns = inverse_depth.shape
    for du in (-0.5, 0.5):
        for dv in (-0.5, 0.5):
            column = np.clip(np.floor(pixel[:, 0] + du).astype(int), 0, columns - 1)
            row = np.clip(np.floor(pixel[:, 1] + dv).astype(int), 0, rows - 1)
            hidden &= np.abs(inverse_depth[row, column] * depth - 1.0) > SAME_DEPTH
    return hidden

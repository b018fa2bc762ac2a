"""Registration error of a warped frame against the ray-traced frame, per display pixel, from geometry.

`disocclusion.py` finds the pixels for which the warp has no data.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wlr_render.geometry import directions


@dataclass(frozen=True, eq=False)
class RasterError:
    """Errors per display pixel, (height, width).

    Attributes:
        registration_arcmin: angle at the viewpoint between the points that the warped and the ray-traced frame show;
            NaN where either shows nothing.
        only_one: True where exactly one of the two frames shows something.
    """

    registration_arcmin: NDArray[np.float64]
    only_one: NDArray[np.bool_]


def raster_error(
    warped_position: NDArray[np.floating], traced_position: NDArray[np.floating], eye_in_world: NDArray[np.float64]
) -> RasterError:
    """Compare a warped frame with the ray-traced frame of the same viewpoint.

    Args:
        warped_position: (height, width, 3) world points that the warped frame shows, NaN without one.
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

"""The base plane P of planar viewpoint sampling: z = constant in the device frame."""

from dataclasses import dataclass

import numpy as np

from wlr_render.numerics.arrays import FloatArray


@dataclass(frozen=True)
class BasePlane:
    """The plane z = `z` (metres, device frame), on which intermediate models are fitted.

    It is perpendicular to the looking axis -z, so that a direction is carried by its two tangents and the
    projection along a ray is linear in them.
    """

    z: float

    def carry(self, point: FloatArray, tangents: FloatArray) -> FloatArray:
        """Where rays through `point` (..., 3) with `tangents` (..., 2) meet the plane: (x, y), (..., 2).

        Closed-form projection of the paper (section 3.2); the ray may be followed forwards or backwards.
        """
        return np.asarray(point[..., :2] + (point[..., 2:] - self.z) * tangents)

    def depth_of(self, point: FloatArray) -> FloatArray:
        """Distance of points (..., 3) in front of the plane along -z, (...) metres."""
        return np.asarray(self.z - point[..., 2])

    def lift(self, point_in_plane: FloatArray) -> FloatArray:
        """(..., 2) plane coordinates -> (..., 3) device frame."""
        z = np.full((*point_in_plane.shape[:-1], 1), self.z)
        return np.concatenate([point_in_plane, z], axis=-1)

"""The base plane P of planar viewpoint sampling: z = constant in the device frame."""

from dataclasses import dataclass

import numpy as np

from wlr_render.numerics.arrays import FloatArray


@dataclass(frozen=True)
class BasePlane:
    """The plane z = `z` (metres, device frame), on which planar models are fitted.

    It is perpendicular to the axis -z, so the projection along a ray is linear in the tangents of the ray.
    """

    z: float

    def carry(self, point: FloatArray, tangents: FloatArray) -> FloatArray:
        """Project `point` (..., 3) onto the plane along rays with `tangents` (..., 2); returns (x, y), (..., 2).

        Closed-form projection of the paper (section 3.2); the plane may lie in front of the point or behind it.
        Two solvers repeat this formula together with its derivative: `models.bundle` and shaders/solve.frag.
        """
        return np.asarray(point[..., :2] + (point[..., 2:] - self.z) * tangents)

    def depth_of(self, point: FloatArray) -> FloatArray:
        """Distance of points (..., 3) in front of the plane along -z, (...) metres."""
        return np.asarray(self.z - point[..., 2])

    def lift(self, point_in_plane: FloatArray) -> FloatArray:
        """Points (..., 3) in the device frame of plane coordinates (..., 2)."""
        z = np.full((*point_in_plane.shape[:-1], 1), self.z)
        return np.concatenate([point_in_plane, z], axis=-1)

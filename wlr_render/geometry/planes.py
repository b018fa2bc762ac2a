"""The base plane P of planar viewpoint sampling: a plane in the device frame, upright or tilted."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from wlr_render.io.file_records import Key
from wlr_render.numerics.arrays import FloatArray

_FAR_M, _STEEPEST = 1.0, 100.0  # largest distance from the headset's origin, and largest slope, in a file


@dataclass(frozen=True)
class BasePlane:
    """The points (x, y, z + slope . (x, y)), metres in the device frame, on which planar models are fitted.

    Its points are given by x and y, (..., 2), even if the plane is tilted.

    Attributes:
        z: z at x = y = 0, metres.
        slope: rise of z per metre of x and of y. Without slope the projection along a ray is linear in its tangents.
    """

    z: Annotated[float, Key("z_m", most=_FAR_M)]
    slope: Annotated[tuple[float, float], Key(most=_STEEPEST, always=True)] = (0.0, 0.0)

    coordinates: ClassVar[int] = 2

    def depth_along(self, point: FloatArray, tangents: FloatArray) -> FloatArray:
        """Return the depth s (...), metres along -z, at which rays from `point` (..., 3) meet the plane.

        The ray is point + s (tx, ty, -1), so that s = h / (1 + slope . t) with h = z_point - z - slope . xy_point.
        Negative where the plane lies behind the point; infinite or NaN for a ray that is parallel to the plane.
        """
        return np.asarray(self.height_of(point) / (1.0 + tangents @ np.array(self.slope)))

    def depth_by_tangents(self, depth: FloatArray, tangents: FloatArray) -> FloatArray:
        """Return the derivative of `depth_along` by the tangents, -s slope / (1 + slope . t): (..., 2)."""
        slope = np.array(self.slope)
        return np.asarray((-depth / (1.0 + tangents @ slope))[..., None] * slope)

    def carry(self, point: FloatArray, tangents: FloatArray) -> FloatArray:
        """Project `point` (..., 3) onto the plane along rays with `tangents` (..., 2); returns (x, y), (..., 2).

        Closed-form projection of the paper (equations 5 and 6, section 3.3; 13 and 14, section 3.4). The paper's plane
        lies between optics and eye (t >= 0); this one may also lie behind the point.
        """
        return np.asarray(point[..., :2] + self.depth_along(point, tangents)[..., None] * tangents)

    def carry_by_tangents(self, depth: FloatArray, tangents: FloatArray) -> FloatArray:
        """Return the derivative (..., 2, 2) of `carry` by the tangents, s I + t (ds/dt)^T, with s of `depth_along`."""
        by_depth = tangents[..., :, None] * self.depth_by_tangents(depth, tangents)[..., None, :]
        return np.asarray(depth[..., None, None] * np.eye(2) + by_depth)

    def carry_by_point(self, tangents: FloatArray) -> FloatArray:
        """Return the derivative of `carry` by the point: (..., 2, 3)."""
        along_z = (tangents / (1.0 + tangents @ np.array(self.slope))[..., None])[..., None]
        return np.concatenate([np.eye(2) - along_z * np.array(self.slope), along_z], axis=-1)

    def height_of(self, point: FloatArray) -> FloatArray:
        """Return the distance of points (..., 3) behind the plane along +z, (...) metres: h of `depth_along`."""
        return np.asarray(point[..., 2] - self.z_at(point[..., :2]))

    def z_at(self, point_in_plane: FloatArray) -> FloatArray:
        """Return the z (...) of plane coordinates (..., 2), metres."""
        return np.asarray(self.z + point_in_plane @ np.array(self.slope))

    def lift(self, point_in_plane: FloatArray) -> FloatArray:
        """Return the points (..., 3) in the device frame of plane coordinates (..., 2)."""
        return np.concatenate([point_in_plane, self.z_at(point_in_plane)[..., None]], axis=-1)

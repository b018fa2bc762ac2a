"""Surface shapes in closed form.

A shape has its own frame, in metres. Inside the tracer rays are columns: points and directions are (3, n) arrays, so
that each coordinate is contiguous. Shapes have no apertures and poses (see `device`).
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from wlr_render.numerics.arrays import BoolArray, FloatArray


@dataclass(frozen=True)
class SurfaceIntersections:
    """Intersections of rays with a shape.

    Attributes:
        distance: (k, n) distances along the rays, ascending over k, of either sign; NaN without such a root.
        converged: (n,) bool; False where an iteration did not converge, which is not a miss.
    """

    distance: FloatArray
    converged: BoolArray


class Shape(Protocol):
    """A surface without edges, in its own frame."""

    def meet(self, origin: FloatArray, direction: FloatArray) -> SurfaceIntersections:
        """Return all distances at which rays (3, n) with unit directions (3, n) may meet the surface."""

    def normal(self, point: FloatArray) -> FloatArray:
        """Return the unit normals (3, n) at points (3, n) of the surface."""


def unit(vector: FloatArray) -> FloatArray:
    """Return the columns (3, n) scaled to unit length."""
    x, y, z = vector
    return np.asarray(vector / np.sqrt(x * x + y * y + z * z))


def dot(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the scalar products of the columns of two (3, n) arrays, (n,)."""
    return np.asarray(first[0] * second[0] + first[1] * second[1] + first[2] * second[2])


@np.errstate(invalid="ignore", divide="ignore")  # NaN without a root
def _quadratic_roots(a: FloatArray, half_b: FloatArray, c: FloatArray) -> FloatArray:
    """Return both roots of a t^2 + 2 half_b t + c, ascending, (2, n); without cancellation, also where a is 0."""
    q = -(half_b + np.copysign(np.sqrt(half_b * half_b - a * c), half_b))
    first, second = q / a, c / q
    first[~np.isfinite(first)] = np.nan
    # fmin and fmax: a single root fills both rows, and NaN remains only without a root.
    return np.stack([np.fmin(first, second), np.fmax(first, second)])


@dataclass(frozen=True)
class Conic:
    """Plane, sphere or conicoid of revolution, through the origin with its axis along z.

    Sag z = c r^2 / (1 + sqrt(1 - (1 + k) c^2 r^2)); only this sheet counts, not the rest of the quadric.

    Attributes:
        curvature: c in 1/m, positive with the centre of curvature at +z; 0 is a plane.
        conic: k; -1 is a paraboloid, -1 < k < 0 a prolate ellipsoid.
    """

    curvature: float
    conic: float = 0.0

    def meet(self, origin: FloatArray, direction: FloatArray) -> SurfaceIntersections:
        """Return the intersections with c (x^2 + y^2 + (1 + k) z^2) - 2 z = 0."""
        c, p = self.curvature, 1.0 + self.conic
        (ox, oy, oz), (dx, dy, dz) = origin, direction
        a = c * (dx * dx + dy * dy + p * dz * dz)
        half_b = c * (ox * dx + oy * dy + p * oz * dz) - dz
        distance = _quadratic_roots(a, half_b, c * (ox * ox + oy * oy + p * oz * oz) - 2.0 * oz)
        if c != 0.0:
            distance[p * c * (oz + distance * dz) > 1.0] = np.nan
        return SurfaceIntersections(distance, np.ones(ox.shape, dtype=bool))

    def normal(self, point: FloatArray) -> FloatArray:
        """Return the unit normals, which point to +z at the vertex."""
        c = self.curvature
        x, y, z = point
        return unit(np.stack([-c * x, -c * y, 1.0 - (1.0 + self.conic) * c * z]))


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """A whole ellipsoid about the origin.

    Attributes:
        semi_axes: (3,) metres, along the frame's axes.
    """

    semi_axes: FloatArray

    def meet(self, origin: FloatArray, direction: FloatArray) -> SurfaceIntersections:
        """Return the intersections with |o / s + t d / s| = 1."""
        scale = self.semi_axes[:, None]
        o, d = origin / scale, direction / scale
        distance = _quadratic_roots(dot(d, d), dot(o, d), dot(o, o) - 1.0)
        return SurfaceIntersections(distance, np.ones(distance.shape[1], dtype=bool))

    def normal(self, point: FloatArray) -> FloatArray:
        """Return the unit normals, which point outwards."""
        return unit(point / (self.semi_axes * self.semi_axes)[:, None])

"""Surface shapes: planes, conicoids and ellipsoids in closed form, and Newton's method for all others.

A shape has its own frame, in metres. Inside the tracer rays are columns: points and directions are (3, n) arrays, so
that each coordinate is contiguous. Shapes have no apertures and poses (see `device`).
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from wlr_render.io.file_records import LENGTH, Key
from wlr_render.numerics.arrays import BoolArray, FloatArray
from wlr_render.optics.device_keys import FLAT_MM, curvature_key

_STEPS, _ROUNDS = 7, 4  # Newton steps per round, and rounds; each round continues with the unconverged rays
# Tolerance of a step, metres. The error after it is about step^2 * curvature / 2, so a step this short is the last.
_LAST_STEP = 1e-10
_FOOT_SETTLED = 1e-8  # tolerance of feet, metres; the level's error is about its square times curvature / 2

Gradient = tuple[FloatArray, FloatArray, FloatArray | float]
"""Derivatives by x, y and z, (n,) each."""


@dataclass(frozen=True)
class SurfaceIntersections:
    """Intersections of rays with a shape.

    Attributes:
        distance: (k, n) distances along the rays, ascending over k, of either sign; NaN without such a root.
        converged: (n,) bool; False where an iteration did not converge, which is not a miss.
    """

    distance: FloatArray
    converged: BoolArray


def unit(vector: FloatArray) -> FloatArray:
    """Return the columns (3, n) scaled to unit length."""
    x, y, z = vector
    return np.asarray(vector / np.sqrt(x * x + y * y + z * z))


def dot(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the scalar products of the columns of two (3, n) arrays, (n,)."""
    return np.asarray(first[0] * second[0] + first[1] * second[1] + first[2] * second[2])


class Shape:
    """A surface without edges, in its own frame: the zero of a function of the point."""

    def level(self, point: FloatArray) -> tuple[FloatArray, Gradient]:
        """Return a function (n,) of points (3, n) that vanishes on the shape, and its gradient, opposite to normals."""
        raise NotImplementedError

    def level_near(self, point: FloatArray, shift: FloatArray) -> tuple[FloatArray, Gradient, FloatArray | float]:
        """Return the level, its gradient, and the errors (n,) of the feet of the points on a base, if there is a base.

        `shift` (3, n), from the feet to the points, is improved in place.
        """
        return *self.level(point), 0.0

    def meet(self, origin: FloatArray, direction: FloatArray) -> SurfaceIntersections:
        """Return the distances at which rays (3, n) with unit directions (3, n) may meet the surface.

        Here it is the one root that Newton's method finds from the plane z = 0.
        """
        distance, converged = self.root(-origin[2] / direction[2], origin, direction)
        return SurfaceIntersections(distance[None], converged)

    @np.errstate(invalid="ignore", divide="ignore", over="ignore")  # NaN beyond the edge of a shape
    def root(
        self,
        start: FloatArray,
        origin: FloatArray,
        direction: FloatArray,
        shift: FloatArray | None = None,
        rounds: int = _ROUNDS,
    ) -> tuple[FloatArray, BoolArray]:
        """Return the distances (n,) of roots by Newton's method from `start` (n,), and where it converged."""
        distance, shift = start.copy(), np.zeros_like(origin) if shift is None else shift
        for _ in range(_STEPS):
            value, (by_x, by_y, by_z), moved = self.level_near(origin + distance * direction, shift)
            step = value / (by_z * direction[2] + by_x * direction[0] + by_y * direction[1])
            distance -= step
            going = (np.abs(step) > _LAST_STEP) | (moved > _FOOT_SETTLED)
            if not going.any():
                return distance, ~going
        if rounds > 1:
            rest = np.flatnonzero(going)
            again = self.root(distance[rest], origin[:, rest], direction[:, rest], shift[:, rest], rounds - 1)
            distance[rest], going[rest] = again[0], ~again[1]
        return distance, ~going

    def normal(self, point: FloatArray) -> FloatArray:
        """Return the unit normals (3, n) at points (3, n) of the surface."""
        return unit(-np.stack(np.broadcast_arrays(*self.level(point)[1])))


@np.errstate(invalid="ignore", divide="ignore")  # NaN without a root
def _quadratic_roots(a: FloatArray, half_b: FloatArray, c: FloatArray) -> FloatArray:
    """Return both roots of a t^2 + 2 half_b t + c, ascending, (2, n); without cancellation, also where a is 0."""
    q = -(half_b + np.copysign(np.sqrt(half_b * half_b - a * c), half_b))
    first, second = q / a, c / q
    first[~np.isfinite(first)] = np.nan
    # fmin and fmax: a single root fills both rows, and NaN remains only without a root.
    return np.stack([np.fmin(first, second), np.fmax(first, second)])


class _Quadric(Shape):
    """A shape on which (w_x x^2 + w_y y^2 + w_z z^2 + k) / 2 - l z vanishes."""

    def _factors(self) -> tuple[FloatArray, float, float]:
        """Return w (3, 1), l and k."""
        raise NotImplementedError

    def meet(self, origin: FloatArray, direction: FloatArray) -> SurfaceIntersections:
        """Return both intersections, in closed form."""
        weights, linear, constant = self._factors()
        weighted = weights * origin
        half_b = dot(weighted, direction) - linear * direction[2]
        c = dot(weighted, origin) - 2.0 * linear * origin[2] + constant
        distance = _quadratic_roots(dot(weights * direction, direction), half_b, c)
        return SurfaceIntersections(distance, np.ones(len(c), dtype=bool))

    def level(self, point: FloatArray) -> tuple[FloatArray, Gradient]:
        """Return the function that vanishes on the shape, and its gradient."""
        weights, linear, constant = self._factors()
        by_x, by_y, by_z = weighted = weights * point
        return 0.5 * (dot(weighted, point) + constant) - linear * point[2], (by_x, by_y, by_z - linear)

    def normal(self, point: FloatArray) -> FloatArray:
        """Return the unit normals (3, n) at points (3, n) of the surface."""
        weights, linear, _ = self._factors()
        inward = weights * point
        inward[2] -= linear
        return unit(-inward)


@dataclass(frozen=True)
class Conic(_Quadric):
    """Plane, sphere or conicoid of revolution, through the origin with its axis along z.

    Sag z = c r^2 / (1 + sqrt(1 - (1 + k) c^2 r^2)); only this sheet counts, not the rest of the quadric. Its normals
    point to +z at the vertex.

    Attributes:
        curvature: c in 1/m, positive with the centre of curvature at +z; 0 is a plane.
        conic: k; -1 is a paraboloid, -1 < k < 0 a prolate ellipsoid.
    """

    curvature: Annotated[float, curvature_key("radius_mm")]
    conic: float = 0.0

    def _factors(self) -> tuple[FloatArray, float, float]:
        return self.curvature * np.array([[1.0], [1.0], [1.0 + self.conic]]), 1.0, 0.0

    def meet(self, origin: FloatArray, direction: FloatArray) -> SurfaceIntersections:
        """Return the intersections with the sheet through the origin."""
        met = super().meet(origin, direction)
        if self.curvature != 0.0:
            height = origin[2] + met.distance * direction[2]
            met.distance[(1.0 + self.conic) * self.curvature * height > 1.0] = np.nan
        return met


@dataclass(frozen=True, eq=False)
class Ellipsoid(_Quadric):
    """A whole ellipsoid about the origin, with normals that point outwards.

    Attributes:
        semi_axes: (3,) metres, along the frame's axes.
    """

    semi_axes: Annotated[FloatArray, Key("semi_axes_mm", LENGTH, shape=(3,), above=0, most=FLAT_MM)]

    def _factors(self) -> tuple[FloatArray, float, float]:
        return -1.0 / (self.semi_axes * self.semi_axes)[:, None], 0.0, 1.0

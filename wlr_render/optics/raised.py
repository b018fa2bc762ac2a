"""Surfaces displaced from another one: parallel to it, and raised by form errors."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from wlr_render.geometry.transforms import inverse
from wlr_render.numerics.arrays import BoolArray, FloatArray
from wlr_render.optics.sag_surfaces import Gradient, LevelSurface, SagSurface
from wlr_render.optics.surfaces import Shape, SurfaceIntersections, unit

_RAISED_REACH = 1e-2  # metres by which form errors may move a root: they are far smaller
_MAX_TURNS = 40
_SETTLED = 1e-17  # change in metres at convergence: about ten rounding units of a shift of a few millimetres


@dataclass(frozen=True, eq=False)
class FormError:
    """Height of a form error as a function of position across an axis.

    Attributes:
        sag: height over x and y, in metres; its position along z is not used.
        surface_from_error: (4, 4) pose of its axes in the surface's axes; orthogonal, improper in a mirrored eye.
    """

    sag: SagSurface
    surface_from_error: FloatArray

    @cached_property
    def error_from_surface(self) -> FloatArray:
        """Inverse of `surface_from_error`, (4, 4)."""
        return inverse(self.surface_from_error)

    def height_and_gradient(self, point: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the height (n,) in metres at points (3, n) in the surface's axes, and its gradient (3, n) there."""
        pose = self.error_from_surface
        x, y = pose[:2, :3] @ point + pose[:2, 3:]
        height, slope_x, slope_y = self.sag.sag_and_slopes(x, y)
        return height, pose[:2, :3].T @ np.stack([slope_x, slope_y])


def _sums(errors: tuple[FormError, ...], point: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the sum of the heights (n,) of form errors at points (3, n), and its gradient (3, n)."""
    heights, gradients = zip(*(error.height_and_gradient(point) for error in errors), strict=True)
    return np.sum(heights, axis=0), np.sum(gradients, axis=0)


@dataclass(frozen=True)
class Offset:
    """A surface displaced from another one along its unit normals: by a distance, and by form errors.

    Without errors it is the true parallel surface. A ray meets the displaced surface at p = q + d(p, q) where the ray
    shifted by -d meets the base at q. Each iteration shrinks the error by about d / radius of curvature, or by the
    slope of d.

    The height h of the errors is a function of the point itself, not of its foot. Then the surface is F(p) = h(p),
    where F is the distance of a point from the base, and its normal is grad F - grad h: independent of the curvature of
    the base.

    Attributes:
        base: the shape that it is displaced from.
        distance: metres, positive along the base's normal; must stay below the radii of curvature of the base.
        errors: form errors, added to the distance.
    """

    base: Shape
    distance: float
    errors: tuple[FormError, ...] = ()

    def _displacement(self, point: FloatArray, normal: FloatArray) -> FloatArray:
        """Return the displacement (3, n) of points (3, n) from their feet, at which the unit normals are (3, n)."""
        height = _sums(self.errors, point)[0] + self.distance if self.errors else self.distance
        return np.asarray(height * normal)

    def meet(self, origin: FloatArray, direction: FloatArray) -> SurfaceIntersections:
        """Return the intersections of rays with the displaced surface."""
        start = self.base.meet(origin, direction)
        distance, converged = start.distance.copy(), start.converged.copy()
        # Roots of the base farther behind a ray stay behind it, except at grazing angles below 6 degrees.
        reach = _RAISED_REACH if self.errors else 10.0 * abs(self.distance)
        for row in range(len(distance)):
            if row and np.array_equal(start.distance[row], start.distance[row - 1], equal_nan=True):
                distance[row] = distance[row - 1]  # the only root with a plane fills both rows
                continue
            near = distance[row] > -reach
            if near.any():
                distance[row], settled = self._settle(row, origin, direction)
                converged &= settled | ~near
        return SurfaceIntersections(distance, converged)

    def _settle(self, row: int, origin: FloatArray, direction: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Follow one root of the base to the displaced surface; returns distance and convergence, (n,) each."""
        shift = np.zeros_like(origin)
        for _ in range(_MAX_TURNS):
            shifted = origin - shift
            distance = self.base.meet(shifted, direction).distance[row]
            foot = shifted + distance * direction
            new_shift = self._displacement(foot + shift, self.base.normal(foot))
            moving = np.abs(new_shift - shift).max(axis=0) > _SETTLED
            shift = new_shift
            if not moving.any():
                break
        return distance, ~moving

    def normal(self, point: FloatArray) -> FloatArray:
        """Return the unit normals (3, n) at points (3, n), on the side of the base's normals.

        The feet of the points are found by the same contraction.
        """
        shift = np.zeros_like(point)
        for _ in range(_MAX_TURNS):
            normal = self.base.normal(point - shift)
            previous, shift = shift, self._displacement(point, normal)
            if not (np.abs(shift - previous).max(axis=0) > _SETTLED).any():
                break
        return unit(normal - _sums(self.errors, point)[1]) if self.errors else normal


@dataclass(frozen=True)
class RaisedSag(LevelSurface):
    """A surface stated as z(x, y), raised by form errors along its z.

    Attributes:
        base: the surface as prescribed.
        errors: added to each other.
    """

    base: SagSurface
    errors: tuple[FormError, ...]

    def level(self, point: FloatArray) -> tuple[FloatArray, Gradient]:
        """Return the height of the surface above points, and its gradient."""
        below, (by_x, by_y, by_z) = self.base.level(point)
        height, gradient = _sums(self.errors, point)
        return below + height, (by_x + gradient[0], by_y + gradient[1], by_z + gradient[2])


def raised(shape: Shape, *errors: FormError) -> Shape:
    """Return a shape with form errors, in addition to any that it has."""
    match shape:
        case Offset() | RaisedSag():
            return replace(shape, errors=(*shape.errors, *errors))
        case SagSurface():
            return RaisedSag(shape, errors)
        case _:
            return Offset(shape, 0.0, errors)


def base_of(shape: Shape) -> Shape | None:
    """Return the shape that a displaced one is stated by: its base, or the offset that has errors; None for others."""
    if isinstance(shape, Offset) and shape.errors and shape.distance:
        return replace(shape, errors=())
    return shape.base if isinstance(shape, Offset | RaisedSag) else None


def nesting(shape: Shape) -> int:
    """Return the number of shapes that a shape is based on, one by another."""
    base = base_of(shape)
    return 0 if base is None else 1 + nesting(base)

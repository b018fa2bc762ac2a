"""Surfaces displaced from another surface: parallel to it, and raised by form errors."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated

import numpy as np

from wlr_render.geometry.transforms import inverse
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device_keys import distance_key
from wlr_render.optics.sag_surfaces import SagSurface
from wlr_render.optics.surfaces import Gradient, Shape, SurfaceIntersections, dot

_RAISED_REACH = 1e-2  # upper bound, in metres, of a root's shift by form errors, which are far smaller
_MAX_TURNS = 40
_SETTLED = 1e-14  # change in metres at convergence: the next one is smaller by distance / radius of curvature


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


@dataclass(frozen=True)
class Offset(Shape):
    """A surface displaced from another one along its unit normals: by a distance, and by form errors.

    Without errors it is the true parallel surface. A point p on it has the foot q = p - (distance + h(p)) n(q) on the
    base. The height h of the errors is a function of the point itself, not of its foot, so that its normal is n - grad
    h, independent of the curvature of the base. Errors of a surface stated as z(x, y) raise it along its z instead.

    Attributes:
        base: the shape that it is displaced from.
        distance: metres, positive along the base's normal; must stay below the radii of curvature of the base.
        errors: form errors, added to the distance.
    """

    base: Shape
    distance: Annotated[float, distance_key("distance_mm")]
    errors: tuple[FormError, ...] = ()

    @property
    def _is_along_z(self) -> bool:
        return isinstance(self.base, SagSurface) and not self.distance

    def _heights(self, point: FloatArray) -> tuple[FloatArray | float, FloatArray | float]:
        """Return the displacements (n,) of points (3, n) along normals, and their gradient (3, n)."""
        heights = [error.height_and_gradient(point) for error in self.errors]
        return sum((height for height, _ in heights), start=self.distance), sum(slopes for _, slopes in heights)

    def level(self, point: FloatArray) -> tuple[FloatArray, Gradient]:
        """Return the level at points as a distance, from their converged feet on the base, and its gradient."""
        shift = np.zeros_like(point)
        if not self._is_along_z:
            height, _ = self._heights(point)
            for _ in range(_MAX_TURNS):
                previous, shift = shift, height * self.base.normal(point - shift)
                if not (np.abs(shift - previous).max(axis=0) > _SETTLED).any():
                    break
        value, gradient, _ = self.level_near(point, shift)
        return value, gradient

    def level_near(self, point: FloatArray, shift: FloatArray) -> tuple[FloatArray, Gradient, FloatArray | float]:
        """Improve the feet once: their errors shrink by a factor of about the distance over the base's radius."""
        height, slopes = self._heights(point)
        value, gradient = self.base.level(point - shift)
        inward = np.stack(np.broadcast_arrays(*gradient))
        moved: FloatArray | float = 0.0
        if not self._is_along_z:
            length = np.sqrt(dot(inward, inward))
            inward /= length
            # The level at the feet after the new shift, to first order.
            value = value / length + dot(inward, shift)
            previous = shift.copy()
            shift[:] = -height * inward
            moved = np.abs(shift - previous).max(axis=0)
        by_x, by_y, by_z = inward + slopes if self.errors else inward
        return value + height, (by_x, by_y, by_z), moved

    def meet(self, origin: FloatArray, direction: FloatArray) -> SurfaceIntersections:
        """Return the intersections of rays with the displaced surface, by Newton's method from those with the base."""
        if self._is_along_z:
            return super().meet(origin, direction)
        start = self.base.meet(origin, direction)
        distance, converged = start.distance.copy(), start.converged.copy()
        # Roots of the base farther behind a ray stay behind it, except at grazing angles below 6 degrees.
        reach = _RAISED_REACH if self.errors else 10.0 * abs(self.distance)
        for row in range(len(distance)):
            if row and np.array_equal(start.distance[row], start.distance[row - 1], equal_nan=True):
                distance[row] = distance[row - 1]  # the only root with a plane fills both rows
                continue
            near = np.flatnonzero(distance[row] > -reach)
            if near.size:
                distance[row, near], settled = self.root(distance[row, near], origin[:, near], direction[:, near])
                converged[near] &= settled
        return SurfaceIntersections(distance, converged)


def raised(shape: Shape, *errors: FormError) -> Shape:
    """Return the shape with form errors added."""
    return replace(shape, errors=(*shape.errors, *errors)) if isinstance(shape, Offset) else Offset(shape, 0.0, errors)


def base_of(shape: Shape) -> Shape | None:
    """Return the shape that a displaced shape is based on: its base, or the offset without errors; None for others."""
    if not isinstance(shape, Offset):
        return None
    return replace(shape, errors=()) if shape.errors and shape.distance else shape.base


def nesting(shape: Shape) -> int:
    """Return the length of the chain of bases under a shape; 0 without a base."""
    base = base_of(shape)
    return 0 if base is None else 1 + nesting(base)

"""A surface with form errors: raised from its prescription by heights over a plane."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from wlr_render.geometry.transforms import inverse
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.sag_surfaces import LevelSurface, SagSurface
from wlr_render.optics.surfaces import DisplacedShape, Offset, Shape, dot, unit

_REACH = 1e-2  # metres: form errors are far smaller


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


class _WithErrors:
    """A surface raised by the sum of form errors."""

    errors: tuple[FormError, ...]

    def height_and_gradient(self, point: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the sum of the errors' heights (n,) at points (3, n), and its gradient (3, n)."""
        heights, gradients = zip(*(error.height_and_gradient(point) for error in self.errors), strict=True)
        return np.sum(heights, axis=0), np.sum(gradients, axis=0)


@dataclass(frozen=True)
class Raised(_WithErrors, DisplacedShape):
    """A surface raised by form errors along its unit normal.

    The height is a function of the point itself, not of its foot. Then the surface is F(p) = h(p), where F is the
    distance of a point from the base, and its normal is grad F - grad h: independent of the curvature of the base.

    Attributes:
        base: the surface as prescribed.
        errors: added to each other.
    """

    base: Shape
    errors: tuple[FormError, ...]

    @property
    def footing(self) -> Shape:
        """Shape of the feet; an offset has the normals of its base, so that one contraction finds both."""
        return self.base.base if isinstance(self.base, Offset) else self.base

    def displacement(self, point: FloatArray, normal: FloatArray) -> FloatArray:
        """Return the displacement of points from their feet."""
        offset = self.base.distance if isinstance(self.base, Offset) else 0.0
        return np.asarray((self.height_and_gradient(point)[0] + offset) * normal)

    @property
    def reach(self) -> float:
        """Largest shift of a root in metres."""
        return _REACH

    def normal(self, point: FloatArray) -> FloatArray:
        """Return the unit normals, on the side of the base's normals."""
        return unit(self.foot_normal(point) - self.height_and_gradient(point)[1])


@dataclass(frozen=True)
class RaisedSag(_WithErrors, LevelSurface):
    """A surface stated as z(x, y), raised by form errors along its z.

    Attributes:
        base: the surface as prescribed.
        errors: added to each other.
    """

    base: SagSurface
    errors: tuple[FormError, ...]

    def level(self, point: FloatArray, direction: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the height z of points above the surface, and its derivative along directions."""
        height, gradient = self.height_and_gradient(point)
        above, slope = self.base.level(point, direction)
        return above - height, slope - dot(gradient, direction)

    def normal(self, point: FloatArray) -> FloatArray:
        """Return the unit normals, which point to +z at the vertex."""
        _, slope_x, slope_y = self.base.sag_and_slopes(point[0], point[1])
        return unit(np.stack([-slope_x, -slope_y, np.ones_like(slope_x)]) - self.height_and_gradient(point)[1])


def raised(shape: Shape, *errors: FormError) -> Shape:
    """Return a shape with form errors, in addition to any that it has."""
    match shape:
        case Raised() | RaisedSag():
            return replace(shape, errors=(*shape.errors, *errors))
        case SagSurface():
            return RaisedSag(shape, errors)
        case _:
            return Raised(shape, errors)

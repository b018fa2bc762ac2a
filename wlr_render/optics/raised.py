"""A surface with form errors: raised from its prescription by heights over a plane."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from wlr_render.geometry.transforms import inverse
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.sag_surfaces import SagSurface
from wlr_render.optics.surfaces import DisplacedShape, Offset, Shape, dot, unit

_REACH = 1e-2  # metres: form errors are far smaller


@dataclass(frozen=True, eq=False)
class FormError:
    """By how much a surface is raised, as a function of position across an axis.

    Attributes:
        sag: height over x and y, in metres; its z means nothing here.
        surface_from_error: (4, 4) pose of its axes in those of the surface; orthogonal, improper in a mirrored eye.
    """

    sag: SagSurface
    surface_from_error: FloatArray

    @cached_property
    def error_from_surface(self) -> FloatArray:
        """Inverse of `surface_from_error`, (4, 4)."""
        return inverse(self.surface_from_error)

    def height_and_gradient(self, point: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Height (n,) in metres at points (3, n) in the surface's axes, and its gradient (3, n) there."""
        pose = self.error_from_surface
        x, y = pose[:2, :3] @ point + pose[:2, 3:]
        height, slope_x, slope_y = self.sag.sag_and_slopes(x, y)
        return height, pose[:2, :3].T @ np.stack([slope_x, slope_y])


@dataclass(frozen=True)
class Raised(DisplacedShape):
    """A surface raised by form errors: along its z if it is stated as z(x, y), otherwise along its unit normal.

    The height is a function of the point itself, not of its foot, so that the normal follows without the curvature of
    the base. With F the height of a point over the base, the surface is F(p) = h(p), and its normal grad F - grad h.

    Attributes:
        base: the surface as prescribed.
        errors: added to each other.
    """

    base: Shape
    errors: tuple[FormError, ...]

    @property
    def _is_along_z(self) -> bool:
        return isinstance(self.base, SagSurface)

    @property
    def footing(self) -> Shape:
        """See `DisplacedShape`: normals of an offset are those of its base, so that one contraction finds both."""
        return self.base.base if isinstance(self.base, Offset) else self.base

    def displacement(self, point: FloatArray, normal: FloatArray) -> FloatArray:
        """See `DisplacedShape`."""
        height = np.sum([error.height_and_gradient(point)[0] for error in self.errors], axis=0)
        if self._is_along_z:
            return np.asarray(height * _Z)
        return np.asarray((height + (self.base.distance if isinstance(self.base, Offset) else 0.0)) * normal)

    @property
    def reach(self) -> float:
        """See `DisplacedShape`."""
        return _REACH

    def normal(self, point: FloatArray) -> FloatArray:
        """See `surfaces.Shape`; leads to the side that the base's normal leads to."""
        normal = self.foot_normal(point)
        gradient = np.sum([error.height_and_gradient(point)[1] for error in self.errors], axis=0)
        along = normal[2] if self._is_along_z else dot(normal, normal)
        return unit(normal - along * gradient)


_Z = np.array([[0.0], [0.0], [1.0]])


def raised(shape: Shape, error: FormError) -> Raised:
    """A shape with one more form error."""
    return Raised(shape.base, (*shape.errors, error)) if isinstance(shape, Raised) else Raised(shape, (error,))

"""Place of a model: the coordinates of a viewpoint on which its polynomials depend.

A planar model depends on where the ray crosses its base plane, (x, y); a volumetric one on the viewpoint, (x, y, z); a
static one on nothing. `BasePlane` represents the planar place, `OwnPlace` the others; both have the same methods.
"""

from dataclasses import dataclass

import numpy as np

from wlr_render.geometry.planes import BasePlane
from wlr_render.numerics.arrays import FloatArray


@dataclass(frozen=True)
class OwnPlace:
    """Coordinates of the viewpoint itself: they do not move with the view direction.

    Attributes:
        coordinates: 3, or 0 for a model that ignores the viewpoint.
    """

    coordinates: int

    def carry(self, viewpoint: FloatArray, tangents: FloatArray) -> FloatArray:
        """Return the place (n, coordinates) of viewpoints (n, 3)."""
        return viewpoint[:, : self.coordinates]

    def carry_by_point(self, tangents: FloatArray) -> FloatArray:
        """Return the derivative of `carry` by the viewpoint: (n, coordinates, 3)."""
        return np.tile(np.eye(3)[: self.coordinates], (len(tangents), 1, 1))

    def carry_by_tangents(self, depth: FloatArray, tangents: FloatArray) -> FloatArray:
        """Return the derivative of `carry` by the tangents, zeros (n, coordinates, 2)."""
        return np.zeros((len(tangents), self.coordinates, 2))

    def depth_along(self, viewpoint: FloatArray, tangents: FloatArray) -> FloatArray:
        """Return the depth of the place in front of the viewpoint, zeros (n,)."""
        return np.zeros(len(tangents))

    def depth_by_tangents(self, depth: FloatArray, tangents: FloatArray) -> FloatArray:
        """Return the derivative of `depth_along`, zeros (n, 2)."""
        return np.zeros((len(tangents), 2))


ModelPlace = BasePlane | OwnPlace
VIEWPOINT, NOWHERE = OwnPlace(3), OwnPlace(0)

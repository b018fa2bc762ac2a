"""Centres of the discs on a board, from the centres of area of their images.

The two differ by the squared radius of the disc times the curvature of the map from the board to the picture. The
detection estimates that map from the neighbours of a dot. If dots are far apart in the picture, a lens distorts more
from dot to dot than the third-order maps of `lattice_shape` describe, and centres are wrong by tenths of a pixel. Once
the lens is known, only the map from the board to the lens has to be fitted to the neighbours.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from wlr_render.captures.boards.lattice_shape import lattice_shape
from wlr_render.geometry.directions import normalised
from wlr_render.geometry.lens import Lens
from wlr_render.numerics.arrays import FloatArray

_STEPS = np.sqrt(0.5) * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
"""Points of the unit disc with its second moments."""


@dataclass(frozen=True, eq=False)
class Discs:
    """Round features in a photograph.

    Attributes:
        centroid: (n, 2) centres of area of their pictures, camera pixels.
        radius_m: (n,) radii on the board.
    """

    centroid: FloatArray
    radius_m: FloatArray

    def only(self, rows: NDArray[np.generic]) -> "Discs":
        """Return some of the discs, by mask (n,) or by number."""
        return Discs(self.centroid[rows], self.radius_m[rows])

    def centres(self, lens: Lens, point: FloatArray, pixel: FloatArray) -> FloatArray:
        """Return the pixels (n, 2) of the centres of the discs.

        Args:
            lens: lens of the camera, at least roughly.
            point: (n, 3) positions of the centres on the board, board frame, metres.
            pixel: (n, 2) centres to a fraction of a pixel; returned where the lens has no direction.
        """
        direction = lens.dir_of_pixel(pixel)
        finite = np.isfinite(direction).all(axis=-1)
        if finite.sum() < 2:
            return pixel
        result = pixel.copy()
        shift = _centroid_shift(lens, point[finite, :2], direction[finite], self.radius_m[finite])
        result[finite] = np.where(np.isfinite(shift), self.centroid[finite] - shift, pixel[finite])
        return result


def _centroid_shift(lens: Lens, place: FloatArray, direction: FloatArray, radius: FloatArray) -> FloatArray:
    """Return the centre of area of each disc's image minus the image of its centre, (n, 2) pixels.

    The centre of area is the mean over the disc, weighted by the area of the image.

    Args:
        lens: lens of the camera.
        place: (n, 2) positions on the board.
        direction: (n, 3) directions of the centres, camera frame.
        radius: (n,) radii of the discs, in the units of `place`.
    """
    unit = float(np.median(cKDTree(place).query(place, 2)[0][:, 1]))
    to_view = _looking_along(direction.mean(axis=0))
    in_view = direction @ to_view.T
    tangents = in_view[:, :2] / in_view[:, 2:]
    shape = lattice_shape(place / unit, tangents)
    weight, total = np.zeros((len(place), 1)), np.zeros_like(place)
    for step in radius[:, None] / unit * _STEPS[:, None]:
        bend = np.einsum("nckl,nl->nck", shape.curvature, step)
        at = tangents + np.einsum("nck,nk->nc", shape.slope + 0.5 * bend, step)
        projection = lens.project(_forward(at) @ to_view)
        area = np.abs(np.linalg.det(projection.by_point @ to_view[:2].T @ (shape.slope + bend)))[:, None]
        weight += area
        total += area * projection.pixel
    with np.errstate(invalid="ignore"):  # features in one row have no area
        return np.asarray(total / weight - lens.pixel_of_point(_forward(tangents) @ to_view))


def _forward(tangents: FloatArray) -> FloatArray:
    return np.concatenate([tangents, np.ones((len(tangents), 1))], axis=-1)


def _looking_along(direction: FloatArray) -> FloatArray:
    """Return a rotation (3, 3) that turns a direction into z."""
    z = normalised(direction)
    x = normalised(np.cross(np.eye(3)[np.argmin(np.abs(z))], z))
    return np.stack([x, np.cross(z, x), z])

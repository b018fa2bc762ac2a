"""Real points observed from known viewpoints through the optics, with view directions solved from a neighbour's."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wlr_render.geometry.directions import dir_of_tangents
from wlr_render.mappings import Status
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device import EyeOptics
from wlr_render.optics.traced_mappings import TracedSeeThrough
from wlr_render.optics.tracer import trace

_TANGENT_STEP = 1e-5  # step of the finite differences, tangents
_TOLERANCE = 1e-10  # convergence in tangents, about a millionth of a camera pixel
_ITERATIONS = 8


@dataclass(frozen=True, eq=False)
class ObservedPoints:
    """Real points and the viewpoints from which they are observed.

    Attributes:
        optics: the optics in front of the eye.
        wavelength_um: wavelength, micrometres.
        viewpoint, point: (n, 3) viewpoints and points, device frame.
    """

    optics: EyeOptics
    wavelength_um: float
    viewpoint: FloatArray
    point: FloatArray

    def solved(self, rows: NDArray[np.int64] | slice = slice(None)) -> FloatArray:
        """Solve for the tangents (n, 2) of points from a cold start; NaN for points that are not seen."""
        mapping = TracedSeeThrough(self.optics, self.wavelength_um)
        found = mapping.view_dir_of_real_point(self.point[rows], self.viewpoint[rows])
        assert found.warm_start is not None  # the warm start holds the solved tangents
        return np.where((found.status == Status.OK)[:, None], found.warm_start, np.nan)

    def miss(self, tangents: FloatArray, rows: NDArray[np.int64] | slice = slice(None)) -> FloatArray:
        """Return the lateral miss (n, 2) of the world rays at the points' depth, divided by the distance in depth."""
        viewpoint, point = self.viewpoint[rows], self.point[rows]
        traced = trace(self.optics.see_through, viewpoint, dir_of_tangents(tangents), self.wavelength_um)
        lost = (traced.status != Status.OK) & (traced.status != Status.CLIPPED)
        with np.errstate(divide="ignore", invalid="ignore"):
            along = (point[:, 2] - traced.origin[:, 2]) / traced.direction[:, 2]
            across = (traced.origin - point + along[:, None] * traced.direction)[:, :2]
            return np.asarray(np.where(lost[:, None], np.nan, across / (viewpoint[:, 2] - point[:, 2])[:, None]))

    def tangents_from_miss(self, tangents: FloatArray) -> FloatArray:
        """Return the inverse Jacobian (n, 2, 2) of the miss with respect to the tangents; NaN where singular."""
        here = self.miss(tangents)
        columns = [(self.miss(tangents + shift) - here) / _TANGENT_STEP for shift in _TANGENT_STEP * np.eye(2)]
        (a, c), (b, d) = columns[0].T, columns[1].T
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = np.array([[d, -b], [-c, a]]) / (a * d - b * c)
        return np.asarray(np.moveaxis(inverse, -1, 0))

    def solved_from(self, tangents: FloatArray, tangents_from_miss: FloatArray) -> FloatArray:
        """Take Newton steps until the tangents (n, 2) converge; rows that fail to are solved from a cold start.

        A point that the neighbouring bench sees and that has moved past the edge of an aperture keeps its tangents.
        """
        tangents = tangents.copy()
        led = np.isfinite(tangents).all(axis=1) & np.isfinite(tangents_from_miss).all(axis=(1, 2))
        going = np.flatnonzero(led)
        for _ in range(_ITERATIONS):
            step = np.einsum("nij,nj->ni", tangents_from_miss[going], self.miss(tangents[going], going))
            tangents[going] -= step
            going = going[~(np.abs(step).max(axis=1) < _TOLERANCE)]
            if going.size == 0:
                break
        stuck = np.union1d(going, np.flatnonzero(~led))
        if stuck.size:
            tangents[stuck] = self.solved(stuck)
        return tangents

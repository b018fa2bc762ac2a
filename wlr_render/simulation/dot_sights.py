"""In which direction a camera sees real points through the optics, fast when the bench has changed just a little."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wlr_render.geometry.directions import dir_of_tangents, tangents_of_dir
from wlr_render.mappings import Status
from wlr_render.optics.device import EyeOptics
from wlr_render.optics.traced_mappings import TracedSeeThrough
from wlr_render.optics.tracer import trace

FloatArray = NDArray[np.float64]

_TANGENT_STEP = 1e-5  # of the central differences
_TOLERANCE = 1e-10  # radians as seen from the camera: a millionth of a camera pixel
_ITERATIONS = 8


@dataclass(frozen=True, eq=False)
class SightStart:
    """A solved state from which neighbouring ones are reached in a step or two.

    Attributes:
        tangents: (n, 2) of the directions in which the points are seen; NaN where they are not.
        tangents_from_miss: (n, 2, 2) inverse Jacobian of the miss.
    """

    tangents: FloatArray
    tangents_from_miss: FloatArray


def solved(optics: EyeOptics, wavelength_um: float, viewpoint: FloatArray, point: FloatArray) -> SightStart:
    """Solve from cold for points (n, 3) seen from viewpoints (n, 3)."""
    seen = TracedSeeThrough(optics, wavelength_um).view_dir_of_real_point(point, viewpoint)
    tangents = tangents_of_dir(seen.value)
    columns = []
    for shift in _TANGENT_STEP * np.eye(2):
        ahead = _miss(optics, wavelength_um, viewpoint, point, tangents + shift)
        behind = _miss(optics, wavelength_um, viewpoint, point, tangents - shift)
        columns.append((ahead - behind) / (2 * _TANGENT_STEP))
    jacobian = np.stack(columns, axis=-1)
    singular = ~(np.abs(np.linalg.det(jacobian)) > 0)
    jacobian[singular] = np.nan
    inverse = np.full_like(jacobian, np.nan)
    inverse[~singular] = np.linalg.inv(jacobian[~singular])
    return SightStart(tangents, inverse)


def view_tangents(
    optics: EyeOptics, wavelength_um: float, viewpoint: FloatArray, point: FloatArray, start: SightStart
) -> FloatArray:
    """Tangents (n, 2) of the directions in which points are seen, by Newton steps with the start's Jacobian.

    Rows that do not settle so are solved from cold; NaN where there is no solution.
    """
    tangents = start.tangents.copy()
    going = np.flatnonzero(np.isfinite(tangents).all(axis=1) & np.isfinite(start.tangents_from_miss).all(axis=(1, 2)))
    for _ in range(_ITERATIONS):
        miss = _miss(optics, wavelength_um, viewpoint[going], point[going], tangents[going])
        step = np.einsum("nij,nj->ni", start.tangents_from_miss[going], miss)
        tangents[going] -= step
        going = going[~(np.abs(step).max(axis=1) < _TOLERANCE)]
        if going.size == 0:
            break
    stuck = np.union1d(going, np.flatnonzero(~np.isfinite(tangents).all(axis=1)))
    if stuck.size:
        seen = TracedSeeThrough(optics, wavelength_um).view_dir_of_real_point(point[stuck], viewpoint[stuck])
        tangents[stuck] = tangents_of_dir(seen.value)
    return tangents


def _miss(
    optics: EyeOptics, wavelength_um: float, viewpoint: FloatArray, point: FloatArray, tangents: FloatArray
) -> FloatArray:
    """Where the world rays pass the points' depth, minus the points, over their distance: (n, 2)."""
    traced = trace(optics.see_through, viewpoint, dir_of_tangents(tangents), wavelength_um)
    lost = (traced.status != Status.OK) & (traced.status != Status.CLIPPED)
    with np.errstate(divide="ignore", invalid="ignore"):
        along = (point[:, 2] - traced.origin[:, 2]) / traced.direction[:, 2]
        across = (traced.origin - point + along[:, None] * traced.direction)[:, :2]
        return np.asarray(np.where(lost[:, None], np.nan, across / (viewpoint[:, 2] - point[:, 2])[:, None]))

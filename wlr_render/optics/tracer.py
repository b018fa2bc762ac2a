"""Exact sequential ray tracing in float64: reflection and refraction along a path.

G. H. Spencer and M. V. R. K. Murty, "General Ray-Tracing Procedure", J. Opt. Soc. Am. 52 (1962) 672, with the
intersection chosen by its distance along the ray and the clear aperture.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wlr_render.mappings import Status, StatusArray
from wlr_render.numerics.arrays import BoolArray, FloatArray
from wlr_render.optics.device import ClearAperture, Interaction, Path, PlacedSurface
from wlr_render.optics.media import AIR
from wlr_render.optics.surfaces import dot

_CHUNK = 8192  # rays at a time: their columns stay in the processor's cache
_FORWARD = 1e-12  # metres; a root must lie this far ahead


@dataclass(frozen=True)
class Trace:
    """Result of tracing rays along a path.

    Attributes:
        points: (..., steps, 3) intersections with the path's surfaces.
        origin: (..., 3) the last of these points, or the start if the path has no steps.
        direction: (..., 3) unit directions after the last step.
        status: (...) uint8 `Status`. CLIPPED rays continue as if the surface were unlimited, so that a solver can
            cross its edge; all other failures are NaN from that surface on.
    """

    points: FloatArray
    origin: FloatArray
    direction: FloatArray
    status: StatusArray


@np.errstate(all="ignore")  # a ray that overflows is lost, and its status reports it
def trace(path: Path, origin: FloatArray, direction: FloatArray, wavelength_um: float) -> Trace:
    """Trace rays along a path.

    Args:
        path: the surface interactions, in order.
        origin: (..., 3) metres, device frame; broadcasts against `direction`.
        direction: (..., 3) unit.
        wavelength_um: vacuum wavelength in micrometres.
    """
    lead = np.broadcast_shapes(origin.shape[:-1], direction.shape[:-1])
    starts = np.broadcast_to(origin, (*lead, 3)).reshape(-1, 3)
    heads = np.broadcast_to(direction, (*lead, 3)).reshape(-1, 3)
    count, steps = len(starts), len(path.steps)
    points, end, status = np.empty((count, steps, 3)), np.empty((count, 3)), np.empty(count, dtype=np.uint8)
    for first in range(0, count, _CHUNK):
        rows = slice(first, first + _CHUNK)
        _follow(
            path, starts[rows].T.copy(), heads[rows].T.copy(), wavelength_um, (points[rows], end[rows], status[rows])
        )
    last = points[:, -1] if steps else starts
    return Trace(points.reshape(*lead, steps, 3), last.reshape(*lead, 3), end.reshape(*lead, 3), status.reshape(lead))


def _follow(
    path: Path,
    origin: FloatArray,
    direction: FloatArray,
    wavelength_um: float,
    result: tuple[FloatArray, FloatArray, StatusArray],
) -> None:
    """Trace one chunk of columns (3, n) into `result`: points (n, steps, 3), directions (n, 3), status (n,)."""
    points, end, status = result
    # A ray that starts with NaN must not end as OK on an empty path.
    status[:] = np.where(np.isfinite(origin).all(axis=0) & np.isfinite(direction).all(axis=0), Status.OK, Status.MISS)
    index = AIR.index(wavelength_um)
    for number, step in enumerate(path.steps):
        origin, normal, failure = _meet(step.surface, origin, direction)
        _keep_first(status, failure)
        points[:, number] = origin.T
        next_index = step.medium.index(wavelength_um)
        if step.interaction is Interaction.REFRACT:
            direction = _refracted(direction, normal, index / next_index)
            index = next_index
            _keep_first(status, np.where(np.isnan(direction[0]), Status.TOTAL_REFLECTION, Status.OK))
            continue
        if step.interaction is Interaction.TOTAL_REFLECT:
            _keep_first(status, np.where(_is_total(direction, normal, index), Status.OK, Status.CLIPPED))
        direction = direction - 2.0 * dot(direction, normal) * normal
    end[:] = direction.T


def _keep_first(status: StatusArray, failure: NDArray[np.integer]) -> None:
    """Record the first failure of each ray."""
    np.copyto(status, failure, where=status == Status.OK, casting="unsafe")


@np.errstate(invalid="ignore")
def _refracted(direction: FloatArray, normal: FloatArray, ratio: float) -> FloatArray:
    """Refract by Snell's law in vector form, `ratio` = n before / n after; NaN at total reflection."""
    cosine = dot(direction, normal)
    root = np.sqrt(1.0 - ratio * ratio * (1.0 - cosine * cosine))
    return np.asarray(ratio * direction + (np.copysign(root, cosine) - ratio * cosine) * normal)


def _is_total(direction: FloatArray, normal: FloatArray, index: float) -> BoolArray:
    """Return whether rays are totally internally reflected against air.

    Below the critical angle most of the light leaves, so the surface is not a mirror for this step, and the ray is
    CLIPPED.
    """
    cosine = dot(direction, normal)
    return np.asarray(index * index * (1.0 - cosine * cosine) >= 1.0)


def _meet(
    surface: PlacedSurface, origin: FloatArray, direction: FloatArray
) -> tuple[FloatArray, FloatArray, StatusArray]:
    """Intersect rays with one surface: points (3, n) and normals (3, n) in the device frame, and status (n,).

    The result is the first intersection ahead inside the clear aperture; without one, the intersection nearest to the
    aperture, as CLIPPED.
    """
    pose = surface.surface_from_device
    local_origin = pose[:3, :3] @ origin + pose[:3, 3:]
    local_direction = pose[:3, :3] @ direction
    hits = surface.shape.meet(local_origin, local_direction)
    ahead = np.where((hits.distance > _FORWARD) & hits.converged, hits.distance, np.nan)
    distance, point, excess = _choose(surface.aperture, ahead, local_origin, local_direction)
    status = np.where(excess > 0.0, Status.CLIPPED, Status.OK)
    status[np.isnan(distance)] = Status.MISS
    status[~hits.converged] = Status.NOT_CONVERGED
    normal = pose[:3, :3].T @ surface.shape.normal(point)
    return origin + distance * direction, normal, status.astype(np.uint8)


def _choose(
    aperture: ClearAperture, ahead: FloatArray, origin: FloatArray, direction: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Choose among intersections (k, n), NaN where not ahead: distance (n,), local point (3, n), excess (n,)."""
    distance = ahead[0].copy()
    for other in ahead[1:]:
        np.copyto(distance, other, where=np.isnan(distance))
    point = origin + distance * direction
    excess = _excess(aperture, point)
    for other in ahead:
        again = np.flatnonzero((excess > 0.0) & (other != distance) & ~np.isnan(other))
        if again.size == 0:
            continue
        other_point = origin[:, again] + other[again] * direction[:, again]
        other_excess = _excess(aperture, other_point)
        better = other_excess < excess[again]
        chosen = again[better]
        distance[chosen] = other[chosen]
        point[:, chosen] = other_point[:, better]
        excess[chosen] = other_excess[better]
    return distance, point, excess


def _excess(aperture: ClearAperture, point: FloatArray) -> FloatArray:
    """Return the distance of points (3, n) outside the aperture's box, along its worst axis; at most 0 inside."""
    outside = np.maximum(aperture.low[:, None] - point, point - aperture.high[:, None])
    return np.asarray(outside.max(axis=0))

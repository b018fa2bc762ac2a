"""Ray maps for one viewpoint after the other on the CPU, in float64, and the protocol that every solver follows."""

from dataclasses import replace
from typing import Protocol, TypeVar

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.mappings import EyeMappings
from wlr_render.numerics.arrays import FloatArray
from wlr_render.rendering.ray_map import RayMap, RayMapPlan, WarmStart, ray_map, solve_pixels
from wlr_render.rendering.warp_grid import WarpGrid

SolvedT = TypeVar("SolvedT", covariant=True)
"""`RayMap`, or `gl_ray_maps.GpuRayMap`."""


class RayMapSolver(Protocol[SolvedT]):
    """Solves the rays of a warp grid for successive viewpoints, each from the last solution."""

    def solve(self, viewpoint: FloatArray) -> SolvedT:
        """The ray map at a viewpoint (3,), device frame, metres; on the GPU the next solve overwrites it.

        Raises:
            BadInputError: the viewpoint is not three finite numbers; the last solution is kept.
        """

    def forget(self) -> None:
        """Start the next solve cold."""


def checked_viewpoint(viewpoint: FloatArray) -> FloatArray:
    """Return the viewpoint as (3,) float64.

    Raises:
        BadInputError: it is not three finite numbers.
    """
    try:
        checked = np.asarray(viewpoint, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise BadInputError(f"the viewpoint {viewpoint!r} is not three finite numbers.") from error
    if checked.shape != (3,) or not np.isfinite(checked).all():
        raise BadInputError(
            f"the viewpoint {checked.tolist()} is not three finite numbers; give the eye's place in the device frame in"
            " metres, and hold the last good one while the eye is not seen."
        )
    return checked


class CpuPixelSolver:
    """`RayMapSolver` for any mappings, planar or not, that queries every point."""

    def __init__(self, mappings: EyeMappings, warp_grid: WarpGrid, device_from_camera: FloatArray) -> None:
        """Prepare for the points of a warp grid on the mappings' panel, and for tangents in these axes (3, 3)."""
        self._mappings = mappings
        self._device_from_camera = device_from_camera
        self._pixel = warp_grid.panel_pixel()
        self._last: WarmStart | None = None

    def solve(self, viewpoint: FloatArray) -> RayMap:
        """See `RayMapSolver.solve`."""
        viewpoint = checked_viewpoint(viewpoint)
        axes = self._device_from_camera
        solved = solve_pixels(self._mappings, axes, self._pixel, viewpoint, self._last)
        self._last = solved.warm_start
        slope_offset = np.ascontiguousarray(np.moveaxis(solved.slope_offset, -1, 0), dtype=np.float32)
        return RayMap(viewpoint, axes, slope_offset, solved.status)

    def forget(self) -> None:
        """Start the next solve cold."""
        self._last = None


class CpuNodeSolver:
    """`RayMapSolver` for any mappings from Chebyshev nodes: `ray_map` with a warm start of its own."""

    def __init__(self, mappings: EyeMappings, plan: RayMapPlan) -> None:
        """Prepare for the plan's warp grid and axes; the plan is of the mappings' panel."""
        self._mappings, self._plan = mappings, plan
        self._last: WarmStart | None = None

    def solve(self, viewpoint: FloatArray) -> RayMap:
        """See `RayMapSolver.solve`."""
        solved = ray_map(self._mappings, checked_viewpoint(viewpoint), self._plan, self._last)
        self._last = solved.warm_start
        return replace(solved, warm_start=None)

    def forget(self) -> None:
        """Start the next solve cold."""
        self._last = None

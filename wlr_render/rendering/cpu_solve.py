"""Fields for one viewpoint after the other without a GPU: the mappings' own queries, in float64."""

from dataclasses import dataclass, replace

import numpy as np

from wlr_render.mappings import EyeMappings
from wlr_render.numerics.arrays import FloatArray
from wlr_render.rendering.lattice import Lattice
from wlr_render.rendering.pixel_solve import checked_viewpoint
from wlr_render.rendering.ray_field import FieldPlan, RayField, WarmStart, ray_field, solve_pixels


@dataclass(frozen=True, eq=False)
class CpuSolvedField:
    """A field that already is in numpy arrays."""

    field: RayField

    def read(self) -> RayField:
        """The field."""
        return self.field


class CpuSolve:
    """`PixelSolve` for any mappings, planar or not: every point is asked."""

    def __init__(self, mappings: EyeMappings, lattice: Lattice, device_from_camera: FloatArray) -> None:
        """Prepare for the points of a lattice on the mappings' panel, and for tangents in these axes (3, 3)."""
        self._mappings = mappings
        self._device_from_camera = device_from_camera
        self._pixel = lattice.panel_pixel()
        self._last: WarmStart | None = None

    def solve(self, viewpoint: FloatArray) -> CpuSolvedField:
        """See `PixelSolve.solve`."""
        viewpoint = checked_viewpoint(viewpoint)
        axes = self._device_from_camera
        solved = solve_pixels(self._mappings, axes, self._pixel, viewpoint, self._last)
        self._last = solved.warm_start
        bend = np.ascontiguousarray(np.moveaxis(solved.bend, -1, 0), dtype=np.float32)
        return CpuSolvedField(RayField(viewpoint, axes, bend, solved.status))

    def forget(self) -> None:
        """Start the next solve cold."""
        self._last = None


class CpuNodes:
    """`PixelSolve` for any mappings by the nodes of a plan: `ray_field` that keeps its own warm start."""

    def __init__(self, mappings: EyeMappings, plan: FieldPlan) -> None:
        """Prepare for the plan's lattice and axes; the plan is of the mappings' panel."""
        self._mappings, self._plan = mappings, plan
        self._last: WarmStart | None = None

    def solve(self, viewpoint: FloatArray) -> CpuSolvedField:
        """See `PixelSolve.solve`."""
        field = ray_field(self._mappings, checked_viewpoint(viewpoint), self._plan, self._last)
        self._last = field.warm_start
        return CpuSolvedField(replace(field, warm_start=None))

    def forget(self) -> None:
        """Start the next solve cold."""
        self._last = None

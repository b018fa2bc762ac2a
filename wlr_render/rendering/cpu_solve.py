"""The solve of every display pixel without a GPU: the mappings' own queries, in float64."""

from dataclasses import dataclass

import numpy as np

from wlr_render.mappings import EyeMappings, FloatArray
from wlr_render.rendering.pixel_solve import checked_viewpoint, pixel_centres_on_panel
from wlr_render.rendering.ray_field import RayField, WarmStart, solve_pixels


@dataclass(frozen=True, eq=False)
class CpuSolvedField:
    """A field that already is in numpy arrays."""

    field: RayField

    def read(self) -> RayField:
        """The field."""
        return self.field


class CpuSolve:
    """`PixelSolve` for any mappings, planar or not."""

    def __init__(self, mappings: EyeMappings, size_px: tuple[int, int], device_from_camera: FloatArray) -> None:
        """Prepare for (width, height) pixels that cover the panel, and for tangents in these axes (3, 3)."""
        self._mappings = mappings
        self._device_from_camera = device_from_camera
        self._pixel = pixel_centres_on_panel(mappings.display.panel.size_px, size_px)
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

"""Cells of a warp grid: image positions of the rays at their corners, and bounds of the depths that the rays meet."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from wlr_render.gl import gl
from wlr_render.numerics.arrays import FloatArray
from wlr_render.warp.gl_ray_maps import RayTexture
from wlr_render.warp.gpu_image import DepthRanges, GlDepthRanges, GpuImage
from wlr_render.warp.raster_camera import MAX_SAMPLES
from wlr_render.warp.warp import DIRECT_PX, SPACING_PX, SURFACE_STEP, TILE, WarpStatus

MAX_OVERLAYS = 4
"""Largest number of overlays that an eye shows at once."""


WARP_CONSTANTS = {status.name: int(status) for status in WarpStatus} | {
    "SURFACE_STEP": SURFACE_STEP,
    "TILE": TILE,
    "DIRECT_PX": DIRECT_PX,
    "SPACING_PX": SPACING_PX,
    "MISSING": 1e30,
    "MAX_OVERLAYS": MAX_OVERLAYS,
    "MOST_SAMPLES": float(MAX_SAMPLES),
}
"""Constants of the shaders of the cells and of the warp."""


@dataclass(frozen=True, eq=False)
class WarpCells:
    """Outputs of `cells.frag` for a picture, and the bounds of the picture's depths.

    Attributes:
        paths: at each point of the grid, the picture position at infinity, and its shift per inverse depth.
        bends: second differences of the positions, along the rows and along the columns.
        mixed_bends_and_ranges: mixed differences, and bounds of the inverse depth with the notes of `cell_notes.glsl`.
        ranges: bounds of the picture's inverse depths.
    """

    paths: gl.Texture
    bends: gl.Texture
    mixed_bends_and_ranges: gl.Texture
    ranges: DepthRanges


class GlCells:
    """Draws `cells.frag` for one picture of a frame: the widest, or an inset; textures are reused between frames."""

    def __init__(self, context: gl.GlContext, channels: int, ranges: GlDepthRanges) -> None:
        self._channels = channels
        self.ranges, self._targets = ranges, gl.RenderTargets(context)
        self._filling = gl.Pass(context, "cells.frag", CHANNELS=channels, **WARP_CONSTANTS)

    def draw(
        self,
        image: GpuImage,
        ray_maps: Sequence[RayTexture],
        image_from_ray_map: FloatArray,
        display_size_px: tuple[int, int],
        is_inset: bool,
        inset: WarpCells | None,
    ) -> WarpCells:
        """Compute the cells of a picture, which may be an inset, and may contain an inset."""
        ranges = self.ranges.of(image)
        warp_grid = ray_maps[0].warp_grid
        matrices = image.camera.image_from_camera @ image_from_ray_map
        by_rows = matrices.ndim == 3
        cells = self._targets.get("cells", (warp_grid.columns, warp_grid.rows * self._channels), *[(4, "f4")] * 3)
        rays = [each.slope_offset for each in ray_maps]
        # Unused samplers have a texture too, because none may read a target.
        unused = dict.fromkeys(("row_matrices", "inset_ranges"), rays[0])
        textures: dict[str, Any] = {"ranges": ranges.pyramid, "slope_offset": rays, **unused}
        inputs = np.zeros((4, 4))
        if by_rows:
            rows = self._targets.get("row matrices", (3, warp_grid.rows), (4, "f4")).textures[0]
            rows.write(np.ascontiguousarray(matrices, np.float32))
            textures["row_matrices"] = rows
        else:
            inputs[:3] = matrices
        if inset is not None:
            textures["inset_ranges"] = inset.mixed_bends_and_ranges
        per_cell = display_size_px[0] / (warp_grid.columns - 1), display_size_px[1] / (warp_grid.rows - 1)
        inputs[3] = *image.inverse_depth.size, *per_cell
        uniforms = {"has_row_matrices": by_rows, "is_inset": is_inset, "has_inset": inset is not None}
        self._filling.fill(cells, textures, inputs_of_picture=gl.floats(inputs), **uniforms)
        paths, bends, mixed_bends_and_ranges = cells.textures
        return WarpCells(paths, bends, mixed_bends_and_ranges, ranges)

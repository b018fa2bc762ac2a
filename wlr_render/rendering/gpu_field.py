"""A field of world rays that has stayed on the GPU."""

from dataclasses import dataclass

import numpy as np

from wlr_render.mappings import FloatArray
from wlr_render.rendering import gl
from wlr_render.rendering.lattice import Lattice
from wlr_render.rendering.ray_field import Float32Array


@dataclass(frozen=True, eq=False)
class GpuField:
    """World rays at the points of a lattice, as a texture that its maker's next field overwrites.

    Attributes:
        context: whose texture it is.
        viewpoint_in_device: (3,) metres.
        device_from_camera: (3, 3) axes of `bend`.
        lattice: the points.
        bend: RGBA32F of the lattice's size, (a, b, c, d) as `RayField.bend`, NaN where there is no ray; read with
            linear filtering between the points.
    """

    context: gl.GlContext
    viewpoint_in_device: FloatArray
    device_from_camera: FloatArray
    lattice: Lattice
    bend: gl.Texture

    def read_bend(self) -> Float32Array:
        """Fetch (4, rows, columns)."""
        with self.context.drawing():
            return np.ascontiguousarray(np.moveaxis(gl.read(self.bend, np.float32), -1, 0))

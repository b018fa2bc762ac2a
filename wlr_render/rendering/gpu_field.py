"""A field of world rays that has stayed on the GPU."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from wlr_render.mappings import StatusArray
from wlr_render.numerics.arrays import Float32Array, FloatArray
from wlr_render.rendering import gl
from wlr_render.rendering.lattice import Lattice
from wlr_render.rendering.ray_field import RayField


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


@dataclass(frozen=True, eq=False)
class SolvedGpuField(GpuField, ABC):
    """A field whose maker can say what became of each point."""

    @abstractmethod
    def read_status(self) -> StatusArray:
        """(rows, columns), one `mappings.Status` each."""

    def read(self) -> RayField:
        """Fetch rays and status."""
        return RayField(self.viewpoint_in_device, self.device_from_camera, self.read_bend(), self.read_status())


class GpuSolve(Protocol):
    """As `pixel_solve.PixelSolve`, with the field on the GPU."""

    def solve(self, viewpoint: FloatArray) -> SolvedGpuField:
        """See `PixelSolve.solve`; the field is overwritten by the next."""

    def forget(self) -> None:
        """Start the next solve cold."""

"""A field on the GPU for any mappings: nodes solved in float64 on the CPU, spread over a lattice, uploaded."""

from dataclasses import dataclass

import cv2
import numpy as np

from wlr_render.mappings import EyeMappings, StatusArray
from wlr_render.numerics.arrays import FloatArray
from wlr_render.rendering import gl
from wlr_render.rendering.cpu_solve import CpuNodes
from wlr_render.rendering.gpu_field import SolvedGpuField
from wlr_render.rendering.ray_field import FieldPlan


@dataclass(frozen=True, eq=False)
class GlNodesField(SolvedGpuField):
    """A field that was solved on the CPU.

    Attributes:
        status: (rows, columns) uint8.
    """

    status: StatusArray

    def read_status(self) -> StatusArray:
        """See `SolvedGpuField`."""
        return self.status


class GlNodes:
    """`GpuSolve` for any mappings by the nodes of a plan, which has the lattice and the axes too."""

    def __init__(self, context: gl.GlContext, mappings: EyeMappings, plan: FieldPlan) -> None:
        self._context, self._plan = context, plan
        self._nodes = CpuNodes(mappings, plan)
        columns, rows = plan.lattice.size
        self._interleaved = np.empty((rows, columns, 4), np.float32)
        with context.drawing():
            self._bend = context.target(plan.lattice.size, 4, "f4")
            gl.read_between_texels(self._bend)

    def solve(self, viewpoint: FloatArray) -> GlNodesField:
        """See `GpuSolve`."""
        field = self._nodes.solve(viewpoint).field
        # One texture of four components costs a shader much less to read than four textures.
        with self._context.drawing():
            self._bend.write(cv2.merge(list(field.bend), self._interleaved))
        return GlNodesField(
            self._context,
            field.viewpoint_in_device,
            field.device_from_camera,
            self._plan.lattice,
            self._bend,
            field.status,
        )

    def forget(self) -> None:
        """Start the next solve cold."""
        self._nodes.forget()

"""Ray maps on the GPU: planar models solved in a shader, any others spread from Chebyshev nodes solved on the CPU.

Each point of the warp grid finds the tangents t under which the viewpoint sees it from
p~ = viewpoint_xy + s t(pixel, p~), by Newton's method in float32. On a plane of slope m the depth s is
h / (1 + m . t), with h the viewpoint's height over the plane along z. Deviation and ray are a closed form of the
solution. A solve starts from the viewpoint, not from the last frame: a warp grid has so few points that the two or
three iterations do not show in a frame's time.
"""

from dataclasses import dataclass

import numpy as np

from wlr_render.geometry.directions import ARCMIN
from wlr_render.gl import gl
from wlr_render.mappings import EYE_BOX_MARGIN, Eye, Status, StatusArray, require_planar
from wlr_render.numerics.arrays import Float32Array, FloatArray
from wlr_render.warp.grid import WarpGrid
from wlr_render.warp.ray_map import NEAREST_M, FilledRayMaps, RayMap, RayMapPlan, checked_viewpoint
from wlr_render.warp.shader_polynomial import held_source, thinned, value_source


@dataclass(frozen=True, eq=False)
class RayTexture:
    """World rays at the points of a warp grid.

    Attributes:
        warp_grid: the points, from edge to edge of the panel.
        slope_offset: RGBA32F of the warp grid's size, (a, b, c, d) as `RayMap.slope_offset`, NaN without a ray.
    """

    warp_grid: WarpGrid
    slope_offset: gl.Texture


@dataclass(frozen=True, eq=False)
class GpuRayMap(RayTexture):
    """The ray map of one viewpoint, whose textures the solver's next solves overwrite.

    Attributes:
        context: of the textures.
        viewpoint_in_device: (3,) metres.
        device_from_camera: (3, 3) axes of `slope_offset`.
        status: `mappings.Status` of each point: (rows, columns) uint8, or R8UI from a shader.
    """

    context: gl.GlContext
    viewpoint_in_device: FloatArray
    device_from_camera: FloatArray
    status: gl.Texture | StatusArray

    def read(self) -> RayMap:
        """Fetch rays and status."""
        return RayMap(self.viewpoint_in_device, self.device_from_camera, self.read_slope_offset(), self.read_status())

    def read_slope_offset(self) -> Float32Array:
        """Fetch (4, rows, columns)."""
        with self.context.drawing():
            return np.ascontiguousarray(np.moveaxis(gl.read(self.slope_offset, np.float32), -1, 0))

    def read_status(self) -> StatusArray:
        """Fetch (rows, columns), one `mappings.Status` each."""
        if isinstance(self.status, np.ndarray):
            return self.status
        with self.context.drawing():
            return gl.read(self.status, np.uint8)


MAX_ITERATIONS = 12
"""A regular solve takes two or three."""
LAST_STEP_M = 3e-6
"""A Newton step in the base plane that ends the solve: t follows its slope over it to 1e-4 arcmin, for slopes that
change by less than 6 rad/m in a millimetre; and a thousand times what float32 leaves of a step."""

DROPPED = 0.002 * ARCMIN
"""Terms of a polynomial are dropped while they change no direction by more, in each of the display's tangents, A and
B / NEAREST_M: a fifteenth of the best fits' error (0.03'), and no more than float32 loses."""


class GlPlanarSolver:
    """`RayMapSolver` of one eye's planar models, in a shader compiled for its models.

    Attributes:
        dropped_arcmin: bounds what dropped terms of the polynomials change in a world ray within the fit, to NEAREST_M.
    """

    def __init__(
        self,
        context: gl.GlContext,
        mappings: Eye,
        warp_grid: WarpGrid,
        device_from_camera: FloatArray,
    ) -> None:
        """Prepare for the points of a warp grid on the mappings' panel, and for tangents in these axes (3, 3).

        Raises:
            BadInputError: the mappings are not planar models.
        """
        self._display, self._see_through = require_planar(mappings)
        self._context, self._warp_grid, self._device_from_camera = context, warp_grid, device_from_camera
        display = thinned(self._display.modelled, np.full(2, DROPPED))
        deviation = thinned(self._see_through.modelled, DROPPED * np.array([1.0, 1.0, NEAREST_M, NEAREST_M]))
        parts = display.bound, deviation.bound[:2], deviation.bound[2:] / NEAREST_M
        self.dropped_arcmin = float(sum(np.linalg.norm(part) for part in parts)) / ARCMIN
        functions = held_source("display", display.polynomial) + value_source("deviation", deviation.polynomial)
        constants: dict[str, float] = {status.name: int(status) for status in Status}
        constants |= {"MAX_ITERATIONS": MAX_ITERATIONS, "LAST_STEP_M": LAST_STEP_M}
        with context.drawing():
            self._solve = context.full_screen("solve.frag", "full_screen.vert", functions, **constants)
            self._target = gl.RenderTargets(context).get("rays", warp_grid.size, (4, "f4"), (1, "u1"))

    def solve(self, viewpoint: FloatArray) -> GpuRayMap:
        """Solve a ray map in the shader; see `RayMapSolver.solve`."""
        viewpoint = checked_viewpoint(viewpoint)
        display, see_through = self._display, self._see_through
        with self._context.drawing():
            self._context.draw_to(self._target.framebuffer)
            self._set_constants()
            gl.set_uniforms(
                self._solve.program,
                viewpoint=tuple(viewpoint),
                behind_display_plane=float(display.place.height_of(viewpoint)),
                behind_see_through_plane=float(see_through.place.height_of(viewpoint)),
                viewpoint_inside=all(
                    each.eye_box.contains(viewpoint, EYE_BOX_MARGIN) for each in (display, see_through)
                ),
            )
            self._solve.render(vertices=3)
        slope_offset, status = self._target.textures
        return GpuRayMap(self._warp_grid, slope_offset, self._context, viewpoint, self._device_from_camera, status)

    def _set_constants(self) -> None:
        # Eyes with equal models share the program, but not their grid.
        program = self._solve.program
        gl.set_uniforms(
            program,
            first_px=tuple(self._warp_grid.first_px),
            step_px=tuple(self._warp_grid.step_px),
            display_plane_slope=tuple(map(float, self._display.place.slope)),
            see_through_plane_slope=tuple(map(float, self._see_through.place.slope)),
        )
        gl.set_matrix(program, "camera_from_device", self._device_from_camera.T)


class GlNodeSolver:
    """`RayMapSolver` for any mappings from Chebyshev nodes; the plan states warp grid and axes."""

    def __init__(self, context: gl.GlContext, mappings: Eye, plan: RayMapPlan) -> None:
        """Prepare, and query every point once to know where the device shows nothing."""
        self._context, self._plan = context, plan
        self._ray_maps = FilledRayMaps(mappings, plan)
        with context.drawing():
            self._slope_offset = context.target(plan.warp_grid.size, 4, "f4")

    def solve(self, viewpoint: FloatArray) -> GpuRayMap:
        """Solve a ray map on the CPU and upload it; see `RayMapSolver.solve`."""
        solved = self._ray_maps.at(checked_viewpoint(viewpoint))
        with self._context.drawing():
            self._slope_offset.write(np.ascontiguousarray(np.moveaxis(solved.slope_offset, 0, -1)))
        return GpuRayMap(
            self._plan.warp_grid,
            self._slope_offset,
            self._context,
            solved.viewpoint_in_device,
            solved.device_from_camera,
            solved.status,
        )

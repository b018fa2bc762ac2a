"""Ray maps on the GPU: planar models solved in a shader, any others spread from Chebyshev nodes solved on the CPU.

Each point, be it a display pixel or coarser, finds the tangents t under which the viewpoint sees it from
p~ = viewpoint_xy + s t(pixel, p~), by Newton's method in float32. On a plane of slope m the depth s is
h / (1 + m . t), with h the viewpoint's height over the plane along z. A frame starts from the last frame's t,
extrapolated to the new viewpoint with its derivative, T (1 - M T)^-1 (d viewpoint_xy + t dh / (1 + m . t)), with T the
slope of t(pixel, p~) in p~ and M that of s t in t: the error is of second order, so that one evaluation is usually
enough, even after a saccade.
Deviation and ray are a closed form of the solution.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render.geometry.directions import ARCMIN
from wlr_render.mappings import EYE_BOX_MARGIN, EyeMappings, Status, StatusArray, require_planar
from wlr_render.numerics.arrays import Float32Array, FloatArray
from wlr_render.rendering import gl
from wlr_render.rendering.cpu_ray_maps import CpuNodeSolver, checked_viewpoint
from wlr_render.rendering.ray_map import NEAREST_M, RayMap, RayMapPlan
from wlr_render.rendering.shader_polynomial import held_source, thinned, value_source
from wlr_render.rendering.warp_grid import WarpGrid


@dataclass(frozen=True, eq=False)
class RayTexture:
    """World rays at the points of a warp grid.

    Attributes:
        warp_grid: the points.
        slope_offset: RGBA32F of the warp grid's size, (a, b, c, d) as `RayMap.slope_offset`, NaN where there is no ray;
            read with linear filtering between the points.
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
        status: `mappings.Status` of each point: (rows, columns) uint8, or from a shader RG8UI with the number of
            iterations in the second channel.
        view_tangents: RG32F, (tx, ty) of the view direction in the device frame, NaN where there is none; None if the
            rays were solved on the CPU.
    """

    context: gl.GlContext
    viewpoint_in_device: FloatArray
    device_from_camera: FloatArray
    status: gl.Texture | StatusArray
    view_tangents: gl.Texture | None = None

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
            return np.ascontiguousarray(gl.read(self.status, np.uint8)[..., 0])

    def read_iterations(self) -> NDArray[np.uint8]:
        """Fetch the iterations of a shader, (rows, columns)."""
        assert not isinstance(self.status, np.ndarray), "these rays were solved on the CPU"
        with self.context.drawing():
            return np.asarray(gl.read(self.status, np.uint8)[..., 1])


MAX_ITERATIONS = 12
"""From either start; a regular solve takes two from cold."""
LAST_STEP_M = 3e-6
"""A Newton step in the base plane that ends the solve: t follows its slope over it to 1e-4 arcmin, for slopes that
change by less than 6 rad/m in a millimetre; and a thousand times what float32 leaves of a step."""

DROPPED = 0.002 * ARCMIN
"""Terms of a polynomial are dropped while they change no direction by more, in each of the display's tangents, A and
B / NEAREST_M: a fifteenth of the best fits' error (0.03'), and no more than float32 loses."""


@dataclass(frozen=True, eq=False)
class _Solution:
    """View tangents and their derivatives by the viewpoint's xy, with their framebuffer."""

    tangents: gl.Texture
    slopes: gl.Texture
    framebuffer: gl.Framebuffer


class GlPlanarSolver:
    """`RayMapSolver` of one eye's planar models, in a shader compiled for its models.

    Attributes:
        dropped_arcmin: bounds what dropped terms of the polynomials change in a world ray within the fit, to NEAREST_M.
    """

    def __init__(
        self,
        context: gl.GlContext,
        mappings: EyeMappings,
        warp_grid: WarpGrid,
        device_from_camera: FloatArray,
    ) -> None:
        """Prepare for the points of a warp grid on the mappings' panel, and for tangents in these axes (3, 3).

        Raises:
            BadInputError: the mappings are not planar models.
        """
        self._display, self._see_through = require_planar(mappings)
        self._context, self._warp_grid, self._device_from_camera = context, warp_grid, device_from_camera
        display = thinned(self._display.forward, np.full(2, DROPPED))
        deviation = thinned(self._see_through.deviation, DROPPED * np.array([1.0, 1.0, NEAREST_M, NEAREST_M]))
        parts = display.bound, deviation.bound[:2], deviation.bound[2:] / NEAREST_M
        self.dropped_arcmin = float(sum(np.linalg.norm(part) for part in parts)) / ARCMIN
        functions = held_source("display", display.polynomial) + value_source("deviation", deviation.polynomial)
        constants: dict[str, float] = {status.name: int(status) for status in Status}
        constants |= {"MAX_ITERATIONS": MAX_ITERATIONS, "LAST_STEP_M": LAST_STEP_M}
        with context.drawing():
            self._solve = context.full_screen("solve.frag", "full_screen.vert", functions, **constants)
            self._slope_offset = context.target(warp_grid.size, 4, "f4")
            gl.read_between_texels(self._slope_offset)
            self._status_and_iterations = context.target(warp_grid.size, 2, "u1")
            # The shader reads one while it writes the other.
            self._new, self._last = (self._solution() for _ in range(2))
        self._last_viewpoint: FloatArray | None = None

    def _moved(self, viewpoint: FloatArray, started_from: FloatArray | None) -> tuple[float, ...]:
        """Since the last frame: the viewpoint's x and y, and its height over the display's base plane."""
        if started_from is None:
            return 0.0, 0.0, 0.0
        plane = self._display.base_plane
        return *(viewpoint - started_from)[:2], float(plane.depth_of(started_from) - plane.depth_of(viewpoint))

    def _solution(self) -> _Solution:
        tangents = self._context.target(self._warp_grid.size, 2, "f4")
        slopes = self._context.target(self._warp_grid.size, 4, "f2")  # only a start comes of them
        textures = [self._slope_offset, tangents, self._status_and_iterations, slopes]
        return _Solution(tangents, slopes, self._context.framebuffer(textures))

    def solve(self, viewpoint: FloatArray) -> GpuRayMap:
        """See `RayMapSolver.solve`."""
        viewpoint = checked_viewpoint(viewpoint)
        inside = all(
            box.contains(viewpoint, EYE_BOX_MARGIN) for box in (self._display.eye_box, self._see_through.eye_box)
        )
        self._new, self._last = self._last, self._new
        started_from, self._last_viewpoint = self._last_viewpoint, None  # after a failure there is no start
        with self._context.drawing():
            self._new.framebuffer.use()
            last = {"last_view_tangents": self._last.tangents, "last_slopes": self._last.slopes}
            gl.bind_textures(self._solve.program, **last)
            self._set_uniforms(viewpoint, started_from, inside)
            self._solve.render(vertices=3)
        # Extrapolated from outside the eye box, it may be another root of the polynomials: no start for a next frame.
        self._last_viewpoint = viewpoint if inside else None
        return GpuRayMap(
            self._warp_grid,
            self._slope_offset,
            self._context,
            viewpoint,
            self._device_from_camera,
            self._status_and_iterations,
            self._new.tangents,
        )

    def _set_uniforms(self, viewpoint: FloatArray, started_from: FloatArray | None, inside: bool) -> None:
        display, see_through, program = self._display, self._see_through, self._solve.program
        gl.set_uniforms(
            program,
            has_last=started_from is not None,
            moved=self._moved(viewpoint, started_from),
            first_px=tuple(self._warp_grid.first_px),
            step_px=tuple(self._warp_grid.step_px),
            viewpoint=tuple(viewpoint),
            behind_display_plane=-float(display.base_plane.depth_of(viewpoint)),
            behind_see_through_plane=-float(see_through.base_plane.depth_of(viewpoint)),
            display_plane_slope=display.base_plane.slope,
            see_through_plane_slope=see_through.base_plane.slope,
            viewpoint_inside=inside,
        )
        gl.set_matrix(program, "camera_from_device", self._device_from_camera.T)

    def forget(self) -> None:
        """Start the next solve cold."""
        self._last_viewpoint = None


class GlNodeSolver:
    """`RayMapSolver` for any mappings from Chebyshev nodes; the plan states warp grid and axes."""

    def __init__(self, context: gl.GlContext, mappings: EyeMappings, plan: RayMapPlan) -> None:
        self._context, self._plan = context, plan
        self._nodes = CpuNodeSolver(mappings, plan)
        columns, rows = plan.warp_grid.size
        self._interleaved = np.empty((rows, columns, 4), np.float32)
        with context.drawing():
            self._slope_offset = context.target(plan.warp_grid.size, 4, "f4")
            gl.read_between_texels(self._slope_offset)

    def solve(self, viewpoint: FloatArray) -> GpuRayMap:
        """See `RayMapSolver`."""
        solved = self._nodes.solve(viewpoint)
        # One texture of four components costs a shader much less to read than four textures.
        with self._context.drawing():
            self._slope_offset.write(cv2.merge(list(solved.slope_offset), self._interleaved))
        return GpuRayMap(
            self._plan.warp_grid,
            self._slope_offset,
            self._context,
            solved.viewpoint_in_device,
            solved.device_from_camera,
            solved.status,
        )

    def forget(self) -> None:
        """Start the next solve cold."""
        self._nodes.forget()

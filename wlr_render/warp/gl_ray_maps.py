"""Ray maps on the GPU: planar models are solved in a shader, other models interpolated from nodes solved on the CPU.

For each point of the warp grid, the shader solves p~ = viewpoint_xy + s t(pixel, p~) for the tangents t at which the
viewpoint sees it, by Newton's method in float32. On a plane of slope m the depth s is
h / (1 + m . t), with h the viewpoint's height over the plane along z. A solve starts from the viewpoint, not from the
last frame: a warp grid has so few points that the two or three iterations do not affect a frame's time.

A pixel has one ray through each point of a base plane. At a pixel, therefore, the tangents t are a polynomial of p~
alone, and the deviation (A, B) is a smooth function of the place on its own plane. A texture holds the coefficients of
both for each point of the warp grid, computed once in float64: one program serves all eyes and calibrations.
"""

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.polynomial import polyvander2d

from wlr_render.gl import gl
from wlr_render.mappings import EYE_BOX_MARGIN, Eye, PlanarModel, Status, StatusArray, require_planar
from wlr_render.numerics.arrays import Float32Array, FloatArray
from wlr_render.numerics.polynomial import SCALED_LIMIT, Box
from wlr_render.warp.grid import WarpGrid
from wlr_render.warp.ray_map import FilledRayMaps, RayMap, RayMapPlan, checked_viewpoint


@dataclass(frozen=True, eq=False)
class RayTexture:
    """World rays at the points of a warp grid.

    Attributes:
        warp_grid: the warp grid, from edge to edge of the panel.
        slope_offset: RGBA32F of the warp grid's size, (a, b, c, d) as in `RayMap.slope_offset`, NaN without a ray.
    """

    warp_grid: WarpGrid
    slope_offset: gl.Texture


@dataclass(frozen=True, eq=False)
class GpuRayMap(RayTexture):
    """The ray map of one viewpoint, in textures that the solver's next solve overwrites.

    Attributes:
        context: context of the textures.
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
        """Fetch `slope_offset` as (4, rows, columns)."""
        with self.context.drawing():
            return np.ascontiguousarray(np.moveaxis(gl.read(self.slope_offset, np.float32), -1, 0))

    def read_status(self) -> StatusArray:
        """Fetch the status (rows, columns), one `mappings.Status` each."""
        if isinstance(self.status, np.ndarray):
            return self.status
        with self.context.drawing():
            return gl.read(self.status, np.uint8)


MAX_ITERATIONS = 12
"""Largest number of iterations; a regular solve takes two or three."""
LAST_STEP_M = 3e-6
"""Newton step in the base plane that ends the solve: over it t is linear to 1e-4 arcmin, for slopes that change by less
than 6 rad/m in a millimetre; and it is a thousand times the float32 rounding of a step."""

DEGREE = 5
"""Lowest total degree of a point's polynomials: display models have this degree in the base-plane position.
Interpolated deviations of the shipped devices' models then err by 0.0015 arcmin; degree 6 errs by 0.0002, with a third
more texels."""

_STEPS = 6  # fixed-point steps between base planes a few mm from each other: each leaves a tenth of the error or less


class GlPlanarSolver:
    """`RayMapSolver` of one eye's planar models, in a shader."""

    def __init__(
        self,
        context: gl.GlContext,
        mappings: Eye,
        warp_grid: WarpGrid,
        device_from_camera: FloatArray,
    ) -> None:
        """Prepare for the points of a warp grid on the mappings' panel, and for tangents in the given axes (3, 3).

        Raises:
            BadInputError: the mappings are not planar models.
        """
        self._display, self._see_through = require_planar(mappings)
        self._context, self._warp_grid, self._device_from_camera = context, warp_grid, device_from_camera
        orders = self._display.modelled.orders[:, 2:], self._see_through.modelled.orders[:, :2]
        of_display, of_see_through = (int(each.sum(axis=1).max(initial=0)) for each in orders)
        # One degree more for the deviation: it also depends on the tangents, which vary with the position.
        self._degree = max(DEGREE, of_display, of_see_through + 1)
        terms = planar_terms(self._display, self._see_through, warp_grid, self._degree)
        constants: dict[str, float] = {status.name: int(status) for status in Status}
        constants |= {"MAX_ITERATIONS": MAX_ITERATIONS, "LAST_STEP_M": LAST_STEP_M, "SCALED_LIMIT": SCALED_LIMIT}
        constants |= {"DEGREE": self._degree, "TEXELS": terms.shape[3]}
        with context.drawing():
            self._solve = gl.Pass(context, "solve.frag", **constants)
            self._target = gl.RenderTargets(context).get("rays", warp_grid.size, (4, "f4"), (1, "u1"))
            self._texture = context.target((terms.shape[2] * terms.shape[3], 3 * warp_grid.rows), 4, "f4")
            self._texture.write(terms)
        self._inputs_of_eye = self._fixed_inputs()
        models = self._display, self._see_through
        self._box_centres = np.array([model.eye_box.centre for model in models])
        self._box_reach = np.array([0.5 * model.eye_box.size + EYE_BOX_MARGIN for model in models])
        # The viewpoint's height over a plane is the product of a row with (x, y, z, 1).
        self._heights = np.array([[*-np.array(model.place.slope), 1.0, -model.place.z] for model in models])

    def solve(self, viewpoint: FloatArray) -> GpuRayMap:
        """Solve a ray map in the shader; see `RayMapSolver.solve`."""
        viewpoint = checked_viewpoint(viewpoint)
        with self._context.drawing():
            inputs = gl.floats(self._inputs(viewpoint))
            self._solve.fill(self._target, {"terms": self._texture}, inputs_of_eye=inputs)
        slope_offset, status = self._target.textures
        return GpuRayMap(self._warp_grid, slope_offset, self._context, viewpoint, self._device_from_camera, status)

    def _fixed_inputs(self) -> FloatArray:
        """Return the rows (11, 4) of the shader's `inputs_of_eye`; rows 6 and 7, the viewpoint's, are left at 0."""
        display, see_through, grid = self._display, self._see_through, self._warp_grid
        boxes = [model.modelled.box for model in (display, see_through)]
        rows = np.zeros((11, 4))
        rows[:4] = [row for box in boxes for row in (0.5 * (box.low + box.high), box.per_unit)]
        rows[4] = *grid.first_px, *grid.step_px
        rows[5] = *display.place.slope, *see_through.place.slope
        rows[8:, :3] = self._device_from_camera.T
        return rows

    def _inputs(self, viewpoint: FloatArray) -> FloatArray:
        rows = self._inputs_of_eye
        rows[6, :3], rows[6, 3] = viewpoint, (np.abs(viewpoint - self._box_centres) <= self._box_reach).all()
        rows[7, :2] = self._heights[:, :3] @ viewpoint + self._heights[:, 3]
        return rows


def planar_terms(display: PlanarModel, see_through: PlanarModel, warp_grid: WarpGrid, degree: int) -> Float32Array:
    """Return the coefficients of t, A and B at each point: (rows, 3, columns, texels of two terms each, 4)."""
    box, pixel = display.modelled.box.select((2, 3)), warp_grid.panel_pixel()
    held = display.modelled.held((0, 1), pixel.reshape(-1, 2))
    nodes, solve = _interpolation(box, degree)
    shown = [held(np.broadcast_to(node, (pixel.size // 2, 2))).reshape(pixel.shape) for node in nodes]
    tangents = solve @ np.stack(shown, axis=-2)

    def deviation(node: FloatArray) -> FloatArray:
        # Tangents of the rays through the node: the terms continue smoothly beyond the display's box.
        place, point = node, see_through.place.lift(node)
        for _ in range(1 if display.place == see_through.place else _STEPS):
            seen = np.einsum("...n,...no->...o", _products(box.scaled(place), degree), tangents)
            place = display.place.carry(point, seen)
        return see_through.modelled(np.concatenate([np.broadcast_to(node, seen.shape), seen], axis=-1))

    nodes, solve = _interpolation(see_through.modelled.box.select((0, 1)), degree)
    deviations = solve @ np.stack([deviation(node) for node in nodes], axis=-2)
    terms = np.concatenate([tangents, deviations], axis=-1, dtype=np.float32)
    # Two terms share a texel; t, A and B of a row of points fill one row of texels each.
    paired = np.moveaxis(terms.reshape(*pixel.shape[:2], -1, 2, 3, 2), 4, 1)
    return np.ascontiguousarray(paired).reshape(*paired.shape[:4], 4)


def _interpolation(box: Box, degree: int) -> tuple[FloatArray, FloatArray]:
    """Return Padua points (n, 2) of a box, and the matrix (terms, n) from values there to coefficients of `_products`.

    Padua points are Chebyshev points for a total degree: interpolation is hardly worse than the best polynomial.
    """
    along = itertools.product(range(degree + 1), range(degree + 2))
    scaled = np.cos(np.pi * np.array([(i / degree, j / (degree + 1)) for i, j in along if (i + j) % 2 == 0]))
    used = np.sum(_powers(degree), axis=1) <= degree
    solve = np.zeros((len(used), len(scaled)))
    solve[used] = np.linalg.inv(_products(scaled, degree)[:, used])
    return 0.5 * (box.low + box.high) + scaled / box.per_unit, solve


def _products(scaled: FloatArray, degree: int) -> FloatArray:
    """Return the terms x^i y^j of `_powers` at scaled places (..., 2): (..., terms)."""
    products = polyvander2d(scaled[..., 0], scaled[..., 1], [degree, degree + 1])
    return np.asarray(products[..., [i * (degree + 2) + j for i, j in _powers(degree)]])


def _powers(degree: int) -> list[tuple[int, int]]:
    """Return i and j of the terms in the order of solve.frag, which reads two terms at once; some exceed the degree."""
    return [(i, j) for i in reversed(range(degree + 1)) for j in reversed(range((degree - i | 1) + 1))]


class GlNodeSolver:
    """`RayMapSolver` for any mappings from Chebyshev nodes; the plan defines warp grid and axes."""

    def __init__(self, context: gl.GlContext, mappings: Eye, plan: RayMapPlan) -> None:
        """Prepare, and query every point once to find where the device shows nothing."""
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

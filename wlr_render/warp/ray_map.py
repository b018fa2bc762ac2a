"""The world ray of every display pixel at one viewpoint: display forward, then see-through forward.

The ray map is smooth in the pixel, so it is solved exactly on a tensor grid of Chebyshev nodes and interpolated at the
points of a warp grid, usually all pixels, by two thin matrix products per component. `choose_plan` finds the number of
nodes from a measured error; `solve_every_pixel` is the slow plain version, which solves every pixel.
"""

from dataclasses import dataclass, replace
from typing import Protocol, TypeVar

import numpy as np

from wlr_render.geometry import directions, rays, transforms
from wlr_render.mappings import Eye, Panel, Status, StatusArray, worst_status
from wlr_render.numerics import chebyshev
from wlr_render.numerics.arrays import Float32Array, FloatArray, finite_array
from wlr_render.numerics.polynomial import Box, basis, total_degree
from wlr_render.warp.grid import WarpGrid

NODE_COUNTS = (9, 13, 17, 21, 25, 33, 41, 49)
_ROWS_PER_BLOCK = 64
_GRID = 33
_EXTRAPOLATED = 0.25  # weight of errors outside the fitted box
NEAREST_M = 0.25
"""Nearest distance at which the ray map's error is judged; the nearer the scene, the more a ray's offset matters."""


@dataclass(frozen=True, eq=False)
class RayMapPlan:
    """Interpolation from Chebyshev nodes to the points of a warp grid; computed once per panel.

    Attributes:
        device_from_camera: (3, 3) rotation from the axes of the tangents. These look at the middle of the field of
            view, so that a field of view far off the device's axis is not stretched.
        warp_grid: the points where rays are computed.
        node_pixel: (rows, columns, 2) pixel positions of the nodes.
        from_rows: (warp grid rows, rows) float32, node rows -> warp grid rows.
        from_columns: (columns, warp grid columns) float32, node columns -> warp grid columns.
    """

    device_from_camera: FloatArray
    warp_grid: WarpGrid
    node_pixel: FloatArray
    from_rows: Float32Array
    from_columns: Float32Array

    @classmethod
    def with_nodes(
        cls, panel: Panel, count: int, device_from_camera: FloatArray, offset_px: FloatArray | None = None
    ) -> "RayMapPlan":
        """Return a plan of count x count nodes for all pixels; `offset_px` (2,) moves them (for supersampling)."""
        pixels = WarpGrid.of_pixels(panel)
        if offset_px is not None:
            pixels = replace(pixels, first_px=pixels.first_px + offset_px)
        return cls.onto_grid(pixels, count, device_from_camera)

    @classmethod
    def onto_grid(cls, warp_grid: WarpGrid, count: int, device_from_camera: FloatArray) -> "RayMapPlan":
        """Return a plan of count x count nodes for the points of a warp grid."""
        panel, (u, v) = warp_grid.panel, warp_grid.axes_px()
        columns = chebyshev.interpolation_matrix(count, 0, panel.width_px, u)
        rows = chebyshev.interpolation_matrix(count, 0, panel.height_px, v)
        nodes = chebyshev.nodes(count, 0, panel.width_px), chebyshev.nodes(count, 0, panel.height_px)
        node_pixel = np.stack(np.meshgrid(*nodes), axis=-1)
        from_columns = np.ascontiguousarray(columns.T, dtype=np.float32)
        return cls(device_from_camera, warp_grid, node_pixel, rows.astype(np.float32), from_columns)

    @property
    def panel(self) -> Panel:
        """The panel these rays belong to."""
        return self.warp_grid.panel

    @property
    def node_count(self) -> int:
        """Number of nodes along each axis."""
        return len(self.node_pixel)


@dataclass(frozen=True, eq=False)
class WarmStart:
    """Solutions at the nodes, for the next frame with the same plan."""

    display: FloatArray | None
    see_through: FloatArray | None


@dataclass(frozen=True, eq=False)
class RayMap:
    """World rays of all points of a warp grid, usually the pixels, in a camera frame with its origin at the viewpoint.

    Attributes:
        viewpoint_in_device: (3,) metres.
        device_from_camera: (3, 3) rotation of the camera frame.
        slope_offset: (4, height, width) float32, (a, b, c, d): the ray passes through (c, d, 0) with tangents (a, b);
            at depth Z in front of the viewpoint it is at (a Z + c, b Z + d, -Z). NaN where the status has no value.
        status: (height, width) uint8, see `mappings.Status`.
        warm_start: start for the next frame.
    """

    viewpoint_in_device: FloatArray
    device_from_camera: FloatArray
    slope_offset: Float32Array
    status: StatusArray
    warm_start: WarmStart | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width)."""
        return self.slope_offset.shape[1], self.slope_offset.shape[2]

    def world_rays(self, world_from_device: FloatArray, rows: slice = slice(None)) -> tuple[Float32Array, Float32Array]:
        """Return the rays of some rows in the world: origins and unit directions, each (rows * width, 3) float32.

        An origin is the point where the straight continuation of the bent ray passes near the viewpoint; NaN where the
        ray map has no value. With `status`, they are a frame's primary rays for other renderers.
        """
        a, b, c, d = self.slope_offset[:, rows].reshape(4, -1)
        # Unpacked rows of the rotation keep this in float32 and avoid (n, 3) temporaries.
        r = (world_from_device[:3, :3] @ self.device_from_camera).astype(np.float32)
        eye = transforms.apply(world_from_device, self.viewpoint_in_device).astype(np.float32)
        scale = 1.0 / np.sqrt(a * a + b * b + 1.0)
        origin, direction = np.empty((a.size, 3), np.float32), np.empty((a.size, 3), np.float32)
        for axis in range(3):
            origin[:, axis] = eye[axis] + r[axis, 0] * c + r[axis, 1] * d
            direction[:, axis] = (r[axis, 0] * a + r[axis, 1] * b - r[axis, 2]) * scale
        return origin, direction


@dataclass(frozen=True, eq=False)
class SolvedRays:
    """Exact solutions at some pixels: `slope_offset` (..., 4), see `RayMap.slope_offset`, and `status` (...)."""

    slope_offset: FloatArray
    status: StatusArray
    warm_start: WarmStart


SolvedT = TypeVar("SolvedT", covariant=True)
"""`RayMap`, or `gl_ray_maps.GpuRayMap`."""


class RayMapSolver(Protocol[SolvedT]):
    """Solves the rays of a warp grid for successive viewpoints."""

    def solve(self, viewpoint: FloatArray) -> SolvedT:
        """Return the ray map at a viewpoint (3,), device frame, metres; on the GPU the next solve overwrites it.

        Raises:
            BadInputError: the viewpoint is not three finite numbers; the last solution is kept.
        """


def checked_viewpoint(viewpoint: FloatArray) -> FloatArray:
    """Return a copy of the viewpoint as (3,) float64.

    Raises:
        BadInputError: it is not three finite numbers.
    """
    return finite_array(
        viewpoint,
        (3,),
        "the viewpoint",
        "three finite numbers, the eye's place in the device frame in metres, and hold the last good ones while the "
        "eye is not seen",
    )


def solve_pixels(
    mappings: Eye,
    device_from_camera: FloatArray,
    pixel: FloatArray,
    viewpoint: FloatArray,
    warm_start: WarmStart | None = None,
) -> SolvedRays:
    """Query the mappings at pixels (..., 2) for one viewpoint (3,), in axes (3, 3).

    A pixel without a direction keeps the display's status.
    """
    warm_start = warm_start or WarmStart(None, None)
    view = mappings.display.view_dir_of_pixel(pixel, viewpoint, warm_start.display)
    real = mappings.see_through.real_ray_of_view_dir(view.value, viewpoint, warm_start.see_through)
    status = np.where(view.usable, worst_status(view.status, real.status), view.status)
    in_camera = rays.transformed(transforms.inverse(transforms.rigid(device_from_camera, viewpoint)), real.value)
    at_viewpoint = rays.at_z(in_camera, 0.0)
    slope_offset = np.concatenate([directions.tangents_of_dir(at_viewpoint[..., 3:]), at_viewpoint[..., :2]], axis=-1)
    # A ray that does not point forwards has no tangents, and shows nothing.
    lost = ~np.isfinite(slope_offset).all(axis=-1)
    slope_offset = np.where(lost[..., None], np.nan, slope_offset)
    status = np.where(lost & (status <= Status.OUTSIDE_FIT), Status.MISS, status).astype(np.uint8)
    return SolvedRays(slope_offset, status, WarmStart(view.warm_start, real.warm_start))


def solve_every_pixel(
    mappings: Eye, viewpoint: FloatArray, device_from_camera: FloatArray, pixel: FloatArray | None = None
) -> RayMap:
    """Solve every pixel, which takes minutes: as a reference, or for nodes with holes.

    Args:
        mappings: any display and see-through mappings.
        viewpoint: (3,) device frame.
        device_from_camera: (3, 3) axes of the tangents.
        pixel: (height, width, 2), all pixel centres if None.
    """
    pixel = mappings.display.panel.pixel_centres() if pixel is None else pixel
    height, width = pixel.shape[:2]
    slope_offset = np.empty((4, height, width), np.float32)
    status = np.empty((height, width), np.uint8)
    for start in range(0, height, _ROWS_PER_BLOCK):
        rows = slice(start, start + _ROWS_PER_BLOCK)
        solved = solve_pixels(mappings, device_from_camera, pixel[rows], viewpoint)
        slope_offset[:, rows] = np.moveaxis(solved.slope_offset, -1, 0)
        status[rows] = solved.status
    return RayMap(viewpoint, device_from_camera, slope_offset, status)


def ray_map(mappings: Eye, viewpoint: FloatArray, plan: RayMapPlan, warm_start: WarmStart | None = None) -> RayMap:
    """Return the ray map of a viewpoint, interpolated between the Chebyshev nodes of `plan`.

    If a node has no answer, the polynomial through the nodes is meaningless, and every warp grid point is solved.

    Args:
        mappings: any display and see-through mappings, with the plan's panel.
        viewpoint: (3,) device frame.
        plan: from `choose_plan`.
        warm_start: warm start of the last frame's ray map with this plan.
    """
    axes = plan.device_from_camera
    solved = solve_pixels(mappings, axes, plan.node_pixel, viewpoint, warm_start)
    if not np.isfinite(solved.slope_offset).all():
        exact = solve_every_pixel(mappings, viewpoint, axes, plan.warp_grid.panel_pixel())
        return replace(exact, warm_start=solved.warm_start)
    status = _spread_status(plan, solved.status)
    return RayMap(viewpoint, axes, _spread(plan, solved.slope_offset), status, solved.warm_start)


_FILL_DEGREE = 4
_KNOWN_PER_TERM = 2


class FilledRayMaps:
    """Ray maps of one plan in bounded time: nodes without a ray are filled from the other nodes.

    A map is the exact map at the eye box's centre, solved once at every point, plus the interpolated change of the
    nodes from there. The change is smooth: where a node has no ray, here or at the centre, a polynomial of degree 4 is
    fitted to the other nodes' changes; with too few nodes the last map's change is used. Points without a ray at the
    centre have none in any map.
    """

    def __init__(self, mappings: Eye, plan: RayMapPlan) -> None:
        """Query every point of the warp grid and every node; the plan must be for the mappings' panel."""
        self._mappings, self._plan = mappings, plan
        centre, axes = mappings.eye_box.centre, plan.device_from_camera
        self._base = solve_every_pixel(mappings, centre, axes, plan.warp_grid.panel_pixel())
        nodes = solve_pixels(mappings, axes, plan.node_pixel, centre)
        self._base_nodes, self._warm_start = nodes.slope_offset, nodes.warm_start
        scaled = (plan.node_pixel / plan.panel.size_px * 2 - 1).reshape(-1, 2)
        self._terms = basis(scaled, total_degree(2, _FILL_DEGREE), Box(-np.ones(2), np.ones(2)))
        self._last_change = np.zeros_like(self._base_nodes)

    def at(self, viewpoint: FloatArray) -> RayMap:
        """Return the ray map of a viewpoint (3,); points around filled nodes have the nodes' status."""
        plan, base = self._plan, self._base
        solved = solve_pixels(self._mappings, plan.device_from_camera, plan.node_pixel, viewpoint, self._warm_start)
        self._last_change = self._filled(solved.slope_offset - self._base_nodes)
        slope_offset = base.slope_offset + _spread(plan, self._last_change)
        known_at_centre = np.isfinite(base.slope_offset).all(axis=0)
        status = np.where(known_at_centre, _spread_status(plan, solved.status), base.status)
        return RayMap(viewpoint, plan.device_from_camera, slope_offset, status.astype(np.uint8))

    def _filled(self, change: FloatArray) -> FloatArray:
        """Return changes (rows, columns, 4) at the nodes with NaN filled in."""
        flat = change.reshape(-1, 4)
        known = np.asarray(np.isfinite(flat).all(axis=-1))
        if known.all():
            return change
        if known.sum() < _KNOWN_PER_TERM * self._terms.shape[1]:
            return np.where(known[:, None], flat, self._last_change.reshape(-1, 4)).reshape(change.shape)
        coefficients, *_ = np.linalg.lstsq(self._terms[known], flat[known])
        return np.asarray(np.where(known[:, None], flat, self._terms @ coefficients).reshape(change.shape))


def _spread(plan: RayMapPlan, at_nodes: FloatArray) -> Float32Array:
    """Interpolate values (rows, columns, k) at the nodes to (k, rows, columns) at the warp grid's points."""
    components = np.moveaxis(at_nodes, -1, 0).astype(np.float32)
    return np.asarray(np.matmul(plan.from_rows @ components, plan.from_columns))


def _spread_status(plan: RayMapPlan, at_nodes: StatusArray) -> StatusArray:
    """Return the status of each point, the worst status of the nodes around it."""
    columns, rows = plan.warp_grid.size
    if not at_nodes.any():
        return np.zeros((rows, columns), np.uint8)
    last, (u, v) = plan.node_count - 1, plan.warp_grid.axes_px()
    row, column = np.searchsorted(plan.node_pixel[:, 0, 1], v), np.searchsorted(plan.node_pixel[0, :, 0], u)
    below, above = np.maximum(row - 1, 0), np.minimum(row, last)
    left, right = np.maximum(column - 1, 0), np.minimum(column, last)
    across = np.maximum(at_nodes[:, left], at_nodes[:, right])
    return np.asarray(np.maximum(across[below], across[above]))


def ray_map_error_px(mappings: Eye, viewpoint: FloatArray, plan: RayMapPlan, pixel: FloatArray) -> FloatArray:
    """Return the error of the interpolated ray map at some pixels, relative to the exact solve, in display pixels.

    Args:
        mappings: any display and see-through mappings.
        viewpoint: (3,) device frame.
        plan: plan with the number of nodes to be judged.
        pixel: (n, 2) anywhere on the panel.

    Returns:
        (n,) error at infinity plus error of the offset at the nearest depth, over the size of a pixel there;
        NaN where the exact solve has no answer.
    """
    count, panel = plan.node_count, plan.panel
    axes = plan.device_from_camera
    nodes = solve_pixels(mappings, axes, plan.node_pixel, viewpoint).slope_offset
    across = chebyshev.interpolation_matrix(count, 0, panel.width_px, pixel[:, 0])
    down = chebyshev.interpolation_matrix(count, 0, panel.height_px, pixel[:, 1])
    interpolated = np.einsum("nr,rck,nc->nk", down, nodes, across)
    apart = _neighbour_px(panel)
    exact, left, upper = (
        solve_pixels(mappings, axes, pixel - step, viewpoint).slope_offset
        for step in ([0.0, 0.0], [apart[0], 0.0], [0.0, apart[1]])
    )
    pixel_size = np.minimum(
        np.linalg.norm((left - exact)[:, :2], axis=1) / apart[0],
        np.linalg.norm((upper - exact)[:, :2], axis=1) / apart[1],
    )
    error = interpolated - exact
    return np.asarray(
        (np.linalg.norm(error[:, :2], axis=1) + np.linalg.norm(error[:, 2:], axis=1) / NEAREST_M) / pixel_size
    )


def _neighbour_px(panel: Panel) -> FloatArray:
    """Return the steps (2,) in u and v for measuring the size of a pixel: less than 1 on a panel of one pixel."""
    return np.minimum(1.0, 0.5 * panel.size_px)


def choose_plan(mappings: Eye, tolerance_px: float = 0.005) -> RayMapPlan:
    """Return the plan with the fewest nodes that keep the ray map within `tolerance_px` over the eye box.

    The error is judged at the centre and two corners of the eye box, at 150 fixed pseudo-random pixels and the panel's
    corners, where polynomial interpolation is worst. If no count reaches the tolerance, the largest is used: a map with
    kinks cannot be interpolated, and `ray_map_error_px` returns its error.
    """
    panel, box = mappings.display.panel, mappings.eye_box
    rng = np.random.default_rng(20250102)
    low, high = _neighbour_px(panel), panel.size_px - 0.5
    corners = np.array([[u, v] for u in (low[0], high[0]) for v in (low[1], high[1])])
    pixel = np.concatenate([rng.uniform(low, high, (150, 2)), corners])
    viewpoints = [box.centre, box.at(np.array([1.0, 1.0, 1.0])), box.at(np.array([-1.0, -1.0, -1.0]))]
    axes = middle_axes(mappings)
    for count in NODE_COUNTS:
        plan = RayMapPlan.with_nodes(panel, count, axes)
        if all(_worst_px(mappings, v, plan, pixel) <= tolerance_px for v in viewpoints):
            return plan
    return plan


def _worst_px(mappings: Eye, viewpoint: FloatArray, plan: RayMapPlan, pixel: FloatArray) -> float:
    """Return the largest known error at pixels (n, 2); infinity if no error is known, because a node has no answer.

    Extrapolated values have less weight: models bend at the border of their fit, which would cost many nodes.
    """
    error_px = ray_map_error_px(mappings, viewpoint, plan, pixel)
    outside = solve_pixels(mappings, plan.device_from_camera, pixel, viewpoint).status == Status.OUTSIDE_FIT
    error_px = np.where(outside, _EXTRAPOLATED * error_px, error_px)
    known = error_px[np.isfinite(error_px)]
    return float(known.max()) if known.size else np.inf


def required_tangents(mappings: Eye, device_from_camera: FloatArray, viewpoint: FloatArray) -> FloatArray:
    """Return the view tangents (n, 2) of the rays' points at infinity and at the nearest depth, from one viewpoint.

    A raster camera must cover them. The pixels are a grid that reaches the panel's borders; NaN without a ray.
    """
    panel = mappings.display.panel
    u, v = (np.linspace(0.5, size - 0.5, _GRID) for size in (panel.width_px, panel.height_px))
    slope_offset = solve_pixels(
        mappings, device_from_camera, np.stack(np.meshgrid(u, v), axis=-1), viewpoint
    ).slope_offset.reshape(-1, 4)
    return np.concatenate([slope_offset[:, :2], slope_offset[:, :2] + slope_offset[:, 2:] / NEAREST_M])


def middle_axes(mappings: Eye) -> FloatArray:
    """Return axes `device_from_camera` (3, 3) that look at the middle of the field of view from the eye box's centre.

    They are turned about the device's vertical, then nodded, never rolled; the device's axes if the panel is not seen.
    """
    panel = mappings.display.panel
    view = mappings.display.view_dir_of_pixel(panel.grid(9, 9).reshape(-1, 2), mappings.eye_box.centre)
    seen = view.value[view.usable]
    if len(seen) == 0:
        return np.eye(3)
    x, y, z = 0.5 * (seen.min(axis=0) + seen.max(axis=0))
    turn, nod = np.arctan2(-x, -z), np.arctan2(y, np.hypot(x, z))
    return np.asarray(transforms.rotation_about("y", turn) @ transforms.rotation_about("x", nod))

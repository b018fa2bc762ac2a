"""The warp of an eye as arrays, for renderers that a `Compositor` cannot serve: Vulkan, Direct3D, WebGPU, engines.

The arrays go with a shader: `shaders/own_warp.glsl` and `shaders/own_warp.wgsl` are complete ones. Nothing here needs
OpenGL.
"""

import typing
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import Float32Array, FloatArray
from wlr_render.warp.checks import (
    check_camera_size,
    checked_choice,
    checked_models,
    checked_number,
    checked_pose,
    checked_size,
    checked_viewpoints,
)
from wlr_render.warp.choose_grid import TOLERANCE_ARCMIN, ray_error_arcmin
from wlr_render.warp.eye_camera import EyeCamera
from wlr_render.warp.grid import WarpGrid
from wlr_render.warp.raster_camera import EyePlan, RasterPlace
from wlr_render.warp.ray_map import FilledRayMaps, RayMap, RayMapPlan, choose_plan, ray_map, solve_pixels
from wlr_render.warp.view import image_from_ray_map

_COARSEST_CELLS = 8
_JUDGED_CELLS = 24
_JUDGED_VIEWPOINTS = np.array([[0, 0, 0], [1, 1, 1], [-1, -1, 1], [-1, 1, -1], [1, -1, -1]], dtype=np.float64)
_NODES_TOLERANCE_PX = 0.0005  # small, so that the triangles limit the accuracy, not the nodes
_TRIED_GRIDS = 8
_AIM, _CLOSE = 0.85, 1.1
_SEARCHED = 0.97  # share of the tolerance to reach: maps of frames differ a little from maps of the search
# Vertices of the two triangles of a cell, as (column, row) steps from its upper left point, and where linear
# interpolation errs most: at the middles of the sides, of which the diagonal is the longest, and within.
_TRIANGLES = np.array([[[0, 0], [0, 1], [1, 0]], [[1, 0], [0, 1], [1, 1]]])
_WEIGHTS = np.array([[0, 0.5, 0.5], [0.5, 0.5, 0], [0.5, 0, 0.5], [1 / 3, 1 / 3, 1 / 3]])


class WarpMesh:
    """One eye's panel as a triangle mesh whose vertices hold world rays.

    Inside a triangle rays are linear, and so are the six numbers that the vertex shader makes of them: the mesh's
    error equals the error of the rays, which is measured here.

    Attributes:
        eye: "left" or "right".
        size_px: (width, height) of the eye's display picture.
        panel_position: (n, 2) float32, vertices on the panel: u to the right and v down, 0 to 1 from edge to edge.
        triangles: (m, 3) uint32, indices of vertices; they cover the panel once.
        bound_arcmin: the largest measured error of a ray inside a triangle over the eye box: the error at infinity plus
            the offset's error at 0.25 m.
        samples_per_axis: samples per pixel and axis that the picture needs where the warp minifies it.
    """

    def __init__(
        self,
        models: Eye | Sequence[Eye],
        size: tuple[int, int],
        *,
        resolution: float = 1.0,
        raster_camera: RasterPlace = "nearest",
        late_margin_deg: float = 1.0,
        tolerance_arcmin: float = TOLERANCE_ARCMIN,
    ) -> None:
        """Choose camera and mesh.

        Args:
            models: mappings of one eye, or three for red, green and blue.
            size: (width, height) in pixels of the display picture, which covers the panel.
            resolution: as `Compositor`.
            raster_camera: as `Compositor`.
            late_margin_deg: as `Compositor`.
            tolerance_arcmin: the mesh is the coarsest whose rays are this exact, 0.001 to 10; no finer than a picture's
                pixels.

        Raises:
            BadInputError: models that do not fit together, two eyes, no size, or a number outside its range.
        """
        self._models = checked_models(models)
        if len(self._models) != 1:
            raise BadInputError("a mesh is of one eye, and models of two are given; make one mesh for each eye.")
        (self.eye, self._channels) = next(iter(self._models.items()))
        self.size_px = checked_size(size)
        resolution = checked_number(resolution, "resolution", 0.01, 4)
        margin = float(np.tan(np.deg2rad(checked_number(late_margin_deg, "late_margin_deg", 0, 20))))
        checked_choice(raster_camera, typing.get_args(RasterPlace), "raster_camera")
        tolerance = checked_number(tolerance_arcmin, "tolerance_arcmin", 0.001, 10)
        self._plan = EyePlan.of(self._channels, self.size_px, resolution, raster_camera, margin)
        check_camera_size(self._plan)
        axes = self._plan.device_from_camera
        grids = [mesh_grid(mappings, axes, self.size_px, _SEARCHED * tolerance) for mappings in self._channels]
        grid = min(grids, key=lambda each: float(each.step_px.min()))
        plans = [_plan(mappings, axes, grid) for mappings in self._channels]
        self._ray_maps = [FilledRayMaps(*each) for each in zip(self._channels, plans, strict=True)]
        self.bound_arcmin = max(
            _error_arcmin(mappings, plan, filled.at)
            for mappings, plan, filled in zip(self._channels, plans, self._ray_maps, strict=True)
        )
        self.samples_per_axis = self._plan.samples_per_axis
        self.panel_position = (grid.panel_pixel() / grid.panel.size_px).reshape(-1, 2).astype(np.float32)
        self.triangles = mesh_triangles(grid)

    def camera(self, pose: FloatArray, viewpoint: FloatArray) -> EyeCamera:
        """Return the camera to draw the eye's picture with.

        Args:
            pose: (4, 4) world_from_device.
            viewpoint: (3,) entrance pupil in the device frame, metres.

        Raises:
            BadInputError: an invalid pose or viewpoint, or a viewpoint far outside the eye box.
        """
        return EyeCamera(self.eye, self._plan.view(self._checked(viewpoint), checked_pose(pose)))

    def rays(self, viewpoint: FloatArray) -> Float32Array:
        """World rays of the vertices at a viewpoint (3,): (colours, n, 4) float32.

        A ray is (a, b, c, d), as in `RayMap.slope_offset`: it passes through (c, d, 0) with tangents (a, b), in metres,
        in axes at the viewpoint that `image_from_ray` knows. One colour, or red, green and blue. NaN where a vertex has
        no ray: its triangles show the background. Takes milliseconds.

        Raises:
            BadInputError: an invalid viewpoint, or one far outside the eye box.
        """
        at = self._checked(viewpoint)
        maps = [each.at(at).slope_offset for each in self._ray_maps]
        return np.ascontiguousarray(np.moveaxis(np.stack(maps).reshape(len(maps), 4, -1), 1, 2))

    def image_from_ray(self, camera: EyeCamera, viewpoint: FloatArray, pose: FloatArray) -> Float32Array:
        """(3, 4) float32 rows by which the shader projects rays into a picture.

        They take a point (x, y, z, 1) of the rays' axes to (u depth, v depth, depth) in the picture: pixels, v down
        from the top row, and metres along the camera's -z axis. `project_ray` in `shaders/conventions.glsl` states
        how a ray follows.

        Args:
            camera: that the picture was drawn with, of this frame or of an earlier one.
            viewpoint: (3,) of `rays`.
            pose: (4, 4) newest world_from_device.

        Raises:
            BadInputError: a camera of another eye or mesh, or an invalid pose or viewpoint.
        """
        if not isinstance(camera, EyeCamera) or camera.view.camera is not self._plan.camera:
            raise BadInputError("the camera is not one of this mesh; give what its camera() returned.")
        newest, at = checked_pose(pose), self._checked(viewpoint)
        moved = image_from_ray_map(camera.view, at, self._plan.device_from_camera, newest)
        return np.asarray(camera.view.camera.image_from_camera @ moved, np.float32)

    def _checked(self, viewpoint: FloatArray) -> FloatArray:
        return checked_viewpoints(viewpoint, self._models)[self.eye]


def mesh_triangles(grid: WarpGrid) -> NDArray[np.uint32]:
    """Return the two triangles of each cell, (m, 3) indices of a grid's points, row by row; counter-clockwise."""
    column, row = np.meshgrid(np.arange(grid.columns - 1), np.arange(grid.rows - 1))
    corner = np.stack([column, row], axis=-1).reshape(-1, 1, 1, 2) + _TRIANGLES
    return np.asarray((corner[..., 1] * grid.columns + corner[..., 0]).reshape(-1, 3), np.uint32)


def _plan(mappings: Eye, axes: FloatArray, grid: WarpGrid) -> RayMapPlan:
    return RayMapPlan.onto_grid(grid, _node_count(mappings), axes)


def _node_count(mappings: Eye) -> int:
    return choose_plan(mappings, _NODES_TOLERANCE_PX).node_count


def mesh_grid(mappings: Eye, axes: FloatArray, size_px: tuple[int, int], tolerance_arcmin: float) -> WarpGrid:
    """Return the coarsest grid of square cells whose triangles are within the tolerance; no finer than the picture."""
    panel = mappings.display.panel
    finest_px, coarsest_px = float(np.min(panel.size_px / size_px)), float(np.min(panel.size_px)) / _COARSEST_CELLS
    nodes, cell_px = _node_count(mappings), coarsest_px
    chosen: WarpGrid | None = None
    for _ in range(_TRIED_GRIDS):
        columns, rows = (np.ceil(panel.size_px / cell_px).astype(int) + 1).tolist()
        grid = WarpGrid.edge_to_edge(panel, columns, rows)
        plan = RayMapPlan.onto_grid(grid, nodes, axes)
        error = _error_arcmin(mappings, plan, partial(ray_map, mappings, plan=plan))
        chosen = grid if error <= tolerance_arcmin or chosen is None else chosen
        # The error goes with the square of the cell's size.
        aimed_px = float(np.clip(cell_px * np.sqrt(_AIM * tolerance_arcmin / error), finest_px, coarsest_px))
        if aimed_px == cell_px or (error <= tolerance_arcmin and aimed_px < _CLOSE * cell_px):
            return grid
        cell_px = aimed_px
    assert chosen is not None
    return chosen


def _error_arcmin(mappings: Eye, plan: RayMapPlan, ray_map_at: Callable[[FloatArray], RayMap]) -> float:
    """Largest error of rays between the vertices, in cells all over the panel and viewpoints all over the eye box.

    Against the exact solve, as `ray_error_arcmin`; infinite if no ray is found anywhere.
    """
    grid, axes = plan.warp_grid, plan.device_from_camera
    columns, rows = (np.unique(np.linspace(0, count - 2, _JUDGED_CELLS).round()).astype(int) for count in grid.size)
    vertex = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 1, 1, 2) + _TRIANGLES  # (cells, 2, 3, 2)
    pixel = np.einsum("wk,ctkd->ctwd", _WEIGHTS, grid.first_px + grid.step_px * vertex)
    worst = -np.inf
    for unit in _JUDGED_VIEWPOINTS:
        viewpoint = mappings.eye_box.at(unit)
        at_vertices = np.moveaxis(ray_map_at(viewpoint).slope_offset, 0, -1)
        linear = np.einsum("wk,ctkr->ctwr", _WEIGHTS, at_vertices[vertex[..., 1], vertex[..., 0]])
        error = ray_error_arcmin(linear, solve_pixels(mappings, axes, pixel, viewpoint).slope_offset)
        worst = max(worst, float(np.max(error, initial=-np.inf, where=np.isfinite(error))))
    return worst if np.isfinite(worst) else np.inf

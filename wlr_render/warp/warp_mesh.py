"""The warp of an eye as arrays, for renderers that a `Compositor` cannot serve: Vulkan, Direct3D, WebGPU, engines.

The arrays are for the shaders of `shaders/own_warp.glsl`. Nothing here needs OpenGL.
"""

import typing
from collections.abc import Sequence

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
from wlr_render.warp.choose_grid import TOLERANCE_ARCMIN, choose_mesh_grid, mesh_error_arcmin, mesh_plan
from wlr_render.warp.eye_camera import EyeCamera
from wlr_render.warp.raster_camera import EyePlan, RasterPlace
from wlr_render.warp.ray_map import FilledRayMaps
from wlr_render.warp.view import image_from_ray_map

_SEARCHED = 0.97  # share of the tolerance that is aimed at: maps of frames differ a little from maps of the search


class WarpMesh:
    """One eye's panel as a triangle mesh whose vertices hold world rays.

    Inside a triangle rays are linear; the error of this interpolation, which is measured here, is the mesh's only
    error.

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
            resolution: see `Compositor`.
            raster_camera: see `Compositor`.
            late_margin_deg: see `Compositor`.
            tolerance_arcmin: largest error of rays, 0.001 to 10, for which the coarsest mesh is chosen; the mesh is no
                finer than a picture's pixels.

        Raises:
            BadInputError: models that do not fit together, two eyes, an invalid size, or a number outside its range.
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
        grids = [choose_mesh_grid(mappings, axes, self.size_px, _SEARCHED * tolerance) for mappings in self._channels]
        grid = min(grids, key=lambda each: float(each.step_px.min()))
        plans = [mesh_plan(mappings, axes, grid) for mappings in self._channels]
        self._ray_maps = [FilledRayMaps(*each) for each in zip(self._channels, plans, strict=True)]
        self.bound_arcmin = max(
            mesh_error_arcmin(mappings, plan, filled.at)
            for mappings, plan, filled in zip(self._channels, plans, self._ray_maps, strict=True)
        )
        self.samples_per_axis = self._plan.samples_per_axis
        self.panel_position = (grid.panel_pixel() / grid.panel.size_px).reshape(-1, 2).astype(np.float32)
        self.triangles = grid.triangles()

    def camera(self, pose: FloatArray, viewpoint: FloatArray) -> EyeCamera:
        """Return the camera to draw the eye's picture with.

        Args:
            pose: (4, 4) world_from_device.
            viewpoint: (3,) entrance pupil in the device frame, metres.

        Raises:
            BadInputError: an invalid pose or viewpoint, or a viewpoint far outside the eye box.
        """
        at = self._checked(viewpoint)
        return EyeCamera(self.eye, self._plan.view(at, checked_pose(pose)), at)

    def shading_rate(self, tile_px: tuple[int, int] = (16, 16)) -> NDArray[np.uint8]:
        """Return the coarsest shading rate (rows, columns) of each tile of the picture, see `EyePlan.shading_rate`."""
        return self._plan.shading_rate(tile_px)

    def rays(self, viewpoint: FloatArray) -> Float32Array:
        """Return the world rays of the vertices at a viewpoint (3,): (colours, n, 4) float32.

        A ray is (a, b, c, d), as in `RayMap.slope_offset`: it passes through (c, d, 0) with tangents (a, b), in metres,
        in axes at the viewpoint that `image_from_ray` transforms to the picture. One colour, or red, green and blue.
        NaN where a vertex has no ray: its triangles show the background. Takes milliseconds for some thousand vertices,
        and 60 to 80 ms for 100,000: their number depends on `tolerance_arcmin`.

        Raises:
            BadInputError: an invalid viewpoint, or one far outside the eye box.
        """
        at = self._checked(viewpoint)
        maps = [each.at(at).slope_offset for each in self._ray_maps]
        return np.ascontiguousarray(np.moveaxis(np.stack(maps).reshape(len(maps), 4, -1), 1, 2))

    def image_from_ray(self, camera: EyeCamera, viewpoint: FloatArray, pose: FloatArray) -> Float32Array:
        """Return the matrix (3, 4) float32 with which the shader projects rays into a picture.

        It maps a point (x, y, z, 1) in the rays' axes to (u depth, v depth, depth) in the picture: pixels, v down from
        the top row, and metres along the camera's -z axis. For rays see `project_ray` in `shaders/conventions.glsl`.

        Args:
            camera: camera with which the picture was drawn, of this frame or of an earlier one.
            viewpoint: (3,) viewpoint of `rays`.
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

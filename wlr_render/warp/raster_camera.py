"""Settings of one eye that all frames share: the camera of the intermediate image, its position, warp grid and filter.

The paper (section 4.2) puts the raster camera at the viewpoint. From there it does not see along the bent rays, which
miss it by up to millimetres; behind an edge it misses the surfaces that the rays meet. Most of that offset is common to
all rays: a thick see-through element makes the eye appear elsewhere, and a camera at that place sees almost along the
rays. This is the default, "nearest"; the paper's is "viewpoint".
"""

import functools
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from wlr_render.geometry import transforms
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.mappings import Eye, EyeChannels, middle_channel
from wlr_render.numerics.arrays import Float32Array, FloatArray
from wlr_render.numerics.polynomial import Box, Polynomial, basis, total_degree
from wlr_render.warp.choose_grid import ChosenWarpGrid, choose_warp_grid
from wlr_render.warp.grid import WarpGrid
from wlr_render.warp.ray_map import RayMapPlan, choose_plan, middle_axes, required_tangents, solve_pixels
from wlr_render.warp.view import View
from wlr_render.warp.warp import SPACING_PX

RasterPlace = Literal["nearest", "viewpoint"]
"""Position of the raster camera: the point nearest to the rays of all pixels, or the viewpoint, as in the paper."""


def intermediate_camera(
    channels: Sequence[Eye],
    device_from_camera: FloatArray,
    resolution: float,
    size_px: tuple[int, int],
    margin: float,
) -> Pinhole:
    """Intrinsics of the raster camera that cover the field of view of all viewpoints in the eye box.

    The mappings are queried at the eye box's centre and corners.

    Args:
        channels: one pair, or one per colour channel.
        device_from_camera: (3, 3) axes of the camera.
        resolution: it has `resolution`^2 times as many pixels as the display, square in tangents.
        size_px: (width, height) of the display.
        margin: tangents added on every side, for a head that turns between drawing and scan-out. They get pixels of
            their own: the resolution stays.
    """
    box, (width, height) = channels[0].eye_box, size_px
    corners = [np.array([x, y, z]) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)]
    tangents = np.concatenate(
        [
            required_tangents(mappings, device_from_camera, box.at(unit))
            for mappings in channels
            for unit in [np.zeros(3), *corners]
        ]
    )
    low, high = np.nanmin(tangents, axis=0), np.nanmax(tangents, axis=0)
    pixels_per_tangent = resolution * float(np.sqrt(width * height / np.prod(high - low)))
    return Pinhole.covering(np.stack([low - margin, high + margin]), pixels_per_tangent)


_GRID = 7
_DEGREE = 2


def nearest_point_to_rays(slope_offset: FloatArray) -> FloatArray:
    """Return the point (3,) that minimises the squares of the rays' offsets from it, in the rays' camera frame.

    A ray is at (c - a z, d - b z, z); its offset from (x, y, z) is measured across the viewing axis, so that the
    point is a regression of (c, d) on (a, b): (c, d) = (x, y) + z (a, b).

    Args:
        slope_offset: (4, ...), (a, b, c, d) as `RayMap.slope_offset`; rays with a NaN do not count.

    Returns:
        The point; the origin where no ray counts, and z = 0 where all are parallel.
    """
    rays = np.asarray(slope_offset, dtype=np.float64).reshape(4, -1)
    rays = rays[:, np.isfinite(rays).all(axis=0)]
    if rays.shape[1] == 0:
        return np.zeros(3)
    mean = rays.mean(axis=1)
    tangents, offset = np.split(rays - mean[:, None], 2)
    spread = np.sum(tangents * tangents)
    z = np.sum(tangents * offset) / spread if spread > 0 else 0.0
    return np.array([*(mean[2:] - z * mean[:2]), z])


class RasterPosition:
    """Position of the raster camera as a function of the viewpoint: a polynomial fitted over the eye box."""

    def __init__(self, mappings: Eye, device_from_camera: FloatArray) -> None:
        """Fit; best for a camera with these axes (3, 3), across whose viewing axis offsets are measured."""
        eye_box, pixel = mappings.eye_box, mappings.display.panel.grid(_GRID, _GRID)
        half = 0.5 * np.maximum(eye_box.size, 1e-6)
        self._box = Box(eye_box.centre - half, eye_box.centre + half)
        viewpoints = eye_box.centre + half * np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=3)))
        shift_in_camera = [
            nearest_point_to_rays(
                np.moveaxis(solve_pixels(mappings, device_from_camera, pixel, each).slope_offset, -1, 0)
            )
            for each in viewpoints
        ]
        shift = transforms.rotate(device_from_camera, np.array(shift_in_camera))
        orders = total_degree(3, _DEGREE)
        coefficients, *_ = np.linalg.lstsq(basis(viewpoints, orders, self._box), shift)
        self._shift = Polynomial(orders, self._box, coefficients.astype(np.float64))

    def at(self, viewpoint: FloatArray) -> FloatArray:
        """Camera positions (..., 3) for viewpoints (..., 3), both in the device frame.

        Outside the eye box the shift of the box's nearest point applies, so that it neither jumps nor grows.
        """
        return np.asarray(viewpoint + self._shift(np.clip(viewpoint, self._box.low, self._box.high)))


def ray_map_plans(channels: Sequence[Eye], device_from_camera: FloatArray) -> tuple[RayMapPlan, ...]:
    """Return the plans of the ray maps of all pixels, one for each channel, in the axes (3, 3) of a camera."""
    return tuple(
        RayMapPlan.with_nodes(each.display.panel, choose_plan(each).node_count, device_from_camera) for each in channels
    )


MAX_SAMPLES = 4
_POINTS = 33


def largest_minification(
    slope_offset: Float32Array, warp_grid: WarpGrid, camera: Pinhole, size_px: tuple[int, int]
) -> float:
    """Largest minification: image pixels per display pixel, in the direction and at the position where it is largest.

    The largest singular value of the map's derivative for points at infinity, by differences between warp grid points;
    0 if no ray is known.

    Args:
        slope_offset: (4, rows, columns) in the image's camera frame, at the points of `warp_grid`; at least 2 x 2.
        warp_grid: where.
        camera: of the image.
        size_px: (width, height) of the display picture, which covers the panel.
    """
    points_per_pixel = warp_grid.panel.size_px / size_px / warp_grid.step_px
    at_infinity = camera.pixel_of_tangents(np.moveaxis(slope_offset[:2].astype(np.float64), 0, -1))
    down, across = np.gradient(at_infinity, axis=(0, 1))
    across, down = across * points_per_pixel[0], down * points_per_pixel[1]
    squares = (across**2 + down**2).sum(axis=-1)
    area = across[..., 0] * down[..., 1] - across[..., 1] * down[..., 0]
    largest_squared = 0.5 * (squares + np.sqrt(np.maximum(squares**2 - 4 * area**2, 0.0)))
    return float(np.sqrt(np.max(largest_squared, initial=0.0, where=np.isfinite(largest_squared))))


def minification_over_eye_box(
    mappings: Eye, device_from_camera: FloatArray, camera: Pinhole, size_px: tuple[int, int]
) -> float:
    """`largest_minification` of an eye's ray maps at the centre of the eye box and at its nearest and farthest corners.

    Args:
        mappings: any pair.
        device_from_camera: (3, 3) axes of the camera.
        camera: of the image.
        size_px: (width, height) of the display picture.
    """
    warp_grid = WarpGrid.edge_to_edge(mappings.display.panel, _POINTS, _POINTS)
    box, pixel = mappings.eye_box, warp_grid.panel_pixel()
    slope_offsets = [
        solve_pixels(mappings, device_from_camera, pixel, box.at(unit)).slope_offset
        for unit in np.array([[0.0, 0, 0], [1, 1, 1], [-1, -1, -1]])
    ]
    return max(
        largest_minification(np.moveaxis(slope_offset, -1, 0).astype(np.float32), warp_grid, camera, size_px)
        for slope_offset in slope_offsets
    )


def samples_for(minification: float) -> int:
    """Return samples per display pixel along each axis, 1 to MAX_SAMPLES, for `largest_minification`."""
    return min(max(math.ceil(minification / SPACING_PX), 1), MAX_SAMPLES)


@dataclass(frozen=True, eq=False)
class EyePlan:
    """Plan of one eye: all that is fixed over its frames.

    Attributes:
        eye: "left" or "right".
        channels: one pair of mappings, or one per colour channel.
        size_px: (width, height) of the display's picture, which covers the panel.
        device_from_camera: (3, 3) axes of the intermediate image and of the ray map.
        camera: of the intermediate image.
        raster_position: position of that camera as a function of the viewpoint; None: the viewpoint itself.
        minification: largest minification of that image, see `minification_over_eye_box`.
    """

    eye: str
    channels: EyeChannels
    size_px: tuple[int, int]
    device_from_camera: FloatArray
    camera: Pinhole
    raster_position: RasterPosition | None
    minification: float

    @functools.cached_property
    def warp_grid(self) -> ChosenWarpGrid:
        """The warp grid, and its measured interpolation error.

        The densest grid that any colour channel needs. Computed on first use: only a compositor needs it.
        """
        models = {id(mappings): mappings for mappings in self.channels}.values()  # one model may serve all colours
        chosen = [choose_warp_grid(mappings, self.device_from_camera) for mappings in models]
        return min(chosen, key=lambda each: float(each.cell_px.min()))

    @classmethod
    def of(
        cls,
        channels: EyeChannels,
        size_px: tuple[int, int],
        resolution: float,
        raster_camera: RasterPlace = "nearest",
        late_margin: float = 0.0,
    ) -> "EyePlan":
        """Make the plan.

        Args:
            channels: of one eye.
            size_px: (width, height) of the display.
            resolution: of the intermediate image, as in `intermediate_camera`.
            raster_camera: position of the camera of the intermediate image.
            late_margin: tangents by which the head may turn between drawing and scan-out.
        """
        middle = middle_channel(channels)
        axes = middle_axes(middle)
        camera = intermediate_camera(channels, axes, resolution, size_px, late_margin)
        minification = minification_over_eye_box(middle, axes, camera, size_px)
        position = RasterPosition(middle, axes) if raster_camera == "nearest" else None
        return cls(middle.eye, channels, size_px, axes, camera, position, minification)

    @property
    def samples_per_axis(self) -> int:
        """Samples per display pixel and axis that the filter takes."""
        return self.samples_of(self.camera)

    def samples_of(self, camera: Pinhole) -> int:
        """Return the same of an inset's camera."""
        return samples_for(float(np.max(camera.focal_px / self.camera.focal_px)) * self.minification)

    def view(self, viewpoint: FloatArray, world_from_device: FloatArray) -> View:
        """Return the camera pose and intrinsics to draw with for a viewpoint (3,) and a head pose (4, 4)."""
        position = self.raster_position.at(viewpoint) if self.raster_position else viewpoint
        return View(self.camera, position, world_from_device, self.device_from_camera)

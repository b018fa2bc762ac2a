"""Settings of one eye for all frames: the camera of the intermediate image, its position, warp grid and filter.

The paper (section 4.2) puts the raster camera at the viewpoint. From there it does not look along the bent rays, which
miss it by up to millimetres; behind an edge it does not see the surfaces that the rays meet. Most of that offset is
common to all rays: a thick see-through element makes the eye appear displaced, and a camera at the apparent position
looks almost along the rays. This is the default, "nearest"; the paper's position is "viewpoint".
"""

import functools
import importlib
import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.io.input_files import shown
from wlr_render.mappings import Eye, EyeChannels, middle_channel
from wlr_render.numerics.arrays import BoolArray, Float32Array, FloatArray, IntArray
from wlr_render.numerics.polynomial import Box
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
    """Return intrinsics of the raster camera that cover the field of view of all viewpoints in the eye box.

    The mappings are queried at the eye box's centre and corners.

    Args:
        channels: one pair of mappings, or one per colour channel.
        device_from_camera: (3, 3) axes of the camera.
        resolution: the image has `resolution`^2 times as many pixels as the display, square in tangents.
        size_px: (width, height) of the display.
        margin: tangents added on every side, with additional pixels, for a head that turns between drawing and
            scan-out.
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
_PAIRS = np.triu_indices(4)


def nearest_point_to_rays(slope_offset: FloatArray) -> FloatArray:
    """Return the point (3,) with the least sum of squared offsets of the rays, in the rays' camera frame.

    A ray is at (c - a z, d - b z, z); its offset from (x, y, z) is measured across the viewing axis, so that the
    point is a regression of (c, d) on (a, b): (c, d) = (x, y) + z (a, b).

    Args:
        slope_offset: (4, ...), (a, b, c, d) as in `RayMap.slope_offset`; rays with a NaN are ignored.

    Returns:
        The point; the origin if there are no rays, and z = 0 if all are parallel.
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
    """Position of the raster camera as a function of the viewpoint: a quadratic polynomial fitted over the eye box."""

    def __init__(self, mappings: Eye, device_from_camera: FloatArray) -> None:
        """Fit, for a camera with the given axes (3, 3); offsets are measured across its viewing axis."""
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
        self._coefficients, *_ = np.linalg.lstsq(self._terms(viewpoints), shift)

    def at(self, viewpoint: FloatArray) -> FloatArray:
        """Return camera positions (..., 3) for viewpoints (..., 3), both in the device frame.

        Outside the eye box the shift is that at the box's nearest point, so that it neither jumps nor grows.
        """
        return np.asarray(viewpoint + self._terms(viewpoint) @ self._coefficients)

    def _terms(self, viewpoint: FloatArray) -> FloatArray:
        """Return all products of two out of 1 and the scaled coordinates, (..., 10)."""
        scaled = self._box.scaled(viewpoint).clip(-1, 1)
        factors = np.concatenate([np.ones_like(scaled[..., :1]), scaled], axis=-1)
        return np.asarray((factors[..., :, None] * factors[..., None, :])[..., *_PAIRS])


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
    """Return the largest number of image pixels per display pixel, over directions and positions.

    It is the largest singular value of the map's Jacobian for points at infinity, by differences between warp grid
    points; 0 if no ray is known.

    Args:
        slope_offset: (4, rows, columns) in the image's camera frame, at the points of `warp_grid`; at least 2 x 2.
        warp_grid: the warp grid of the rays.
        camera: camera of the image.
        size_px: (width, height) of the display picture, which covers the panel.
    """
    _, sides, area = _footprints(slope_offset, warp_grid, camera, size_px)
    squares = (sides**2).sum(axis=(-2, -1))
    largest_squared = 0.5 * (squares + np.sqrt(np.maximum(squares**2 - 4 * area**2, 0.0)))
    return float(np.sqrt(np.max(largest_squared, initial=0.0, where=np.isfinite(largest_squared))))


def _footprints(
    slope_offset: Float32Array, warp_grid: WarpGrid, camera: Pinhole, size_px: tuple[int, int]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the positions of a warp grid's points in an image, and the display pixels there, for points at infinity.

    For the arguments see `largest_minification`.

    Returns:
        The positions (rows, columns, 2), and the sides (rows, columns, 2, 2), across and down, and areas of display
        pixels, in image pixels.
    """
    points_per_pixel = warp_grid.panel.size_px / size_px / warp_grid.step_px
    at_infinity = camera.pixel_of_tangents(np.moveaxis(slope_offset[:2].astype(np.float64), 0, -1))
    down, across = np.gradient(at_infinity, axis=(0, 1))
    sides = np.stack([across, down], axis=-2) * points_per_pixel[:, None]
    return at_infinity, sides, sides[..., 0, 0] * sides[..., 1, 1] - sides[..., 0, 1] * sides[..., 1, 0]


def minification_over_eye_box(
    mappings: Eye, device_from_camera: FloatArray, camera: Pinhole, size_px: tuple[int, int]
) -> float:
    """Return the `largest_minification` at the centre of the eye box and at its nearest and farthest corners.

    Args:
        mappings: any display and see-through mappings.
        device_from_camera: (3, 3) axes of the camera.
        camera: camera of the image.
        size_px: (width, height) of the display picture.
    """
    maps = _maps_of(mappings, device_from_camera, [(0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (-1.0, -1.0, -1.0)])
    return max(largest_minification(slope_offset, grid, camera, size_px) for grid, slope_offset in maps)


def _maps_of(
    mappings: Eye, device_from_camera: FloatArray, units: Iterable[tuple[float, ...]]
) -> Iterator[tuple[WarpGrid, Float32Array]]:
    """Yield the warp grid and its rays (4, rows, columns) at positions in the eye box, -1 to 1."""
    warp_grid = WarpGrid.edge_to_edge(mappings.display.panel, _POINTS, _POINTS)
    for unit in units:
        viewpoint = mappings.eye_box.at(np.array(unit))
        solved = solve_pixels(mappings, device_from_camera, warp_grid.panel_pixel(), viewpoint)
        yield warp_grid, np.moveaxis(solved.slope_offset, -1, 0).astype(np.float32)


def samples_for(minification: float) -> int:
    """Return samples per display pixel along each axis, 1 to MAX_SAMPLES, for `largest_minification`."""
    return min(max(math.ceil(minification / SPACING_PX), 1), MAX_SAMPLES)


_SLACK = 1e-3  # share of a display pixel allowed for rounding
_BLOCKS = np.array([(4, 4), (4, 2), (2, 4), (2, 2), (2, 1), (1, 2), (1, 1)])
"""Blocks of pixels (width, height) that Vulkan and Direct3D 12 can shade as one, coarsest first."""


def _cells_of(place: FloatArray, sides: FloatArray, area: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return the cells of a warp grid in an image that have a ray at a corner, from the results of `_footprints`.

    Returns:
        First and last pixels (n, 2) of each cell, and which of `_BLOCKS` (n, blocks) are larger than a display pixel.
    """
    is_known = np.asarray(np.isfinite(place).all(axis=-1))
    with np.errstate(divide="ignore", invalid="ignore"):
        # Display pixels per image pixel, [display axis, image axis]: the inverse of the sides, without signs.
        display_px = np.abs(sides[..., ::-1, ::-1] / area[..., None, None])
    fits = np.asarray((display_px @ _BLOCKS.T).max(axis=-2) <= 1 + _SLACK)

    def corners(values: FloatArray | BoolArray) -> Any:
        return np.stack([values[:-1, :-1], values[:-1, 1:], values[1:, :-1], values[1:, 1:]])

    in_use = corners(is_known).any(axis=0)
    first, last = (corners(np.where(is_known[..., None], place, other)) for other in (np.inf, -np.inf))
    fails = corners(is_known[..., None] & ~fits).any(axis=0)
    return first.min(axis=0)[in_use], last.max(axis=0)[in_use], fails[in_use]


def _boxes_cover(first: IntArray, last: IntArray, size: tuple[int, int]) -> BoolArray:
    """Return the mask (rows, columns) of a raster (columns, rows) that the boxes (n, 2) of (column, row) cover."""
    corners = np.zeros((size[1] + 1, size[0] + 1), dtype=np.int64)
    (left, top), (right, bottom) = np.clip(first, 0, size).T, np.clip(last + 1, 0, size).T
    for x, y, sign in ((left, top, 1), (right, top, -1), (left, bottom, -1), (right, bottom, 1)):
        np.add.at(corners, (y, x), sign)
    return corners.cumsum(axis=0).cumsum(axis=1)[:-1, :-1] > 0


@dataclass(frozen=True, eq=False)
class EyePlan:
    """Plan of one eye: everything that stays the same in all its frames.

    Attributes:
        eye: "left" or "right".
        channels: one pair of mappings, or one per colour channel.
        size_px: (width, height) of the display's picture, which covers the panel.
        device_from_camera: (3, 3) axes of the intermediate image and of the ray map.
        camera: camera of the intermediate image.
        raster_position: position of that camera as a function of the viewpoint; None for the viewpoint itself.
        minification: largest minification of that image, see `minification_over_eye_box`.
        late_margin: tangents by which the head may turn between drawing and scan-out.
    """

    eye: str
    channels: EyeChannels
    size_px: tuple[int, int]
    device_from_camera: FloatArray
    camera: Pinhole
    raster_position: RasterPosition | None
    minification: float
    late_margin: float

    @functools.cached_property
    def warp_grid(self) -> ChosenWarpGrid:
        """The warp grid, and its measured interpolation error.

        It is the densest grid that any colour channel needs, computed on first use: only a compositor needs it.
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
            channels: mappings of one eye, per channel.
            size_px: (width, height) of the display.
            resolution: resolution of the intermediate image, see `intermediate_camera`.
            raster_camera: position of the camera of the intermediate image.
            late_margin: tangents by which the head may turn between drawing and scan-out.
        """
        importlib.import_module("scipy.spatial.transform")  # takes half a second, which must not delay a frame
        middle = middle_channel(channels)
        axes = middle_axes(middle)
        camera = intermediate_camera(channels, axes, resolution, size_px, late_margin)
        minification = minification_over_eye_box(middle, axes, camera, size_px)
        position = RasterPosition(middle, axes) if raster_camera == "nearest" else None
        return cls(middle.eye, channels, size_px, axes, camera, position, minification, late_margin)

    @functools.cached_property
    def samples_per_axis(self) -> int:
        """Samples of the filter per display pixel and axis."""
        return self.samples_of(self.camera)

    def samples_of(self, camera: Pinhole) -> int:
        """Return the samples for an inset's camera."""
        return samples_for(float(np.max(camera.focal_px / self.camera.focal_px)) * self.minification)

    def shading_rate(self, tile_px: tuple[int, int] = (16, 16)) -> NDArray[np.uint8]:
        """Return the coarsest shading rate of each tile of the intermediate image.

        Where the warp minifies the image, a block of its pixels may be shaded as one: the largest
        block that is not larger than any display pixel, at the centre and the corners of the eye box and within
        `late_margin`. Tiles without rays have 4 x 4.

        Args:
            tile_px: (width, height) of a tile, the `shadingRateAttachmentTexelSize` of Vulkan or the
                `ShadingRateImageTileSize` of Direct3D 12.

        Returns:
            (rows, columns) uint8, the top row first: 4 log2(width) + log2(height) of a block in pixels, the texels of
            Vulkan's attachment and the values of D3D12_SHADING_RATE.

        Raises:
            BadInputError: invalid size.
        """
        tile = np.asarray(tile_px)
        if tile.shape != (2,) or tile.dtype.kind not in "iu" or tile.min() < 1:
            raise BadInputError(f"tile_px is {shown(tile_px)}; give (width, height) of a tile in whole pixels.")
        columns, rows = (-(-np.array(self.camera.size_px) // tile)).tolist()
        is_too_coarse = np.zeros((len(_BLOCKS), rows, columns), dtype=np.bool_)
        units = [(0.0, 0.0, 0.0), *itertools.product((-1.0, 1.0), repeat=3)]
        margin_px = self.late_margin * self.camera.focal_px
        for mappings in {id(each): each for each in self.channels}.values():  # one model may serve all colours
            for grid, slope_offset in _maps_of(mappings, self.device_from_camera, units):
                low, high, fails = _cells_of(*_footprints(slope_offset, grid, self.camera, self.size_px))
                first, last = ((px // tile).astype(int) for px in (low - margin_px, high + margin_px))
                for k, failing in enumerate(fails.T[:-1]):
                    is_too_coarse[k] |= _boxes_cover(first[failing], last[failing], (columns, rows))
        codes = (np.log2(_BLOCKS) @ [4, 1]).astype(np.uint8)
        return np.asarray(codes[np.argmin(is_too_coarse, axis=0)])

    def view(self, viewpoint: FloatArray, world_from_device: FloatArray) -> View:
        """Return the camera pose and intrinsics to draw with for a viewpoint (3,) and a head pose (4, 4)."""
        position = self.raster_position.at(viewpoint) if self.raster_position else viewpoint
        return View(self.camera, position, world_from_device, self.device_from_camera)

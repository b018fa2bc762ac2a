"""Pictures warped along given rays."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from wlr_render.geometry.pinhole import Pinhole
from wlr_render.gl.context import GlContext
from wlr_render.mappings import Panel
from wlr_render.numerics.arrays import Float32Array, FloatArray
from wlr_render.warp.gl_ray_maps import RayTexture
from wlr_render.warp.gl_warp import GlWarp
from wlr_render.warp.gpu_image import GpuImage
from wlr_render.warp.grid import WarpGrid
from wlr_render.warp.view import GeometryImage
from wlr_render.warp.warp import WarpedImage


def uploaded(context: GlContext, image: GeometryImage, camera: Pinhole) -> GpuImage:
    """A `GeometryImage` as a `GpuImage`."""
    size = image.colour.shape[1::-1]
    with context.drawing():
        colour, inverse_depth = context.target(size, 4, "srgb"), context.target(size, 1, "f4")
        alpha = np.full((*image.colour.shape[:2], 1), 255, np.uint8)
        colour.write(np.ascontiguousarray(np.concatenate([image.colour, alpha], axis=-1)))
        inverse_depth.write(np.ascontiguousarray(image.inverse_depth))
    return GpuImage(context, camera, colour, inverse_depth)


def uploaded_field(context: GlContext, slope_offset: Float32Array | FloatArray, warp_grid: WarpGrid) -> RayTexture:
    """Rays (4, rows, columns) at the points of a warp grid as a `RayTexture`."""
    with context.drawing():
        texture = context.target(warp_grid.size, 4, "f4")
        texture.write(np.ascontiguousarray(np.moveaxis(slope_offset, 0, -1), np.float32))
    return RayTexture(warp_grid, texture)


def field_of_pixels(context: GlContext, slope_offset: Float32Array) -> RayTexture:
    """Rays (4, height, width) of a display's pixels as those of their corners, with one cell for each pixel.

    Exact for rays that are linear in the pixel; missing where one of the four pixels around a corner is.
    """
    _, height, width = slope_offset.shape
    padded = slope_offset.astype(np.float64)
    for axis in (1, 2):
        if padded.shape[axis] == 1:
            padded = np.repeat(padded, 3, axis=axis)
            continue
        first, second = padded.take([0], axis), padded.take([1], axis)
        last, before = padded.take([-1], axis), padded.take([-2], axis)
        padded = np.concatenate([2 * first - second, padded, 2 * last - before], axis=axis)
    corners = 0.25 * (padded[:, 1:, 1:] + padded[:, 1:, :-1] + padded[:, :-1, 1:] + padded[:, :-1, :-1])
    return uploaded_field(context, corners, WarpGrid.edge_to_edge(Panel(width, height), width + 1, height + 1))


def warp_pixels(
    context: GlContext,
    image: GpuImage,
    slope_offsets: Sequence[Float32Array],
    image_from_ray_map: None = None,
    **options: Any,
) -> WarpedImage:
    """A `WarpedImage` with its pull map of a `GpuImage`, along rays (4, height, width) of each channel."""
    fields = [field_of_pixels(context, slope_offset) for slope_offset in slope_offsets]
    transform = np.eye(4) if image_from_ray_map is None else image_from_ray_map
    size = slope_offsets[0].shape[:0:-1]
    drawn = GlWarp(context, len(fields)).draw(image, fields, transform, size, with_source=True, **options)
    return drawn.read()


def warped(
    context: GlContext,
    image: GeometryImage,
    camera: Pinhole,
    slope_offsets: Sequence[Float32Array],
    image_from_ray_map: None = None,
    **options: Any,
) -> WarpedImage:
    """The same of a `GeometryImage`."""
    return warp_pixels(context, uploaded(context, image, camera), slope_offsets, image_from_ray_map, **options)

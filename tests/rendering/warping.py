"""One picture warped by either backend, for tests that hold both to the same rule."""

import numpy as np

from wlr_render.mappings import Panel
from wlr_render.rendering.cpu_warp import warp_on_cpu
from wlr_render.rendering.gl_ray_maps import RayTexture
from wlr_render.rendering.gl_warp import GlWarp
from wlr_render.rendering.gpu_image import GpuImage
from wlr_render.rendering.warp_grid import WarpGrid

BACKENDS = ("cpu", "gl")


def uploaded(context, image, camera):
    """A `GeometryImage` as a `GpuImage`."""
    size = image.colour.shape[1::-1]
    with context.drawing():
        colour, inverse_depth = context.target(size, 4, "f1"), context.target(size, 1, "f4")
        alpha = np.full((*image.colour.shape[:2], 1), 255, np.uint8)
        colour.write(np.ascontiguousarray(np.concatenate([image.colour, alpha], axis=-1)))
        inverse_depth.write(np.ascontiguousarray(image.inverse_depth))
    return GpuImage(context, camera, colour, inverse_depth)


def uploaded_field(context, slope_offset, warp_grid=None):
    """Rays (4, rows, columns) as a `RayTexture`; of each pixel of a display if no warp grid is given."""
    _, rows, columns = slope_offset.shape
    with context.drawing():
        texture = context.target((columns, rows), 4, "f4")
        texture.write(np.ascontiguousarray(np.moveaxis(slope_offset, 0, -1), np.float32))
    return RayTexture(warp_grid or WarpGrid.of_pixels(Panel(columns, rows)), texture)


def warped(backend, request, image, camera, slope_offsets, image_from_ray_map=None, **options):
    """A `WarpedImage` with its pull map, along rays (4, height, width): one field, or one for each channel."""
    if backend == "cpu":
        return warp_on_cpu(image, camera, slope_offsets, image_from_ray_map, **options)
    context = request.getfixturevalue("gl_context")
    fields = [uploaded_field(context, slope_offset) for slope_offset in slope_offsets]
    transform = np.eye(4) if image_from_ray_map is None else image_from_ray_map
    return (
        GlWarp(context, len(slope_offsets))
        .draw(
            uploaded(context, image, camera),
            fields,
            transform,
            slope_offsets[0].shape[:0:-1],
            with_source=True,
            **options,
        )
        .read()
    )

"""Backward warp of an intermediate image on the CPU; `warp.py` states the algorithm."""

from collections.abc import Sequence

import numpy as np
from cpu_march import EpipolarLines, InverseDepths, march
from numpy.typing import NDArray

from wlr_render.geometry.pinhole import Pinhole
from wlr_render.numerics.arrays import Float32Array, FloatArray
from wlr_render.rendering import sampling
from wlr_render.rendering.srgb import decode_srgb, encode_srgb
from wlr_render.rendering.thread_pool import for_blocks
from wlr_render.rendering.view import GeometryImage
from wlr_render.rendering.warp import WarpedImage, WarpStatus

_PIXELS_PER_BLOCK = 1 << 15


def warp_on_cpu(
    image: GeometryImage,
    camera: Pinhole,
    slope_offsets: Sequence[Float32Array],
    image_from_ray_map: FloatArray | None = None,
    background: tuple[int, int, int] = (0, 0, 0),
    samples_per_axis: int = 1,
) -> WarpedImage:
    """Return the display image and its pull map.

    Args:
        image: colour and inverse depth.
        camera: of the image.
        slope_offsets: one for all colours, or three: of red, green and blue. Each (4, height, width) float32,
            (a, b, c, d) of each display pixel; NaN where there is no ray.
        image_from_ray_map: rigid, from the camera frame of the rays to that of the image, (4, 4), or (height, 4, 4)
            with one for each row of the display; the same frame if None.
        background: sRGB for pixels that show nothing of the image.
        samples_per_axis: samples per pixel along each axis, see `raster_camera.samples_for`.
    """
    depths = InverseDepths.of(image.inverse_depth)
    if len(slope_offsets) == 1:
        return _warp_channel(
            image.colour, depths, camera, slope_offsets[0], image_from_ray_map, background, samples_per_axis
        )
    greys = (np.ascontiguousarray(image.colour[..., k]) for k in range(3))
    channels = [
        _warp_channel(grey, depths, camera, slope_offset, image_from_ray_map, code, samples_per_axis)
        for grey, slope_offset, code in zip(greys, slope_offsets, background, strict=True)
    ]
    status = np.max([each.status for each in channels], axis=0)
    return WarpedImage(np.stack([each.colour for each in channels], axis=-1), status, channels[1].source)


def _warp_channel(
    picture: NDArray[np.uint8],
    depths: InverseDepths,
    camera: Pinhole,
    slope_offset: Float32Array,
    image_from_ray_map: FloatArray | None,
    background: int | tuple[int, int, int],
    samples_per_axis: int,
) -> WarpedImage:
    """All channels of a picture (height, width) or (height, width, 3) along one ray map."""
    _, height, width = slope_offset.shape
    warped = WarpedImage(
        np.empty((height, width, *picture.shape[2:]), np.uint8),
        np.empty((height, width), np.uint8),
        np.empty((height, width, 2), np.float32),
    )

    def warp(rows: slice) -> None:
        lines = EpipolarLines.of(camera, _in_image_frame(slope_offset, image_from_ray_map, rows))
        pixel, status = march(depths, lines)
        status[_outside(pixel, camera)] = WarpStatus.OUTSIDE
        status[lines.missing] = WarpStatus.NO_RAY
        shape = warped.status[rows].shape
        lost = np.flatnonzero(status >= WarpStatus.OUTSIDE)
        # What is lost is sampled at a harmless place and painted over.
        pixel[:, lost] = 0.5
        colour = _filtered(picture, pixel.reshape(2, *shape), lines, samples_per_axis)
        pixel[:, lost] = np.nan
        colour.reshape(-1, *picture.shape[2:])[lost] = background
        assert warped.source is not None
        warped.colour[rows], warped.status[rows] = colour, status.reshape(shape)
        warped.source[rows, :, 0], warped.source[rows, :, 1] = pixel.reshape(2, *shape)

    # An even number of rows, so that no block of 2 x 2 pixels is cut.
    for_blocks(warp, height, 2 * max(1, _PIXELS_PER_BLOCK // (2 * max(1, width))))
    return warped


def _in_image_frame(slope_offset: Float32Array, image_from_ray_map: FloatArray | None, rows: slice) -> Float32Array:
    if image_from_ray_map is None:
        return slope_offset[:, rows]
    return in_camera_frame(
        slope_offset[:, rows], image_from_ray_map if image_from_ray_map.ndim == 2 else image_from_ray_map[rows]
    )


def in_camera_frame(slope_offset: Float32Array, image_from_ray_map: FloatArray) -> Float32Array:
    """Transform rays in (slope, offset) form to another camera frame.

    With X = O + l D, O = (c, d, 0) and D = (a, b, -1), the transform gives O' = R O + t and D' = R D; D' is scaled to
    D'_z = -1 and O' slid along it to z = 0.

    Args:
        slope_offset: (4, rows, columns), as `RayMap.slope_offset`.
        image_from_ray_map: rigid, from the camera frame of `slope_offset` to the other, (4, 4), or (rows, 4, 4) with
            one for each row.

    Returns:
        (4, rows, columns) of the type of `slope_offset`; NaN where a ray does not lead forwards in the other frame.
    """
    entries = np.moveaxis(np.asarray(image_from_ray_map, slope_offset.dtype), (-2, -1), (0, 1))[..., None]
    a, b, c, d = slope_offset
    direction = [row[0] * a + row[1] * b - row[2] for row in entries[:3]]
    origin = [row[0] * c + row[1] * d + row[3] for row in entries[:3]]
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.where(direction[2] < 0, -direction[2], np.nan)
        tangents = [direction[0] / depth, direction[1] / depth]
    offset = [origin[axis] + origin[2] * tangents[axis] for axis in range(2)]
    return np.asarray(np.stack([*tangents, *offset]), slope_offset.dtype)


def _outside(pixel: Float32Array, camera: Pinhole) -> NDArray[np.bool_]:
    u, v = pixel
    return np.asarray((u < 0) | (u > camera.width_px) | (v < 0) | (v > camera.height_px))


def _filtered(
    picture: NDArray[np.uint8], pixel: Float32Array, lines: EpipolarLines, samples_per_axis: int
) -> NDArray[np.uint8]:
    """Colour at positions (2, rows, columns): the mean light over what a display pixel covers in the image."""
    light = decode_srgb(picture)
    if samples_per_axis == 1:
        return encode_srgb(sampling.bilinear_at(light, pixel[0], pixel[1]))
    at_infinity = np.where(lines.missing, np.float32(np.nan), lines.at_infinity).reshape(pixel.shape)
    across, down = _differences(at_infinity, 2), _differences(at_infinity, 1)
    at_hole = np.isnan(across + down).any(axis=0)
    across, down = (np.where(at_hole, np.float32(0), side) for side in (across, down))
    places = ((np.arange(samples_per_axis) + 0.5) / samples_per_axis - 0.5).astype(np.float32)
    total = np.zeros((*pixel.shape[1:], *picture.shape[2:]), np.float32)
    for y in places:
        for x in places:
            u, v = pixel + x * across + y * down
            total += sampling.bilinear_at(light, u, v)
    return encode_srgb(total / np.float32(samples_per_axis**2))


def _differences(values: Float32Array, axis: int) -> Float32Array:
    """From the first to the second of each pair along an axis, at both; 0 at a last one without a partner."""
    index = np.arange(values.shape[axis])
    first = index - index % 2
    second = np.minimum(first + 1, index[-1])
    return np.asarray(values.take(second, axis) - values.take(first, axis))

"""Warping an intermediate image along bent rays, without a GPU; the rule is in `warped_image.py`."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render.geometry.pinhole import Pinhole
from wlr_render.rendering import sampling
from wlr_render.rendering.scene import Float32Array
from wlr_render.rendering.view import GeometryImage
from wlr_render.rendering.warped_image import MAX_STEPS, SETTLED_PX, SURFACE_STEP, WarpedImage, WarpStatus
from wlr_render.rendering.workers import for_blocks

_PIXELS_PER_BLOCK = 1 << 15


def warp_on_cpu(
    image: GeometryImage, camera: Pinhole, bend: Float32Array, background: tuple[int, int, int] = (0, 0, 0)
) -> WarpedImage:
    """The picture that the display must show, and its pull map.

    Args:
        image: colour and inverse depth, drawn from the viewpoint of the ray field.
        camera: of the image, with the axes and the origin of the field's camera frame.
        bend: (4, height, width) float32, (a, b, c, d) of each display pixel; NaN where there is no ray.
        background: sRGB for pixels that show nothing of the image.
    """
    _, height, width = bend.shape
    warped = WarpedImage(
        np.empty((height, width, 3), np.uint8),
        np.empty((height, width), np.uint8),
        np.empty((height, width, 2), np.float32),
    )
    depths = _InverseDepths.of(image.inverse_depth)

    def warp(rows: slice) -> None:
        lines = _Lines.of(camera, bend[:, rows])
        pixel, status = _follow(depths, lines)
        status[_outside(pixel, camera)] = WarpStatus.OUTSIDE
        status[lines.missing] = WarpStatus.NO_RAY
        _write_block(warped, rows, image.colour, pixel, status, background)

    for_blocks(warp, height, max(1, _PIXELS_PER_BLOCK // max(1, width)))
    return warped


def inverse_depth_at(inverse_depth: Float32Array, source: Float32Array) -> Float32Array:
    """What the warp reads from an inverse depth image (height, width) at finite positions (n, 2): (n,) in 1/m."""
    return _InverseDepths.of(inverse_depth).at(np.ascontiguousarray(source.T, dtype=np.float32))


@dataclass(frozen=True, eq=False)
class _Lines:
    """Where rays appear in the image: s(w) = at_infinity + w shift.

    Attributes:
        at_infinity, shift: (2, n) float32 pixels, and pixels times metres; 0 where there is no ray.
        missing: (n,) where there is no ray.
    """

    at_infinity: Float32Array
    shift: Float32Array
    missing: NDArray[np.bool_]

    @classmethod
    def of(cls, camera: Pinhole, bend: Float32Array) -> "_Lines":
        flat = bend.reshape(4, -1)
        missing = np.asarray(~np.isfinite(flat).all(axis=0))
        if missing.any():
            flat = np.where(missing, np.float32(0), flat)
        focal = (camera.focal_px * [1, -1]).astype(np.float32)[:, None]
        return cls(focal * flat[:2] + camera.centre_px.astype(np.float32)[:, None], focal * flat[2:], missing)

    def at(self, inverse_depth: Float32Array) -> Float32Array:
        return np.asarray(self.at_infinity + inverse_depth * self.shift)

    def some(self, index: NDArray[np.intp]) -> "_Lines":
        return _Lines(self.at_infinity.take(index, axis=1), self.shift.take(index, axis=1), self.missing.take(index))


def _follow(depths: "_InverseDepths", lines: _Lines) -> tuple[Float32Array, NDArray[np.uint8]]:
    """Positions (2, n) and status (n,): SEEN, or DISOCCLUDED if the search did not settle."""
    count = lines.missing.size
    result = np.empty((2, count), np.float32)
    status = np.full(count, WarpStatus.SEEN, np.uint8)
    open_rays = np.arange(count)
    seen = np.full(count, depths.largest, np.float32)
    pixel = lines.at(seen)
    for _ in range(MAX_STEPS):
        previous, previously_seen = pixel, seen
        seen = depths.at(previous)
        pixel = lines.at(seen)
        moved = np.square(pixel - previous).sum(axis=0) >= np.float32(SETTLED_PX**2)
        settled, unsettled = np.flatnonzero(~moved), np.flatnonzero(moved)
        _put(result, open_rays.take(settled), pixel.take(settled, axis=1))
        # Few rays are left after two or three steps.
        open_rays, lines = open_rays.take(unsettled), lines.some(unsettled)
        pixel, previous = pixel.take(unsettled, axis=1), previous.take(unsettled, axis=1)
        seen, previously_seen = seen.take(unsettled), previously_seen.take(unsettled)
    _put(result, open_rays, np.where(seen < previously_seen, previous, pixel))
    status[open_rays] = WarpStatus.DISOCCLUDED
    return result, status


def _put(target: Float32Array, index: NDArray[np.intp], values: Float32Array) -> None:
    """target[:, index] = values, but faster."""
    for row, row_values in zip(target, values, strict=True):
        row[index] = row_values


def _outside(pixel: Float32Array, camera: Pinhole) -> NDArray[np.bool_]:
    u, v = pixel
    return np.asarray((u < 0) | (u > camera.width_px) | (v < 0) | (v > camera.height_px))


def _write_block(
    warped: WarpedImage,
    rows: slice,
    picture: NDArray[np.uint8],
    pixel: Float32Array,
    status: NDArray[np.uint8],
    background: tuple[int, int, int],
) -> None:
    assert warped.source is not None
    shape = warped.status[rows].shape
    lost = np.flatnonzero(status >= WarpStatus.OUTSIDE)
    # What is lost is sampled at a harmless place and painted over.
    pixel[:, lost] = 0.5
    colour = sampling.bilinear_at(picture, pixel[0].reshape(shape), pixel[1].reshape(shape))
    pixel[:, lost] = np.nan
    colour.reshape(-1, 3)[lost] = background
    warped.colour[rows] = colour
    warped.status[rows] = status.reshape(shape)
    warped.source[rows, :, 0], warped.source[rows, :, 1] = pixel.reshape(2, *shape)


@dataclass(frozen=True, eq=False)
class _InverseDepths:
    """An inverse depth image that is read without mixing surfaces.

    Attributes:
        image: (height, width) float32.
        is_edge: (height + 1, width + 1); entry (i, j) says that the texels that touch the corner (j, i), counted from
            the image's outer corner, belong to several surfaces.
        largest: the nearest surface's.
    """

    image: Float32Array
    is_edge: NDArray[np.bool_]
    largest: np.float32

    @classmethod
    def of(cls, image: Float32Array) -> "_InverseDepths":
        padded = cv2.copyMakeBorder(image, 1, 1, 1, 1, cv2.BORDER_REPLICATE)
        square = np.ones((2, 2), np.uint8)
        low = np.asarray(cv2.erode(padded, square, anchor=(0, 0)))[:-1, :-1]
        high = np.asarray(cv2.dilate(padded, square, anchor=(0, 0)))[:-1, :-1]
        return cls(image, high - low > np.float32(SURFACE_STEP) * high, image.max())

    def at(self, pixel: Float32Array) -> Float32Array:
        """Bilinear within a surface, the nearest texel at its edges; beyond the image its outermost texels.

        (2, n) positions -> (n,).
        """
        height, width = self.image.shape
        u = np.clip(pixel[0], np.float32(0), np.float32(width))
        v = np.clip(pixel[1], np.float32(0), np.float32(height))
        value = sampling.bilinear_at(self.image, u, v)
        corner = (v + np.float32(0.5)).astype(np.intp) * (width + 1) + (u + np.float32(0.5)).astype(np.intp)
        edge = np.flatnonzero(self.is_edge.reshape(-1).take(corner))
        column = np.minimum(u[edge].astype(np.intp), width - 1)
        row = np.minimum(v[edge].astype(np.intp), height - 1)
        value[edge] = self.image[row, column]
        return value

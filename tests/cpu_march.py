"""March rays through the depth of an intermediate image on the CPU; `warp.py` states the algorithm."""

from dataclasses import dataclass, fields, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render.geometry.pinhole import Pinhole
from wlr_render.numerics.arrays import BoolArray, Float32Array
from wlr_render.rendering import sampling
from wlr_render.rendering.warp import (
    CONVERGED_PX,
    MAX_REFINEMENTS,
    MAX_STEPS,
    STEP_PX,
    SURFACE_STEP,
    TILE,
    WarpStatus,
)


@dataclass(frozen=True, eq=False)
class EpipolarLines:
    """The epipolar lines of rays, by inverse depth w: s(w) = at_infinity + w shift.

    Attributes:
        at_infinity, shift: (2, n) float32 pixels, and pixels times metres; 0 where there is no ray.
        missing: (n,) where there is no ray.
    """

    at_infinity: Float32Array
    shift: Float32Array
    missing: BoolArray

    @classmethod
    def of(cls, camera: Pinhole, slope_offset: Float32Array) -> "EpipolarLines":
        """Of rays (4, ...) in the image's camera frame."""
        flat = slope_offset.reshape(4, -1)
        missing = np.asarray(~np.isfinite(flat).all(axis=0))
        if missing.any():
            flat = np.where(missing, np.float32(0), flat)
        focal = (camera.focal_px * [1, -1]).astype(np.float32)[:, None]
        return cls(focal * flat[:2] + camera.centre_px.astype(np.float32)[:, None], focal * flat[2:], missing)

    def at(self, inverse_depth: Float32Array) -> Float32Array:
        """Positions (2, n)."""
        return np.asarray(self.at_infinity + inverse_depth * self.shift)

    def some(self, index: NDArray[np.intp]) -> "EpipolarLines":
        """Those of a selection."""
        return EpipolarLines(
            self.at_infinity.take(index, axis=1), self.shift.take(index, axis=1), self.missing.take(index)
        )


@dataclass(frozen=True, eq=False)
class InverseDepths:
    """An inverse depth image that is read without mixing surfaces.

    Attributes:
        image: (height, width) float32.
        is_edge: (height + 1, width + 1); entry (i, j) says that the texels that touch the corner (j, i), counted from
            the image's outer corner, belong to several surfaces.
        low, high: (rows, columns) smallest and largest value in each tile of TILE px and the eight around it.
        whole: the same of the image.
    """

    image: Float32Array
    is_edge: BoolArray
    low: Float32Array
    high: Float32Array
    whole: tuple[np.float32, np.float32]

    @classmethod
    def of(cls, image: Float32Array) -> "InverseDepths":
        """Prepare an inverse depth image."""
        padded = cv2.copyMakeBorder(image, 1, 1, 1, 1, cv2.BORDER_REPLICATE)
        square = np.ones((2, 2), np.uint8)
        low = np.asarray(cv2.erode(padded, square, anchor=(0, 0)))[:-1, :-1]
        high = np.asarray(cv2.dilate(padded, square, anchor=(0, 0)))[:-1, :-1]
        is_edge = high - low > np.float32(SURFACE_STEP) * high
        return cls(image, is_edge, *_around_tiles(image), (image.min(), image.max()))

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
        value[edge] = self.nearest(pixel.take(edge, axis=1))
        return value

    def nearest(self, pixel: Float32Array) -> Float32Array:
        """The texel at (2, n) positions -> (n,)."""
        height, width = self.image.shape
        column = np.clip(pixel[0], 0, width - 1).astype(np.intp)
        row = np.clip(pixel[1], 0, height - 1).astype(np.intp)
        return np.asarray(self.image.reshape(-1).take(row * width + column))

    def range_along(
        self, lines: EpipolarLines, px_per_inverse_depth: Float32Array
    ) -> tuple[Float32Array, Float32Array]:
        """Smallest and largest value that the image shows along the paths, (n,) each."""
        height, width = self.image.shape
        u, v = lines.at_infinity + np.float32(0.5) * self.whole[1] * lines.shift
        column = (np.clip(u, 0, width - 1) / np.float32(TILE)).astype(np.intp)
        row = (np.clip(v, 0, height - 1) / np.float32(TILE)).astype(np.intp)
        tile = row * self.low.shape[1] + column
        short = px_per_inverse_depth * self.whole[1] <= np.float32(2 * TILE)
        low = np.where(short, self.low.reshape(-1).take(tile), self.whole[0])
        return low, np.where(short, self.high.reshape(-1).take(tile), self.whole[1])


def _around_tiles(image: Float32Array) -> tuple[Float32Array, Float32Array]:
    height, width = image.shape
    whole_tiles = np.pad(image, ((0, -height % TILE), (0, -width % TILE)), mode="edge")
    tiles = whole_tiles.reshape(whole_tiles.shape[0] // TILE, TILE, -1, TILE)
    square = np.ones((3, 3), np.uint8)
    low, high = (np.ascontiguousarray(x) for x in (tiles.min(axis=(1, 3)), tiles.max(axis=(1, 3))))
    return np.asarray(cv2.erode(low, square)), np.asarray(cv2.dilate(high, square))


def march(depths: InverseDepths, lines: EpipolarLines) -> tuple[Float32Array, NDArray[np.uint8]]:
    """Intersect rays with the depth image: positions (2, n) and status (n,), SEEN or DISOCCLUDED."""
    px_per_inverse_depth = np.sqrt(np.square(lines.shift).sum(axis=0))
    low, high = depths.range_along(lines, px_per_inverse_depth)
    first = depths.nearest(lines.at(high))
    step_count = np.clip(np.ceil(px_per_inverse_depth * (high - low) / np.float32(STEP_PX)), 1, MAX_STEPS)
    # Most paths are one step long and converge at its first query: those need no search.
    met_at = depths.at(lines.at(first))
    converged = (step_count == 1) & (np.abs(met_at - first) * px_per_inverse_depth < np.float32(CONVERGED_PX))
    status = np.full(converged.size, WarpStatus.SEEN, np.uint8)
    left = np.flatnonzero(~converged)
    if left.size:
        search = _Search.start(step_count.take(left), low.take(left), high.take(left), first.take(left))
        found, met_at[left] = _search(depths, lines.some(left), search)
        status[left] = np.where(found, WarpStatus.SEEN, WarpStatus.DISOCCLUDED)
    return lines.at(met_at), status


@dataclass(frozen=True, eq=False)
class _Search:
    """State of rays that have no intersection yet, (m,) each; names as in `shaders/march.glsl`.

    Attributes:
        ray: index among all searched rays.
        step_count, nearest_end, stride: number of steps of the path; its near end and step length, inverse depths.
        step_index: the current step, from 1.
        seen_near, seen_far: inverse depths that the image shows at the ends of the step.
        in_front: whether the ray is in front of what is shown at the near end.
        refining: whether the next query refines an intersection; otherwise it is the far end of the step.
        query: the inverse depth at which the image is read next.
        last_crossing: the inverse depth that stands in if there is no intersection.
        refinements: number of refinements in this step so far.
    """

    ray: NDArray[np.intp]
    step_count: Float32Array
    nearest_end: Float32Array
    stride: Float32Array
    step_index: Float32Array
    seen_near: Float32Array
    seen_far: Float32Array
    in_front: BoolArray
    refining: BoolArray
    query: Float32Array
    last_crossing: Float32Array
    refinements: NDArray[np.int32]

    @classmethod
    def start(cls, step_count: Float32Array, low: Float32Array, high: Float32Array, first: Float32Array) -> "_Search":
        """At the near ends of paths; `first` is what the image shows there."""
        stride = (high - low) / step_count
        refining = step_count == 1
        return cls(
            ray=np.arange(step_count.size),
            step_count=step_count,
            nearest_end=high,
            stride=stride,
            step_index=np.ones_like(step_count),
            seen_near=first,
            seen_far=first,
            in_front=np.ones(step_count.size, bool),
            refining=refining,
            query=np.where(refining, first, high - stride),
            last_crossing=high,
            refinements=np.zeros(step_count.size, np.int32),
        )

    def some(self, index: NDArray[np.intp]) -> "_Search":
        return _Search(**{field.name: getattr(self, field.name).take(index) for field in fields(self)})

    def advance(self, seen: Float32Array) -> "_Search":
        """The state after the image was read where the rays are at `query`, for rays that did not converge there."""
        far_end = self.nearest_end - self.step_index * self.stride
        middle = far_end + np.float32(0.5) * self.stride
        reach = np.float32(1.5) * self.stride
        seen_far = np.where(self.refining, self.seen_far, seen)
        nearer, farther = np.maximum(self.seen_near, seen_far), np.minimum(self.seen_near, seen_far)
        from_front = (nearer >= far_end) | (self.step_index == self.step_count)
        crosses = np.where(self.in_front, from_front, np.abs(seen_far - middle) <= np.float32(0.51) * self.stride)
        start = np.where(np.abs(nearer - middle) <= reach, nearer, farther)
        following = np.where(self.refining, seen, start)
        refinements = np.where(self.refining, self.refinements + 1, 0)
        is_near_step = (self.step_count == 1) | (np.abs(following - middle) <= reach)
        continues = is_near_step & np.where(self.refining, refinements < MAX_REFINEMENTS, crosses)
        misses = ~continues & (self.refining | crosses)
        last_tried = np.where(self.refining, np.maximum(seen, self.query), nearer)
        step_index = self.step_index + ~continues
        return replace(
            self,
            step_index=step_index,
            seen_near=np.where(continues, self.seen_near, seen_far),
            seen_far=seen_far,
            in_front=np.where(continues, self.in_front, seen_far < far_end),
            refining=continues,
            query=np.where(continues, following, self.nearest_end - step_index * self.stride),
            last_crossing=np.where(misses, last_tried, self.last_crossing),
            refinements=refinements,
        )


def _search(depths: InverseDepths, lines: EpipolarLines, search: _Search) -> tuple[BoolArray, Float32Array]:
    """Whether each ray has an intersection, and its inverse depth, or that of the last depth edge crossed."""
    met = np.zeros(search.ray.size, bool)
    inverse_depth = np.empty(search.ray.size, np.float32)
    px_per_inverse_depth = np.sqrt(np.square(lines.shift).sum(axis=0))
    while search.ray.size:
        seen = depths.at(lines.at(search.query))
        converged = search.refining & (np.abs(seen - search.query) * px_per_inverse_depth < np.float32(CONVERGED_PX))
        met[search.ray[converged]] = True
        inverse_depth[search.ray[converged]] = seen[converged]
        search = search.advance(seen)
        ended = ~converged & (search.step_index > search.step_count)
        inverse_depth[search.ray[ended]] = search.last_crossing[ended]
        left = np.flatnonzero(~converged & ~ended)
        search, lines = search.some(left), lines.some(left)
        px_per_inverse_depth = px_per_inverse_depth.take(left)
    return met, inverse_depth

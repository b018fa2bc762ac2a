"""Ray-scene intersection by Embree; the only module that imports embreex.

World frame. The tree is built once per scene with one geometry per instance, so that Embree's ids are ours. Embree
works in float32.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wlr_render.draw.thread_pool import for_blocks
from wlr_render.numerics.arrays import Float32Array
from wlr_render.scene.scene import Scene, world_positions

_RAYS_PER_BLOCK = 1 << 16


@dataclass(frozen=True, eq=False)
class Intersections:
    """Nearest intersections of rays; the arrays share one shape (...).

    Attributes:
        distance: float32, along the ray in lengths of its direction (metres for unit directions); inf on a miss.
        instance: int32 index into `Scene.instances`, -1 on a miss.
        triangle: int32 index into the instance's mesh, -1 on a miss.
        barycentric_u, barycentric_v: float32 weights of the triangle's second and third corner; 0 on a miss.
    """

    distance: Float32Array
    instance: NDArray[np.int32]
    triangle: NDArray[np.int32]
    barycentric_u: Float32Array
    barycentric_v: Float32Array

    @classmethod
    def misses(cls, count: int) -> "Intersections":
        """Return `count` misses, to be overwritten by `fill`."""
        nothing, zero = np.full((2, count), -1, np.int32), np.zeros((2, count), np.float32)
        return cls(np.full(count, np.inf, np.float32), *nothing, *zero)

    def reshaped(self, shape: tuple[int, ...]) -> "Intersections":
        """Return views of another shape."""
        return Intersections(*(each.reshape(shape) for each in self._arrays()))

    def fill(self, where: slice | NDArray[np.intp], hits: "Intersections") -> None:
        """Write `hits` at some indices."""
        for mine, theirs in zip(self._arrays(), hits._arrays(), strict=True):
            mine[where] = theirs

    def _arrays(self) -> tuple[NDArray[Any], ...]:
        return self.distance, self.instance, self.triangle, self.barycentric_u, self.barycentric_v


class SceneTracer:
    """Intersects rays with one scene."""

    def __init__(self, scene: Scene) -> None:
        # Imported here, because the command line must start without embreex.
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        self.scene = scene
        # Without robust mode, rays aimed at an edge may slip between its two triangles; it costs a few per cent.
        self._embree = EmbreeScene(robust=True)
        for instance in scene.instances:
            mesh = scene.mesh_of(instance)
            position = world_positions(mesh, instance).astype(np.float32)
            TriangleMesh(self._embree, position, mesh.triangles.astype(np.int32))
        # The first query builds the tree, which must not happen in several threads at once.
        self._embree.run(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32))

    def intersect(self, origin: ArrayLike, direction: ArrayLike) -> Intersections:
        """Return the nearest intersection of each ray, on all processors.

        Args:
            origin: (..., 3) world frame, metres; broadcasts against `direction`. float32 is not copied.
            direction: (..., 3) world frame, of any length.

        Returns:
            Intersections of shape (...); a ray with a NaN or an infinity is a miss.
        """
        origin, direction, shape = _flat(origin, direction)
        hits = Intersections.misses(len(direction))

        def trace(block: slice) -> None:
            finite = _finite_rays(origin[block], direction[block])
            if finite is None:
                hits.fill(block, self._run(origin[block], direction[block]))
            else:
                chosen = finite + block.start
                hits.fill(chosen, self._run(origin[chosen], direction[chosen]))

        for_blocks(trace, len(direction), _RAYS_PER_BLOCK)
        return hits.reshaped(shape)

    def _run(self, origin: Float32Array, direction: Float32Array) -> Intersections:
        distance = np.full(len(direction), np.inf, np.float32)
        # Embree shortens the given reach to the hit, in place.
        found = self._embree.run(origin, direction, dists=distance, output=True)
        return Intersections(distance, found["geomID"], found["primID"], found["u"], found["v"])

    def occluded(self, origin: ArrayLike, direction: ArrayLike, distance: ArrayLike) -> NDArray[np.bool_]:
        """Return whether a surface lies on each ray nearer than `distance`; runs on all processors.

        Args:
            origin, direction: see `intersect`.
            distance: (...) in lengths of the direction; may be inf.

        Returns:
            (...) bool; False for a ray with a NaN or an infinity.
        """
        origin, direction, shape = _flat(origin, direction)
        reach = np.broadcast_to(np.asarray(distance, np.float32), shape).reshape(-1)
        result = np.zeros(len(direction), np.bool_)

        def trace(block: slice) -> None:
            finite = _finite_rays(origin[block], direction[block])
            chosen = block if finite is None else finite + block.start
            found = self._embree.run(origin[chosen], direction[chosen], dists=np.array(reach[chosen]), query="OCCLUDED")
            result[chosen] = found != -1

        for_blocks(trace, len(direction), _RAYS_PER_BLOCK)
        return result.reshape(shape)


def _flat(origin: ArrayLike, direction: ArrayLike) -> tuple[Float32Array, Float32Array, tuple[int, ...]]:
    origin, direction = np.broadcast_arrays(np.asarray(origin, np.float32), np.asarray(direction, np.float32))
    return origin.reshape(-1, 3), direction.reshape(-1, 3), direction.shape[:-1]


def _finite_rays(origin: Float32Array, direction: Float32Array) -> NDArray[np.intp] | None:
    """Return the indices of rays without NaN or infinity; None if all are finite, the usual case."""
    if np.isfinite(direction).all() and np.isfinite(origin).all():
        return None
    return np.flatnonzero(np.isfinite(origin).all(axis=1) & np.isfinite(direction).all(axis=1))

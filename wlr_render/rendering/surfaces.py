"""What lies at a hit: normal and albedo of every triangle of a scene, in tables made to be gathered from.

Attributes lie component by component, (k, n), because numpy works fastest along long contiguous rows.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wlr_render.numerics.arrays import Float32Array
from wlr_render.rendering import sampling
from wlr_render.rendering.scene import Instance, Mesh, Scene, world_normals
from wlr_render.rendering.srgb import decode_srgb

IndexArray = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class SurfaceHits:
    """Hits without the misses, component by component.

    Attributes:
        triangle: (n,) number of the triangle over all instances.
        instance: (n,) index into `Scene.instances`.
        u, v: (n,) float32 barycentric weights of the second and third corner.
    """

    triangle: IndexArray
    instance: IndexArray
    u: Float32Array
    v: Float32Array


@dataclass(frozen=True, eq=False)
class Surfaces:
    """Attributes of all triangles and instances of a scene, world frame.

    Attributes:
        first_triangle: (instances,) number of each instance's first triangle.
        normal: (9, triangles) float32; three components at the first corner, then their change towards the second
            and towards the third corner. The others are laid out alike.
        uv: (6, triangles) or None without textures.
        vertex_colour: (9, triangles) or None without vertex colours.
        base_colour: (3, instances) float32 linear.
        texture_of_instance: (instances,) index into `textures`, -1 without one.
        textures: (height + 2, width + 2, 3) float32 linear, with one texel of the opposite edge all around.
    """

    first_triangle: IndexArray
    normal: Float32Array
    uv: Float32Array | None
    vertex_colour: Float32Array | None
    base_colour: Float32Array
    texture_of_instance: IndexArray
    textures: tuple[Float32Array, ...]

    @classmethod
    def of(cls, scene: Scene) -> "Surfaces":
        """Tables of a scene."""
        placed = [(scene.mesh_of(instance), instance) for instance in scene.instances]
        counts = [len(mesh.triangles) for mesh, _ in placed]
        textured = [number for number, mesh in enumerate(scene.meshes) if mesh.texture is not None]
        coloured = any(mesh.vertex_colour is not None for mesh in scene.meshes)
        return cls(
            first_triangle=np.cumsum([0, *counts], dtype=np.intp)[:-1],
            normal=_table([_normals(mesh, instance) for mesh, instance in placed], 3),
            uv=_table([_uvs(mesh) for mesh, _ in placed], 2) if textured else None,
            vertex_colour=_table([_vertex_colours(mesh) for mesh, _ in placed], 3) if coloured else None,
            base_colour=np.array([mesh.base_colour for mesh, _ in placed], np.float32).reshape(-1, 3).T.copy(),
            texture_of_instance=np.array(
                [textured.index(i.mesh) if i.mesh in textured else -1 for i in scene.instances], np.intp
            ),
            textures=tuple(_wrapped_texture(scene.meshes[number]) for number in textured),
        )

    def normals(self, hits: SurfaceHits) -> Float32Array:
        """Interpolated vertex normals of any length, (3, n)."""
        return _interpolated(self.normal, hits)

    def albedo(self, hits: SurfaceHits) -> Float32Array:
        """Base colour times texture times vertex colour, linear, (3, n)."""
        albedo = self.base_colour.take(hits.instance, axis=1)
        if self.vertex_colour is not None:
            albedo *= _interpolated(self.vertex_colour, hits)
        if self.uv is not None:
            self._multiply_textures(albedo, hits, _interpolated(self.uv, hits))
        return albedo

    def _multiply_textures(self, albedo: Float32Array, hits: SurfaceHits, uv: Float32Array) -> None:
        texture = self.texture_of_instance.take(hits.instance)
        for number in np.flatnonzero(np.bincount(texture + 1, minlength=len(self.textures) + 1)[1:]):
            here = np.flatnonzero(texture == number)
            if len(here) == len(texture):
                albedo *= _texels(self.textures[number], uv).T
            else:
                albedo[:, here] *= _texels(self.textures[number], uv[:, here]).T


def _texels(wrapped: Float32Array, uv: Float32Array) -> Float32Array:
    """Bilinear samples (n, 3) of a repeated texture at (2, n), (0, 0) the texture's outer top-left corner."""
    height, width = wrapped.shape[0] - 2, wrapped.shape[1] - 2
    pixel = uv - np.floor(uv)
    pixel *= np.array([[width], [height]], np.float32)
    pixel += 1.0
    return sampling.bilinear_at(wrapped, pixel[0], pixel[1])


def _interpolated(table: Float32Array, hits: SurfaceHits) -> Float32Array:
    rows = table.take(hits.triangle, axis=1, mode="clip").reshape(3, len(table) // 3, hits.triangle.size)
    result, towards_second, towards_third = rows
    result += np.multiply(towards_second, hits.u, out=towards_second)
    result += np.multiply(towards_third, hits.v, out=towards_third)
    return np.asarray(result)


def _table(corners: list[Float32Array], components: int) -> Float32Array:
    """Values at the corners of each instance's triangles, (triangles, 3, k) each -> (3 k, triangles)."""
    joined = np.concatenate([np.zeros((0, 3, components), np.float32), *corners])
    joined[:, 1:] -= joined[:, :1]
    return np.ascontiguousarray(joined.reshape(-1, 3 * components).T, dtype=np.float32)


def _normals(mesh: Mesh, instance: Instance) -> Float32Array:
    return world_normals(mesh, instance).astype(np.float32)[mesh.triangles]


def _uvs(mesh: Mesh) -> Float32Array:
    return np.zeros((len(mesh.triangles), 3, 2), np.float32) if mesh.uv is None else mesh.uv[mesh.triangles]


def _vertex_colours(mesh: Mesh) -> Float32Array:
    if mesh.vertex_colour is None:
        return np.ones((len(mesh.triangles), 3, 3), np.float32)
    return mesh.vertex_colour[mesh.triangles]


def _wrapped_texture(mesh: Mesh) -> Float32Array:
    assert mesh.texture is not None
    return decode_srgb(np.pad(mesh.texture, ((1, 1), (1, 1), (0, 0)), mode="wrap"))

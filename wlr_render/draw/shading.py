"""The shading model in numpy, as in shaders/shading.glsl. Normals and albedo come from tables per triangle.

Attributes are stored by component, (k, n), because numpy works fastest along long contiguous rows.

A surface's colour is albedo * (ambient + sum over lights of light * max(0, n.l)) in linear light (docs/conventions.md,
"Colour"). Lambert's law holds on both sides: the interpolated normal is turned to face the ray's origin.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wlr_render.draw import sampling
from wlr_render.draw.ray_intersections import Intersections, SceneTracer
from wlr_render.numerics.arrays import Float32Array
from wlr_render.numerics.srgb import decode_srgb
from wlr_render.scene.scene import Instance, LightSource, Mesh, Scene, world_normals

IndexArray = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class SurfaceHits:
    """Intersections without the misses, component by component.

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
            and towards the third corner. The other attributes have the same layout.
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
        """Build the tables of a scene."""
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
        """Return interpolated vertex normals of any length, (3, n)."""
        return _interpolated(self.normal, hits)

    def albedo(self, hits: SurfaceHits) -> Float32Array:
        """Return base colour times texture times vertex colour, linear, (3, n)."""
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
                texels = _texels(self.textures[number], uv.take(here, axis=1))
                for row, factor in zip(albedo, texels.T, strict=True):  # indexing rows is faster than columns in NumPy
                    row[here] = row.take(here) * factor


def _texels(wrapped: Float32Array, uv: Float32Array) -> Float32Array:
    """Return bilinear samples (n, 3) of a repeated texture at (2, n); (0, 0) is the texture's outer top-left corner."""
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
    """Convert values at the corners of each instance's triangles, (triangles, 3, k) each, to (3 k, triangles)."""
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


_SHADOW_BIAS = 2e-4
"""Height of a shadow ray's start over its surface, per metre from the viewer (at least one): above float32 rounding."""


@dataclass(frozen=True, eq=False)
class MetSurfaces:
    """The surfaces that rays hit, component by component, without the misses.

    Attributes:
        index: (m,) indices of the rays.
        on_surface: triangle, instance and barycentric weights, (m,) each.
        distance: (m,) float32 along the ray, in lengths of its direction.
        position: (3, m) float32 world frame, metres.
        normal: (3, m) float32 world frame, unit, interpolated between the vertices, facing the ray's origin.
    """

    index: IndexArray
    on_surface: SurfaceHits
    distance: Float32Array
    position: Float32Array
    normal: Float32Array


def meet_surfaces(
    surfaces: Surfaces, hits: Intersections, origin: Float32Array, direction: Float32Array
) -> MetSurfaces:
    """Return the surfaces that rays hit, without light; for the arguments see `shade`."""
    index = np.flatnonzero(hits.instance >= 0)
    instance = hits.instance.take(index).astype(np.intp)
    triangle = surfaces.first_triangle.take(instance) + hits.triangle.take(index)
    on_surface = SurfaceHits(triangle, instance, hits.barycentric_u.take(index), hits.barycentric_v.take(index))
    towards = _components(direction, index)
    distance = hits.distance.take(index)
    position = towards * distance
    position += _components(origin, index)
    normal = _facing(surfaces.normals(on_surface), towards)
    return MetSurfaces(index, on_surface, distance, position, normal)


@dataclass(frozen=True, eq=False)
class Shaded:
    """The rays that hit something, component by component.

    Attributes:
        index: (m,) indices of the rays.
        colour: (3, m) float32 linear RGB, not clipped.
        position: (3, m) float32 world frame, metres.
        normal: (3, m) float32 world frame, unit, facing the ray's origin.
    """

    index: IndexArray
    colour: Float32Array
    position: Float32Array
    normal: Float32Array


def shade(
    scene: Scene,
    surfaces: Surfaces,
    hits: Intersections,
    origin: Float32Array,
    direction: Float32Array,
    shadow_tracer: SceneTracer | None = None,
) -> Shaded:
    """Return the colours of the surfaces that rays hit.

    Args:
        scene: scene with the lights.
        surfaces: surfaces of the same scene.
        hits: (n,) result of `SceneTracer.intersect` for these rays.
        origin, direction: (n, 3) float32 world frame.
        shadow_tracer: tracer of the same scene, if surfaces cast shadows.
    """
    if (hits.instance < 0).all():  # saves a hundred useless calls under the GIL
        nothing = np.empty((3, 0), np.float32)
        return Shaded(np.empty(0, np.intp), nothing, nothing, nothing)
    met = meet_surfaces(surfaces, hits, origin, direction)
    position, normal = met.position, met.normal
    irradiance = np.empty_like(normal)
    irradiance[:] = scene.ambient[:, None]
    for light in scene.lights:
        to_light, strength = _towards_light(light, position, normal)
        if shadow_tracer is not None:
            _hide(strength, light, to_light, _raised(position, normal, met.distance), shadow_tracer)
        for channel in range(3):
            irradiance[channel] += light.colour[channel] * strength
    irradiance *= surfaces.albedo(met.on_surface)
    return Shaded(met.index, irradiance, position, normal)


def _components(vector: Float32Array, index: IndexArray) -> Float32Array:
    """Return the chosen rows of (n, 3) as (3, m)."""
    chosen = vector if len(index) == len(vector) else vector.take(index, axis=0)
    return np.ascontiguousarray(chosen.T)


def _dot(first: Float32Array, second: Float32Array) -> Float32Array:
    result = first[0] * second[0]
    result += first[1] * second[1]
    result += first[2] * second[2]
    return np.asarray(result)


def _facing(normal: Float32Array, direction: Float32Array) -> Float32Array:
    """Return unit normals (3, m) turned against the directions (3, m), in place."""
    length = np.sqrt(_dot(normal, normal))
    scale = np.copysign(np.reciprocal(np.maximum(length, np.float32(1e-30), out=length)), -_dot(normal, direction))
    normal *= scale
    return normal


def _raised(position: Float32Array, normal: Float32Array, distance: Float32Array) -> Float32Array:
    """Return the starts of shadow rays."""
    height = np.maximum(distance, np.float32(1)) * np.float32(_SHADOW_BIAS)
    return np.asarray(position + normal * height)


def _towards_light(
    light: LightSource, position: Float32Array, normal: Float32Array
) -> tuple[Float32Array, Float32Array]:
    """Return vectors to the light, (3, m) or (3, 1), and the light's falloff times n.l, (m,)."""
    vector = light.vector.astype(np.float32)[:, None]
    if light.kind == "directional":
        return -vector, np.maximum(_dot(normal, -vector), np.float32(0))
    to_light = vector - position
    inverse_square = np.reciprocal(np.maximum(_dot(to_light, to_light), np.float32(1e-12)))
    strength = np.maximum(_dot(normal, to_light), np.float32(0))
    strength *= inverse_square
    strength *= np.sqrt(inverse_square)
    return to_light, strength


def _hide(
    strength: Float32Array, light: LightSource, to_light: Float32Array, raised: Float32Array, shadow_tracer: SceneTracer
) -> None:
    """Set the light's strength to 0, in place, where another surface hides the light."""
    lit = np.flatnonzero(strength)
    towards = np.broadcast_to(to_light, raised.shape).T[lit]
    reach = 1.0 if light.kind == "point" else np.inf
    strength[lit[shadow_tracer.occluded(raised.T[lit], towards, reach)]] = 0.0

"""The one shading model, in numpy; shaders/shading.glsl is its twin.

A surface's colour is albedo * (ambient + sum over lights of light * max(0, n.l)) in linear light (docs/conventions.md,
"Colour"). Lambert's law on both sides: the interpolated normal is turned to face the ray's origin.
"""

from dataclasses import dataclass

import numpy as np

from wlr_render.numerics.arrays import Float32Array
from wlr_render.rendering.raytrace import Hits, SceneTracer
from wlr_render.rendering.scene import Light, Scene
from wlr_render.rendering.surfaces import IndexArray, SurfaceHits, Surfaces

_SHADOW_BIAS = 2e-4
"""How far a shadow ray starts above its surface, per metre from the viewer (at least one): beyond float32 rounding."""


@dataclass(frozen=True, eq=False)
class Shaded:
    """The rays that hit something, component by component.

    Attributes:
        index: (m,) which of the rays.
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
    hits: Hits,
    origin: Float32Array,
    direction: Float32Array,
    shadow_tracer: SceneTracer | None = None,
) -> Shaded:
    """Colour of what rays hit.

    Args:
        scene: whose lights shine.
        surfaces: of the same scene.
        hits: of shape (n,), from `SceneTracer.intersect` of these rays.
        origin, direction: (n, 3) float32 world frame.
        shadow_tracer: of the same scene, if surfaces shall cast shadows.
    """
    index = np.flatnonzero(hits.instance >= 0)
    instance = hits.instance.take(index).astype(np.intp)
    triangle = surfaces.first_triangle.take(instance) + hits.triangle.take(index)
    on_surface = SurfaceHits(triangle, instance, hits.barycentric_u.take(index), hits.barycentric_v.take(index))
    towards = _components(direction, index)
    distance = hits.distance.take(index)
    position = towards * distance
    position += _components(origin, index)
    normal = _facing(surfaces.normals(on_surface), towards)
    irradiance = np.empty_like(normal)
    irradiance[:] = scene.ambient[:, None]
    for light in scene.lights:
        to_light, strength = _towards_light(light, position, normal)
        if shadow_tracer is not None:
            _hide(strength, light, to_light, _raised(position, normal, distance), shadow_tracer)
        for channel in range(3):
            irradiance[channel] += light.colour[channel] * strength
    irradiance *= surfaces.albedo(on_surface)
    return Shaded(index, irradiance, position, normal)


def _components(vector: Float32Array, index: IndexArray) -> Float32Array:
    """Chosen rows of (n, 3), as (3, m)."""
    chosen = vector if len(index) == len(vector) else vector.take(index, axis=0)
    return np.ascontiguousarray(chosen.T)


def _dot(first: Float32Array, second: Float32Array) -> Float32Array:
    result = first[0] * second[0]
    result += first[1] * second[1]
    result += first[2] * second[2]
    return np.asarray(result)


def _facing(normal: Float32Array, direction: Float32Array) -> Float32Array:
    """Unit normals (3, m) turned against the directions (3, m), in place."""
    length = np.sqrt(_dot(normal, normal))
    scale = np.copysign(np.reciprocal(np.maximum(length, np.float32(1e-30), out=length)), -_dot(normal, direction))
    normal *= scale
    return normal


def _raised(position: Float32Array, normal: Float32Array, distance: Float32Array) -> Float32Array:
    """Starts of shadow rays."""
    height = np.maximum(distance, np.float32(1)) * np.float32(_SHADOW_BIAS)
    return np.asarray(position + normal * height)


def _towards_light(light: Light, position: Float32Array, normal: Float32Array) -> tuple[Float32Array, Float32Array]:
    """Vectors to the light, (3, m) or (3, 1), and the light's falloff times n.l, (m,)."""
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
    strength: Float32Array, light: Light, to_light: Float32Array, raised: Float32Array, shadow_tracer: SceneTracer
) -> None:
    """Put out the light, in place, where something stands before it."""
    lit = np.flatnonzero(strength)
    towards = np.broadcast_to(to_light, raised.shape).T[lit]
    reach = 1.0 if light.kind == "point" else np.inf
    strength[lit[shadow_tracer.occluded(raised.T[lit], towards, reach)]] = 0.0

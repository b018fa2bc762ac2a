"""Scenes: meshes, their instances in the world, lights. Plain arrays; no file formats, no GPU.

World frame: OpenXR (x right, y up, -z forward), metres. Colours are linear RGB, 0..1; encoding to sRGB is the last
step of drawing. `shading.py` defines the one shading model, the same in GLSL and numpy.
"""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from wlr_render.numerics.arrays import Float32Array


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles with one material.

    Attributes:
        name: name for messages.
        position: (vertices, 3) float32, mesh frame, metres.
        normal: (vertices, 3) float32 unit.
        triangles: (triangles, 3) uint32.
        base_colour: (3,) float32 linear RGB factor (glTF baseColorFactor).
        uv: (vertices, 2) float32 or None; (0, 0) is the top-left corner of the texture, v down (as glTF).
        texture: (height, width, 3) uint8 sRGB or None; repeats outside 0..1, bilinear.
        vertex_colour: (vertices, 3) float32 linear or None.
    """

    name: str
    position: Float32Array
    normal: Float32Array
    triangles: NDArray[np.uint32]
    base_colour: Float32Array = field(default_factory=lambda: np.ones(3, np.float32))
    uv: Float32Array | None = None
    texture: NDArray[np.uint8] | None = None
    vertex_colour: Float32Array | None = None

    @cached_property
    def corners(self) -> NDArray[np.float64]:
        """Corners (8, 3) of the bounding box, mesh frame."""
        bounds = np.stack([self.position.min(axis=0), self.position.max(axis=0)]).astype(np.float64)
        x, y, z = np.meshgrid(*bounds.T)
        return np.stack([x, y, z], axis=-1).reshape(-1, 3)


@dataclass(frozen=True, eq=False)
class Instance:
    """One placement of a mesh.

    Attributes:
        name: name for messages and pictures.
        mesh: index into `Scene.meshes`.
        world_from_mesh: (4, 4) float64; rotation, uniform or non-uniform scale, translation.
    """

    name: str
    mesh: int
    world_from_mesh: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LightSource:
    """A directional or point light.

    Attributes:
        kind: "directional" or "point".
        vector: (3,) for "directional" the unit direction in which the light travels, for "point" its position
            (metres); world frame.
        colour: (3,) linear RGB times intensity; for a point light the value at 1 m, falling with 1 / distance^2.
        name: name for messages.
    """

    kind: str
    vector: NDArray[np.float64]
    colour: Float32Array
    name: str = ""


@dataclass(frozen=True, eq=False)
class Scene:
    """Meshes, instances and lights in the world.

    Attributes:
        name: name for messages.
        meshes, instances, lights: as above.
        ambient: (3,) linear RGB added to every surface's irradiance.
        background: (3,) linear RGB where nothing is hit.
        not_drawn: content of mesh files that is not drawn, one text per entry.
    """

    name: str
    meshes: tuple[Mesh, ...]
    instances: tuple[Instance, ...]
    lights: tuple[LightSource, ...]
    ambient: Float32Array = field(default_factory=lambda: np.full(3, 0.25, np.float32))
    background: Float32Array = field(default_factory=lambda: np.zeros(3, np.float32))
    not_drawn: tuple[str, ...] = ()

    @property
    def warnings(self) -> list[str]:
        """One sentence that lists the content of mesh files that is not drawn, if there is any."""
        if not self.not_drawn:
            return []
        return [f"Surfaces are drawn matt and opaque by every method. Not drawn: {'; '.join(self.not_drawn)}."]

    def bright_lights(self) -> dict[str, float]:
        """Return the lights that alone make a white surface brighter than white: the factor, by name.

        For a point light the surface is in the middle of the nearest instance.
        """
        found: dict[str, float] = {}
        for light in self.lights:
            brightness = float(light.colour.max())
            if light.kind == "point":
                places = [
                    world_positions(self.mesh_of(each), each).mean(axis=0) - light.vector for each in self.instances
                ]
                brightness /= max(float(np.min(np.sum(np.square(places), axis=1))), 1e-6)
            if brightness > 1.0:
                found[light.name] = max(found.get(light.name, 0.0), brightness)
        return found

    @property
    def triangle_count(self) -> int:
        """Number of triangles over all instances."""
        return sum(len(self.meshes[instance.mesh].triangles) for instance in self.instances)

    def mesh_of(self, instance: Instance) -> Mesh:
        """Return the mesh that an instance places."""
        return self.meshes[instance.mesh]

    @cached_property
    def bounds(self) -> NDArray[np.float64]:
        """Lowest and highest corner (2, 3) of all instances, world frame."""
        corners = [world_positions(self.mesh_of(instance), instance) for instance in self.instances]
        return np.stack([np.min([c.min(0) for c in corners], 0), np.max([c.max(0) for c in corners], 0)])


def world_positions(mesh: Mesh, instance: Instance) -> NDArray[np.float64]:
    """Return the vertices (vertices, 3) of an instance in the world."""
    matrix = instance.world_from_mesh
    return np.asarray(mesh.position @ matrix[:3, :3].T + matrix[:3, 3])


def world_normals(mesh: Mesh, instance: Instance) -> NDArray[np.float64]:
    """Return unit vertex normals of an instance in the world, (vertices, 3): by the inverse transpose."""
    turned = mesh.normal @ np.linalg.inv(instance.world_from_mesh[:3, :3])
    return np.asarray(turned / np.maximum(np.linalg.norm(turned, axis=1, keepdims=True), 1e-30))

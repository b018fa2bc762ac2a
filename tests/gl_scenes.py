"""Small scenes whose pictures are known in closed form, and the shipped ones, read once."""

from collections.abc import Iterable
from functools import lru_cache
from typing import Any

import numpy as np

from wlr_render.geometry import transforms
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.numerics.arrays import FloatArray
from wlr_render.scene.scene import Instance, LightSource, Mesh, Scene
from wlr_render.scene.scene_file import load_scene
from wlr_render.warp.view import View

shipped_scene = lru_cache(load_scene)

OFF_CENTRE = Pinhole(64, 48, np.array([-0.5, -0.3]), np.array([0.3, 0.3]))


def view(
    camera: Pinhole = OFF_CENTRE,
    viewpoint: tuple[float, float, float] = (0.0, 0.0, 0.0),
    world_from_device: FloatArray | None = None,
) -> View:
    return View(camera, np.array(viewpoint, float), np.eye(4) if world_from_device is None else world_from_device)


def quad(low: Iterable[float], high: Iterable[float], z: float = 0.0, **material: Any) -> Mesh:
    """A rectangle facing +z; uv (0, 0) at its upper left corner."""
    (x0, y0), (x1, y1) = low, high
    position = np.array([[x0, y1, z], [x1, y1, z], [x1, y0, z], [x0, y0, z]], np.float32)
    normal = np.tile(np.array([0, 0, 1], np.float32), (4, 1))
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
    return Mesh("quad", position, normal, np.array([[0, 2, 1], [0, 3, 2]], np.uint32), uv=uv, **material)


def cube(size: float = 1.0) -> Mesh:
    """A cube about the origin, flat normals, one vertex colour per face."""
    face = quad((-0.5, -0.5), (0.5, 0.5), 0.5)
    turns = [transforms.rotation_about("y", k * np.pi / 2) for k in range(4)]
    turns += [transforms.rotation_about("x", k * np.pi / 2) for k in (1, -1)]
    position = np.concatenate([face.position @ turn.T for turn in turns]) * size
    normal = np.concatenate([face.normal @ turn.T for turn in turns])
    triangles = np.concatenate([face.triangles + 4 * k for k in range(6)]).astype(np.uint32)
    colour = np.repeat(np.random.default_rng(3).uniform(0.2, 1.0, (6, 3)), 4, axis=0)
    return Mesh(
        "cube",
        position.astype(np.float32),
        normal.astype(np.float32),
        triangles,
        vertex_colour=colour.astype(np.float32),
    )


def at(x: float, y: float, z: float, turn: FloatArray | None = None) -> FloatArray:
    return transforms.rigid(np.eye(3) if turn is None else turn, np.array([x, y, z], float))


def unlit(*placed: tuple[Mesh, FloatArray], background: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Scene:
    """A scene of (mesh, world_from_mesh) pairs that shows its colours as they are; equal meshes are shared."""
    meshes = list(dict.fromkeys(mesh for mesh, _ in placed))
    instances = tuple(Instance(f"i{k}", meshes.index(mesh), pose) for k, (mesh, pose) in enumerate(placed))
    return Scene("test", tuple(meshes), instances, (), np.ones(3, np.float32), np.array(background, np.float32))


def lit(*placed: tuple[Mesh, FloatArray]) -> Scene:
    """The same under a point and a directional light."""
    lights = (
        LightSource("point", np.array([0.4, 0.8, 0.3]), np.array([0.9, 0.8, 0.7], np.float32)),
        LightSource("directional", np.array([-0.6, 0.0, -0.8]), np.array([0.1, 0.2, 0.3], np.float32)),
    )
    scene = unlit(*placed)
    return Scene("lit", scene.meshes, scene.instances, lights, np.full(3, 0.1, np.float32))

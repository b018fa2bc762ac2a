"""A scene as a GLB file, written by trimesh; colours go to 0..1 in 8 bits."""

from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from PIL import Image

from wlr_render.geometry import transforms
from wlr_render.geometry.directions import normalised
from wlr_render.io.atomic_files import write_bytes
from wlr_render.numerics.arrays import FloatArray
from wlr_render.scene.gltf_document import LIGHTS as EXTENSION
from wlr_render.scene.scene import LightSource, Mesh, Scene


def save_glb(scene: Scene, path: Path) -> Path:
    """Write meshes, instances and lights; ambient light and background have no place in glTF."""
    target = trimesh.Scene()
    keys = [f"{index} {mesh.name}" for index, mesh in enumerate(scene.meshes)]
    for key, mesh in zip(keys, scene.meshes, strict=True):
        target.geometry[key] = _trimesh_of(mesh)
    for index, instance in enumerate(scene.instances):
        node = f"{index} {instance.name}"
        target.graph.update(node, geometry=keys[instance.mesh], matrix=instance.world_from_mesh)
    if scene.lights:
        target.metadata["gltf_extensions"] = {EXTENSION: {"lights": [_stated(light) for light in scene.lights]}}
    for index, light in enumerate(scene.lights):
        extension = {"gltf_extensions": {EXTENSION: {"light": index}}}
        target.graph.update(f"light {index}", matrix=_world_from_light(light), metadata=extension)
    return write_bytes(path, target.export(file_type="glb", include_normals=True))


def _trimesh_of(mesh: Mesh) -> trimesh.Trimesh:
    material = trimesh.visual.material.PBRMaterial(
        baseColorFactor=[*np.clip(mesh.base_colour, 0, 1).tolist(), 1.0],
        baseColorTexture=None if mesh.texture is None else Image.fromarray(mesh.texture),
        metallicFactor=0.0,
        roughnessFactor=1.0,
        doubleSided=True,
    )
    uv = None if mesh.uv is None else mesh.uv * [1, -1] + [0, 1]
    visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    if mesh.vertex_colour is not None:
        colour = np.round(np.clip(mesh.vertex_colour, 0, 1) * 255).astype(np.uint8)
        visual.vertex_attributes["color"] = np.pad(colour, ((0, 0), (0, 1)), constant_values=255)
    return trimesh.Trimesh(mesh.position, mesh.triangles, vertex_normals=mesh.normal, visual=visual, process=False)


def _stated(light: LightSource) -> dict[str, Any]:
    """Colours are 0..1 in glTF; what is beyond goes into the intensity."""
    peak = max(float(light.colour.max()), 1e-9)
    return {"type": light.kind, "color": (light.colour / peak).tolist(), "intensity": peak * np.pi}


def _world_from_light(light: LightSource) -> FloatArray:
    """(4, 4) of a node that carries the light."""
    if light.kind == "point":
        return transforms.rigid(np.eye(3), light.vector)
    back = -light.vector
    right = normalised(np.cross(np.eye(3)[np.argmin(np.abs(back))], back))
    return transforms.rigid(np.stack([right, np.cross(back, right), back], axis=-1), np.zeros(3))

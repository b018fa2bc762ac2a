"""Meshes, their placements and lights from GLB, glTF, OBJ and PLY files: the only module that imports trimesh.

A glTF light shines along its node's -z axis. glTF's matt surface reflects 1/pi of the light, ours all of it, so an
intensity is divided by pi.

Colours become linear: material factors and glTF's vertex colours are so already, vertex colours of OBJ and PLY are
sRGB. trimesh keeps glTF's factors in 8 bits. Opacity is ignored, and metallic materials are drawn as matt ones.
"""

import io
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import normalised
from wlr_render.numerics.arrays import Float32Array
from wlr_render.rendering.scene import Instance, LightSource, Mesh
from wlr_render.rendering.srgb import decode_srgb

EXTENSION = "KHR_lights_punctual"
SUFFIXES = (".glb", ".gltf", ".obj", ".ply")
_GLTF = (".glb", ".gltf")
_IMAGES = (".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tga", ".tif", ".tiff")
_UNDERSTOOD = {EXTENSION, "KHR_materials_unlit", "KHR_materials_pbrSpecularGlossiness", "EXT_texture_webp"}


def lights_of_graph(path: Path, metadata: dict[str, Any], graph: Any) -> tuple[LightSource, ...]:
    """The lights of a scene graph that trimesh has read, world frame.

    Raises:
        BadInputError: a light that is neither directional nor a point.
    """
    listed = metadata.get("gltf_extensions", {}).get(EXTENSION, {}).get("lights", [])
    lights = []
    for (_, node), edge in graph.transforms.edge_data.items():
        used = (edge.get("metadata") or {}).get("gltf_extensions", {}).get(EXTENSION)
        if used is None:
            continue
        stated = listed[used["light"]]
        kind = stated["type"]
        if kind not in ("directional", "point"):
            raise BadInputError(f"{path}: light '{node}' is of kind '{kind}'; make it a point or directional light.")
        matrix = np.array(graph.get(node)[0], dtype=np.float64)
        vector = matrix[:3, 3] if kind == "point" else normalised(-matrix[:3, 2])
        colour = np.array(stated.get("color", (1.0, 1.0, 1.0))) * stated.get("intensity", 1.0) / np.pi
        lights.append(LightSource(kind, vector, colour.astype(np.float32)))
    return tuple(lights)


@dataclass(frozen=True, eq=False)
class MeshFile:
    """What a file holds, in its own frame (glTF's is x right, y up, metres; the others' is as the file has it).

    Attributes:
        meshes: one per material and mesh of the file.
        instances: one per placement in the file's scene graph.
        lights: directional and point lights.
    """

    meshes: tuple[Mesh, ...]
    instances: tuple[Instance, ...]
    lights: tuple[LightSource, ...]


def load_meshes(path: str | Path) -> MeshFile:
    """Read a GLB, glTF, OBJ or PLY file.

    Raises:
        BadInputError: a missing, unreadable or empty file, one that needs a glTF extension that is not understood, a
            missing or broken texture or material file, vertices that are not finite, an index out of range, a light
            of another kind.
    """
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise BadInputError(f"{path}: cannot read '{path.suffix}' files, only {', '.join(SUFFIXES)}.")
    if not path.is_file():
        raise BadInputError(f"{path}: there is no such file.")
    _require_understood(path)
    source = _loaded(path)
    names = [name for name, geometry in source.geometry.items() if hasattr(geometry, "faces")]
    meshes = tuple(_mesh(path, name, source.geometry[name]) for name in names)
    if not meshes:
        raise BadInputError(f"{path}: holds no triangles; export it again with faces.")
    placed = [(node, *source.graph.get(node)) for node in source.graph.nodes_geometry]
    instances = tuple(
        Instance(str(node), names.index(name), np.array(matrix, dtype=np.float64))
        for node, matrix, name in placed
        if name in names
    )
    return MeshFile(meshes, instances, lights_of_graph(path, source.metadata, source.graph))


def _require_understood(path: Path) -> None:
    """Refuse a glTF file that says it cannot be drawn without an extension that is not understood here."""
    if path.suffix.lower() not in _GLTF:
        return
    content = path.read_bytes()
    if path.suffix.lower() == ".glb":
        # A GLB is a 12-byte header, then chunks of length, type, content, the first of which is the JSON.
        content = content[20 : 20 + int.from_bytes(content[12:16], "little")]
    try:
        required = set(json.loads(content).get("extensionsRequired", []))
    except (ValueError, AttributeError) as error:
        raise BadInputError(f"{path}: is not a glTF file ({error}).") from error
    if required - _UNDERSTOOD:
        unknown = ", ".join(sorted(required - _UNDERSTOOD))
        raise BadInputError(f"{path}: needs the glTF extension {unknown}; export it again without.")


class _Neighbours:
    """Gives trimesh the files that a file refers to, and keeps what trimesh would pass over in silence."""

    def __init__(self, path: Path) -> None:
        self._folder = path.parent
        self.faults: list[str] = []

    def get(self, name: str) -> bytes:
        """The content of a file beside the one being read."""
        from PIL import Image

        try:
            content = (self._folder / unquote(name.strip())).read_bytes()
            if Path(name.strip()).suffix.lower() in _IMAGES:
                Image.open(io.BytesIO(content)).verify()
        except (OSError, SyntaxError) as error:
            self.faults.append(f"its file {name.strip()} is missing or broken ({type(error).__name__})")
            raise
        return content

    __getitem__ = get


def _loaded(path: Path) -> Any:
    """The file as a trimesh.Scene, with everything that it refers to."""
    import trimesh

    neighbours = _Neighbours(path)
    try:
        source = trimesh.load_scene(str(path), process=False, resolver=neighbours)
    except Exception as error:
        reason = neighbours.faults[0] if neighbours.faults else f"{type(error).__name__}: {error}"
        raise BadInputError(f"{path}: cannot be read as a mesh ({reason}); export it again.") from error
    if neighbours.faults:
        raise BadInputError(f"{path}: {neighbours.faults[0]}; put it beside this one.")
    return source


def _mesh(path: Path, name: str, source: Any) -> Mesh:
    """One trimesh.Trimesh as our Mesh."""
    position, triangles = np.asarray(source.vertices, dtype=np.float64), np.asarray(source.faces)
    if not np.isfinite(position).all():
        raise BadInputError(f"{path}: mesh '{name}' has a vertex that is not finite; mend it where it was made.")
    if triangles.size and (triangles.min() < 0 or triangles.max() >= len(position)):
        raise BadInputError(f"{path}: mesh '{name}' refers to a vertex beyond its {len(position)}; the file is broken.")
    corners = position[triangles]
    doubled_area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    triangles = triangles[doubled_area > 0]
    if len(triangles) == 0:
        raise BadInputError(f"{path}: mesh '{name}' has no triangles with an area.")
    factor, uv, texture = _material(path, name, source.visual)
    return Mesh(
        name,
        position.astype(np.float32),
        _unit_normals(source),
        triangles.astype(np.uint32),
        base_colour=factor,
        uv=uv,
        texture=texture,
        vertex_colour=_vertex_colour(path, source.visual),
    )


def _unit_normals(source: Any) -> Float32Array:
    """The file's normals or, where it has none, the mean of those of the triangles around."""
    normal = np.array(source.vertex_normals, dtype=np.float64)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    unit = np.where(length > 1e-12, normal / np.maximum(length, 1e-12), [0.0, 1.0, 0.0])
    return unit.astype(np.float32)


def _material(path: Path, name: str, visual: Any) -> tuple[Float32Array, Float32Array | None, NDArray[np.uint8] | None]:
    """Linear factor (3,), uv (vertices, 2) with its origin at the top left, and texture of a mesh."""
    material = getattr(visual, "material", None)
    if material is None:
        return np.ones(3, np.float32), None, None
    if hasattr(material, "baseColorTexture"):
        image, factor = material.baseColorTexture, material.baseColorFactor
        factor = np.ones(3) if factor is None else factor[:3] / 255.0
    else:
        image, factor = material.image, np.array(material.kwargs.get("kd", (1.0, 1.0, 1.0)))
    uv = None if visual.uv is None else np.asarray(visual.uv, dtype=np.float32)[:, :2] * [1, -1] + [0, 1]
    if image is None or uv is None:
        return factor.astype(np.float32), None, None
    try:
        texture = np.asarray(image.convert("RGB"), dtype=np.uint8)
    except (OSError, SyntaxError) as error:
        raise BadInputError(f"{path}: the texture of mesh '{name}' cannot be read ({error}).") from error
    return factor.astype(np.float32), uv.astype(np.float32), texture


def _vertex_colour(path: Path, visual: Any) -> Float32Array | None:
    """Linear colours (vertices, 3), or None."""
    gltf = path.suffix.lower() in _GLTF
    if visual.kind in ("vertex", "face"):
        byte = np.asarray(visual.vertex_colors)[:, :3]
        return (byte / 255).astype(np.float32) if gltf else decode_srgb(byte)
    # Only glTF has colours and a material at once; they are floats, or integers of which the greatest means 1.
    stored = getattr(visual, "vertex_attributes", {}).get("color")
    if stored is None:
        return None
    whole = 1.0 if stored.dtype.kind == "f" else float(np.iinfo(stored.dtype).max)
    return (np.asarray(stored)[:, :3] / whole).astype(np.float32)

"""Meshes, their placements and lights from GLB, glTF, OBJ and PLY files: the only module that imports trimesh.

A glTF light shines along its node's -z axis. glTF's matt surface reflects 1/pi of the light, ours all of it, so an
intensity is divided by pi.

Colours become linear: material factors and glTF's vertex colours are so already, vertex colours of OBJ and PLY are
sRGB. trimesh keeps glTF's factors in 8 bits. Surfaces are matt and opaque; `MeshFile.not_drawn` lists what else
the file states.
"""

import functools
import io
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import normalised
from wlr_render.input_files import (
    LIMITS,
    decode_image,
    inside_folder,
    parsing,
    read_bytes,
    require_picture,
    require_pixels,
    shown,
)
from wlr_render.numerics.arrays import Float32Array
from wlr_render.rendering.gltf_document import GLOSSY, LIGHTS, GltfDocument
from wlr_render.rendering.gltf_losses import SPOT, lost_material_keys, lost_parts
from wlr_render.rendering.mesh_checks import check_obj, check_ply
from wlr_render.rendering.scene import Instance, LightSource, Mesh
from wlr_render.rendering.srgb import decode_srgb

EXTENSION = LIGHTS
SUFFIXES = (".glb", ".gltf", ".obj", ".ply")
_GLTF = (".glb", ".gltf")
_IMAGES = (".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tga", ".tif", ".tiff")
_FARTHEST = 1e6  # metres, and scale of a placement
_BRIGHTEST = 1e6
_LARGEST = 1e12  # of a coordinate, whose squares must fit into 32 bits
_MATT_AND_OPAQUE_OBJ = {"d": r"1(\.0*)?", "tr": "[0. ]+", "ke": "[0. ]+", "pm": "[0. ]+"}
"""Patterns of values with which nothing is lost."""
_UNDERSTOOD = {EXTENSION, "KHR_materials_unlit", GLOSSY, "EXT_texture_webp"}


def lights_of_scene(path: Path, source: Any) -> tuple[LightSource, ...]:
    """The directional and point lights of a trimesh.Scene, world frame.

    Raises:
        BadInputError: a kind that glTF does not have, or a colour out of range.
    """
    graph, geometry = source.graph, source.geometry
    listed = source.metadata.get("gltf_extensions", {}).get(EXTENSION, {}).get("lights", [])
    lights = []
    for (_, node), edge in graph.transforms.edge_data.items():
        used = (edge.get("metadata") or {}).get("gltf_extensions", {}).get(EXTENSION)
        if used is None or ("geometry" in edge and _is_part(geometry[edge["geometry"]])):
            continue
        stated = listed[used["light"]]
        kind = stated["type"]
        if kind == SPOT:
            continue
        if kind not in ("directional", "point"):
            raise BadInputError(
                f"{path}: light {shown(node)} is of kind {shown(kind)}; make it a point or directional light."
            )
        matrix = np.array(graph.get(node)[0], dtype=np.float64)
        vector = matrix[:3, 3] if kind == "point" else normalised(-matrix[:3, 2])
        colour = np.array(stated.get("color", (1.0, 1.0, 1.0))) * stated.get("intensity", 1.0) / np.pi
        if colour.shape != (3,) or not ((colour >= 0) & (colour <= _BRIGHTEST)).all():
            raise BadInputError(f"{path}: light {shown(node)} must have a colour from 0 to {_BRIGHTEST:g}; correct it.")
        lights.append(LightSource(kind, vector, colour.astype(np.float32)))
    return tuple(lights)


@dataclass(frozen=True, eq=False)
class MeshFile:
    """Meshes, placements and lights of a file, in its own frame.

    That of glTF is x right, y up, metres; the others are as the file has them.

    Attributes:
        meshes: one per material and mesh of the file.
        instances: one per placement in the file's scene graph; those of glTF depth first, in the order of the file.
        lights: directional and point lights.
        not_drawn: keys of materials that a matt and opaque surface does not have, and parts of glTF that are not drawn;
            one text per entry, with the file's name.
    """

    meshes: tuple[Mesh, ...]
    instances: tuple[Instance, ...]
    lights: tuple[LightSource, ...]
    not_drawn: tuple[str, ...] = ()


def load_meshes(path: str | Path) -> MeshFile:
    """Read a GLB, glTF, OBJ or PLY file.

    Raises:
        BadInputError: a missing, unreadable or empty file, one that needs a glTF extension that is not understood, a
            missing or broken texture or material file, vertices that are not finite, an index out of range, or a light
            of a kind that glTF does not have.
    """
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise BadInputError(
            f"{path}: cannot read {shown(path.suffix)} files, only {', '.join(SUFFIXES)}; convert it to one of these."
        )
    with parsing(path, "a mesh", "export it again"):
        return _content(path, *_loaded(path))


def _content(path: Path, source: Any, not_drawn: tuple[str, ...]) -> MeshFile:
    names = [name for name, geometry in source.geometry.items() if hasattr(geometry, "faces")]
    with np.errstate(all="ignore"):  # what overflows is refused below
        meshes = tuple(_mesh(path, name, source.geometry[name]) for name in names)
    if not meshes:
        raise BadInputError(f"{path}: holds no triangles; export it again with faces.")
    placed = [(node, *source.graph.get(node)) for node in source.graph.nodes_geometry]
    instances = tuple(
        Instance(_instance_name(source, str(node), name), names.index(name), np.array(matrix, dtype=np.float64))
        for node, matrix, name in placed
        if name in names
    )
    for instance in instances:
        matrix = instance.world_from_mesh
        if not np.abs(matrix).max() < _FARTHEST or not np.linalg.matrix_rank(matrix) == 4:
            raise BadInputError(f"{path}: node {shown(instance.name)} has no size or no finite place; export it again.")
    return MeshFile(meshes, instances, lights_of_scene(path, source), not_drawn)


def _is_part(geometry: Any) -> bool:
    """Whether the geometry is one of several primitives of a glTF mesh."""
    return bool(geometry.metadata.get("from_gltf_primitive"))


def _instance_name(source: Any, node: str, mesh: str) -> str:
    """The node's name; trimesh gives nodes of its own, with a random name, to meshes of several primitives."""
    return f"{source.graph.transforms.parents[node]}/{mesh}" if _is_part(source.geometry[mesh]) else node


class _Neighbours:
    """Gives trimesh the files that a file refers to, and keeps what trimesh would pass over in silence."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._left = LIMITS.mesh_bytes
        self.file_name = path.name
        self.faults: list[BadInputError] = []
        self.get = functools.cache(self._get)

    def __getitem__(self, name: str) -> bytes:
        return self.get(name)

    def _get(self, name: str) -> bytes:
        """The content of a file beside the one being read."""
        try:
            file = inside_folder(self._path.parent, unquote(name.strip()), str(self._path))
            if not file.is_file():
                raise BadInputError(
                    f"{self._path}: its file {shown(name)[1:-1]} is missing or no regular file; put it beside this one."
                )
            content = read_bytes(file, self._left, "put it beside the mesh")
            self._left -= len(content)
            if file.suffix.lower() in _IMAGES:
                require_picture(f"{self._path}: its file {shown(name)[1:-1]}", content)
        except BadInputError as error:
            self.faults.append(error)
            raise
        return content


def _loaded(path: Path) -> tuple[Any, tuple[str, ...]]:
    """The file as a trimesh.Scene, with everything that it refers to, and what is not drawn."""
    import trimesh

    content, neighbours = read_bytes(path, LIMITS.mesh_bytes), _Neighbours(path)
    suffix = path.suffix.lower()
    document = GltfDocument(path, content) if suffix in _GLTF else None
    materials: Iterable[tuple[str, list[str]]] = ()
    parts: list[str] = []
    if document:
        document.check(_UNDERSTOOD, neighbours.get)
        materials, parts = lost_material_keys(document, neighbours.get), list(lost_parts(document))
        content = document.for_trimesh()
    elif suffix == ".obj":
        check_obj(path, content, neighbours.get)
    else:
        check_ply(path, content)
    source = trimesh.load_scene(io.BytesIO(content), file_type=suffix[1:], process=False, resolver=neighbours)
    if neighbours.faults:
        raise neighbours.faults[0]
    names_of: dict[str, list[str]] = {}
    for name, keys in materials if document else _obj_materials(source):
        if keys:
            names_of.setdefault(", ".join(keys), []).append(name)
    lost = [*(f"{keys} of {', '.join(dict.fromkeys(names))}" for keys, names in names_of.items()), *parts]
    return source, tuple(f"{each} in {path.name}" for each in lost)


def _obj_materials(source: Any) -> Iterator[tuple[str, list[str]]]:
    """Name, and keys that are not drawn, of each material of an OBJ file."""
    materials = [getattr(geometry.visual, "material", None) for geometry in source.geometry.values()]
    for material in filter(None, materials):
        words = {key: " ".join(each) for key, each in material.kwargs.items() if key in _MATT_AND_OPAQUE_OBJ}
        yield (
            shown(material.name),
            [key for key, each in words.items() if not re.fullmatch(_MATT_AND_OPAQUE_OBJ[key], each)],
        )


def _mesh(path: Path, name: str, source: Any) -> Mesh:
    """One trimesh.Trimesh as our Mesh."""
    position, triangles = np.asarray(source.vertices, dtype=np.float64), np.asarray(source.faces)
    if not (np.abs(position) < _LARGEST).all():
        raise BadInputError(
            f"{path}: mesh {shown(name)} has a vertex that is not finite in 32 bits; mend it where it was made."
        )
    if triangles.size and (triangles.min() < 0 or triangles.max() >= len(position)):
        raise BadInputError(
            f"{path}: mesh {shown(name)} refers to a vertex beyond its {len(position)}; export it again."
        )
    corners = position[triangles]
    doubled_area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    triangles = triangles[doubled_area > 0]
    if len(triangles) == 0:
        raise BadInputError(f"{path}: mesh {shown(name)} has no triangles with an area; export it again.")
    factor, uv, texture = _material(path, name, source.visual)
    normal, colour = _unit_normals(source), _vertex_colour(path, source.visual)
    for what, values in (("normal", normal), ("colour", factor), ("colour", colour), ("texture coordinate", uv)):
        if values is not None and not np.isfinite(values).all():
            raise BadInputError(f"{path}: mesh {shown(name)} has a {what} that is not finite; export it again.")
    if factor.min() < 0 or (colour is not None and colour.size and colour.min() < 0):
        raise BadInputError(f"{path}: mesh {shown(name)} has a negative colour; export it again.")
    return Mesh(name, position.astype(np.float32), normal, triangles.astype(np.uint32), factor, uv, texture, colour)


def _unit_normals(source: Any) -> Float32Array:
    """The file's normals or, where it has none, the mean of those of the triangles around."""
    normal = np.array(source.vertex_normals, dtype=np.float64)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    unit = np.where(~(length <= 1e-12), normal / np.maximum(length, 1e-12), [0.0, 1.0, 0.0])
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
    if image is not None and uv is None:
        raise BadInputError(
            f"{path}: mesh {shown(name)} has a texture but no texture coordinates; export it with them."
        )
    if image is None or uv is None:
        return factor.astype(np.float32), None, None
    where, stored = f"{path}: the texture of mesh {shown(name)}", image.fp
    require_pixels(where, image.size)
    try:
        texture = np.asarray(image.convert("RGB"), dtype=np.uint8)
    except (OSError, SyntaxError) as error:
        raise BadInputError(
            f"{where} cannot be read ({error}); replace the picture, or export the mesh again."
        ) from error
    if not texture[-1].any() and isinstance(stored, io.BytesIO):
        # Pillow leaves rows that a PNG lacks black, and says nothing; OpenCV refuses them.
        decode_image(where, stored.getvalue(), cv2.IMREAD_COLOR, "replace the picture, or export the mesh again")
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

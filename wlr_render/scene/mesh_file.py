"""Meshes, their placements and lights from GLB, glTF, OBJ, PLY and STL files.

Colours become linear: material factors and glTF's vertex colours already are, vertex colours of OBJ and PLY are
sRGB. Surfaces are matt and opaque; `MeshFile.not_drawn` lists all other content of the file.
"""

import functools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.io.input_files import LIMITS, as_bad_input, inside_folder, read_bytes, require_picture, shown
from wlr_render.numerics.arrays import Float32Array, FloatArray
from wlr_render.scene.gltf_document import GltfDocument
from wlr_render.scene.gltf_file import read_lights, read_nodes, read_parts, require_place
from wlr_render.scene.gltf_losses import lost_material_keys, lost_parts
from wlr_render.scene.mtl_file import Materials
from wlr_render.scene.obj_file import ObjFile
from wlr_render.scene.ply_file import PlyFile
from wlr_render.scene.raw_mesh import RawMesh, texture_of
from wlr_render.scene.scene import Instance, LightSource, Mesh
from wlr_render.scene.stl_file import stl_meshes

SUFFIXES = (".glb", ".gltf", ".obj", ".ply", ".stl")
_GLTF = (".glb", ".gltf")
_IMAGES = (".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tga", ".tif", ".tiff")
_LARGEST = 1e12  # largest coordinate; its square must fit into a float32


@dataclass(frozen=True, eq=False)
class MeshFile:
    """Meshes, placements and lights of a file, in the file's frame.

    The frame of glTF is x right, y up, in metres; other formats keep the file's axes and units.

    Attributes:
        meshes: one per material and mesh of the file.
        instances: one per placement in the file's scene graph; for glTF depth first, in the order of the file.
        lights: directional and point lights.
        not_drawn: keys of materials that a matt and opaque surface does not have, and parts of glTF that are not drawn;
            one text per entry, with the file's name.
    """

    meshes: tuple[Mesh, ...]
    instances: tuple[Instance, ...]
    lights: tuple[LightSource, ...]
    not_drawn: tuple[str, ...] = ()


def load_meshes(path: str | Path) -> MeshFile:
    """Read a GLB, glTF, OBJ, PLY or STL file.

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
    # The checks refuse values that overflow.
    with as_bad_input(path, "a mesh", "export it again"), np.errstate(all="ignore"):
        return (_gltf_file if path.suffix.lower() in _GLTF else _polygon_file)(path)


def _polygon_file(path: Path) -> MeshFile:
    """Return the meshes of an OBJ, PLY or STL file, each placed once, untransformed."""
    content, neighbours = read_bytes(path, LIMITS.mesh_bytes), _Neighbours(path)
    lost: Iterable[tuple[str, list[str]]] = ()
    parts: Sequence[str] = ()
    kind = path.suffix.lower()
    if kind == ".stl":
        raw = [*stl_meshes(path, content)]
    elif kind == ".obj":
        materials = Materials(path, neighbours)
        obj = ObjFile(path, content, materials)
        raw, lost, parts = [*obj.meshes()], materials.lost(), obj.not_drawn
    else:
        ply = PlyFile(path, content, neighbours)
        raw, parts = [*ply.meshes()], ply.not_drawn
    not_drawn = _named(path, lost, parts)
    meshes = _meshes(path, raw, not_drawn)
    instances = tuple(Instance(mesh.name, number, np.eye(4)) for number, mesh in enumerate(meshes))
    return MeshFile(meshes, instances, (), not_drawn)


def _gltf_file(path: Path) -> MeshFile:
    """Return the meshes of a glTF file, their placements depth first, and its lights."""
    document = GltfDocument(path, read_bytes(path, LIMITS.mesh_bytes), _Neighbours(path).get)
    parts, nodes = [*read_parts(document)], read_nodes(document)
    not_drawn = _named(path, lost_material_keys(document, parts), [*lost_parts(document, nodes)])
    meshes = _meshes(path, [part.raw for part in parts], not_drawn)
    number_of = {mesh.name: number for number, mesh in enumerate(meshes)}
    names_of: dict[int, list[str]] = {}
    for part in parts:
        names_of.setdefault(part.mesh, []).append(part.raw.name)
    instances = []
    for node in nodes:
        names = names_of.get(document.entry("nodes", node.number).get("mesh", -1), [])
        for name in names:
            if name in number_of:
                place = node.name if len(names) == 1 else f"{node.name}/{name}"
                require_place(document, place, node.world_from_node)
                instances.append(Instance(place, number_of[name], node.world_from_node))
    return MeshFile(meshes, tuple(instances), tuple(read_lights(document, nodes)), not_drawn)


class _Neighbours:
    """The files that a mesh file refers to; their total size is limited."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._left = LIMITS.mesh_bytes
        self._is_gltf = path.suffix.lower() in _GLTF  # glTF percent-encodes file names
        self.get = functools.cache(self._get)

    def find(self, names: Sequence[str]) -> str | None:
        """Return the first of these names that exists in the folder of the mesh file."""
        return next((name for name in names if name and (self._path.parent / name).is_file()), None)

    def _get(self, name: str) -> bytes:
        """Return the content of a file in the folder of the mesh file."""
        stated = name.strip()
        file = inside_folder(self._path.parent, unquote(stated) if self._is_gltf else stated, str(self._path))
        where = f"{self._path}: its file {shown(name)[1:-1]}"
        if not file.is_file():
            raise BadInputError(f"{where} is missing or no regular file; put it beside this one.")
        content = read_bytes(file, self._left, "put it beside the mesh")
        self._left -= len(content)
        if file.suffix.lower() in _IMAGES:
            require_picture(where, content)
        return content


def _named(path: Path, materials: Iterable[tuple[str, list[str]]], parts: Sequence[str]) -> tuple[str, ...]:
    """Return a text for each part that is not drawn: keys of materials by name, and parts of the file."""
    names_of: dict[str, list[str]] = {}
    for name, keys in materials:
        if keys:
            names_of.setdefault(", ".join(keys), []).append(name)
    lost = [*(f"{keys} of {', '.join(dict.fromkeys(names))}" for keys, names in names_of.items()), *parts]
    return tuple(f"{each} in {path.name}" for each in lost)


def _meshes(path: Path, raw: Sequence[RawMesh], not_drawn: Sequence[str]) -> tuple[Mesh, ...]:
    """Return checked meshes, without those whose triangles have no area; refuse the file if none is left."""
    meshes = tuple(mesh for each in raw if (mesh := _mesh(path, each)) is not None)
    if raw and not meshes:
        which = f"mesh {shown(raw[0].name)} has" if len(raw) == 1 else "its meshes have"
        raise BadInputError(f"{path}: {which} no triangles with an area; export it again.")
    if not meshes:
        lost = ", ".join(each.removesuffix(f" in {path.name}") for each in not_drawn)
        beside = f" (not drawn: {lost})" if lost else ""
        raise BadInputError(f"{path}: holds no triangles{beside}; export it again with faces.")
    return meshes


def _mesh(path: Path, raw: RawMesh) -> Mesh | None:
    """Return a checked mesh; None if no triangle has an area."""
    name, position, triangles = raw.name, raw.position, raw.triangles
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
        return None
    raw = replace(raw, triangles=triangles) if raw.normal is not None else _flat(raw, triangles)
    assert raw.normal is not None
    mesh = Mesh(
        name,
        raw.position.astype(np.float32),
        _unit_normals(raw.normal),
        raw.triangles.astype(np.uint32),
        raw.base_colour.astype(np.float32),
        None if raw.uv is None else raw.uv.astype(np.float32),
        vertex_colour=None if raw.vertex_colour is None else raw.vertex_colour.astype(np.float32),
    )
    factor, uv, colour = mesh.base_colour, mesh.uv, mesh.vertex_colour
    for what, values in (("normal", mesh.normal), ("colour", factor), ("colour", colour), ("texture coordinate", uv)):
        if values is not None and not np.isfinite(values).all():
            raise BadInputError(f"{path}: mesh {shown(name)} has a {what} that is not finite; export it again.")
    if factor.min() < 0 or (colour is not None and colour.size and colour.min() < 0):
        raise BadInputError(f"{path}: mesh {shown(name)} has a negative colour; export it again.")
    if raw.picture is None:
        return mesh
    if uv is None:
        raise BadInputError(
            f"{path}: mesh {shown(name)} has a texture but no texture coordinates; export it with them."
        )
    return replace(mesh, texture=texture_of(f"{path}: the texture of mesh {shown(name)}", raw.picture))


def _flat(raw: RawMesh, triangles: NDArray[np.int64]) -> RawMesh:
    """Return these triangles of a mesh without normals, each with three vertices and the normal of its plane."""
    corners = raw.position[triangles]
    normal = np.repeat(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), 3, axis=0)
    kept = triangles.ravel()
    return replace(
        raw,
        position=raw.position[kept],
        triangles=np.arange(len(kept)).reshape(-1, 3),
        normal=normal / np.abs(normal).max(axis=1, keepdims=True),
        uv=None if raw.uv is None else raw.uv[kept],
        vertex_colour=None if raw.vertex_colour is None else raw.vertex_colour[kept],
    )


def _unit_normals(normal: FloatArray) -> Float32Array:
    """Scale normals (vertices, 3) to unit length; a normal without length becomes up."""
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    unit = np.where(~(length <= 1e-12), normal / np.maximum(length, 1e-12), [0.0, 1.0, 0.0])
    return unit.astype(np.float32)

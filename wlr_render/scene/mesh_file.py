"""Meshes, their placements and lights from GLB, glTF, OBJ and PLY files: the only module that imports trimesh.

trimesh parses glTF; `obj_file.py` and `ply_file.py` read the others.

A glTF light shines along its node's -z axis. glTF's matt surface reflects 1/pi of the light, ours all of it, so an
intensity is divided by pi.

Colours become linear: material factors and glTF's vertex colours are so already, vertex colours of OBJ and PLY are
sRGB. trimesh keeps glTF's factors in 8 bits. Surfaces are matt and opaque; `MeshFile.not_drawn` lists what else
the file states.
"""

import functools
import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import normalised
from wlr_render.io.input_files import LIMITS, as_bad_input, inside_folder, read_bytes, require_picture, shown
from wlr_render.numerics.arrays import Float32Array, FloatArray
from wlr_render.scene.gltf_arrays import GltfArrays
from wlr_render.scene.gltf_document import GLOSSY, LIGHTS, MOVED, QUANTISED, GltfDocument
from wlr_render.scene.gltf_losses import SPOT, lost_material_keys, lost_parts
from wlr_render.scene.mtl_file import Materials
from wlr_render.scene.obj_file import ObjFile
from wlr_render.scene.ply_file import PlyFile
from wlr_render.scene.raw_mesh import RawMesh, texture_of
from wlr_render.scene.scene import Instance, LightSource, Mesh

EXTENSION = LIGHTS
SUFFIXES = (".glb", ".gltf", ".obj", ".ply")
_GLTF = (".glb", ".gltf")
_IMAGES = (".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tga", ".tif", ".tiff")
_FARTHEST = 1e6  # metres, and scale of a placement
_BRIGHTEST = 1e6
_LARGEST = 1e12  # largest coordinate; its square must fit into a float32
_UNDERSTOOD = {EXTENSION, "KHR_materials_unlit", GLOSSY, "EXT_texture_webp", MOVED, QUANTISED}


def lights_of_scene(path: Path, source: Any) -> tuple[LightSource, ...]:
    """Return the directional and point lights of a trimesh.Scene, world frame.

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
        lights.append(LightSource(kind, vector, colour.astype(np.float32), str(stated.get("name", node))))
    return tuple(lights)


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
    # What overflows is refused by the checks.
    with as_bad_input(path, "a mesh", "export it again"), np.errstate(all="ignore"):
        return (_gltf_file if path.suffix.lower() in _GLTF else _polygon_file)(path)


def _polygon_file(path: Path) -> MeshFile:
    """Return the meshes of an OBJ or PLY file, each placed once where it is."""
    content, neighbours = read_bytes(path, LIMITS.mesh_bytes), _Neighbours(path)
    lost: Iterable[tuple[str, list[str]]] = ()
    file: ObjFile | PlyFile
    if path.suffix.lower() == ".obj":
        materials = Materials(path, neighbours)
        file = ObjFile(path, content, materials)
        raw, lost = [*file.meshes()], materials.lost()
    else:
        file = PlyFile(path, content, neighbours)
        raw = [*file.meshes()]
    not_drawn = _named(path, lost, file.not_drawn)
    meshes = _meshes(path, raw, not_drawn)
    instances = tuple(Instance(mesh.name, number, np.eye(4)) for number, mesh in enumerate(meshes))
    return MeshFile(meshes, instances, (), not_drawn)


def _gltf_file(path: Path) -> MeshFile:
    source, not_drawn = _loaded(path)
    raw = [_of_trimesh(name, geometry) for name, geometry in source.geometry.items() if hasattr(geometry, "faces")]
    meshes = _meshes(path, raw, not_drawn)
    names = [mesh.name for mesh in meshes]
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
    """Return whether the geometry is one of several primitives of a glTF mesh."""
    return bool(geometry.metadata.get("from_gltf_primitive"))


def _instance_name(source: Any, node: str, mesh: str) -> str:
    """Return the node's name; for a mesh of several primitives trimesh adds child nodes with random names."""
    return f"{source.graph.transforms.parents[node]}/{mesh}" if _is_part(source.geometry[mesh]) else node


class _Neighbours:
    """Gives trimesh the files that a file refers to, and keeps what trimesh would pass over in silence."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._left = LIMITS.mesh_bytes
        self._is_gltf = path.suffix.lower() in _GLTF  # glTF percent-encodes file names
        self.file_name = path.name
        self.faults: list[BadInputError] = []
        self.given: dict[str, bytes] = {}
        self.get = functools.cache(self._get)

    def __getitem__(self, name: str) -> bytes:
        return self.given[name] if name in self.given else self.get(name)

    def find(self, names: Sequence[str]) -> str | None:
        """Return the first of these names that exists in the folder of the mesh file."""
        return next((name for name in names if name and (self._path.parent / name).is_file()), None)

    def _get(self, name: str) -> bytes:
        """Return the content of a file in the folder of the mesh file."""
        try:
            file = inside_folder(
                self._path.parent, unquote(name.strip()) if self._is_gltf else name.strip(), str(self._path)
            )
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
    """Return a glTF file as a trimesh.Scene, with all files that it refers to, and texts about parts not drawn."""
    import trimesh

    neighbours = _Neighbours(path)
    document = GltfDocument(path, read_bytes(path, LIMITS.mesh_bytes))
    document.check(_UNDERSTOOD, neighbours.get)
    arrays = GltfArrays(document, neighbours.get)
    materials, parts = lost_material_keys(document, arrays), list(lost_parts(document))
    content, neighbours.given = arrays.for_trimesh()
    source = trimesh.load_scene(io.BytesIO(content), file_type="gltf", process=False, resolver=neighbours)
    if neighbours.faults:
        raise neighbours.faults[0]
    return source, _named(path, materials, parts)


def _named(path: Path, materials: Iterable[tuple[str, list[str]]], parts: Sequence[str]) -> tuple[str, ...]:
    """Return a text for each part that is not drawn: keys of materials by name, and parts of the file."""
    names_of: dict[str, list[str]] = {}
    for name, keys in materials:
        if keys:
            names_of.setdefault(", ".join(keys), []).append(name)
    lost = [*(f"{keys} of {', '.join(dict.fromkeys(names))}" for keys, names in names_of.items()), *parts]
    return tuple(f"{each} in {path.name}" for each in lost)


def _meshes(path: Path, raw: Sequence[RawMesh], not_drawn: Sequence[str]) -> tuple[Mesh, ...]:
    """Return checked meshes, without those whose triangles have no area; refused where none is left."""
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
    """Return a checked mesh; None where no triangle has an area."""
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
    """Return a mesh without normals as these triangles of it, each with three vertices and the normal of its plane."""
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
    """Return unit normals (vertices, 3) of normals of any length; up where one has no length."""
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    unit = np.where(~(length <= 1e-12), normal / np.maximum(length, 1e-12), [0.0, 1.0, 0.0])
    return unit.astype(np.float32)


def _of_trimesh(name: str, source: Any) -> RawMesh:
    """Return a trimesh.Trimesh of a glTF file."""
    visual, factor, uv, picture = source.visual, np.ones(3), None, None
    material = getattr(visual, "material", None)
    if material is not None:
        picture = material.baseColorTexture
        factor = factor if material.baseColorFactor is None else material.baseColorFactor[:3] / 255.0
        if picture is not None and visual.uv is not None:
            uv = np.asarray(visual.uv, dtype=np.float32)[:, :2] * [1, -1] + [0, 1]
    stored = getattr(visual, "vertex_attributes", {}).get("color")
    colour = None if stored is None else np.asarray(stored, dtype=np.float64)[:, :3]
    position, triangles = np.asarray(source.vertices, dtype=np.float64), np.asarray(source.faces)
    normal = np.array(source.vertex_normals, dtype=np.float64) if "vertex_normals" in source._cache else None
    return RawMesh(name, position, triangles, normal, factor, uv, picture, colour)

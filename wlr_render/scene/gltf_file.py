"""Meshes, placements and lights of a glTF file.

A light shines along its node's -z axis. A matt surface reflects 1/pi of the light in glTF, and all of it here, so
intensities are divided by pi. Material factors and vertex colours are linear.
"""

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wlr_render.geometry import transforms
from wlr_render.geometry.directions import normalised
from wlr_render.io.input_files import shown
from wlr_render.numerics.arrays import FloatArray
from wlr_render.scene.gltf_document import GLOSSY, LIGHTS, MOVED, QUANTISED, GltfDocument
from wlr_render.scene.polygons import Triangles, strip_corners
from wlr_render.scene.raw_mesh import RawMesh
from wlr_render.scene.scene import LightSource

FLAT_MODES = {0: "points", 1: "lines", 2: "lines", 3: "lines"}
"""Modes of primitives without triangles, and their names."""
SPOT = "spot"
"""The kind of light that is not drawn."""
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_VECTORS = {"POSITION": (3,), "NORMAL": (3,), "COLOR_0": (3, 4)}
"""Attributes that are read, with their numbers of components."""
_DIELECTRIC = 0.04  # reflectance of surfaces that are not metals
_LUMA = (0.299, 0.587, 0.114)
_DEEPEST = 200
_MOST_NODES = 50_000
_FARTHEST = 1e6  # largest coordinate, metres, and largest scale of a placement
_BRIGHTEST = 1e6


@dataclass(frozen=True, eq=False)
class Part:
    """A primitive with triangles.

    Attributes:
        raw: its triangles, with a name that no other part has.
        mesh: number of its mesh in the file.
        material: number of its material, None without one.
    """

    raw: RawMesh
    mesh: int
    material: int | None


@dataclass(frozen=True, eq=False)
class Node:
    """A node of the scene: its number, its name, which no other node has, and its placement (4, 4)."""

    number: int
    name: str
    world_from_node: FloatArray


def base_texture(material: dict[str, Any]) -> dict[str, Any] | None:
    """Return the reference to the texture that gives a material its colour, or None."""
    rough = material.get("pbrMetallicRoughness", {})
    glossy = material.get("extensions", {}).get(GLOSSY, {})
    used: dict[str, Any] | None = rough.get("baseColorTexture") or glossy.get("diffuseTexture")
    return used


def has_triangles(primitive: dict[str, Any]) -> bool:
    """Return whether a primitive has triangles to draw; glTF requires that one without positions is not drawn."""
    return primitive.get("mode") not in FLAT_MODES and "POSITION" in primitive["attributes"]


def read_parts(document: GltfDocument) -> Iterator[Part]:
    """Return all primitives with triangles, mesh by mesh."""
    names: Counter[str] = Counter()
    for number in range(len(document.entries("meshes"))):
        mesh = document.entry("meshes", number)
        for primitive in mesh["primitives"]:
            if has_triangles(primitive):
                name = _unique(str(mesh.get("name", "GLTF")), names)
                where = f"mesh {document.name_of('meshes', number)}"
                yield Part(_raw_mesh(document, name, where, primitive), number, primitive.get("material"))


def read_nodes(document: GltfDocument) -> list[Node]:
    """Return the nodes of the file's scene, depth first, in the order of the file."""
    if len(nodes := document.entries("nodes")) > _MOST_NODES:
        raise document.fail(f"has {len(nodes)} nodes, more than {_MOST_NODES}")
    if not document.entries("scenes") and "scene" not in document.tree:
        return []
    known: Counter[str] = Counter()
    names = [_unique(str(document.entry("nodes", number).get("name", number)), known) for number in range(len(nodes))]
    roots = document.entry("scenes", document.tree.get("scene", 0)).get("nodes", [])
    found: dict[int, Node] = {}
    left = [(root, np.eye(4), 1) for root in reversed(roots)]
    while left:
        number, parent, depth = left.pop()
        node = document.entry("nodes", number)
        if number in found:
            raise document.fail(f"nodes {number} is its own child, or has two parents")
        if depth > _DEEPEST:
            raise document.fail(f"nests its nodes more than {_DEEPEST} deep")
        placement = parent @ _parent_from_node(document, number, node)
        found[number] = Node(number, names[number], placement)
        left += [(child, placement, depth + 1) for child in reversed(node.get("children", []))]
    return list(found.values())


def require_place(document: GltfDocument, name: str, world_from_mesh: FloatArray) -> None:
    """Refuse an instance that is too far away, or flat."""
    if not np.abs(world_from_mesh).max() < _FARTHEST or not np.linalg.matrix_rank(world_from_mesh) == 4:
        raise document.fail(f"node {shown(name)} has no size or no finite place")


def light_of(document: GltfDocument, node: Node) -> dict[str, Any] | None:
    """Return the entry of a node's light; None without one."""
    used = document.entry("nodes", node.number).get("extensions", {}).get(LIGHTS)
    if used is None:
        return None
    lights = document.tree.get("extensions", {}).get(LIGHTS, {}).get("lights", [])
    light = used.get("light")
    if type(light) is not int or not 0 <= light < len(lights):
        raise document.fail(
            f"nodes {node.number}: 'light' is {shown(light)}, not the number of one of its {len(lights)} lights"
        )
    stated: dict[str, Any] = lights[light]
    return stated


def read_lights(document: GltfDocument, nodes: Sequence[Node]) -> Iterator[LightSource]:
    """Return the directional and point lights of nodes, in the frame of the file."""
    for node in nodes:
        stated = light_of(document, node)
        kind = None if stated is None else stated["type"]
        if stated is None or kind == SPOT:
            continue
        if kind not in ("directional", "point"):
            raise document.fail(
                f"light {shown(node.name)} is of kind {shown(kind)}", "make it a point or directional light"
            )
        matrix = node.world_from_node
        vector = matrix[:3, 3] if kind == "point" else normalised(-matrix[:3, 2])
        colour = np.array(stated.get("color", (1.0, 1.0, 1.0))) * stated.get("intensity", 1.0) / np.pi
        if colour.shape != (3,) or not ((colour >= 0) & (colour <= _BRIGHTEST)).all():
            raise document.fail(f"light {shown(node.name)} must have a colour from 0 to {_BRIGHTEST:g}", "correct it")
        yield LightSource(kind, vector, colour.astype(np.float32), str(stated.get("name", node.name)))


def _unique(name: str, taken: Counter[str]) -> str:
    """Return a name, with a number if it is taken, and count it in `taken`; glTF allows empty names."""
    name = name or "geometry"
    free, number = name, taken[name]
    while free in taken:
        free, number = f"{name}_{number}", number + 1
    taken[name] = number
    taken[free] += 1
    return free


def _raw_mesh(document: GltfDocument, name: str, where: str, primitive: dict[str, Any]) -> RawMesh:
    stated, mode = primitive["attributes"], primitive.get("mode", _TRIANGLES)
    if mode not in (_TRIANGLES, _STRIP, _FAN):
        raise document.fail(
            f"{where} has primitives of mode {shown(mode)}, which are not read", "export it as triangles"
        )
    counts = {len(document.values(accessor)) for accessor in stated.values()}
    if len(counts) > 1:
        raise document.fail(f"{where}: its attributes have {', '.join(map(str, sorted(counts)))} entries, not as many")
    vectors = {key: _vectors(document, where, key, stated[key]) for key in _VECTORS if key in stated}
    triangles = _triangles(document, where, primitive, mode)
    factor, uv, picture = np.ones(3), None, None
    if "material" in primitive:
        material = document.entry("materials", primitive["material"])
        factor = _base_colour(document, where, material)
        if (texture := base_texture(material)) is not None:
            uv = _texture_coordinates(document, where, stated, texture)
            picture = _picture(document, where, texture)
    colour = vectors["COLOR_0"][:, :3] if "COLOR_0" in vectors else None
    return RawMesh(name, vectors["POSITION"], triangles, vectors.get("NORMAL"), factor, uv, picture, colour)


def _vectors(document: GltfDocument, where: str, key: str, accessor: int, components: Sequence[int] = ()) -> FloatArray:
    """Return an attribute as floats; KHR_mesh_quantization allows small integers for positions and normals."""
    values, allowed = document.values(accessor), components or _VECTORS[key]
    is_small = values.dtype.itemsize < 4
    is_plain = key in ("POSITION", "NORMAL") and QUANTISED not in document.tree.get("extensionsUsed", [])
    if values.shape[1] not in allowed or not (values.dtype.kind == "f" or (is_small and not is_plain)):
        kinds = " or ".join(f"VEC{size}" for size in allowed)
        raise document.fail(f"{where}: {key} is not of type {kinds} in floats, as it is read")
    return document.floats(accessor, is_colour=key == "COLOR_0")


def _triangles(document: GltfDocument, where: str, primitive: dict[str, Any], mode: int) -> Triangles:
    """Return triangles (n, 3), also of strips and fans."""
    if "indices" in primitive:
        stored = document.values(primitive["indices"])
        if stored.shape[1] != 1 or stored.dtype.kind != "u":
            raise document.fail(f"{where}: its indices are not of type SCALAR in unsigned integers")
        index = stored[:, 0].astype(np.int64)
    else:
        index = np.arange(len(document.values(primitive["attributes"]["POSITION"])))
    if mode == _STRIP:
        return index[strip_corners(len(index))]
    if mode == _FAN:
        first = np.arange(max(len(index) - 2, 0))
        return index[np.stack([first + 1, first + 2, 0 * first], axis=1)]
    return index[: len(index) // 3 * 3].reshape(-1, 3)


def _base_colour(document: GltfDocument, where: str, material: dict[str, Any]) -> FloatArray:
    """Return the linear colour (3,) of a material; specular-glossiness is used if it has no other base texture."""
    rough = material.get("pbrMetallicRoughness", {})
    glossy = material.get("extensions", {}).get(GLOSSY)
    key, stated = "baseColorFactor", rough
    if glossy is not None and "baseColorTexture" not in rough:
        key, stated = "diffuseFactor", glossy
    factor = stated.get(key, (1.0,) * 4)
    if len(factor) != 4 or not all(0.0 <= value <= 1.0 for value in factor):
        raise document.fail(f"{where}: its '{key}' is {shown(factor)}, not four numbers from 0 to 1")
    colour = np.array(factor[:3], dtype=np.float64)
    if stated is rough or {"diffuseTexture", "specularGlossinessTexture"} & stated.keys():
        return colour
    return _equivalent_base_colour(colour, np.array(stated.get("specularFactor", (1.0,) * 3), dtype=np.float64))


def _equivalent_base_colour(diffuse: FloatArray, specular: FloatArray) -> FloatArray:
    """Return the base colour (3,) of a metal or dielectric that reflects `diffuse` (3,) and `specular` (3,) light.

    The formula is from the converter that the extension's document names.
    """
    of_diffuse, of_specular = (np.sqrt(np.square(colour) @ _LUMA) for colour in (diffuse, specular))
    rest, metallic = (1.0 - specular.max()) / (1.0 - _DIELECTRIC), 0.0
    if of_specular >= _DIELECTRIC:
        half = (of_diffuse * rest + of_specular) / 2.0 - _DIELECTRIC
        root = np.sqrt(max(half**2 - _DIELECTRIC * (_DIELECTRIC - of_specular), 2.5e-7))
        metallic = np.clip((root - half) / _DIELECTRIC, 0.0, 1.0)
    from_diffuse = diffuse * rest / max(1.0 - metallic, 1e-6)
    from_specular = (specular - _DIELECTRIC * (1.0 - metallic)) / max(metallic, 1e-6)
    return np.asarray(np.clip(from_diffuse + metallic**2 * (from_specular - from_diffuse), 0.0, 1.0))


def _texture_coordinates(
    document: GltfDocument, where: str, attributes: dict[str, int], texture: dict[str, Any]
) -> FloatArray:
    """Return coordinates (vertices, 2) of a texture, scaled, rotated and moved by its `KHR_texture_transform`."""
    moved = texture.get("extensions", {}).get(MOVED, {})
    key = f"TEXCOORD_{moved.get('texCoord', texture.get('texCoord', 0))}"
    if key not in attributes:
        raise document.fail(
            f"{where}: its base texture uses {key}, which the mesh lacks", "export it with texture coordinates"
        )
    uv = _vectors(document, where, key, attributes[key], (2,))
    stated = {}
    for name, default in (("offset", (0.0, 0.0)), ("scale", (1.0, 1.0)), ("rotation", 0.0)):
        stated[name] = np.array(moved.get(name, default), dtype=np.float64)
        if stated[name].shape != np.shape(default) or not np.isfinite(stated[name]).all():
            what = "2 finite numbers" if np.shape(default) else "a finite number"
            raise document.fail(f"{where}: '{name}' of its base texture is {shown(moved[name])}, not {what}")
    cosine, sine = np.cos(stated["rotation"]), np.sin(stated["rotation"])
    return np.asarray((uv * stated["scale"]) @ np.array([[cosine, -sine], [sine, cosine]]) + stated["offset"])


def _picture(document: GltfDocument, where: str, texture: dict[str, Any]) -> Any:
    stated = document.entry("textures", texture.get("index"))
    extensions = stated.get("extensions", {})
    number = extensions.get("EXT_texture_webp", {}).get("source", stated.get("source"))
    if number is None:
        kinds = ", ".join(extensions) or "no 'source'"
        raise document.fail(f"{where}: its base texture has no picture that is read ({kinds})", "export PNG or JPEG")
    return document.picture(number)


def _parent_from_node(document: GltfDocument, number: int, node: dict[str, Any]) -> NDArray[np.float64]:
    """Return the transform (4, 4) of a node: its matrix, or its translation, rotation and scale."""
    if "mesh" in node:
        document.entry("meshes", node["mesh"])
    stated = {}
    defaults = {"matrix": np.eye(4).ravel(), "translation": np.zeros(3), "scale": np.ones(3)}
    for key, default in (defaults | {"rotation": np.array([0.0, 0.0, 0.0, 1.0])}).items():
        stated[key] = values = np.array(node.get(key, default), dtype=np.float64)
        if values.shape != default.shape or not np.abs(values).max() < 1e9:
            raise document.fail(
                f"nodes {number}: '{key}' is {shown(node[key])}, not {default.size} finite numbers below 1e9"
            )
    matrix = stated["matrix"].reshape(4, 4).T
    if matrix[3].tolist() != [0, 0, 0, 1]:
        row = shown(node["matrix"][3::4])
        raise document.fail(f"nodes {number}: the last row of 'matrix' is {row}, not 0, 0, 0, 1")
    if abs((length := math.hypot(*stated["rotation"])) - 1.0) > 1e-2:
        raise document.fail(f"nodes {number}: 'rotation' has length {length:g}, not 1")
    turn = transforms.rotation_of_quaternion(stated["rotation"])
    return np.asarray(matrix @ transforms.rigid(turn * stated["scale"], stated["translation"]))

"""The JSON of a glTF file: checks before trimesh parses it, and the content that trimesh reads.

trimesh allocates as many bytes as a header states, and skips parts that it cannot read; the checks refuse both.
"""

import base64
import binascii
import copy
import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import unquote_to_bytes

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.io.input_files import LIMITS, require_picture, shown
from wlr_render.io.toml_files import parse_json

LIGHTS = "KHR_lights_punctual"
GLOSSY = "KHR_materials_pbrSpecularGlossiness"
MOVED = "KHR_texture_transform"
QUANTISED = "KHR_mesh_quantization"
FLAT_MODES = {0: "points", 1: "lines", 2: "lines", 3: "lines"}
"""Modes of primitives without triangles, and their names."""
_READ_MODES = (4, 5, 6)  # triangles, strips and fans of them
_COMPONENT_BYTES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_FLOAT = 5126
_SMALL_INTEGERS = {5120, 5121, 5122, 5123}
_TYPES = {"POSITION": ("VEC3",), "NORMAL": ("VEC3",), "COLOR_0": ("VEC3", "VEC4")}
_UNSIGNED = {5121, 5123, 5125}
_DEEPEST = 200
_MOST_NODES = 50_000

Fetch = Callable[[str], bytes]
"""Name of a file that the mesh refers to -> its content."""


def base_texture(material: dict[str, Any]) -> dict[str, Any] | None:
    """Return the reference to the texture that gives a material its colour, or None."""
    rough = material.get("pbrMetallicRoughness", {})
    glossy = material.get("extensions", {}).get(GLOSSY, {})
    used: dict[str, Any] | None = rough.get("baseColorTexture") or glossy.get("diffuseTexture")
    return used


def coordinates_key(material: dict[str, Any]) -> str:
    """Return the attribute with the texture coordinates of a material's base texture."""
    use = base_texture(material) or {}
    return f"TEXCOORD_{use.get('extensions', {}).get(MOVED, {}).get('texCoord', use.get('texCoord', 0))}"


def has_triangles(primitive: dict[str, Any]) -> bool:
    """Return whether a primitive has triangles to draw; glTF demands that one without positions is not drawn."""
    return primitive.get("mode") not in FLAT_MODES and "POSITION" in primitive["attributes"]


class GltfDocument:
    """The JSON of a glTF file, with checked references between its lists.

    Raises:
        BadInputError: from every method: a reference to nothing, a number out of range, or a part that would not be
            drawn as it is meant.
    """

    def __init__(self, path: Path, content: bytes) -> None:
        """Parse a .gltf or .glb file."""
        self._path, self._binary = path, b""
        self._buffers: dict[int, bytes] = {}
        self._pictures: set[int] = set()
        if path.suffix.lower() == ".glb":
            # A GLB is a 12-byte header, then chunks of length, type, content: the JSON, and the first buffer.
            if (container := int.from_bytes(content[4:8], "little")) != 2:
                raise self.fail(f"is a GLB of version {container}; version 2 is read")
            size = int.from_bytes(content[12:16], "little")
            self._binary = content[28 + size :]
            content = content[20 : 20 + size]
        self.tree = parse_json(path, content.decode("utf-8-sig"), "a glTF file", "export it again")
        version = str(self.tree.get("asset", {}).get("version", "2.0"))
        if not version.startswith("2."):
            raise self.fail(f"is of glTF version {shown(version)}; version 2 is read")

    def fail(self, sentence: str, remedy: str = "export it again") -> BadInputError:
        """Exception for an error in this file; the caller raises it."""
        return BadInputError(f"{self._path}: {sentence}; {remedy}.")

    def entry(self, kind: str, index: Any) -> dict[str, Any]:
        """Return one entry of a list of the file's top level; raise if it is missing."""
        entries = self.entries(kind)
        if type(index) is not int or not 0 <= index < len(entries) or not isinstance(entries[index], dict):
            raise self.fail(f"refers to number {shown(index)} of '{kind}', which has {len(entries)} entries")
        entry: dict[str, Any] = entries[index]
        return entry

    def entries(self, kind: str) -> list[Any]:
        """Return a list of the file's top level, empty where the file has none."""
        entries = self.tree.get(kind, [])
        if not isinstance(entries, list):
            raise self.fail(f"'{kind}' must be a list")
        return entries

    def name_of(self, kind: str, index: int) -> str:
        """Name of a mesh, material, node or animation for messages, in quotes; its number where it has none."""
        return shown(self.entry(kind, index).get("name", f"{kind[:-1].replace('meshe', 'mesh')} {index}"))

    def placed_nodes(self) -> Iterator[int]:
        """Nodes of the scene, depth first, in the order of the file."""
        scenes = self.entries("scenes")
        left = list(reversed(scenes[self.tree.get("scene", 0)].get("nodes", []))) if scenes else []
        while left:
            index = left.pop()
            yield index
            left += reversed(self.entries("nodes")[index].get("children", []))

    def rewritten(self) -> dict[str, Any]:
        """Return a copy of the tree with what trimesh would read wrongly put otherwise.

        Siblings are reversed, because trimesh takes the last one first. Primitives without triangles and cameras are
        left out: trimesh loses the children of their nodes. Textures of specular glossiness, of which trimesh would
        blend the palette, become base textures.
        """
        tree = copy.deepcopy(self.tree)
        for mesh in tree.get("meshes", []):
            mesh["primitives"] = [each for each in mesh["primitives"] if has_triangles(each)]
        for material in tree.get("materials", []):
            _use_base_texture(material)
        for node in tree.get("nodes", []):
            node.pop("camera", None)
            if "mesh" in node and not tree["meshes"][node["mesh"]]["primitives"]:
                del node["mesh"]
            node.get("children", []).reverse()
        for scene in tree.get("scenes", []):
            scene.get("nodes", []).reverse()
        return tree

    def buffer_content(self, number: int, fetch: Fetch) -> bytes:
        """Return the bytes of a buffer: of its uri, or of the GLB's second chunk."""
        if number not in self._buffers:
            buffer = self.entry("buffers", number)
            self._buffers[number] = self.bytes_of(buffer["uri"], fetch) if "uri" in buffer else self._binary
        return self._buffers[number]

    def check(self, understood: set[str], fetch: Fetch) -> None:
        """Check everything that is drawn.

        Args:
            understood: extensions that the file may require.
            fetch: reads the files that it refers to.
        """
        required = self.tree.get("extensionsRequired", [])
        unknown = ", ".join(shown(name) for name in required if name not in understood)
        if unknown:
            raise self.fail(f"needs the glTF extension {unknown}, which is not read".replace("'", ""))
        self._check_buffers(fetch)
        for mesh in range(len(self.entries("meshes"))):
            for primitive in self.entry("meshes", mesh)["primitives"]:
                self._check_primitive(mesh, primitive, fetch)
        self._check_nodes()

    def _whole(self, entry: dict[str, Any], key: str, where: str, default: int | None = None) -> int:
        value = entry.get(key, default)
        if type(value) is not int or not 0 <= value <= LIMITS.mesh_bytes:
            raise self.fail(f"{where}: '{key}' is {shown(value)}, not a whole number from 0 to {LIMITS.mesh_bytes}")
        return value

    def _check_buffers(self, fetch: Fetch) -> None:
        """Check that accessors lie in their views, and that no bytes are used so often that they fill the memory."""
        sizes: dict[int, int] = {}
        for index in range(len(self.entries("buffers"))):
            buffer, where = self.entry("buffers", index), f"buffers {index}"
            content, sizes[index] = self.buffer_content(index, fetch), self._whole(buffer, "byteLength", where)
            if len(content) < sizes[index]:
                name = f", {shown(buffer['uri'])}," if "uri" in buffer else ""
                raise self.fail(f"{where}{name} has {len(content)} bytes, not {sizes[index]}")
        views, viewed, read = [], 0, 0
        for index in range(len(self.entries("bufferViews"))):
            view, where = self.entry("bufferViews", index), f"bufferViews {index}"
            self.entry("buffers", view.get("buffer"))
            views.append(self._whole(view, "byteLength", where))
            if (end := self._whole(view, "byteOffset", where, 0) + views[-1]) > sizes[view["buffer"]]:
                raise self.fail(f"{where} ends at byte {end}, beyond buffers {view['buffer']}")
            viewed += views[-1]
        for index in range(len(self.entries("accessors"))):
            accessor, where = self.entry("accessors", index), f"accessors {index}"
            kind, component = accessor.get("type"), accessor.get("componentType")
            if kind not in COMPONENTS or component not in _COMPONENT_BYTES:
                raise self.fail(f"{where} has type {shown(kind)} of component {shown(component)}")
            row, count = COMPONENTS[kind] * _COMPONENT_BYTES[component], self._whole(accessor, "count", where)
            if "bufferView" in accessor:
                self._check_view(accessor, where, count, row, views)
            if "sparse" in accessor:
                self._check_sparse(accessor["sparse"], f"{where}, sparse", count, row, views)
            read += count * row
        if max(viewed, read) > LIMITS.mesh_bytes:
            raise self.fail(f"uses the same bytes for more than {LIMITS.mesh_bytes / 1e6:g} MB of data")

    def _check_view(self, stated: dict[str, Any], where: str, count: int, row: int, views: Sequence[int]) -> None:
        """Check that `count` rows of `row` bytes lie in the buffer view that an accessor states."""
        view = self.entry("bufferViews", stated.get("bufferView"))
        stride = self._whole(view, "byteStride", where, row)
        end = self._whole(stated, "byteOffset", where, 0) + max(count - 1, 0) * stride + row * (count > 0)
        if end > views[stated["bufferView"]]:
            raise self.fail(f"{where} ends at byte {end}, beyond bufferViews {stated['bufferView']}")

    def _check_sparse(self, sparse: dict[str, Any], where: str, count: int, row: int, views: Sequence[int]) -> None:
        if not all(isinstance(sparse.get(key), dict) for key in ("indices", "values")):
            raise self.fail(f"{where}: lacks 'indices' or 'values'")
        number, component = self._whole(sparse, "count", where), sparse["indices"].get("componentType")
        if number > count or component not in _UNSIGNED:
            raise self.fail(f"{where}: has {number} indices of component {shown(component)} for {count} entries")
        self._check_view(sparse["indices"], where, number, _COMPONENT_BYTES[component], views)
        self._check_view(sparse["values"], where, number, row, views)

    def _check_primitive(self, mesh: int, primitive: dict[str, Any], fetch: Fetch) -> None:
        where, mode = f"mesh {self.name_of('meshes', mesh)}", primitive.get("mode", 4)
        if not has_triangles(primitive):
            return
        if mode not in _READ_MODES:
            raise self.fail(
                f"{where} has primitives of mode {shown(mode)}, which are not read", "export it as triangles"
            )
        counts = set()
        for name, index in primitive["attributes"].items():
            accessor = self.entry("accessors", index)
            counts.add(accessor["count"])
            if name in _TYPES:
                self._check_type(where, name, accessor, _TYPES[name])
        if len(counts) > 1:
            raise self.fail(f"{where}: its attributes have {', '.join(map(str, sorted(counts)))} entries, not as many")
        if "indices" in primitive:
            accessor = self.entry("accessors", primitive["indices"])
            if accessor["type"] != "SCALAR" or accessor["componentType"] not in _UNSIGNED:
                raise self.fail(f"{where}: its indices are not of type SCALAR in unsigned integers")
        if "material" in primitive:
            self._check_material(where, primitive, self.entry("materials", primitive["material"]), fetch)

    def _check_type(self, where: str, name: str, accessor: dict[str, Any], kinds: Sequence[str]) -> None:
        """Refuse attributes of other types than glTF has; small integers of positions are of KHR_mesh_quantization."""
        small = accessor["componentType"] in _SMALL_INTEGERS
        plain = name in ("POSITION", "NORMAL") and QUANTISED not in self.tree.get("extensionsUsed", [])
        if accessor["type"] not in kinds or not (accessor["componentType"] == _FLOAT or (small and not plain)):
            raise self.fail(f"{where}: {name} is not of type {' or '.join(kinds)} in floats, as it is read")

    def _check_material(self, where: str, primitive: dict[str, Any], material: dict[str, Any], fetch: Fetch) -> None:
        """Refuse a colour that trimesh would wrap around, and a texture that it would leave out without a word."""
        rough = material.get("pbrMetallicRoughness", {})
        glossy = material.get("extensions", {}).get(GLOSSY, {})
        for kind, key in ((rough, "baseColorFactor"), (glossy, "diffuseFactor")):
            factor = kind.get(key, (1.0,) * 4)
            if len(factor) != 4 or not all(0.0 <= value <= 1.0 for value in factor):
                raise self.fail(f"{where}: its '{key}' is {shown(factor)}, not four numbers from 0 to 1")
        use = base_texture(material)
        if use is None:
            return
        key = coordinates_key(material)
        if key not in primitive["attributes"]:
            raise self.fail(
                f"{where}: its base texture uses {key}, which the mesh lacks", "export it with texture coordinates"
            )
        self._check_type(where, key, self.entry("accessors", primitive["attributes"][key]), ("VEC2",))
        moved = use.get("extensions", {}).get(MOVED, {})
        for key, size in (("offset", 2), ("scale", 2), ("rotation", None)):
            value = np.array(moved.get(key, np.zeros(size or ())), dtype=np.float64)
            if value.shape != ((size,) if size else ()) or not np.isfinite(value).all():
                what = f"{size} finite numbers" if size else "a finite number"
                raise self.fail(f"{where}: '{key}' of its base texture is {shown(moved[key])}, not {what}")
        texture = self.entry("textures", use.get("index"))
        webp = texture.get("extensions", {}).get("EXT_texture_webp", {})
        number = webp.get("source", texture.get("source"))
        if number is None:
            kinds = ", ".join(texture.get("extensions", {})) or "no 'source'"
            raise self.fail(f"{where}: its base texture has no picture that is read ({kinds})", "export PNG or JPEG")
        image = self.entry("images", number)
        if number not in self._pictures:
            require_picture(f"{self._path}: images {shown(number)}", self._image(image, fetch))
            self._pictures.add(number)

    def _image(self, image: dict[str, Any], fetch: Fetch) -> bytes:
        if "bufferView" not in image:
            return self.bytes_of(image.get("uri"), fetch)
        view = self.entry("bufferViews", image["bufferView"])
        content = self.buffer_content(view["buffer"], fetch)
        start = view.get("byteOffset", 0)
        return content[start : start + view["byteLength"]]

    def bytes_of(self, uri: object, fetch: Fetch) -> bytes:
        """Return the bytes of a uri: data inside it, as base64 or text (RFC 2397), or a file."""
        if not isinstance(uri, str):
            raise self.fail(f"has the uri {shown(uri)}, which is not text")
        if not uri.startswith("data:"):
            return fetch(uri)
        kind, _, data = uri.partition(",")
        try:
            return base64.b64decode(unquote_to_bytes(data)) if kind.endswith(";base64") else unquote_to_bytes(data)
        except binascii.Error as error:
            raise self.fail(f"has data that are not base64 ({error})") from error

    def _check_nodes(self) -> None:
        """Check that nodes are trees of limited depth, and that their transforms are ones."""
        nodes = self.entries("nodes")
        if len(nodes) > _MOST_NODES:
            raise self.fail(f"has {len(nodes)} nodes, more than {_MOST_NODES}")
        for scene in range(len(self.entries("scenes"))):
            self._walk(self.entry("scenes", scene).get("nodes", []))
        if "scene" in self.tree:
            self.entry("scenes", self.tree["scene"])

    def _walk(self, level: Sequence[int]) -> None:
        seen: set[int] = set()
        for _ in range(_DEEPEST):
            below: list[int] = []
            for index in level:
                node = self.entry("nodes", index)
                if index in seen:
                    raise self.fail(f"nodes {index} is its own child, or has two parents")
                seen.add(index)
                self._check_node(index, node)
                below += node.get("children", [])
            level = below
            if not level:
                return
        raise self.fail(f"nests its nodes more than {_DEEPEST} deep")

    def _check_node(self, index: int, node: dict[str, Any]) -> None:
        if "mesh" in node:
            self.entry("meshes", node["mesh"])
        for key, size in (("matrix", 16), ("translation", 3), ("rotation", 4), ("scale", 3)):
            values = np.array(node.get(key, np.ones(size)), dtype=np.float64)
            if values.shape != (size,) or not np.abs(values).max() < 1e9:
                raise self.fail(f"nodes {index}: '{key}' is {shown(node[key])}, not {size} finite numbers below 1e9")
        if "matrix" in node and list(node["matrix"][3::4]) != [0, 0, 0, 1]:
            raise self.fail(f"nodes {index}: the last row of 'matrix' is {shown(node['matrix'][3::4])}, not 0, 0, 0, 1")
        light = node.get("extensions", {}).get(LIGHTS, {}).get("light", 0)
        if type(light) is not int or light < 0:
            raise self.fail(f"nodes {index}: 'light' is {shown(light)}, not the number of a light")
        rotation = node.get("rotation", (1.0, 0.0, 0.0, 0.0))
        if abs(math.hypot(*rotation) - 1.0) > 1e-2:
            raise self.fail(f"nodes {index}: 'rotation' has length {math.hypot(*rotation):g}, not 1")


def _use_base_texture(material: dict[str, Any]) -> None:
    """Replace specular glossiness by metallic roughness where textures give the colour."""
    glossy = material.get("extensions", {}).get(GLOSSY, {})
    if not {"diffuseTexture", "specularGlossinessTexture"} & glossy.keys():
        return
    del material["extensions"][GLOSSY]
    if "baseColorTexture" not in material.get("pbrMetallicRoughness", {}):
        keys = (("diffuseFactor", "baseColorFactor"), ("diffuseTexture", "baseColorTexture"))
        material["pbrMetallicRoughness"] = {ours: glossy[key] for key, ours in keys if key in glossy}

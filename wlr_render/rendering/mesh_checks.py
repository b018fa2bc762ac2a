"""Checks of glTF and PLY files before trimesh parses them.

trimesh allocates what a header promises, and passes over what it cannot read; these checks refuse both.
"""

import base64
import binascii
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import unquote_to_bytes

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.input_files import LIMITS, require_picture, shown
from wlr_render.toml_files import parse_json

_COMPONENT_BYTES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
_COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_FLOAT = 5126
_FLOATS = {"POSITION": "VEC3", "NORMAL": "VEC3", "TEXCOORD_0": "VEC2"}
_UNSIGNED = {5121, 5123, 5125}
_LIGHTS = "KHR_lights_punctual"
_FAN = 6
_DEEPEST = 200
_MOST_NODES = 50_000
_PLY_TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"}
_PLY_TYPES |= {"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"}
_PLY_TYPES |= {"float": "f4", "double": "f8", "float32": "f4", "float64": "f8"}
_BYTES = {"uchar", "uint8"}
_HEADER_BYTES = 100_000

Fetch = Callable[[str], bytes]
"""Name of a file that the mesh refers to -> its content."""


class GltfDocument:
    """The JSON of a glTF file, with checked references between its lists.

    Raises:
        BadInputError: from every method: a reference to nothing, a number out of range, or a part that would not be
            drawn as it is meant.
    """

    def __init__(self, path: Path, content: bytes) -> None:
        """Parse a .gltf or .glb file."""
        self._path, self._binary = path, b""
        if path.suffix.lower() == ".glb":
            # A GLB is a 12-byte header, then chunks of length, type, content: the JSON, and the first buffer.
            size = int.from_bytes(content[12:16], "little")
            self._binary = content[28 + size :]
            content = content[20 : 20 + size]
        self.tree = parse_json(path, content.decode("utf-8-sig"), "a glTF file", "export it again")

    def fail(self, sentence: str) -> BadInputError:
        """Exception for an error in this file; the caller raises it."""
        return BadInputError(f"{self._path}: {sentence}; export it again.")

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
        for mesh in range(len(self._list("meshes"))):
            for primitive in self._entry("meshes", mesh)["primitives"]:
                self._check_primitive(mesh, primitive, fetch)
        self._check_nodes()

    def _list(self, kind: str) -> list[Any]:
        entries = self.tree.get(kind, [])
        if not isinstance(entries, list):
            raise self.fail(f"'{kind}' must be a list")
        return entries

    def _entry(self, kind: str, index: Any) -> dict[str, Any]:
        entries = self._list(kind)
        if type(index) is not int or not 0 <= index < len(entries) or not isinstance(entries[index], dict):
            raise self.fail(f"refers to number {shown(index)} of '{kind}', which has {len(entries)} entries")
        entry: dict[str, Any] = entries[index]
        return entry

    def _whole(self, entry: dict[str, Any], key: str, where: str, default: int | None = None) -> int:
        value = entry.get(key, default)
        if type(value) is not int or not 0 <= value <= LIMITS.mesh_bytes:
            raise self.fail(f"{where}: '{key}' is {shown(value)}, not a whole number from 0 to {LIMITS.mesh_bytes}")
        return value

    def _check_buffers(self, fetch: Fetch) -> None:
        """Check that accessors lie in their views, and that no bytes are used so often that they fill the memory."""
        sizes: dict[int, int] = {}
        for index in range(len(self._list("buffers"))):
            buffer, where = self._entry("buffers", index), f"buffers {index}"
            content, sizes[index] = self._content_of(buffer, fetch), self._whole(buffer, "byteLength", where)
            if len(content) < sizes[index]:
                name = f", {shown(buffer['uri'])}," if "uri" in buffer else ""
                raise self.fail(f"{where}{name} has {len(content)} bytes, not {sizes[index]}")
        views, viewed, read = [], 0, 0
        for index in range(len(self._list("bufferViews"))):
            view, where = self._entry("bufferViews", index), f"bufferViews {index}"
            self._entry("buffers", view.get("buffer"))
            views.append(self._whole(view, "byteLength", where))
            if (end := self._whole(view, "byteOffset", where, 0) + views[-1]) > sizes[view["buffer"]]:
                raise self.fail(f"{where} ends at byte {end}, beyond buffers {view['buffer']}")
            viewed += views[-1]
        for index in range(len(self._list("accessors"))):
            accessor, where = self._entry("accessors", index), f"accessors {index}"
            if "sparse" in accessor or "bufferView" not in accessor:
                raise self.fail(f"{where} is sparse or without a bufferView, which is not read")
            view = self._entry("bufferViews", accessor["bufferView"])
            kind, component = accessor.get("type"), accessor.get("componentType")
            if kind not in _COMPONENTS or component not in _COMPONENT_BYTES:
                raise self.fail(f"{where} has type {shown(kind)} of component {shown(component)}")
            row = _COMPONENTS[kind] * _COMPONENT_BYTES[component]
            count, stride = self._whole(accessor, "count", where), self._whole(view, "byteStride", where, row)
            end = self._whole(accessor, "byteOffset", where, 0) + max(count - 1, 0) * stride + row * (count > 0)
            if end > views[accessor["bufferView"]]:
                raise self.fail(f"{where} ends at byte {end}, beyond bufferViews {accessor['bufferView']}")
            read += count * row
        if max(viewed, read) > LIMITS.mesh_bytes:
            raise self.fail(f"uses the same bytes for more than {LIMITS.mesh_bytes / 1e6:g} MB of data")

    def _check_primitive(self, mesh: int, primitive: dict[str, Any], fetch: Fetch) -> None:
        where = f"meshes {mesh}"
        if primitive.get("mode") == _FAN:
            raise self.fail(f"{where} has triangle fans, which are not read")
        counts = set()
        for name, index in primitive["attributes"].items():
            accessor = self._entry("accessors", index)
            counts.add(accessor["count"])
            if name in _FLOATS and (accessor["componentType"], accessor["type"]) != (_FLOAT, _FLOATS[name]):
                raise self.fail(f"{where}: {name} is not of type {_FLOATS[name]} in floats, as it is read")
        if len(counts) > 1:
            raise self.fail(f"{where}: its attributes have {', '.join(map(str, sorted(counts)))} entries, not as many")
        if "indices" in primitive:
            accessor = self._entry("accessors", primitive["indices"])
            if accessor["type"] != "SCALAR" or accessor["componentType"] not in _UNSIGNED:
                raise self.fail(f"{where}: its indices are not of type SCALAR in unsigned integers")
        if "material" in primitive:
            self._check_material(where, primitive, self._entry("materials", primitive["material"]), fetch)

    def _check_material(self, where: str, primitive: dict[str, Any], material: dict[str, Any], fetch: Fetch) -> None:
        """Refuse a colour that trimesh would wrap around, and a texture that it would leave out without a word."""
        rough = material.get("pbrMetallicRoughness", {})
        glossy = material.get("extensions", {}).get("KHR_materials_pbrSpecularGlossiness", {})
        for kind, key in ((rough, "baseColorFactor"), (glossy, "diffuseFactor")):
            factor = kind.get(key, (1.0,) * 4)
            if len(factor) != 4 or not all(0.0 <= value <= 1.0 for value in factor):
                raise self.fail(f"{where}: its '{key}' is {shown(factor)}, not four numbers from 0 to 1")
        used = [rough.get("baseColorTexture"), glossy.get("diffuseTexture")]
        for use in filter(None, used):
            if use.get("texCoord", 0) != 0 or "TEXCOORD_0" not in primitive["attributes"]:
                raise self.fail(f"{where} has a texture without coordinates TEXCOORD_0")
            texture = self._entry("textures", use.get("index"))
            webp = texture.get("extensions", {}).get("EXT_texture_webp", {})
            number = webp.get("source", texture.get("source"))
            require_picture(f"{self._path}: images {shown(number)}", self._image(self._entry("images", number), fetch))

    def _image(self, image: dict[str, Any], fetch: Fetch) -> bytes:
        if "bufferView" not in image:
            return self._bytes_of(image.get("uri"), fetch)
        view = self._entry("bufferViews", image["bufferView"])
        content = self._content_of(self._entry("buffers", view["buffer"]), fetch)
        start = view.get("byteOffset", 0)
        return content[start : start + view["byteLength"]]

    def _content_of(self, buffer: dict[str, Any], fetch: Fetch) -> bytes:
        return self._bytes_of(buffer["uri"], fetch) if "uri" in buffer else self._binary

    def _bytes_of(self, uri: object, fetch: Fetch) -> bytes:
        if not isinstance(uri, str):
            raise self.fail(f"has the uri {shown(uri)}, which is not text")
        if not uri.startswith("data:"):
            return fetch(uri)
        try:
            return base64.b64decode(unquote_to_bytes(uri.partition("base64,")[2]))
        except binascii.Error as error:
            raise self.fail(f"has data that are not base64 ({error})") from error

    def _check_nodes(self) -> None:
        """Check that nodes are trees of limited depth, and that their transforms are ones."""
        nodes = self._list("nodes")
        if len(nodes) > _MOST_NODES:
            raise self.fail(f"has {len(nodes)} nodes, more than {_MOST_NODES}")
        for scene in range(len(self._list("scenes"))):
            self._walk(self._entry("scenes", scene).get("nodes", []))
        if "scene" in self.tree:
            self._entry("scenes", self.tree["scene"])

    def _walk(self, level: Sequence[int]) -> None:
        seen: set[int] = set()
        for _ in range(_DEEPEST):
            below: list[int] = []
            for index in level:
                node = self._entry("nodes", index)
                if index in seen:
                    raise self.fail(f"nodes {index} is its own child, or that of two nodes")
                seen.add(index)
                self._check_node(index, node)
                below += node.get("children", [])
            level = below
            if not level:
                return
        raise self.fail(f"nests its nodes more than {_DEEPEST} deep")

    def _check_node(self, index: int, node: dict[str, Any]) -> None:
        if "mesh" in node:
            self._entry("meshes", node["mesh"])
        for key, size in (("matrix", 16), ("translation", 3), ("rotation", 4), ("scale", 3)):
            values = np.array(node.get(key, np.ones(size)), dtype=np.float64)
            if values.shape != (size,) or not np.abs(values).max() < 1e9:
                raise self.fail(f"nodes {index}: '{key}' is {shown(node[key])}, not {size} finite numbers below 1e9")
        if "matrix" in node and list(node["matrix"][3::4]) != [0, 0, 0, 1]:
            raise self.fail(f"nodes {index}: the last row of 'matrix' is {shown(node['matrix'][3::4])}, not 0, 0, 0, 1")
        light = node.get("extensions", {}).get(_LIGHTS, {}).get("light", 0)
        if type(light) is not int or light < 0:
            raise self.fail(f"nodes {index}: 'light' is {shown(light)}, not the number of a light")
        rotation = node.get("rotation", (1.0, 0.0, 0.0, 0.0))
        if abs(math.hypot(*rotation) - 1.0) > 1e-2:
            raise self.fail(f"nodes {index}: 'rotation' has length {math.hypot(*rotation):g}, not 1")


def check_obj(path: Path, content: bytes, fetch: Fetch) -> None:
    """Check that an OBJ file's materials and their textures can be read, and that no face counts from 0.

    Raises:
        BadInputError: trimesh would leave out a material or a texture, or take vertex 0 for the last one.
    """
    if zero := re.search(rb"^[ \t]*f(?:[ \t][^\n]*?)?[ \t]0+(?![\d.])", content, re.MULTILINE):
        line = content.count(b"\n", 0, zero.end()) + 1
        raise BadInputError(f"{path} line {line}: has vertex 0, but they are counted from 1; export it again.")
    if short := re.search(rb"^[ \t]*[vf](?:[ \t]+[^\s]+){0,2}[ \t]*\r?$", content, re.MULTILINE):
        line = content.count(b"\n", 0, short.start()) + 1
        raise BadInputError(f"{path} line {line}: has fewer than three numbers; export it again.")
    _check_corners(path, content)
    library = re.search(rb"mtllib([^\n]*)", content)
    if library is None:
        return
    name = library[1].decode("utf-8").strip()
    text = fetch(name)
    used, stated = (
        {each.strip() for each in re.findall(rb"^[ \t]*%b[ \t]+([^\r\n]+)" % key, where, re.MULTILINE)}
        for key, where in ((b"usemtl", content), (b"newmtl", text))
    )
    for each in sorted(used - stated):
        material = shown(each.decode("utf-8", "replace"))
        raise BadInputError(f"{path}: uses the material {material}, which {shown(name)} lacks; export both again.")
    for each in re.findall(rb"^[ \t]*Kd\b([^\r\n]*)", text, re.MULTILINE):
        _require_colour(path, name, each.decode("utf-8", "replace"))
    for each in re.findall(rb"^[ \t]*map_kd([^\n]*)", text, re.MULTILINE | re.IGNORECASE):
        picture = each.decode("utf-8").strip()
        require_picture(f"{path}: its file {shown(picture)[1:-1]}", fetch(picture))


def _check_corners(path: Path, content: bytes) -> None:
    """Refuse texture coordinates and normals that are not there: trimesh leaves out all of them then."""
    faces = b"\n".join(re.findall(rb"^[ \t]*f[ \t][^\n]*/[^\n]*", content, re.MULTILINE))
    corners = re.findall(rb"/(-?\d*)(?:/(-?\d*))?", faces)
    for key, indices in zip((b"vt", b"vn"), zip(*corners, strict=True), strict=False):
        used = [int(index) for index in set(indices) if index]
        count = len(re.findall(rb"^[ \t]*%b[ \t]" % key, content, re.MULTILINE))
        for index in used:
            if not (1 <= index <= count or -count <= index <= -1):
                raise BadInputError(
                    f"{path}: a face refers to '{key.decode()}' number {index} of {count}; export it again."
                )


def _require_colour(path: Path, library: str, text: str) -> None:
    try:
        colour = [float(each) for each in text.split()]
    except ValueError:
        colour = []
    if len(colour) != 3 or not all(0.0 <= each <= 1.0 for each in colour):
        raise BadInputError(
            f"{path}: in {shown(library)}, 'Kd' is {shown(text.strip())}, not three numbers from 0 to 1; correct it."
        )


@dataclass
class _PlyElement:
    """An element of a PLY header: its name, how many rows it has, and type and name of each property.

    The type of a list is a pair of types: of its length, and of its entries.
    """

    name: str
    rows: int
    properties: list[tuple[str | tuple[str, str], str]] = field(default_factory=list)


def check_ply(path: Path, content: bytes) -> None:
    """Check that a PLY file has the rows that its header promises, and that trimesh reads all of them.

    Raises:
        BadInputError: the header has no end, an unknown type or no format, or promises other rows than there are; some
            faces have more corners than others in a binary file; a colour is not whole.
    """
    header = re.match(rb"ply\s.*?^end_header *\r?(?:\n|$)", content[:_HEADER_BYTES], re.DOTALL | re.MULTILINE)
    if header is None:
        raise BadInputError(f"{path}: is not a PLY file: its header has no 'ply' or no 'end_header'; export it again.")
    lines = [line.split() for line in header[0].decode("utf-8", "replace").splitlines()]
    elements = _ply_elements(path, lines)
    for element in elements:
        colours = [name for _, name in element.properties if name in ("red", "green", "blue")]
        if len(colours) not in (0, 3):
            raise BadInputError(f"{path}: '{element.name}' has {', '.join(colours)} alone; export all three colours.")
    body = content[header.end() :]
    if ["format", "ascii", "1.0"] in lines:
        _check_ascii_rows(path, elements, body)
    else:
        order = ">" if ["format", "binary_big_endian", "1.0"] in lines else "<"
        _check_binary_rows(path, elements, body, order)


def _ply_elements(path: Path, lines: list[list[str]]) -> list[_PlyElement]:
    elements: list[_PlyElement] = []
    for line in lines:
        if line[:1] == ["element"]:
            if len(line) != 3 or not re.fullmatch(r"\d{1,10}", line[2]):
                raise BadInputError(f"{path}: 'element' line {shown(' '.join(line))} has no count; export it again.")
            elements.append(_PlyElement(line[1], int(line[2])))
        elif line[:1] == ["property"] and elements:
            kinds, name = (line[2:-1], line[-1]) if line[1:2] == ["list"] else (line[1:-1], line[-1])
            if len(kinds) != 1 + (line[1:2] == ["list"]) or not set(kinds) <= set(_PLY_TYPES):
                raise BadInputError(f"{path}: 'property' line {shown(' '.join(line))} is not known; export it again.")
            elements[-1].properties.append(((kinds[0], kinds[1]) if len(kinds) == 2 else kinds[0], name))
    return elements


def _check_ascii_rows(path: Path, elements: list[_PlyElement], body: bytes) -> None:
    if strange := re.search(rb"[^\d\s+\-.eEnaifNAIF]", body):
        raise BadInputError(f"{path}: has {shown(strange[0].decode('latin-1'))} among its numbers; export it again.")
    rows, promised = body.strip().splitlines() if body.strip() else [], sum(element.rows for element in elements)
    if len(rows) != promised:
        raise BadInputError(f"{path}: promises {promised} rows but has {len(rows)}; export it again.")
    start = 0
    for element in elements:
        for number, row in enumerate(rows[start : start + element.rows], start=1):
            _check_ascii_row(f"{path}: row {number} of '{element.name}'", element, row.split())
        start += element.rows


def _check_ascii_row(where: str, element: _PlyElement, values: list[bytes]) -> None:
    at = 0
    for kind, name in element.properties:
        value = values[at] if at < len(values) else b""
        if isinstance(kind, tuple):
            at += int(value) if value.isdigit() else len(values)
        elif kind in _BYTES and not (value.isdigit() and int(value) <= 255):
            raise BadInputError(f"{where}: '{name}' is {shown(value.decode())}, not a byte; export it again.")
        at += 1
    if at != len(values):
        raise BadInputError(f"{where} has {len(values)} numbers, not as many as its properties; export it again.")


def _check_binary_rows(path: Path, elements: list[_PlyElement], body: bytes, order: str) -> None:
    """Check that all lists of a property are as long as its first one, which is what trimesh takes them for."""
    start = 0
    for element in elements:
        row: list[Any] = []
        for index, (kind, _) in enumerate(element.properties):
            if not isinstance(kind, tuple):
                row.append((f"p{index}", order + _PLY_TYPES[kind]))
                continue
            length = np.dtype([*row, ("n", order + _PLY_TYPES[kind[0]])])
            first = np.frombuffer(body[start : start + length.itemsize].ljust(length.itemsize, b"\0"), length)["n"][0]
            if element.rows and not 0 <= first < 1e6:
                raise BadInputError(f"{path}: a list of '{element.name}' has {first:g} entries; export it again.")
            row += [(f"n{index}", length["n"]), (f"p{index}", order + _PLY_TYPES[kind[1]], (int(first),))]
        size = np.dtype(row).itemsize
        if (end := start + element.rows * size) > len(body):
            raise BadInputError(f"{path}: promises at least {end} bytes but has {len(body)}; export it again.")
        read = np.frombuffer(body, np.dtype(row), element.rows, start) if size else np.empty(0)
        for name in (each[0] for each in row if each[0].startswith("n")):
            if len(np.unique(read[name])) > 1:
                raise BadInputError(
                    f"{path}: the lists of '{element.name}' have {shown(np.unique(read[name])[:4].tolist())} entries; "
                    "export it again with triangles only."
                )
        start = end

"""The JSON, the buffers and the accessors of a glTF file, checked when they are read.

Every accessor is known to lie in its buffer view, and every view in its buffer, before anything is drawn.
"""

import base64
import binascii
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import unquote_to_bytes

import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.io.input_files import LIMITS, require_picture, shown
from wlr_render.io.toml_files import parse_json
from wlr_render.numerics.arrays import FloatArray
from wlr_render.scene.raw_mesh import opened_picture

LIGHTS = "KHR_lights_punctual"
GLOSSY = "KHR_materials_pbrSpecularGlossiness"
MOVED = "KHR_texture_transform"
QUANTISED = "KHR_mesh_quantization"
_UNDERSTOOD = {LIGHTS, "KHR_materials_unlit", GLOSSY, "EXT_texture_webp", MOVED, QUANTISED}
"""Extensions that a file may require."""
_KINDS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_COLUMNS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}

Fetch = Callable[[str], bytes]
"""Name of a file that the mesh refers to -> its content."""


class GltfDocument:
    """The lists of a glTF file, and its data.

    Raises:
        BadInputError: from every method: a dangling reference, a number out of range, or a part that would
            be drawn wrongly.
    """

    def __init__(self, path: Path, content: bytes, fetch: Fetch) -> None:
        """Parse a .gltf or .glb file; `fetch` reads the files that it refers to."""
        self.path, self._fetch, self._binary = path, fetch, b""
        self._pictures: dict[int, Any] = {}
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
        unknown = ", ".join(shown(name) for name in self.tree.get("extensionsRequired", []) if name not in _UNDERSTOOD)
        if unknown:
            raise self.fail(f"needs the glTF extension {unknown}, which is not read".replace("'", ""))
        self._buffers: list[memoryview] = [self._buffer(number) for number in range(len(self.entries("buffers")))]
        self._views = [self._view(number) for number in range(len(self.entries("bufferViews")))]
        self._read_bytes = 0
        self._arrays = [self._array(number) for number in range(len(self.entries("accessors")))]

    def fail(self, sentence: str, remedy: str = "export it again") -> BadInputError:
        """Return an exception for an error in this file; the caller raises it."""
        return BadInputError(f"{self.path}: {sentence}; {remedy}.")

    def entry(self, kind: str, index: Any) -> dict[str, Any]:
        """Return one entry of a list of the file's top level; raise if it is missing."""
        entries = self.entries(kind)
        if type(index) is not int or not 0 <= index < len(entries) or not isinstance(entries[index], dict):
            raise self.fail(f"refers to number {shown(index)} of '{kind}', which has {len(entries)} entries")
        entry: dict[str, Any] = entries[index]
        return entry

    def entries(self, kind: str) -> list[Any]:
        """Return a list of the file's top level, empty if the file has none."""
        entries = self.tree.get(kind, [])
        if not isinstance(entries, list):
            raise self.fail(f"'{kind}' must be a list")
        return entries

    def name_of(self, kind: str, index: int) -> str:
        """Name a mesh, material, node or animation for messages: its name in quotes, or its number if it has none."""
        return shown(self.entry(kind, index).get("name", f"{kind[:-1].replace('meshe', 'mesh')} {index}"))

    def values(self, accessor: int) -> NDArray[Any]:
        """Return the stored values (count, components) of an accessor, sparse values applied; zeros if it has none."""
        self.entry("accessors", accessor)
        return self._arrays[accessor]

    def floats(self, accessor: int, is_colour: bool = False) -> FloatArray:
        """Return the values of an accessor; normalised integers and colours become fractions of the largest integer."""
        values = self.values(accessor)
        if values.dtype.kind == "f" or not (is_colour or self.entry("accessors", accessor).get("normalized")):
            return values.astype(np.float64)
        return np.maximum(values / float(np.iinfo(values.dtype).max), -1.0)

    def picture(self, image: int) -> Any:
        """Return the PIL.Image of an entry of `images`, not yet decoded."""
        if image not in self._pictures:
            stated = self.entry("images", image)
            if "bufferView" in stated:
                self.entry("bufferViews", stated["bufferView"])
                content = bytes(self._views[stated["bufferView"]])
            else:
                content = self._bytes_of(stated.get("uri"))
            require_picture(f"{self.path}: images {shown(image)}", content)
            self._pictures[image] = opened_picture(content)
        return self._pictures[image]

    def _whole(self, entry: dict[str, Any], key: str, where: str, default: int | None = None) -> int:
        value = entry.get(key, default)
        if type(value) is not int or not 0 <= value <= LIMITS.mesh_bytes:
            raise self.fail(f"{where}: '{key}' is {shown(value)}, not a whole number from 0 to {LIMITS.mesh_bytes}")
        return value

    def _buffer(self, number: int) -> memoryview:
        """Return the bytes of a buffer, from its uri or the GLB's second chunk."""
        buffer, where = self.entry("buffers", number), f"buffers {number}"
        size = self._whole(buffer, "byteLength", where)
        content = self._bytes_of(buffer["uri"]) if "uri" in buffer else self._binary
        if len(content) < size:
            name = f", {shown(buffer['uri'])}," if "uri" in buffer else ""
            raise self.fail(f"{where}{name} has {len(content)} bytes, not {size}")
        return memoryview(content)[:size]

    def _view(self, number: int) -> memoryview:
        view, where = self.entry("bufferViews", number), f"bufferViews {number}"
        self.entry("buffers", view.get("buffer"))
        content: memoryview = self._buffers[view["buffer"]]
        start = self._whole(view, "byteOffset", where, 0)
        if (end := start + self._whole(view, "byteLength", where)) > len(content):
            raise self.fail(f"{where} ends at byte {end}, beyond buffers {view['buffer']}")
        return content[start:end]

    def _array(self, number: int) -> NDArray[Any]:
        accessor, where = self.entry("accessors", number), f"accessors {number}"
        columns, kind = _COLUMNS.get(str(accessor.get("type"))), accessor.get("componentType")
        if columns is None or kind not in _KINDS:
            raise self.fail(f"{where} has type {shown(accessor.get('type'))} of component {shown(kind)}")
        count, stored = self._whole(accessor, "count", where), np.dtype(_KINDS[kind])
        self._read_bytes += count * columns * stored.itemsize
        if self._read_bytes > LIMITS.mesh_bytes:
            raise self.fail(f"uses the same bytes for more than {LIMITS.mesh_bytes / 1e6:g} MB of data")
        if "bufferView" in accessor:
            values = self._rows(accessor, where, count, columns, stored)
        else:
            values = np.zeros((count, columns), stored)
        return self._sparse(accessor["sparse"], number, values) if "sparse" in accessor else values

    def _sparse(self, sparse: dict[str, Any], number: int, values: NDArray[Any]) -> NDArray[Any]:
        """Return a copy of an accessor's values with its sparse values applied."""
        count, where = len(values), f"accessors {number}, sparse"
        if not all(isinstance(sparse.get(key), dict) for key in ("indices", "values")):
            raise self.fail(f"{where}: lacks 'indices' or 'values'")
        changed, component = self._whole(sparse, "count", where), sparse["indices"].get("componentType")
        kind = np.dtype(_KINDS.get(component, "f"))
        if changed > count or kind.kind != "u":
            raise self.fail(f"{where}: has {changed} indices of component {shown(component)} for {count} entries")
        at = self._rows(sparse["indices"], where, changed, 1, kind)[:, 0]
        if at.size and at.max() >= count:
            raise self.fail(f"accessors {number}: its sparse indices reach {at.max()}, beyond its {count}")
        values = values.copy()
        values[at] = self._rows(sparse["values"], where, changed, values.shape[1], values.dtype)
        return values

    def _rows(self, stated: dict[str, Any], where: str, count: int, columns: int, kind: np.dtype[Any]) -> NDArray[Any]:
        """Return rows (count, columns) of the buffer view that an accessor states, without a copy."""
        view, row = self.entry("bufferViews", stated.get("bufferView")), columns * kind.itemsize
        content, stride = self._views[stated["bufferView"]], self._whole(view, "byteStride", where, row)
        start = self._whole(stated, "byteOffset", where, 0)
        end = start + max(count - 1, 0) * stride + row * (count > 0)
        if end > len(content):
            raise self.fail(f"{where} ends at byte {end}, beyond bufferViews {stated['bufferView']}")
        return np.ndarray((count, columns), kind, content, start, (stride, kind.itemsize))

    def _bytes_of(self, uri: object) -> bytes:
        """Return the bytes of a uri: data inside it, as base64 or text (RFC 2397), or a file."""
        if not isinstance(uri, str):
            raise self.fail(f"has the uri {shown(uri)}, which is not text")
        if not uri.startswith("data:"):
            return self._fetch(uri)
        kind, _, data = uri.partition(",")
        try:
            return base64.b64decode(unquote_to_bytes(data)) if kind.endswith(";base64") else unquote_to_bytes(data)
        except binascii.Error as error:
            raise self.fail(f"has data that are not base64 ({error})") from error

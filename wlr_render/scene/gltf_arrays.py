"""Arrays of a glTF file: accessors of every layout and type as plain floats and triangles."""

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wlr_render.numerics.arrays import FloatArray
from wlr_render.scene.gltf_document import COMPONENTS, MOVED, Fetch, GltfDocument, base_texture, coordinates_key
from wlr_render.scene.polygons import strip_corners

_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_STRIP, _FAN = 5, 6
_FLOAT, _UINT = 5126, 5125


class GltfArrays:
    """Reads the accessors of a checked document."""

    def __init__(self, document: GltfDocument, fetch: Fetch) -> None:
        """Prepare; `fetch` reads the files that the document refers to."""
        self._document, self._fetch = document, fetch
        self._blob = bytearray()
        self._accessors: list[dict[str, Any]] = []
        self._views: list[dict[str, Any]] = []

    def for_trimesh(self) -> tuple[bytes, dict[str, bytes]]:
        """Return a .gltf file that trimesh reads as the document means it, and the files that it refers to.

        Primitives have triangles of plain floats in place of strips, fans, and sparse, quantised or interleaved data,
        and a material; the coordinates of the base texture are TEXCOORD_0, moved as `KHR_texture_transform` states.
        """
        tree = self._document.rewritten()
        materials = tree.setdefault("materials", [])
        for mesh in tree.get("meshes", []):
            for primitive in mesh["primitives"]:
                stated = primitive["attributes"]
                attributes = {
                    key: self._added(self.floats(stated[key], is_colour=key == "COLOR_0"))
                    for key in ("POSITION", "NORMAL", "COLOR_0")
                    if key in stated
                }
                if (coordinates := self.texture_coordinates(primitive)) is not None:
                    attributes["TEXCOORD_0"] = self._added(coordinates)
                indices = self._added(self._triangles(primitive))
                if "material" not in primitive:
                    primitive["material"] = len(self._document.entries("materials"))
                primitive |= {"attributes": attributes, "indices": indices, "mode": 4}
                primitive.pop("targets", None)
                primitive.pop("extensions", None)
        materials.append({})
        views, buffers = tree.get("bufferViews", []), tree.get("buffers", [])
        tree["accessors"] = [{**each, "bufferView": each["bufferView"] + len(views)} for each in self._accessors]
        tree["bufferViews"] = [*views, *({**view, "buffer": len(buffers)} for view in self._views)]
        files = {f"buffer {n}": self._document.buffer_content(n, self._fetch) for n in range(len(buffers))}
        files[f"buffer {len(buffers)}"] = bytes(self._blob)
        tree["buffers"] = [{"byteLength": len(content), "uri": name} for name, content in files.items()]
        for number, image in enumerate(tree.get("images", [])):
            if str(image.get("uri", "")).startswith("data:"):
                files[f"image {number}"] = self._document.bytes_of(image["uri"], self._fetch)
                image["uri"] = f"image {number}"
        return json.dumps(tree).encode(), files

    def values(self, number: int) -> NDArray[Any]:
        """Return stored values (count, components) of an accessor; zeros where it has none, sparse ones in place."""
        accessor = self._document.entry("accessors", number)
        columns, kind = COMPONENTS[accessor["type"]], np.dtype(_TYPES[accessor["componentType"]])
        count = accessor["count"]
        if "bufferView" in accessor:
            values = self._read(accessor, count, columns, kind)
        else:
            values = np.zeros((count, columns), kind)
        if (sparse := accessor.get("sparse")) is None:
            return values
        at = self._read(sparse["indices"], sparse["count"], 1, np.dtype(_TYPES[sparse["indices"]["componentType"]]))
        if at.size and at.max() >= count:
            raise self._document.fail(f"accessors {number}: its sparse indices reach {at.max()}, beyond its {count}")
        values = values.copy()
        values[at[:, 0]] = self._read(sparse["values"], sparse["count"], columns, kind)
        return values

    def floats(self, number: int, is_colour: bool = False) -> FloatArray:
        """Values of an accessor; normalised integers, and all of colours, as parts of their largest."""
        accessor, values = self._document.entry("accessors", number), self.values(number)
        if values.dtype.kind == "f" or not (is_colour or accessor.get("normalized")):
            return values.astype(np.float64)
        return np.maximum(values / float(np.iinfo(values.dtype).max), -1.0)

    def texture_coordinates(self, primitive: dict[str, Any]) -> FloatArray | None:
        """Texture coordinates (vertices, 2) of the base texture, moved, turned and scaled; None without a texture."""
        material = self._document.entry("materials", primitive["material"]) if "material" in primitive else {}
        use = base_texture(material)
        if use is None:
            return None
        uv = self.floats(primitive["attributes"][coordinates_key(material)])
        moved = use.get("extensions", {}).get(MOVED, {})
        angle, scale = moved.get("rotation", 0.0), moved.get("scale", (1.0, 1.0))
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        return np.asarray((uv * scale) @ turn.T + moved.get("offset", (0.0, 0.0)))

    def _read(self, stated: dict[str, Any], count: int, columns: int, kind: np.dtype[Any]) -> NDArray[Any]:
        view = self._document.entry("bufferViews", stated["bufferView"])
        content = self._document.buffer_content(view["buffer"], self._fetch)
        start = view.get("byteOffset", 0) + stated.get("byteOffset", 0)
        stride = view.get("byteStride", columns * kind.itemsize)
        return np.ndarray((count, columns), kind, content, start, (stride, kind.itemsize))

    def _triangles(self, primitive: dict[str, Any]) -> NDArray[Any]:
        """Return indices (3 n, 1) of triangles, also of strips and fans."""
        if "indices" in primitive:
            index = self.values(primitive["indices"])[:, 0].astype(np.uint32)
        else:
            index = np.arange(self._document.entry("accessors", primitive["attributes"]["POSITION"])["count"])
        mode, first = primitive.get("mode", 4), np.arange(max(len(index) - 2, 0))
        if mode == _STRIP:
            corners = strip_corners(len(index))
        elif mode == _FAN:
            corners = np.stack([first + 1, first + 2, 0 * first], axis=1)
        else:
            corners = np.arange(len(index) // 3 * 3)
        return index[corners].reshape(-1, 1)

    def _added(self, values: NDArray[Any]) -> int:
        """Return the number of a new accessor with these values."""
        kind = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}[values.shape[1]]
        whole = values.dtype.kind in "iu"
        content = values.astype("<u4" if whole else "<f4").tobytes()
        self._views.append({"byteOffset": len(self._blob), "byteLength": len(content)})
        self._blob += content
        number = len(self._accessors)
        self._accessors.append(
            {"bufferView": number, "componentType": _UINT if whole else _FLOAT, "count": len(values), "type": kind}
        )
        return number

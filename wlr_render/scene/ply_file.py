"""PLY files: ASCII and binary, polygons of any size, colours and texture coordinates of vertices or faces.

Colours are sRGB. Without normals in the file, a vertex gets the mean normal of the triangles around it.
"""

import re
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.io.input_files import as_bad_input, require_picture, shown
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.srgb import decode_srgb
from wlr_render.scene.mtl_file import Neighbours, spellings
from wlr_render.scene.polygons import Triangles, smooth_normals, strip_corners, triangulated
from wlr_render.scene.raw_mesh import RawMesh, opened_picture

_TYPES = {"char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I"}
_TYPES |= {"int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i", "uint32": "I"}
_TYPES |= {"float": "f", "double": "d", "float32": "f", "float64": "d"}
"""Types of PLY, as `struct` and numpy abbreviate them in standard size."""
_CODES = {"i": "i4", "I": "u4", "h": "i2", "H": "u2", "b": "i1", "B": "u1", "f": "f4", "d": "f8"}
_BYTES = {"uchar", "uint8"}
_HEADER_BYTES = 100_000
_HEADER = rb"ply[ \t]*(?:(\r)(?!\n)|\r?\n)(?:.*?[\r\n])??end_header[ \t]*(?(1)(?:\r|\Z)|\r?(?:\n|\Z))"
"""A header with lines that end in LF, CR LF or CR; after a lone CR, an LF would belong to the body."""
_COLOUR = ("red", "green", "blue")
_COLOURS = (_COLOUR, ("diffuse_red", "diffuse_green", "diffuse_blue"), ("r", "g", "b"))
_COORDINATES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"), ("texture_s", "texture_t"))
_CORNERS = ("vertex_indices", "vertex_index")
_NAMES = {"edge": "edges", "tristrips": "triangle strips", "material": "materials"}

Column = NDArray[Any] | list[NDArray[Any]]
"""Values of a property: (rows,), or an array for each row of a list."""


@dataclass
class _Element:
    """An element of a PLY header: its name, its number of rows, and type and name of each property.

    The type of a list is a pair of types: of its length, and of its entries.
    """

    name: str
    rows: int
    properties: list[tuple[str | tuple[str, str], str]] = field(default_factory=list)
    columns: dict[str, Column] = field(default_factory=dict)

    def is_translucent(self) -> bool:
        """Return whether any row has an 'alpha' below the largest value of its type."""
        alpha = np.asarray(self.columns.get("alpha", ()), dtype=np.float64)
        return bool(alpha.size and alpha.min() not in (1.0, 255.0, 65535.0))

    def vectors(self, *names: Sequence[str]) -> tuple[FloatArray, list[str]] | None:
        """Return the values (rows, k) and types of the first group of properties that the element has."""
        for group in names:
            if all(name in self.columns for name in group):
                types = [str(kind) for kind, name in self.properties if name in group]
                return np.stack([np.asarray(self.columns[name], np.float64) for name in group], axis=1), types
        return None


class PlyFile:
    """The elements of a PLY file.

    Attributes:
        not_drawn: parts of the file that have no effect on pictures, one text each.

    Raises:
        BadInputError: the header has no end, an unknown type or no format, or promises other rows than there are; a
            colour is incomplete; an index or a texture is missing.
    """

    def __init__(self, path: Path, content: bytes, neighbours: Neighbours) -> None:
        """Read all elements; `neighbours` has the textures."""
        self._path, self._neighbours = path, neighbours
        header = re.match(_HEADER, content[:_HEADER_BYTES], re.DOTALL)
        if header is None:
            raise BadInputError(
                f"{path}: is not a PLY file: its header has no 'ply' or no 'end_header'; export it again."
            )
        rows = re.split(r"[\r\n]+", header[0].decode("utf-8", "replace"))
        lines = [row.split() for row in rows]
        stated = (re.match(r"comment\s+TextureFile\s+(.+?)\s*$", row, re.IGNORECASE) for row in rows)
        self._textures = [found[1] for found in stated if found]
        elements = _elements(path, lines)
        for element in elements:
            colours = [name for _, name in element.properties if name in _COLOUR]
            if len(colours) not in (0, 3):
                raise BadInputError(f"{path}: '{element.name}' has {', '.join(colours)} alone; export all three.")
        body = content[header.end() :]
        if ["format", "ascii", "1.0"] in lines:
            _read_ascii(path, elements, body)
        else:
            _read_binary(path, elements, body, ">" if ["format", "binary_big_endian", "1.0"] in lines else "<")
        self._elements = {element.name: element for element in elements}
        face, strips = (self._elements.get(name, _Element(name, 0)) for name in ("face", "tristrips"))
        if not face.rows and any(name in strips.columns for name in _CORNERS):
            self._elements["face"] = _faces_of_strips(self._elements.pop("tristrips"))
        self.not_drawn = [name for key, name in _NAMES.items() if key in self._elements and self._elements[key].rows]
        self.not_drawn += [f"opacity (alpha) of '{each.name}'" for each in elements if each.is_translucent()]

    def meshes(self) -> Iterator[RawMesh]:
        """Return the faces, as one mesh for each texture."""
        vertex, face = (self._elements.get(name, _Element(name, 0)) for name in ("vertex", "face"))
        corners = next((face.columns[name] for name in _CORNERS if name in face.columns), None)
        position = vertex.vectors("xyz")
        if not vertex.rows or not face.rows or corners is None or position is None:
            return
        texture = np.zeros(face.rows, dtype=np.int64)
        if len(self._textures) > 1:
            if "texnumber" not in face.columns:
                raise BadInputError(
                    f"{self._path}: has {len(self._textures)} textures and faces without 'texnumber'; export it with "
                    "one texture."
                )
            texture = np.asarray(face.columns["texnumber"]).astype(np.int64)
        for number in np.unique(texture):
            rows = np.flatnonzero(texture == number)
            name = self._path.name if len(self._textures) < 2 else f"{self._path.name}/{number}"
            yield self._mesh(name, vertex, face, [np.asarray(corners[row]) for row in rows], rows, int(number))

    def _mesh(
        self,
        name: str,
        vertex: _Element,
        face: _Element,
        polygons: list[NDArray[Any]],
        rows: NDArray[np.int64],
        texture: int,
    ) -> RawMesh:
        found = vertex.vectors("xyz")
        assert found is not None
        position = found[0]
        place, triangles = self._corners(name, position, polygons)
        stated = vertex.vectors(("nx", "ny", "nz"))
        own = smooth_normals(position, place[triangles]) if stated is None else stated[0]
        picture = self._picture(texture)
        coordinates = None if picture is None else self._coordinates(vertex, face, rows, place)
        colours = self._colours(vertex)
        if picture is not None:
            self.not_drawn += ["vertex colours beside the texture"] * (colours is not None)
            colours = None
        elif colours is not None:
            colours = colours[place]
        elif (of_faces := self._colours(face)) is not None:
            colours = np.repeat(of_faces[rows], [len(each) for each in polygons], axis=0)
        return RawMesh(name, position[place], triangles, own[place], np.ones(3), coordinates, picture, colours)

    def _corners(
        self, name: str, position: FloatArray, polygons: list[NDArray[Any]]
    ) -> tuple[NDArray[np.int64], Triangles]:
        """Return the vertex of each corner of the polygons, and triangles of corners."""
        place = np.concatenate(polygons).astype(np.int64)
        if place.size and not (place.min() >= 0 and place.max() < len(position)):
            raise BadInputError(
                f"{self._path}: mesh {shown(name)} refers to a vertex beyond its {len(position)}; export it again."
            )
        lengths = np.array([len(each) for each in polygons])
        first = np.cumsum(lengths) - lengths
        with as_bad_input(self._path, "a mesh", "triangulate it where it was made"):
            parts = [
                triangulated(position[place], first[lengths == length][:, None] + np.arange(length))
                for length in np.unique(lengths)
                if length > 2
            ]
        return place, np.concatenate([np.empty((0, 3), np.int64), *parts])

    def _picture(self, texture: int) -> Any:
        if not 0 <= texture < len(self._textures):
            return None
        name = self._neighbours.find(spellings(self._textures[texture])) or self._textures[texture]
        content = self._neighbours.get(name)
        require_picture(f"{self._path}: its file {shown(name)[1:-1]}", content)
        return opened_picture(content)

    def _coordinates(
        self, vertex: _Element, face: _Element, rows: NDArray[np.int64], place: NDArray[np.int64]
    ) -> FloatArray | None:
        """Return texture coordinates per corner, from the face or else from the vertex; origin at the top left."""
        own = face.columns.get("texcoord")
        if own is not None:
            uv = np.concatenate([np.asarray(own[row], np.float64) for row in rows])
            if len(uv) != 2 * len(place):
                raise BadInputError(
                    f"{self._path}: 'texcoord' has {len(uv)} numbers for {len(place)} corners; export it again."
                )
            return uv.reshape(-1, 2) * [1, -1] + [0, 1]
        found = vertex.vectors(*_COORDINATES)
        return None if found is None else found[0][place] * [1, -1] + [0, 1]

    def _colours(self, element: _Element) -> FloatArray | None:
        """Return linear colours (rows, 3): white is 1, the largest value of 8 or 16 bits, or 255 for more bits."""
        found = element.vectors(*_COLOURS)
        if found is None:
            return None
        values, types = found
        code = _CODES[_TYPES[types[0]]]
        white = 1.0 if code[0] == "f" else 255.0 if code[1] == "4" else float(np.iinfo(code).max)
        if not ((values >= 0) & (values <= white)).all():
            raise BadInputError(f"{self._path}: a colour of '{element.name}' is not from 0 to {white:g}; correct it.")
        return decode_srgb(np.rint(255 * values / white).astype(np.uint8)).astype(np.float64)


def _faces_of_strips(strips: _Element) -> _Element:
    """Return the triangles of strips, each ended by the index -1."""
    lists = [np.append(each, -1) for name in _CORNERS for each in strips.columns.get(name, ())]
    whole = np.concatenate([np.empty(0), *lists]).astype(np.int64)
    parts = [part[part >= 0] for part in np.split(whole, np.flatnonzero(whole < 0))]
    triangles = np.concatenate([np.empty((0, 3), np.int64), *(part[strip_corners(len(part))] for part in parts)])
    return _Element("face", len(triangles), [], {_CORNERS[0]: triangles})


def _elements(path: Path, lines: list[list[str]]) -> list[_Element]:
    elements: list[_Element] = []
    for line in lines:
        if line[:1] == ["element"]:
            if len(line) != 3 or not re.fullmatch(r"\d{1,10}", line[2]):
                raise BadInputError(f"{path}: 'element' line {shown(' '.join(line))} has no count; export it again.")
            elements.append(_Element(line[1], int(line[2])))
        elif line[:1] == ["property"] and elements:
            kinds, name = (line[2:-1], line[-1]) if line[1:2] == ["list"] else (line[1:-1], line[-1])
            if len(kinds) != 1 + (line[1:2] == ["list"]) or not set(kinds) <= set(_TYPES):
                raise BadInputError(f"{path}: 'property' line {shown(' '.join(line))} is not known; export it again.")
            elements[-1].properties.append(((kinds[0], kinds[1]) if len(kinds) == 2 else kinds[0], name))
    return elements


def _read_ascii(path: Path, elements: list[_Element], body: bytes) -> None:
    if strange := re.search(rb"[^\d\s+\-.eEnaifNAIF]", body):
        raise BadInputError(f"{path}: has {shown(strange[0].decode('latin-1'))} among its numbers; export it again.")
    rows, promised = [row for row in body.splitlines() if row.strip()], sum(element.rows for element in elements)
    if len(rows) != promised:
        raise BadInputError(f"{path}: promises {promised} rows but has {len(rows)}; export it again.")
    start = 0
    for element in elements:
        table = [
            _ascii_row(f"{path}: row {number} of '{element.name}'", element, row.split())
            for number, row in enumerate(rows[start : start + element.rows], start=1)
        ]
        start += element.rows
        for at, (kind, name) in enumerate(element.properties):
            values = [row[at] for row in table]
            element.columns[name] = values if isinstance(kind, tuple) else np.array(values, dtype=np.float64)


def _ascii_row(where: str, element: _Element, values: list[bytes]) -> list[Any]:
    at = 0
    row: list[Any] = []
    for kind, name in element.properties:
        value = values[at] if at < len(values) else b""
        if isinstance(kind, tuple):
            count = int(value) if value.isdigit() else len(values)
            row.append(np.array(values[at + 1 : at + 1 + count], dtype=np.float64))
            at += count
        elif kind in _BYTES and not (value.isdigit() and int(value) <= 255):
            raise BadInputError(f"{where}: '{name}' is {shown(value.decode())}, not a byte; export it again.")
        else:
            row.append(float(value or "nan"))
        at += 1
    if at != len(values):
        raise BadInputError(f"{where} has {len(values)} numbers, not as many as its properties; export it again.")
    return row


def _read_binary(path: Path, elements: list[_Element], body: bytes, order: str) -> None:
    """Read rows at once where every list of a property is as long as its first one, else row by row."""
    start = 0
    for element in elements:
        layout: list[Any] = []
        for index, (kind, _) in enumerate(element.properties):
            if not isinstance(kind, tuple):
                layout.append((f"p{index}", order + _CODES[_TYPES[kind]]))
                continue
            length = np.dtype([*layout, ("n", order + _CODES[_TYPES[kind[0]]])])
            first = np.frombuffer(body[start : start + length.itemsize].ljust(length.itemsize, b"\0"), length)["n"][0]
            if element.rows and not 0 <= first < 1e6:
                raise BadInputError(f"{path}: a list of '{element.name}' has {first:g} entries; export it again.")
            layout += [(f"n{index}", length["n"]), (f"p{index}", order + _CODES[_TYPES[kind[1]]], (int(first),))]
        size = np.dtype(layout).itemsize
        end = start + element.rows * size
        read = np.frombuffer(body, np.dtype(layout), element.rows, start) if size and end <= len(body) else None
        lists = [name for name, *_ in layout if name.startswith("n")]
        if read is not None and all(len(np.unique(read[name])) < 2 for name in lists):
            element.columns = {name: read[f"p{at}"] for at, (_, name) in enumerate(element.properties)}
            start = end
        elif lists:
            start = _read_unequal_rows(path, element, body, start, order)
        elif size:
            raise BadInputError(f"{path}: promises at least {end} bytes but has {len(body)}; export it again.")


def _read_unequal_rows(path: Path, element: _Element, body: bytes, start: int, order: str) -> int:
    """Read the rows of an element with lists of unequal lengths; returns the end of the last row."""
    columns: dict[str, list[Any]] = {name: [] for _, name in element.properties}
    least = sum(
        struct.calcsize("=" + _TYPES[kind if isinstance(kind, str) else kind[0]]) for kind, _ in element.properties
    )
    at = start
    try:
        if start + element.rows * least > len(body):
            raise struct.error
        for _ in range(element.rows):
            for kind, name in element.properties:
                code = f"{order}{_TYPES[kind if isinstance(kind, str) else kind[0]]}"
                (value,) = struct.unpack_from(code, body, at)
                at += struct.calcsize(code)
                if isinstance(kind, tuple):
                    entry = np.dtype(order + _CODES[_TYPES[kind[1]]])
                    end = at + int(value) * entry.itemsize
                    if value < 0 or end > len(body):
                        raise struct.error
                    value, at = np.frombuffer(body, entry, int(value), at), end
                columns[name].append(value)
    except struct.error:
        raise BadInputError(
            f"{path}: ends within the {element.rows} rows of '{element.name}' that it promises; export it again."
        ) from None
    for kind, name in element.properties:
        element.columns[name] = columns[name] if isinstance(kind, tuple) else np.array(columns[name], np.float64)
    return at

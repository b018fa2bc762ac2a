"""Wavefront OBJ files: one mesh for each material. Materials are read by `mtl_file.py`.

Vertex colours are sRGB. Without normals in the file, a vertex gets the mean normal of the triangles around it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.io.input_files import as_bad_input, shown
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.srgb import decode_srgb
from wlr_render.scene.mtl_file import Materials, ObjMaterial, obj_text, statements, without_comment
from wlr_render.scene.polygons import Triangles, smooth_normals, triangulated
from wlr_render.scene.raw_mesh import RawMesh, opened_picture

_DATA = {"v": (3, 8), "vt": (1, 3), "vn": (3, 3)}
"""Fewest and most numbers of each kind of data."""
_KINDS = tuple(_DATA)
_BULK = {*_DATA, "f", "fo"}
_WITHOUT_EFFECT = {"mtllib", "g", "s", "bevel", "c_interp", "d_interp", "lod", "shadow_obj", "trace_obj", "mg", "end"}
_NAMES = {"p": "points", "l": "lines", "usemap": "texture maps (usemap)", "maplib": "texture maps (usemap)"}
_NAMES |= dict.fromkeys(("call", "csh"), "other files (call, csh)")
_FREE_FORM = ("vp", "deg", "bmat", "step", "cstype", "curv", "curv2", "surf", "parm", "trim", "hole", "scrv", "sp")
_NAMES |= dict.fromkeys((*_FREE_FORM, "con", "ctech", "stech"), "free-form curves and surfaces")
_NO_MATERIAL = ("", "None", "(null)")
_MOST_NAMED = 5

Corner = tuple[int, int, int]
"""Indices of a position, texture coordinates and a normal; -1 where a corner has none."""


@dataclass
class _Part:
    """The faces of one material: polygons of indices into `corners`; `known` has the indices by their words."""

    material: str
    object_name: str = ""
    corners: dict[Corner, int] = field(default_factory=dict)
    known: dict[str, int] = field(default_factory=dict)
    polygons: list[list[int]] = field(default_factory=list)


class ObjFile:
    """The statements of an OBJ file.

    Attributes:
        not_drawn: statements of the file that have no effect on pictures, one text each.

    Raises:
        BadInputError: a statement has the wrong numbers, an index refers to nothing, or a material is missing.
    """

    def __init__(self, path: Path, content: bytes, materials: Materials) -> None:
        """Read all statements; `materials` opens the material libraries that the file names."""
        self._path, self._materials = path, materials
        self._data: dict[str, list[list[float]]] = {kind: [] for kind in _KINDS}
        self._parts: dict[str, _Part] = {}
        self._part, self._object = self._part_of(""), ""
        self._has_library = False
        if b"\0" in content:
            raise BadInputError(f"{path}: has null characters; is it binary, or UTF-16? Export it as plain text.")
        strange: dict[str, None] = {}
        for number, words in statements(obj_text(content)):
            key, rest = words[0], " ".join(words[1:]) if words[0] not in _BULK else ""
            if key in _DATA:
                self._data[key].append(self._numbers(number, words))
            elif key in ("f", "fo"):
                self._face(number, words)
            elif key == "usemtl":
                self._part = self._part_of(rest)
            elif key == "mtllib" and rest:
                self._has_library = True
                materials.open(rest)
            elif key == "o":
                self._object = rest
            elif key not in _WITHOUT_EFFECT:
                strange[_NAMES.get(key, f"lines {shown(key)}")] = None
        self.not_drawn = [*strange][:_MOST_NAMED]

    def meshes(self) -> Iterator[RawMesh]:
        """Yield a mesh for each material that faces use."""
        data = {kind: self._array(kind, columns) for kind, columns in (("v", 3), ("vt", 2), ("vn", 3))}
        colours = self._colours()
        used = [part for part in self._parts.values() if part.polygons]
        names: set[str] = set()
        for part in used:
            material = self._material(part.material)
            name = part.material if len(self._materials) > 1 and part.material else part.object_name or self._path.name
            for raw in self._meshes_of(name, part, material, data, colours):
                while raw.name in names:
                    raw = replace(raw, name=f"{raw.name}_1")
                names.add(raw.name)
                yield raw

    def _meshes_of(
        self,
        name: str,
        part: _Part,
        material: ObjMaterial,
        data: dict[str, FloatArray],
        colours: FloatArray | None,
    ) -> Iterator[RawMesh]:
        """Yield the mesh of a part, or two: faces without the texture coordinates of others are an untextured mesh."""
        place, coordinate, turned = np.array([*part.corners], dtype=np.int64).T
        position = data["v"][place]
        triangles = _triangles(self._path, position, part.polygons)
        _, first, point = np.unique(place, return_index=True, return_inverse=True)
        normal = smooth_normals(position[first], point[triangles])[point]
        normal[turned >= 0] = data["vn"][turned[turned >= 0]]
        colour = None if colours is None else colours[place]
        picture = None if material.picture is None else opened_picture(material.picture)
        raw = RawMesh(name, position, triangles, normal, material.base_colour, None, picture, colour)
        textured = (coordinate >= 0)[triangles].all(axis=1)
        if picture is None or not textured.any():
            yield raw
            return
        uv = data["vt"][np.maximum(coordinate, 0)] * [1, -1] + [0, 1]
        yield replace(raw, triangles=triangles[textured], uv=uv)
        if not textured.all():
            self.not_drawn.append(f"the texture of {shown(part.material)} on faces without texture coordinates")
            yield replace(raw, triangles=triangles[~textured], picture=None)

    def _material(self, name: str) -> ObjMaterial:
        found = self._materials.get(name)
        if found is not None:
            return found
        if name in _NO_MATERIAL:
            return ObjMaterial()
        if not self._has_library:
            self.not_drawn.append(f"material {shown(name)}, of no mtllib")
            return ObjMaterial()
        raise BadInputError(
            f"{self._path}: uses the material {shown(name)}, which {self._materials.names} lacks; export both again."
        )

    def _part_of(self, material: str) -> _Part:
        return self._parts.setdefault(material, _Part(material))

    def _numbers(self, line: int, words: Sequence[str]) -> list[float]:
        """Return the numbers of a data statement, without a comment at its end."""
        least, most = _DATA[words[0]]
        try:
            if least <= len(words) - 1 <= most:
                return [*map(float, words[1:])]
        except ValueError:
            pass
        text = without_comment(" ".join(words[1:]))
        count = len(text.split())
        if least <= count <= most and count < len(words) - 1:
            return self._numbers(line, [words[0], *text.split()])
        if count < least:
            few = ("fewer than three numbers", "no number")[least == 1]
            raise BadInputError(f"{self._path} line {line}: has {few}; export it again.")
        what = f"{count} numbers, more than {most}" if count > most else f"{shown(text)}, which are not numbers"
        raise BadInputError(f"{self._path} line {line}: '{words[0]}' has {what}; export it again.")

    def _face(self, line: int, words: Sequence[str]) -> None:
        part = self._part
        try:
            polygon = [part.known[word] for word in words[1:]]
        except KeyError:
            polygon = []
            for word in words[1:]:
                if word.startswith("#"):
                    break
                corner = self._corner(line, word)
                polygon.append(part.corners.setdefault(corner, len(part.corners)))
                if "-" not in word:  # negative indices are relative to their line
                    part.known[word] = polygon[-1]
        if len(polygon) < 3:
            raise BadInputError(f"{self._path} line {line}: has fewer than three numbers; export it again.")
        part.object_name = self._object
        part.polygons.append(polygon)

    def _corner(self, line: int, word: str) -> Corner:
        """Return a corner's indices, counted from 0; negative indices in the file count back from the latest."""
        parts = word.split("/")
        found = [-1, -1, -1]
        for at, text in enumerate(parts):
            if text == "" and at > 0:
                continue
            try:
                index = int(text)
            except ValueError:
                index = None
            if index is None or at > 2:
                raise BadInputError(
                    f"{self._path} line {line}: {shown(word)} is not a corner of a face; export it again."
                )
            if index == 0:
                raise BadInputError(
                    f"{self._path} line {line}: has vertex 0, but they are counted from 1; export it again."
                )
            found[at] = index - 1 if index > 0 else len(self._data[_KINDS[at]]) + index
            if found[at] < 0:
                self._refuse_index(_KINDS[at], index)
        return found[0], found[1], found[2]

    def _array(self, kind: str, columns: int) -> FloatArray:
        """Return the first columns of one kind of data, 0 where a line has fewer; check every corner's index."""
        rows, at = self._data[kind], _KINDS.index(kind)
        used = [np.array([*part.corners])[:, at].max() for part in self._parts.values() if part.corners]
        if (largest := int(max(used, default=-1))) >= len(rows):
            self._refuse_index(kind, largest + 1)
        widths = {len(row) for row in rows}
        if len(widths) == 1 and min(widths) >= columns:
            return np.array(rows)[:, :columns]
        return np.array([(*row[:columns], 0.0, 0.0)[:columns] for row in rows]).reshape(-1, columns)

    def _refuse_index(self, kind: str, index: int) -> None:
        raise BadInputError(
            f"{self._path}: a face refers to '{kind}' number {index} of {len(self._data[kind])}; export it again."
        )

    def _colours(self) -> FloatArray | None:
        """Return linear colours (vertices, 3) from 'v' lines of six or more numbers, white for other lines."""
        if not any(len(row) >= 6 for row in self._data["v"]):
            return None
        codes = np.array([row[3:6] if len(row) >= 6 else [1.0, 1.0, 1.0] for row in self._data["v"]])
        if not ((codes >= 0) & (codes <= 255)).all():
            raise BadInputError(
                f"{self._path}: has a vertex colour outside 0 to 1, or one that is not finite; export it again."
            )
        codes = codes if codes.max() > 1 else 255 * codes
        return decode_srgb(np.rint(codes).astype(np.uint8)).astype(np.float64)


def _triangles(path: Path, position: FloatArray, polygons: Sequence[Sequence[int]]) -> Triangles:
    by_corners: dict[int, list[Sequence[int]]] = {}
    for polygon in polygons:
        by_corners.setdefault(len(polygon), []).append(polygon)
    with as_bad_input(path, "a mesh", "triangulate it where it was made"):
        return np.concatenate([triangulated(position, np.array(each)) for each in by_corners.values()])

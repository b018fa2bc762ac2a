"""Checks of OBJ and PLY files before trimesh parses them.

trimesh allocates what a header promises, and passes over what it cannot read; these checks refuse both.
"""

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.input_files import require_picture, shown
from wlr_render.rendering.gltf_document import Fetch

_PLY_TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"}
_PLY_TYPES |= {"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"}
_PLY_TYPES |= {"float": "f4", "double": "f8", "float32": "f4", "float64": "f8"}
_BYTES = {"uchar", "uint8"}
_HEADER_BYTES = 100_000


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

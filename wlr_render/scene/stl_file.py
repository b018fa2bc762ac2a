"""STL files, binary and ASCII, read by trimesh: one mesh for each solid, with flat triangles."""

import io
import re
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.scene.raw_mesh import RawMesh

_HEADER_BYTES, _FACET_BYTES = 84, 50
_FACET = re.compile(rb"(?<!end)facet\s+normal", re.IGNORECASE)
_STATEMENT = re.compile(
    rb"(?<!\s)\s++(?=(?:facet\s+normal|outer\s+loop|vertex|endloop|endfacet|endsolid)\b)", re.IGNORECASE
)


def stl_meshes(path: Path, content: bytes) -> Iterator[RawMesh]:
    """Return the solids of an STL file.

    Raises:
        BadInputError: the file ends early, or has facets that cannot be read.
    """
    import trimesh

    end = _HEADER_BYTES + _FACET_BYTES * int.from_bytes(content[80:_HEADER_BYTES], "little")
    if _HEADER_BYTES <= end <= len(content):
        content, facets = content[:end], (end - _HEADER_BYTES) // _FACET_BYTES  # some writers append bytes
    elif not (facets := len(_FACET.findall(content))):
        raise BadInputError(f"{path}: is neither an ASCII STL nor a binary one of the stated length; export it again.")
    else:
        # trimesh reads one statement per line, and would guess the encoding.
        content = _STATEMENT.sub(b"\n", content).decode("utf-8", errors="replace").encode()
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)  # numpy's warning about text that is not a number
        solids = trimesh.load_scene(io.BytesIO(content), file_type="stl", process=False).geometry
    if (read := sum(len(solid.faces) for solid in solids.values())) != facets:
        raise BadInputError(f"{path}: has {facets} facets, of which {read} can be read; export it again.")
    for name, solid in solids.items():
        position = np.asarray(solid.vertices, dtype=np.float64)
        yield RawMesh(name if len(solids) > 1 else path.name, position, np.asarray(solid.faces), None, np.ones(3))

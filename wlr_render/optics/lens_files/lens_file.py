"""Read a sequential prescription of Zemax, CODE V, Optiland or rayoptics; the content tells the format."""

import re
from pathlib import Path

from wlr_render.errors import BadInputError
from wlr_render.io.input_files import LIMITS, read_bytes
from wlr_render.io.toml_files import read_json
from wlr_render.optics.lens_files.codev import read_codev
from wlr_render.optics.lens_files.glass_catalogues import GlassCatalogue
from wlr_render.optics.lens_files.optiland_json import read_optiland
from wlr_render.optics.lens_files.rayoptics_json import read_rayoptics
from wlr_render.optics.lens_files.sequence import LensFile
from wlr_render.optics.lens_files.zemax import read_zemax
from wlr_render.optics.lens_text import read_lens_lines

_KINDS = "a lens file of Zemax (.zmx, sequential), CODE V (.seq), Optiland (.json) or rayoptics (.roa)"
_CODE_V = re.compile(r"\s*(LEN|RDM|SO)\b", re.IGNORECASE)
"""Commands that begin a CODE V lens, but never a line of a Zemax file."""


def read_lens_file(path: Path, catalogue: GlassCatalogue) -> tuple[str, LensFile]:
    """Read a lens file; returns the program that wrote it, and its content.

    Raises:
        BadInputError: the file has none of the four formats, or breaks its format; the sentence says where.
    """
    if not read_bytes(path, LIMITS.data_bytes).lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"{"):
        lines = read_lens_lines(path, _KINDS)
        if any(_CODE_V.match(line) for line in lines) and not any(line.startswith("SURF") for line in lines):
            return "CODE V", read_codev(path, lines, catalogue)
        return "Zemax", read_zemax(path, lines, catalogue)
    content = read_json(path, _KINDS, "name another file")
    if content.has("surface_group"):
        return "Optiland", read_optiland(path, content, catalogue)
    if content.has("optical_model"):
        return "rayoptics", read_rayoptics(path, content, catalogue)
    raise BadInputError(f"{path}: is not {_KINDS}; name another file.")

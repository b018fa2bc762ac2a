"""Read a sequential prescription of Zemax, Optiland or rayoptics; the content tells the format."""

from pathlib import Path

from wlr_render.errors import BadInputError
from wlr_render.io.input_files import LIMITS, read_bytes
from wlr_render.io.toml_files import read_json
from wlr_render.optics.lens_files.glass_catalogues import GlassCatalogue
from wlr_render.optics.lens_files.optiland_json import read_optiland
from wlr_render.optics.lens_files.rayoptics_json import read_rayoptics
from wlr_render.optics.lens_files.sequence import LensFile
from wlr_render.optics.lens_files.zemax import read_zemax

_KINDS = "a lens file of Zemax (.zmx, sequential), Optiland (.json) or rayoptics (.roa)"


def read_lens_file(path: Path, catalogue: GlassCatalogue) -> tuple[str, LensFile]:
    """Read a lens file; returns the program that wrote it, and its content.

    Raises:
        BadInputError: the file has none of the three formats, or breaks its format; the sentence says where.
    """
    if not read_bytes(path, LIMITS.data_bytes).lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"{"):
        return "Zemax", read_zemax(path, catalogue)
    content = read_json(path, _KINDS, "name another file")
    if content.has("surface_group"):
        return "Optiland", read_optiland(path, content, catalogue)
    if content.has("optical_model"):
        return "rayoptics", read_rayoptics(path, content, catalogue)
    raise BadInputError(f"{path}: is not {_KINDS}; name another file.")

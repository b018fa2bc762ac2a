"""Text of lens design programs: UTF-16 or UTF-8, with or without byte order mark, or Latin-1."""

import codecs
import re
from pathlib import Path

from wlr_render.errors import BadInputError
from wlr_render.io.input_files import LIMITS, as_bad_input, read_bytes


def read_lens_lines(path: Path, kind: str) -> list[str]:
    """Read the lines of a text file.

    Unlike `str.splitlines`, it splits only at line ends, not at separators such as Latin-1's 0x85.

    Raises:
        BadInputError: the content is not text; the sentence says that it is not `kind`.
    """
    content = read_bytes(path, LIMITS.text_bytes)
    with as_bad_input(path, kind, "name another file, or save it as text"):
        return re.split("\r\n|\r|\n", _decoded(path, content, kind))


def _decoded(path: Path, content: bytes, kind: str) -> str:
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return content.decode("utf-16")
    if content[1:200:2].count(0) > content[0:200:2].count(0):
        return content.decode("utf-16-le")
    if content[0:1] == b"\0" != content[1:2]:
        return content.decode("utf-16-be")
    if 0 in content:
        raise BadInputError(f"{path}: has bytes of zero, so this is not {kind}; name another file.")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("latin-1")

"""OpenEXR files: any number of named channels of one size, exact floats or whole numbers, and text in the header."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.extras import installed_by
from wlr_render.io.atomic_files import disk_errors, written_whole
from wlr_render.io.input_files import as_bad_input, reason_of, require_pixels

_TYPES = (np.float16, np.float32, np.uint32)
"""Types of values in the format."""
_OWN = "wlr:"
"""Prefix of the names of our texts in a header: no other program's attributes have it."""


def require_exr(use: str) -> None:
    """Check that OpenEXR files can be written; `use` begins the sentence, e.g. an option.

    Raises:
        MissingExtraError: the library OpenEXR is not installed.
    """
    with installed_by("exr", use):
        import OpenEXR  # noqa: F401


def write_exr(path: str | Path, channels: Mapping[str, NDArray[Any]], texts: Mapping[str, str] | None = None) -> Path:
    """Write channels without loss (ZIP), the first row on top.

    Args:
        path: path of the file.
        channels: (height, width) values by name, float16, float32 or uint32; a name "LAYER.CHANNEL", e.g. "normal.X",
            puts the channel into a layer.
        texts: texts of the header, by name; "wlr:" is put before each name.

    Raises:
        BadInputError: no channels, channels of different sizes or of another type, or a file that cannot be written.
        MissingExtraError: the library OpenEXR is not installed.
    """
    with installed_by("exr", str(path)):
        import OpenEXR

    if len({values.shape for values in channels.values()}) != 1:
        raise BadInputError(f"{path}: give channels (height, width) of one size, not {_shapes(channels)}.")
    for name, values in channels.items():
        if values.dtype not in _TYPES or values.ndim != 2 or not values.size:
            raise BadInputError(
                f"{path}: channel {name!r}, {values.dtype} {values.shape}, cannot be written; give float16, float32 or "
                "uint32 (height, width)."
            )
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    header |= {f"{_OWN}{name}": text for name, text in (texts or {}).items()}
    content = {name: np.ascontiguousarray(values) for name, values in channels.items()}
    file = OpenEXR.File(header, content)
    with written_whole(path) as temporary, disk_errors(path):
        try:
            file.write(str(temporary))
        except RuntimeError as error:  # OpenEXR raises it for errors of the file system as well
            raise OSError(reason_of(error)) from error
    return Path(path)


def read_exr(path: str | Path) -> tuple[dict[str, NDArray[Any]], dict[str, str]]:
    """Return the channels (height, width) by name, and the texts of the header that `write_exr` wrote.

    Raises:
        BadInputError: the file is missing, is not an OpenEXR file, or is too large.
        MissingExtraError: the library OpenEXR is not installed.
    """
    with installed_by("exr", str(path)):
        import OpenEXR

    if not Path(path).is_file():
        raise BadInputError(f"{path}: there is no such file; name an OpenEXR file.")
    with as_bad_input(path, "an OpenEXR file"):
        low, high = OpenEXR.File(str(path), header_only=True).header()["dataWindow"]
        require_pixels(Path(path), (int(high[0] - low[0]) + 1, int(high[1] - low[1]) + 1), "write it again")
        opened = OpenEXR.File(str(path), separate_channels=True)
        channels = {name: channel.pixels for name, channel in opened.channels().items()}
        header = opened.header()
    return channels, {name[len(_OWN) :]: str(text) for name, text in header.items() if name.startswith(_OWN)}


def _shapes(channels: Mapping[str, NDArray[Any]]) -> str:
    return ", ".join(f"{name} {values.shape}" for name, values in channels.items()) or "none"

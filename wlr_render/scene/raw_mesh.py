"""Meshes as read from their files, before they are checked, and pictures of textures."""

import io
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.io.input_files import decode_image, require_pixels
from wlr_render.numerics.arrays import FloatArray

_REMEDY = "replace the picture, or export the mesh again"
_WHOLE_16_BIT = {"PNG", "PPM", "JPEG2000"}  # formats of which Pillow reads 16 bits into 32


@dataclass(frozen=True, eq=False)
class RawMesh:
    """Triangles with one material, unchecked.

    Attributes:
        name: name for messages.
        position: (vertices, 3).
        triangles: (triangles, 3).
        normal: (vertices, 3) of any length; None: triangles are flat.
        base_colour: (3,) linear RGB factor.
        uv: (vertices, 2) or None; (0, 0) is the top-left corner of the texture.
        picture: PIL.Image of the texture, or None.
        vertex_colour: (vertices, 3) linear or None.
    """

    name: str
    position: FloatArray
    triangles: NDArray[np.int64]
    normal: FloatArray | None
    base_colour: FloatArray
    uv: FloatArray | None = None
    picture: Any = None
    vertex_colour: FloatArray | None = None


def opened_picture(content: bytes) -> Any:
    """Return the picture of a file's content, as PIL.Image, not yet decoded."""
    from PIL import Image

    return Image.open(io.BytesIO(content))


def texture_of(where: str, picture: Any) -> NDArray[np.uint8]:
    """Return a picture as a texture (height, width, 3) of codes: opaque, without colour profile, gamma or orientation.

    Raises:
        BadInputError: the picture is broken, or holds numbers without a stated white, such as floats.
    """
    require_pixels(where, picture.size)
    stored, kind = picture.fp, picture.format
    try:
        picture.load()
        if picture.mode.startswith("I;16") or (picture.mode == "I" and kind in _WHOLE_16_BIT):
            grey = np.rint(np.asarray(picture, dtype=np.float64) / 257).astype(np.uint8)
            texture = np.repeat(grey[..., None], 3, axis=2)
        elif picture.mode in ("I", "F"):
            raise BadInputError(f"{where} is a picture of floats or 32-bit integers; store it in 8 or 16 bits.")
        else:
            texture = np.asarray((picture.convert("RGBA") if picture.mode == "RGBa" else picture).convert("RGB"))
    except (OSError, SyntaxError, ValueError) as error:
        if isinstance(error, BadInputError):
            raise
        raise BadInputError(f"{where} cannot be read ({error}); {_REMEDY}.") from error
    if kind == "PNG" and not texture[-1].any() and isinstance(stored, io.BytesIO):
        # Pillow silently leaves missing rows of a PNG black; OpenCV refuses the file.
        decode_image(where, stored.getvalue(), cv2.IMREAD_COLOR, _REMEDY)
    return texture

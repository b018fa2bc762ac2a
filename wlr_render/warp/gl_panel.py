"""Light of a panel on the GPU: constants of the warp's shaders, and textures that are uploaded once."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wlr_render.gl import gl
from wlr_render.warp.panel_light import PanelLight

_ENCODINGS = {"SRGB": 0, "LINEAR": 1, "TABLE": 2}
TEXTURE_KINDS = {8: "f1", 10: "rgb10", 16: "f2"}
"""Formats of textures that hold codes, by their bits; see `GlContext.target`."""


@dataclass(frozen=True, eq=False)
class PanelEncoder:
    """Shader constants and textures that encode light for a `PanelLight`.

    Attributes:
        constants: preprocessor constants of the shaders.
        textures: textures by sampler name.
        texture_kind: format of the textures that we draw to, see `GlContext.target`.
    """

    constants: dict[str, int]
    textures: dict[str, gl.Texture]
    texture_kind: str

    @classmethod
    def of(cls, context: gl.GlContext, panel: PanelLight) -> "PanelEncoder":
        """Upload the table and the uniformity map, if there are any."""
        table, textures = panel.code_of_light(), {}
        if table is not None:
            textures["code_of_light"] = _uploaded(context, table[None], "f4")
        if panel.uniformity is not None:
            factors = np.broadcast_to(np.atleast_3d(panel.uniformity), (*panel.uniformity.shape[:2], 3))
            textures["uniformity"] = _uploaded(context, factors, "f2")
        name = panel.encoding.upper() if isinstance(panel.encoding, str) else "TABLE"
        constants = {"ENCODING": _ENCODINGS[name], "UNIFORMITY": int(panel.uniformity is not None)}
        return cls(constants | _ENCODINGS, textures, TEXTURE_KINDS[panel.bits])


def _uploaded(context: gl.GlContext, rgb: NDArray[Any], dtype: str) -> gl.Texture:
    with context.drawing():
        texture = context.target((rgb.shape[1], rgb.shape[0]), 3, dtype)
        texture.write(np.ascontiguousarray(rgb, {"f2": np.float16, "f4": np.float32}[dtype]), alignment=1)
        gl.read_between_texels(texture)
    return texture


SRGB_ENCODER = PanelEncoder({"ENCODING": 0, "UNIFORMITY": 0} | _ENCODINGS, {}, "f1")

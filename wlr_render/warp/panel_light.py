"""Light of a panel: light per code, uniformity over the panel, and sub-pixel positions."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.io.input_files import shown
from wlr_render.numerics.arrays import Float32Array, FloatArray, finite_array

_GAMMAS = 0.2, 5.0
_FARTHEST_PX = 1.0
_CODES = 1024


@dataclass(frozen=True, eq=False)
class PanelLight:
    """Response of a panel: the light that it emits for each code.

    Attributes:
        encoding: "srgb"; "linear", for a compositor that takes linear light, which is not clipped in half floats; the
            exponent of a gamma curve (light = code ^ exponent), 0.2 to 5; or a measured table (n, 3): the light of red,
            green and blue for n codes in equal steps from 0 to the largest, where 1 is the light of the picture's
            white. Light outside a primary's table becomes its first or last code.
        uniformity: factors of linear light, 0 to 1, (height, width) or (height, width, 3), of the display picture's
            size, top row first: smaller where the panel is brighter.
        sub_pixel_px: (3, 2) positions of the red, green and blue sub-pixels from the pixel's centre, in display pixels,
            x right and y down; each primary is drawn along the ray of its sub-pixel.
        bits: bits per channel of the textures that we draw to: 8 (RGBA8), 10 (RGB10_A2) or 16 (RGBA16F).

    Raises:
        BadInputError: another encoding or number of bits, a table that does not rise, factors outside 0 to 1, offsets
            of more than a pixel, or numbers that are not finite.
    """

    encoding: Literal["srgb", "linear"] | float | FloatArray = "srgb"
    uniformity: FloatArray | None = None
    sub_pixel_px: FloatArray | None = None
    bits: Literal[8, 10, 16] = 8

    def __post_init__(self) -> None:
        object.__setattr__(self, "encoding", _checked_encoding(self.encoding))
        if self.uniformity is not None:
            object.__setattr__(self, "uniformity", _checked_uniformity(self.uniformity))
        if self.sub_pixel_px is not None:
            wanted = (
                "(3, 2) numbers of display pixels from -1 to 1: right and down from the pixel's centre for each primary"
            )
            offsets = finite_array(self.sub_pixel_px, (3, 2), "sub_pixel_px", wanted)
            if np.abs(offsets).max() > _FARTHEST_PX:
                raise BadInputError(f"sub_pixel_px is {shown(offsets.tolist())}; give {wanted}.")
            object.__setattr__(self, "sub_pixel_px", offsets)
        if isinstance(self.bits, bool) or self.bits not in (8, 10, 16):
            raise BadInputError(f"bits is {shown(self.bits)}; choose from 8, 10, 16.")

    def code_of_light(self) -> Float32Array | None:
        """Return codes (n, 3), 0 to 1, of each primary for n lights with fourth roots in equal steps from 0 to 1.

        None if no table is needed. The codes of all usual curves are smooth in the fourth root.
        """
        if isinstance(self.encoding, str):
            return None
        light = np.linspace(0, 1, _CODES) ** 4
        if isinstance(self.encoding, float):
            return np.repeat((light ** (1 / self.encoding))[:, None], 3, axis=1).astype(np.float32)
        codes = np.linspace(0, 1, len(self.encoding))
        return np.stack([np.interp(light, column, codes) for column in self.encoding.T], axis=-1).astype(np.float32)


def _checked_encoding(value: Any) -> str | float | FloatArray:
    wanted = "'srgb', 'linear', an exponent from 0.2 to 5, or a table (n, 3) of the light of each code"
    if isinstance(value, str) and value in ("srgb", "linear"):
        return value
    if isinstance(value, int | float) and not isinstance(value, bool) and _GAMMAS[0] <= value <= _GAMMAS[1]:
        return float(value)
    if not isinstance(value, np.ndarray) or value.ndim != 2 or value.shape[1] != 3 or len(value) < 2:
        raise BadInputError(f"the panel's encoding is {shown(value)}; give {wanted}.")
    table = finite_array(value, value.shape, "the panel's encoding", wanted)
    falls = np.argwhere(np.diff(table, axis=0) <= 0)
    if len(falls) or table[0].min() < 0:
        row, column = falls[0] if len(falls) else (-1, int(np.argmin(table[0])))
        primary = ("red", "green", "blue")[column]
        raise BadInputError(
            f"the panel's table has {table[row + 1, column]:g} for {primary} in row {row + 1}: "
            "the light must rise from row to row, from 0 or more: smooth the measured values."
        )
    return table


def _checked_uniformity(value: Any) -> FloatArray:
    wanted = "(height, width) or (height, width, 3) factors from 0 to 1: divide yours by the largest"
    shape = np.shape(value) if isinstance(value, np.ndarray) else ()
    if len(shape) not in (2, 3) or shape[2:] not in ((), (3,)):
        raise BadInputError(f"the uniformity map has the shape {shape}; give {wanted}.")
    factors = finite_array(value, shape, "the uniformity map", wanted)
    if factors.min(initial=0) < 0 or factors.max(initial=0) > 1:
        raise BadInputError(f"the uniformity map runs from {factors.min():g} to {factors.max():g}; give {wanted}.")
    return factors


SRGB_PANEL = PanelLight()

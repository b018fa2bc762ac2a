"""Procedural textures, (height, width, 3) uint8 sRGB. Edges are one texel soft; patterns that repeat have no seam."""

import numpy as np
from numpy.typing import NDArray

from wlr_render.numerics.arrays import FloatArray

Texture = NDArray[np.uint8]


def hex_colour(code: str) -> FloatArray:
    """Return an sRGB colour "rrggbb" as (3,) in 0..1."""
    return np.array([int(code[i : i + 2], 16) for i in (0, 2, 4)]) / 255.0


def encoded(colour: FloatArray) -> Texture:
    """Return sRGB in 0..1 (height, width, 3) as bytes."""
    return np.asarray(np.round(np.clip(colour, 0, 1) * 255), dtype=np.uint8)


def mixed(first: FloatArray, second: FloatArray, weight: FloatArray) -> FloatArray:
    """Blend colours (..., 3) by weights (...) of the second."""
    return np.asarray(first + weight[..., None] * (second - first))


def texel_grid(height: int, width: int) -> tuple[FloatArray, FloatArray]:
    """Return u and v in 0..1 at the texel centres, (height, width) each."""
    u, v = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    return u, v


def inside(distance: FloatArray, softness: float) -> FloatArray:
    """Return 1 where a signed distance is negative, 0 where it is positive, with an edge of the given width."""
    return np.asarray(np.clip(0.5 - distance / softness, 0, 1))


def wave(phase: FloatArray, duty: float = 0.5, softness: float = 0.02) -> FloatArray:
    """Return a soft square wave of period 1: 1 during the first `duty` of each period."""
    return inside(np.abs(np.mod(phase - 0.5 * duty + 0.5, 1) - 0.5) - 0.5 * duty, softness)


def inlay() -> Texture:
    """Return the sculpture's skin: a checker of ivory and petrol tiles in two sizes, between copper bands. Repeats."""
    u, v = texel_grid(512, 512)
    coarse = np.abs(wave(2 * u) - wave(4 * v))
    fine = np.abs(wave(6 * u, softness=0.03) - wave(12 * v, softness=0.03))
    checker = np.where(np.mod(v, 1) < 0.5, coarse, fine)
    colour = mixed(hex_colour("f6ecd8"), hex_colour("0f4653"), checker)
    colour = mixed(colour, hex_colour("c8641e"), wave(2 * v + 0.05, 0.1, 0.01))
    return encoded(colour)


def stripes(colours: tuple[str, ...]) -> Texture:
    """Return bands of sRGB colours "rrggbb" across u. Repeats."""
    u, _ = texel_grid(64, 1024)
    index = np.floor(u * len(colours)).astype(int)
    return encoded(np.stack([hex_colour(code) for code in colours])[index])

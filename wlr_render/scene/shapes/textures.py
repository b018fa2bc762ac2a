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


def noise(height: int, width: int, rows: float, columns: float, seed: int) -> FloatArray:
    """Return smooth periodic noise, mean 0, deviation 1, with about `rows` x `columns` bumps over the texture."""
    white = np.random.default_rng(seed).normal(size=(height, width))
    frequency_v = np.fft.fftfreq(height, 1 / height)[:, None] / rows
    frequency_u = np.fft.fftfreq(width, 1 / width)[None] / columns
    smooth = np.fft.ifft2(np.fft.fft2(white) * np.exp(-(frequency_u**2) - frequency_v**2)).real
    return np.asarray((smooth - smooth.mean()) / smooth.std())


def inlay() -> Texture:
    """Return the sculpture's skin: a checker of ivory and petrol tiles in two sizes, between copper bands. Repeats."""
    u, v = texel_grid(512, 512)
    coarse = np.abs(wave(2 * u) - wave(4 * v))
    fine = np.abs(wave(6 * u, softness=0.03) - wave(12 * v, softness=0.03))
    checker = np.where(np.mod(v, 1) < 0.5, coarse, fine)
    colour = mixed(hex_colour("f6ecd8"), hex_colour("0f4653"), checker)
    colour = mixed(colour, hex_colour("c8641e"), wave(2 * v + 0.05, 0.1, 0.01))
    return encoded(colour)


def wood() -> Texture:
    """Return planks with grain along u. Repeats."""
    height, width = 512, 1024
    u, v = texel_grid(height, width)
    grain = noise(height, width, 90, 3, 1) * 0.5 + noise(height, width, 14, 1.5, 2) * 0.7
    plank = np.floor(4 * v)
    shade = np.array([0.05, -0.06, 0.0, 0.08])[plank.astype(int)]
    colour = mixed(hex_colour("a9784f"), hex_colour("7d5231"), np.clip(0.45 + 0.22 * grain - shade * 2, 0, 1))
    joint = wave(4 * v, 0.012, 0.012) + wave(u + 0.37 * np.mod(plank, 2), 0.0015, 0.0015)
    return encoded(mixed(colour, hex_colour("3d2817"), np.clip(joint, 0, 1) * 0.8))


def marble() -> Texture:
    """Return pale stone with grey veins. Repeats."""
    swirl = noise(512, 512, 5, 5, 3) + 0.4 * noise(512, 512, 16, 16, 4)
    vein = np.exp(-np.abs(swirl) * 9)
    cloud = 0.03 * noise(512, 512, 3, 3, 5)[..., None]
    return encoded(mixed(hex_colour("e9e6df"), hex_colour("7c7f86"), 0.65 * vein) + cloud)


def stripes(colours: tuple[str, ...]) -> Texture:
    """Return bands of sRGB colours "rrggbb" across u. Repeats."""
    u, _ = texel_grid(64, 1024)
    index = np.floor(u * len(colours)).astype(int)
    return encoded(np.stack([hex_colour(code) for code in colours])[index])


def screen() -> Texture:
    """Return a monitor's picture: a window of text lines, a side bar and a chart."""
    height, width = 540, 960
    u, v = texel_grid(height, width)
    colour = mixed(hex_colour("10263f"), hex_colour("1f5f78"), v)
    colour = _panel(colour, u, v, (0.05, 0.08, 0.60, 0.92), "f4f6f8")
    colour = _panel(colour, u, v, (0.05, 0.08, 0.60, 0.14), "33475b")
    colour = _panel(colour, u, v, (0.65, 0.08, 0.95, 0.47), "f4f6f8")
    colour = _panel(colour, u, v, (0.65, 0.53, 0.95, 0.92), "182838")
    rng = np.random.default_rng(6)
    for number, length in enumerate(rng.uniform(0.18, 0.48, 16)):
        top = 0.19 + 0.044 * number
        colour = _panel(
            colour, u, v, (0.08, top, 0.08 + length, top + 0.018), "c0392b" if number % 5 == 0 else "5d6d7e"
        )
    for bar, size in enumerate(rng.uniform(0.08, 0.32, 7)):
        left = 0.675 + 0.038 * bar
        colour = _panel(colour, u, v, (left, 0.45 - size, left + 0.026, 0.45), ("2e86c1", "f39c12")[bar % 2])
    curve = 0.725 - 0.12 * np.sin(21 * u) * np.exp(-6 * (u - 0.65)) - 0.15 * (u - 0.65)
    line = inside(np.abs(v - curve) - 0.006, 0.004) * inside(np.abs(u - 0.8) - 0.14, 0.002)
    return encoded(mixed(colour, hex_colour("58d68d"), line))


def _panel(
    colour: FloatArray, u: FloatArray, v: FloatArray, box: tuple[float, float, float, float], code: str
) -> FloatArray:
    """Fill the box (left, top, right, bottom) in 0..1."""
    left, top, right, bottom = box
    horizontal = np.abs(u - 0.5 * (left + right)) - 0.5 * (right - left)
    vertical = np.abs(v - 0.5 * (top + bottom)) - 0.5 * (bottom - top)
    return mixed(colour, hex_colour(code), inside(np.maximum(horizontal, vertical), 0.002))


def painting() -> Texture:
    """Return a landscape: sun, sky and five ranges of hills."""
    height, width = 512, 720
    u, v = texel_grid(height, width)
    colour = mixed(hex_colour("f6c177"), hex_colour("e8e3d3"), np.clip(1.4 - 2.2 * v, 0, 1))
    sun = np.hypot((u - 0.68) * width / height, v - 0.33) - 0.085
    colour = mixed(colour, hex_colour("fff4d6"), inside(sun, 0.004))
    for row, code in enumerate(("c9a27e", "a3806f", "75626a", "4a4a5e", "26324a")):
        skyline = 0.42 + 0.1 * row + 0.05 * noise(1, width, 1, 3 + 2 * row, 10 + row)[0]
        colour = mixed(colour, hex_colour(code), inside(skyline - v, 0.004))
    return encoded(colour)


def keys() -> Texture:
    """Return a keyboard from above: six rows of keys."""
    u, v = texel_grid(256, 768)
    row = np.floor(6 * v)
    gap = np.maximum(wave(15 * u + 0.28 * row, 0.14, 0.05), wave(6 * v, 0.13, 0.05))
    return encoded(mixed(hex_colour("d8dce0"), hex_colour("2a2f36"), np.clip(gap, 0, 1)))

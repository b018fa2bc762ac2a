"""Mip levels of overlays: each texel is the mean of what it covers, whatever the sides of the picture."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from wlr_render.gl.context import GlContext
from wlr_render.gl.mips import level_sizes
from wlr_render.numerics.arrays import Float32Array, FloatArray
from wlr_render.numerics.srgb import decode_srgb
from wlr_render.warp.gl_overlay import OverlayImport, Quad
from wlr_render.warp.stored_picture import PREMULTIPLIED, StoredColour

pytestmark = pytest.mark.gl

QUAD = Quad(np.eye(4), np.ones(2), False)
SIZES = [(300, 200), (301, 199), (64, 16), (37, 1), (1, 6), (7, 96), (1, 1)]


def shares(size: int, count: int) -> FloatArray:
    """(count, size): the share of each of `size` texels in each of `count` that cover them."""
    edge = np.arange(count + 1) * size / count
    first, last = np.arange(size), np.arange(1, size + 1)
    covered = np.minimum(last, edge[1:, None]) - np.maximum(first, edge[:-1, None])
    return np.asarray(np.maximum(covered, 0) * count / size)


def levels_of(
    context: GlContext, overlays: OverlayImport, picture: Float32Array, stored: StoredColour
) -> Iterator[Any]:
    """What each level of an overlay's texture holds, and its exact mean from the light of level 0."""
    texture = overlays.take(picture, QUAD, stored, None).texture
    sizes = level_sizes(picture.shape[1::-1])
    assert sizes[-1] == (1, 1)
    for level, (width, height) in enumerate(sizes):
        read = np.empty((height, width, 4), np.uint8 if texture.dtype == "f1" else np.float16)
        with context.drawing():
            texture.read_into(read, level=level, alignment=1)
        if not level:
            np.testing.assert_allclose(read, picture, atol=1e-3)
            light = read.astype(np.float64)
            if texture.dtype == "f1":
                light = np.concatenate([decode_srgb(read[..., :3]), read[..., 3:] / 255], axis=-1)
        down, across = shares(light.shape[0], height), shares(light.shape[1], width)
        yield read, np.moveaxis(down @ np.moveaxis(light, -1, 0) @ across.T, 0, -1)


@pytest.mark.parametrize("size", SIZES)
def test_levels_of_light_are_exact_means(gl_context: GlContext, size: tuple[int, int]) -> None:
    picture = np.random.default_rng(7).uniform(0, 1, (*size[::-1], 4)).astype(np.float32)
    overlays = OverlayImport(gl_context)
    for _ in range(2):  # the second picture goes into the same texture
        picture = picture[::-1, ::-1].copy()
        for level, (read, exact) in enumerate(
            levels_of(gl_context, overlays, picture, StoredColour("linear", alpha=True))
        ):
            np.testing.assert_allclose(read, exact, atol=max(level, 1) * 2.0**-11)  # half floats, rounded at each level


@pytest.mark.parametrize("size", SIZES)
def test_levels_of_codes_are_means_of_light(gl_context: GlContext, size: tuple[int, int]) -> None:
    rng = np.random.default_rng(8)
    picture = rng.choice(np.array([0, 128, 255], np.uint8), (*size[::-1], 4))
    for level, (read, exact) in enumerate(levels_of(gl_context, OverlayImport(gl_context), picture, PREMULTIPLIED)):
        rounded = 0.75 * max(level, 1)  # to whole codes at each level, which llvmpipe decodes to 0.2 codes
        light = exact[..., :3]
        code = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
        np.testing.assert_allclose(read[..., :3], 255 * code, atol=rounded)
        np.testing.assert_allclose(read[..., 3] / 255, exact[..., 3], atol=rounded / 255)

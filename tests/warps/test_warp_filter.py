"""Where the map shrinks, the mean over what a display pixel covers: against the exact mean of the picture."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hardware import SRGB_DECODE, allowed
from warping import warped

from wlr_render.geometry.pinhole import Pinhole
from wlr_render.gl.context import GlContext
from wlr_render.numerics.arrays import Float32Array, FloatArray
from wlr_render.numerics.srgb import decode_srgb
from wlr_render.warp.raster_camera import samples_for
from wlr_render.warp.view import GeometryImage

pytestmark = pytest.mark.gl

CAMERA = Pinhole(360, 360, np.array([-0.5, -0.5]), np.array([0.5, 0.5]))


def picture_of(code: FloatArray) -> GeometryImage:
    """A grey picture (360, 360) at 2 m."""
    colour = np.repeat(np.rint(code)[..., None], 3, axis=-1).astype(np.uint8)
    return GeometryImage(colour, np.full(code.shape, 0.5, np.float32))


def zone_plate() -> FloatArray:
    """Codes of rings that are the finer the further out, to half a cycle per pixel at the sides."""
    x, y = np.meshgrid(np.arange(360) - 179.5, np.arange(360) - 179.5)
    return np.asarray(127.5 + 127.5 * np.cos(np.pi * (x**2 + y**2) / 360))


def checkerboard() -> FloatArray:
    """Codes of squares of one pixel."""
    return np.asarray(255.0 * (np.indices((360, 360)).sum(axis=0) % 2))


def shrinking(times: float, phase: float = 0.37) -> Float32Array:
    """Rays of a display that shows the whole picture `times` smaller; its pixels cover times x times pixels."""
    count = round(360 / times)
    u = (np.arange(count) + 0.5) * times + phase
    tangents = CAMERA.tangents_of_pixel(np.stack(np.meshgrid(u, u), axis=-1))
    return np.concatenate([tangents, 0 * tangents], axis=-1).transpose(2, 0, 1).astype(np.float32)


def exact_mean(code: FloatArray, times: float, phase: float = 0.37) -> FloatArray:
    """Mean light over the display pixels of the picture, which is constant over each of its own pixels; (n, n)."""
    light = decode_srgb(np.rint(code).astype(np.uint8)).astype(np.float64)
    edges = np.minimum(np.arange(round(360 / times) + 1) * times + phase, 360.0)
    cumulated = np.concatenate([np.zeros((1, 360)), np.cumsum(light, axis=0)])

    def along_first(sums: FloatArray) -> FloatArray:
        at = np.stack([np.interp(edges, np.arange(361), column) for column in sums.T], axis=-1)
        return np.asarray(np.diff(at, axis=0) / np.diff(edges)[:, None])

    rows = along_first(cumulated)
    return along_first(np.concatenate([np.zeros((1, rows.shape[0])), np.cumsum(rows.T, axis=0)])).T


@pytest.mark.parametrize("code", [zone_plate, checkerboard])
@pytest.mark.parametrize(("times", "gain"), [(1.5, 10.0), (2, 1000.0), (2.4, 100.0), (3, 200.0)])
def test_more_samples_reduce_aliasing(
    gl_context: GlContext, code: Callable[..., Any], times: float, gain: float
) -> None:
    image, slope_offset = picture_of(code()), shrinking(times)
    exact = exact_mean(code(), times)
    inner = slice(2, -2)

    def energy(samples_per_axis: int) -> float:
        result = warped(gl_context, image, CAMERA, [slope_offset], samples_per_axis=samples_per_axis)
        light = decode_srgb(result.colour[..., 1])
        return float(np.square(light - exact)[inner, inner].mean())

    assert energy(samples_for(times)) * gain < energy(1)


def test_more_samples_do_not_change_linear_pictures_or_holes(gl_context: GlContext) -> None:
    ramp = np.add.outer(0.3 * np.arange(360), 0.4 * np.arange(360))
    slope_offset = shrinking(2)
    slope_offset[:, 50:60, 70:81] = np.nan
    one, three = (warped(gl_context, picture_of(ramp), CAMERA, [slope_offset], samples_per_axis=n) for n in (1, 3))
    np.testing.assert_array_equal(one.status, three.status)
    difference = np.abs(one.colour.astype(int) - three.colour)
    # Either mean has its own errors of decoded texels; neighbours differ by less than a code.
    assert difference[2:-2, 2:-2].max() <= allowed(gl_context, 1, 2 * SRGB_DECODE)

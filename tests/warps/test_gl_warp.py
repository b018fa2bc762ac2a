from collections.abc import Iterable

import numpy as np
import pytest
from gl_scenes import at, cube, lit, quad, unlit, view
from hardware import SRGB_DECODE, VERTEX_SNAP_PX, allowed, codes_of, filter_of
from numpy.typing import NDArray
from present import present
from warping import field_of_pixels, warp_pixels

from wlr_render.draw.gl_raster import GlRaster
from wlr_render.geometry import transforms
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.gl.context import GlContext
from wlr_render.numerics.arrays import Float32Array, FloatArray
from wlr_render.numerics.srgb import decode_srgb
from wlr_render.warp.gl_warp import GlWarp
from wlr_render.warp.gpu_image import GpuImage
from wlr_render.warp.warp import WarpStatus

pytestmark = pytest.mark.gl

CAMERA = Pinhole(96, 80, np.array([-0.5, -0.35]), np.array([0.4, 0.4]))


def bend_field(tangents: FloatArray, offset: Iterable[float] = (0.0, 0.0)) -> Float32Array:
    """(4, height, width) of tangents (height, width, 2) with one offset (c, d) for all pixels."""
    c, d = (np.full(tangents.shape[:2], x) for x in offset)
    return np.stack([tangents[..., 0], tangents[..., 1], c, d]).astype(np.float32)


def straight(camera: Pinhole = CAMERA) -> Float32Array:
    return bend_field(camera.pixel_centre_tangents())


@pytest.fixture
def busy_picture(gl_context: GlContext) -> GpuImage:
    scene = lit(
        (cube(0.5), at(0.1, 0, -1.5, transforms.rotation_about("y", 0.5))), (quad((-9, -9), (9, 9)), at(0, 0, -4))
    )
    return GlRaster(gl_context, scene).draw_on_gpu(view(CAMERA))


def test_straight_rays_give_the_picture_back_bit_by_bit(gl_context: GlContext, busy_picture: GpuImage) -> None:
    warped = warp_pixels(gl_context, busy_picture, [straight()])
    np.testing.assert_array_equal(warped.colour, busy_picture.read().colour)
    assert (warped.status == WarpStatus.SEEN).all()
    centres = np.stack(np.meshgrid(np.arange(96) + 0.5, np.arange(80) + 0.5), axis=-1)
    np.testing.assert_allclose(present(warped.source), centres, atol=allowed(gl_context, 1e-4, VERTEX_SNAP_PX))


def test_pixels_without_a_ray_or_beyond_the_picture_show_the_background(
    gl_context: GlContext, busy_picture: GpuImage
) -> None:
    slope_offset = straight()
    slope_offset[2, 10:20, 30:40] = np.nan
    slope_offset[0, 50] += 2.0
    warped = warp_pixels(gl_context, busy_picture, [slope_offset], background=(1, 2, 3))
    expected = np.full((80, 96), WarpStatus.SEEN)
    expected[10:20, 30:40], expected[50] = WarpStatus.NO_RAY, WarpStatus.OUTSIDE
    sure = np.ones((80, 96), bool)
    sure[9:21, 29:41], sure[47:54] = False, False  # cells that share grid points with others
    sure[10:20, 30:40], sure[50] = True, True
    np.testing.assert_array_equal(warped.status[sure], expected[sure])
    nothing = warped.status != WarpStatus.SEEN
    np.testing.assert_array_equal(warped.colour[nothing], [[1, 2, 3]] * nothing.sum())
    np.testing.assert_array_equal(np.isnan(present(warped.source)[..., 0]), nothing)


def test_colour_between_pixels_is_bilinear_in_linear_light(gl_context: GlContext, busy_picture: GpuImage) -> None:
    light = decode_srgb(busy_picture.read().colour).astype(float)
    step = 1 / CAMERA.focal_px
    slope_offset = bend_field(CAMERA.pixel_centre_tangents() + [0.25 * step[0], -0.5 * step[1]])
    warped = warp_pixels(gl_context, busy_picture, [slope_offset])
    across = 0.75 * light[:, :-1] + 0.25 * light[:, 1:]
    mixed = 0.5 * across[:-1] + 0.5 * across[1:]
    # Half a code is rounding.
    most = 0.5 + SRGB_DECODE + allowed(gl_context, 0.0, codes_of(mixed, filter_of(light)[:-1, :-1]))
    assert (np.abs(warped.colour[:-1, :-1] - exact_code(mixed)) <= most).all()


def exact_code(light: FloatArray) -> FloatArray:
    """sRGB of linear light, 0 to 255, not rounded."""
    light = np.clip(light, 0, 1)
    return 255 * np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def test_a_display_and_a_camera_of_new_sizes_are_followed(gl_context: GlContext, busy_picture: GpuImage) -> None:
    warp = GlWarp(gl_context)

    def drawn(image: GpuImage, camera: Pinhole) -> NDArray[np.uint8]:
        size = camera.width_px, camera.height_px
        return warp.draw(image, [field_of_pixels(gl_context, straight(camera))], np.eye(4), size).read().colour

    drawn(busy_picture, CAMERA)
    small = Pinhole(40, 30, CAMERA.tangent_min, CAMERA.tangent_max)
    image = GlRaster(gl_context, unlit((cube(), at(0, 0, -2)))).draw_on_gpu(view(small))
    np.testing.assert_array_equal(drawn(image, small), image.read().colour)
    np.testing.assert_array_equal(drawn(busy_picture, CAMERA), busy_picture.read().colour)

"""Pictures in layers, mip levels and samples of textures, by ModernGL's objects or OpenGL's names."""

import ctypes
from collections.abc import Sequence

import moderngl
import numpy as np
import pytest
from gl_scenes import OFF_CENTRE as CAMERA
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.gl import gl
from wlr_render.gl.context import GlContext
from wlr_render.gl.framebuffers import TextureLayer
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import Float32Array
from wlr_render.warp.compositor import Compositor
from wlr_render.warp.gpu_image import GpuImage
from wlr_render.warp.picture_import import PictureImport
from wlr_render.warp.stored_picture import CODES, DepthKind, StoredColour, StoredDepth

pytestmark = pytest.mark.gl

SIZE = WIDTH, HEIGHT = CAMERA.width_px, CAMERA.height_px
INVERSE, WINDOW = StoredDepth(DepthKind.INVERSE), StoredDepth(DepthKind.WINDOW, 0.5, 4.0)
COLOURS = np.random.default_rng(1).integers(0, 256, (HEIGHT, WIDTH, 4), np.uint8)
DEPTHS = np.random.default_rng(2).uniform(0.1, 0.9, (HEIGHT, WIDTH)).astype(np.float32)
TEXTURE_2D_ARRAY, DEPTH_COMPONENT32F, DEPTH_COMPONENT, FLOAT = 0x8C1A, 0x8CAC, 0x1902, 0x1406
FRAMEBUFFER, COLOUR, DEPTH = 0x8D40, 0x8CE0, 0x8D00


@pytest.fixture
def take(gl_context: GlContext) -> PictureImport:
    return PictureImport(gl_context)


def array_of(
    context: moderngl.Context, last: Float32Array | NDArray[np.uint8], dtype: str, other: float
) -> moderngl.TextureArray:
    """An array texture of three layers whose last one is given, and the others hold one value."""
    layers = np.stack([np.full_like(last, other), np.full_like(last, other), last])
    components = last.shape[2] if last.ndim == 3 else 1
    return context.texture_array((*SIZE, 3), components, np.ascontiguousarray(layers), dtype=dtype)


def depth_array(context: GlContext, layers: Sequence[Float32Array]) -> int:
    """OpenGL's name of an array texture of a depth format."""
    name = (ctypes.c_uint * 1)()
    uint, pointer = ctypes.c_uint, ctypes.c_void_p
    context.function("glGenTextures", ctypes.c_int, pointer)(1, ctypes.addressof(name))
    context.function("glBindTexture", uint, uint)(TEXTURE_2D_ARRAY, name[0])
    image = context.function("glTexImage3D", uint, *[ctypes.c_int] * 6, uint, uint, pointer)
    data = np.ascontiguousarray(layers, np.float32)
    size = WIDTH, HEIGHT, len(layers)
    image(TEXTURE_2D_ARRAY, 0, DEPTH_COMPONENT32F, *size, 0, DEPTH_COMPONENT, FLOAT, data.ctypes.data)
    context.function("glTexParameteri", *[uint] * 3)(TEXTURE_2D_ARRAY, 0x813D, 0)  # GL_TEXTURE_MAX_LEVEL
    context.function("glBindTexture", uint, uint)(TEXTURE_2D_ARRAY, 0)
    return name[0]


def assert_taken(image: GpuImage, inverse: Float32Array = DEPTHS) -> None:
    picture = image.read()
    np.testing.assert_array_equal(picture.colour, COLOURS[::-1, :, :3])
    np.testing.assert_allclose(picture.inverse_depth, inverse[::-1], rtol=1e-5)


def test_a_layer_of_an_array_by_object_or_name(gl_context: GlContext, take: PictureImport) -> None:
    with gl_context.drawing() as ctx:
        colour, depth = array_of(ctx, COLOURS, "f1", 9), array_of(ctx, DEPTHS, "f4", 0.5)
        window = depth_array(gl_context, [0 * DEPTHS, 0 * DEPTHS, DEPTHS])
    assert_taken(take.take(CAMERA, TextureLayer(colour, 2), TextureLayer(depth, 2), INVERSE))
    assert_taken(take.take(CAMERA, TextureLayer(colour.glo, 2), TextureLayer(depth.glo, layer=2), INVERSE))
    inverse = 1 / 0.5 + DEPTHS * (1 / 4 - 1 / 0.5)
    assert_taken(take.take(CAMERA, TextureLayer(colour.glo, 2), TextureLayer(window, 2), WINDOW), inverse)
    assert (take.take(CAMERA, colour, depth, INVERSE).read().colour == 9).all()


def test_a_mip_level(gl_context: GlContext, take: PictureImport) -> None:
    with gl_context.drawing() as ctx:
        colour, depth = ctx.texture((4 * WIDTH, 4 * HEIGHT), 4), ctx.texture((2 * WIDTH, 2 * HEIGHT), 1, dtype="f4")
        colour.build_mipmaps()
        depth.build_mipmaps()
        colour.write(COLOURS, level=2)
        depth.write(DEPTHS, level=1)
    assert_taken(take.take(CAMERA, TextureLayer(colour, level=2), TextureLayer(depth, level=1), INVERSE))


def test_rectangles_of_textures(gl_context: GlContext, take: PictureImport) -> None:
    """Both eyes in one texture, layers of an array, and a depth in another place than the colours."""
    wide, first = (
        np.full((HEIGHT + 5, 2 * WIDTH + 3, 4), 9, np.uint8),
        np.full((HEIGHT + 2, WIDTH + 1), 0.5, np.float32),
    )
    wide[4 : 4 + HEIGHT, WIDTH + 3 :], first[2:, 1:] = COLOURS, DEPTHS
    with gl_context.drawing() as ctx:
        colour = ctx.texture((2 * WIDTH + 3, HEIGHT + 5), 4, wide, alignment=1)
        array = ctx.texture_array((2 * WIDTH + 3, HEIGHT + 5, 2), 4, np.stack([0 * wide, wide]), alignment=1)
        depth = ctx.texture((WIDTH + 1, HEIGHT + 2), 1, first, dtype="f4")
        buffer = ctx.depth_texture((WIDTH + 1, HEIGHT + 2), first)
    rect, depth_rect = (WIDTH + 3, 4, WIDTH, HEIGHT), (1, 2, WIDTH, HEIGHT)
    for given in (TextureLayer(colour, rect_px=rect), TextureLayer(array.glo, 1, rect_px=rect)):
        assert_taken(take.take(CAMERA, given, TextureLayer(depth, rect_px=depth_rect), INVERSE))
        inverse = 1 / 0.5 + DEPTHS * (1 / 4 - 1 / 0.5)
        assert_taken(take.take(CAMERA, given, TextureLayer(buffer.glo, rect_px=depth_rect), WINDOW), inverse)
        assert take.colour_alone(given, CODES).size == SIZE
    aside = take.take(
        CAMERA, TextureLayer(colour, rect_px=(0, 0, *SIZE)), TextureLayer(depth, rect_px=depth_rect), INVERSE
    )
    assert (aside.read().colour == 9).all()


def test_multisampled_textures_are_resolved(gl_context: GlContext, take: PictureImport) -> None:
    with gl_context.drawing() as ctx:
        colour, depth = ctx.texture(SIZE, 4, samples=4), ctx.depth_texture(SIZE, samples=4)
        drawn = ctx.framebuffer([colour], depth)
        drawn.clear(0.2, 0.4, 0.6, 1.0, depth=0.25)
    for given, beside in ((colour, depth), (colour.glo, depth.glo), (drawn, None), (drawn.glo, None)):
        picture = take.take(CAMERA, given, beside, WINDOW).read()
        assert (picture.colour == [51, 102, 153]).all()
        np.testing.assert_allclose(picture.inverse_depth, 2 + 0.25 * (0.25 - 2), rtol=1e-4)


def test_metres_in_a_depth_format_are_refused(gl_context: GlContext, take: PictureImport) -> None:
    """The default of `Compositor.submit`: a depth buffer's values would be shown as metres."""
    with gl_context.drawing() as ctx:
        colour, depth = ctx.texture(SIZE, 4), ctx.depth_texture(SIZE)
        drawn = ctx.framebuffer([colour], depth)
        drawn.clear(depth=0.25)
    pictures = (
        (colour, depth),
        (colour.glo, np.uint32(depth.glo)),
        (TextureLayer(colour), depth),
        (drawn, None),
        (drawn.glo, None),
    )
    for given, beside in pictures:
        with pytest.raises(BadInputError, match=r"holds no metres; say .* stored=StoredDepth\(DepthKind.WINDOW, near"):
            take.take(CAMERA, given, beside, StoredDepth())
        assert (take.take(CAMERA, given, beside, WINDOW).read().inverse_depth > 0).all()


def test_a_framebuffer_with_layers_as_attachments(gl_context: GlContext, take: PictureImport) -> None:
    with gl_context.drawing() as ctx:
        colour = array_of(ctx, COLOURS, "f1", 9)
        window = depth_array(gl_context, [DEPTHS, 0 * DEPTHS])
        name = (ctypes.c_uint * 1)()
        uint, sint = ctypes.c_uint, ctypes.c_int
        gl_context.function("glGenFramebuffers", sint, ctypes.c_void_p)(1, ctypes.addressof(name))
        gl_context.function("glBindFramebuffer", uint, uint)(FRAMEBUFFER, name[0])
        attach = gl_context.function("glFramebufferTextureLayer", uint, uint, uint, sint, sint)
        attach(FRAMEBUFFER, COLOUR, colour.glo, 0, 2)
        attach(FRAMEBUFFER, DEPTH, window, 0, 0)
    assert_taken(take.take(CAMERA, name[0], None, WINDOW), 2 + DEPTHS * (0.25 - 2))
    with gl_context.drawing():
        gl_context.function("glBindFramebuffer", uint, uint)(FRAMEBUFFER, name[0])
        gl_context.function("glFramebufferTexture", uint, uint, uint, sint)(FRAMEBUFFER, COLOUR, colour.glo, 0)
        gl_context.function("glFramebufferTexture", uint, uint, uint, sint)(FRAMEBUFFER, DEPTH, window, 0)
    with pytest.raises(BadInputError, match="is layered"):
        take.take(CAMERA, name[0], None, WINDOW)


def test_floats_keep_more_than_bytes(gl_context: GlContext, take: PictureImport) -> None:
    """In a texture that is read in place, and in a mip level that is copied."""
    light = np.full((HEIGHT, WIDTH, 4), 0.50098, np.float16)
    with gl_context.drawing() as ctx:
        plain, level = ctx.texture(SIZE, 4, light, dtype="f2"), ctx.texture((2 * WIDTH, 2 * HEIGHT), 4, dtype="f2")
        depth = ctx.texture(SIZE, 1, DEPTHS, dtype="f4")
        level.build_mipmaps()
        level.write(light, level=1)
    for given in (TextureLayer(plain), TextureLayer(level, level=1)):
        taken = take.take(CAMERA, given, depth, INVERSE, stored_colour=StoredColour("linear"))
        with gl_context.drawing():
            np.testing.assert_array_equal(gl.read(taken.colour, np.float16)[..., :3], light[..., :3])


def test_a_texture_that_died_is_told_and_the_last_picture_stays(
    made: Compositor, gl_context: GlContext, flat_image_headset: Eye
) -> None:
    seen = flat_image_headset.eye_box.centre
    (camera,) = made.begin_frame(np.eye(4), seen).values()
    with gl_context.drawing() as ctx:
        colour = ctx.texture(camera.size_px, 4, np.full((*camera.size_px[::-1], 4), 70, np.uint8))
        depth = ctx.texture(camera.size_px, 1, np.ones(camera.size_px[::-1], np.float32), dtype="f4")
    layers = TextureLayer(colour.glo), TextureLayer(depth.glo)
    made.submit(*layers)
    assert (made.compose().read() == 70).all()
    made.begin_frame(np.eye(4), seen)
    with gl_context.drawing():
        colour.release()
    with pytest.raises(BadInputError, match=r"number \d+ is not a texture of the OpenGL context"):
        made.submit(*layers)
    assert (made.compose().read() == 70).all()


def test_bad_layers_are_refused_in_a_sentence(gl_context: GlContext, take: PictureImport) -> None:
    with gl_context.drawing() as ctx:
        colour, depth = ctx.texture(SIZE, 4), ctx.texture(SIZE, 1, dtype="f4")
        array, whole = ctx.texture_array((*SIZE, 2), 4), ctx.texture(SIZE, 4, dtype="u1")
        levels, several = ctx.texture(SIZE, 4), ctx.texture(SIZE, 4, samples=4)
        cube = ctx.texture_cube(SIZE[:1] * 2, 4)
        levels.build_mipmaps()
        gone = ctx.texture_array((*SIZE, 2), 4)
        gone.release()
    for (given, beside), words in (
        ((1999, depth.glo), "number 1999 is not a texture of the OpenGL context"),
        ((TextureLayer(array, 5), depth), r"texture \d+ has no layer 5; it has 2, counted from 0"),
        ((TextureLayer(colour, 1), depth), r"texture \d+ has no layer 1; it has 1, counted"),
        ((TextureLayer(colour, level=3), depth), r"texture \d+ has no level 3; it has 1, counted from 0"),
        ((TextureLayer(levels, level=30), depth), r"texture \d+ has no level 30; it has 7, counted from 0"),
        ((TextureLayer(several, level=1), depth), r"texture \d+ has no level 1; it has 1, counted from 0"),
        (
            (TextureLayer(colour, rect_px=(1, 0, *SIZE)), depth),
            r"rect_px is \(1, 0, 64, 48\), and texture \d+ has 64 x 48",
        ),
        ((TextureLayer(colour, rect_px=(0, 0, 9, 48)), depth), "has 9x48 pixels, the camera 64x48"),
        ((depth.glo, depth.glo), "holds no red, green and blue"),
        ((whole.glo, depth.glo), "holds whole numbers for colours: use RGBA8"),
        ((int(cube.glo), depth), r"texture \d+ is a cube map, a buffer or a row; give a 2D"),
        ((colour.glo, whole.glo), "holds no depth that can be copied"),
        ((gone, depth), "has been released"),
        ((colour, 0.5), "a picture cannot be taken from a Texture and a float"),
        ((colour, None), "a picture cannot be taken from a Texture and a NoneType"),
    ):
        with pytest.raises(BadInputError, match=words):
            take.take(CAMERA, given, beside, INVERSE)
    assert TextureLayer(5, rect_px=[1, 2, 3, 4]) == TextureLayer(5, rect_px=(1, 2, 3, 4))
    hash(TextureLayer(5, rect_px=[1, 2, 3, 4]))
    for bad, words in (
        ({"texture": "colour"}, "texture is a str; give"),
        ({"texture": 5, "layer": -1}, "layer is -1; give a whole number from 0"),
        ({"texture": 5, "level": 0.5}, "level is 0.5"),
        ({"texture": True}, "texture is a bool"),
        ({"texture": 5, "rect_px": (0, 0, 8, 0)}, r"rect_px is \(0, 0, 8, 0\); give \(x, y, width, height\)"),
        ({"texture": 5, "rect_px": (-1, 0, 8, 8)}, r"rect_px is \(-1, 0, 8, 8\)"),
        ({"texture": 5, "rect_px": (0, 0, 8)}, r"rect_px is \(0, 0, 8\)"),
    ):
        with pytest.raises(BadInputError, match=words):
            TextureLayer(**bad)

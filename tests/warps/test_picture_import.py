"""Pictures of other programs: what was drawn by us, told as others tell it, must come back the same."""

import ctypes
from collections.abc import Callable, Sequence

import gl_scenes
import moderngl
import numpy as np
import pytest
from gl_scenes import OFF_CENTRE as CAMERA
from numpy.typing import NDArray
from warps.composing import HEAD, Make, planar, viewpoint

from benchmarks.submission.gl_calls import GlCalls
from wlr_render.draw.gl_raster import NEAR_M, GlRaster
from wlr_render.errors import BadInputError
from wlr_render.gl import gl
from wlr_render.gl.context import GlContext
from wlr_render.gl.framebuffers import TextureLayer
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import Float32Array, FloatArray
from wlr_render.warp.compositor import Compositor
from wlr_render.warp.gpu_image import GpuImage
from wlr_render.warp.picture_import import PictureImport
from wlr_render.warp.stored_picture import CODES, DepthKind, Rows, StoredColour, StoredDepth
from wlr_render.warp.view import GeometryImage

pytestmark = pytest.mark.gl

SIZE = WIDTH, HEIGHT = CAMERA.width_px, CAMERA.height_px
MOVED = HEAD @ gl_scenes.at(0.01, 0.0, 0.0, np.eye(3))
FAR_M = 9.0
METRES, INVERSE = StoredDepth(DepthKind.METRES), StoredDepth(DepthKind.INVERSE)
WINDOW = StoredDepth(DepthKind.WINDOW, NEAR_M, np.inf)


def metres(inverse_depth: FloatArray, nothing: float = 0.0) -> FloatArray:
    with np.errstate(divide="ignore"):
        return np.where(inverse_depth > 0, 1 / inverse_depth, nothing)


def buffered(inverse_depth: FloatArray, at_0: float, at_1: float, nothing: int) -> FloatArray:
    """A depth buffer's values, by the projection that puts distance at_0 at 0 and at_1 at 1."""
    stored = (inverse_depth - 1 / at_0) / (1 / at_1 - 1 / at_0)
    return np.where(inverse_depth > 0, stored, nothing)


TOLD: dict[str, tuple[StoredDepth, Callable[[FloatArray], FloatArray]]] = {
    "metres": (METRES, metres),
    "metres, nothing is infinite": (METRES, lambda inverse: metres(inverse, np.inf)),
    "inverse": (INVERSE, lambda inverse: inverse),
    "window": (StoredDepth(DepthKind.WINDOW, 1.0, FAR_M), lambda inverse: buffered(inverse, 1.0, FAR_M, 1)),
    "window without end": (StoredDepth(DepthKind.WINDOW, 1.0), lambda inverse: buffered(inverse, 1.0, np.inf, 1)),
    "window reversed": (
        StoredDepth(DepthKind.WINDOW, np.inf, 0.05),
        lambda inverse: buffered(inverse, np.inf, 0.05, 0),
    ),
    "window reversed, with an end": (
        StoredDepth(DepthKind.WINDOW, FAR_M, 0.05),
        lambda inverse: buffered(inverse, FAR_M, 0.05, 0),
    ),
    "window in a part of the range": (
        StoredDepth(DepthKind.WINDOW, 1.0, FAR_M, min_depth=0.1, max_depth=0.6),
        lambda inverse: 0.1 + 0.5 * buffered(inverse, 1.0, FAR_M, 1),
    ),
    "window reversed in a part of the range": (
        StoredDepth(DepthKind.WINDOW, np.inf, 0.05, min_depth=0.25, max_depth=1.0),
        lambda inverse: 0.25 + 0.75 * buffered(inverse, np.inf, 0.05, 0),
    ),
}


@pytest.fixture
def drawn(gl_context: GlContext) -> GpuImage:
    scene = gl_scenes.lit(
        (gl_scenes.cube(), gl_scenes.at(0.1, 0.2, -2)), (gl_scenes.cube(), gl_scenes.at(-1, -0.5, -4))
    )
    return GlRaster(gl_context, scene).draw_on_gpu(gl_scenes.view())


@pytest.fixture
def take(gl_context: GlContext) -> PictureImport:
    return PictureImport(gl_context)


def assert_same(taken: GeometryImage, expected: GeometryImage) -> None:
    np.testing.assert_array_equal(taken.colour, expected.colour)
    np.testing.assert_allclose(taken.inverse_depth, expected.inverse_depth, rtol=1e-5, atol=0)
    assert (expected.inverse_depth > 0).sum() > 500


@pytest.mark.parametrize("rows", Rows)
@pytest.mark.parametrize("told", TOLD)
def test_arrays_come_back_as_they_were_drawn(take: PictureImport, drawn: GpuImage, told: str, rows: Rows) -> None:
    stored, tell = TOLD[told]
    picture = drawn.read()
    depth = tell(picture.inverse_depth.astype(np.float64)).astype(np.float32)
    step = 1 if rows is Rows.TOP_FIRST else -1
    colour = np.broadcast_to(picture.colour[::step], picture.colour.shape)  # which makes it read only
    assert_same(take.from_arrays(CAMERA, colour, depth[::step], stored, rows).read(), picture)


def test_textures_are_read_past_their_own_settings(gl_context: GlContext, take: PictureImport) -> None:
    """Past a format that is read in linear light, filters, comparisons, a swizzle and a base level."""
    colours = np.random.default_rng(0).integers(0, 256, (*SIZE[::-1], 4), np.uint8)
    with gl_context.drawing() as ctx:
        encoded = ctx.texture(SIZE, 4, colours, internal_format=0x8C43)  # GL_SRGB8_ALPHA8
        encoded.filter = ctx.LINEAR_MIPMAP_LINEAR, ctx.LINEAR
        swizzled, levels = (ctx.texture(SIZE, 4, colours) for _ in range(2))
        swizzled.swizzle = "BGRA"
        levels.build_mipmaps()
        levels.use(0)
        gl_context.function("glTexParameteri", *[ctypes.c_uint] * 3)(0x0DE1, 0x813C, 1)  # GL_TEXTURE_BASE_LEVEL
        compared = ctx.depth_texture(SIZE, np.full(SIZE[::-1], 0.5, np.float32))
    for given in (encoded, swizzled, levels):
        taken = take.from_textures(CAMERA, given, compared, StoredDepth(DepthKind.WINDOW, 1.0)).read()
        np.testing.assert_array_equal(taken.colour, colours[::-1, :, :3])
        np.testing.assert_allclose(taken.inverse_depth, 0.5, rtol=1e-6)


def test_what_lies_outside_a_depth_range_is_background(gl_context: GlContext, take: PictureImport) -> None:
    """As glClearDepth leaves it: the range of glDepthRange does not concern it."""
    stored = StoredDepth(DepthKind.WINDOW, 1.0, 9.0, min_depth=0.25, max_depth=0.5)
    values = np.array([0.0, 0.2, 0.25, 0.375, 0.5, 0.6, 1.0], np.float32)
    with gl_context.drawing() as ctx:
        row = np.resize(values, SIZE[0])
        colour, depth = ctx.texture(SIZE, 4), ctx.texture(SIZE, 1, np.tile(row, (SIZE[1], 1)), dtype="f4")
    taken = take.from_textures(CAMERA, colour, depth, stored).read().inverse_depth[0, :7]
    np.testing.assert_allclose(taken, [0, 0, 1, 5 / 9, 0, 0, 0], rtol=1e-6)
    picture = np.zeros((*SIZE[::-1], 3), np.uint8), np.tile(row, (SIZE[1], 1))
    taken = take.from_arrays(CAMERA, *picture, stored).read().inverse_depth[0, :7]
    np.testing.assert_allclose(taken, [0, 0, 1, 5 / 9, 0, 0, 0], rtol=1e-6)


def test_depths_at_the_ends_of_a_range_may_be_rounded(take: PictureImport) -> None:
    stored = StoredDepth(DepthKind.WINDOW, 1.0, np.inf, min_depth=0.25, max_depth=0.3)
    depth = np.full(SIZE[::-1], 0.25 - 3e-8, np.float32)
    depth[0, 0] = np.float32(0.3) + np.float32(3e-8)
    taken = take.from_arrays(CAMERA, np.zeros((*SIZE[::-1], 3), np.uint8), depth, stored).read().inverse_depth
    assert taken[0, 0] == 0
    np.testing.assert_allclose(taken.ravel()[1:], 1.0, rtol=1e-5)
    for far, end in ((10.0, 0.9), (10.0, 0.5)):  # the codes of 16 bits beside the end are background, too
        code = round(end * 65535) / 65535
        stored = StoredDepth(DepthKind.WINDOW, 0.1, far, max_depth=end)
        depth = np.full(SIZE[::-1], code, np.float32)
        depth[0, 0] = 0.99 * end
        taken = take.from_arrays(CAMERA, np.zeros((*SIZE[::-1], 3), np.uint8), depth, stored).read().inverse_depth
        assert taken[0, 0] > 0
        assert not taken.ravel()[1:].any()


def framebuffer(context: GlContext, depth_format: int | None = None) -> moderngl.Framebuffer:
    """A framebuffer whose lower half is nearer and of another colour than its upper one."""
    with context.drawing() as ctx:
        made = ctx.simple_framebuffer(SIZE)
        if depth_format is not None:
            _give_depth(context, made, depth_format)
        made.clear(0.2, 0.4, 0.6, 1.0, depth=0.5)
        made.clear(0.6, 0.2, 0.4, 1.0, depth=0.25, viewport=(0, 0, SIZE[0], SIZE[1] // 2))
    return made


def _give_depth(context: GlContext, made: moderngl.Framebuffer, depth_format: int) -> None:
    uint, name = ctypes.c_uint, ctypes.c_uint()
    context.function("glGenRenderbuffers", ctypes.c_int, ctypes.c_void_p)(1, ctypes.addressof(name))
    context.function("glBindRenderbuffer", uint, uint)(0x8D41, name)
    context.function("glRenderbufferStorage", *[uint] * 4)(0x8D41, depth_format, *made.size)
    context.function("glBindFramebuffer", uint, uint)(0x8D40, made.glo)
    context.function("glFramebufferRenderbuffer", *[uint] * 4)(0x8D40, 0x8D00, 0x8D41, name)


def assert_halves(picture: GeometryImage) -> None:
    upper, lower = np.split(np.arange(SIZE[1]), 2)
    for rows, colour, stored in ((upper, [51, 102, 153], 0.5), (lower, [153, 51, 102], 0.25)):
        assert (picture.colour[rows] == colour).all()
        np.testing.assert_allclose(picture.inverse_depth[rows], (1 - stored) / NEAR_M, rtol=1e-4)


def test_a_framebuffer_with_any_depth_is_copied(gl_context: GlContext, take: PictureImport) -> None:
    for depth_format in (0x81A5, 0x81A6, 0x88F0, 0x8CAC, 0x8CAD):  # 16, 24, 24 + stencil, 32 float, and with stencil
        theirs = framebuffer(gl_context, depth_format)
        assert_halves(take.from_framebuffer(CAMERA, theirs, WINDOW).read())
        assert_halves(take.from_framebuffer(CAMERA, theirs.glo, WINDOW).read())


def test_textures_are_read_in_place(compositor: Make) -> None:
    """A framebuffer's, by name, in a rectangle, and in layers of arrays; renderbuffers are copied."""
    calls, shown = GlCalls(), []
    with calls.counted():
        made = compositor(planar(), context="egl")
        (camera,) = made.begin_frame(HEAD, viewpoint(planar())).values()
        size = width, height = camera.view.camera.size_px
        with made.context.drawing() as ctx:
            colour, depth = ctx.texture(size, 4), ctx.depth_texture(size)
            of_textures, of_buffers = ctx.framebuffer([colour], depth), ctx.simple_framebuffer(size)
            for each in (of_textures, of_buffers):
                each.clear(0.2, 0.4, 0.6, 1.0, depth=0.5)
                each.clear(0.6, 0.2, 0.4, 1.0, depth=0.25, viewport=(0, 0, width, height // 2))
            pixels = np.frombuffer(colour.read(), np.uint8).reshape(height, width, 4)
            beside = ctx.texture((2 * width, height), 4, np.ascontiguousarray(np.hstack([0 * pixels, pixels])))
            layers = ctx.texture_array((*size, 2), 4, np.stack([0 * pixels, pixels]))
        for picture, copies in (
            ((of_buffers, None), 2),
            ((of_textures, None), 0),
            ((of_textures.glo, None), 0),
            ((colour.glo, depth.glo), 0),
            ((TextureLayer(beside, rect_px=(width, 0, *size)), depth), 0),
            ((TextureLayer(layers.glo, 1), depth.glo), 0),
        ):
            made.begin_frame(HEAD, viewpoint(planar()))
            calls.start()
            made.submit(*picture, eye="right", stored=WINDOW)
            assert calls.found().get("glBlitFramebuffer", 0) == copies
            shown.append(made.compose(pose=MOVED).read())
        made.release()
    for other in shown[1:]:
        np.testing.assert_array_equal(other, shown[0])
    assert len(np.unique(shown[0].reshape(-1, 3), axis=0)) > 1


def test_frames_make_no_objects(gl_context: GlContext, take: PictureImport) -> None:
    theirs, colour = framebuffer(gl_context), np.zeros((*SIZE[::-1], 3), np.uint8)
    depth = np.ones(SIZE[::-1], np.float32)

    def frame() -> None:
        take.from_framebuffer(CAMERA, theirs, WINDOW)
        take.from_arrays(CAMERA, colour, depth, METRES)

    frame()
    first = objects(gl_context)
    for _ in range(30):
        frame()
    assert objects(gl_context) == first


def objects(context: GlContext) -> list[int]:
    with context.drawing():
        kinds = "Texture", "Framebuffer", "Buffer", "VertexArray", "Sampler"
        alive = [context.function(f"glIs{kind}", ctypes.c_uint, result=ctypes.c_ubyte) for kind in kinds]
        return [sum(is_one(number) for number in range(2000)) for is_one in alive]


def test_bad_framebuffers_are_refused_in_a_sentence(gl_context: GlContext, take: PictureImport) -> None:
    with gl_context.drawing() as ctx:
        small = ctx.simple_framebuffer((3, 4))
        without_depth = ctx.framebuffer([ctx.texture(SIZE, 4)])
        whole_numbers = ctx.framebuffer([ctx.texture(SIZE, 4, dtype="u1")], ctx.depth_texture(SIZE))
    for bad, told in (
        (small, "has 3x4 pixels, the camera 64x48"),
        (without_depth, "has no depth attachment"),
        (whole_numbers, "holds whole numbers for colours: use RGBA8"),
        (0, "number 0 is not a framebuffer object"),
        (1999, "number 1999 is not a framebuffer object"),
    ):
        with pytest.raises(BadInputError, match=told):
            take.from_framebuffer(CAMERA, bad, WINDOW)
    assert_halves(take.from_framebuffer(CAMERA, framebuffer(gl_context), WINDOW).read())


TO_4_M = StoredDepth(DepthKind.WINDOW, 0.5, 4.0)
COLOURS = np.random.default_rng(1).integers(0, 256, (HEIGHT, WIDTH, 4), np.uint8)
DEPTHS = np.random.default_rng(2).uniform(0.1, 0.9, (HEIGHT, WIDTH)).astype(np.float32)
TEXTURE_2D_ARRAY, DEPTH_COMPONENT32F, DEPTH_COMPONENT, FLOAT = 0x8C1A, 0x8CAC, 0x1902, 0x1406
FRAMEBUFFER, COLOUR, DEPTH = 0x8D40, 0x8CE0, 0x8D00


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
    assert_taken(take.take(CAMERA, TextureLayer(colour.glo, 2), TextureLayer(window, 2), TO_4_M), inverse)
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
        assert_taken(take.take(CAMERA, given, TextureLayer(buffer.glo, rect_px=depth_rect), TO_4_M), inverse)
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
        picture = take.take(CAMERA, given, beside, TO_4_M).read()
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
        assert (take.take(CAMERA, given, beside, TO_4_M).read().inverse_depth > 0).all()


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
    assert_taken(take.take(CAMERA, name[0], None, TO_4_M), 2 + DEPTHS * (0.25 - 2))
    with gl_context.drawing():
        gl_context.function("glBindFramebuffer", uint, uint)(FRAMEBUFFER, name[0])
        gl_context.function("glFramebufferTexture", uint, uint, uint, sint)(FRAMEBUFFER, COLOUR, colour.glo, 0)
        gl_context.function("glFramebufferTexture", uint, uint, uint, sint)(FRAMEBUFFER, DEPTH, window, 0)
    with pytest.raises(BadInputError, match="is layered"):
        take.take(CAMERA, name[0], None, TO_4_M)


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

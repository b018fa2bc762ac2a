"""Pictures go where they are told to, upright, and nowhere else."""

import ctypes
from collections.abc import Callable, Mapping
from types import SimpleNamespace

import moderngl
import numpy as np
import pytest
from gl_caller import make_current, open_other
from numpy.typing import NDArray
from present import narrowed
from warps.composing import HEAD, SMALL, Make, draw, scene, viewpoint

from benchmarks.scene_source import SceneSource
from wlr_render.errors import BadInputError
from wlr_render.gl.framebuffers import TextureLayer
from wlr_render.gl.native_contexts import OsMesaBinding
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import FloatArray
from wlr_render.warp.compositor import Compositor

pytestmark = pytest.mark.gl

WIDTH, HEIGHT = SMALL
DRAW_FRAMEBUFFER, COLOUR = 0x8CA9, 0x8CE0


@pytest.fixture
def one_eye(seen: FloatArray, theirs: moderngl.Context, compositor: Make, flat_image_headset: Eye) -> Compositor:
    """A compositor of one eye to which a frame was submitted."""
    made: Compositor = compositor(flat_image_headset, context=theirs)
    draw(made, SceneSource(made, scene()), HEAD, seen)
    return made


@pytest.fixture
def two_eyes(theirs: moderngl.Context, compositor: Make, pair: Mapping[str, Eye]) -> Compositor:
    made: Compositor = compositor(pair, context=theirs)
    at = {"left": viewpoint(pair["left"], -0.7, 0, 0), "right": viewpoint(pair["right"], 0.7, 0, 0)}
    draw(made, SceneSource(made, scene()), HEAD, at)
    return made


def upright(framebuffer: moderngl.Framebuffer, attachment: int = 0) -> NDArray[np.uint8]:
    """What a framebuffer shows, its top row first."""
    pixels = framebuffer.read(components=3, attachment=attachment, alignment=1)
    return np.frombuffer(pixels, np.uint8).reshape(framebuffer.height, framebuffer.width, 3)[::-1]


def assert_same_but_for_rounding(shown: NDArray[np.uint8], expected: NDArray[np.uint8]) -> None:
    """Assert that pictures differ as their rays do, which other window coordinates round otherwise, by some 1e-4 px.

    That is worth a code where a colour lies at a tie; it changes by less than 100 codes a pixel, so that one in a
    hundred may lie there.
    """
    difference = np.abs(shown.astype(int) - expected)
    assert difference.max() <= 1
    assert (difference > 0).mean() < 0.01


def call(context: moderngl.Context, name: str, *arguments: ctypes.Array[ctypes.c_uint] | int) -> None:
    types = [ctypes.c_void_p if isinstance(each, ctypes.Array) else ctypes.c_uint for each in arguments]
    ctypes.CFUNCTYPE(None, *types)(context.mglo._context.load(name))(*arguments)


def test_both_eyes_go_the_same_wherever_they_go(theirs: moderngl.Context, two_eyes: Compositor) -> None:
    frame = two_eyes.compose()
    left, right = (frame.read(eye).copy() for eye in two_eyes.eyes)
    assert (left != right).any()
    texture = np.frombuffer(frame.texture("right").read(), np.uint8).reshape(HEIGHT, WIDTH, 4)
    np.testing.assert_array_equal(texture[..., :3], right)
    assert (texture[..., 3] == 255).all()
    beside = theirs.simple_framebuffer((2 * WIDTH, HEIGHT))
    for into in (beside, beside.glo, np.uint32(beside.glo)):
        beside.clear()
        two_eyes.compose(into)
        assert_same_but_for_rounding(upright(beside), np.hstack([left, right]))
    each = {eye: theirs.simple_framebuffer(SMALL) for eye in ("right", "left")}
    two_eyes.compose(each)
    for eye, picture in (("left", left), ("right", right)):
        assert_same_but_for_rounding(upright(each[eye]), picture)


@pytest.mark.parametrize("buffers", [(0, 1, 2), (1, None, 0), (None, 1, None)])
def test_only_the_first_colour_is_drawn_and_draw_buffers_come_back(
    theirs: moderngl.Context, one_eye: Compositor, buffers: tuple[int | None, int | None, int | None]
) -> None:
    expected = one_eye.compose().read()
    given = theirs.framebuffer(
        [theirs.texture(SMALL, 4, bytes([9 + k]) * (4 * WIDTH * HEIGHT)) for k in range(3)],
        theirs.depth_texture(SMALL, np.full((HEIGHT, WIDTH), 0.25, np.float32)),
    )
    names = (ctypes.c_uint * 3)(*(0 if k is None else COLOUR + k for k in buffers))
    call(theirs, "glBindFramebuffer", DRAW_FRAMEBUFFER, given.glo)
    call(theirs, "glDrawBuffers", 3, names)
    one_eye.compose(given)
    found = [(ctypes.c_uint * 1)() for _ in range(4)]
    call(theirs, "glBindFramebuffer", DRAW_FRAMEBUFFER, given.glo)
    for k, name in enumerate(found):
        call(theirs, "glGetIntegerv", 0x8825 + k, name)
    assert [name[0] for name in found] == [*names, 0]
    np.testing.assert_array_equal(upright(given), expected)
    for k in (1, 2):
        assert (np.frombuffer(narrowed(given.color_attachments[k], moderngl.Texture).read(), np.uint8) == 9 + k).all()
    assert np.ptp(np.frombuffer(narrowed(given.depth_attachment, moderngl.Texture).read(), np.float32)) == 0


def test_two_eyes_do_not_share_a_framebuffer_of_one_eyes_size(theirs: moderngl.Context, two_eyes: Compositor) -> None:
    shared = theirs.simple_framebuffer(SMALL)
    with pytest.raises(BadInputError, match="same framebuffer"):
        two_eyes.compose({"left": shared, "right": shared.glo})


def test_floats_are_drawn_as_bytes_are(theirs: moderngl.Context, one_eye: Compositor) -> None:
    expected = one_eye.compose().read()
    floats = theirs.framebuffer([theirs.texture(SMALL, 4, dtype="f4")])
    one_eye.compose(floats)
    shown = np.frombuffer(floats.read(components=3, dtype="f4"), np.float32).reshape(HEIGHT, WIDTH, 3)[::-1]
    np.testing.assert_allclose(shown * 255, expected, atol=0.51)


def test_layers_levels_and_samples_of_textures_are_targets(theirs: moderngl.Context, two_eyes: Compositor) -> None:
    frame = two_eyes.compose()
    left, right = (frame.read(eye).copy() for eye in two_eyes.eyes)
    array = theirs.texture_array((*SMALL, 3), 4, bytes([7]) * (4 * 3 * WIDTH * HEIGHT))
    two_eyes.compose({"left": TextureLayer(array, 1), "right": TextureLayer(array.glo, 2)})
    layers = np.frombuffer(array.read(), np.uint8).reshape(3, HEIGHT, WIDTH, 4)[:, ::-1, :, :3]
    assert (layers[0] == 7).all()
    assert_same_but_for_rounding(layers[1], left)
    assert_same_but_for_rounding(layers[2], right)

    both = theirs.texture((4 * WIDTH, 2 * HEIGHT), 4)
    both.build_mipmaps()
    for into in (TextureLayer(both, level=1), attached(theirs, both, level=1)):
        both.build_mipmaps()
        two_eyes.compose(into)
        shown = np.frombuffer(both.read(level=1), np.uint8).reshape(HEIGHT, 2 * WIDTH, 4)[::-1, :, :3]
        assert_same_but_for_rounding(shown, np.hstack([left, right]))

    wide = theirs.texture((2 * WIDTH + 5, HEIGHT + 4), 4, bytes([7]) * (4 * (2 * WIDTH + 5) * (HEIGHT + 4)))
    apart = {"left": (0, 3, *SMALL), "right": (WIDTH + 5, 3, *SMALL)}
    two_eyes.compose({eye: TextureLayer(wide, rect_px=rect) for eye, rect in apart.items()})
    shown = np.frombuffer(wide.read(), np.uint8).reshape(HEIGHT + 4, -1, 4)[::-1, :, :3]
    assert_same_but_for_rounding(shown[1:-3, :WIDTH], left)
    assert_same_but_for_rounding(shown[1:-3, WIDTH + 5 :], right)
    for untouched in (shown[0], shown[-3:], shown[:, WIDTH : WIDTH + 5]):
        assert (untouched == 7).all()
    two_eyes.compose(TextureLayer(wide, rect_px=(4, 1, 2 * WIDTH, HEIGHT)))
    shown = np.frombuffer(wide.read(), np.uint8).reshape(HEIGHT + 4, -1, 4)[::-1, :, :3]
    assert_same_but_for_rounding(shown[3:-1, 4:-1], np.hstack([left, right]))

    sampled, plain = theirs.texture((2 * WIDTH, HEIGHT), 4, samples=4), theirs.simple_framebuffer((2 * WIDTH, HEIGHT))
    for target in (sampled, theirs.framebuffer([sampled])):
        plain.clear()
        two_eyes.compose(target)
        theirs.copy_framebuffer(plain, theirs.framebuffer([sampled]))
        assert_same_but_for_rounding(upright(plain), np.hstack([left, right]))


def attached(
    context: moderngl.Context,
    texture: SimpleNamespace | moderngl.Texture | moderngl.Texture3D | moderngl.TextureArray,
    level: int = 0,
    layer: int | None = None,
) -> int:
    """The number of a framebuffer to which one layer and level of a texture is attached, or all layers."""
    name = (ctypes.c_uint * 1)()
    call(context, "glGenFramebuffers", 1, name)
    call(context, "glBindFramebuffer", DRAW_FRAMEBUFFER, name[0])
    if layer is None:
        call(context, "glFramebufferTexture", DRAW_FRAMEBUFFER, COLOUR, texture.glo, level)
    else:
        call(context, "glFramebufferTextureLayer", DRAW_FRAMEBUFFER, COLOUR, texture.glo, level, layer)
    return name[0]


SQUARE = 60, 60
POSITIVE_X, FACE, MULTISAMPLED_ARRAY, RGBA8 = 0x8515, 0x8517, 0x9102, 0x8058


@pytest.mark.parametrize("kind", ["array", "volume", "cube"])
def test_a_layer_of_an_array_a_slice_of_a_volume_and_a_face_of_a_cube_are_targets(
    seen: FloatArray, theirs: moderngl.Context, compositor: Make, flat_image_headset: Eye, kind: str
) -> None:
    made = compositor(flat_image_headset, SQUARE, context=theirs)
    draw(made, SceneSource(made, scene()), HEAD, seen)
    expected = made.compose().read()
    read: Callable[[], bytes]
    if kind == "cube":
        cube = theirs.texture_cube(SQUARE, 4)
        number, read = attached(theirs, theirs.texture(SQUARE, 4)), lambda: cube.read(face=FACE - POSITIVE_X)
        call(theirs, "glBindFramebuffer", DRAW_FRAMEBUFFER, number)
        call(theirs, "glFramebufferTexture2D", DRAW_FRAMEBUFFER, COLOUR, FACE, cube.glo, 0)
    else:
        texture = (theirs.texture_array if kind == "array" else theirs.texture3d)((*SQUARE, 3), 4)
        number, read = attached(theirs, texture, layer=2), lambda: texture.read()[-4 * 60 * 60 :]
        with pytest.raises(BadInputError, match=r"is layered .*TextureLayer\(texture, layer=0\)"):
            made.compose(attached(theirs, texture))
    made.compose(number)
    shown = np.frombuffer(read(), np.uint8).reshape(60, 60, 4)[::-1, :, :3]
    np.testing.assert_array_equal(shown, expected)
    assert theirs.error == "GL_NO_ERROR"


def test_a_layer_that_drivers_do_not_name_is_refused(theirs: moderngl.Context, one_eye: Compositor) -> None:
    """Mesa reports layer 0 for every layer of a multisampled array."""
    name, layer = (ctypes.c_uint * 1)(), (ctypes.c_uint * 1)()
    call(theirs, "glGenTextures", 1, name)
    call(theirs, "glBindTexture", MULTISAMPLED_ARRAY, name[0])
    call(theirs, "glTexImage3DMultisample", MULTISAMPLED_ARRAY, 4, RGBA8, *SMALL, 3, 1)
    number = attached(theirs, SimpleNamespace(glo=name[0]), layer=1)
    # GL_FRAMEBUFFER_ATTACHMENT_TEXTURE_LAYER
    call(theirs, "glGetFramebufferAttachmentParameteriv", DRAW_FRAMEBUFFER, COLOUR, 0x8CD4, layer)
    if layer[0]:
        pytest.skip("This driver names the layer.")
    with pytest.raises(BadInputError, match=r"a layer of a multisampled array .*TextureLayer\(texture, layer=0\)"):
        one_eye.compose(number)


def test_framebuffers_that_cannot_be_drawn_to_are_told_in_a_sentence(
    theirs: moderngl.Context, one_eye: Compositor
) -> None:
    expected = one_eye.compose().read()
    released = theirs.simple_framebuffer(SMALL)
    released.release()
    elsewhere = open_other()
    foreign, elsewhere_texture = elsewhere.simple_framebuffer(SMALL), elsewhere.texture(SMALL, 4)
    make_current(theirs)
    for into, words in (
        (theirs.simple_framebuffer((HEIGHT, WIDTH)), "has 60 x 72 pixels, and 72 x 60 are needed"),
        (theirs.simple_framebuffer((2 * WIDTH, HEIGHT)), "144 x 60"),
        (foreign, "another OpenGL context"),
        (0, "has no window"),
        (12345, "12345 is not a framebuffer object"),
        (-1, "is not a framebuffer object"),
        (released, "the framebuffer has been released, or an image of it; give one that is alive"),
        (theirs.framebuffer([theirs.texture(SMALL, 4, dtype="u1")]), "fractions"),
        (theirs.framebuffer([theirs.texture(SMALL, 2)]), "red, green and blue"),
        (theirs.framebuffer([], theirs.depth_texture(SMALL)), "first attachment"),
        ("left", "str is not a framebuffer"),
        (theirs.texture((HEIGHT, WIDTH), 4), "has 60 x 72 pixels, and 72 x 60 are needed"),
        (TextureLayer(12345), "12345 is not a texture"),
        (TextureLayer(theirs.texture_array((*SMALL, 2), 4), layer=2), "has no layer 2; it has 2, counted"),
        (TextureLayer(theirs.texture(SMALL, 4), level=1), "has no level 1; it has 1, counted"),
        (TextureLayer(theirs.texture(SMALL, 4), rect_px=(0, 1, *SMALL)), "has 72 x 60 pixels; give a rectangle within"),
        (elsewhere_texture, "another OpenGL context"),
        ({"left": theirs.simple_framebuffer(SMALL)}, "no framebuffer for the right eye"),
    ):
        with pytest.raises(BadInputError, match=words) as told:
            one_eye.compose(into)
        assert str(told.value).count("\n") == 0
        assert theirs.error == "GL_NO_ERROR"
    np.testing.assert_array_equal(one_eye.compose().read(), expected)
    elsewhere.release()


@pytest.mark.parametrize("kind", ["name", "object", "framebuffer"])
def test_a_target_that_died_is_told(theirs: moderngl.Context, one_eye: Compositor, kind: str) -> None:
    """Our framebuffer keeps its image, to which a frame would be drawn for nobody."""
    texture = theirs.texture(SMALL, 4)
    kinds = {"name": TextureLayer(texture.glo), "object": texture, "framebuffer": theirs.framebuffer([texture])}
    one_eye.compose(kinds[kind])
    texture.release()
    with pytest.raises(BadInputError, match=r"number \d+ is not a texture|has been released, or an image of it"):
        one_eye.compose(kinds[kind])


def test_what_went_elsewhere_is_not_fetched(theirs: moderngl.Context, one_eye: Compositor) -> None:
    frame = one_eye.compose(theirs.simple_framebuffer(SMALL))
    for fetch, words in (
        (frame.read, "into your framebuffer"),
        (frame.texture, "no texture"),
        (frame.source, "into your framebuffer"),
        (lambda: frame.read("left"), "left eye was not composed in this frame, which has right"),
    ):
        with pytest.raises(BadInputError, match=words):
            fetch()
    assert frame.unsolved() == {"right": {}}
    with pytest.raises(BadInputError, match="with_source"):
        one_eye.compose().source()


def test_a_window_is_drawn_to_by_its_number(seen: FloatArray, compositor: Make, flat_image_headset: Eye) -> None:
    try:
        window = OsMesaBinding().opened()
    except OSError as error:
        pytest.skip(f"libosmesa6 is not installed ({error}).")
    window.make_current()
    size = 16, 16  # of an OSMesa context's own picture
    made = compositor(flat_image_headset, size, context="current")
    draw(made, SceneSource(made, scene()), HEAD, seen)
    expected = made.compose().read()
    assert expected.std() > 5
    made.compose(into=0)
    pixels = np.empty((*size, 4), np.uint8)
    read = ctypes.CFUNCTYPE(None, *[ctypes.c_int] * 4, *[ctypes.c_uint] * 2, ctypes.c_void_p)
    read(window.load_opengl_function("glReadPixels"))(0, 0, *size, 0x1908, 0x1401, pixels.ctypes.data)
    np.testing.assert_array_equal(pixels[::-1, :, :3], expected)
    made.release()
    window.release()

"""Images of all kinds: found on a framebuffer of others, measured, and attached to one of ours."""

import ctypes

import numpy as np
import pytest

from wlr_render.errors import BadInputError
from wlr_render.rendering import gl
from wlr_render.rendering.framebuffers import COLOUR, DEPTH, FramebufferQueries, Image, fresh_framebuffer

pytestmark = pytest.mark.gl

UINT, INT = ctypes.c_uint, ctypes.c_int
RGBA8, RGBA, BYTES = 0x8058, 0x1908, 0x1401
ARRAY, MULTISAMPLED, MULTISAMPLED_ARRAY, RECTANGLE, VOLUME, CUBE = 0x8C1A, 0x9100, 0x9102, 0x84F5, 0x806F, 0x8513
SIZE = 16, 16
# By name: target, the call that makes its storage, layer, level, face.
KINDS = {
    "plain": (0x0DE1, ("glTexImage2D", 0, RGBA8, *SIZE, 0), 0, 0, 0),
    "mip level": (0x0DE1, ("glTexImage2D", 1, RGBA8, *SIZE, 0), 0, 1, 0),
    "array": (ARRAY, ("glTexImage3D", 0, RGBA8, *SIZE, 3, 0), 2, 0, 0),
    "volume": (VOLUME, ("glTexImage3D", 0, RGBA8, *SIZE, 3, 0), 1, 0, 0),
    "rectangle": (RECTANGLE, ("glTexImage2D", 0, RGBA8, *SIZE, 0), 0, 0, 0),
    "cube": (CUBE, ("glTexImage2D", 0, RGBA8, *SIZE, 0), 0, 0, 0x8517),
    "multisampled": (MULTISAMPLED, ("glTexImage2DMultisample", 4, RGBA8, *SIZE, 1), 0, 0, 0),
    "multisampled array": (MULTISAMPLED_ARRAY, ("glTexImage3DMultisample", 4, RGBA8, *SIZE, 3, 1), 1, 0, 0),
}


def made(context, kind):
    """The name of a texture and of a framebuffer of others that has one image of it."""
    target, (maker, *numbers), layer, level, face = KINDS[kind]
    names = [UINT(), UINT()]
    for name, objects in zip(names, ("Textures", "Framebuffers"), strict=True):
        context.function(f"glGen{objects}", INT, ctypes.c_void_p)(1, ctypes.addressof(name))
    texture, framebuffer = (name.value for name in names)
    context.function("glBindTexture", UINT, UINT)(target, texture)
    context.function("glTexParameteri", UINT, UINT, UINT)(target, 0x813C, level)  # GL_TEXTURE_BASE_LEVEL
    context.function("glTexParameteri", UINT, UINT, UINT)(target, 0x813D, level)  # GL_TEXTURE_MAX_LEVEL
    for side in range(0x8515, 0x851B) if face else [target]:
        if "Multisample" in maker:
            context.function(maker, *[UINT] * (1 + len(numbers)))(side, *numbers)
        else:
            image = context.function(maker, UINT, *[INT] * len(numbers), UINT, UINT, ctypes.c_void_p)
            image(side, *numbers, RGBA, BYTES, None)
    context.function("glBindTexture", UINT, UINT)(target, 0)
    context.function("glBindFramebuffer", UINT, UINT)(0x8D40, framebuffer)
    if layer:
        attach = context.function("glFramebufferTextureLayer", UINT, UINT, UINT, INT, INT)
        attach(0x8D40, COLOUR, texture, level, layer)
    elif face:
        attach = context.function("glFramebufferTexture2D", UINT, UINT, UINT, UINT, INT)
        attach(0x8D40, COLOUR, face, texture, level)
    else:
        context.function("glFramebufferTexture", UINT, UINT, UINT, INT)(0x8D40, COLOUR, texture, level)
    return texture, framebuffer


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "multisampled array"])
def test_an_image_is_found_measured_and_drawn_to(gl_context, kind):
    *_, layer, level, face = KINDS[kind]
    with gl_context.drawing() as ctx:
        texture, theirs = made(gl_context, kind)
        gl_context.take_error()
        ask = FramebufferQueries(gl_context)
        ask.bind(theirs)
        image = Image(texture, False, level, layer, face)
        assert ask.image(COLOUR) == image
        assert ask.image(DEPTH) is None
        assert ask.size(image) == SIZE
        ours = fresh_framebuffer(gl_context)
        ask.bind(ours.glo)
        assert ask.attach(COLOUR, image)
        assert ask.format(COLOUR).blue_bits == 8
        ours.viewport = (0, 0, *SIZE)
        ours.clear(1.0, 0.0, 1.0, 1.0)
        plain = gl_context.target(SIZE, 4, "f1")
        shown = gl_context.framebuffer([plain])
        ask.bind(theirs, 0x8CA8)
        ask.bind(shown.glo, 0x8CA9)
        copy = gl_context.function("glBlitFramebuffer", *[INT] * 8, UINT, UINT)
        copy(0, 0, *SIZE, 0, 0, *SIZE, 0x4000, 0x2600)
        assert (gl.read(plain, np.uint8) == [255, 0, 255, 255]).all()
        assert ctx.error == "GL_NO_ERROR"


def layer_reported(context):
    number = INT()
    read = context.function("glGetFramebufferAttachmentParameteriv", UINT, UINT, UINT, ctypes.c_void_p)
    read(0x8D40, COLOUR, 0x8CD4, ctypes.addressof(number))  # GL_FRAMEBUFFER_ATTACHMENT_TEXTURE_LAYER
    return number.value


def test_a_layer_that_drivers_do_not_name_is_refused(gl_context):
    """Mesa reports layer 0 for every layer of a multisampled array."""
    with gl_context.drawing():
        texture, theirs = made(gl_context, "multisampled array")
        gl_context.take_error()
        ask = FramebufferQueries(gl_context)
        ask.bind(theirs)
        if not layer_reported(gl_context):
            with pytest.raises(
                BadInputError, match=r"a layer of a multisampled array .*TextureLayer\(texture, layer=0\)"
            ):
                ask.image(COLOUR)
        image = Image(texture, False, 0, 1, 0)
        assert ask.size(image) == SIZE
        ours = fresh_framebuffer(gl_context)
        ask.bind(ours.glo)
        assert ask.attach(COLOUR, image)


def test_a_renderbuffer_is_found_and_measured(gl_context):
    with gl_context.drawing() as ctx:
        made = ctx.framebuffer([ctx.renderbuffer((5, 7))], ctx.depth_renderbuffer((5, 7)))
        ask = FramebufferQueries(gl_context)
        ask.bind(made.glo)
        for point in (COLOUR, DEPTH):
            image = ask.image(point)
            assert image.is_renderbuffer
            assert ask.size(image) == (5, 7)
        ours = fresh_framebuffer(gl_context)
        ask.bind(made.glo)
        depth = ask.image(DEPTH)
        ask.bind(ours.glo)
        assert ask.attach(DEPTH, depth)
        assert ask.image(COLOUR) is None
        assert ask.format(DEPTH).depth_bits == 24


def test_what_is_no_texture_has_no_size(gl_context):
    with gl_context.drawing():
        assert FramebufferQueries(gl_context).size(Image(1999)) == (0, 0)

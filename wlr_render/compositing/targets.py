"""Framebuffers of the caller, checked and shared out among the eyes."""

import contextlib
import ctypes
from collections.abc import Iterator, Mapping, Sequence
from numbers import Integral
from typing import Any

from wlr_render.errors import BadInputError
from wlr_render.rendering import gl
from wlr_render.rendering.gl_warp import WarpTarget

_DRAW_BUFFERS = range(0x8825, 0x8825 + 8)  # GL_DRAW_BUFFER0 and on
_DRAW_FRAMEBUFFER, _COMPLETE = 0x8CA9, 0x8CD5
_COLOUR, _KIND = 0x8CE0, 0x8CD0  # GL_COLOR_ATTACHMENT0, GL_FRAMEBUFFER_ATTACHMENT_OBJECT_TYPE
_NUMBERS, _BLUE_BITS = 0x8211, 0x8214  # GL_FRAMEBUFFER_ATTACHMENT_COMPONENT_TYPE, ..._BLUE_SIZE
_WHOLE_NUMBERS = {0x1404, 0x1405}  # GL_INT, GL_UNSIGNED_INT
_ON, _OFF = (True,) * 4, (False,) * 4


def targets_of(
    context: gl.GlContext, into: Any, eyes: Sequence[str], size_px: tuple[int, int]
) -> dict[str, WarpTarget]:
    """Where each eye's picture goes, upright as OpenGL shows it; see `Compositor.compose`. In a drawing block.

    Raises:
        BadInputError: an eye has none, one is no framebuffer of this context, or of another size or kind.
    """
    if isinstance(into, Mapping):
        missing = set(eyes) - set(into)
        if missing:
            raise BadInputError(f"there is no framebuffer for the {sorted(missing)[0]} eye; give one for every eye.")
        return {
            eye: WarpTarget(_of_size(context, into[eye], size_px), (0, 0), size_px, top_row_first=False) for eye in eyes
        }
    width, height = size_px
    framebuffer = _of_size(context, into, (width * len(eyes), height))
    return {
        eye: WarpTarget(framebuffer, (number * width, 0), size_px, top_row_first=False)
        for number, eye in enumerate(eyes)
    }


def _of_size(context: gl.GlContext, into: Any, size_px: tuple[int, int]) -> gl.Framebuffer:
    if isinstance(into, gl.Framebuffer) and not context.has(into):
        raise BadInputError("the framebuffer belongs to another OpenGL context than the compositor works in.")
    number = into.glo if isinstance(into, gl.Framebuffer) else into
    if not isinstance(number, Integral):
        raise BadInputError(f"a {type(into).__name__} is no framebuffer; give ModernGL's, or an OpenGL number.")
    _check_kind(context, int(number))
    framebuffer = _detected(context, int(number))
    # The size of a window's picture is its toolkit's affair: OpenGL cannot be asked for it.
    size = into.size if isinstance(into, gl.Framebuffer) else framebuffer.size if number else size_px
    if tuple(size) != size_px:
        found, needed = (" x ".join(map(str, pixels)) for pixels in (size, size_px))
        raise BadInputError(
            f"the framebuffer has {found} pixels, and {needed} are needed; give one of that size, or make the "
            "compositor for yours."
        )
    return framebuffer


def _check_kind(context: gl.GlContext, number: int) -> None:
    uint = ctypes.c_uint
    if number and not context.function("glIsFramebuffer", uint, result=ctypes.c_ubyte)(number):
        raise BadInputError(f"number {number} is no framebuffer object of the OpenGL context.")
    context.function("glBindFramebuffer", uint, uint)(_DRAW_FRAMEBUFFER, number)
    if context.function("glCheckFramebufferStatus", uint, result=uint)(_DRAW_FRAMEBUFFER) != _COMPLETE:
        what = "the framebuffer is incomplete" if number else "the OpenGL context has no window"
        raise BadInputError(f"{what}; give a framebuffer object with an RGBA8 texture.")
    if number and not _takes_colours(context):
        raise BadInputError(
            "the framebuffer's first attachment does not hold red, green and blue as fractions; give it an RGBA8 "
            "texture."
        )


def _takes_colours(context: gl.GlContext) -> bool:
    """Of the bound framebuffer object."""
    read = context.function("glGetFramebufferAttachmentParameteriv", *[ctypes.c_uint] * 3, ctypes.c_void_p)

    def parameter(name: int) -> int:
        value = ctypes.c_int()
        read(_DRAW_FRAMEBUFFER, _COLOUR, name, ctypes.byref(value))
        return value.value

    return parameter(_KIND) != 0 and parameter(_BLUE_BITS) > 0 and parameter(_NUMBERS) not in _WHOLE_NUMBERS


def _detected(context: gl.GlContext, number: int) -> gl.Framebuffer:
    """A framebuffer of whomever as one of ours, of which only the first colour is drawn to."""
    with context.drawing() as ctx:
        framebuffer: Any = ctx.detect_framebuffer(number) if number else ctx.screen
    if framebuffer is None:
        raise BadInputError("the compositor's own OpenGL context has no window; give a framebuffer object of it.")
    masks = framebuffer.color_mask
    if number and isinstance(masks[0], tuple):
        # ModernGL draws to all attachments, and what a shader does not write is undefined.
        framebuffer.color_mask = (_ON, *[_OFF] * (len(masks) - 1))
    checked: gl.Framebuffer = framebuffer
    return checked


@contextlib.contextmanager
def draw_buffers_kept(context: gl.GlContext, framebuffer: gl.Framebuffer) -> Iterator[None]:
    """Give a caller's framebuffer object its draw buffers back: ModernGL switches on all that it has."""
    number = int(framebuffer.glo)
    if not number:
        yield
        return
    bind = context.function("glBindFramebuffer", ctypes.c_uint, ctypes.c_uint)
    get = context.function("glGetIntegerv", ctypes.c_uint, ctypes.c_void_p)
    with context.drawing():
        bind(_DRAW_FRAMEBUFFER, number)
        buffers = (ctypes.c_uint * len(_DRAW_BUFFERS))()
        for index, name in enumerate(_DRAW_BUFFERS):
            get(name, ctypes.byref(buffers, index * ctypes.sizeof(ctypes.c_uint)))
        try:
            yield
        finally:
            bind(_DRAW_FRAMEBUFFER, number)
            context.function("glDrawBuffers", ctypes.c_int, ctypes.c_void_p)(len(buffers), buffers)

"""Framebuffers of the caller, checked and shared out among the eyes."""

import contextlib
import ctypes
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from wlr_render.errors import BadInputError
from wlr_render.rendering import gl
from wlr_render.rendering.gl_warp import WarpTarget

_DRAW_BUFFERS = range(0x8825, 0x8825 + 8)  # GL_DRAW_BUFFER0 and on
_DRAW_FRAMEBUFFER = 0x8CA9


def targets_of(
    context: gl.GlContext, into: Any, eyes: Sequence[str], size_px: tuple[int, int]
) -> dict[str, WarpTarget]:
    """Where each eye's picture goes, upright as OpenGL shows it; see `Compositor.compose`.

    Raises:
        BadInputError: an eye has none, one is no framebuffer of this context, or of another size.
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
    framebuffer = _framebuffer(context, into)
    if tuple(framebuffer.size) != size_px:
        found, needed = (" x ".join(map(str, size)) for size in (framebuffer.size, size_px))
        raise BadInputError(
            f"the framebuffer has {found} pixels, and {needed} are needed; give one of that size, or make the "
            "compositor for yours."
        )
    return framebuffer


def _framebuffer(context: gl.GlContext, into: Any) -> gl.Framebuffer:
    """A framebuffer of the caller's ModernGL context, or of a number, as one of ours."""
    if isinstance(into, gl.Framebuffer):
        if not context.has(into):
            raise BadInputError("the framebuffer belongs to another OpenGL context than the compositor works in.")
        into = into.glo
    if not isinstance(into, int):
        raise BadInputError(f"a {type(into).__name__} is no framebuffer; give ModernGL's, or an OpenGL number.")
    with context.drawing() as ctx:
        return ctx.detect_framebuffer(into)


@contextlib.contextmanager
def draw_buffers_kept(context: gl.GlContext, framebuffer: gl.Framebuffer) -> Iterator[None]:
    """Give a caller's framebuffer object its draw buffers back: ModernGL switches on all that it has."""
    bind = context.function("glBindFramebuffer", ctypes.c_uint, ctypes.c_uint)
    get = context.function("glGetIntegerv", ctypes.c_uint, ctypes.c_void_p)
    number = int(framebuffer.glo)
    with context.drawing():
        bind(_DRAW_FRAMEBUFFER, number)
        buffers = (ctypes.c_uint * (len(_DRAW_BUFFERS) if number else 1))()
        for index, name in zip(range(len(buffers)), _DRAW_BUFFERS, strict=False):
            get(name, ctypes.byref(buffers, index * ctypes.sizeof(ctypes.c_uint)))
        try:
            yield
        finally:
            bind(_DRAW_FRAMEBUFFER, number)
            context.function("glDrawBuffers", ctypes.c_int, ctypes.c_void_p)(len(buffers), buffers)

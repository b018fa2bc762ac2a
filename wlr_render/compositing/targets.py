"""Framebuffers of the caller as targets: checks, and each eye's viewport."""

import contextlib
import ctypes
from collections.abc import Iterator, Mapping, Sequence
from numbers import Integral
from typing import Any

from wlr_render.errors import BadInputError
from wlr_render.rendering import gl
from wlr_render.rendering.framebuffers import COLOUR, DRAW, FramebufferQueries
from wlr_render.rendering.gl_warp import WarpTarget

_DRAW_BUFFERS = range(0x8825, 0x8825 + 8)  # GL_DRAW_BUFFER0 and on
_ON, _OFF = (True,) * 4, (False,) * 4


class CallersFramebuffers:
    """The caller's framebuffers as targets; use it in drawing blocks."""

    def __init__(self, context: gl.GlContext) -> None:
        self._context, self._ask = context, FramebufferQueries(context)
        # ModernGL never frees what it makes for a number, so that one is made for each.
        self._by_number: dict[int, gl.Framebuffer] = {}

    def targets(self, into: Any, eyes: Sequence[str], size_px: tuple[int, int]) -> dict[str, WarpTarget]:
        """Where each eye's picture goes, upright as OpenGL shows it; see `Compositor.compose`.

        Raises:
            BadInputError: an eye has none, one is no framebuffer of this context, or of another size or kind.
        """
        if isinstance(into, Mapping):
            missing = set(eyes) - set(into)
            if missing:
                raise BadInputError(
                    f"there is no framebuffer for the {sorted(missing)[0]} eye; give one for every eye."
                )
            found = {eye: self._of_size(into[eye], size_px) for eye in eyes}
            if len({framebuffer.glo for framebuffer in found.values()}) < len(found):
                raise BadInputError(
                    "both eyes are given the same framebuffer; give each its own, or one of twice the width."
                )
            return {eye: WarpTarget(framebuffer, (0, 0), size_px, False) for eye, framebuffer in found.items()}
        width, height = size_px
        framebuffer = self._of_size(into, (width * len(eyes), height))
        return {
            eye: WarpTarget(framebuffer, (index * width, 0), size_px, top_row_first=False)
            for index, eye in enumerate(eyes)
        }

    @contextlib.contextmanager
    def draw_buffers_kept(self, framebuffer: gl.Framebuffer) -> Iterator[None]:
        """Give a framebuffer object its draw buffers back: ModernGL switches on all that it has."""
        number, ask = int(framebuffer.glo), self._ask
        if not number:
            yield
            return
        ask.bind(number, DRAW)
        buffers = (ctypes.c_uint * len(_DRAW_BUFFERS))(*map(ask.integer, _DRAW_BUFFERS))
        try:
            yield
        finally:
            ask.bind(number, DRAW)
            ask.gl("glDrawBuffers", ctypes.c_int, ctypes.c_void_p)(len(buffers), buffers)

    def _of_size(self, into: Any, size_px: tuple[int, int]) -> gl.Framebuffer:
        if isinstance(into, gl.Framebuffer) and not self._context.has(into):
            raise BadInputError("the framebuffer belongs to another OpenGL context than the compositor works in.")
        number = into.glo if isinstance(into, gl.Framebuffer) else into
        if not isinstance(number, Integral):
            raise BadInputError(f"a {type(into).__name__} is not a framebuffer; give ModernGL's, or an OpenGL number.")
        framebuffer = self._checked(int(number))
        # The size of a window's picture is its toolkit's affair: OpenGL cannot be asked for it.
        size = self._ask.measure(COLOUR)[:2] if number else into.size if into is not number else size_px
        if tuple(size) != size_px:
            found, needed = (" x ".join(map(str, pixels)) for pixels in (size, size_px))
            raise BadInputError(
                f"the framebuffer has {found} pixels, and {needed} are needed; give one of that size, or make the "
                "compositor for yours."
            )
        return framebuffer

    def _checked(self, number: int) -> gl.Framebuffer:
        """A framebuffer that takes colours, bound."""
        ask = self._ask
        if number and not ask.exists(number):
            raise BadInputError(f"number {number} is not a framebuffer object of the OpenGL context.")
        ask.bind(number)
        if not ask.is_complete():
            what = "the framebuffer is incomplete" if number else "the OpenGL context has no window"
            raise BadInputError(f"{what}; give a framebuffer object with an RGBA8 texture.")
        if number and not (ask.has(COLOUR) and ask.has_blue(COLOUR) and not ask.has_whole_numbers(COLOUR)):
            raise BadInputError(
                "the framebuffer's first attachment does not hold red, green and blue as fractions; give it an RGBA8 "
                "texture."
            )
        if number not in self._by_number:
            self._by_number[number] = self._wrapped(number)
        ask.bind(number)
        return self._by_number[number]

    def _wrapped(self, number: int) -> gl.Framebuffer:
        with self._context.drawing() as ctx:
            found: Any = ctx.detect_framebuffer(number) if number else ctx.screen
        if found is None:
            raise BadInputError("the compositor's own OpenGL context has no window; give a framebuffer object of it.")
        if number and isinstance(found.color_mask[0], tuple):
            # Only the first colour is drawn to: what a shader leaves out is undefined.
            found.color_mask = (_ON, *[_OFF] * (len(found.color_mask) - 1))
        framebuffer: gl.Framebuffer = found
        return framebuffer

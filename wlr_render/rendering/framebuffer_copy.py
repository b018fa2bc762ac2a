"""Copies of colour and depth that other software has drawn into a framebuffer object, on the GPU."""

import ctypes
from dataclasses import dataclass

from wlr_render.errors import BadInputError
from wlr_render.rendering import gl
from wlr_render.rendering.framebuffer_queries import COLOUR, DEPTH, DRAW, READ, FramebufferQueries
from wlr_render.rendering.gl_state import UNITS

_UINT, _INT = ctypes.c_uint, ctypes.c_int
_TEXTURE_2D, _READ_BUFFER = 0x0DE1, 0x0C02
_DEPTH_COMPONENT, _UNSIGNED_INT = 0x1902, 0x1405
_COLOUR_AND_DEPTH, _NEAREST = 0x4100, 0x2600


@dataclass(frozen=True, eq=False)
class _Copy:
    """Textures for one size and format of depth."""

    size: tuple[int, int]
    depth_format: int
    framebuffer: gl.Framebuffer
    colour: gl.Texture
    depth: gl.Texture


class FramebufferCopy:
    """Copies framebuffer objects of one context, made by whomever; its textures are kept while nothing changes."""

    def __init__(self, context: gl.GlContext) -> None:
        self._context = context
        self._ask = FramebufferQueries(context)
        self._copy: _Copy | None = None

    def copy(self, number: int, size: tuple[int, int]) -> tuple[gl.Texture, gl.Texture]:
        """Colour (RGBA8) and the depth buffer's values, rows as they lie; call it within a drawing block.

        Several samples become one: colours are averaged, of the depths OpenGL takes one.

        Args:
            number: OpenGL's name of the framebuffer object.
            size: (width, height) that it must have.

        Raises:
            BadInputError: there is no such framebuffer object, it has another size or lacks colour or depth, or they
                are of a kind that cannot be copied.
        """
        ask = self._ask
        if not ask.exists(number):
            raise BadInputError(
                f"Number {number} is no framebuffer object of this context: draw into one, the window's cannot be read."
            )
        ask.bind(number)
        for point, name in ((COLOUR, "colour"), (DEPTH, "depth")):
            if not ask.has(point):
                raise BadInputError(f"The framebuffer {number} has no {name} attachment: give it one and draw into it.")
        width, height, _ = ask.measure(COLOUR)
        _, _, depth_format = ask.measure(DEPTH)
        if (width, height) != size:
            raise BadInputError(
                f"The framebuffer {number} has {width}x{height} pixels, the camera {size[0]}x{size[1]}: draw with that "
                "camera."
            )
        if ask.has_whole_numbers(COLOUR):
            raise BadInputError(f"The framebuffer {number} holds whole numbers for colours: use RGBA8.")
        samples, copy = ask.samples(), self._copy_for(size, depth_format)
        self._blit(number, copy)
        if ask.gl("glGetError", result=_UINT)():
            raise BadInputError(
                f"OpenGL cannot copy the framebuffer {number} of {samples} samples: resolve it into one of single "
                "samples with RGBA8 colour first."
            )
        return copy.colour, copy.depth

    def _blit(self, number: int, copy: _Copy) -> None:
        ask, read_from = self._ask, self._ask.gl("glReadBuffer", _UINT)
        ask.bind(number, READ)
        ask.bind(copy.framebuffer.glo, DRAW)
        before = ask.integer(_READ_BUFFER)
        read_from(COLOUR)
        corners = 0, 0, *copy.size
        ask.gl("glBlitFramebuffer", *[_INT] * 8, _UINT, _UINT)(*corners, *corners, _COLOUR_AND_DEPTH, _NEAREST)
        read_from(before)

    def _copy_for(self, size: tuple[int, int], depth_format: int) -> _Copy:
        if self._copy is None or (self._copy.size, self._copy.depth_format) != (size, depth_format):
            colour, depth = self._context.target(size, 4, "f1"), self._context.target(size, 1, "f4")
            # OpenGL copies depth only into its like: the texture is given the format of the one to be copied.
            depth.use(UNITS - 1)
            image = self._ask.gl("glTexImage2D", _UINT, *[_INT] * 5, _UINT, _UINT, ctypes.c_void_p)
            image(_TEXTURE_2D, 0, depth_format, *size, 0, _DEPTH_COMPONENT, _UNSIGNED_INT, None)
            framebuffer = self._context.framebuffer([colour])
            self._ask.bind(framebuffer.glo, DRAW)
            attach = self._ask.gl("glFramebufferTexture2D", _UINT, _UINT, _UINT, _UINT, _INT)
            attach(DRAW, DEPTH, _TEXTURE_2D, depth.glo, 0)
            self._copy = _Copy(size, depth_format, framebuffer, colour, depth)
        return self._copy

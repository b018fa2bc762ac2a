"""Copies of colour and depth that other software has drawn into a framebuffer object, on the GPU."""

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from wlr_render.errors import BadInputError
from wlr_render.rendering import gl
from wlr_render.rendering.gl_state import UNITS

_UINT, _INT = ctypes.c_uint, ctypes.c_int
_READ, _DRAW, _BOTH = 0x8CA8, 0x8CA9, 0x8D40  # GL_READ_FRAMEBUFFER, GL_DRAW_FRAMEBUFFER, GL_FRAMEBUFFER
_COLOUR, _DEPTH = 0x8CE0, 0x8D00  # GL_COLOR_ATTACHMENT0, GL_DEPTH_ATTACHMENT
_KIND, _NAME, _NUMBERS = 0x8CD0, 0x8CD1, 0x8211  # GL_FRAMEBUFFER_ATTACHMENT_OBJECT_TYPE, _OBJECT_NAME, _COMPONENT_TYPE
_TEXTURE, _RENDERBUFFER = 0x1702, 0x8D41
_WHOLE_NUMBERS = {0x1404, 0x1405}  # GL_INT, GL_UNSIGNED_INT
_TEXTURE_2D, _MULTISAMPLED = 0x0DE1, 0x9100
_BINDING = {_TEXTURE_2D: 0x8069, _MULTISAMPLED: 0x9104}
_OF_TEXTURE, _OF_RENDERBUFFER = (0x1000, 0x1001, 0x1003), (0x8D42, 0x8D43, 0x8D44)  # width, height, internal format
_SAMPLES, _READ_BUFFER = 0x80A9, 0x0C02
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
        self._functions: dict[str, Callable[..., Any]] = {}
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
        if number == 0 or not self._gl("glIsFramebuffer", _UINT, result=ctypes.c_ubyte)(number):
            raise BadInputError(
                f"Number {number} is no framebuffer object of this context: draw into one, the window's cannot be read."
            )
        self._gl("glBindFramebuffer", _UINT, _UINT)(_BOTH, number)
        samples = self._integer(_SAMPLES)
        for point, name in ((_COLOUR, "colour"), (_DEPTH, "depth")):
            if self._of_attachment(point, _KIND) not in (_TEXTURE, _RENDERBUFFER):
                raise BadInputError(f"The framebuffer {number} has no {name} attachment: give it one and draw into it.")
        width, height, _ = self._measure(_COLOUR, samples)
        _, _, depth_format = self._measure(_DEPTH, samples)
        if (width, height) != size:
            raise BadInputError(
                f"The framebuffer {number} has {width}x{height} pixels, the camera {size[0]}x{size[1]}: draw with that "
                "camera."
            )
        if self._of_attachment(_COLOUR, _NUMBERS) in _WHOLE_NUMBERS:
            raise BadInputError(f"The framebuffer {number} holds whole numbers for colours: use RGBA8.")
        copy = self._copy_for(size, depth_format)
        self._blit(number, copy)
        if self._gl("glGetError", result=_UINT)():
            raise BadInputError(
                f"OpenGL cannot copy the framebuffer {number} of {samples} samples: resolve it into one of single "
                "samples with RGBA8 colour first."
            )
        return copy.colour, copy.depth

    def _blit(self, number: int, copy: _Copy) -> None:
        bind, read_from = self._gl("glBindFramebuffer", _UINT, _UINT), self._gl("glReadBuffer", _UINT)
        bind(_READ, number)
        bind(_DRAW, copy.framebuffer.glo)
        before = self._integer(_READ_BUFFER)
        read_from(_COLOUR)
        corners = 0, 0, *copy.size
        self._gl("glBlitFramebuffer", *[_INT] * 8, _UINT, _UINT)(*corners, *corners, _COLOUR_AND_DEPTH, _NEAREST)
        read_from(before)

    def _measure(self, point: int, samples: int) -> tuple[int, int, int]:
        """Width, height and internal format of an attachment of the bound framebuffer."""
        name = self._of_attachment(point, _NAME)
        if self._of_attachment(point, _KIND) == _RENDERBUFFER:
            self._gl("glBindRenderbuffer", _UINT, _UINT)(_RENDERBUFFER, name)
            read = self._gl("glGetRenderbufferParameteriv", _UINT, _UINT, ctypes.c_void_p)
            return self._three(lambda enum, address: read(_RENDERBUFFER, enum, address), _OF_RENDERBUFFER)
        kind = _MULTISAMPLED if samples else _TEXTURE_2D
        bind, before = self._gl("glBindTexture", _UINT, _UINT), self._integer(_BINDING[kind])
        read = self._gl("glGetTexLevelParameteriv", _UINT, _INT, _UINT, ctypes.c_void_p)
        bind(kind, name)
        found = self._three(lambda enum, address: read(kind, 0, enum, address), _OF_TEXTURE)
        bind(kind, before)
        return found

    def _copy_for(self, size: tuple[int, int], depth_format: int) -> _Copy:
        if self._copy is None or (self._copy.size, self._copy.depth_format) != (size, depth_format):
            colour, depth = self._context.target(size, 4, "f1"), self._context.target(size, 1, "f4")
            # OpenGL copies depth only into its like: the texture is given the format of the one to be copied.
            depth.use(UNITS - 1)
            image = self._gl("glTexImage2D", _UINT, *[_INT] * 5, _UINT, _UINT, ctypes.c_void_p)
            image(_TEXTURE_2D, 0, depth_format, *size, 0, _DEPTH_COMPONENT, _UNSIGNED_INT, None)
            framebuffer = self._context.framebuffer([colour])
            self._gl("glBindFramebuffer", _UINT, _UINT)(_DRAW, framebuffer.glo)
            attach = self._gl("glFramebufferTexture2D", _UINT, _UINT, _UINT, _UINT, _INT)
            attach(_DRAW, _DEPTH, _TEXTURE_2D, depth.glo, 0)
            self._copy = _Copy(size, depth_format, framebuffer, colour, depth)
        return self._copy

    def _gl(self, name: str, *argument_types: Any, result: Any = None) -> Callable[..., Any]:
        if name not in self._functions:
            self._functions[name] = self._context.function(name, *argument_types, result=result)
        return self._functions[name]

    def _integer(self, enum: int) -> int:
        numbers = (_INT * 2)()
        self._gl("glGetIntegerv", _UINT, ctypes.c_void_p)(enum, ctypes.addressof(numbers))
        return numbers[0]

    def _of_attachment(self, point: int, enum: int) -> int:
        number, read = _INT(), "glGetFramebufferAttachmentParameteriv"
        self._gl(read, _UINT, _UINT, _UINT, ctypes.c_void_p)(_BOTH, point, enum, ctypes.addressof(number))
        return number.value

    @staticmethod
    def _three(read: Callable[[int, int], None], enums: tuple[int, int, int]) -> tuple[int, int, int]:
        numbers = (_INT * 3)()
        for k, enum in enumerate(enums):
            read(enum, ctypes.addressof(numbers) + k * ctypes.sizeof(_INT))
        return numbers[0], numbers[1], numbers[2]

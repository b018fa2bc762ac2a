"""Queries and copies of framebuffer objects that other software has made and drawn into."""

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from wlr_render.errors import BadInputError
from wlr_render.rendering import gl
from wlr_render.rendering.gl_state import UNITS

READ, DRAW, BOTH = 0x8CA8, 0x8CA9, 0x8D40  # GL_READ_FRAMEBUFFER, GL_DRAW_FRAMEBUFFER, GL_FRAMEBUFFER
COLOUR, DEPTH = 0x8CE0, 0x8D00  # GL_COLOR_ATTACHMENT0, GL_DEPTH_ATTACHMENT
_UINT, _INT = ctypes.c_uint, ctypes.c_int
_KIND, _NAME, _NUMBERS = 0x8CD0, 0x8CD1, 0x8211  # GL_FRAMEBUFFER_ATTACHMENT_OBJECT_TYPE, _OBJECT_NAME, _COMPONENT_TYPE
_BLUE_BITS = 0x8214  # GL_FRAMEBUFFER_ATTACHMENT_BLUE_SIZE
_TEXTURE, _RENDERBUFFER = 0x1702, 0x8D41
_WHOLE_NUMBERS = {0x1404, 0x1405}  # GL_INT, GL_UNSIGNED_INT
_TEXTURE_2D, _MULTISAMPLED = 0x0DE1, 0x9100
_BINDING = {_TEXTURE_2D: 0x8069, _MULTISAMPLED: 0x9104}
_OF_TEXTURE, _OF_RENDERBUFFER = (0x1000, 0x1001, 0x1003), (0x8D42, 0x8D43, 0x8D44)  # width, height, internal format
_SAMPLES = 0x80A9
_COMPLETE = 0x8CD5
_READ_BUFFER = 0x0C02
_DEPTH_COMPONENT, _UNSIGNED_INT = 0x1902, 0x1405
_COLOUR_AND_DEPTH, _NEAREST = 0x4100, 0x2600


class FramebufferQueries:
    """Queries of framebuffer objects; call them within drawing blocks."""

    def __init__(self, context: gl.GlContext) -> None:
        self._context = context
        self._functions: dict[str, Callable[..., Any]] = {}

    def gl(self, name: str, *argument_types: Any, result: Any = None) -> Callable[..., Any]:
        """As `GlContext.function`."""
        if name not in self._functions:
            self._functions[name] = self._context.function(name, *argument_types, result=result)
        return self._functions[name]

    def exists(self, number: int) -> bool:
        """Whether a number names a framebuffer object; 0, the window's, does not."""
        return number != 0 and bool(self.gl("glIsFramebuffer", _UINT, result=ctypes.c_ubyte)(number))

    def bind(self, number: int, target: int = BOTH) -> None:
        """Bind a framebuffer object, or with 0 the window, as the object of the other queries."""
        self.gl("glBindFramebuffer", _UINT, _UINT)(target, number)

    def is_complete(self) -> bool:
        """Whether the framebuffer is complete."""
        return bool(self.gl("glCheckFramebufferStatus", _UINT, result=_UINT)(BOTH) == _COMPLETE)

    def samples(self) -> int:
        """Samples per pixel, 0 for a plain framebuffer."""
        return self.integer(_SAMPLES)

    def has(self, point: int) -> bool:
        """Whether a texture or a renderbuffer is attached there."""
        return self._of_attachment(point, _KIND) in (_TEXTURE, _RENDERBUFFER)

    def has_whole_numbers(self, point: int) -> bool:
        """Whether the attachment has an integer format."""
        return self._of_attachment(point, _NUMBERS) in _WHOLE_NUMBERS

    def has_blue(self, point: int) -> bool:
        """Whether the attachment has a blue channel, and therefore red and green."""
        return self._of_attachment(point, _BLUE_BITS) > 0

    def measure(self, point: int) -> tuple[int, int, int]:
        """Width, height and internal format of the attachment."""
        name = self._of_attachment(point, _NAME)
        if self._of_attachment(point, _KIND) == _RENDERBUFFER:
            self.gl("glBindRenderbuffer", _UINT, _UINT)(_RENDERBUFFER, name)
            read = self.gl("glGetRenderbufferParameteriv", _UINT, _UINT, ctypes.c_void_p)
            return _three(lambda enum, address: read(_RENDERBUFFER, enum, address), _OF_RENDERBUFFER)
        kind = _MULTISAMPLED if self.samples() else _TEXTURE_2D
        bind, before = self.gl("glBindTexture", _UINT, _UINT), self.integer(_BINDING[kind])
        read = self.gl("glGetTexLevelParameteriv", _UINT, _INT, _UINT, ctypes.c_void_p)
        bind(kind, name)
        found = _three(lambda enum, address: read(kind, 0, enum, address), _OF_TEXTURE)
        bind(kind, before)
        return found

    def integer(self, enum: int) -> int:
        """As glGetIntegerv."""
        numbers = (_INT * 2)()
        self.gl("glGetIntegerv", _UINT, ctypes.c_void_p)(enum, ctypes.addressof(numbers))
        return numbers[0]

    def _of_attachment(self, point: int, enum: int) -> int:
        number, read = _INT(), "glGetFramebufferAttachmentParameteriv"
        self.gl(read, _UINT, _UINT, _UINT, ctypes.c_void_p)(BOTH, point, enum, ctypes.addressof(number))
        return number.value


def _three(read: Callable[[int, int], None], enums: tuple[int, int, int]) -> tuple[int, int, int]:
    numbers = (_INT * 3)()
    for k, enum in enumerate(enums):
        read(enum, ctypes.addressof(numbers) + k * ctypes.sizeof(_INT))
    return numbers[0], numbers[1], numbers[2]


@dataclass(frozen=True, eq=False)
class _Copy:
    """Textures for one size and format of depth."""

    size: tuple[int, int]
    depth_format: int
    framebuffer: gl.Framebuffer
    colour: gl.Texture
    depth: gl.Texture


class FramebufferCopy:
    """Copies framebuffer objects of one context; textures are reused while size and format stay the same."""

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
                f"Number {number} is not a framebuffer object of this context: draw into one; a window is not read."
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

"""Images of other software's framebuffers and textures: queries, and our own framebuffers with the same images.

An image is one layer and level of a texture, or a renderbuffer. We attach it to our own framebuffer, so that the
read buffer, draw buffers and attachments of the caller's framebuffers are not changed.
"""

import contextlib
import ctypes
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from numbers import Integral
from typing import Any, TypeVar

from wlr_render.errors import BadInputError
from wlr_render.gl import gl

READ, DRAW, BOTH = 0x8CA8, 0x8CA9, 0x8D40  # GL_READ_FRAMEBUFFER, GL_DRAW_FRAMEBUFFER, GL_FRAMEBUFFER
COLOUR, DEPTH = 0x8CE0, 0x8D00  # GL_COLOR_ATTACHMENT0, GL_DEPTH_ATTACHMENT
FLOATS, WHOLE_NUMBERS = 0x1406, (0x1404, 0x1405)  # GL_FLOAT; GL_INT, GL_UNSIGNED_INT
_UINT, _INT = ctypes.c_uint, ctypes.c_int
# GL_FRAMEBUFFER_ATTACHMENT_OBJECT_TYPE, _OBJECT_NAME, _TEXTURE_LEVEL, _CUBE_MAP_FACE, _TEXTURE_LAYER, _LAYERED
_KIND, _NAME, _LEVEL, _FACE, _LAYER, _LAYERED = 0x8CD0, 0x8CD1, 0x8CD2, 0x8CD3, 0x8CD4, 0x8DA7
_NUMBERS, _RED, _BLUE, _DEPTH_BITS, _STENCIL_BITS = 0x8211, 0x8212, 0x8214, 0x8216, 0x8217
_CODING, _SRGB = 0x8210, 0x8C40  # GL_FRAMEBUFFER_ATTACHMENT_COLOR_ENCODING
_TEXTURE, _RENDERBUFFER, _SAMPLES = 0x1702, 0x8D41, 0x80A9
_CUBE_MAP, _MULTISAMPLED_ARRAY = 0x8513, 0x9102
# 2D, 2D array, multisampled, multisampled array, rectangle, 3D; and the queries of the bindings of all targets.
TEXTURE_2D, TEXTURE_2D_ARRAY = 0x0DE1, 0x8C1A
_TARGETS = TEXTURE_2D, TEXTURE_2D_ARRAY, 0x9100, _MULTISAMPLED_ARRAY, 0x84F5, 0x806F
_BASE_LEVEL, _SWIZZLE, _PLAIN = 0x813C, 0x8E46, [0, 0x1903, 0x1904, 0x1905, 0x1906]
# GL_TEXTURE_RED_TYPE, _DEPTH_TYPE, _RED_SIZE, _BLUE_SIZE, _DEPTH_SIZE, _STENCIL_SIZE, _INTERNAL_FORMAT
_SAMPLED, _SRGB_FORMATS = (0x8C10, 0x8C16, 0x805C, 0x805E, 0x884A, 0x88F1, 0x1003), (0x8C41, 0x8C43)
_BINDINGS = dict(zip((*_TARGETS, _CUBE_MAP), (0x8069, 0x8C1D, 0x9104, 0x9105, 0x84F6, 0x806A, 0x8514), strict=True))
_LEVELS = 16  # mip levels of a side of 32768 pixels, the longest of any driver
_LAYERS = 0x8071  # GL_TEXTURE_DEPTH
_WIDTH, _HEIGHT, _RENDERBUFFER_WIDTH, _RENDERBUFFER_HEIGHT = 0x1000, 0x1001, 0x8D42, 0x8D43
_COMPLETE, _NEAREST = 0x8CD5, 0x2600
BLIT_COLOUR, BLIT_DEPTH = 0x4000, 0x0100  # GL_COLOR_BUFFER_BIT, GL_DEPTH_BUFFER_BIT

_Made = TypeVar("_Made")


@dataclass(frozen=True)
class TextureLayer:
    """One layer and mip level of a texture, as a picture to submit or a target to compose into.

    Attributes:
        texture: ModernGL's `Texture` or `TextureArray`, or the OpenGL name of a texture.
        layer: layer of an array texture, 0 by default; 0 for other textures.
        level: mip level; the picture has that level's size.
        rect_px: (x, y, width, height) of the picture in the level, like `imageRect` of XrSwapchainSubImage: from the
            first column and row in memory, OpenGL's lower left corner. The whole level if None.

    OpenGL is queried once for an object of this class with an OpenGL name: make a new object for a new texture.

    Raises:
        BadInputError: invalid `texture`, a layer or level that is not a whole number from 0, or a `rect_px` that is not
            a rectangle.
    """

    texture: Any
    layer: int = 0
    level: int = 0
    rect_px: Sequence[int] | None = None

    def __post_init__(self) -> None:
        if not is_number(self.texture) and not isinstance(self.texture, gl.Texture | gl.TextureArray):
            raise BadInputError(
                f"texture is a {type(self.texture).__name__}; give ModernGL's Texture or TextureArray, or the OpenGL "
                "name of a texture."
            )
        for name, value in (("layer", self.layer), ("level", self.level)):
            if not is_number(value) or not 0 <= value < 1 << 31:
                raise BadInputError(f"{name} is {value!r}; give a whole number from 0.")
        rect: Any = (0, 0, 1, 1) if self.rect_px is None else self.rect_px
        is_rect = isinstance(rect, tuple | list) and len(rect) == 4 and all(map(is_number, rect))
        if not is_rect or min(rect[:2]) < 0 or min(rect[2:]) < 1:
            raise BadInputError(f"rect_px is {rect!r}; give (x, y, width, height), four whole numbers.")
        if self.rect_px is not None:
            object.__setattr__(self, "rect_px", tuple(map(int, rect)))  # plain numbers, for keys of caches

    def rect_in(self, size_px: tuple[int, int]) -> tuple[tuple[int, int], tuple[int, int]]:
        """Return the first pixel (x, y) and the size (width, height) of the picture in a level of a size.

        Raises:
            BadInputError: the rectangle is not inside the level.
        """
        x, y, width, height = self.rect_px or (0, 0, *size_px)
        if x + width > size_px[0] or y + height > size_px[1]:
            raise BadInputError(
                f"rect_px is {self.rect_px}, and texture {self.name} has {size_px[0]} x {size_px[1]} pixels; give a "
                "rectangle within it."
            )
        return (x, y), (width, height)

    @property
    def name(self) -> int:
        """OpenGL's name of the texture."""
        return int(self.texture if is_number(self.texture) else self.texture.glo)


def is_number(value: Any) -> bool:
    """Return whether a value may be the OpenGL name of an object: an integer that is not a bool."""
    return isinstance(value, Integral) and not isinstance(value, bool)


@dataclass(frozen=True)
class Image:
    """One layer and level of a texture, or a renderbuffer; `face` is a cube map's (OpenGL's enum), or 0."""

    name: int
    is_renderbuffer: bool = False
    level: int = 0
    layer: int = 0
    face: int = 0


@dataclass(frozen=True)
class ImageFormat:
    """Format of an attached image.

    Attributes:
        numbers: type of the components, an enum of OpenGL.
        red_bits, blue_bits, depth_bits, stencil_bits: bits of each component; 0 without it.
        is_srgb: whether OpenGL decodes the codes of the format when it is sampled.
    """

    numbers: int
    red_bits: int
    blue_bits: int
    depth_bits: int
    stencil_bits: int
    is_srgb: bool


class FramebufferQueries:
    """Queries and attachments of framebuffer objects; call them within drawing blocks."""

    def __init__(self, context: gl.GlContext) -> None:
        self._context = context
        self._functions: dict[str, Callable[..., Any]] = {}

    def gl(self, name: str, *argument_types: Any, result: Any = None) -> Callable[..., Any]:
        """Return an OpenGL function like `GlContext.function`; each name is looked up once."""
        if name not in self._functions:
            self._functions[name] = self._context.function(name, *argument_types, result=result)
        return self._functions[name]

    def is_texture(self, number: int) -> bool:
        """Return whether a number names a texture."""
        return 0 < number < 1 << 32 and bool(self.gl("glIsTexture", _UINT, result=ctypes.c_ubyte)(number))

    def part_of(self, layer: TextureLayer) -> "tuple[Image, tuple[int, int], tuple[int, int]]":
        """Return the image of a layer of a texture, and the size and first pixel of the picture in it.

        Raises:
            BadInputError: the texture, layer, level or rectangle does not exist.
        """
        image = Image(layer.name, False, layer.level, layer.layer)
        if not self.is_texture(image.name):
            raise BadInputError(f"number {image.name} is not a texture of the OpenGL context; give one that is.")
        self._check_layer(image)
        self._context.take_error()
        whole = self.size(image)
        if not all(whole):
            raise BadInputError(
                f"texture {image.name} is a cube map, a buffer or a row; give a 2D, array, 3D, rectangle or "
                "multisampled texture."
            )
        first_px, size = layer.rect_in(whole)
        return image, size, first_px

    def bind(self, number: int, target: int = BOTH) -> None:
        """Bind a framebuffer object, to which the other methods refer."""
        self.gl("glBindFramebuffer", _UINT, _UINT)(target, number)

    def images_of(self, framebuffer: Any, points: Sequence[int]) -> "list[Image | None]":
        """Return the images that are attached to a framebuffer of the caller, ModernGL's or by its number.

        Raises:
            BadInputError: a framebuffer object that does not exist or is incomplete, or to which a whole array of
                layers or a layer of a multisampled array, which Mesa does not report, is attached; or as
                `GlContext.host`.
        """
        number = int(framebuffer if is_number(framebuffer) else framebuffer.glo)
        is_ours = not is_number(framebuffer) and self._context.is_ours(framebuffer)
        with contextlib.nullcontext() if is_ours else self._context.host():
            exists = 0 < number < 1 << 32 and self.gl("glIsFramebuffer", _UINT, result=ctypes.c_ubyte)(number)
            if not exists:
                raise BadInputError(
                    f"number {number} is not a framebuffer object of the OpenGL context; give one that is."
                )
            self.bind(number)
            if not self.is_complete():
                raise BadInputError(f"the framebuffer {number} is incomplete; give one with an RGBA8 texture.")
            found = [self._image(point) for point in points]
            samples = self.integer(_SAMPLES)
        for image in found:
            if image is None or image.is_renderbuffer or image.layer or not samples:
                continue
            if self._with_texture(_MULTISAMPLED_ARRAY, image.name, lambda: True):
                raise BadInputError(
                    "the framebuffer has a layer of a multisampled array texture, and drivers do not say which one; "
                    "give it as TextureLayer(texture, layer=0)."
                )
        return found

    def is_complete(self) -> bool:
        """Return whether the framebuffer is complete."""
        return bool(self.gl("glCheckFramebufferStatus", _UINT, result=_UINT)(BOTH) == _COMPLETE)

    def _image(self, point: int) -> "Image | None":
        kind = self._of_attachment(point, _KIND)
        if kind not in (_TEXTURE, _RENDERBUFFER):
            return None
        name = self._of_attachment(point, _NAME)
        if kind == _RENDERBUFFER:
            return Image(name, is_renderbuffer=True)
        if self._of_attachment(point, _LAYERED):
            raise BadInputError(
                "the framebuffer is layered (all layers of an array texture are attached); give one layer as "
                "TextureLayer(texture, layer=0)."
            )
        level, layer, face = (self._of_attachment(point, enum) for enum in (_LEVEL, _LAYER, _FACE))
        return Image(name, False, level, layer, face)

    @contextlib.contextmanager
    def made(self) -> Iterator[int]:
        """Make a framebuffer object in the current context, for a block."""
        name = _UINT()
        self.gl("glGenFramebuffers", _INT, ctypes.c_void_p)(1, ctypes.addressof(name))
        try:
            yield name.value
        finally:
            self.gl("glDeleteFramebuffers", _INT, ctypes.c_void_p)(1, ctypes.addressof(name))

    def copy(self, first_px: tuple[int, int], size: tuple[int, int], buffers: int) -> None:
        """Copy pixels from the framebuffer bound to READ to the lower left corner of the one bound to DRAW."""
        (x, y), (width, height) = first_px, size
        blit = self.gl("glBlitFramebuffer", *[_INT] * 8, _UINT, _UINT)
        blit(x, y, x + width, y + height, 0, 0, width, height, buffers, _NEAREST)

    def attach(self, point: int, image: Image) -> bool:
        """Attach an image to the framebuffer, and detach all others; return whether it is then complete."""
        attach = self.gl("glFramebufferRenderbuffer", *[_UINT] * 4)
        for other in {COLOUR, DEPTH} - {point}:
            attach(BOTH, other, _RENDERBUFFER, 0)
        if image.is_renderbuffer:
            attach(BOTH, point, _RENDERBUFFER, image.name)
        elif image.face:
            self.gl("glFramebufferTexture2D", *[_UINT] * 4, _INT)(BOTH, point, image.face, image.name, image.level)
        else:
            attach_layer = self.gl("glFramebufferTextureLayer", _UINT, _UINT, _UINT, _INT, _INT)
            attach_layer(BOTH, point, image.name, image.level, image.layer)
            if self._context.take_error() and not image.layer:  # a texture without layers
                self.gl("glFramebufferTexture", _UINT, _UINT, _UINT, _INT)(BOTH, point, image.name, image.level)
        return not self._context.take_error() and self.is_complete()

    def format(self, point: int) -> ImageFormat:
        """Return the format of the image at an attachment point."""
        enums = _NUMBERS, _RED, _BLUE, _DEPTH_BITS, _STENCIL_BITS
        numbers, red, blue, depth, stencil = (self._of_attachment(point, enum) for enum in enums)
        return ImageFormat(numbers, red, blue, depth, stencil, self._of_attachment(point, _CODING) == _SRGB)

    def size(self, image: Image) -> tuple[int, int]:
        """Return width and height of an image; (0, 0) for an unknown kind."""
        if image.is_renderbuffer:
            self.gl("glBindRenderbuffer", _UINT, _UINT)(_RENDERBUFFER, image.name)
            read = self.gl("glGetRenderbufferParameteriv", _UINT, _UINT, ctypes.c_void_p)
            width, height = _numbers(read, _RENDERBUFFER, _RENDERBUFFER_WIDTH, _RENDERBUFFER_HEIGHT)
            return width, height
        found = self._of_level(image, _WIDTH, _HEIGHT)
        return (0, 0) if found is None else (found[1][0], found[1][1])

    def _check_layer(self, image: Image) -> None:
        found = self._of_level(image, _WIDTH, _LAYERS)
        if found is None:
            return
        width, layers = found[1]
        if not width:
            self._context.take_error()
            levels = [self._of_level(replace(image, level=level), _WIDTH) for level in range(_LEVELS)]
            self._context.take_error()
            count = sum(bool(each and each[1][0]) for each in levels)
            raise BadInputError(f"texture {image.name} has no level {image.level}; it has {count}, counted from 0.")
        if image.layer >= (layers := max(layers, 1)):
            raise BadInputError(f"texture {image.name} has no layer {image.layer}; it has {layers}, counted from 0.")

    def sampled(self, image: Image) -> "tuple[int, ImageFormat] | None":
        """Return target and format of a 2D or 2D-array texture that shaders can read directly; None for others."""
        if image.is_renderbuffer or image.level or image.face:
            return None
        read_level = self.gl("glGetTexLevelParameteriv", _UINT, _INT, _UINT, ctypes.c_void_p)
        read, settings = self.gl("glGetTexParameteriv", _UINT, _UINT, ctypes.c_void_p), (_INT * 5)()
        for target in (TEXTURE_2D, TEXTURE_2D_ARRAY):

            def asked(of: int = target) -> list[int]:
                read(of, _BASE_LEVEL, ctypes.addressof(settings))
                read(of, _SWIZZLE, ctypes.addressof(settings) + ctypes.sizeof(_INT))
                return _numbers(lambda to, enum, at: read_level(to, 0, enum, at), of, *_SAMPLED)

            found = self._with_texture(target, image.name, asked)
            if found is not None:
                red_type, depth_type, red, blue, depth, stencil, internal = found
                numbers = depth_type if depth else red_type
                is_srgb = internal in _SRGB_FORMATS
                return (
                    (target, ImageFormat(numbers, red, blue, depth, stencil, is_srgb))
                    if [*settings] == _PLAIN
                    else None
                )
        return None

    def _of_level(self, image: Image, *enums: int) -> tuple[int, list[int]] | None:
        """Return the target of a texture and values of glGetTexLevelParameter; None for an unknown kind."""
        read = self.gl("glGetTexLevelParameteriv", _UINT, _INT, _UINT, ctypes.c_void_p)
        for target in [_CUBE_MAP] if image.face else _TARGETS:

            def asked(of: int = image.face or target) -> list[int]:
                return _numbers(lambda to, enum, at: read(to, image.level, enum, at), of, *enums)

            found = self._with_texture(target, image.name, asked)
            if found is not None:
                return target, found
        return None

    def _with_texture(self, target: int, name: int, read: Callable[[], _Made]) -> _Made | None:
        """Bind a texture to a target and return the result of `read`; None if the texture has another target."""
        bind, before = self.gl("glBindTexture", _UINT, _UINT), self.integer(_BINDINGS[target])
        bind(target, name)
        if self._context.take_error():
            return None
        found = read()
        bind(target, before)
        return found

    def integer(self, enum: int) -> int:
        """Return the first integer of glGetIntegerv."""
        numbers = (_INT * 2)()
        self.gl("glGetIntegerv", _UINT, ctypes.c_void_p)(enum, ctypes.addressof(numbers))
        return numbers[0]

    def _of_attachment(self, point: int, enum: int) -> int:
        number, read = _INT(), "glGetFramebufferAttachmentParameteriv"
        self.gl(read, _UINT, _UINT, _UINT, ctypes.c_void_p)(BOTH, point, enum, ctypes.addressof(number))
        return number.value


def _numbers(read: Callable[..., None], target: int, *enums: int) -> list[int]:
    numbers = (_INT * len(enums))()
    for k, enum in enumerate(enums):
        read(target, enum, ctypes.addressof(numbers) + k * ctypes.sizeof(_INT))
    return list(numbers)


def fresh_framebuffer(context: gl.GlContext) -> gl.Framebuffer:
    """Return a new framebuffer of ours, to which an image can be attached."""
    return context.framebuffer([context.target((1, 1), 4, "f1")])

"""Pictures in other software's textures and framebuffers, as textures that a shader reads.

Plain textures and layers of arrays are read where they are. Renderbuffers, mip levels, cube faces and multisampled
images are first copied to a texture of ours, which resolves samples.
"""

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from wlr_render.errors import BadInputError
from wlr_render.gl import gl
from wlr_render.gl.framebuffers import (
    BLIT_COLOUR,
    BLIT_DEPTH,
    COLOUR,
    DEPTH,
    DRAW,
    FLOATS,
    READ,
    TEXTURE_2D,
    TEXTURE_2D_ARRAY,
    WHOLE_NUMBERS,
    FramebufferQueries,
    Image,
    ImageFormat,
    TextureLayer,
    fresh_framebuffer,
    is_number,
)
from wlr_render.gl.image_cache import ImageCache
from wlr_render.warp.stored_picture import StoredDepth, check_depth_format

_UINT, _INT = ctypes.c_uint, ctypes.c_int
_DEPTH_COMPONENT, _UNSIGNED_INT, _TEXTURE0 = 0x1902, 0x1405, 0x84C0
# Internal formats by (is float, bits of depth, has stencil).
_DEPTH_FORMATS = {
    (False, 16, False): 0x81A5,
    (False, 24, False): 0x81A6,
    (False, 24, True): 0x88F0,
    (False, 32, False): 0x81A7,
    (True, 32, False): 0x8CAC,
    (True, 32, True): 0x8CAD,
}


@dataclass(frozen=True, eq=False)
class TheirTexture:
    """A texture of other software.

    Attributes:
        glo: OpenGL's name, as ModernGL calls it.
        target: 2D or 2D array.
        functions: glActiveTexture and glBindTexture.
    """

    glo: int
    target: int
    functions: tuple[Callable[..., Any], Callable[..., Any]]

    def use(self, unit: int) -> None:
        """Bind the texture to a texture unit."""
        activate, bind = self.functions
        activate(_TEXTURE0 + unit)
        bind(self.target, self.glo)


@dataclass(frozen=True, eq=False)
class Source:
    """An image as a shader reads it.

    Attributes:
        texture: texture with the image; its sampler may have any state.
        size_px: (width, height) of the picture.
        first_px: column and row of the texture at which the picture starts.
        layer: layer of an array texture; None for a plain texture.
        is_8_bit: whether the components are fractions of 8 bits.
        is_srgb: whether OpenGL decodes the codes of its format.
        is_callers: whether the texture is the caller's own.
    """

    texture: gl.Texture | TheirTexture
    size_px: tuple[int, int]
    first_px: tuple[int, int] = (0, 0)
    layer: int | None = None
    is_8_bit: bool = False
    is_srgb: bool = False
    is_callers: bool = False


@dataclass(frozen=True, eq=False)
class _Blit:
    """A copy of one image, from a framebuffer of ours that holds it to one with our texture."""

    source: gl.Framebuffer
    target: gl.Framebuffer
    buffers: int
    first_px: tuple[int, int]
    size_px: tuple[int, int]


@dataclass(eq=False)
class _Prepared:
    """The images of a picture, colour first, and the copies that each frame needs."""

    sources: list[Source] = field(default_factory=list)
    blits: list[_Blit] = field(default_factory=list)
    needs_depth_kind: bool = False


_NO_FORMAT = ImageFormat(0, 0, 0, 0, 0, False)
_Part = tuple[Image, tuple[int, int], tuple[int, int]]  # image, and size and first pixel of the picture in it


class GivenPictures:
    """Finds the images of callers' pictures; copies are reused while size and format stay the same.

    Call its methods within drawing blocks.
    """

    def __init__(self, context: gl.GlContext) -> None:
        self._context = context
        self._ask = FramebufferQueries(context)
        self._prepared: ImageCache[_Prepared] = ImageCache(self._ask)
        self._targets: dict[int, tuple[tuple[object, ...], gl.Framebuffer, gl.Texture]] = {}
        self._new = ""  # name of a picture that was never copied before
        self._binding = self._ask.gl("glActiveTexture", _UINT), self._ask.gl("glBindTexture", _UINT, _UINT)

    def of_framebuffer(self, framebuffer: Any, size: tuple[int, int], stored: StoredDepth) -> list[Source]:
        """Return colour and depth of a framebuffer object (or its number) of (width, height), rows as stored.

        Raises:
            BadInputError: the framebuffer object does not exist, has another size, lacks colour or depth, or has them
                in a format that cannot be copied; see also `check_depth_format`.
        """
        number = int(framebuffer if is_number(framebuffer) else framebuffer.glo)

        def prepare(old: _Prepared | None) -> _Prepared:
            parts = [(image, self._ask.size(image), (0, 0)) for image in self._images_of(framebuffer, number)]
            return self._prepare(parts, f"framebuffer {number}", size, old)

        return self._sources(self._prepared.get([framebuffer], size, prepare), stored)

    def of_textures(self, given: Sequence[Any], size: tuple[int, int] | None, stored: StoredDepth) -> list[Source]:
        """Return the colour, and depth if there is one, of textures or layers of (width, height), rows as stored.

        If the size is None, any size is accepted.

        Raises:
            BadInputError: a texture, layer or level does not exist, or has another size or a format that cannot be
                read; see also `check_depth_format`.
        """
        layers = [each if isinstance(each, TextureLayer) else TextureLayer(each) for each in given]

        def prepare(old: _Prepared | None) -> _Prepared:
            return self._prepare([self._ask.part_of(each) for each in layers], "texture {name}", size, old)

        key = (size, "layers", *((each.layer, each.level, each.rect_px) for each in layers))
        return self._sources(self._prepared.get(list(given), key, prepare), stored)

    def _images_of(self, framebuffer: Any, number: int) -> list[Image]:
        images = []
        for image, name in zip(self._ask.images_of(framebuffer, [COLOUR, DEPTH]), ("colour", "depth"), strict=True):
            if image is None:
                raise BadInputError(f"The framebuffer {number} has no {name} attachment: give it one and draw into it.")
            images.append(image)
        return images

    def _prepare(
        self, parts: Sequence[_Part], what: str, size: tuple[int, int] | None, old: _Prepared | None
    ) -> _Prepared:
        self._context.take_error()
        size = size or parts[0][1]
        for image, found, _ in parts:
            if found != size:
                raise BadInputError(
                    f"The picture in the {what.format(name=image.name)} has {found[0]}x{found[1]} pixels, the camera "
                    f"{size[0]}x{size[1]}: draw with that camera."
                )
        what = what.format(name=parts[0][0].name)
        made, spare = _Prepared(), [each.source for each in old.blits] if old else []
        for point, part in zip((COLOUR, DEPTH), parts, strict=False):
            self._add(made, point, part, what, spare)
        self._new = what if made.blits else ""
        return made

    def _add(self, made: _Prepared, point: int, part: _Part, what: str, spare: list[gl.Framebuffer]) -> None:
        """Add an image to a picture, and a copy if shaders cannot read the image."""
        image, size, first_px = part
        target, found = self._ask.sampled(image) or (0, None)
        if found is not None and not found.stencil_bits:
            buffers = _buffers(point, found, what)
            layer = image.layer if target == TEXTURE_2D_ARRAY else None
            texture = TheirTexture(image.name, target, self._binding)
            source = Source(texture, size, first_px, layer, _is_8_bit(found), found.is_srgb, is_callers=True)
        else:
            holder = spare.pop() if spare else fresh_framebuffer(self._context)
            found, buffers = self._attached(holder, point, image, what)
            framebuffer, copy = self._copy_of(point, found, buffers, size)
            source = Source(copy, size, is_8_bit=_is_8_bit(found), is_srgb=gl.is_srgb(copy))
            made.blits.append(_Blit(holder, framebuffer, buffers, first_px, size))
        made.needs_depth_kind |= buffers == BLIT_DEPTH
        made.sources.append(source)

    def _attached(self, framebuffer: gl.Framebuffer, point: int, image: Image, what: str) -> tuple[ImageFormat, int]:
        """Attach an image to a framebuffer of ours; return its format, and the buffer for a copy."""
        self._ask.bind(framebuffer.glo)
        for at in dict.fromkeys((point, COLOUR)):  # a depth may be the first component of a colour
            if self._ask.attach(at, image):
                found = self._ask.format(at)
                return found, _buffers(point, found, what)
        return _NO_FORMAT, _buffers(point, _NO_FORMAT, what)

    def _copy_of(
        self, point: int, found: ImageFormat, buffers: int, size: tuple[int, int]
    ) -> tuple[gl.Framebuffer, gl.Texture]:
        """Return a framebuffer of ours and its texture, in a format to which an image can be copied."""
        if point == COLOUR:
            # A resolve or copy keeps the codes of an sRGB format only if the target is sRGB too.
            dtype = "f2" if found.numbers == FLOATS or found.red_bits > 8 else "srgb" if found.is_srgb else "f1"
            return self._target(COLOUR, (size, dtype), lambda: self._context.target(size, 4, dtype))
        if buffers == BLIT_COLOUR:
            return self._target(DEPTH, (size, "f4"), lambda: self._context.target(size, 1, "f4"))
        depth_format = _DEPTH_FORMATS[_depth_key(found)]

        def make() -> gl.Texture:
            texture = self._context.target(size, 1, "f4")
            # glBlitFramebuffer requires matching depth formats.
            texture.use(self._context.texture_unit)
            image = self._ask.gl("glTexImage2D", _UINT, *[_INT] * 5, _UINT, _UINT, ctypes.c_void_p)
            image(TEXTURE_2D, 0, depth_format, *size, 0, _DEPTH_COMPONENT, _UNSIGNED_INT, None)
            return texture

        return self._target(DEPTH, (size, depth_format), make)

    def _target(self, point: int, key: tuple[object, ...], make: Any) -> tuple[gl.Framebuffer, gl.Texture]:
        found = self._targets.get(point)
        if found is None or found[0] != key:
            texture, framebuffer = make(), fresh_framebuffer(self._context)
            self._ask.bind(framebuffer.glo)
            is_depth = point == DEPTH and key[-1] != "f4"
            self._ask.attach(DEPTH if is_depth else COLOUR, Image(int(texture.glo)))
            found = self._targets[point] = key, framebuffer, texture
        return found[1:]

    def _sources(self, prepared: _Prepared, stored: StoredDepth) -> list[Source]:
        if prepared.needs_depth_kind:
            check_depth_format(stored)
        for blit in prepared.blits:
            self._ask.bind(blit.source.glo, READ)
            self._ask.bind(blit.target.glo, DRAW)
            self._ask.copy(blit.first_px, blit.size_px, blit.buffers)
        what, self._new = self._new, ""
        if what and self._context.take_error():
            self._prepared.clear()
            raise BadInputError(
                f"OpenGL cannot copy the {what}: resolve it into one of single samples with RGBA8 colour first."
            )
        return prepared.sources


def _buffers(point: int, found: ImageFormat, what: str) -> int:
    """Return the buffer in which an image holds colour, or depth.

    Raises:
        BadInputError: it holds no such buffer.
    """
    is_whole = found.numbers in WHOLE_NUMBERS
    if point == COLOUR:
        if is_whole or not found.blue_bits:
            kind = "whole numbers" if is_whole else "no red, green and blue"
            raise BadInputError(f"The {what} holds {kind} for colours: use RGBA8.")
        return BLIT_COLOUR
    if _depth_key(found) in _DEPTH_FORMATS:
        return BLIT_DEPTH
    if is_whole or not found.red_bits:
        raise BadInputError(f"The {what} holds no depth that can be copied: use a depth format.")
    return BLIT_COLOUR


def _is_8_bit(found: ImageFormat) -> bool:
    return found.numbers != FLOATS and found.red_bits <= 8


def _depth_key(found: ImageFormat) -> tuple[bool, int, bool]:
    return found.numbers == FLOATS, found.depth_bits, found.stencil_bits > 0

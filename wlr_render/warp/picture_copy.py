"""Copies of other software's images, which may have several samples, layers or levels, as plain textures."""

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass, replace
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
    WHOLE_NUMBERS,
    FramebufferQueries,
    Image,
    ImageCache,
    ImageFormat,
    TextureLayer,
    fresh_framebuffer,
    is_number,
)
from wlr_render.warp.stored_picture import StoredDepth, check_depth_format

_UINT, _INT = ctypes.c_uint, ctypes.c_int
_TEXTURE_2D, _DEPTH_COMPONENT, _UNSIGNED_INT = 0x0DE1, 0x1902, 0x1405
# Internal formats by (is float, bits of depth, whether there is a stencil).
_DEPTH_FORMATS = {
    (False, 16, False): 0x81A5,
    (False, 24, False): 0x81A6,
    (False, 24, True): 0x88F0,
    (False, 32, False): 0x81A7,
    (True, 32, False): 0x8CAC,
    (True, 32, True): 0x8CAD,
}


@dataclass(frozen=True, eq=False)
class _Blit:
    """A copy of one image: from a framebuffer of ours that has it, to one with our texture."""

    source: gl.Framebuffer
    target: gl.Framebuffer
    texture: gl.Texture
    buffers: int
    first_px: tuple[int, int] = (0, 0)


_Blits = tuple[_Blit, ...]  # one for colour, and one for depth if the picture has one


class PictureCopy:
    """Copies images to plain textures, which are reused while size and format stay the same.

    Call its methods within drawing blocks.
    """

    def __init__(self, context: gl.GlContext) -> None:
        self._context = context
        self._ask = FramebufferQueries(context)
        self._blits: ImageCache[_Blits] = ImageCache()
        self._targets: dict[int, tuple[tuple[object, ...], gl.Framebuffer, gl.Texture]] = {}
        self._new = ""  # the source that was never copied before

    def copy_framebuffer(self, framebuffer: Any, size: tuple[int, int], stored: StoredDepth) -> tuple[gl.Texture, ...]:
        """Colour and depth of a framebuffer object (or its number) of (width, height), rows as they lie.

        Raises:
            BadInputError: the framebuffer object does not exist, has another size, lacks colour or depth, or has them
                in a format that cannot be copied; or as `check_depth_format`.
        """
        number = int(framebuffer if is_number(framebuffer) else framebuffer.glo)
        fixed = not is_number(framebuffer) and framebuffer.color_attachments is not None

        def prepare(old: _Blits | None) -> _Blits:
            images = [(image, self._ask.size(image), (0, 0)) for image in self._images_of(framebuffer, number)]
            return self._prepare(images, f"framebuffer {number}", size, old)

        return self._copied(self._blits.get([framebuffer if fixed else number], size, prepare), size, stored)

    def copy_layers(self, given: Sequence[Any], size: tuple[int, int], stored: StoredDepth) -> tuple[gl.Texture, ...]:
        """Colour, and depth if there is one, of textures or layers of (width, height), rows as they lie.

        Raises:
            BadInputError: a texture, layer or level does not exist, or has another size or a format that cannot be
                copied; or as `check_depth_format`.
        """
        layers = [each if isinstance(each, TextureLayer) else TextureLayer(each) for each in given]

        def prepare(old: _Blits | None) -> _Blits:
            return self._prepare([self._part_of(each) for each in layers], "texture {name}", size, old)

        key = (*size, "layers", *((each.layer, each.level, each.rect_px) for each in layers))
        return self._copied(self._blits.get(list(given), key, prepare), size, stored)

    def size_of(self, layer: TextureLayer) -> tuple[int, int]:
        """(width, height) of the picture in a layer of a texture.

        Raises:
            BadInputError: the texture, layer, level or rectangle does not exist.
        """
        return self._part_of(layer)[1]

    def _part_of(self, layer: TextureLayer) -> tuple[Image, tuple[int, int], tuple[int, int]]:
        """Return an image, and size and first pixel of the picture in it."""
        image = Image(layer.name, False, layer.level, layer.layer)
        if not self._ask.is_texture(image.name):
            raise BadInputError(f"Number {image.name} is not a texture of this context: submit one that is.")
        self._ask.check_layer(image)
        self._context.take_error()
        first_px, size = layer.rect_in(self._ask.size(image))
        return image, size, first_px

    def _images_of(self, framebuffer: Any, number: int) -> list[Image]:
        images = []
        for image, name in zip(self._ask.images_of(framebuffer, [COLOUR, DEPTH]), ("colour", "depth"), strict=True):
            if image is None:
                raise BadInputError(f"The framebuffer {number} has no {name} attachment: give it one and draw into it.")
            images.append(image)
        return images

    def _prepare(
        self,
        parts: Sequence[tuple[Image, tuple[int, int], tuple[int, int]]],
        what: str,
        size: tuple[int, int],
        old: _Blits | None,
    ) -> _Blits:
        self._context.take_error()
        for image, found, _ in parts:
            if found != size:
                raise BadInputError(
                    f"The picture in the {what.format(name=image.name)} has {found[0]}x{found[1]} pixels, the camera "
                    f"{size[0]}x{size[1]}: draw with that camera."
                )
        sources = [each.source for each in old] if old else [fresh_framebuffer(self._context) for _ in parts]
        blits = [self._colour_blit(parts[0][0], sources[0], what, size)]
        blits += [self._depth_blit(each, sources[1], what, size) for each, _, _ in parts[1:]]
        self._new = what.format(name=parts[0][0].name)
        return tuple(replace(blit, first_px=first_px) for blit, (_, _, first_px) in zip(blits, parts, strict=True))

    def _colour_blit(self, image: Image, source: gl.Framebuffer, what: str, size: tuple[int, int]) -> _Blit:
        self._ask.bind(source.glo)
        found = self._ask.format(COLOUR) if self._ask.attach(COLOUR, image) else None
        if found is None or not found.blue_bits or found.numbers in WHOLE_NUMBERS:
            kind = "holds whole numbers" if found and found.numbers in WHOLE_NUMBERS else "holds no red, green and blue"
            raise BadInputError(f"The {what.format(name=image.name)} {kind} for colours: use RGBA8.")
        return _Blit(source, *self._colour_target(found, size), BLIT_COLOUR)

    def _colour_target(self, found: ImageFormat, size: tuple[int, int]) -> tuple[gl.Framebuffer, gl.Texture]:
        # A resolve or copy keeps the codes of an sRGB format only in one.
        dtype = "f2" if found.numbers == FLOATS or found.red_bits > 8 else "srgb" if found.is_srgb else "f1"
        return self._target(COLOUR, (size, dtype), lambda: self._context.target(size, 4, dtype))

    def _depth_blit(self, image: Image, source: gl.Framebuffer, what: str, size: tuple[int, int]) -> _Blit:
        self._ask.bind(source.glo)
        if self._ask.attach(DEPTH, image):
            found = self._ask.format(DEPTH)
            key = found.numbers == FLOATS, found.depth_bits, found.stencil_bits > 0
            if key in _DEPTH_FORMATS:
                return _Blit(source, *self._depth_target(_DEPTH_FORMATS[key], size), BLIT_DEPTH)
        elif self._ask.attach(COLOUR, image) and self._ask.format(COLOUR).numbers not in WHOLE_NUMBERS:
            made = self._target(DEPTH, (size, "f4"), lambda: self._context.target(size, 1, "f4"))
            return _Blit(source, *made, BLIT_COLOUR)
        raise BadInputError(
            f"The {what.format(name=image.name)} holds no depth that can be copied: use a depth format."
        )

    def _depth_target(self, depth_format: int, size: tuple[int, int]) -> tuple[gl.Framebuffer, gl.Texture]:
        def make() -> gl.Texture:
            texture = self._context.target(size, 1, "f4")
            # glBlitFramebuffer requires matching depth formats.
            texture.use(self._context.texture_unit)
            image = self._ask.gl("glTexImage2D", _UINT, *[_INT] * 5, _UINT, _UINT, ctypes.c_void_p)
            image(_TEXTURE_2D, 0, depth_format, *size, 0, _DEPTH_COMPONENT, _UNSIGNED_INT, None)
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

    def _copied(self, blits: _Blits, size: tuple[int, int], stored: StoredDepth) -> tuple[gl.Texture, ...]:
        if blits[-1].buffers == BLIT_DEPTH:
            check_depth_format(stored)
        for blit in blits:
            self._draw(blit, size)
        what, self._new = self._new, ""
        if what and self._context.take_error():
            self._blits.clear()
            raise BadInputError(
                f"OpenGL cannot copy the {what}: resolve it into one of single samples with RGBA8 colour first."
            )
        return tuple(each.texture for each in blits)

    def _draw(self, blit: _Blit, size: tuple[int, int]) -> None:
        self._ask.bind(blit.source.glo, READ)
        self._ask.bind(blit.target.glo, DRAW)
        self._ask.copy(blit.first_px, size, blit.buffers)

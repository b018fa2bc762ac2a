"""Import of pictures that other programs rendered, as the GPU images that the warp reads."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.rendering import gl
from wlr_render.rendering.framebuffers import TextureLayer, is_number
from wlr_render.rendering.gpu_image import GpuImage
from wlr_render.rendering.picture_copy import PictureCopy
from wlr_render.rendering.stored_picture import (
    CODES,
    COLOUR_TYPES,
    DepthKind,
    Rows,
    StoredColour,
    StoredDepth,
    check_arrays,
    check_depth_format,
)


class PictureImport:
    """Converts other programs' pictures to GPU images; textures are reused, so each picture overwrites the last."""

    def __init__(self, context: gl.GlContext) -> None:
        self._context = context
        self._copy = PictureCopy(context)
        self._targets = gl.RenderTargets(context)
        with context.drawing():
            self._imports = [context.full_screen("import_picture.frag", DECODE=decode) for decode in (0, 1)]
            self._samplers = {"srgb": context.plain_sampler(), "linear": context.plain_sampler(decodes=True)}

    def take(
        self,
        camera: Pinhole,
        colour: Any,
        depth: Any,
        stored: StoredDepth,
        rows: Rows | None = None,
        stored_colour: StoredColour = CODES,
    ) -> GpuImage:
        """A picture of any kind that `Compositor.submit` takes; rows lie as usual for that kind if None.

        Raises:
            BadInputError: as the methods below, or a picture of no such kind.
        """
        if isinstance(colour, np.ndarray) and isinstance(depth, np.ndarray):
            return self.from_arrays(camera, colour, depth, stored, rows or Rows.TOP_FIRST, stored_colour)
        upwards = rows or Rows.BOTTOM_FIRST
        if isinstance(colour, gl.Texture) and isinstance(depth, gl.Texture):
            return self.from_textures(camera, colour, depth, stored, upwards, stored_colour)
        if all(_is_texture(each) for each in (colour, depth)):
            return self.from_layers(camera, _layer(colour), _layer(depth), stored, upwards, stored_colour)
        if depth is None and (isinstance(colour, gl.Framebuffer) or is_number(colour)):
            return self.from_framebuffer(camera, colour, stored, upwards, stored_colour)
        raise BadInputError(
            f"a picture cannot be taken from a {type(colour).__name__} and a {type(depth).__name__}; submit two "
            "arrays, two textures (ModernGL's, their OpenGL names, or TextureLayer), or one framebuffer (or its "
            "number) that holds both colour and depth."
        )

    def from_arrays(
        self,
        camera: Pinhole,
        colour: NDArray[Any],
        depth: NDArray[np.float32],
        stored: StoredDepth,
        rows: Rows = Rows.TOP_FIRST,
        stored_colour: StoredColour = CODES,
    ) -> GpuImage:
        """A picture in memory: colours (height, width, 3 or 4) of `COLOUR_TYPES`, and depth (height, width).

        Raises:
            BadInputError: as `stored_picture.check_arrays`.
        """
        size = camera.width_px, camera.height_px
        check_arrays(colour, depth, stored, size, stored_colour)
        with self._context.drawing():
            kind = colour.shape[2], COLOUR_TYPES[str(colour.dtype)]
            textures = self._targets.get(f"{kind} uploaded", size, kind, (1, "f4")).textures
            for texture, pixels in zip(textures, (colour, depth), strict=True):
                texture.write(np.ascontiguousarray(pixels), alignment=1)
            return self._take(camera, textures[0], textures[1], stored, rows, stored_colour)

    def from_textures(
        self,
        camera: Pinhole,
        colour: gl.Texture,
        depth: gl.Texture,
        stored: StoredDepth,
        rows: Rows = Rows.BOTTOM_FIRST,
        stored_colour: StoredColour = CODES,
    ) -> GpuImage:
        """A picture in textures of the image's context; depth in the first channel.

        Raises:
            BadInputError: a texture of another context or size, or of other numbers; metres in a depth format.
        """
        if any(not gl.is_released(each) and each.samples for each in (colour, depth)):
            return self.from_layers(camera, TextureLayer(colour), TextureLayer(depth), stored, rows, stored_colour)
        size = camera.width_px, camera.height_px
        for name, texture, least_components in (("colour", colour, 3), ("depth", depth, 1)):
            _check_texture(self._context, name, texture, size, least_components)
        if depth.depth:
            check_depth_format(stored)
        with self._context.drawing():
            return self._take(camera, colour, depth, stored, rows, stored_colour, callers=True)

    def from_layers(
        self,
        camera: Pinhole,
        colour: TextureLayer,
        depth: TextureLayer,
        stored: StoredDepth,
        rows: Rows = Rows.BOTTOM_FIRST,
        stored_colour: StoredColour = CODES,
    ) -> GpuImage:
        """A picture in layers of textures of any kind, which are copied on the GPU; see `from_framebuffer`.

        The depth may have a depth format, or be the first component of a colour format.

        Raises:
            BadInputError: a texture of another context or size, or of a format that cannot be copied; no such
                layer or level; metres in a depth format.
        """
        for name, layer in (("colour", colour), ("depth", depth)):
            if not is_number(layer.texture):
                _check_context(self._context, f"{name} texture", layer.texture)
        with self._context.drawing():
            textures = self._copy.copy_layers(colour, depth, (camera.width_px, camera.height_px), stored)
            return self._take(camera, *textures, stored, rows, stored_colour)

    def from_framebuffer(
        self,
        camera: Pinhole,
        framebuffer: gl.Framebuffer | int,
        stored: StoredDepth,
        rows: Rows = Rows.BOTTOM_FIRST,
        stored_colour: StoredColour = CODES,
    ) -> GpuImage:
        """A picture in a framebuffer object of the image's context, ModernGL's or by its OpenGL number.

        It is copied, on the GPU. Of several samples per pixel colours are averaged. Of their depths OpenGL takes one,
        usually sample 0, which lies up to half a pixel from the centre.

        Raises:
            BadInputError: a framebuffer of another context or size, or whose colour or depth is missing or of a kind
                that cannot be copied; metres in a depth format.
        """
        if not is_number(framebuffer):
            _check_context(self._context, "framebuffer", framebuffer)
        with self._context.drawing():
            textures = self._copy.copy_framebuffer(framebuffer, (camera.width_px, camera.height_px), stored)
            return self._take(camera, *textures, stored, rows, stored_colour)

    def _take(
        self,
        camera: Pinhole,
        colour: gl.Texture,
        depth: gl.Texture,
        stored: StoredDepth,
        rows: Rows,
        stored_colour: StoredColour,
        callers: bool = False,
    ) -> GpuImage:
        """Convert two textures; a caller's textures may have any filter, so that they are read by a sampler of ours."""
        codes = stored_colour.encoding == "srgb"
        in_bytes = codes and stored_colour.bits == 8 and colour.dtype in ("f1", "nu1")
        kind = "srgb" if in_bytes else "f2"
        target = self._targets.get(f"picture {kind}", (camera.width_px, camera.height_px), (4, kind), (1, "f4"))
        self._context.draw_to(target.framebuffer)
        drawing = self._imports[codes and not in_bytes]
        program = drawing.program
        gl.bind_textures(program, stored_colour=colour, stored_depth=depth)
        # Codes of fewer bits than the numbers of a uint16 texture, which holds 65535 as 1.
        of_largest = 65535 / ((1 << stored_colour.bits) - 1) if not callers and colour.dtype == "nu2" else 1.0
        gl.set_uniforms(
            program,
            bottom_first=rows is Rows.BOTTOM_FIRST,
            scale=(*[of_largest] * 3, of_largest if stored_colour.alpha else 0.0),
            opaque=0.0 if stored_colour.alpha else 1.0,
            in_metres=stored.kind is DepthKind.METRES,
            inverse_depth_of_0_and_1=stored.inverse_of_0_and_1,
            limits=stored.limits,
        )
        units = range(2 if callers or gl.is_srgb(colour) else 0)
        for unit in units:
            self._samplers[stored_colour.encoding].use(unit)
        drawing.render(vertices=3)
        for unit in units:
            self._samplers[stored_colour.encoding].clear(unit)
        colours, depths = target.textures
        return GpuImage(
            self._context,
            camera,
            colours,
            depths,
            encoding="srgb" if in_bytes else "linear",
            has_alpha=stored_colour.alpha,
        )


def _is_texture(value: Any) -> bool:
    return is_number(value) or isinstance(value, TextureLayer | gl.Texture | gl.TextureArray)


def _layer(value: Any) -> TextureLayer:
    return value if isinstance(value, TextureLayer) else TextureLayer(value)


def _check_context(context: gl.GlContext, name: str, thing: Any) -> None:
    if gl.is_released(thing):
        raise BadInputError(f"The {name} has been released: submit a picture before you release it.")
    if not context.has(thing):
        raise BadInputError(
            f"The {name} belongs to another ModernGL context: adopt that one, or hand the picture over as arrays."
        )


def _check_texture(
    context: gl.GlContext, name: str, texture: gl.Texture, size: tuple[int, int], least_components: int
) -> None:
    _check_context(context, f"{name} texture", texture)
    if texture.size != size:
        raise BadInputError(
            f"The {name} texture has {texture.size[0]}x{texture.size[1]} pixels, the camera {size[0]}x{size[1]}: draw "
            "with that camera."
        )
    if not texture.dtype.startswith(("f", "nu")) or texture.components < least_components:
        raise BadInputError(
            f"The {name} texture has {texture.components} components of '{texture.dtype}': it needs {least_components} "
            "that are read as fractions ('f1', 'nu2', 'f2' or 'f4')."
        )

"""Import of pictures that other programs rendered, as the GPU images that the warp reads."""

import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.rendering import gl
from wlr_render.rendering.framebuffers import FramebufferCopy
from wlr_render.rendering.gpu_image import GpuImage
from wlr_render.rendering.stored_picture import DepthKind, Rows, StoredDepth, check_arrays


class PictureImport:
    """Converts other programs' pictures to GPU images; textures are reused, so each picture overwrites the last."""

    def __init__(self, context: gl.GlContext) -> None:
        self._context = context
        self._copy = FramebufferCopy(context)
        self._targets = gl.RenderTargets(context)
        with context.drawing():
            self._import = context.full_screen("import_picture.frag")
            self._sampler = context.plain_sampler()

    def from_arrays(
        self,
        camera: Pinhole,
        colour: NDArray[np.uint8],
        depth: NDArray[np.float32],
        stored: StoredDepth,
        rows: Rows = Rows.TOP_FIRST,
    ) -> GpuImage:
        """A picture in memory; arguments and faults are those of `stored_picture.picture_of_arrays`."""
        size = camera.width_px, camera.height_px
        check_arrays(colour, depth, size)
        with self._context.drawing():
            components = colour.shape[2]
            textures = self._targets.get(f"{components} uploaded", size, (components, "f1"), (1, "f4")).textures
            for texture, pixels in zip(textures, (colour, depth), strict=True):
                texture.write(np.ascontiguousarray(pixels), alignment=1)
            return self._take(camera, textures[0], textures[1], stored, rows)

    def from_textures(
        self,
        camera: Pinhole,
        colour: gl.Texture,
        depth: gl.Texture,
        stored: StoredDepth,
        rows: Rows = Rows.BOTTOM_FIRST,
    ) -> GpuImage:
        """A picture in textures of the image's context: colours as sRGB bytes, depth in the first channel.

        Raises:
            BadInputError: a texture of another context or size, of other numbers, or of several samples.
        """
        size = camera.width_px, camera.height_px
        for name, texture, least_components in (("colour", colour, 3), ("depth", depth, 1)):
            _check_texture(self._context, name, texture, size, least_components)
        with self._context.drawing():
            return self._take(camera, colour, depth, stored, rows)

    def from_framebuffer(
        self,
        camera: Pinhole,
        framebuffer: gl.Framebuffer | int,
        stored: StoredDepth,
        rows: Rows = Rows.BOTTOM_FIRST,
    ) -> GpuImage:
        """A picture in a framebuffer object of the image's context, ModernGL's or by its OpenGL number.

        It is copied, on the GPU. Of several samples per pixel OpenGL takes one for the depth, which need not lie at the
        pixel's centre.

        Raises:
            BadInputError: a framebuffer of another context or size, or whose colour or depth is missing or of a kind
                that cannot be copied.
        """
        if isinstance(framebuffer, int):
            number = framebuffer
        else:
            _check_context(self._context, "framebuffer", framebuffer)
            number = int(framebuffer.glo)
        with self._context.drawing():
            colour, depth = self._copy.copy(number, (camera.width_px, camera.height_px))
            return self._take(camera, colour, depth, stored, rows)

    def _take(
        self, camera: Pinhole, colour: gl.Texture, depth: gl.Texture, stored: StoredDepth, rows: Rows
    ) -> GpuImage:
        target = self._targets.get("picture", (camera.width_px, camera.height_px), (4, "f1"), (1, "f4"))
        target.framebuffer.use()
        program = self._import.program
        gl.bind_textures(program, stored_colour=colour, stored_depth=depth)
        gl.set_uniforms(
            program,
            bottom_first=rows is Rows.BOTTOM_FIRST,
            in_metres=stored.kind is DepthKind.METRES,
            inverse_depth_of_0_and_1=stored.inverse_of_0_and_1,
        )
        for unit in range(2):
            self._sampler.use(unit)
        self._import.render(vertices=3)
        for unit in range(2):
            self._sampler.clear(unit)
        return GpuImage(self._context, camera, *target.textures)


def _check_context(context: gl.GlContext, name: str, thing: gl.Texture | gl.Framebuffer) -> None:
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
    if texture.dtype[0] != "f" or texture.components < least_components:
        raise BadInputError(
            f"The {name} texture has {texture.components} components of '{texture.dtype}': it needs {least_components} "
            "that are read as fractions ('f1', 'f2' or 'f4')."
        )
    if texture.samples:
        raise BadInputError(f"The {name} texture has {texture.samples} samples: hand over the framebuffer instead.")

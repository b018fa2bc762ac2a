"""Import of other programs' pictures as the GPU images that the warp reads."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.geometry.pinhole import Pinhole, pixels_from
from wlr_render.gl import gl
from wlr_render.gl.framebuffers import TextureLayer, is_number
from wlr_render.warp.given_pictures import GivenPictures, Source
from wlr_render.warp.gpu_image import GpuImage
from wlr_render.warp.stored_picture import (
    CODES,
    COLOUR_TYPES,
    METRES,
    DepthKind,
    Encoding,
    Rows,
    StoredColour,
    StoredDepth,
    check_arrays,
    check_colour_array,
)

BORDER = 0.1
"""Width of the border in which an inset blends into the wider picture, as a share of its shorter side."""


class PictureImport:
    """Converts other programs' pictures to GPU images; textures are reused, so each picture overwrites the last."""

    def __init__(self, context: gl.GlContext) -> None:
        self._context = context
        self._targets = gl.RenderTargets(context)
        self._drawings: dict[tuple[bool, ...], gl.VertexArray] = {}
        with context.drawing():
            self._given = GivenPictures(context)
            for decodes in (False, True):
                self._drawing(decodes, False, False)
            self._samplers = {"srgb": context.plain_sampler(), "linear": context.plain_sampler(decodes=True)}

    def take(
        self,
        camera: Pinhole,
        colour: Any,
        depth: Any,
        stored: StoredDepth,
        rows: Rows | None = None,
        stored_colour: StoredColour = CODES,
        wider: GpuImage | None = None,
    ) -> GpuImage:
        """Import a picture of any kind that `Compositor.submit` takes, with that kind's usual row order if None.

        Args:
            camera: camera that drew it.
            colour, depth: see `Compositor.submit`.
            stored: encoding of the depth.
            rows: row that comes first.
            stored_colour: encoding of the colours.
            wider: for an inset, the picture around it, in the same camera frame. Within BORDER of the inset's sides its
                colours blend into the wider picture's, in linear light. Without a depth it takes the wider picture's.

        Raises:
            BadInputError: another type of picture; see also the methods below.
        """
        has_depth = depth is not None
        if isinstance(colour, GpuImage) and wider is not None:
            stored_colour = StoredColour(colour.encoding, alpha=colour.has_alpha)
            stored = StoredDepth(DepthKind.INVERSE)
            with self._context.drawing():
                given = [_own(colour.colour), _own(colour.inverse_depth)]
                return self._take(camera, given, stored, Rows.TOP_FIRST, stored_colour, wider)
        if isinstance(colour, np.ndarray) and (isinstance(depth, np.ndarray) or (wider and not has_depth)):
            return self.from_arrays(camera, colour, depth, stored, rows or Rows.TOP_FIRST, stored_colour, wider)
        upwards = rows or Rows.BOTTOM_FIRST
        if not has_depth and (isinstance(colour, gl.Framebuffer) or is_number(colour)):
            return self.from_framebuffer(camera, colour, stored, upwards, stored_colour, wider)
        if is_texture(colour) and (is_texture(depth) or (wider and not has_depth)):
            return self.from_textures(camera, colour, depth, stored, upwards, stored_colour, wider)
        raise BadInputError(
            f"a picture cannot be taken from a {type(colour).__name__} and a {type(depth).__name__}; submit two "
            "arrays, two textures (ModernGL's, their OpenGL names, or TextureLayer), or one framebuffer (or its "
            "number) that holds both colour and depth."
        )

    def from_arrays(
        self,
        camera: Pinhole,
        colour: NDArray[Any],
        depth: NDArray[np.float32] | None,
        stored: StoredDepth,
        rows: Rows = Rows.TOP_FIRST,
        stored_colour: StoredColour = CODES,
        wider: GpuImage | None = None,
    ) -> GpuImage:
        """Import a picture in memory: colours (height, width, 3 or 4) of `COLOUR_TYPES`, depth (height, width) or None.

        Raises:
            BadInputError: see `stored_picture.check_arrays`.
        """
        check_arrays(colour, depth, stored, camera.size_px, stored_colour)
        with self._context.drawing():
            return self._take(camera, self._uploaded(colour, depth), stored, rows, stored_colour, wider)

    def _uploaded(self, colour: NDArray[Any], depth: NDArray[np.float32] | None) -> list[Source]:
        height, width, components = colour.shape
        kind = components, COLOUR_TYPES[str(colour.dtype)]
        formats = [kind] if depth is None else [kind, (1, "f4")]
        textures = self._targets.get(f"{formats} uploaded", (width, height), *formats).textures
        for texture, array in zip(textures, (colour, depth), strict=False):
            texture.write(np.ascontiguousarray(array), alignment=1)
        return list(map(_own, textures))

    def from_textures(
        self,
        camera: Pinhole,
        colour: Any,
        depth: Any,
        stored: StoredDepth,
        rows: Rows = Rows.BOTTOM_FIRST,
        stored_colour: StoredColour = CODES,
        wider: GpuImage | None = None,
    ) -> GpuImage:
        """Import a picture in textures of the image's context; see `is_texture`. The depth may be None.

        Plain textures and layers of arrays are read directly; others are copied first, see `given_pictures`. The
        depth may have a depth format, or be the first component of a colour format.

        Raises:
            BadInputError: a texture of another context or size, or of a format that cannot be read or copied; a missing
                layer or level; metres in a depth format.
        """
        with self._context.drawing():
            given = self._textures(camera.size_px, colour, depth, stored)
            return self._take(camera, given, stored, rows, stored_colour, wider)

    def _textures(self, size: tuple[int, int] | None, colour: Any, depth: Any, stored: StoredDepth) -> list[Source]:
        named = [("colour", colour)] + ([] if depth is None else [("depth", depth)])
        for name, each in named:
            texture = each.texture if isinstance(each, TextureLayer) else each
            if not is_number(texture):
                _check_context(self._context, f"{name} texture", texture)
        return self._given.of_textures([each for _, each in named], size, stored)

    def colour_alone(self, picture: Any, stored_colour: StoredColour, rows: Rows | None = None) -> gl.Texture:
        """Import a picture without depth and camera as a texture of its colours, in a format of `GpuImage.colour`.

        Args:
            picture: an array (height, width, 3 or 4), or a texture of any kind that `from_textures` takes.
            stored_colour: encoding of the colours.
            rows: row that comes first; as usual for that kind if None.

        Raises:
            BadInputError: see `stored_picture.check_colour_array` and `from_textures`.
        """
        with self._context.drawing():
            if isinstance(picture, np.ndarray):
                check_colour_array(picture, stored_colour)
                given, usual = self._uploaded(picture, None), Rows.TOP_FIRST
            else:
                given, usual = self._textures(None, picture, None, METRES), Rows.BOTTOM_FIRST
            return self._drawn(given, METRES, rows or usual, stored_colour)[0]

    def from_framebuffer(
        self,
        camera: Pinhole,
        framebuffer: gl.Framebuffer | int,
        stored: StoredDepth,
        rows: Rows = Rows.BOTTOM_FIRST,
        stored_colour: StoredColour = CODES,
        wider: GpuImage | None = None,
    ) -> GpuImage:
        """Import a picture in a framebuffer object, ModernGL's or by its OpenGL number.

        Its textures are read like those in `from_textures`. With several samples per pixel, colours are averaged;
        OpenGL takes the depth of one sample, usually sample 0, which lies up to half a pixel from the centre.

        Raises:
            BadInputError: a framebuffer of another context or size, a colour or depth that is missing or cannot be
                copied; metres in a depth format.
        """
        if not is_number(framebuffer):
            _check_context(self._context, "framebuffer", framebuffer)
        with self._context.drawing():
            given = self._given.of_framebuffer(framebuffer, camera.size_px, stored)
            return self._take(camera, given, stored, rows, stored_colour, wider)

    def inset_program(self) -> gl.VertexArray:
        """Return the drawing of insets, compiled on first use."""
        return self._drawing(False, False, False, is_inset=True)

    def _drawing(
        self, decodes: bool, colour_in_array: bool, depth_in_array: bool, is_inset: bool = False
    ) -> gl.VertexArray:
        key = decodes, colour_in_array, depth_in_array, is_inset
        if key not in self._drawings:
            names = "DECODE", "COLOUR_LAYERS", "DEPTH_LAYERS", "INSET"
            constants = dict(zip(names, map(int, key), strict=True))
            self._drawings[key] = self._context.full_screen("import_picture.frag", **constants)
        return self._drawings[key]

    def _take(
        self,
        camera: Pinhole,
        given: Sequence[Source],
        stored: StoredDepth,
        rows: Rows,
        stored_colour: StoredColour,
        wider: GpuImage | None,
    ) -> GpuImage:
        colours, depths = self._drawn(given, stored, rows, stored_colour, None if wider is None else (camera, wider))
        encoding: Encoding = "srgb" if gl.is_srgb(colours) else "linear"
        return GpuImage(self._context, camera, colours, depths, encoding=encoding, has_alpha=stored_colour.alpha)

    def _drawn(
        self,
        given: Sequence[Source],
        stored: StoredDepth,
        rows: Rows,
        stored_colour: StoredColour,
        inset: tuple[Pinhole, GpuImage] | None = None,
    ) -> Sequence[gl.Texture]:
        """Convert textures to colour, and to inverse depth if they or a wider picture have a depth.

        A caller's textures may have any filter, so they are read with a sampler of ours.
        """
        colour, depth = given[0], given[-1]
        has_depth = len(given) > 1
        codes = stored_colour.encoding == "srgb"
        if codes and not self._context.reads_srgb_codes and colour.is_srgb:
            codes = False  # OpenGL has decoded them
        # The codes of an inset are decoded, to be mixed with the wider picture's light.
        in_bytes = codes and stored_colour.bits == 8 and colour.is_8_bit and inset is None
        formats = [(4, "srgb" if in_bytes else "f2"), (1, "f4")][: 2 if has_depth or inset is not None else 1]
        target = self._targets.get(f"picture {formats}", colour.size_px, *formats)
        self._context.draw_to(target.framebuffer)
        decodes = codes and not in_bytes
        in_arrays = colour.layer is not None, depth.layer is not None
        drawing = self._drawing(decodes and inset is None, *in_arrays, inset is not None)
        program = drawing.program
        textures = {"stored_colour": colour.texture, "stored_depth": depth.texture}
        if inset is not None:
            camera, wider = inset
            gl.read_between_texels(wider.colour)
            textures |= {"wider": wider.colour, "wider_inverse_depth": wider.inverse_depth}
            gl.set_uniforms(
                program,
                wider_from_inset=pixels_from(camera, wider.camera),
                border_px=BORDER * min(camera.width_px, camera.height_px),
                shares_depth=not has_depth,
                decodes=decodes,
            )
        gl.bind_textures(program, **textures)
        gl.set_uniforms(
            program, bottom_first=rows is Rows.BOTTOM_FIRST, **_storage(colour, depth, stored, stored_colour)
        )
        units = range(len(given) if any(each.is_callers or each.is_srgb for each in given) else 0)
        for unit in units:
            self._samplers[stored_colour.encoding].use(unit)
        drawing.render(vertices=3)
        for unit in units:
            self._samplers[stored_colour.encoding].clear(unit)
        return target.textures


def _own(texture: gl.Texture) -> Source:
    return Source(texture, texture.size, is_8_bit=texture.dtype in ("f1", "nu1"), is_srgb=gl.is_srgb(texture))


def _storage(colour: Source, depth: Source, stored: StoredDepth, stored_colour: StoredColour) -> dict[str, Any]:
    """Return uniforms: where and how the colours and the depth are stored."""
    # The scale of codes with fewer bits in a uint16 texture, in which 65535 is read as 1.
    is_uint16 = isinstance(colour.texture, gl.Texture) and colour.texture.dtype == "nu2"
    of_largest = 65535 / ((1 << stored_colour.bits) - 1) if is_uint16 else 1.0
    return {
        "size_px": colour.size_px,
        "firsts_px": (*colour.first_px, *depth.first_px),
        "layers": (float(colour.layer or 0), float(depth.layer or 0)),
        "scale": (*[of_largest] * 3, of_largest if stored_colour.alpha else 0.0),
        "opaque": 0.0 if stored_colour.alpha else 1.0,
        "in_metres": stored.kind is DepthKind.METRES,
        "inverse_depth_of_0_and_1": stored.inverse_of_0_and_1,
        "limits": stored.limits,
        "nothing": stored.nothing,
    }


def is_texture(value: Any) -> bool:
    """Return whether a value may be a texture: a ModernGL texture or array, an OpenGL name, or a `TextureLayer`."""
    return is_number(value) or isinstance(value, TextureLayer | gl.Texture | gl.TextureArray)


def _check_context(context: gl.GlContext, name: str, thing: Any) -> None:
    if gl.is_released(thing):
        raise BadInputError(f"The {name} has been released: submit a picture before you release it.")
    if not context.has(thing):
        raise BadInputError(
            f"The {name} belongs to another ModernGL context: adopt that one, or hand the picture over as arrays."
        )

"""Framebuffers and textures of other software as targets of composed frames."""

import ctypes
from collections.abc import Collection, Mapping, Sequence
from typing import Any

from wlr_render.errors import BadInputError
from wlr_render.gl import gl
from wlr_render.gl.framebuffers import (
    BLIT_COLOUR,
    COLOUR,
    DRAW,
    READ,
    WHOLE_NUMBERS,
    FramebufferQueries,
    Image,
    TextureLayer,
    fresh_framebuffer,
    is_number,
)
from wlr_render.gl.image_cache import ImageCache
from wlr_render.warp.gl_warp import WarpTarget

_UINT, _INT = ctypes.c_uint, ctypes.c_int
_FRACTIONS = "does not hold red, green and blue as fractions; give it an RGBA8 texture."


class TargetFramebuffers:
    """The caller's framebuffers and textures as targets, for use in drawing blocks."""

    def __init__(self, context: gl.GlContext, window_kind: str) -> None:
        """Prepare; a window's picture is drawn to a texture in a format of `GlContext.target`."""
        self._context, self._ask, self._window_kind = context, FramebufferQueries(context), window_kind
        self._targets: ImageCache[gl.Framebuffer] = ImageCache(self._ask)
        self._made = gl.RenderTargets(context)
        self._for_window: gl.RenderTarget | None = None

    def targets(self, into: Any, eyes: Sequence[str], size_px: tuple[int, int]) -> dict[str, WarpTarget]:
        """Return the target of each eye's picture, upright as OpenGL shows it; see `Compositor.compose`.

        Raises:
            BadInputError: an eye has no target, or a target is not a framebuffer or texture of this context, or has
                another size or kind.
        """
        if isinstance(into, Mapping):
            missing = set(eyes) - set(into)
            if missing:
                raise BadInputError(
                    f"there is no framebuffer for the {sorted(missing)[0]} eye; give one for every eye."
                )
            if len({_identity(into[eye]) for eye in eyes}) < len(eyes):
                raise BadInputError(
                    "both eyes are given the same framebuffer; give each its own, or one of twice the width."
                )
            return {
                eye: WarpTarget(self._of_size(into[eye], size_px), _first_px(into[eye]), size_px, False) for eye in eyes
            }
        width, height = size_px
        framebuffer, (x, y) = self._of_size(into, (width * len(eyes), height)), _first_px(into)
        return {eye: WarpTarget(framebuffer, (x + k * width, y), size_px, False) for k, eye in enumerate(eyes)}

    def _of_size(self, into: Any, size_px: tuple[int, int]) -> gl.Framebuffer:
        """Return a framebuffer of ours with the first colour image of a target; for number 0, one to be shown later."""
        given = into
        into = TextureLayer(into) if isinstance(into, gl.Texture | gl.TextureArray) else into
        owner = into.texture if isinstance(into, TextureLayer) else into
        if not is_number(owner) and not isinstance(owner, gl.Framebuffer | gl.Texture | gl.TextureArray):
            raise BadInputError(
                f"a {type(into).__name__} is not a framebuffer; give ModernGL's, its OpenGL number, a texture or a "
                "TextureLayer."
            )
        if not is_number(owner) and not gl.is_released(owner) and not self._context.has(owner):
            raise BadInputError(
                "the framebuffer belongs to another OpenGL context than the compositor works in; make it in that one."
            )
        if isinstance(into, TextureLayer):
            layer = into
            key = "texture", layer.layer, layer.level, layer.rect_px, size_px
            return self._targets.get([given], key, lambda old: self._of_texture(layer, size_px, old))
        number = int(owner if is_number(owner) else owner.glo)
        if not number:
            return self._window(size_px)
        return self._targets.get(
            [owner],
            ("framebuffer", size_px),
            lambda old: self._of_framebuffer(owner, size_px, old),
        )

    def _window(self, size_px: tuple[int, int]) -> gl.Framebuffer:
        # The window toolkit determines the size of a window's picture: OpenGL has no query for it.
        if self._context.host_is_clean:
            with self._context.drawing() as ctx:
                window: Any = ctx.screen
                screen: gl.Framebuffer = window
            return screen
        if not self._context.has_host:
            raise BadInputError("the compositor's own OpenGL context has no window; give a framebuffer object of it.")
        with self._context.host():
            self._ask.bind(0)
            if not self._ask.is_complete():
                raise BadInputError(
                    "the OpenGL context has no window; give a framebuffer object with an RGBA8 texture."
                )
        self._for_window = self._made.get("window", size_px, (4, self._window_kind))
        return self._for_window.framebuffer

    def show(self, targets: Collection[WarpTarget]) -> None:
        """Copy the picture for the window to the window, in the window's context: framebuffers are not shared."""
        drawn = self._for_window
        if drawn is None or all(each.framebuffer is not drawn.framebuffer for each in targets):
            return
        texture, ask = drawn.textures[0], self._ask
        with self._context.host(), ask.made() as source:
            ask.bind(source, READ)
            ask.gl("glFramebufferTexture", *[_UINT] * 3, _INT)(READ, COLOUR, texture.glo, 0)
            ask.bind(0, DRAW)
            ask.copy((0, 0), texture.size, BLIT_COLOUR)

    def _of_framebuffer(self, owner: Any, size_px: tuple[int, int], old: gl.Framebuffer | None) -> gl.Framebuffer:
        (image,) = self._ask.images_of(owner, [COLOUR])
        if image is None:
            raise BadInputError(f"the framebuffer's first attachment {_FRACTIONS}")
        self._context.take_error()
        return self._with_image(image, "framebuffer", self._ask.size(image), size_px, old)

    def _of_texture(self, layer: TextureLayer, size_px: tuple[int, int], old: gl.Framebuffer | None) -> gl.Framebuffer:
        image, size, _ = self._ask.part_of(layer)
        return self._with_image(image, f"texture {image.name}", size, size_px, old)

    def _with_image(
        self, image: Image, what: str, size: tuple[int, int], size_px: tuple[int, int], old: gl.Framebuffer | None
    ) -> gl.Framebuffer:
        if size != size_px:
            found, needed = (" x ".join(map(str, pixels)) for pixels in (size, size_px))
            raise BadInputError(
                f"the {what} has {found} pixels, and {needed} are needed; give one of that size, or make the "
                "compositor for yours."
            )
        framebuffer = old or fresh_framebuffer(self._context)
        self._ask.bind(framebuffer.glo)
        complete = self._ask.attach(COLOUR, image)
        colour = self._ask.format(COLOUR) if complete else None
        if colour is None or not colour.blue_bits or colour.numbers in WHOLE_NUMBERS:
            raise BadInputError(f"the {what}'s first attachment {_FRACTIONS}")
        return framebuffer


def _first_px(into: Any) -> tuple[int, int]:
    rect_px = into.rect_px if isinstance(into, TextureLayer) else None
    return (rect_px[0], rect_px[1]) if rect_px else (0, 0)


def _identity(into: Any) -> object:
    if isinstance(into, TextureLayer):
        return into.name, into.layer, into.level, into.rect_px
    return into if is_number(into) else getattr(into, "glo", id(into))

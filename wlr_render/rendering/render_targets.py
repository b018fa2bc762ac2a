"""Framebuffers of our own with their textures, by name and size."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from wlr_render.rendering.gl_context import Framebuffer, GlContext, Texture


@dataclass(frozen=True, eq=False)
class RenderTarget:
    """A framebuffer and its textures, in the order of the shader's outputs."""

    framebuffer: "Framebuffer"
    textures: "tuple[Texture, ...]"


class RenderTargets:
    """Targets by name; a target is made once for each size, and the next drawing overwrites it."""

    def __init__(self, context: "GlContext") -> None:
        self._context = context
        self._targets: dict[str, RenderTarget] = {}

    def get(
        self, name: str, size: tuple[int, int], *formats: tuple[int, str], with_depth: bool = False
    ) -> RenderTarget:
        """The target of a name and size (width, height).

        Args:
            name: of the target, which keeps its formats.
            size: (width, height) in pixels.
            formats: components and dtype of each texture, as in `GlContext.target`.
            with_depth: attach a depth texture.
        """
        target = self._targets.get(name)
        if target is None or target.framebuffer.size != size:
            textures = [self._context.target(size, *each) for each in formats]
            depth = self._context.depth_target(size) if with_depth else None
            target = self._targets[name] = RenderTarget(self._context.framebuffer(textures, depth), tuple(textures))
        return target

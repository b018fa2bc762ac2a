"""Cache of objects that were made for other software's textures and framebuffers."""

import weakref
from collections import OrderedDict
from collections.abc import Callable
from typing import Any, Generic, TypeVar

from wlr_render.errors import BadInputError
from wlr_render.gl import gl
from wlr_render.gl.framebuffers import FramebufferQueries, TextureLayer, is_number

_CACHED = 16
"""Number of sources or targets that are kept: four swap chains of four images."""

_Made = TypeVar("_Made")


class ImageCache(Generic[_Made]):
    """Cache of objects made for the caller's last few textures and framebuffers.

    A ModernGL object keeps its images while it lives, and so does a `TextureLayer`. A number alone does not: another
    object may have it in the next frame, so OpenGL is queried again each time. Our framebuffers would keep the images
    of deleted textures alive, and drawing to them would fail silently: entries of dead objects are never returned.
    """

    def __init__(self, ask: FramebufferQueries) -> None:
        """Prepare; `ask` queries OpenGL for the textures that exist."""
        self._ask = ask
        self._made: OrderedDict[tuple[object, ...], tuple[list[Any], _Made]] = OrderedDict()

    def get(self, objects: list[Any], key: tuple[object, ...], make: Callable[[_Made | None], _Made]) -> _Made:
        """Return the result of `make` for the same objects and key.

        Args:
            objects: ModernGL objects, layers, or numbers.
            key: further values that distinguish results.
            make: called with its previous result for the same numbers, which it may reuse; its exceptions are not
                caught.

        Raises:
            BadInputError: a ModernGL object has been released, or an image of a framebuffer.
        """
        _check_alive(objects)
        owners = [_owner(each) for each in objects]
        full_key = (*map(_number, objects), *key)
        before, found = self._made.get(full_key, ([], None))
        if found is not None and all(
            old is not None and new is not None and old() is new and self._exists(each)
            for old, new, each in zip(before, owners, objects, strict=True)
        ):
            self._made.move_to_end(full_key)
            return found
        made = make(found)
        gone = [key for key, (kept, _) in self._made.items() if any(each and each() is None for each in kept)]
        for other in gone:  # our framebuffers would hold the memory of released textures
            del self._made[other]
        self._made[full_key] = [None if each is None else weakref.ref(each) for each in owners], made
        if len(self._made) > _CACHED:
            self._made.popitem(last=False)
        return made

    def clear(self) -> None:
        """Remove all entries."""
        self._made.clear()

    def _exists(self, given: Any) -> bool:
        is_name = isinstance(given, TextureLayer) and is_number(given.texture)
        return not is_name or self._ask.is_texture(given.name)


def _check_alive(objects: list[Any]) -> None:
    for given in objects:
        thing = given.texture if isinstance(given, TextureLayer) else given
        if is_number(thing):
            continue
        images = [*(thing.color_attachments or ()), thing.depth_attachment] if isinstance(thing, gl.Framebuffer) else []
        if any(gl.is_released(each) for each in (thing, *filter(None, images))):
            kind = "framebuffer" if isinstance(thing, gl.Framebuffer) else "texture"
            raise BadInputError(f"the {kind} has been released, or an image of it; give one that is alive.")


def _owner(given: Any) -> Any:
    """Return the object that lives as long as the given images; None if OpenGL must be queried for the images."""
    if isinstance(given, TextureLayer) and not is_number(given.texture):
        return given.texture
    is_asked = is_number(given) or (isinstance(given, gl.Framebuffer) and given.color_attachments is None)
    return None if is_asked else given


def _number(given: Any) -> int:
    return int(given if is_number(given) else given.name if isinstance(given, TextureLayer) else given.glo)

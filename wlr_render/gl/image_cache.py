"""Cache of what was made for other software's textures and framebuffers."""

import weakref
from collections import OrderedDict
from collections.abc import Callable
from typing import Any, Generic, TypeVar

from wlr_render.gl.framebuffers import TextureLayer, is_number

_CACHED = 16
"""Sources or targets that are remembered: four swap chains of four images."""

_Made = TypeVar("_Made")


class ImageCache(Generic[_Made]):
    """Cache of objects that were made for the caller's last few textures and framebuffers.

    A ModernGL object keeps its images while it lives, and so does a `TextureLayer`. A number alone does not: another
    object may have it in the next frame, so that OpenGL is asked again for each.
    """

    def __init__(self) -> None:
        self._made: OrderedDict[tuple[object, ...], tuple[list[Any], _Made]] = OrderedDict()

    def get(self, objects: list[Any], key: tuple[object, ...], make: Callable[[_Made | None], _Made]) -> _Made:
        """Return the result of `make` for the same objects and key.

        Args:
            objects: ModernGL objects, layers, or numbers.
            key: further numbers that matter.
            make: called with its previous result for the same numbers, which it may reuse; its exceptions are not
                caught.
        """
        owners = [_owner(each) for each in objects]
        full_key = (*map(_number, objects), *key)
        before, found = self._made.get(full_key, ([], None))
        if found is not None and all(
            old is not None and new is not None and old() is new for old, new in zip(before, owners, strict=True)
        ):
            self._made.move_to_end(full_key)
            return found
        made = make(found)
        gone = [key for key, (kept, _) in self._made.items() if any(each and each() is None for each in kept)]
        for other in gone:  # our framebuffers would keep the memory of released textures
            del self._made[other]
        self._made[full_key] = [None if each is None else weakref.ref(each) for each in owners], made
        if len(self._made) > _CACHED:
            self._made.popitem(last=False)
        return made

    def clear(self) -> None:
        """Forget everything."""
        self._made.clear()


def _owner(given: Any) -> Any:
    """Return the object whose life is that of the given images; None for a number."""
    if isinstance(given, TextureLayer) and not is_number(given.texture):
        return given.texture
    return None if is_number(given) else given


def _number(given: Any) -> int:
    return int(given if is_number(given) else given.name if isinstance(given, TextureLayer) else given.glo)

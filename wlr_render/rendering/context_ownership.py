"""Ownership of an OpenGL context, our own or an adopted one: state handling around draws, and cleanup."""

import contextlib
import threading
from collections.abc import Callable, Iterator
from typing import Any, Protocol

from wlr_render.errors import BadInputError
from wlr_render.rendering.gl_state import GlState
from wlr_render.rendering.native_contexts import CurrentContext


class ContextOwner(Protocol):
    """Owner of an OpenGL context."""

    def entered(self, third_party: bool) -> contextlib.AbstractContextManager[None]:
        """Return a block in which the context is current; `third_party` as in `GlState.kept`."""

    def release(self, objects: list[Any]) -> None:
        """Destroy the given ModernGL objects and those that Python has dropped."""


class OwnContext:
    """A context that this library opened: each outermost block makes it current, and restores the previous one.

    Between blocks it is current on no thread, so any thread may use it, one at a time.
    """

    def __init__(self, ctx: Any, current: CurrentContext, save: Callable[[], Callable[[], None]]) -> None:
        """Wrap an opened context; `save` saves the context that is current, and returns the function to restore it."""
        self._ctx, self._current, self._save = ctx, current, save
        self._make_current: Callable[[], object] = ctx.__enter__
        self._in_use = threading.RLock()

    @contextlib.contextmanager
    def entered(self, third_party: bool) -> Iterator[None]:
        """See `ContextOwner`; makes the context current, and the previous one when the block ends.

        Raises:
            BadInputError: another thread is inside a block, or the context cannot be made current.
        """
        if not self._in_use.acquire(blocking=False):
            raise BadInputError(
                "Another thread is drawing in this OpenGL context: use a compositor or renderer from one thread at a "
                "time."
            )
        with contextlib.ExitStack() as at_end:
            at_end.callback(self._in_use.release)
            if not self._current.is_current():
                at_end.callback(self._save())
                self._make_current()
                if not self._current.is_current():
                    raise BadInputError(
                        "This library's OpenGL context cannot be made current on this thread: release the context that "
                        "is current there, or adopt it (context='current')."
                    )
            yield

    def release(self, objects: list[Any]) -> None:
        """See `ContextOwner`; destroys the context with all its objects, and leaves any other current."""
        restore = self._save()
        self._ctx.release()
        restore()


class AdoptedContext:
    """A context of another program: each block leaves its state unchanged, and it is never destroyed here."""

    def __init__(self, current: CurrentContext, state: GlState, ctx: Any) -> None:
        self._current, self._state, self._ctx = current, state, ctx

    @contextlib.contextmanager
    def entered(self, third_party: bool) -> Iterator[None]:
        """See `ContextOwner`.

        Raises:
            BadInputError: it is not current.
        """
        if not self._current.is_current():
            raise BadInputError(
                "The adopted OpenGL context is not current on this thread: make it current before drawing."
            )
        outermost = not self._state.inside
        with self._state.kept(third_party):
            if outermost:
                self._ctx.screen.use()  # what ModernGL takes to be bound from now on
            yield

    def release(self, objects: list[Any]) -> None:
        """See `ContextOwner`; the context stays."""
        # In a context that is gone its objects are, too.
        if self._current.is_current():
            with self._state.kept():
                self._ctx.gc()
                for one in objects:
                    one.release()
        # Objects that Python drops from now on are gone already.
        self._ctx.gc_mode = None

"""Whose an OpenGL context is: what holds around each block of drawing, and what becomes of our objects in the end."""

import contextlib
from collections.abc import Callable, Iterator
from typing import Any, Protocol

from wlr_render.errors import BadInputError
from wlr_render.rendering.current_context import CurrentContext
from wlr_render.rendering.gl_state import GlState


class Host(Protocol):
    """Whose the context is."""

    def entered(self, by_others: bool) -> contextlib.AbstractContextManager[None]:
        """A block in which the context is current; `by_others` as in `GlState.kept`."""

    def release(self, objects: list[Any]) -> None:
        """Destroy our objects, those of ModernGL's that are given and those that Python has dropped."""


class Own:
    """A context that this library opened: made current by each block, and destroyed with all that is in it."""

    def __init__(self, ctx: Any) -> None:
        self._ctx = ctx
        self._make_current: Callable[[], object] = ctx.__enter__

    @contextlib.contextmanager
    def entered(self, by_others: bool) -> Iterator[None]:
        """See `Host`; makes it current."""
        self._make_current()
        yield

    def release(self, objects: list[Any]) -> None:
        """See `Host`; the context goes with them."""
        self._ctx.release()


class Foreign:
    """A context of somebody else's program: its state outlives each block, and it outlives us."""

    def __init__(self, current: CurrentContext, state: GlState, ctx: Any) -> None:
        self._current, self._state, self._ctx = current, state, ctx

    @contextlib.contextmanager
    def entered(self, by_others: bool) -> Iterator[None]:
        """See `Host`.

        Raises:
            BadInputError: it is not current.
        """
        if not self._current.is_current():
            raise BadInputError(
                "The adopted OpenGL context is not current on this thread: make it current before drawing."
            )
        outermost = not self._state.inside
        with self._state.kept(by_others):
            if outermost:
                self._ctx.screen.use()  # what ModernGL takes to be bound from now on
            yield

    def release(self, objects: list[Any]) -> None:
        """See `Host`; the context stays."""
        # In a context that is gone its objects are, too.
        if self._current.is_current():
            with self._state.kept():
                self._ctx.gc()
                for one in objects:
                    one.release()
        # Objects that Python drops from now on are gone already.
        self._ctx.gc_mode = None

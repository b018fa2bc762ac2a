"""Ownership of an OpenGL context, our own or an adopted one: state handling around draws, and cleanup."""

import contextlib
import ctypes
import threading
import warnings
from collections.abc import Callable, Iterator
from typing import Any, Protocol
from weakref import WeakKeyDictionary

from wlr_render.errors import BadInputError, stacklevel_of_caller
from wlr_render.gl.gl_state import GlState
from wlr_render.gl.native_contexts import CurrentContext, EglBinding


class ContextOwner(Protocol):
    """Owner of an OpenGL context."""

    def entered(self, third_party: bool) -> contextlib.AbstractContextManager[None]:
        """Return a block in which the context is current; `third_party` as in `GlState.kept`."""

    def odd_values(self) -> list[str]:
        """Return the OpenGL calls of the host that have set values other than OpenGL's defaults."""

    def is_same_as(self, context: Any) -> bool:
        """Return whether another ModernGL context wraps the same native context."""

    def release(self, objects: list[Any]) -> bool:
        """Destroy the given ModernGL objects and all garbage-collected ones; return whether that was possible."""


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
        """Make the context current, and the previous one when the block ends; see `ContextOwner`.

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

    def odd_values(self) -> list[str]:
        """Return an empty list: no host shares this context."""
        return []

    def is_same_as(self, context: Any) -> bool:
        """Return False: nothing else wraps this context."""
        return False

    def release(self, objects: list[Any]) -> bool:
        """Destroy the context with all its objects; the context that was current stays current."""
        restore = self._save()
        self._ctx.release()
        restore()
        return True


class AdoptedContext:
    """A context of another program: each block leaves its state unchanged, and it is never destroyed here."""

    def __init__(self, current: CurrentContext, state: GlState, ctx: Any, host_is_clean: bool) -> None:
        """Wrap an adopted context; with a clean host only blocks of third parties save and restore its state."""
        self._current, self._state, self._ctx, self._host_is_clean = current, state, ctx, host_is_clean
        self._inside = False
        self._same: WeakKeyDictionary[Any, bool] = WeakKeyDictionary()
        self._set_depth_mask = current.function("glDepthMask", ctypes.c_ubyte)

    @contextlib.contextmanager
    def entered(self, third_party: bool) -> Iterator[None]:
        """Check that the context is current, and keep the host's state where necessary; see `ContextOwner`.

        Raises:
            BadInputError: the context is not current, or as `GlState.kept`.
        """
        self._check_current()
        if self._host_is_clean and not third_party:
            outermost, self._inside = not self._inside, True
            try:
                yield
            finally:
                if outermost:
                    self._inside = False
                    self._set_depth_mask(1)  # ModernGL clears it for framebuffers without depth
            return
        outermost = not self._state.inside
        with self._state.kept(third_party):
            if outermost:
                self._ctx.screen.use()  # ModernGL then records the default framebuffer as bound
            yield

    def odd_values(self) -> list[str]:
        """Return the calls that `GlState` finds; see `ContextOwner`."""
        self._check_current()
        return self._state.odd_values()

    def is_same_as(self, context: Any) -> bool:
        """Return as `ContextOwner`, by making the other context current once; always False without EGL."""
        if self._current.platform != "egl":
            return False
        if context not in self._same:
            self._same[context] = EglBinding().makes_current(context.__enter__, self._current)
        return self._same[context]

    def _check_current(self) -> None:
        if not self._current.is_current():
            raise BadInputError(
                "The adopted OpenGL context is not current on this thread: make it current before drawing."
            )

    def release(self, objects: list[Any]) -> bool:
        """Destroy the objects and keep the context; if it is not current, warn and destroy nothing."""
        if not self._current.is_current():
            # No error: programs end with the context gone, and its objects with it, which nobody can ask about.
            warnings.warn(
                "The adopted OpenGL context is not current on this thread, so that nothing was released: make it "
                "current and call release() again, before the context is destroyed.",
                RuntimeWarning,
                stacklevel=stacklevel_of_caller(),
            )
            return False
        # In a context that is gone its objects are, too.
        if self._state.is_same_context():
            if self._host_is_clean:
                # A program that is in use would outlive its deletion, for another compositor to find and restore.
                self._current.function("glUseProgram", ctypes.c_uint)(0)
            # What a clean host has bound may be ours, and cannot be bound again after it is deleted.
            with contextlib.nullcontext() if self._host_is_clean else self._state.kept(checked=False):
                self._ctx.gc()
                for one in objects:
                    one.release()
                self._state.release()
        # Objects that Python drops from now on are gone already.
        self._ctx.gc_mode = None
        return True

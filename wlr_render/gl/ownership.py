"""Ownership of an OpenGL context: when it is current, synchronisation with a host's context, and cleanup."""

import contextlib
import ctypes
import threading
import warnings
from collections.abc import Callable, Collection, Iterator
from typing import Any, Protocol
from weakref import WeakKeyDictionary

from wlr_render.errors import BadInputError, stacklevel_of_caller
from wlr_render.gl.native_contexts import CurrentContext, EglBinding

_UINT, _INT, _POINTER = ctypes.c_uint, ctypes.c_int, ctypes.c_void_p
_READ, _DRAW = 0x8CA8, 0x8CA9  # GL_READ_FRAMEBUFFER, GL_DRAW_FRAMEBUFFER
_BINDINGS = {_READ: 0x8CAA, _DRAW: 0x8CA6}
_SWITCHES = 0x0C11, 0x8DB9  # GL_SCISSOR_TEST, GL_FRAMEBUFFER_SRGB, which affect blits
_COMMANDS_COMPLETE, _NO_TIMEOUT = 0x9117, 0xFFFFFFFFFFFFFFFF
_WAIT_S = 10.0
"""Longest time that a call waits for another thread's call."""


class ContextOwner(Protocol):
    """Owner of an OpenGL context.

    Attributes:
        has_host: whether another program's context shares textures with it.
    """

    has_host: bool

    def entered(self) -> contextlib.AbstractContextManager[None]:
        """Return a block in which the context is current."""

    def host(self) -> contextlib.AbstractContextManager[None]:
        """Return a block, within `entered`, in which the framebuffers of the context's host may be bound."""

    def is_same_as(self, context: Any) -> bool:
        """Return whether another ModernGL context wraps the host's native context."""

    def release(self, objects: Collection[Any]) -> bool:
        """Destroy the given and all garbage-collected ModernGL objects; return whether that was possible."""


class Host:
    """Another program's context, which shares textures with a context of ours."""

    def __init__(self, current: CurrentContext) -> None:
        """Wrap the context that is current."""
        self._current = current
        self.is_current = current.is_current
        self._get = current.function("glGetIntegerv", _UINT, _POINTER)
        self._bind = current.function("glBindFramebuffer", _UINT, _UINT)
        self._is_on = current.function("glIsEnabled", _UINT, result=ctypes.c_bool)
        self._turn = [current.function(f"gl{name}", _UINT) for name in ("Disable", "Enable")]
        self._same: WeakKeyDictionary[Any, bool] = WeakKeyDictionary()

    @contextlib.contextmanager
    def framebuffers_kept(self) -> Iterator[None]:
        """Turn off the capabilities that affect blits in a block; restore them and the framebuffers at its end."""
        number = _INT()
        bound = {}
        for target, enum in _BINDINGS.items():
            self._get(enum, ctypes.addressof(number))
            bound[target] = number.value
        switched = [enum for enum in _SWITCHES if self._is_on(enum)]
        for enum in switched:
            self._turn[0](enum)
        try:
            yield
        finally:
            for enum in switched:
                self._turn[1](enum)
            for target, name in bound.items():
                self._bind(target, name)

    def is_same_as(self, context: Any) -> bool:
        """Return the same as `ContextOwner`, by making the other context current once; always False without EGL."""
        if self._current.platform != "egl":
            return False
        # The context may be current on another thread, so a failed switch is not remembered.
        if context not in self._same and EglBinding().makes_current(context.__enter__, self._current):
            self._same[context] = True
        return context in self._same


class OwnContext:
    """A context that this library opened: each outermost block makes it current, and restores the previous one.

    Between blocks it is current on no thread, so any thread may use it, one at a time. A host's draws before a block
    are complete in the block, and the block's draws are complete for the host afterwards.
    """

    def __init__(
        self, ctx: Any, current: CurrentContext, save: Callable[[], Callable[[], None]], host: Host | None = None
    ) -> None:
        """Wrap an opened context; `save` saves the context that is current, and returns the function to restore it."""
        self._ctx, self._current, self._save, self._host = ctx, current, save, host
        self.has_host = host is not None
        self._make_current: Callable[[], object] = ctx.__enter__
        self._in_use = threading.RLock()
        self._restore: Callable[[], None] | None = None  # set if the host's context was current before the block
        self._fence = current.function("glFenceSync", _UINT, _UINT, result=_POINTER)
        self._wait = current.function("glWaitSync", _POINTER, _UINT, ctypes.c_uint64)
        self._drop = current.function("glDeleteSync", _POINTER)

    @contextlib.contextmanager
    def entered(self) -> Iterator[None]:
        """Make the context current, and the previous one when the block ends; see `ContextOwner`.

        Raises:
            BadInputError: another thread does not leave its block, or the context cannot be made current.
        """
        with self._waited_for():
            if self._current.is_current():
                yield
                return
            is_host = self._host is not None and self._host.is_current()
            restore, before = self._save(), self._restore
            try:
                self._after_all_before(self._make_current, is_host)
                if not self._current.is_current():
                    raise BadInputError(
                        "This library's OpenGL context cannot be made current on this thread: release the context that "
                        "is current there, or adopt it (context='current')."
                    )
                self._restore = restore if is_host else None
                yield
            finally:
                self._restore = before
                self._after_all_before(restore, is_host and self._current.is_current())

    @contextlib.contextmanager
    def _waited_for(self) -> Iterator[None]:
        if not self._in_use.acquire(timeout=_WAIT_S):
            raise BadInputError(
                f"Another thread has drawn in this OpenGL context for {_WAIT_S:g} s: end its call, or its block of "
                "`context.drawing()`."
            )
        try:
            yield
        finally:
            self._in_use.release()

    def _after_all_before(self, switch: Callable[[], object], is_shared: bool) -> None:
        """Switch to another context; if the two share, its commands run after the commands of this context."""
        fence = self._fence(_COMMANDS_COMPLETE, 0) if is_shared else None
        switch()
        if fence:
            self._wait(fence, 0, _NO_TIMEOUT)
            self._drop(fence)

    @contextlib.contextmanager
    def host(self) -> Iterator[None]:
        """Make the host's context current; see `ContextOwner`. Without a host this context stays current.

        Raises:
            BadInputError: the host's context was not current on this thread before the block.
        """
        if self._host is None:
            yield
            return
        if self._restore is None:
            raise BadInputError(
                "The adopted OpenGL context is not current on this thread, and framebuffers belong to it alone: make "
                "it current, or give textures, whose drawing has ended (glFinish) if another thread drew them."
            )
        self._after_all_before(self._restore, True)
        try:
            with self._host.framebuffers_kept():
                yield
        finally:
            self._after_all_before(self._make_current, True)

    def is_same_as(self, context: Any) -> bool:
        """Return the same as `ContextOwner`; False without a host."""
        return self._host is not None and self._host.is_same_as(context)

    def release(self, objects: Collection[Any]) -> bool:
        """Destroy the context with all its objects; the context that was current stays current."""
        with self._waited_for():
            restore = self._save()
            if self._host is not None:  # shared textures would outlive this context
                self._make_current()
            if self._host is not None and self._current.is_current():
                free_dropped(self._ctx)
                for one in list(objects):
                    one.release()
            self._ctx.gc_mode = None  # objects that Python collects from now on no longer exist
            self._ctx.release()
            restore()
        return True


class HostContext:
    """Another program's context in which we draw, because the driver cannot share or the host requests it.

    The host guarantees OpenGL's default state before each block, and relies on no binding after it.
    """

    has_host = False

    def __init__(self, ctx: Any, current: CurrentContext) -> None:
        """Wrap an adopted context."""
        self._ctx, self._current, self._host = ctx, current, Host(current)
        self._depth = 0
        self._set_depth_mask = current.function("glDepthMask", ctypes.c_ubyte)

    @contextlib.contextmanager
    def entered(self) -> Iterator[None]:
        """Check that the context is current; see `ContextOwner`.

        Raises:
            BadInputError: the context is not current.
        """
        if not self._current.is_current():
            raise BadInputError(
                "The adopted OpenGL context is not current on this thread: make it current before drawing."
            )
        self._depth += 1
        try:
            yield
        finally:
            self._depth -= 1
            if not self._depth:
                self._set_depth_mask(1)  # ModernGL turns the mask off for framebuffers without depth

    def host(self) -> contextlib.AbstractContextManager[None]:
        """Return an empty block, see `ContextOwner`."""
        return contextlib.nullcontext()

    def is_same_as(self, context: Any) -> bool:
        """Return the same as `ContextOwner`."""
        return self._host.is_same_as(context)

    def release(self, objects: Collection[Any]) -> bool:
        """Destroy the objects and keep the context; if it is not current, warn and destroy nothing."""
        if not self._current.is_current():
            # Only a warning: at a program's end the context may be destroyed with its objects, which cannot be queried.
            warnings.warn(
                "The adopted OpenGL context is not current on this thread, so that nothing was released: make it "
                "current and call release() again, before the context is destroyed.",
                RuntimeWarning,
                stacklevel=stacklevel_of_caller(),
            )
            return False
        self._current.function("glUseProgram", _UINT)(0)  # a program in use is not deleted
        free_dropped(self._ctx)
        for one in list(objects):
            one.release()
        self._ctx.gc_mode = None  # objects that Python collects from now on no longer exist
        return True


def free_dropped(ctx: Any) -> None:
    """Release dropped objects like `Context.gc`, but skip objects that were already released."""
    while ctx.objects:
        dropped = ctx.objects.popleft()
        if hasattr(dropped, "release"):
            dropped.release()

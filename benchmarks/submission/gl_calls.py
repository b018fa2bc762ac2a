"""Counts of OpenGL calls, made through ctypes or ModernGL, and a way to make drawing calls do nothing.

OpenGL functions are loaded by address. Instead of a function's address, the loader gets the address of a few bytes of
machine code that count the call and then jump to the function, or, while drawing is switched off, to a return.
"""

import contextlib
import ctypes
import mmap
import platform
import re
from collections.abc import Callable, Iterator
from typing import Any

import glcontext
import moderngl

from wlr_render.errors import BadInputError
from wlr_render.gl import gl
from wlr_render.gl.native_contexts import CurrentContext, NativeContext

_SIZE = 1 << 20
_FUNCTION_BYTES = 64
# mov r11, counter; inc [r11]; mov r11, slot; jmp [r11]: r11 carries no argument and need not be preserved.
_COUNT, _LOAD, _JUMP = b"\x49\xbb", b"\x49\xff\x03\x49\xbb", b"\x41\xff\x23"
_NOTHING = b"\x31\xc0\xc3"  # xor eax, eax; ret
_IS_GET = re.compile(r"gl(Get|Is|Check)[A-Z]")
_IS_DRAWING = re.compile(
    r"gl(MultiDraw|Draw(Arrays|Elements|Range)|BlitFramebuffer|Clear$|ClearBuffer|DispatchCompute)"
)


def is_get(name: str) -> bool:
    """Return whether a function only reads state; threaded drivers must wait for such calls."""
    return bool(_IS_GET.match(name))


class GlCalls:
    """Counter of the calls of OpenGL functions that are looked up inside `counted`.

    Raises:
        BadInputError: the processor is not an x86-64.
    """

    def __init__(self) -> None:
        if platform.machine().lower() not in ("x86_64", "amd64"):
            raise BadInputError(
                f"OpenGL calls are counted by machine code for x86-64, and this processor is a {platform.machine()}."
            )
        self._memory = mmap.mmap(-1, _SIZE, prot=mmap.PROT_READ | mmap.PROT_WRITE | mmap.PROT_EXEC)
        self._address = ctypes.addressof(ctypes.c_char.from_buffer(self._memory))
        self._memory[: len(_NOTHING)] = _NOTHING
        self._end = _FUNCTION_BYTES
        # For each name and address with counting code: the counter, the slot with the jump's target, and the function.
        self._functions: dict[str, list[tuple[ctypes.c_uint64, ctypes.c_uint64, int]]] = {}
        self._codes: dict[tuple[str, int], int] = {}

    def address(self, name: str, function: int) -> int:
        """Return the address of code that counts a call of a function and then runs the function; 0 for 0."""
        if not function:
            return 0
        if (name, function) not in self._codes:
            start, self._end = self._end, self._end + _FUNCTION_BYTES
            counter, slot = (ctypes.c_uint64.from_address(self._address + start + k) for k in (40, 48))
            counter.value, slot.value = 0, function
            numbers = [(self._address + start + k).to_bytes(8, "little") for k in (40, 48)]
            code = _COUNT + numbers[0] + _LOAD + numbers[1] + _JUMP
            self._memory[start : start + len(code)] = code
            self._functions.setdefault(name, []).append((counter, slot, function))
            self._codes[name, function] = self._address + start
        return self._codes[name, function]

    def start(self) -> None:
        """Set all counts to 0."""
        for counter, _, _ in self._each():
            counter.value = 0

    def found(self) -> dict[str, int]:
        """Return the number of calls since `start` by name, without functions that were not called."""
        counts = {name: sum(each[0].value for each in found) for name, found in self._functions.items()}
        return {name: count for name, count in counts.items() if count}

    @contextlib.contextmanager
    def without_drawing(self) -> Iterator[None]:
        """Make drawing, clearing and copying of framebuffers do nothing in this block."""
        drawing = [each for name, found in self._functions.items() if _IS_DRAWING.match(name) for each in found]
        for _, slot, _ in drawing:
            slot.value = self._address
        try:
            yield
        finally:
            for _, slot, function in drawing:
                slot.value = function

    @contextlib.contextmanager
    def counted(self) -> Iterator[None]:
        """Count calls of functions that are looked up in this block, including calls after the block."""
        openers = dict(gl._OPENERS)
        loaders: tuple[Any, ...] = CurrentContext, NativeContext
        before = [loader.load_opengl_function for loader in loaders]
        for loader, load in zip(loaders, before, strict=True):
            loader.load_opengl_function = self._counting(load)
        gl._OPENERS["egl"] = lambda: _opened(_CountedEgl(self))
        try:
            yield
        finally:
            for loader, load in zip(loaders, before, strict=True):
                setattr(loader, "load_opengl_function", load)  # noqa: B010
            gl._OPENERS.update(openers)

    def _counting(self, load: Callable[[Any, str], int]) -> Callable[[Any, str], int]:
        return lambda loader, name: self.address(name, load(loader, name))

    def _each(self) -> Iterator[tuple[ctypes.c_uint64, ctypes.c_uint64, int]]:
        return (each for found in self._functions.values() for each in found)


def _opened(loader: Any) -> moderngl.Context:
    return moderngl.create_context(standalone=True, require=410, context=loader)


class _CountedEgl:
    """An EGL context for ModernGL whose functions are counted."""

    def __init__(self, calls: GlCalls) -> None:
        backend: Any = glcontext.get_backend_by_name("egl")
        self._inner, self._calls = backend(mode="standalone", glversion=410), calls

    def load_opengl_function(self, name: str) -> int:
        return self._calls.address(name, self._inner.load(name))

    def __enter__(self) -> "_CountedEgl":
        self._inner.__enter__()
        return self

    def __exit__(self, *exception: object) -> None:
        self._inner.__exit__(*exception)

    def release(self) -> None:
        self._inner.release()

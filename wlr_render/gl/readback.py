"""Read-back of textures, at once or asynchronously through pixel-pack buffers and fences."""

import ctypes
import weakref
from collections import deque
from typing import Any

import cv2
import numpy as np
from numpy.typing import DTypeLike, NDArray

from wlr_render.errors import BadInputError
from wlr_render.gl import gl
from wlr_render.gl.gl_errors import GlError

_COMMANDS_COMPLETE, _FLUSH = 0x9117, 0x1  # GL_SYNC_GPU_COMMANDS_COMPLETE, GL_SYNC_FLUSH_COMMANDS_BIT
_TIMEOUT, _FAILED = 0x911B, 0x911D  # GL_TIMEOUT_EXPIRED, GL_WAIT_FAILED
_FOREVER_NS = 10_000_000_000
_BUFFERS = 3  # buffers of a ring


def rgb_of_rgba(rgba: NDArray[Any]) -> NDArray[Any]:
    """Drop alpha, (height, width, 4) to (height, width, 3): faster than a read of three of four channels."""
    return np.asarray(cv2.cvtColor(rgba, cv2.COLOR_RGBA2RGB))


def read_rgb(texture: gl.Texture) -> NDArray[Any]:
    """Return an RGBA texture's colours, (height, width, 3) of `colour_type`; call it in a drawing block."""
    rgba = gl.read(texture, colour_type(texture))
    return np.ascontiguousarray(rgba[..., :3]) if rgba.dtype == np.float16 else rgb_of_rgba(rgba)


def colour_type(texture: gl.Texture) -> DTypeLike:
    """Return the type in which a colour texture is read: uint8, uint16 (65535 is 1) or float16."""
    return {"f1": "u1", "nu2": "u2", "f2": "f2"}[texture.dtype]


class _Fence:
    """A fence after all commands so far; call its methods in a drawing block."""

    def __init__(self, context: gl.GlContext) -> None:
        self._wait = context.function(
            "glClientWaitSync", ctypes.c_void_p, ctypes.c_uint, ctypes.c_uint64, result=ctypes.c_uint
        )
        self._delete = context.function("glDeleteSync", ctypes.c_void_p)
        make = context.function("glFenceSync", ctypes.c_uint, ctypes.c_uint, result=ctypes.c_void_p)
        self._number: int = make(_COMMANDS_COMPLETE, 0)
        context.tracked(self)

    def is_passed(self, timeout_ns: int) -> bool:
        return self._wait(self._number, _FLUSH, timeout_ns) not in (_TIMEOUT, _FAILED)

    def release(self) -> None:
        number, self._number = self._number, 0
        self._delete(number)  # 0 is ignored


class Readback:
    """A picture in transfer to the CPU; later frames do not change it."""

    def __init__(self, context: gl.GlContext, texture: gl.Texture, buffer: gl.Buffer) -> None:
        """Start copying an RGBA texture into a buffer of its size, which must not be used meanwhile."""
        self._context, self._shape = context, (texture.height, texture.width, 4)
        self._dtype: np.dtype[Any] = np.dtype(colour_type(texture))
        self._pixels: NDArray[Any] | None = None
        with context.drawing() as ctx:
            texture.read_into(buffer)
            self._buffer, self._fence = buffer, _Fence(context)
            # The next drawing block frees the objects of this list, like garbage-collected textures.
            weakref.finalize(self, ctx.objects.append, self._fence)

    def is_ready(self) -> bool:
        """Return whether `result` returns without waiting for the GPU."""
        if self._pixels is not None:
            return True
        with self._context.drawing():
            return self._fence.is_passed(0)

    def result(self) -> NDArray[Any]:
        """Return the picture (height, width, 3), like `ComposedFrame.read`; wait for the GPU if it is not ready.

        Raises:
            BadInputError: the context has been released.
            GlError: the GPU does not finish within ten seconds.
        """
        if self._pixels is None:
            with self._context.drawing():
                if not self._fence.is_passed(_FOREVER_NS):
                    raise GlError(f"the picture was not read within ten seconds ({self._context.renderer}).")
                rgba = np.empty(self._shape, self._dtype)
                self._buffer.read_into(rgba)
                self._fence.release()
            self._pixels = rgba[..., :3] if self._dtype == np.float16 else rgb_of_rgba(rgba)
        return self._pixels


class ReadbackRing:
    """Three buffers for the pictures of one source: one is being filled while two wait to be read."""

    def __init__(self, context: gl.GlContext) -> None:
        self._context = context
        self._used = deque[tuple[gl.Buffer, weakref.ref[Readback]]](maxlen=_BUFFERS)

    def start(self, texture: gl.Texture) -> Readback:
        """Start copying an RGBA texture; wait only for the third picture before, if it is still unread."""
        buffer, size_bytes = None, np.dtype(colour_type(texture)).itemsize * 4 * texture.width * texture.height
        with self._context.drawing() as ctx:
            if len(self._used) == _BUFFERS:
                buffer, last = self._used.popleft()
                if (unread := last()) is not None:
                    unread.result()
            if buffer is None or buffer.size != size_bytes:
                buffer = self._context.tracked(ctx.buffer(reserve=size_bytes))
            reading = Readback(self._context, texture, buffer)
        self._used.append((buffer, weakref.ref(reading)))
        return reading


def read_into(context: gl.GlContext, texture: gl.Texture, target: Any) -> None:
    """Copy an RGBA texture into a numpy array, or without a wait into a ModernGL buffer; call it in a drawing block.

    Args:
        context: context of the texture.
        texture: texture to copy.
        target: (height, width, 4) of `colour_type`, contiguous, or a buffer of the context with as many bytes.

    Raises:
        BadInputError: a target of another kind, size or context.
    """
    shape, dtype = (texture.height, texture.width, 4), np.dtype(colour_type(texture))
    size_bytes = dtype.itemsize * 4 * texture.width * texture.height
    if isinstance(target, gl.Buffer):
        if not context.has(target):
            raise BadInputError("the buffer belongs to another OpenGL context; make it in the compositor's.")
        if target.size != size_bytes:
            raise BadInputError(f"the buffer has {target.size} bytes, and {size_bytes} are needed.")
    elif not (
        isinstance(target, np.ndarray)
        and target.shape == shape
        and target.dtype == dtype
        and target.flags.c_contiguous
        and target.flags.writeable
    ):
        raise BadInputError(
            f"a picture cannot be read into that {type(target).__name__}; give a writeable array {shape} of {dtype}, "
            "or a ModernGL buffer."
        )
    texture.read_into(target, alignment=1)

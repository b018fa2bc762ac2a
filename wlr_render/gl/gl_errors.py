"""Errors of OpenGL: their names, and a reader."""

import ctypes

from wlr_render.gl.native_contexts import CurrentContext

_LARGEST_COUNT = 16
"""Largest number of errors that are read: OpenGL holds one of each kind."""
_LOST = 0x0507
_NAMES = {
    0x0500: "GL_INVALID_ENUM",
    0x0501: "GL_INVALID_VALUE",
    0x0502: "GL_INVALID_OPERATION",
    0x0505: "GL_OUT_OF_MEMORY",
    0x0506: "GL_INVALID_FRAMEBUFFER_OPERATION",
    _LOST: "GL_CONTEXT_LOST",
}


class GlError(RuntimeError):
    """OpenGL refused a call: a fault of this library or of the driver, not of the input."""


def error_name(error: int) -> str:
    """Return OpenGL's name of an error."""
    return _NAMES.get(error, f"error {error:#x}")


class ErrorReader:
    """Reads and clears the errors of an OpenGL context."""

    def __init__(self, current: CurrentContext) -> None:
        self._get_error = current.function("glGetError", result=ctypes.c_uint)

    def take(self) -> int:
        """Return the oldest error (0: none), and clear all errors.

        Raises:
            GlError: the context is lost, and reports errors forever.
        """
        first = error = self._get_error()
        for _ in range(_LARGEST_COUNT):
            if not error:
                return int(first)
            if error == _LOST:
                break
            error = self._get_error()
        raise GlError(
            f"OpenGL reports {error_name(first)} without end: the context is lost, after a reset of the GPU or of its "
            "driver; release it with all compositors, and make new ones."
        )

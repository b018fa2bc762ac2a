"""A software OpenGL context from libOSMesa, for machines with neither a display nor EGL.

It has the few methods that `moderngl.create_context(context=...)` asks of a context object.
"""

import ctypes
import ctypes.util

_RGBA, _UNSIGNED_BYTE = 0x1908, 0x1401
# OSMESA_FORMAT, OSMESA_PROFILE = OSMESA_CORE_PROFILE, OSMESA_CONTEXT_MAJOR_VERSION and _MINOR_VERSION.
_ATTRIBUTES = (0x22, _RGBA, 0x33, 0x34, 0x36, 4, 0x37, 3, 0)


class OsMesaContext:
    """An OpenGL 4.3 core context; drawing goes to framebuffer objects, its own picture is a formality.

    Raises:
        OSError: libOSMesa is not installed, or it cannot open the context.
    """

    def __init__(self) -> None:
        self._library = self.library()
        self._library.OSMesaCreateContextAttribs.restype = ctypes.c_void_p
        self._library.OSMesaGetProcAddress.restype = ctypes.c_void_p
        attributes = (ctypes.c_int * len(_ATTRIBUTES))(*_ATTRIBUTES)
        self._handle = ctypes.c_void_p(self._library.OSMesaCreateContextAttribs(attributes, None))
        if not self._handle:
            raise OSError("libOSMesa cannot open an OpenGL 4.3 context")
        self._picture = ctypes.create_string_buffer(16 * 16 * 4)
        self.__enter__()

    @staticmethod
    def library() -> ctypes.CDLL:
        """Load libOSMesa, or raise OSError."""
        return ctypes.CDLL(ctypes.util.find_library("OSMesa") or "libOSMesa.so.8")

    def load_opengl_function(self, name: str) -> int:
        """Address of an OpenGL function, 0 if there is none."""
        return self._library.OSMesaGetProcAddress(name.encode()) or 0

    def __enter__(self) -> "OsMesaContext":
        self._library.OSMesaMakeCurrent(self._handle, self._picture, _UNSIGNED_BYTE, 16, 16)
        return self

    def __exit__(self, *exception: object) -> None:
        """Stay current: there is nothing to go back to."""

    def release(self) -> None:
        """Destroy the context."""
        if self._handle:
            self._library.OSMesaDestroyContext(self._handle)
            self._handle = ctypes.c_void_p(None)

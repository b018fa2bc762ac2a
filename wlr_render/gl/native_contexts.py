"""OpenGL contexts of the platform: the one that is current on this thread, EGL's binding, and OSMesa's context."""

import ctypes
import ctypes.util
from collections.abc import Callable, Iterable
from typing import Any

_MAJOR_VERSION, _MINOR_VERSION = 0x821B, 0x821C
_EXTENSIONS, _EXTENSION_COUNT = 0x1F03, 0x821D
_EGL_DRAW, _EGL_READ = 0x3059, 0x305A

# What the library is called, and its two functions. OSMesa comes last: within Mesa it takes EGL's context for its own.
_PLATFORMS = {
    "egl": (("EGL", "libEGL.so.1"), "eglGetCurrentContext", "eglGetProcAddress"),
    "glx": (("GL", "libGL.so.1"), "glXGetCurrentContext", "glXGetProcAddressARB"),
    "wgl": (("opengl32", "opengl32.dll"), "wglGetCurrentContext", "wglGetProcAddress"),
    "osmesa": (("OSMesa", "libOSMesa.so.8"), "OSMesaGetCurrentContext", "OSMesaGetProcAddress"),
}


class NoCurrentContextError(RuntimeError):
    """No OpenGL context is current on this thread."""


class CurrentContext:
    """The OpenGL context that was current when this object was made.

    Attributes:
        platform: "egl", "glx", "wgl" or "osmesa".

    Raises:
        NoCurrentContextError: none is.
    """

    def __init__(self, platforms: Iterable[str] = _PLATFORMS) -> None:
        for self.platform in platforms:
            library = _library(self.platform)
            if library is None:
                continue
            _, current_name, address_name = _PLATFORMS[self.platform]
            self._library, self._native_current = library, _pointer_function(library, current_name)
            self._address_of = _pointer_function(library, address_name, ctypes.c_char_p)
            self._native = self._native_current()
            if self._native:
                return
        raise NoCurrentContextError("No OpenGL context is current on this thread")

    def is_current(self) -> bool:
        """Return whether the context is current on the calling thread."""
        return bool(self._native_current() == self._native)

    def version(self) -> tuple[int, int]:
        """(major, minor); (0, 0) where it is older than 3.0."""
        read = self.function("glGetIntegerv", ctypes.c_uint, ctypes.c_void_p)
        numbers = (ctypes.c_int * 2)()
        read(_MAJOR_VERSION, ctypes.byref(numbers))
        read(_MINOR_VERSION, ctypes.byref(numbers, ctypes.sizeof(ctypes.c_int)))
        return numbers[0], numbers[1]

    def has(self, version: tuple[int, int], extension: str) -> bool:
        """Return whether the context has this version or the extension.

        The address of a function tells neither: GLX and EGL return one for every name.
        """
        if self.version() >= version:
            return True
        count = ctypes.c_int()
        self.function("glGetIntegerv", ctypes.c_uint, ctypes.c_void_p)(_EXTENSION_COUNT, ctypes.byref(count))
        name = self.function("glGetStringi", ctypes.c_uint, ctypes.c_uint, result=ctypes.c_char_p)
        return any(name(_EXTENSIONS, index) == extension.encode() for index in range(count.value))

    def function(self, name: str, *argument_types: Any, result: Any = None) -> Callable[..., Any]:
        """Return an OpenGL function of this context, to be called while it is current."""
        return ctypes.CFUNCTYPE(result, *argument_types)(self.load_opengl_function(name))

    def load_opengl_function(self, name: str) -> int:
        """Return the address of an OpenGL function, 0 if it is missing."""
        address = self._address_of(name.encode())
        if not address and hasattr(self._library, name):  # Windows: the oldest functions are the library's own
            address = ctypes.cast(getattr(self._library, name), ctypes.c_void_p).value
        return address or 0

    def __enter__(self) -> "CurrentContext":
        return self

    def __exit__(self, *exception: object) -> None:
        """Do nothing: the program that made the context makes it current."""

    def release(self) -> None:
        """Do nothing: the program that made the context destroys it."""


class EglBinding:
    """The EGL context that is current on the calling thread: saves it and makes it current again.

    Raises:
        OSError: libEGL is not installed.
    """

    def __init__(self) -> None:
        library = _library("egl")
        if library is None:
            raise OSError("libEGL is not installed")
        self._display = _pointer_function(library, "eglGetCurrentDisplay")
        self._context = _pointer_function(library, "eglGetCurrentContext")
        self._surface = _pointer_function(library, "eglGetCurrentSurface", ctypes.c_int)
        make_current = ctypes.cast(library.eglMakeCurrent, ctypes.c_void_p).value or 0
        self._make_current = ctypes.CFUNCTYPE(ctypes.c_uint, *[ctypes.c_void_p] * 4)(make_current)

    def save(self) -> Callable[[], None]:
        """Save the current context and its surfaces; the returned function makes them current again.

        If no context is current now, or it has been destroyed by then, the returned function leaves none current.
        """
        saved = self._display(), self._surface(_EGL_DRAW), self._surface(_EGL_READ), self._context()

        def restore() -> None:
            if not (saved[-1] and self._make_current(*saved)) and self._context():
                self._make_current(self._display(), None, None, None)

        return restore

    def makes_current(self, make_current: Callable[[], object], current: CurrentContext) -> bool:
        """Return whether a function makes the given context current; then restore the context that was current."""
        restore = self.save()
        if self._context():
            self._make_current(self._display(), None, None, None)
        try:
            make_current()
            return current.is_current()
        finally:
            restore()


def _library(platform: str) -> ctypes.CDLL | None:
    (name, file_name), *_ = _PLATFORMS[platform]
    try:
        return ctypes.CDLL(ctypes.util.find_library(name) or file_name)
    except OSError:
        return None


def _pointer_function(library: ctypes.CDLL, name: str, *argument_types: Any) -> Callable[..., int | None]:
    address = ctypes.cast(getattr(library, name), ctypes.c_void_p).value
    return ctypes.CFUNCTYPE(ctypes.c_void_p, *argument_types)(address or 0)


_RGBA, _UNSIGNED_BYTE = 0x1908, 0x1401
# OSMESA_FORMAT, OSMESA_PROFILE = OSMESA_CORE_PROFILE, OSMESA_CONTEXT_MAJOR_VERSION and _MINOR_VERSION.
_ATTRIBUTES = (0x22, _RGBA, 0x33, 0x34, 0x36, 4, 0x37, 1, 0)


class OsMesaContext:
    """An OpenGL 4.1 core context; drawing goes to framebuffer objects; its own picture is not used.

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
            raise OSError("libOSMesa cannot open an OpenGL 4.1 context")
        self._picture = ctypes.create_string_buffer(16 * 16 * 4)
        self.__enter__()

    @staticmethod
    def library() -> ctypes.CDLL:
        """Load libOSMesa, or raise OSError."""
        return ctypes.CDLL(ctypes.util.find_library("OSMesa") or "libOSMesa.so.8")

    def load_opengl_function(self, name: str) -> int:
        """Return the address of an OpenGL function, 0 if it is missing."""
        return self._library.OSMesaGetProcAddress(name.encode()) or 0

    def __enter__(self) -> "OsMesaContext":
        self._library.OSMesaMakeCurrent(self._handle, self._picture, _UNSIGNED_BYTE, 16, 16)
        return self

    def __exit__(self, *exception: object) -> None:
        """Stay current."""

    def release(self) -> None:
        """Destroy the context."""
        if self._handle:
            self._library.OSMesaDestroyContext(self._handle)
            self._handle = ctypes.c_void_p(None)

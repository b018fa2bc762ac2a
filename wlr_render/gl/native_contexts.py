"""Native OpenGL contexts: the current context, bindings to a thread, and contexts that share textures."""

import contextlib
import ctypes
import ctypes.util
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Protocol

_MAJOR_VERSION, _MINOR_VERSION = 0x821B, 0x821C
_INT, _POINTER = ctypes.c_int, ctypes.c_void_p
_EGL_DRAW, _EGL_READ, _EGL_CONFIG_ID, _EGL_NONE = 0x3059, 0x305A, 0x3028, 0x3038
_EGL_MAJOR, _EGL_MINOR, _EGL_PROFILE, _EGL_CORE = 0x3098, 0x30FB, 0x30FD, 1
_EGL_OPENGL = 0x30A2
_EGL_LOST_AT_RESET = 0x31BD, 0x31BF  # reset notification strategy of robust contexts
_GLX_CONFIG_ID, _GLX_SCREEN = 0x8013, 0x800C
_GLX_MAJOR, _GLX_MINOR, _GLX_PROFILE, _GLX_CORE = 0x2091, 0x2092, 0x9126, 1
_RGBA, _UNSIGNED_BYTE, _OSMESA_TYPE = 0x1908, 0x1401, 0x23
# OSMESA_FORMAT, OSMESA_PROFILE = OSMESA_CORE_PROFILE, OSMESA_CONTEXT_MAJOR_VERSION and _MINOR_VERSION.
_OSMESA_ATTRIBUTES = (0x22, _RGBA, 0x33, 0x34, 0x36, 4, 0x37, 1, 0)

# Names of each library and of its two functions. OSMesa comes last: within Mesa it mistakes EGL's context for its own.
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
        NoCurrentContextError: no context is current.
    """

    def __init__(self, platforms: Iterable[str] = _PLATFORMS) -> None:
        for self.platform in platforms:
            library = _library(self.platform)
            if library is None:
                continue
            _, current_name, address_name = _PLATFORMS[self.platform]
            self._library, self._native_current = library, _function(library, current_name)
            self._address_of = _function(library, address_name, ctypes.c_char_p)
            self._native = self._native_current()
            if self._native:
                return
        raise NoCurrentContextError("No OpenGL context is current on this thread")

    def is_current(self) -> bool:
        """Return whether the context is current on the calling thread."""
        return bool(self._native_current() == self._native)

    def version(self) -> tuple[int, int]:
        """Return (major, minor); (0, 0) if it is older than 3.0."""
        read = self.function("glGetIntegerv", ctypes.c_uint, ctypes.c_void_p)
        numbers = (ctypes.c_int * 2)()
        read(_MAJOR_VERSION, ctypes.byref(numbers))
        read(_MINOR_VERSION, ctypes.byref(numbers, ctypes.sizeof(ctypes.c_int)))
        return numbers[0], numbers[1]

    def function(self, name: str, *argument_types: Any, result: Any = None) -> Callable[..., Any]:
        """Return an OpenGL function of this context, to be called while it is current."""
        return ctypes.CFUNCTYPE(result, *argument_types)(self.load_opengl_function(name))

    def load_opengl_function(self, name: str) -> int:
        """Return the address of an OpenGL function, 0 if it is missing."""
        address = self._address_of(name.encode())
        if not address and hasattr(self._library, name):  # on Windows, the library itself exports the oldest functions
            address = ctypes.cast(getattr(self._library, name), ctypes.c_void_p).value
        return address or 0

    def __enter__(self) -> "CurrentContext":
        return self

    def __exit__(self, *exception: object) -> None:
        """Do nothing: the program that made the context makes it current."""

    def release(self) -> None:
        """Do nothing: the program that made the context destroys it."""


@dataclass(frozen=True)
class NativeContext:
    """A context that this library opened, in the form that ModernGL takes."""

    address_of: Callable[[bytes], int | None]
    make_current: Callable[[], object]
    destroy: Callable[[], object]

    def load_opengl_function(self, name: str) -> int:
        """Return the address of an OpenGL function, 0 if it is missing."""
        return self.address_of(name.encode()) or 0

    def __enter__(self) -> "NativeContext":
        self.make_current()
        return self

    def __exit__(self, *exception: object) -> None:
        """Stay current."""

    def release(self) -> None:
        """Destroy the context."""
        self.destroy()


class Binding(Protocol):
    """Binding of a context and its surfaces to the calling thread, on one platform."""

    def save(self) -> Callable[[], None]:
        """Save the current context and its surfaces; the returned function makes them current again.

        If no context is current now, or it has been destroyed by then, no context is current afterwards.
        """

    def shared(self) -> NativeContext:
        """Return a new OpenGL 4.1 core context that shares textures with the current one, which stays current.

        Raises:
            OSError: the driver refuses.
        """


class EglBinding:
    """EGL's `Binding`.

    Raises:
        OSError: libEGL is not installed.
    """

    def __init__(self) -> None:
        library = _needed_library("egl")
        self._display = _function(library, "eglGetCurrentDisplay")
        self._context = _function(library, "eglGetCurrentContext")
        self._surface = _function(library, "eglGetCurrentSurface", _INT)
        self._make_current = _function(library, "eglMakeCurrent", *[_POINTER] * 4, result=ctypes.c_uint)
        self._library = library

    def save(self) -> Callable[[], None]:
        """Save the current context, see `Binding`."""
        saved = self._display(), self._surface(_EGL_DRAW), self._surface(_EGL_READ), self._context()

        def restore() -> None:
            if not (saved[-1] and self._make_current(*saved)) and self._context():
                self._make_current(self._display(), None, None, None)

        return restore

    def shared(self) -> NativeContext:
        """Return a new context, see `Binding`."""
        display, host = self._display(), self._context()
        find = _function(self._library, "eglChooseConfig", *[_POINTER] * 3, _INT, _POINTER)
        query = _function(self._library, "eglQueryContext", _POINTER, _POINTER, _INT, _POINTER)
        number, config, count = _INT(), _POINTER(), _INT()
        query(display, host, _EGL_CONFIG_ID, ctypes.addressof(number))
        if number.value:  # 0: the context has no configuration, and ours needs none
            wanted = _numbers(_EGL_CONFIG_ID, number.value, _EGL_NONE)
            find(display, wanted, ctypes.addressof(config), 1, ctypes.addressof(count))
        create = _function(self._library, "eglCreateContext", *[_POINTER] * 4)
        version = _EGL_MAJOR, 4, _EGL_MINOR, 1, _EGL_PROFILE, _EGL_CORE
        with self._opengl_chosen():
            # Contexts that share must have the same GPU reset strategy.
            ours = create(display, config, host, _numbers(*version, _EGL_NONE)) or create(
                display, config, host, _numbers(*version, *_EGL_LOST_AT_RESET, _EGL_NONE)
            )
        if not ours:
            raise OSError("EGL refuses an OpenGL 4.1 context that shares with the one that is current")
        destroy = _function(self._library, "eglDestroyContext", _POINTER, _POINTER)
        load = _function(self._library, "eglGetProcAddress", ctypes.c_char_p)
        return NativeContext(
            load, lambda: self._make_current(display, None, None, ours), lambda: destroy(display, ours)
        )

    @contextlib.contextmanager
    def _opengl_chosen(self) -> Iterator[None]:
        """Select OpenGL for contexts that are created in a block: threads begin with OpenGL ES."""
        choose = _function(self._library, "eglBindAPI", ctypes.c_uint, result=ctypes.c_uint)
        before = _function(self._library, "eglQueryAPI", result=ctypes.c_uint)()
        choose(_EGL_OPENGL)
        try:
            yield
        finally:
            choose(before)

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


class GlxBinding:
    """GLX's `Binding`, like `EglBinding`."""

    def __init__(self) -> None:
        library = self._library = _needed_library("glx")
        names = "glXGetCurrentDisplay", "glXGetCurrentDrawable", "glXGetCurrentReadDrawable", "glXGetCurrentContext"
        self._current = [_function(library, name) for name in names]
        self._make_current = _function(library, "glXMakeContextCurrent", *[_POINTER] * 4)

    def save(self) -> Callable[[], None]:
        """Save the current context, see `Binding`."""
        saved = [get() for get in self._current]

        def restore() -> None:
            if saved[-1]:
                self._make_current(*saved)
            elif self._current[-1]():
                self._make_current(self._current[0](), None, None, None)

        return restore

    def shared(self) -> NativeContext:
        """Return a new context, see `Binding`."""
        display, _, _, host = (get() for get in self._current)
        query = _function(self._library, "glXQueryContext", _POINTER, _POINTER, _INT, _POINTER)
        number, screen, count, found = (_INT() for _ in range(4))
        query(display, host, _GLX_CONFIG_ID, ctypes.addressof(number))
        query(display, host, _GLX_SCREEN, ctypes.addressof(screen))
        all_configs = _function(self._library, "glXGetFBConfigs", _POINTER, _INT, _POINTER)
        first = all_configs(display, screen, ctypes.addressof(count))
        attribute = _function(self._library, "glXGetFBConfigAttrib", _POINTER, _POINTER, _INT, _POINTER)
        load = _function(self._library, "glXGetProcAddressARB", ctypes.c_char_p)
        address = load(b"glXCreateContextAttribsARB")
        ours = None
        for config in (_POINTER * count.value).from_address(first) if first and address else ():
            attribute(display, config, _GLX_CONFIG_ID, ctypes.addressof(found))
            if found.value == number.value:
                create = ctypes.CFUNCTYPE(_POINTER, _POINTER, _POINTER, _POINTER, _INT, _POINTER)(address)
                version = _GLX_MAJOR, 4, _GLX_MINOR, 1, _GLX_PROFILE, _GLX_CORE
                with _x_errors_ignored(display):
                    ours = create(display, config, host, 1, _numbers(*version, 0))
                break
        if not ours:
            raise OSError("GLX refuses an OpenGL 4.1 context that shares with the one that is current")
        destroy = _function(self._library, "glXDestroyContext", _POINTER, _POINTER)
        return NativeContext(
            load, lambda: self._make_current(display, None, None, ours), lambda: destroy(display, ours)
        )


@contextlib.contextmanager
def _x_errors_ignored(display: int | None) -> Iterator[None]:
    """Ignore X errors in a block: by default they end the program."""
    x11 = ctypes.CDLL(ctypes.util.find_library("X11") or "libX11.so.6")
    handle = _function(x11, "XSetErrorHandler", _POINTER)
    wait = _function(x11, "XSync", _POINTER, _INT, result=_INT)
    ignore = ctypes.CFUNCTYPE(_INT, _POINTER, _POINTER)(lambda display, error: 0)
    wait(display, 0)  # errors arrive with a delay: earlier errors are the host's
    before = handle(ctypes.cast(ignore, _POINTER))
    try:
        yield
    finally:
        wait(display, 0)
        handle(before)


class OsMesaBinding:
    """OSMesa's `Binding`, like `EglBinding`. All its contexts, even shared ones, draw to framebuffer objects."""

    def __init__(self) -> None:
        library = self._library = _needed_library("osmesa")
        egl = _library("egl")
        # Within Mesa, OSMesa mistakes EGL's current context for its own.
        self._other = _function(egl, "eglGetCurrentContext") if egl else lambda: None
        self._current = _function(library, "OSMesaGetCurrentContext")
        self._make_current = _function(library, "OSMesaMakeCurrent", _POINTER, _POINTER, *[_INT] * 3)

    def save(self) -> Callable[[], None]:
        """Save the current context, see `Binding`."""
        host = None if self._other() else self._current()
        width, height, pixel_format, kind, buffer = _INT(), _INT(), _INT(), _INT(), _POINTER()
        if host:
            read = _function(self._library, "OSMesaGetColorBuffer", *[_POINTER] * 5)
            read(host, *map(ctypes.addressof, (width, height, pixel_format, buffer)))
            _function(self._library, "OSMesaGetIntegerv", _INT, _POINTER)(_OSMESA_TYPE, ctypes.addressof(kind))

        def restore() -> None:
            if not self._other():
                self._make_current(host, buffer, kind, width, height)

        return restore

    def shared(self) -> NativeContext:
        """Return a new context, see `Binding`."""
        return self.opened(self._current())

    def opened(self, host: int | None = None) -> NativeContext:
        """Return a new context, which shares with `host` if it is given.

        Raises:
            OSError: the driver refuses.
        """
        create = _function(self._library, "OSMesaCreateContextAttribs", _POINTER, _POINTER)
        ours, picture = create(_numbers(*_OSMESA_ATTRIBUTES), host), ctypes.create_string_buffer(16 * 16 * 4)
        if not ours:
            raise OSError("libOSMesa cannot open an OpenGL 4.1 context")
        destroy = _function(self._library, "OSMesaDestroyContext", _POINTER)
        return NativeContext(
            _function(self._library, "OSMesaGetProcAddress", ctypes.c_char_p),
            lambda: self._make_current(ours, ctypes.addressof(picture), _UNSIGNED_BYTE, 16, 16),
            lambda: destroy(ours),
        )


BINDINGS: dict[str, Callable[[], Binding]] = {"egl": EglBinding, "glx": GlxBinding, "osmesa": OsMesaBinding}
"""Bindings by platform; WGL has no binding."""


def _library(platform: str) -> ctypes.CDLL | None:
    (name, file_name), *_ = _PLATFORMS[platform]
    try:
        return ctypes.CDLL(ctypes.util.find_library(name) or file_name)
    except OSError:
        return None


def _needed_library(platform: str) -> ctypes.CDLL:
    library = _library(platform)
    if library is None:
        raise OSError(f"lib{_PLATFORMS[platform][0][0]} is not installed")
    return library


def _function(library: ctypes.CDLL, name: str, *argument_types: Any, result: Any = _POINTER) -> Callable[..., Any]:
    address = ctypes.cast(getattr(library, name), ctypes.c_void_p).value
    return ctypes.CFUNCTYPE(result, *argument_types)(address or 0)


def _numbers(*values: int) -> Any:
    """Return a list of attributes as a C array."""
    return (_INT * len(values))(*values)

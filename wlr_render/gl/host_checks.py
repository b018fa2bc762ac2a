"""Checks of a host's OpenGL context before we draw in it: pending errors, and modes that our draws would disturb."""

import ctypes
import secrets
import warnings
from collections.abc import Callable
from typing import Any

from wlr_render.errors import BadInputError, stacklevel_of_caller
from wlr_render.gl.native_contexts import CurrentContext

_UINT, _INT, _POINTER = ctypes.c_uint, ctypes.c_int, ctypes.c_void_p
_LARGEST_COUNT = 16
"""Errors that are read at most: OpenGL holds one of each kind."""
_LOST = 0x0507
_NAMES = {
    0x0500: "GL_INVALID_ENUM",
    0x0501: "GL_INVALID_VALUE",
    0x0502: "GL_INVALID_OPERATION",
    0x0505: "GL_OUT_OF_MEMORY",
    0x0506: "GL_INVALID_FRAMEBUFFER_OPERATION",
    _LOST: "GL_CONTEXT_LOST",
}
_CURRENT_QUERY, _BORDER_COLOUR, _NO_WAIT = 0x8865, 0x1004, 0x8E14
_SAMPLES_PASSED = 0x8914
# Time queries may run: they count our time as part of the host's frame.
_QUERIES = {
    _SAMPLES_PASSED: "GL_SAMPLES_PASSED",
    0x8C2F: "GL_ANY_SAMPLES_PASSED",
    0x8D6A: "GL_ANY_SAMPLES_PASSED_CONSERVATIVE",
    0x8C87: "GL_PRIMITIVES_GENERATED",
}
_YOUNGER_QUERIES = {0x8D6A: ((4, 3), "GL_ARB_ES3_compatibility")}
_FEEDBACK_ACTIVE, _FEEDBACK_PAUSED = 0x8E24, 0x8E23


class GlError(RuntimeError):
    """OpenGL refused a call: a fault of this library or of the driver, not of the input."""


class PendingGlErrorWarning(RuntimeWarning):
    """The host's OpenGL context held an error before a call of ours."""


def error_name(error: int) -> str:
    """OpenGL's name of an error."""
    return _NAMES.get(error, f"error {error:#x}")


class ErrorReader:
    """Reads the errors that an OpenGL context holds."""

    def __init__(self, current: CurrentContext) -> None:
        self._get_error = current.function("glGetError", result=_UINT)

    def take(self) -> int:
        """Return the oldest error (0: none), after which OpenGL holds none.

        Raises:
            GlError: the context is lost: it reports errors for ever.
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


class HostChecks:
    """Checks of one adopted context; call them while a context is current at its address."""

    def __init__(self, current: CurrentContext) -> None:
        self._current, self._errors = current, ErrorReader(current)
        self._get = current.function("glGetIntegerv", _UINT, _POINTER)
        self._query = current.function("glGetQueryiv", _UINT, _UINT, _POINTER)
        self._pause = current.function("glPauseTransformFeedback")
        self._resume = current.function("glResumeTransformFeedback")
        self._begin_conditional = current.function("glBeginConditionalRender", _UINT, _UINT)
        self._end_conditional = current.function("glEndConditionalRender")
        self._get_token = current.function("glGetSamplerParameterfv", _UINT, _UINT, _POINTER)
        self._queries = {
            target: name
            for target, name in _QUERIES.items()
            if target not in _YOUNGER_QUERIES or current.has(*_YOUNGER_QUERIES[target])
        }
        self._number = _INT()
        self._address = ctypes.addressof(self._number)
        self._report_pending()
        self._check_queries()
        self._sampler, self._token = self._made_token()
        self._own_query = self._made_query()

    def check(self) -> Callable[[], None]:
        """Check that drawing disturbs nothing of the host, and pause its transform feedback.

        Errors that OpenGL holds are reported by a `PendingGlErrorWarning`, because reading them removes them.

        Returns:
            A function that resumes the transform feedback; call it when the host's program is in use again.

        Raises:
            BadInputError: another context at the same address, a query that counts samples or primitives, or
                conditional rendering. Nothing was changed.
            GlError: the context is lost.
        """
        self._report_pending()
        if not self.is_same_context():
            raise BadInputError(
                "The OpenGL context that is current is not the one that was adopted: a new context lies at the address "
                "of the old one, which is gone; make another compositor for it."
            )
        self._begin_conditional(self._own_query, _NO_WAIT)
        if self._errors.take():
            raise BadInputError(
                "Conditional rendering is active in the OpenGL context, which would drop our draws: call "
                "glEndConditionalRender first."
            )
        self._end_conditional()
        self._check_queries()
        if not self._integer(_FEEDBACK_ACTIVE) or self._integer(_FEEDBACK_PAUSED):
            return lambda: None
        self._pause()
        return self._resume

    def is_same_context(self) -> bool:
        """Return whether our sampler object exists, so that the context is not another one at the same address."""
        found = (ctypes.c_float * 4)()
        self._get_token(self._sampler, _BORDER_COLOUR, ctypes.addressof(found))
        # A context without the object reports an error and writes nothing.
        return not self._errors.take() and list(found) == self._token

    def take_error(self) -> int:
        """Return as `ErrorReader.take`."""
        return self._errors.take()

    def release(self) -> None:
        """Delete our objects."""
        for kind, name in (("Samplers", self._sampler), ("Queries", self._own_query)):
            self._current.function(f"glDelete{kind}", _INT, _POINTER)(1, ctypes.addressof(_UINT(name)))

    def _report_pending(self) -> None:
        error = self._errors.take()
        if error:
            warnings.warn(
                f"OpenGL held {error_name(error)} before the call; it has been removed. The host's own call caused it: "
                "check glGetError before you call.",
                PendingGlErrorWarning,
                stacklevel=stacklevel_of_caller(),
            )

    def _check_queries(self) -> None:
        for target, name in self._queries.items():
            self._number.value = 0
            self._query(target, _CURRENT_QUERY, self._address)
            if self._number.value:
                raise BadInputError(
                    f"A {name} query is active in the OpenGL context and would count our draws: end it."
                )

    def _made_token(self) -> tuple[int, list[float]]:
        """Return a sampler object whose border colour tells this context from any other."""
        token = [float(secrets.randbits(20)) for _ in range(4)]
        set_token = self._current.function("glSamplerParameterfv", _UINT, _UINT, _POINTER)
        name = self._made("Samplers")
        set_token(name, _BORDER_COLOUR, ctypes.addressof((ctypes.c_float * 4)(*token)))
        return name, token

    def _made_query(self) -> int:
        name = self._made("Queries")
        self._current.function("glBeginQuery", _UINT, _UINT)(_SAMPLES_PASSED, name)
        self._current.function("glEndQuery", _UINT)(_SAMPLES_PASSED)
        return name

    def _made(self, kind: str) -> int:
        name = _UINT()
        generate: Any = self._current.function(f"glGen{kind}", _INT, _POINTER)
        generate(1, ctypes.addressof(name))
        return name.value

    def _integer(self, enum: int) -> int:
        self._number.value = 0
        self._get(enum, self._address)
        return self._number.value

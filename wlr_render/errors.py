"""Exceptions for bad input, and the caller that a warning refers to."""

import sys


class BadInputError(ValueError):
    """Bad input: one sentence with the file, the key or value, and the remedy.

    The command line prints the sentence and ends with status 2; a library caller catches it as a ValueError.
    """


class MissingGlError(BadInputError):
    """OpenGL is required and cannot be opened; the message states what to install or which backend to use."""


class Terminated(KeyboardInterrupt):
    """SIGTERM, which ends a run as Ctrl-C does."""


def stacklevel_of_caller() -> int:
    """Return the `stacklevel` for warnings.warn that names the line which called this library."""
    frame, level = sys._getframe(1), 1
    while frame.f_back and frame.f_globals.get("__name__", "").partition(".")[0] in ("wlr_render", "contextlib"):
        frame, level = frame.f_back, level + 1
    return level

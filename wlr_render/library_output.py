"""Suppression of output that libraries print and users of a verb should not see."""

import contextlib
import io
import logging
import os
import sys
import warnings
from collections.abc import Iterator

_STANDARD_ERROR = 2


@contextlib.contextmanager
def silenced_libraries() -> Iterator[None]:
    """Drop, in a `with` block, warnings, log records, and errors printed by C libraries and worker processes.

    libpng, libjpeg, libtiff, FFmpeg, OpenCV and Mesa write straight to file descriptor 2, which is redirected to the
    null device; `sys.stderr`, which gets the program's sentences, keeps its destination.
    """
    last_resort = logging.lastResort
    with warnings.catch_warnings(), _own_standard_error():
        warnings.simplefilter("ignore")
        logging.lastResort = logging.NullHandler()
        try:
            yield
        finally:
            logging.lastResort = last_resort


@contextlib.contextmanager
def _own_standard_error() -> Iterator[None]:
    stream = sys.stderr
    try:
        kept = os.dup(_STANDARD_ERROR)
    except OSError:  # standard error is closed
        yield
        return
    try:
        if _descriptor(stream) == _STANDARD_ERROR:
            sys.stderr = os.fdopen(
                kept, "w", encoding=stream.encoding, errors=stream.errors, buffering=1, closefd=False
            )
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), _STANDARD_ERROR)
        yield
    finally:
        with contextlib.suppress(OSError):  # a full disk
            sys.stderr.flush()
        sys.stderr = stream
        os.dup2(kept, _STANDARD_ERROR)
        os.close(kept)


def _descriptor(stream: object) -> int | None:
    """Return the file descriptor of a stream; None for a stream in memory or a missing one."""
    try:
        return stream.fileno() if isinstance(stream, io.TextIOBase) else None
    except OSError:
        return None

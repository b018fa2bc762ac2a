"""Entry point of the command line: signals and standard streams, ready before anything large is imported."""

import os
import signal
import sys
import time

from wlr_render.errors import Terminated

TYPE_CHECKING = False
if TYPE_CHECKING:  # `typing` is large: a signal before the handlers are installed ends in a traceback
    from collections.abc import Callable
    from types import FrameType
    from typing import TextIO

_REPEATED_S = 2.0
"""Signals within this time after the first one are repetitions: `timeout` sends two, to a process and to its group."""
_IMPORT_S = 0.02
"""Time after which an interrupted import is looked at again."""
_HAS_TIMER = hasattr(signal, "setitimer")


class Interruptions:
    """Signal handlers that end the program with one sentence on Ctrl-C or SIGTERM.

    The first signal raises a KeyboardInterrupt, so that temporary files are removed; during an import this waits for
    its end, because extension modules may swallow exceptions then (numpy.random's do). A later signal ends the
    process at once, and so does the first one when the work is done.
    """

    def __init__(self) -> None:
        self._first_s: float | None = None
        self._number = signal.SIGINT
        self.work_is_done = False

    def install(self) -> None:
        """Handle both signals, unless they are ignored, as by `nohup`."""
        for number in (signal.SIGINT, signal.SIGTERM):
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, self._interrupt)
        if _HAS_TIMER:
            signal.signal(signal.SIGALRM, self._raise)

    def _interrupt(self, number: int, frame: "FrameType | None") -> None:
        now = time.monotonic()
        if self._first_s is None:
            self._first_s, self._number = now, signal.Signals(number)
            self._raise(number, frame)
        elif now - self._first_s > _REPEATED_S:
            os._exit(128 + self._number if self.work_is_done else self.report())

    def _raise(self, _: int, frame: "FrameType | None") -> None:
        if self.work_is_done:
            os._exit(self.report())
        if _HAS_TIMER and _is_importing(frame):
            signal.setitimer(signal.ITIMER_REAL, _IMPORT_S)
        else:
            raise Terminated if self._number == signal.SIGTERM else KeyboardInterrupt

    def report(self) -> int:
        """Write the sentence; returns the exit status, 130 or 143."""
        word = "terminated" if self._number == signal.SIGTERM else "interrupted"
        _say(f"{word}; finished files are kept.")
        return 128 + self._number


def _is_importing(frame: "FrameType | None") -> bool:
    while frame is not None:
        if frame.f_code.co_filename == "<frozen importlib._bootstrap>":
            return True
        frame = frame.f_back
    return False


def main() -> int:
    """Run the command line as a program; returns the exit status."""

    def run() -> int:
        from wlr_render import cli

        return cli.main()

    return run_program(run)


def run_program(run: "Callable[[], int]") -> int:
    """Call `run` with signal handlers and open standard streams, and return its exit status."""
    interruptions = Interruptions()
    try:
        interruptions.install()
        _open_streams()
        status = run()
        interruptions.work_is_done = True
    except KeyboardInterrupt:
        interruptions.work_is_done = True
        status = interruptions.report()
    status = _flushed(sys.stdout, status)
    _flushed(sys.stderr, status)
    return status


def _open_streams() -> None:
    """Replace closed standard streams by the null device, so that no file gets their number and their output."""
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        try:
            os.fstat(number)
        except OSError:
            opened = os.open(os.devnull, os.O_RDWR)
            os.set_inheritable(opened, True)
            setattr(sys, name, os.fdopen(number, mode, encoding="utf-8", closefd=False))


def _flushed(stream: "TextIO", status: int) -> int:
    """Flush a stream; returns the exit status, or 2 if that fails.

    Without this, Python reports the failure at exit. A reader that closes early, e.g. `| head`, is not a failure.
    """
    try:
        stream.flush()
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
        if status == 0 and not isinstance(error, BrokenPipeError):
            _say(f"the standard output cannot be written ({error.strerror}); free space or print elsewhere.")
            return 2
    return status


def _say(sentence: str) -> None:
    import contextlib

    with contextlib.suppress(OSError):  # there is no stream to report to
        os.write(sys.stderr.fileno(), f"wlr-render: {sentence}\n".encode())


if __name__ == "__main__":
    sys.exit(main())

"""Take a photograph with the command of a camera's program, and wait until its file is complete."""

import os
import shlex
import subprocess
import tempfile
import time
from pathlib import Path

from wlr_render.errors import BadInputError

_LOOK_S = 0.1
_STABLE_S = 0.4  # camera programs write a file within one transfer; none pauses for so long


def words_of(trigger: str) -> list[str]:
    """Split a command as a shell does; `{path}` stands for the photograph's file.

    Raises:
        BadInputError: it has no `{path}`, or a quote that is not closed.
    """
    try:
        words = shlex.split(trigger)
    except ValueError as error:
        raise BadInputError(f"--trigger {trigger!r} is no command ({error}).") from error
    if not any("{path}" in word for word in words):
        raise BadInputError(
            f"--trigger {trigger!r} has no {{path}}, in place of which the name of the photograph's file is put; e.g. "
            '"gphoto2 --capture-image-and-download --filename {path}".'
        )
    return words


def take_photograph(trigger: str, path: Path, timeout_s: float) -> None:
    """Run a command and wait until it has written a file; its name has a dot in front until it is complete.

    Raises:
        BadInputError: the command cannot be run or fails, or there is no complete file within `timeout_s`.
    """
    ends = time.monotonic() + timeout_s
    partial = path.with_name(f".{path.name}")
    partial.unlink(missing_ok=True)
    command = [word.replace("{path}", str(partial)) for word in words_of(trigger)]
    named = f"{path}: was not taken: `{shlex.join(command)}`"
    # No pipe: one would be waited for as long as a program lives that the command leaves behind.
    with tempfile.TemporaryFile(mode="w+", errors="replace") as output:
        try:
            status = subprocess.run(command, stdout=output, stderr=subprocess.STDOUT, timeout=timeout_s).returncode
        except OSError as error:
            raise BadInputError(f"{named} cannot be run ({error.strerror}); correct --trigger.") from error
        except subprocess.TimeoutExpired as error:
            raise BadInputError(
                f"{named} did not end within {timeout_s:g} s; try it by hand, or give --timeout-s."
            ) from error
        output.seek(0)
        said = output.read().split("\n")
    if status != 0:
        last = next((line.strip() for line in reversed(said) if line.strip()), "no message")
        raise BadInputError(f"{named} failed with status {status} ({last}).")
    size, since = -1, time.monotonic()
    while size <= 0 or time.monotonic() - since < _STABLE_S:
        if time.monotonic() > ends + _STABLE_S:
            what = "was still growing" if size > 0 else "was not written"
            raise BadInputError(f"{named} ended, but its file {what} within {timeout_s:g} s; correct --trigger.")
        time.sleep(_LOOK_S)
        now = partial.stat().st_size if partial.is_file() else -1
        if now != size:
            size, since = now, time.monotonic()
    os.replace(partial, path)

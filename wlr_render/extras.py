"""Libraries that are installed only with an extra of the package."""

import contextlib
import importlib.metadata
import shlex
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

from wlr_render.errors import BadInputError


class MissingExtraError(BadInputError):
    """A library that is not installed; the sentence has the command that installs it."""


_NO_EXTRA = {"blender": ("--no-deps", "bpy>=5.0", "OpenEXR>=3.3")}
"""Arguments of pip for bpy, which cannot be an extra: it requires NumPy 1, and runs with the NumPy 2 that we need."""


def install_command(extra: str) -> str:
    """Return the command that installs an extra's libraries for the running interpreter.

    The command names the libraries as `pyproject.toml` does, not `wlr_render[extra]`, because the package is not on an
    index, where its name may belong to someone else. It names the interpreter, because the shell's `pip` may belong to
    a different one.
    """
    try:
        stated = importlib.metadata.requires("wlr_render") or []
    except importlib.metadata.PackageNotFoundError:
        stated = []
    named = [each.partition(";") for each in stated]
    libraries = [library.strip() for library, _, when in named if f"extra == '{extra}'" in when.replace('"', "'")]
    libraries = list(_NO_EXTRA.get(extra, libraries))
    if not libraries:  # a checkout that was never installed, or was installed before this extra existed
        libraries = [f"{Path(__file__).resolve().parents[1]}[{extra}]"]
    pip = [sys.executable, "-m", "pip", "install"]
    if find_spec("pip") is None:  # an environment created by uv
        pip = ["uv", "pip", "install", "--python", sys.executable]
    return shlex.join([*pip, *libraries])


@contextlib.contextmanager
def installed_by(extra: str, use: str) -> Iterator[None]:
    """Import an optional library in a `with` block; a failure names the extra that installs it.

    Args:
        extra: the extra of `wlr_render` that installs it, e.g. "exr".
        use: the file or option that needs it, as the start of a sentence.

    Raises:
        MissingExtraError: the library is not installed, or fails to load.
    """
    try:
        yield
    except ImportError as error:
        library = (error.name or "").partition(".")[0]
        fault = f"{library} is not installed" if isinstance(error, ModuleNotFoundError) else f"cannot load: {error}"
        raise MissingExtraError(f"{use}: {fault}; install it: {install_command(extra)}") from error


@contextlib.contextmanager
def script_needs(extra: str) -> Iterator[None]:
    """Import an optional library in a script, like `installed_by`; a failure exits with the sentence."""
    try:
        with installed_by(extra, Path(sys.argv[0]).name):
            yield
    except MissingExtraError as error:
        sys.exit(str(error))

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
"""Arguments of pip for what cannot be an extra: bpy asks for NumPy 1, and runs with the NumPy 2 that we need."""


def install_command(extra: str) -> str:
    """Return the command that installs an extra's libraries for the running interpreter.

    It names the libraries as `pyproject.toml` does, not `wlr_render[extra]`: the package is on no index, where others
    may use its name. It names the interpreter, because the shell's `pip` may be another one's.
    """
    try:
        stated = importlib.metadata.requires("wlr_render") or []
    except importlib.metadata.PackageNotFoundError:
        stated = []
    named = [each.partition(";") for each in stated]
    libraries = [library.strip() for library, _, when in named if f"extra == '{extra}'" in when.replace('"', "'")]
    libraries = list(_NO_EXTRA.get(extra, libraries))
    if not libraries:  # a checkout that was never installed, or not since it has this extra
        libraries = [f"{Path(__file__).resolve().parents[1]}[{extra}]"]
    pip = [sys.executable, "-m", "pip", "install"]
    if find_spec("pip") is None:  # an environment made by uv
        pip = ["uv", "pip", "install", "--python", sys.executable]
    return shlex.join([*pip, *libraries])


@contextlib.contextmanager
def installed_by(extra: str, use: str) -> Iterator[None]:
    """Context manager of the import of a library that not everybody installs.

    Args:
        extra: the extra of `wlr_render` that installs it, e.g. "exr".
        use: what needs it, as the start of a sentence, e.g. the path of a file.

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
    """As `installed_by`, for a script: without the library it ends with the sentence, not with a traceback."""
    try:
        with installed_by(extra, Path(sys.argv[0]).name):
            yield
    except MissingExtraError as error:
        sys.exit(str(error))

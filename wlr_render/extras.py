"""Libraries that are installed only with an extra of the package."""

import contextlib
from collections.abc import Iterator

from wlr_render.errors import BadInputError


class MissingExtraError(BadInputError):
    """A library that is not installed; the sentence has the command that installs it."""


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
        raise MissingExtraError(f"{use}: {fault}; install it: pip install 'wlr_render[{extra}]'.") from error

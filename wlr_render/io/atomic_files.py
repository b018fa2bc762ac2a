"""Paths of shipped files, and atomic writing of every output.

Every output is encoded in memory, written under a temporary name in the same folder, flushed to the disk, and then
renamed: readers never find a partial file, and a full disk or a failed run leaves the old file in place. The writer
locks its temporary file, and a lock ends with its process: an unlocked temporary file belongs to a killed run, and the
next run removes it.
"""

import contextlib
import difflib
import errno
import functools
import io
import os
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.io.escapes import plain_figure
from wlr_render.io.input_files import shown

if sys.platform != "win32":
    import fcntl

if TYPE_CHECKING:
    from matplotlib.figure import Figure

is_cluster_worker = False
"""True while this process runs a task of a job on another machine, whose file locks it may not see."""
_PACKAGE = Path(__file__).resolve().parents[1]
_PART = ".wlr-part-"
"""Start of the names of temporary files."""
NO_DETOUR = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
"""Flags that refuse to follow a link, which may lead to any file, and do not wait for the other end of a pipe."""
_LOCK = ".wlr-render.lock"
"""File that a run locks while it writes into a folder."""


def _umask() -> int:
    """Return the umask of the process. Reading it requires setting it, which is not safe with other threads."""
    umask = os.umask(0)
    os.umask(umask)
    return umask


_FILE_MODE = 0o666 & ~_umask()


def resource(folder: str, name: str = "") -> Path:
    """Return the path of a shipped file: `folder` is "devices", "docs", "scenes" or "shaders".

    These folders are inside the package in a wheel, and next to it in a checkout.
    """
    for root in (_PACKAGE, _PACKAGE.parent):
        path = root / folder / name
        if path.exists():
            return path
    raise BadInputError(f"The shipped file {folder}/{name} is missing: install wlr_render again.")


def shipped_names(folder: str, suffix: str) -> list[str]:
    """Return the stems of the shipped files of one kind, sorted."""
    return sorted(path.stem for path in resource(folder).glob(f"*{suffix}"))


def named_or_path(folder: str, spec: str | Path) -> Path:
    """Return the path of a shipped file by its name, or of any file by its path.

    Raises:
        BadInputError: the file does not exist; the message lists the shipped names.
    """
    path = Path(spec)
    names = shipped_names(folder, ".toml")
    if str(spec) in names:
        return resource(folder, f"{spec}.toml")
    if os.path.isdir(path):  # unlike Path.is_dir, accepts names that no file can have
        model = path / "model.json"
        raise BadInputError(f"{path}: is a folder; name {model if model.is_file() else 'a file in it'}.")
    if path.suffix == ".toml" or len(path.parts) > 1 or os.path.isfile(path):
        if not os.path.exists(path):
            raise BadInputError(f"{path}: there is no such file; correct its name.")
        return path
    close = difflib.get_close_matches(str(spec), names, 1)
    remedy = f"Did you mean {close[0]}?" if close else "Name one of them."
    name = shown(str(spec))
    raise BadInputError(f"{name} is neither a file nor one of the shipped {folder} ({', '.join(names)}). {remedy}")


def output_folder(path: str | Path) -> Path:
    """Create an output folder if necessary, and check that it can be written."""
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        reason = error.strerror or str(error)
        raise BadInputError(f"{folder}: cannot write to this output folder ({reason}); choose another.") from error
    remove_abandoned_once(folder.resolve())
    return folder


@functools.cache  # because a folder may contain many files
def remove_abandoned_once(folder: Path) -> None:
    """Remove the temporary files of killed runs, once per process."""
    _remove_abandoned(folder)


def _remove_abandoned(folder: Path) -> None:
    """Remove temporary files that no process has locked, except on a worker, which may not see the locks of others."""
    for path in () if is_cluster_worker else folder.glob(f"{_PART}*"):
        with contextlib.suppress(OSError), path.open("rb+") as file:
            _lock(file.fileno())
            path.unlink()


def _lock(handle: int) -> None:
    """Lock an open file until it is closed or this process ends.

    Raises:
        BlockingIOError: it is locked already.
        OSError: the operating system or the file system does not support locks.
    """
    if sys.platform == "win32":
        raise OSError(errno.ENOTSUP, os.strerror(errno.ENOTSUP))
    fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)


@contextlib.contextmanager
def locked_folder(path: str | Path, run: str) -> Iterator[None]:
    """Lock an output folder against other runs within a `with` block; create it if necessary.

    At the end, temporary files of killed workers are removed, and a folder created here if it is empty.

    Args:
        path: the folder.
        run: name of this run in the error message of another run.

    Raises:
        BadInputError: the folder cannot be written, or another run has locked it.
    """
    folder = Path(path)
    created = [parent for parent in (folder, *folder.parents) if not parent.exists()]
    lock = output_folder(folder) / _LOCK
    with disk_errors(lock):
        handle = _locked(lock)
    try:
        with contextlib.suppress(OSError):  # the disk may be full
            os.ftruncate(handle, 0)
            os.write(handle, f"{run} (process {os.getpid()})".encode())
        yield
    finally:
        _remove_abandoned(folder.resolve())  # of workers that were killed since the run began
        with contextlib.suppress(OSError):  # the folder may have been removed in the meantime
            lock.unlink()
        os.close(handle)
        with contextlib.suppress(OSError):
            for parent in created:
                parent.rmdir()


def _locked(lock: Path) -> int:
    """Open and lock the lock file of a folder; repeat if another run removes the file before it is locked."""
    while True:
        handle = os.open(lock, os.O_RDWR | os.O_CREAT | NO_DETOUR, _FILE_MODE)
        try:
            _lock(handle)
        except BlockingIOError as error:
            run = os.read(handle, 200).decode(errors="replace") or "another run"
            os.close(handle)
            raise BadInputError(
                f"{lock.parent}: {run} is writing into this folder; wait until it has ended, or choose another folder."
            ) from error
        except OSError:
            pass  # without locks the user must separate the runs
        if os.fstat(handle).st_nlink:
            return handle
        os.close(handle)  # another run removed the file after it was opened here


@contextlib.contextmanager
def written_whole(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path, which is renamed to `path` if the `with` block ends without an error.

    Use it for encoders that need a path, such as video encoders, and `write_bytes` for everything else.

    Raises:
        BadInputError: the folder cannot be written, or the file cannot be flushed.
    """
    target = Path(path)
    output_folder(target.parent)
    with disk_errors(path):
        handle, temporary = _locked_temporary(target)
    try:
        yield temporary
        with disk_errors(path):
            with temporary.open("rb+") as file:
                os.fsync(file.fileno())
            temporary.chmod(_FILE_MODE)
            temporary.replace(target)
    finally:
        temporary.unlink(missing_ok=True)
        os.close(handle)


def _locked_temporary(target: Path) -> tuple[int, Path]:
    """Create and lock a file next to `target`; repeat if another process removes the file before it is locked.

    Returns:
        Handle and path of the file.
    """
    while True:
        handle, name = tempfile.mkstemp(prefix=_PART, suffix=target.suffix, dir=target.parent)
        try:
            _lock(handle)
        except BlockingIOError:
            os.close(handle)
            continue
        except OSError:
            pass  # without locks no process removes temporary files
        if os.fstat(handle).st_nlink:
            return handle, Path(name)
        os.close(handle)


@contextlib.contextmanager
def disk_errors(path: str | Path) -> Iterator[None]:
    """Convert disk errors to a `BadInputError` that says why `path` cannot be written."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        raise BadInputError(f"{path}: cannot be written ({reason}); free space or choose another folder.") from error


def write_bytes(path: str | Path, content: bytes | memoryview) -> Path:
    """Write a file atomically.

    Raises:
        BadInputError: the disk is full, or the folder cannot be written.
    """
    with written_whole(path) as temporary, disk_errors(path):
        temporary.write_bytes(content)
    return Path(path)


def write_text(path: str | Path, text: str) -> Path:
    """Write a UTF-8 text file with `write_bytes`."""
    return write_bytes(path, text.encode("utf-8"))


def write_image(path: str | Path, image: NDArray[np.generic], parameters: Sequence[int] = ()) -> Path:
    """Write an image (colours in BGR order) in the format of the path's suffix.

    Args:
        path: the file.
        image: (height, width) or (height, width, 3).
        parameters: parameters of `cv2.imencode`.

    Raises:
        BadInputError: OpenCV cannot encode this array in this format, or the disk is full.
    """
    import cv2

    try:
        encoded, content = cv2.imencode(Path(path).suffix, image, parameters)
    except cv2.error:
        encoded = False
    if not encoded:
        raise BadInputError(f"{path}: OpenCV cannot write this kind of picture; name it .png.")
    return write_bytes(path, content.data)


def write_figure(path: str | Path, figure: "Figure", dpi: float | None = None) -> Path:
    """Write a matplotlib figure in the format of the path's suffix; `dpi` is the figure's own by default."""
    plain_figure(figure)
    content = io.BytesIO()
    figure.savefig(content, format=Path(path).suffix[1:], dpi=dpi or "figure")
    return write_bytes(path, content.getbuffer())


def write_arrays(path: str | Path, arrays: Mapping[str, NDArray[Any]]) -> Path:
    """Write named arrays as a compressed .npz, without pickled objects."""
    content = io.BytesIO()
    np.savez_compressed(content, allow_pickle=False, **arrays)
    return write_bytes(path, content.getbuffer())

"""Reading of untrusted files: all readers of the package open their files here.

Only regular files of limited size are read, a reference to another file stays inside its folder, and any exception of a
parser becomes one sentence. `LIMITS` has the sizes.
"""

import contextlib
import contextvars
import difflib
import gzip
import hashlib
import io
import math
import os
import re
import reprlib
import stat
import zipfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wlr_render.errors import BadInputError


@dataclass(frozen=True)
class InputLimits:
    """Largest sizes of input; docs/files.md lists them.

    Each limit is at least ten times the size that this program or supported equipment writes, and small enough for 2 GB
    of memory.
    """

    text_bytes: int = 8_000_000
    """TOML, YAML, XML, and other text that a person may have written."""
    data_bytes: int = 64_000_000
    """JSON."""
    record_bytes: int = 256_000_000
    """Ledgers of finished files, which the program writes to continue a job: 350,000 frames."""
    table_bytes: int = 256_000_000
    """CSV and trajectories, decompressed."""
    array_bytes: int = 512_000_000
    """All arrays of an .npz file together, decompressed."""
    rows: int = 2_000_000
    """Observations of a capture file or a table, samples of a trajectory."""
    index: int = 1_000_000
    """Largest index of a capture, a visit, or a target pose."""
    time_s: float = 1e11
    """Largest time stamp, of either sign: 3000 years, as clocks count from 1970 or from any other origin."""
    temperature_c: tuple[float, float] = (-40.0, 65.0)
    """Temperature of a bench in degrees Celsius; room temperature in Fahrenheit or kelvin is above it."""
    captures: int = 2_000
    """Camera places of a capture file."""
    photographs: int = 5_000
    """Photographs of a session or a folder."""
    board_features: int = 100_000
    """Dots, corners or tags of a board."""
    mesh_bytes: int = 512_000_000
    """A mesh, and each file that it refers to."""
    picture_bytes: int = 1_000_000_000
    """A photograph or texture as it is stored."""
    picture_pixels: int = 1 << 27
    """Pixels of a photograph, texture, panel or image to draw: 134 million; the largest cameras have 100 million."""
    picture_side: int = 32_766
    """Width or height in pixels: OpenCV samples longer sides wrongly."""
    eye_box_m: float = 0.2
    """Side of an eye box."""


LIMITS = InputLimits()
_TIFF_WIDTH, _TIFF_HEIGHT = 256, 257  # TIFF tags
_REWRITE = "write it again"
_NEAR = 0.75  # least similarity of a mistyped key or column, as difflib measures it; 'eye' and 'eye_box' have 0.6
_AXES = re.compile(r"(?:^|(?<=_))q?[u-z](?=_|$)")
"""Axes in a key or column: the v of v_axis, the x of aperture_x_mm, the qw of camera_qw."""
_short = reprlib.Repr()
_short.maxstring = _short.maxother = 100
_short.maxdict = _short.maxlist = 4
_outside = contextvars.ContextVar("outside", default=False)
_hashes: contextvars.ContextVar[dict[str, str] | None] = contextvars.ContextVar("hashes", default=None)


@contextlib.contextmanager
def hashes_of_inputs() -> Iterator[dict[str, str]]:
    """Record, in a `with` block, the SHA-256 of every file that is read, by path."""
    hashes: dict[str, str] = {}
    token = _hashes.set(hashes)
    try:
        yield hashes
    finally:
        _hashes.reset(token)


def may_refer_outside() -> bool:
    """Return whether `outside_references` is in force."""
    return _outside.get()


@contextlib.contextmanager
def outside_references() -> Iterator[None]:
    """Allow references to files outside their folder in a `with` block, as `--outside-references` does."""
    token = _outside.set(True)
    try:
        yield
    finally:
        _outside.reset(token)


@contextlib.contextmanager
def as_bad_input(path: str | Path, kind: str, remedy: str = "write it again") -> Iterator[None]:
    """Convert any exception of the parser in a `with` block to a `BadInputError`.

    Args:
        path: path of the file, or a place in the file.
        kind: expected content, e.g. "a mesh".
        remedy: remedy, without a full stop.
    """
    try:
        yield
    except BadInputError:
        raise
    except RecursionError as error:
        raise BadInputError(f"{path}: is nested too deeply to be {kind}; {remedy}.") from error
    except MemoryError as error:
        raise BadInputError(f"{path}: is too large for the memory of this machine; {remedy}.") from error
    except Exception as error:
        raise BadInputError(f"{path}: cannot be read as {kind} ({reason_of(error)}); {remedy}.") from error


@contextlib.contextmanager
def prefix_errors(path: str | Path) -> Iterator[None]:
    """Prefix errors in a `with` block with the file or folder that was read.

    Raises:
        BadInputError: the error of the block, prefixed with the path unless its sentence has it; or a singular matrix,
            because the readings do not determine the fit.
    """
    try:
        yield
    except BadInputError as error:
        if str(path) in str(error):
            raise
        raise type(error)(f"{path}: {error}") from error
    except np.linalg.LinAlgError as error:
        raise BadInputError(
            f"{path}: the readings do not determine the fit ({reason_of(error)}); check that they differ in place, "
            "direction and panel pixel, and that their sigma is right."
        ) from error


def reason_of(error: BaseException) -> str:
    """Return the reason of an exception in at most 200 characters of one line, without OpenCV's source line."""
    if isinstance(error, SystemError) and error.__cause__ is not None:  # raised by OpenCV's constructors
        error = error.__cause__
    reason = getattr(error, "strerror", None) or getattr(error, "err", None) or str(error)
    reason = " ".join(str(reason).split()).rstrip(".")
    if isinstance(error, KeyError) or not reason:
        reason = f"{type(error).__name__} {reason}".rstrip()
    return reason if len(reason) <= 200 else reason[:200] + "..."


def shown(value: object, quoted: bool = True) -> str:
    """Represent any value for an error: one line of about 100 characters, control characters escaped.

    Args:
        value: value from a file or a caller; an array is described by its shape and type.
        quoted: False leaves out the quotes of a text.
    """
    if isinstance(value, np.ndarray) and value.ndim:
        return f"an array of shape {value.shape} and type {value.dtype}"
    try:
        text = _short.repr(value).replace("\n", " ")
    except (ValueError, RecursionError):  # an integer of more than 4300 digits, or deep nesting
        return f"a large {type(value).__name__}"
    return text if quoted else text[1:-1]


def near_spelling(name: str, others: Iterable[str]) -> str | None:
    """Return the key or column that is spelled most like `name`, to be suggested for it; None if none is near.

    Keys of another axis are not suggested: v_axis is not a misspelled u_axis.
    """
    axes = _AXES.findall(name)
    of_same_axes = [other for other in others if not axes or _AXES.findall(other) in ([], axes)]
    return next(iter(difflib.get_close_matches(name[:100], of_same_axes, 1, _NEAR)), None)


def read_bytes(path: str | Path, at_most: int, remedy: str = "name another file") -> bytes:
    """Read a regular file.

    Raises:
        BadInputError: the file is missing, a folder, a pipe or a device, has more than `at_most` bytes, or cannot be
            read.
    """
    try:
        with open(path, "rb", opener=_open_at_once) as file:
            status = os.fstat(file.fileno())
            if not stat.S_ISREG(status.st_mode):
                raise BadInputError(f"{path}: is a pipe or a device, not a regular file; {remedy}.")
            # A growing file, or one on a file system without sizes, may be longer than its stated size.
            content = file.read(at_most + 1) if status.st_size <= at_most else None
    except IsADirectoryError as error:
        raise BadInputError(f"{path}: is a folder; {remedy}.") from error
    except FileNotFoundError as error:
        raise BadInputError(f"{path}: there is no such file; {remedy}.") from error
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        if isinstance(error, BadInputError):
            raise
        raise BadInputError(f"{path}: cannot be read ({reason_of(error)}); {remedy}.") from error
    except MemoryError as error:
        raise BadInputError(f"{path}: is too large for the memory of this machine; {remedy}.") from error
    if content is None or len(content) > at_most:
        raise BadInputError(f"{path}: has more than {_size(at_most)}, the most that is read here; {remedy}.")
    if (hashes := _hashes.get()) is not None:
        hashes[str(path)] = hashlib.sha256(content).hexdigest()
    return content


def _open_at_once(path: str, flags: int) -> int:
    """Open a file without waiting for a writer, as opening a pipe does."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def read_text(path: str | Path, kind: str, at_most: int = LIMITS.text_bytes, remedy: str = "name another file") -> str:
    """Read a regular file of UTF-8 text, with or without byte order mark.

    Raises:
        BadInputError: as `read_bytes`, or the file is not text; the message says that it is not `kind`.
    """
    return decode_text(path, read_bytes(path, at_most, remedy), kind, remedy)


def decode_text(path: str | Path, content: bytes, kind: str, remedy: str = "name another file") -> str:
    """Decode UTF-8 text in memory; arguments, result and errors as `read_text`."""
    try:
        return content.decode("utf-8").removeprefix("\ufeff")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise BadInputError(f"{path}: line {line} is not UTF-8 text, so this is not {kind}; {remedy}.") from error


def gunzip(path: str | Path, content: bytes, at_most: int) -> bytes:
    """Decompress the content of a gzip file.

    Raises:
        BadInputError: the content is not gzip, is cut short, or has more than `at_most` bytes decompressed.
    """
    with as_bad_input(path, "a gzip file", _REWRITE), gzip.open(io.BytesIO(content)) as file:
        try:
            whole = file.read(at_most + 1)
        except EOFError as error:
            raise BadInputError(f"{path}: is cut short; {_REWRITE}.") from error
    if len(whole) > at_most:
        raise BadInputError(f"{path}: decompresses to more than {_size(at_most)}; {_REWRITE}.")
    return whole


def read_arrays(path: str | Path, kind: str) -> dict[str, NDArray[Any]]:
    """Read the named arrays of an .npz file, without pickled objects.

    Raises:
        BadInputError: as `read_bytes`, or the file is not `kind`.
    """
    content = io.BytesIO(read_bytes(path, LIMITS.array_bytes, _REWRITE))
    with as_bad_input(path, kind, _REWRITE), zipfile.ZipFile(content) as archive:
        promised = sum(entry.file_size for entry in archive.infolist())
        if promised > LIMITS.array_bytes:
            raise BadInputError(f"{path}: decompresses to more than {_size(LIMITS.array_bytes)}; {_REWRITE}.")
        content.seek(0)
        with np.load(content, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
    for name, values in arrays.items():
        if not isinstance(values, np.ndarray):  # a member of the archive that is not an array
            raise BadInputError(f"{path}: '{name}' is not an array, so this is not {kind}; {_REWRITE}.")
    return arrays


def read_image(path: str | Path, flags: int, remedy: str = "name another picture") -> NDArray[Any]:
    """Read a picture as OpenCV stores it, (height, width) or (height, width, channels) in BGR order.

    Args:
        path: picture of any format that OpenCV reads.
        flags: flags of `cv2.imdecode`.
        remedy: remedy, without a full stop.

    Raises:
        BadInputError: as `read_bytes`, or the file is not a picture or has more pixels than `LIMITS` allows.
    """
    content = read_bytes(path, LIMITS.picture_bytes, remedy)
    return decode_image(path, content, flags, remedy)


def decode_image(path: str | Path, content: bytes, flags: int, remedy: str = "name another picture") -> NDArray[Any]:
    """Decode a picture in memory; arguments, result and errors as `read_image`."""
    import cv2

    require_picture(path, content, remedy)
    with as_bad_input(path, "a picture", remedy):
        image = cv2.imdecode(np.frombuffer(content, dtype=np.uint8), flags)
        if image is None:
            raise ValueError("it is damaged")
        return np.asarray(image)


def require_picture(where: str | Path, content: bytes, remedy: str = "store the picture again") -> None:
    """Refuse a file that is not a picture, or has more pixels than `LIMITS` allows, without decoding it."""
    with as_bad_input(where, "a picture", remedy):
        require_pixels(where, _stated_size(content), remedy)


def require_pixels(
    path: str | Path, size: Sequence[float] | NDArray[np.float64], remedy: str = "name another picture"
) -> None:
    """Refuse a picture of more pixels than `LIMITS` allows; `size` is its width and height in pixels."""
    if math.prod(size) > LIMITS.picture_pixels or max(size) > LIMITS.picture_side:
        most = f"{LIMITS.picture_pixels / 1e6:.0f} million, or more than {LIMITS.picture_side} on one side"
        raise BadInputError(f"{path}: has {size[0]:.0f}x{size[1]:.0f} pixels, more than {most}; {remedy}.")


def _stated_size(content: bytes) -> tuple[int, int]:
    """Return the width and height that a picture's header states, before a decoder allocates memory."""
    from PIL import Image, UnidentifiedImageError
    from PIL.TiffImagePlugin import ImageFileDirectory_v2

    stream = io.BytesIO(content)
    try:
        with Image.open(stream) as picture:
            return picture.width, picture.height
    except UnidentifiedImageError:
        # Pillow does not know the two types of float maps.
        if pfm := re.match(rb"PF\s+(\d{1,9})\s+(\d{1,9})\s", content):
            return int(pfm[1]), int(pfm[2])
        if content[:4] not in (b"II*\0", b"MM\0*"):
            raise ValueError("its format is not known") from None
        tags = ImageFileDirectory_v2(content[:8])
        stream.seek(tags.next)
        tags.load(stream)
        return int(tags[_TIFF_WIDTH]), int(tags[_TIFF_HEIGHT])
    except Image.DecompressionBombError:
        raise ValueError(f"it has more than {LIMITS.picture_pixels / 1e6:.0f} million pixels") from None


def inside_folder(folder: str | Path, name: str, where: str) -> Path:
    """Return the path of a file that another file refers to.

    Args:
        folder: folder of the file that refers to it.
        name: the reference, relative to the folder.
        where: the file and key of the reference, for the sentence.

    Raises:
        BadInputError: the reference leads out of the folder, and `outside_references` is not in force.
    """
    path = Path(folder) / name
    try:
        is_inside = path.resolve().is_relative_to(Path(folder).resolve())
    except (OSError, ValueError, RuntimeError) as error:
        raise BadInputError(f"{where}: {shown(name)} is not the name of a file ({reason_of(error)}).") from error
    if not is_inside and not may_refer_outside():
        raise BadInputError(
            f"{where}: {shown(name)} leads out of the folder {folder}; copy the file into it, or add "
            "--outside-references if you trust this file."
        )
    return path


def require_length(where: str, length: ArrayLike, at_most: float, unit: str = "m") -> None:
    """Refuse lengths that are not finite or too large, such as millimetres in place of metres.

    Args:
        where: the file and key or column of the lengths.
        length: any shape, in `unit`.
        at_most: the largest plausible absolute value.
        unit: "m" or "mm".
    """
    values = np.abs(np.asarray(length, dtype=np.float64))
    largest = float(values.max(initial=0.0))
    if not math.isfinite(largest):
        raise BadInputError(f"{where} has a length that is not finite; correct it.")
    if largest > at_most:
        full, smaller = ("metres", "millimetres") if unit == "m" else ("millimetres", "micrometres")
        raise BadInputError(
            f"{where} has a length of {largest:g} {unit}, more than the plausible {at_most:g} {unit}; is it in "
            f"{smaller}? Convert it to {full}."
        )


def require_eye_box(where: str, size: ArrayLike, unit: str = "m") -> None:
    """Refuse an eye box with sides (3,), in m or mm, that are negative or larger than `LIMITS` allows."""
    sides = np.asarray(size, dtype=np.float64)
    require_length(where, sides, LIMITS.eye_box_m * (1.0 if unit == "m" else 1e3), unit)
    if np.any(sides < 0):
        raise BadInputError(f"{where} has a negative size, {sides.tolist()}; correct it.")


def _size(count: int) -> str:
    return f"{count / 1e6:g} MB"

"""Read and write photographs: linear values of one channel, 8 to 16 bits."""

import contextlib
import io
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.photograph_format import PhotographFormat, is_left_justified
from wlr_render.errors import BadInputError
from wlr_render.io.atomic_files import write_image
from wlr_render.io.input_files import LIMITS, as_bad_input, decode_image, read_bytes, require_pixels

Photograph = NDArray[np.unsignedinteger[Any]]
"""(h, w) linear values of one channel, uint8 or uint16; a saturated pixel has its format's `full_scale`."""
CodeImage = Photograph | NDArray[np.float32]
"""A photograph of a code picture, or several merged exposures of it."""

_AGAIN = "take it again, or leave it out"
_EXIF, _EXPOSURE_TIME = 0x8769, 0x829A  # EXIF tags
_BLACK = 0.01  # largest 95th percentile of a black picture, as a share of full scale
_BRIGHTEST = 99.5  # percentile of grey values that becomes white for detectors, which need 8 bits
_WELL_EXPOSED = 128.0  # bright percentile from which 8-bit pictures stay unchanged
_RAW = (".dng", ".nef", ".cr2", ".cr3", ".arw", ".raf")
SUFFIXES = (".png", ".tif", ".tiff", ".bmp", ".pgm", ".jpg", ".jpeg", ".npy", *_RAW)


class BadPhotographError(BadInputError):
    """Error for an unusable photograph, e.g. black or cut short; the message names it and the reason."""


def read_photograph(path: str | Path, kind: PhotographFormat | None = None) -> Photograph:
    """Read one photograph as (h, w), uint8 or uint16, linear values of one channel.

    Orientation tags are ignored: pixels stay where the sensor has them.

    Args:
        path: PNG, TIFF, BMP, PGM, JPEG or NumPy file; a raw file if `rawpy` is installed.
        kind: format of the camera's files. None: grey values that fill the bits of the file.

    Raises:
        BadInputError: the file is missing, or its values do not fit the format.
        BadPhotographError: the file is not a picture, or is cut short.
    """
    return _converted(_stored_values(Path(path)), path, kind)


def _converted(stored: Photograph, path: str | Path, kind: PhotographFormat | None) -> Photograph:
    return (kind or PhotographFormat(bits=8 * stored.itemsize)).convert(stored, str(path))


def file_note(path: Path, kind: PhotographFormat) -> str:
    """Describe detected properties of a camera's files that are not stated; may be empty."""
    if kind.left_justified is None and kind.bits < 16 and is_left_justified(_stored_values(path), kind.bits):
        return (
            f"{path.name}: values of {kind.bits} bits fill the upper bits of 16 and were shifted down; state "
            "left_justified = true in the camera's table if all files are so."
        )
    return ""


def _stored_values(path: Path) -> Photograph:
    """Return the stored values (h, w), or (h, w, 3) red, green, blue; uint8 or uint16."""
    content = read_bytes(path, LIMITS.picture_bytes, "take the photograph, or correct its name")
    if path.suffix.lower() == ".npy":
        stored = _numpy_array(path, content)
    elif path.suffix.lower() in _RAW:
        stored = _raw_picture(path, content)
    else:
        flags = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR | cv2.IMREAD_IGNORE_ORIENTATION
        with _decoding(path):
            image = decode_image(path, content, flags, _AGAIN)
        stored = np.asarray(image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2RGB))
    if 0 in stored.shape:
        raise BadPhotographError(f"{path}: has no pixels; {_AGAIN}.")
    if stored.dtype not in (np.uint8, np.uint16):
        raise BadInputError(f"{path}: holds {stored.dtype} values; a photograph must have 8 or 16 bits.")
    return stored


@contextlib.contextmanager
def _decoding(path: Path) -> Iterator[None]:
    """Convert any exception of a decoder in a `with` block to a `BadPhotographError`."""
    try:
        with as_bad_input(path, "a photograph", _AGAIN):
            yield
    except BadInputError as error:
        raise BadPhotographError(str(error)) from error


def _numpy_array(path: Path, content: bytes) -> Photograph:
    with _decoding(path):
        stored: Any = np.lib.format.read_array(io.BytesIO(content), allow_pickle=False)
    if not isinstance(stored, np.ndarray) or stored.ndim not in (2, 3) or stored.shape[2:] not in ((), (3,)):
        raise BadInputError(f"{path}: must hold (height, width) values, or (height, width, 3) red, green and blue.")
    require_pixels(path, stored.shape[1::-1], _AGAIN)
    return np.asarray(stored)


def _raw_picture(path: Path, content: bytes) -> Photograph:
    try:
        import rawpy
    except ImportError as error:
        raise BadInputError(
            f"{path}: raw files need the package rawpy, which is not installed; install it, or convert to .tiff."
        ) from error
    with _decoding(path), rawpy.imread(io.BytesIO(content)) as raw:
        require_pixels(path, (raw.sizes.width, raw.sizes.height), _AGAIN)
        return np.asarray(raw.raw_image_visible.copy())


def exposure_of(path: Path) -> float | None:
    """Return the exposure time in seconds that a JPEG or TIFF file states; None if it states none."""
    if path.suffix.lower() not in (".jpg", ".jpeg", ".tif", ".tiff"):
        return None
    from PIL import Image

    try:
        content = io.BytesIO(read_bytes(path, LIMITS.picture_bytes))
        with as_bad_input(path, "a picture"), Image.open(content) as image:
            tags = image.getexif()
            time = tags.get_ifd(_EXIF).get(_EXPOSURE_TIME, tags.get(_EXPOSURE_TIME))
            return None if time is None or not 0 < float(time) < np.inf else float(time)
    except BadInputError:
        return None  # reading the picture will report the fault


def check_photograph(
    image: CodeImage, size_px: tuple[int, int], kind: PhotographFormat, name: str, merged_from: float | None = None
) -> None:
    """Refuse a photograph that is black, blown out, or not of its camera's size.

    Args:
        image: (h, w).
        size_px: width and height of the camera's photographs.
        kind: format of its file.
        name: name of the photograph, for the error.
        merged_from: value from which an image merged from several exposures is saturated.

    Raises:
        BadInputError: its size differs from the camera's.
        BadPhotographError: it is black or blown out.
    """
    height, width = image.shape
    if (width, height) != tuple(size_px):
        raise BadInputError(
            f"{name}: is {width} x {height} pixels, but its camera has {size_px[0]} x {size_px[1]}; "
            "take it again, or correct the camera's size."
        )
    dark, bright = np.percentile(image, [5, 95])
    if bright < _BLACK * kind.full_scale:
        raise BadPhotographError(f"{name}: is black; nothing can be found in it.")
    if dark >= (merged_from or kind.full_scale) and not kind.synthetic:
        raise BadPhotographError(f"{name}: is blown out; nothing can be found in it.")


def write_photograph(path: str | Path, image: Photograph) -> Path:
    """Write (h, w) uint8 or uint16 as .png or .tif, atomically."""
    # Noise does not compress: a higher compression level only takes longer.
    return write_image(path, image, [cv2.IMWRITE_PNG_COMPRESSION, 1])


def as_bytes(image: Photograph) -> NDArray[np.uint8]:
    """Convert a picture to 8 bits for detectors, with 16-bit or under-exposed values scaled to near 255."""
    brightest = float(np.percentile(image, _BRIGHTEST))
    if image.dtype == np.uint8 and not 0 < brightest < _WELL_EXPOSED:
        return np.asarray(image, dtype=np.uint8)
    scaled = np.minimum(image.astype(np.float32) * (255.0 / max(brightest, 1.0)), 255.0)
    return np.asarray(np.rint(scaled), dtype=np.uint8)


def photographs_in(folder: str | Path) -> list[Path]:
    """Return the photographs of a folder in natural order of their names (2 before 10).

    Raises:
        BadInputError: the folder is missing or has no photographs.
    """
    if not Path(folder).is_dir():
        raise BadInputError(f"{folder}: there is no such folder of photographs; name another one.")
    with as_bad_input(folder, "a folder of photographs", "name another folder"):
        paths = [path for path in Path(folder).iterdir() if path.suffix.lower() in SUFFIXES and path.name[0] != "."]
    if len(paths) > LIMITS.photographs:
        raise BadInputError(f"{folder}: holds {len(paths)} photographs, more than {LIMITS.photographs}; split it.")
    if not paths:
        raise BadInputError(f"{folder}: holds no photographs ({', '.join(SUFFIXES)}); name another folder.")
    return sorted(paths, key=_natural)


def read_each(paths: Sequence[Path], kind: PhotographFormat | None = None) -> Iterator[Photograph]:
    """Read photographs one at a time, all of one size.

    Raises:
        BadInputError: as `read_photograph`, or a photograph's size differs from the first.
    """
    first = ""
    for path in paths:
        stored = _stored_values(path)
        image = _converted(stored, path, kind)
        pixels = describe_pixels(image) + (" in colour" if stored.ndim == 3 else "")
        first = first or pixels
        if pixels != first:
            raise BadInputError(f"{path}: is {pixels}, but {paths[0].name} is {first}; a set must have one format.")
        yield image


def describe_pixels(image: CodeImage) -> str:
    """Return the size and depth, e.g. "1280 x 1024 pixels of 8 bits"."""
    return f"{' x '.join(map(str, image.shape[::-1]))} pixels of {8 * image.itemsize} bits"


def _natural(path: Path) -> list[tuple[int, str]]:
    """Return a sorting key of a name with digits as numbers: 2 before 10."""
    parts = re.split(r"(\d+)", path.name)
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in parts]

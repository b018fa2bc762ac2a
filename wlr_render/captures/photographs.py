"""Read and write photographs: unprocessed grey values of 8 to 16 bits."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.files import write_image

Photograph = NDArray[np.unsignedinteger[Any]]
"""(h, w) grey, uint8 or uint16, as it came from the camera."""

_BLACK = 0.01  # of full scale: where the brightest twentieth of a picture is darker, it is black
SUFFIXES = (".png", ".tif", ".tiff", ".bmp", ".pgm", ".jpg", ".jpeg")


class BadPhotographError(BadInputError):
    """An unusable photograph, e.g. black or cut short; the message names it and the reason."""


def read_photograph(path: str | Path) -> Photograph:
    """Read one photograph as (h, w), uint8 or uint16; of a coloured one its grey value.

    Raises:
        BadInputError: there is no such file, or it does not have 8 or 16 bits.
        BadPhotographError: the file is no picture, or is cut short.
    """
    if not Path(path).is_file():
        raise BadInputError(f"{path}: there is no such photograph; take it, or correct its name.")
    image = cv2.imread(str(path), cv2.IMREAD_ANYDEPTH | cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise BadPhotographError(f"{path}: cannot be read as a picture; take it again, or leave it out.")
    if image.dtype not in (np.uint8, np.uint16):
        raise BadInputError(f"{path}: holds {image.dtype} values; a photograph must have 8 or 16 bits.")
    return np.asarray(image)


def check_photograph(image: Photograph, size_px: tuple[int, int], full_scale: int, name: str) -> None:
    """Refuse a photograph of another size or depth than its camera's, or that is black or blown out.

    Raises:
        BadInputError: it has another size than the camera, or brighter values than the camera can give.
        BadPhotographError: it is black or blown out.
    """
    height, width = image.shape
    if full_scale > np.iinfo(image.dtype).max:
        raise BadInputError(
            f"{name}: has {8 * image.itemsize} bits a pixel, too few for a camera with values up to {full_scale}; "
            "check its 'bits'."
        )
    if (width, height) != tuple(size_px):
        raise BadInputError(
            f"{name}: is {width} x {height} pixels, but its camera has {size_px[0]} x {size_px[1]}; "
            "take it again, or correct the camera's size."
        )
    dark, bright = np.percentile(image, [5, 95])
    if image.max() > full_scale:
        raise BadInputError(
            f"{name}: has values up to {image.max()}, beyond the camera's {full_scale}; check its 'bits'."
        )
    if bright < _BLACK * full_scale:
        raise BadPhotographError(f"{name}: is black; nothing can be found in it.")
    if dark >= full_scale:
        raise BadPhotographError(f"{name}: is blown out; nothing can be found in it.")


def write_photograph(path: str | Path, image: Photograph) -> Path:
    """Write (h, w) uint8 or uint16 as .png or .tif, whole or not at all."""
    # Noise does not compress: more effort only takes longer.
    return write_image(path, image, [cv2.IMWRITE_PNG_COMPRESSION, 1])


def photographs_in(folder: str | Path) -> list[Path]:
    """The photographs of a folder in the order of their names; numbers in names count as numbers.

    Raises:
        BadInputError: there is no such folder, or no photograph in it.
    """
    if not Path(folder).is_dir():
        raise BadInputError(f"{folder}: there is no such folder of photographs.")
    found = [path for path in Path(folder).iterdir() if path.suffix.lower() in SUFFIXES and path.name[0] != "."]
    if not found:
        raise BadInputError(f"{folder}: holds no photographs ({', '.join(SUFFIXES)}).")
    return sorted(found, key=_natural)


def read_each(paths: Sequence[Path]) -> Iterator[Photograph]:
    """Read photographs one at a time, all of one size.

    Raises:
        BadInputError: as `read_photograph`, or a photograph is not of the size of the first.
    """
    first = ""
    for path in paths:
        image = read_photograph(path)
        kind = describe_pixels(image)
        first = first or kind
        if kind != first:
            raise BadInputError(f"{path}: is {kind}, but {paths[0].name} is {first}; all of a set must be alike.")
        yield image


def describe_pixels(image: Photograph) -> str:
    """Size and depth, e.g. "1280 x 1024 pixels of 8 bits"."""
    return f"{' x '.join(map(str, image.shape[::-1]))} pixels of {8 * image.itemsize} bits"


def _natural(path: Path) -> list[tuple[int, str]]:
    """Digits as numbers: 2 before 10."""
    import re

    parts = re.split(r"(\d+)", path.name)
    return [(int(part), "") if part.isdigit() else (-1, part) for part in parts]

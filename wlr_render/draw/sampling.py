"""Image interpolation at sub-pixel positions with OpenCV, whose pixel centres are integers.

Everywhere else in this package (0, 0) is the outer corner of the top-left pixel and centres lie at +0.5. `cv2.remap`
has full precision only for float32 and uint8 images of 1, 3 or 4 channels (OpenCV 5); others are refused here.
"""

from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from wlr_render.errors import BadInputError
from wlr_render.io.input_files import LIMITS
from wlr_render.numerics.arrays import Float32Array

_Pixel = TypeVar("_Pixel", bound=np.generic)

_LONGEST = LIMITS.picture_side  # cv2.remap indexes with 16 bits
_ROW = 1024
"""Width of the image in which scattered positions are passed to cv2.remap."""


def bilinear_at(image: NDArray[_Pixel], u: Float32Array, v: Float32Array) -> NDArray[_Pixel]:
    """Sample bilinearly; beyond the centres of its outermost pixels the image continues with their values.

    Args:
        image: (height, width) or (height, width, c), float32 or uint8, c of 1, 3 or 4, sides of at most 32766 px.
        u, v: (n,) or (rows, columns) finite float32 pixel positions, centres at +0.5.

    Returns:
        (n,) or (rows, columns), with the image's channels and type.
    """
    half = np.float32(0.5)
    if u.ndim == 2 and max(u.shape) <= _LONGEST:
        return _cv2_remap(image, u - half, v - half)
    count = u.size
    rows = max(1, -(-count // _ROW))
    position = np.zeros((2, rows, _ROW), np.float32)
    np.subtract(u.reshape(-1), half, out=position[0].reshape(-1)[:count])
    np.subtract(v.reshape(-1), half, out=position[1].reshape(-1)[:count])
    parts = [
        _cv2_remap(image, position[0, start : start + _LONGEST], position[1, start : start + _LONGEST])
        for start in range(0, rows, _LONGEST)
    ]
    flat = np.concatenate(parts).reshape(rows * _ROW, *image.shape[2:])[:count]
    return flat.reshape(*u.shape, *image.shape[2:])


def _cv2_remap(image: NDArray[_Pixel], x: Float32Array, y: Float32Array) -> NDArray[_Pixel]:
    result = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(result).reshape(*x.shape, *image.shape[2:])


def remap(
    image: NDArray[_Pixel], source_pixel: NDArray[np.floating], background: ArrayLike = 0
) -> tuple[NDArray[_Pixel], NDArray[np.bool_]]:
    """Sample an image bilinearly at any positions.

    Args:
        image: (height, width) or (height, width, c), float32 or uint8, c of 1, 3 or 4, sides of at most 32766 px.
        source_pixel: (..., 2), centres at +0.5; NaN for the background. Rounded to float32, about 1e-4 px in 2000.
        background: value outside the image: a number, or one per channel.

    Returns:
        Samples (...) or (..., c) of the image's type, and whether the position lies inside the image, (...).

    Raises:
        BadInputError: an image that OpenCV would sample wrongly or not at all.
    """
    _refuse_unfit(image)
    inside = _inside(image, source_pixel)
    position = np.where(inside[..., None], source_pixel, 0.5).astype(np.float32)
    sampled = bilinear_at(image, position[..., 0], position[..., 1])
    if not inside.all():
        sampled[~inside] = background
    return sampled, inside


def _inside(image: NDArray[np.generic], source_pixel: NDArray[np.floating]) -> NDArray[np.bool_]:
    height, width = image.shape[:2]
    u, v = source_pixel[..., 0], source_pixel[..., 1]
    return np.asarray((u >= 0) & (u <= width) & (v >= 0) & (v <= height))


def _refuse_unfit(image: NDArray[np.generic]) -> None:
    channels = image.shape[2] if image.ndim == 3 else 1
    if image.ndim not in (2, 3) or channels not in (1, 3, 4) or image.dtype not in (np.float32, np.uint8):
        raise BadInputError(
            f"An image of shape {image.shape} and type {image.dtype} cannot be sampled exactly; "
            "give float32 or uint8 with 1, 3 or 4 channels."
        )
    if not 0 < min(image.shape[:2]) <= max(image.shape[:2]) <= _LONGEST:
        raise BadInputError(
            f"An image of {image.shape[1]} x {image.shape[0]} px cannot be sampled; each side must be 1 to "
            f"{_LONGEST} px: cut it into tiles."
        )

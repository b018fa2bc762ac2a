"""OpenCV's Gray-code decoder (`cv2.structured_light`, in its contrib build only), for comparison with ours."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.photographs import Photograph
from wlr_render.mappings import Panel
from wlr_render.numerics.arrays import IntArray

MISSING = (
    "This OpenCV has no cv2.structured_light. Install "
    "opencv-contrib-python-headless in place of opencv-python-headless, in a separate environment."
)

_BLACK_THRESHOLD = 40  # OpenCV's defaults, in grey values of 255: of white over black,
_WHITE_THRESHOLD = 5  # and of a bit over its inverse


@dataclass(frozen=True, eq=False)
class OpencvCodes:
    """Codes that OpenCV decodes.

    Attributes:
        code: (n, 2) whole panel pixel (column, row).
        accepted: (n,) whether OpenCV accepts the camera pixel.
    """

    code: IntArray
    accepted: NDArray[np.bool_]


def has_opencv_decoder() -> bool:
    """Whether this OpenCV was built with the module."""
    return hasattr(cv2, "structured_light")


def opencv_codes(photographs: Iterable[Photograph], panel: Panel, camera_pixel: IntArray) -> OpencvCodes:
    """Decode 8-bit photographs, white and black first, at camera pixels (n, 2) given as (column, row).

    Only the values at these pixels are kept, as strips one pixel high, because the decoder needs all pictures at once.
    """
    column, row = np.asarray(camera_pixel).T
    strips = [np.ascontiguousarray(photograph[row, column][None]) for photograph in photographs]
    white, black, bits = strips[0].astype(np.int64), strips[1].astype(np.int64), strips[2:]
    module: Any = cv2.structured_light  # type: ignore[attr-defined]  # absent from the stubs
    decoder = module.GrayCodePattern.create(panel.width_px, panel.height_px)
    decoder.setWhiteThreshold(_WHITE_THRESHOLD)
    answers = [decoder.getProjPixel(bits, place, 0) for place in range(len(column))]
    clear = np.array([not unclear for unclear, _ in answers], dtype=bool)
    code = np.array([place for _, place in answers], dtype=np.int64).reshape(-1, 2)
    return OpencvCodes(code, clear & ((white - black)[0] > _BLACK_THRESHOLD))

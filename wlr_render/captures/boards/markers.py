"""Markers of OpenCV's dictionaries: their names, their bits as cells on a board, and their detection."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.lenses.lens_camera import OPENCV_PIXEL_SHIFT
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray


def dictionary_of(name: str) -> cv2.aruco.Dictionary:
    """Return OpenCV's dictionary by name, e.g. "DICT_5X5_1000".

    Raises:
        BadInputError: the name is unknown; the message lists all names.
    """
    if name not in DICTIONARIES:
        raise BadInputError(f"there is no dictionary '{name}'; choose from {', '.join(DICTIONARIES)}.")
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


DICTIONARIES = tuple(sorted(name for name in dir(cv2.aruco) if name.startswith("DICT_")))
LARGEST_DICTIONARIES = tuple(
    name
    for name in DICTIONARIES
    if not name.endswith(("_50", "_100", "_250")) and not (name[-3] == "H" and name.replace("H", "h") in DICTIONARIES)
)
"""Largest dictionaries, each under one name; they contain all markers of the others."""


def marker_cells(
    dictionary: cv2.aruco.Dictionary, number: int, corner: FloatArray, side: float, border_bits: int = 1
) -> tuple[FloatArray, BoolArray]:
    """Return a marker's bits with its border: (k, 4) left, top, right and bottom, and a mask (k,) of black ones.

    Args:
        dictionary, number: the marker.
        corner: (2,) its top left corner, metres.
        side: side of the marker with its border, metres.
        border_bits: width of the border in bits.
    """
    bits = dictionary.markerSize + 2 * border_bits
    picture = dictionary.generateImageMarker(number, bits, borderBits=border_bits)
    row, column = np.divmod(np.arange(bits**2), bits)
    low = corner + np.stack([column, row], axis=-1) * (side / bits)
    high = corner + np.stack([column + 1, row + 1], axis=-1) * (side / bits)
    return np.concatenate([low, high], axis=1), picture.ravel() == 0


def detect_markers(dictionary: str, grey: NDArray[np.uint8], border_bits: int = 1) -> tuple[FloatArray, IntArray]:
    """Return the corners (n, 4, 2) and numbers (n,) of a dictionary's markers in a picture, see `markers_of_opencv`."""
    how = cv2.aruco.DetectorParameters()
    how.markerBorderBits = border_bits
    corners, numbers, _ = cv2.aruco.ArucoDetector(dictionary_of(dictionary), how).detectMarkers(grey)
    return markers_of_opencv(corners, numbers)


def markers_of_opencv(corners: Any, numbers: Any) -> tuple[FloatArray, IntArray]:
    """Convert a detector's results to corners (n, 4, 2), pixels from the picture's outer corner, and numbers (n,)."""
    pixel = np.array(corners, dtype=np.float64).reshape(-1, 4, 2) - OPENCV_PIXEL_SHIFT
    return pixel, np.zeros(0, dtype=np.int64) if numbers is None else np.asarray(numbers, np.int64).ravel()


def marker_areas(corners: FloatArray) -> FloatArray:
    """Return the areas (n,) of markers by their corners (n, 4, 2)."""
    return np.array([cv2.contourArea(each.astype(np.float32)) for each in corners])

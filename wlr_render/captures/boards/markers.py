"""Markers of OpenCV's dictionaries: their names, and their bits as cells on a board."""

import cv2
import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.numerics.arrays import BoolArray, FloatArray


def dictionary_of(name: str) -> cv2.aruco.Dictionary:
    """Return OpenCV's dictionary by name, e.g. "DICT_5X5_1000".

    Raises:
        BadInputError: the name is unknown; the sentence lists all names.
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
"""Dictionaries that hold all markers of the others, under one name each."""


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

"""Reading the calibrated lenses of other programs: mrcal's .cameramodel, and OpenCV's and ROS' YAML, XML and JSON.

Both count pixels from the centre of the top-left one; they are converted. What else the files say is not read: poses,
and mrcal's record of its optimisation, from which mrcal computes the uncertainty of the lens.
"""

import ast
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.geometry.lens import Lens
from wlr_render.geometry.lens_camera import LENS_KINDS, OPENCV_PIXEL_SHIFT, LensCamera
from wlr_render.geometry.splined_lens import SplinedLens
from wlr_render.numerics.arrays import FloatArray

_MRCAL_MODELS = {  # number of distortion terms, and the kind of lens
    "LENSMODEL_PINHOLE": (0, "brown"),
    "LENSMODEL_OPENCV4": (4, "brown"),
    "LENSMODEL_OPENCV5": (5, "brown"),
    "LENSMODEL_OPENCV8": (8, "rational"),
    "LENSMODEL_OPENCV12": (12, "thin-prism"),
}
_SPLINED = re.compile(
    r"LENSMODEL_SPLINED_STEREOGRAPHIC_order=(?P<order>\d+)_Nx=(?P<nx>\d+)_Ny=(?P<ny>\d+)_fov_x_deg=(?P<fov>[\d.]+)"
)

_MATRIX_KEYS = ("camera_matrix", "cameraMatrix", "Camera_Matrix", "K", "cameraMatrix1", "M1")
_TERM_KEYS = (
    "distortion_coefficients",
    "Distortion_Coefficients",
    "dist_coeffs",
    "distCoeffs",
    "D",
    "distCoeffs1",
    "D1",
)
_WIDTH_KEYS, _HEIGHT_KEYS = ("image_width", "image_Width", "width"), ("image_height", "image_Height", "height")
_SIZE_KEYS = ("image_size", "imageSize")
_MODEL_KEYS = ("distortion_model", "camera_model")
_FISHEYE_KEYS = ("fisheye_model", "fisheye")
_FISHEYE_NAMES = ("equidistant", "fisheye", "kannala_brandt")
_PERSPECTIVE_NAMES = ("plumb_bob", "rational_polynomial", "pinhole", "brown", "thin_prism")
_KIND_OF_COUNT = {0: "brown", 4: "brown", 5: "brown", 8: "rational", 12: "thin-prism"}
_TILTED = 14  # terms of OpenCV's tilted sensor model: those of "thin-prism", and two angles
_SKEW = 1e-9  # largest skew taken for zero, relative to the focal length


def load_lens(path: str | Path) -> Lens:
    """Read a calibrated lens.

    Reads mrcal's models (file name ends with .cameramodel) LENSMODEL_PINHOLE, _OPENCV4, _OPENCV5, _OPENCV8, _OPENCV12
    and _SPLINED_STEREOGRAPHIC; and files of cv2.FileStorage or ROS camera_info with a camera matrix, distortion terms,
    the image's width and height, and for a fisheye lens `distortion_model: equidistant` or `fisheye_model: 1`. Of a
    stereo pair it reads the first camera.

    Raises:
        BadInputError: the file is missing, is no such file, or has another lens model.
    """
    file = Path(path)
    try:
        text = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as fault:
        raise BadInputError(f"{file}: cannot be read as text ({fault}); give a file of a calibrated lens.") from fault
    try:
        return _mrcal_lens(text) if file.suffix == ".cameramodel" else _opencv_lens(text)
    except BadInputError as fault:
        raise BadInputError(f"{file}: {fault}") from fault


def _mrcal_lens(text: str) -> Lens:
    try:
        content = ast.literal_eval(text.strip())
        model = content["lensmodel"]
        intrinsics = np.array(content["intrinsics"], dtype=np.float64)
        width, height = (int(length) for length in content["imagersize"])
    except (SyntaxError, TypeError, ValueError, KeyError, MemoryError, RecursionError) as fault:
        raise BadInputError(
            f"is no camera model of mrcal ({fault}); it needs 'lensmodel', 'intrinsics' and 'imagersize'."
        ) from fault
    splined = _SPLINED.fullmatch(str(model))
    if splined is None and model not in _MRCAL_MODELS:
        raise BadInputError(
            f"lens model {model!r} is not supported; convert it with mrcal-convert-lensmodel to one of "
            f"{', '.join(_MRCAL_MODELS)} or LENSMODEL_SPLINED_STEREOGRAPHIC_..."
        )
    if splined is not None:
        order, columns, rows = (int(splined[key]) for key in ("order", "nx", "ny"))
        _check_values(intrinsics, 4 + 2 * columns * rows, model)
        control = intrinsics[4:].reshape(rows, columns, 2)
        centre = intrinsics[2:4] - OPENCV_PIXEL_SHIFT
        return SplinedLens((width, height), intrinsics[:2], centre, control, order, float(splined["fov"]))
    count, kind = _MRCAL_MODELS[model]
    _check_values(intrinsics, 4 + count, model)
    return _lens_camera((width, height), intrinsics[:4], intrinsics[4:], kind)


def _check_values(values: FloatArray, count: int, model: str) -> None:
    if values.shape != (count,) or not np.isfinite(values).all() or np.any(values[:2] <= 0):
        raise BadInputError(
            f"'intrinsics' must be {count} finite numbers for {model}, the first two (focal lengths) above 0; it has "
            f"{values.size}."
        )


def _lens_camera(size_px: tuple[int, int], core: FloatArray, terms: FloatArray, kind: str) -> LensCamera:
    """Camera from OpenCV's (fx, fy, cx, cy); terms that are left out are zero."""
    filled = np.zeros(len(LENS_KINDS[kind]))
    filled[: len(terms)] = terms
    return LensCamera(size_px, core[:2], core[2:] - OPENCV_PIXEL_SHIFT, filled, kind)


def _opencv_lens(text: str) -> LensCamera:
    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        root = storage.root()
        matrix = _values(root, _MATRIX_KEYS)
        terms = _values(root, _TERM_KEYS)
        width, height = _values(root, _WIDTH_KEYS), _values(root, _HEIGHT_KEYS)
        size = _values(root, _SIZE_KEYS) if width.size + height.size == 0 else np.concatenate([width, height])
        model = _text(root, _MODEL_KEYS)
        flag = _values(root, _FISHEYE_KEYS)
    except (cv2.error, SystemError, TypeError, ValueError) as fault:
        raise BadInputError(
            "is no YAML, XML or JSON file that OpenCV can read; save it with cv2.FileStorage, or write each list in "
            "brackets in one line."
        ) from fault
    return _lens_of_matrix(matrix, terms, size, _kind(model, bool(flag.any()), terms))


def _lens_of_matrix(matrix: FloatArray, terms: FloatArray, size: FloatArray, kind: str) -> LensCamera:
    if matrix.size != 9:
        raise BadInputError(f"needs a camera matrix of 9 numbers under one of {', '.join(_MATRIX_KEYS)}.")
    if size.size != 2 or not np.all(size >= 1):
        raise BadInputError("needs the size of the image; add image_width and image_height in pixels.")
    (fx, skew, cx), (_, fy, cy), _ = matrix.reshape(3, 3)
    core = np.array([fx, fy, cx, cy])
    if not np.isfinite(np.concatenate([core, terms])).all() or min(fx, fy) <= 0:
        raise BadInputError("needs finite numbers, and focal lengths above 0, in camera matrix and distortion terms.")
    if abs(skew) > _SKEW * fx:
        raise BadInputError(
            f"has a skew of {skew:g} pixels in its camera matrix, which lenses here lack; fit without it."
        )
    return _lens_camera((int(size[0]), int(size[1])), core, terms[: len(LENS_KINDS[kind])], kind)


def _kind(model: str, is_fisheye: bool, terms: FloatArray) -> str:
    """Kind of lens by the names that the file gives it and the number of its terms."""
    if model and model not in (*_FISHEYE_NAMES, *_PERSPECTIVE_NAMES):
        known = ", ".join((*_PERSPECTIVE_NAMES, *_FISHEYE_NAMES))
        raise BadInputError(f"distortion model '{model}' is not supported; it must be one of {known}.")
    if is_fisheye or model in _FISHEYE_NAMES:
        if terms.size != len(LENS_KINDS["fisheye"]):
            raise BadInputError(f"has {terms.size} distortion terms; a fisheye lens of OpenCV has 4.")
        return "fisheye"
    if terms.size == len(LENS_KINDS["fisheye"]) and not model:
        raise BadInputError(
            "has 4 distortion terms, which may be those of cv2.fisheye (k1 k2 k3 k4) or of cv2.calibrateCamera "
            "(k1 k2 p1 p2); add distortion_model: equidistant or distortion_model: plumb_bob."
        )
    if terms.size == _TILTED and not terms[-2:].any():
        return "thin-prism"
    if terms.size not in _KIND_OF_COUNT:
        raise BadInputError(
            f"has {terms.size} distortion terms; lenses here have 0, 4, 5, 8 or 12, and no tilt of the sensor."
        )
    return _KIND_OF_COUNT[terms.size]


def _node(root: Any, keys: Sequence[str]) -> Any:
    """Node of the first key that the file has, or None."""
    nodes = (root.getNode(key) for key in keys)
    return next((node for node in nodes if not node.empty()), None)


def _values(root: Any, keys: Sequence[str]) -> FloatArray:
    """Numbers (n,) under the first key that the file has: a matrix, nested lists, or one number."""
    node = _node(root, keys)
    return np.zeros(0) if node is None else np.array(_numbers(node), dtype=np.float64)


def _numbers(node: Any) -> list[float]:
    if node.isMap():  # OpenCV's matrix or that of ROS: rows, cols and data
        return _numbers(node.getNode("data"))
    if node.isSeq():
        return [number for place in range(node.size()) for number in _numbers(node.at(place))]
    return [node.real()] if node.isReal() or node.isInt() else [np.nan]


def _text(root: Any, keys: Sequence[str]) -> str:
    node = _node(root, keys)
    return str(node.string()) if node is not None and node.isString() else ""

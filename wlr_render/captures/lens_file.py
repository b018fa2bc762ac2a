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
from wlr_render.geometry.lens_camera import LENS_KINDS, OPENCV_PIXEL_SHIFT, LensCamera
from wlr_render.geometry.splined_lens import SplinedLens
from wlr_render.input_files import parsing, read_text, require_pixels, shown
from wlr_render.numerics.arrays import FloatArray

_MRCAL_MODELS = {  # number of distortion terms, and the kind of lens
    "LENSMODEL_PINHOLE": (0, "brown"),
    "LENSMODEL_OPENCV4": (4, "brown"),
    "LENSMODEL_OPENCV5": (5, "brown"),
    "LENSMODEL_OPENCV8": (8, "rational"),
    "LENSMODEL_OPENCV12": (12, "thin-prism"),
}
_SPLINED = re.compile(
    r"LENSMODEL_SPLINED_STEREOGRAPHIC_order=(?P<order>\d)_Nx=(?P<nx>\d{1,4})_Ny=(?P<ny>\d{1,4})_fov_x_deg=(?P<fov>\d{1,3}(\.\d*)?)"
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
_REMEDY = "give a file of a calibrated lens"
_LONGEST_LIST = 100
_MOST_NUMBERS = 200_000
_DEEPEST = 30
_NESTING = re.compile(r"[\[\]{}()]|</?[A-Za-z_][^<>]*(?<!/)>")
_ASPECT = 3.0  # focal length in x over that in y, of binned pixels
_FOCAL = (0.02, 1000.0)  # focal length over the larger side of the picture
_MOST_TERM = 1e6  # higher terms of long lenses reach ten thousand
_SKEW = 1e-9  # largest skew taken for zero, relative to the focal length


def load_lens(path: str | Path) -> LensCamera | SplinedLens:
    """Read a calibrated lens.

    Reads mrcal's models (file name ends with .cameramodel) LENSMODEL_PINHOLE, _OPENCV4, _OPENCV5, _OPENCV8, _OPENCV12
    and _SPLINED_STEREOGRAPHIC; and files of cv2.FileStorage or ROS camera_info with a camera matrix, distortion terms,
    the image's width and height, and for a fisheye lens `distortion_model: equidistant` or `fisheye_model: 1`. Of a
    stereo pair it reads the first camera.

    Raises:
        BadInputError: the file is missing, is no such file, or has another lens model.
    """
    file = Path(path)
    text = read_text(file, "a file of a lens", remedy=_REMEDY)
    check_nesting(file, text)
    lens = _mrcal_lens(file, text) if file.suffix == ".cameramodel" else _opencv_lens(file, text)
    require_plausible_lens(str(file), lens)
    return lens


def check_nesting(path: Path, text: str) -> None:
    """Refuse text that parsers of lists and tags would follow too deeply, or that has more numbers than a lens."""
    if text.count(",") + text.count("\n") + text.count(" ") > _MOST_NUMBERS:
        raise BadInputError(f"{path}: has more numbers than a file of a lens; {_REMEDY}.")
    depth = 0
    for mark in _NESTING.finditer(text):
        depth += 1 if mark[0] in "[{(" or (mark[0][0] == "<" and mark[0][1] != "/") else -1
        if depth > _DEEPEST:
            line = text.count("\n", 0, mark.start()) + 1
            raise BadInputError(f"{path}: line {line} is nested too deeply for a file of a lens; {_REMEDY}.")


def require_plausible_lens(where: str, lens: LensCamera | SplinedLens) -> None:
    """Refuse a lens that no camera has.

    Args:
        where: the file or table that has the lens.
        lens: any; sizes, focal lengths and centre in pixels.

    Raises:
        BadInputError: the picture is too large, a number is not finite, the focal length is not plausible for the
            size of the picture, the centre is far outside it, or a distortion term is huge.
    """
    require_plausible_view(where, np.asarray(lens.size_px), np.asarray(lens.focal_px), np.asarray(lens.centre_px))
    terms = lens.distortion if isinstance(lens, LensCamera) else lens.control
    if not np.all(np.abs(terms) < _MOST_TERM):
        raise BadInputError(f"{where}: a distortion term is not finite, or above {_MOST_TERM:g}; correct it.")


def require_plausible_view(where: str, size_px: FloatArray, focal_px: FloatArray, centre_px: FloatArray) -> None:
    """Refuse a picture's size, focal lengths and principal point, (2,) each in pixels, that no camera has.

    Raises:
        BadInputError: as `require_plausible_lens`.
    """
    require_pixels(where, size_px, "correct the size of the picture")
    size, picture = max(size_px), f"{size_px[0]:g} x {size_px[1]:g} pixels"
    if min(size_px) < 1:
        raise BadInputError(f"{where}: the picture has {picture}; correct its size.")
    if not np.all((focal_px > _FOCAL[0] * size) & (focal_px < _FOCAL[1] * size)):
        raise BadInputError(
            f"{where}: the focal length (fx, fy) {focal_px.tolist()} pixels is not plausible for a picture of "
            f"{picture}; give it in pixels, not in millimetres."
        )
    if max(focal_px) > _ASPECT * min(focal_px):
        raise BadInputError(
            f"{where}: the focal length (fx, fy) is {focal_px.tolist()} pixels, and no camera's two differ by "
            f"{_ASPECT:g} times; correct one."
        )
    if not np.all(np.abs(centre_px - 0.5 * size_px) < 1.5 * size):
        raise BadInputError(
            f"{where}: the principal point (cx, cy) {centre_px.tolist()} lies far outside the picture; correct it."
        )


def _mrcal_lens(file: Path, text: str) -> LensCamera | SplinedLens:
    with parsing(file, "a camera model of mrcal with 'lensmodel', 'intrinsics' and 'imagersize'", _REMEDY):
        content = ast.literal_eval(text.strip())
        model = str(content["lensmodel"])
        intrinsics = np.array(content["intrinsics"], dtype=np.float64)
        width, height = (int(length) for length in content["imagersize"])
    if intrinsics.ndim != 1:
        raise BadInputError(f"{file}: 'intrinsics' must be a list of numbers; {_REMEDY}.")
    splined = _SPLINED.fullmatch(model)
    if splined is None and model not in _MRCAL_MODELS:
        raise BadInputError(
            f"{file}: lens model {shown(model)} is not supported; convert it with mrcal-convert-lensmodel to one of "
            f"{', '.join(_MRCAL_MODELS)} or LENSMODEL_SPLINED_STEREOGRAPHIC_..."
        )
    if splined is not None:
        order, columns, rows = (int(splined[key]) for key in ("order", "nx", "ny"))
        _check_values(file, intrinsics, 4 + 2 * columns * rows, model)
        control = intrinsics[4:].reshape(rows, columns, 2)
        centre = intrinsics[2:4] - OPENCV_PIXEL_SHIFT
        try:
            return SplinedLens((width, height), intrinsics[:2], centre, control, order, float(splined["fov"]))
        except BadInputError as fault:
            raise BadInputError(f"{file}: {fault}") from fault
    count, kind = _MRCAL_MODELS[model]
    _check_values(file, intrinsics, 4 + count, model)
    return _lens_camera((width, height), intrinsics[:4], intrinsics[4:], kind)


def _check_values(file: Path, values: FloatArray, count: int, model: str) -> None:
    if values.shape != (count,) or not np.isfinite(values).all() or np.any(values[:2] <= 0):
        raise BadInputError(
            f"{file}: 'intrinsics' must be {count} finite numbers for {model}, the first two (focal lengths) above 0; "
            f"it has {values.size}: {_REMEDY}."
        )


def _lens_camera(size_px: tuple[int, int], core: FloatArray, terms: FloatArray, kind: str) -> LensCamera:
    """Camera from OpenCV's (fx, fy, cx, cy); terms that are left out are zero."""
    filled = np.zeros(len(LENS_KINDS[kind]))
    filled[: len(terms)] = terms
    return LensCamera(size_px, core[:2], core[2:] - OPENCV_PIXEL_SHIFT, filled, kind)


def _opencv_lens(file: Path, text: str) -> LensCamera:
    with parsing(
        file,
        "a YAML, XML or JSON file of OpenCV",
        "save it with cv2.FileStorage, or write each list in brackets in one line",
    ):
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        root = storage.root()
        matrix = _values(file, root, _MATRIX_KEYS)
        terms = _values(file, root, _TERM_KEYS)
        width, height = _values(file, root, _WIDTH_KEYS), _values(file, root, _HEIGHT_KEYS)
        size = _values(file, root, _SIZE_KEYS) if width.size + height.size == 0 else np.concatenate([width, height])
        model = _text(root, _MODEL_KEYS)
        flag = _values(file, root, _FISHEYE_KEYS)
    return _lens_of_matrix(file, matrix, terms, size, _kind(file, model, bool(flag.any()), terms))


def _lens_of_matrix(file: Path, matrix: FloatArray, terms: FloatArray, size: FloatArray, kind: str) -> LensCamera:
    if matrix.size != 9:
        raise BadInputError(f"{file}: needs a camera matrix of 9 numbers under one of {', '.join(_MATRIX_KEYS)}.")
    if size.size != 2 or not np.all((size >= 1) & np.isfinite(size)):
        raise BadInputError(f"{file}: needs the size of the image; add image_width and image_height in pixels.")
    (fx, skew, cx), (below, fy, cy), last = matrix.reshape(3, 3)
    if below != 0 or not np.array_equal(last, (0, 0, 1)):
        raise BadInputError(f"{file}: its camera matrix must be fx 0 cx, 0 fy cy, 0 0 1, row by row; {_REMEDY}.")
    core = np.array([fx, fy, cx, cy])
    if not np.isfinite(np.concatenate([core, terms])).all() or min(fx, fy) <= 0:
        raise BadInputError(
            f"{file}: needs finite numbers, and focal lengths above 0, in camera matrix and distortion terms: "
            f"{_REMEDY}."
        )
    if abs(skew) > _SKEW * fx:
        raise BadInputError(
            f"{file}: has a skew of {skew:g} pixels in its camera matrix, which lenses here lack; fit without it."
        )
    return _lens_camera((int(size[0]), int(size[1])), core, terms[: len(LENS_KINDS[kind])], kind)


def _kind(file: Path, model: str, is_fisheye: bool, terms: FloatArray) -> str:
    """Kind of lens by the names that the file gives it and the number of its terms."""
    if model and model not in (*_FISHEYE_NAMES, *_PERSPECTIVE_NAMES):
        known = ", ".join((*_PERSPECTIVE_NAMES, *_FISHEYE_NAMES))
        raise BadInputError(f"{file}: distortion model {shown(model)} is not supported; it must be one of {known}.")
    if is_fisheye or model in _FISHEYE_NAMES:
        if terms.size != len(LENS_KINDS["fisheye"]):
            raise BadInputError(
                f"{file}: has {terms.size} distortion terms; a fisheye lens of OpenCV has 4: fit it again."
            )
        return "fisheye"
    if terms.size == len(LENS_KINDS["fisheye"]) and not model:
        raise BadInputError(
            f"{file}: has 4 distortion terms, which may be those of cv2.fisheye (k1 k2 k3 k4) or of "
            "cv2.calibrateCamera (k1 k2 p1 p2); add distortion_model: equidistant or distortion_model: plumb_bob."
        )
    if terms.size == _TILTED and not terms[-2:].any():
        return "thin-prism"
    if terms.size not in _KIND_OF_COUNT:
        raise BadInputError(
            f"{file}: has {terms.size} distortion terms; lenses here have 0, 4, 5, 8 or 12, and no tilt of the sensor: "
            "fit one of these."
        )
    return _KIND_OF_COUNT[terms.size]


def _node(root: Any, keys: Sequence[str]) -> Any:
    """Node of the first key that the file has, or None."""
    nodes = (root.getNode(key) for key in keys)
    return next((node for node in nodes if not node.empty()), None)


def _values(file: Path, root: Any, keys: Sequence[str]) -> FloatArray:
    """Numbers (n,) under the first key that the file has: a matrix, nested lists, or one number."""
    node = _node(root, keys)
    return np.zeros(0) if node is None else np.array(_numbers(file, node), dtype=np.float64)


def _numbers(file: Path, node: Any) -> list[float]:
    if node.isMap():  # OpenCV's matrix or that of ROS: rows, cols and data
        return _numbers(file, node.getNode("data"))
    if node.isSeq() and node.size() > _LONGEST_LIST:  # a node of many numbers takes time quadratic in them
        raise BadInputError(
            f"{file}: has a list of {node.size()} numbers; a lens has at most {_LONGEST_LIST}: {_REMEDY}."
        )
    if node.isSeq():
        return [number for place in range(node.size()) for number in _numbers(file, node.at(place))]
    return [node.real()] if node.isReal() or node.isInt() else [np.nan]


def _text(root: Any, keys: Sequence[str]) -> str:
    node = _node(root, keys)
    return str(node.string()) if node is not None and node.isString() else ""

"""Reader of calibrated lenses of other programs: mrcal, OpenCV, ROS and Kalibr.

These programs count pixels from the centre of the top-left one; the reader converts them. It ignores poses, and mrcal's
record of its optimisation, from which mrcal computes the uncertainty of the lens.
"""

import ast
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from wlr_render.captures.plain_data import read_mapping
from wlr_render.errors import BadInputError
from wlr_render.io.input_files import as_bad_input, prefix_errors, read_text, require_pixels, shown
from wlr_render.lenses.lens_camera import LENS_KINDS, OPENCV_PIXEL_SHIFT, LensCamera
from wlr_render.lenses.splined_lens import SplinedLens
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

_MATRIX_KEYS = ("camera_matrix", "cameraMatrix", "Camera_Matrix", "K", "k", "mtx", "cameraMatrix1", "M1")
_TERM_KEYS = (
    "distortion_coefficients",
    "Distortion_Coefficients",
    "distortion_coeffs",
    "dist_coeffs",
    "distCoeffs",
    "D",
    "d",
    "dist",
    "distCoeffs1",
    "D1",
)
_WIDTH_KEYS, _HEIGHT_KEYS = ("image_width", "image_Width", "width"), ("image_height", "image_Height", "height")
_SIZE_KEYS = ("image_size", "imageSize", "resolution")
_MODEL_KEYS = ("distortion_model", "camera_model")
_FISHEYE_KEYS = ("fisheye_model", "fisheye")
_OPENCV_KEYS = (*(_MATRIX_KEYS + _TERM_KEYS + _WIDTH_KEYS + _HEIGHT_KEYS + _SIZE_KEYS + _MODEL_KEYS + _FISHEYE_KEYS),)
_OPENCV_MARKS = ("<", "!!opencv-", '"type_id"')  # marks of XML, and of matrices in YAML and JSON
_UNREAD_TERMS = re.compile(r"(?i).*dist(?!ortion_model).*|k_?[1-6]|.*\.k[1-6]")  # keys of unsupported terms
_FISHEYE_NAMES = ("equidistant", "fisheye", "kannala_brandt")
_PERSPECTIVE_NAMES = (
    *("plumb_bob", "rational_polynomial", "pinhole", "brown", "thin_prism", "radtan", "radial_tangential", "none"),
)
_OTHER_PROGRAMS = {
    **{"value0": "Basalt", "model_type": "VINS-Fusion", "projection_parameters": "VINS-Fusion"},
    **{"Camera.fx": "ORB-SLAM", "Camera1.fx": "ORB-SLAM", "intrinsic_matrix": "Open3D"},
}
"""Programs with unsupported files, by a key in these files."""
_COLMAP = re.compile(r"\d+ [A-Z_]+ \d+ \d+( [-+.\deE]+)+")
_AS_ROS = (
    "write image_width, image_height, camera_matrix, distortion_model and distortion_coefficients as ROS does, in "
    "OpenCV's order"
)
_KALIBR_CAMERA = re.compile(r"cam\d+")
KIND_OF_COUNT = {0: "brown", 4: "brown", 5: "brown", 8: "rational", 12: "thin-prism"}
"""Kind of lens by the number of OpenCV's distortion terms."""
_TILTED = 14  # terms of OpenCV's tilted sensor model: "thin-prism" plus two angles
_REMEDY = "give a file of a calibrated lens"
_LONGEST_LIST = 100  # most numbers in a list; no supported lens has half as many
_MOST_NUMBERS = 200_000  # most numbers in a file; splined lenses have a few thousand
_DEEPEST = 30  # deepest nesting of lists and tags; some parsers recurse
_NESTING = re.compile(r"[\[\]{}()]|</?[A-Za-z_][^<>]*(?<!/)>")
_ASPECT = 3.0  # largest ratio of the focal lengths in x and y, for binned pixels
_FOCAL = (0.02, 1000.0)  # focal length over the larger side of the picture
_MOST_TERM = 1e6  # largest distortion term; high-order terms of long lenses reach ten thousand
_SKEW = 1e-9  # largest skew treated as zero, relative to the focal length


def load_lens(path: str | Path) -> LensCamera | SplinedLens:
    """Read a calibrated lens.

    Reads mrcal's models (file name ends with .cameramodel) LENSMODEL_PINHOLE, _OPENCV4, _OPENCV5, _OPENCV8, _OPENCV12
    and _SPLINED_STEREOGRAPHIC; files of cv2.FileStorage or ROS CameraInfo with a camera matrix, distortion terms,
    the image's width and height, and for a fisheye lens `distortion_model: equidistant` or `fisheye_model: 1`; and
    Kalibr's camera chain of one pinhole camera with radtan or equidistant distortion. Of OpenCV's stereo pair it reads
    the first camera.

    Raises:
        BadInputError: the file is missing, has another format, or has another lens model.
    """
    file = Path(path)
    text = read_text(file, "a file of a lens", remedy=_REMEDY)
    check_nesting(file, text)
    with prefix_errors(file):
        lens = _mrcal_lens(file, text) if file.suffix == ".cameramodel" else _lens_of_keys(file, text)
    require_plausible_lens(str(file), lens)
    return lens


def check_nesting(path: Path, text: str) -> None:
    """Refuse text with lists or tags nested too deeply for parsers, or with more numbers than any lens has."""
    if text.count(",") + text.count("\n") + text.count(" ") > _MOST_NUMBERS:
        raise BadInputError(f"{path}: has more numbers than a file of a lens; {_REMEDY}.")
    depth = 0
    for mark in _NESTING.finditer(text):
        depth += 1 if mark[0] in "[{(" or (mark[0][0] == "<" and mark[0][1] != "/") else -1
        if depth > _DEEPEST:
            line = text.count("\n", 0, mark.start()) + 1
            raise BadInputError(f"{path}: line {line} is nested too deeply for a file of a lens; {_REMEDY}.")


def require_plausible_lens(where: str, lens: LensCamera | SplinedLens) -> None:
    """Refuse an implausible lens.

    Args:
        where: the file or table of the lens.
        lens: the lens; size, focal lengths and centre in pixels.

    Raises:
        BadInputError: the picture is too large, a number is not finite, the focal length is not plausible for the
            size of the picture, the centre is far outside it, or a distortion term is huge.
    """
    require_plausible_view(where, np.asarray(lens.size_px), np.asarray(lens.focal_px), np.asarray(lens.centre_px))
    terms = lens.distortion if isinstance(lens, LensCamera) else lens.control
    if not np.all(np.abs(terms) < _MOST_TERM):
        raise BadInputError(f"{where}: a distortion term is not finite, or above {_MOST_TERM:g}; correct it.")


def require_plausible_view(where: str, size_px: FloatArray, focal_px: FloatArray, centre_px: FloatArray) -> None:
    """Refuse an impossible picture size, focal lengths or principal point, each (2,) in pixels.

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
    with as_bad_input(file, "a camera model of mrcal with 'lensmodel', 'intrinsics' and 'imagersize'", _REMEDY):
        content = ast.literal_eval(text.strip())
        model = str(content["lensmodel"])
        intrinsics = np.array(content["intrinsics"], dtype=np.float64)
        width, height = (int(float(length)) for length in content["imagersize"])  # int alone accepts 400 digits
    if intrinsics.ndim != 1:
        raise BadInputError(f"'intrinsics' must be a list of numbers; {_REMEDY}.")
    splined = _SPLINED.fullmatch(model)
    if splined is None and model not in _MRCAL_MODELS:
        raise BadInputError(
            f"lens model {shown(model)} is not supported; convert it with mrcal-convert-lensmodel to one of "
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
    return lens_of_opencv((width, height), intrinsics[:4], intrinsics[4:], kind)


def _check_values(values: FloatArray, count: int, model: str) -> None:
    if values.shape != (count,) or not np.isfinite(values).all() or np.any(values[:2] <= 0):
        raise BadInputError(
            f"'intrinsics' must be {count} finite numbers for {model}, the first two (focal lengths) above 0; "
            f"it has {values.size}: {_REMEDY}."
        )


def lens_of_opencv(size_px: tuple[int, int], core: FloatArray, terms: FloatArray, kind: str) -> LensCamera:
    """Return the camera with OpenCV's parameters.

    Args:
        size_px: width and height.
        core: (4,) fx, fy, cx, cy, pixels from the centre of the top-left pixel.
        terms: distortion terms in OpenCV's order; missing ones are zero.
        kind: key of `LENS_KINDS`.
    """
    filled = np.zeros(len(LENS_KINDS[kind]))
    filled[: len(terms)] = terms
    return LensCamera(size_px, core[:2], core[2:] - OPENCV_PIXEL_SHIFT, filled, kind)


def _lens_of_keys(file: Path, text: str) -> LensCamera:
    _refuse_other_programs(text)
    if text.lstrip().startswith(_OPENCV_MARKS[0]) or any(mark in text for mark in _OPENCV_MARKS[1:]):
        content = _opencv_content(file, text)
    else:
        content = _camera_of(read_mapping(file, text, "a file of a lens", "save it again, or correct it"))
    with as_bad_input(file, "a file of a lens", _REMEDY):
        matrix, terms = (_values(content, keys) for keys in (_MATRIX_KEYS, _TERM_KEYS))
        width, height = _values(content, _WIDTH_KEYS), _values(content, _HEIGHT_KEYS)
        size = _values(content, _SIZE_KEYS) if width.size + height.size == 0 else np.concatenate([width, height])
    unread = [key for key in content if _UNREAD_TERMS.fullmatch(key)]
    if unread and _first(content, _TERM_KEYS) is None:
        raise BadInputError(
            f"{shown(unread[0])} is not read; write the distortion terms as the list {_TERM_KEYS[0]}, in "
            "OpenCV's order."
        )
    return _lens_of_matrix(matrix, terms, size, _kind(content, terms))


def _camera_of(content: dict[str, Any]) -> dict[str, Any]:
    """Return the keys of the one camera in a file of ROS, Kalibr or another program with a camera matrix."""
    program = next((program for key, program in _OTHER_PROGRAMS.items() if key in content), None)
    if program is not None:
        raise BadInputError(f"is a file of {program}, which is not read; {_AS_ROS}.")
    cameras = [key for key, value in content.items() if _KALIBR_CAMERA.fullmatch(key) and isinstance(value, dict)]
    if len(cameras) > 1:
        raise BadInputError(
            f"has the cameras {', '.join(cameras)}; copy the one that took the photographs into a separate file."
        )
    content = content[cameras[0]] if cameras else content
    _refuse_cropped(content)
    return _kalibr_camera(content) if {"intrinsics", "camera_model"} <= content.keys() else content


def _refuse_other_programs(text: str) -> None:
    """Refuse files without keys that other programs write."""
    lines = [line.strip() for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    if lines[:1] == ["[image]"]:
        raise BadInputError("is the ost.txt of ROS' camera calibrator, which is not read; give its ost.yaml.")
    if lines and _COLMAP.fullmatch(lines[0]):
        raise BadInputError(f"is a file of COLMAP, which is not read; {_AS_ROS}, with cx and cy less by 0.5.")


def _opencv_content(file: Path, text: str) -> dict[str, Any]:
    """Return the keys and values of an OpenCV file that describe the lens."""
    with as_bad_input(file, "a YAML, XML or JSON file of OpenCV", "save it with cv2.FileStorage"):
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        root = storage.root()  # valid only while `storage` exists
        if not root.isMap():
            raise ValueError("it has no keys")
        unread = {key: None for key in root.keys() if _UNREAD_TERMS.fullmatch(key)}  # noqa: SIM118
        return unread | {key: _plain(root.getNode(key)) for key in _OPENCV_KEYS if not root.getNode(key).empty()}


def _plain(node: Any) -> Any:
    """Return the value of a node: a list for a matrix or a list, a number or text."""
    if node.isMap():
        return _plain(node.getNode("data"))  # not `node.mat()`, which writes out of bounds for damaged files
    if node.isSeq():  # `at` takes linear time, so that long lists take quadratic time
        return [_plain(node.at(place)) for place in range(min(node.size(), _LONGEST_LIST + 1))]
    return node.real() if node.isReal() or node.isInt() else node.string()


def _kalibr_camera(content: dict[str, Any]) -> dict[str, Any]:
    """Return the keys of a Kalibr camera with its intrinsics as a camera matrix."""
    model = content["camera_model"]
    if model != "pinhole":
        raise BadInputError(
            f"camera model {shown(model)} of Kalibr is not supported; calibrate with pinhole-radtan or pinhole-equi."
        )
    core = _values(content, ("intrinsics",))
    if len(core) != 4:
        raise BadInputError(f"'intrinsics' must be the 4 numbers fu, fv, pu, pv of a pinhole camera; {_REMEDY}.")
    fx, fy, cx, cy = core
    return {"distortion_model": "none", **content, "camera_matrix": [fx, 0, cx, 0, fy, cy, 0, 0, 1]}


def _refuse_cropped(content: Mapping[str, Any]) -> None:
    """Refuse a ROS camera with binning or a region of interest: its camera matrix describes the whole sensor."""
    binning = [content.get(f"binning_{axis}") or 1 for axis in "xy"]
    region = content.get("roi")
    region = region if isinstance(region, dict) else {}
    part = [region.get("x_offset"), region.get("y_offset"), region.get("width"), region.get("height")]
    whole = ([0, 0, 0, 0], [0, 0, content.get("width"), content.get("height")], [None] * 4)
    if binning != [1, 1] or part not in whole:
        raise BadInputError(
            "states binning or a region of interest (roi), and its camera matrix describes the whole sensor; "
            "give the CameraInfo of whole pictures."
        )


def _lens_of_matrix(matrix: FloatArray, terms: FloatArray, size: FloatArray, kind: str) -> LensCamera:
    if matrix.size != 9:
        raise BadInputError(f"needs a camera matrix of 9 numbers under one of {', '.join(_MATRIX_KEYS)}.")
    if size.size != 2 or not np.all((size >= 1) & np.isfinite(size)):
        raise BadInputError("needs the size of the image; add image_width and image_height in pixels.")
    if not matrix.any():
        raise BadInputError("is of a camera that was not calibrated (its camera matrix is zero); calibrate it.")
    (fx, skew, cx), (below, fy, cy), last = matrix.reshape(3, 3)
    if below != 0 or not np.array_equal(last, (0, 0, 1)):
        raise BadInputError(f"its camera matrix must be fx 0 cx, 0 fy cy, 0 0 1, row by row; {_REMEDY}.")
    core = np.array([fx, fy, cx, cy])
    if not np.isfinite(np.concatenate([core, terms])).all() or min(fx, fy) <= 0:
        raise BadInputError(
            f"needs finite numbers, and focal lengths above 0, in camera matrix and distortion terms: {_REMEDY}."
        )
    if abs(skew) > _SKEW * fx:
        raise BadInputError(
            f"has a skew of {skew:g} pixels in its camera matrix, which lenses here lack; fit without it."
        )
    return lens_of_opencv((int(size[0]), int(size[1])), core, terms[: len(LENS_KINDS[kind])], kind)


def _kind(content: Mapping[str, Any], terms: FloatArray) -> str:
    """Return the kind of lens, from the names in the file and the number of its terms."""
    stated = _first(content, _MODEL_KEYS)
    model = re.sub(r"[ -]", "_", stated.lower()) if isinstance(stated, str) else ""
    flag = _values(content, _FISHEYE_KEYS)
    if model and model not in (*_FISHEYE_NAMES, *_PERSPECTIVE_NAMES):
        kinds = ", ".join((*_PERSPECTIVE_NAMES, *_FISHEYE_NAMES))
        raise BadInputError(f"distortion model {shown(stated)} is not supported; it must be one of {kinds}.")
    if flag.any() or model in _FISHEYE_NAMES:
        if terms.size != len(LENS_KINDS["fisheye"]):
            raise BadInputError(f"has {terms.size} distortion terms; a fisheye lens of OpenCV has 4: fit it again.")
        return "fisheye"
    if terms.size == len(LENS_KINDS["fisheye"]) and not model and not flag.size:
        raise BadInputError(
            "has 4 distortion terms, which may come from cv2.fisheye (k1 k2 k3 k4) or "
            "cv2.calibrateCamera (k1 k2 p1 p2); add distortion_model: equidistant or distortion_model: plumb_bob."
        )
    if terms.size == _TILTED and not terms[-2:].any():
        return "thin-prism"
    if terms.size not in KIND_OF_COUNT:
        raise BadInputError(
            f"has {terms.size} distortion terms; lenses here have 0, 4, 5, 8 or 12, and no tilt of the sensor: "
            "fit one of these."
        )
    return KIND_OF_COUNT[terms.size]


def _first(content: Mapping[str, Any], keys: Sequence[str]) -> Any:
    """Return the value of the first key that the file has, or None."""
    return next((content[key] for key in keys if content.get(key) is not None), None)


def _values(content: Mapping[str, Any], keys: Sequence[str]) -> FloatArray:
    """Return the numbers (n,) under the first key that the file has."""
    value = _first(content, keys)
    numbers = [] if value is None else _numbers(value)
    if len(numbers) > _LONGEST_LIST:
        raise BadInputError(f"has a list of more than {_LONGEST_LIST} numbers as {keys[0]}; {_REMEDY}.")
    return np.array(numbers, dtype=np.float64)


def _numbers(value: Any) -> list[float]:
    """Return about the first 100 numbers of a matrix, nested lists, or one number; NaN for other values."""
    if isinstance(value, dict):  # a matrix of ROS: rows, cols and data
        return _numbers(value.get("data"))
    if isinstance(value, list):
        numbers: list[float] = []
        for item in value:
            numbers += _numbers(item)
            if len(numbers) > _LONGEST_LIST:
                break
        return numbers
    try:
        return [float(value)]  # YAML parses 1e-5 as text
    except (TypeError, ValueError, OverflowError):
        return [np.nan]

"""Our detectors of boards and OpenCV's on published photographs: detections and residual of the camera fit."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from benchmarks.published_data.adjusted_boards import adjusted_row
from benchmarks.published_data.board_sets import SETS, PhotographSet
from wlr_render.captures.boards.board import BoardNotFoundError, BoardObservation
from wlr_render.captures.boards.charuco import CharucoBoard
from wlr_render.captures.boards.markers import dictionary_of
from wlr_render.captures.photographs import Photograph, as_bytes, read_photograph
from wlr_render.errors import BadInputError
from wlr_render.lenses.lens_camera import OPENCV_PIXEL_SHIFT
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.report.blocks import Cell, Report, ReportTable

_FLAGS = {"brown": 0, "rational": cv2.CALIB_RATIONAL_MODEL}
_SECTORS = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
# OpenCV's default of 30 steps does not reach the minimum of the rational model.
_CONVERGED = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 500, 1e-12)
_LEAST_CORNERS = 6  # fewest corners per photograph in a calibration

Corners = tuple[IntArray, FloatArray]
"""Index (n, 2) and pixel (n, 2) in one photograph."""


def compare_detectors(folder: Path) -> Report:
    """Find the boards in all photographs with our detectors and OpenCV's, and calibrate with the corners of each.

    Raises:
        BadInputError: the folder has none of the sets.
    """
    present = [each for each in SETS if (folder / each.name).is_dir()]
    if not present:
        raise BadInputError(f"{folder}: holds none of {', '.join(each.name for each in SETS)}.")
    found_in = {each.title: _found(each, folder) for each in present}
    rows = [_row(each, folder, found_in[each.title][0]) for each in present]
    cells = [list(row.values()) for row in rows]
    notes = ("rms: of cv2.calibrateCamera with the corners of each detector, per corner over both axes.",)
    table = ReportTable("Boards found, and calibration", list(rows[0]), cells, notes)
    keys = ("pictures", "found, ours")
    pictures, found = (sum(count for row in rows if isinstance(count := row[key], int)) for key in keys)
    fits = [adjusted_row(each, *found_in[each.title]) for each in present]
    about_fits = (
        "halves: rms over random splits of the halves' difference over its stated sigma; about 1 if sigmas are true.",
        "bow: of the middle against the edge, into the board; stretch: of each photograph, relative.",
    )
    joint = ReportTable("The joint adjustment", list(fits[0]), [list(each.values()) for each in fits], about_fits)
    return Report("", f"{found} of {pictures} boards were found.", blocks=[table, joint])


def _found(of: PhotographSet, root: Path) -> tuple[list[BoardObservation], tuple[int, int]]:
    """Detect the boards with our detector; also return the size of the photographs."""
    found, size = [], (0, 0)
    for path in of.photographs(root):
        image = read_photograph(path)
        size = image.shape[1], image.shape[0]
        try:
            found.append(of.board.find(image, path.name))
        except BoardNotFoundError:
            continue
    return found, size


def _row(of: PhotographSet, root: Path, found: Sequence[BoardObservation]) -> dict[str, Cell]:
    paths = of.photographs(root)
    ours: list[Corners] = [(seen.index, seen.pixel) for seen in found]
    theirs: list[Corners] = []
    size = (0, 0)
    for path in paths:
        image = read_photograph(path)
        size = image.shape[1], image.shape[0]
        corners = _opencv_corners(of, image)
        if corners is not None:
            theirs.append(corners)
    row: dict[str, Cell] = {"set": of.title, "pictures": len(paths)}
    for name, seen_corners in (("ours", ours), ("OpenCV", theirs)):
        row[f"found, {name}"] = len(seen_corners)
        row[f"corners, {name}"] = sum(len(index) for index, _ in seen_corners)
    for name, seen_corners in (("ours", ours), ("OpenCV", theirs)):
        rms, focal = _calibrated(of, seen_corners, size) if of.lens else (None, None)
        row[f"rms, {name} (px)"], row[f"fx, {name} (px)"] = rms, None if focal is None else f"{focal:.2f}"
    row["fx, published (px)"] = None if of.published_fx is None else f"{of.published_fx:.2f}"
    return row


def _opencv_corners(of: PhotographSet, image: Photograph) -> Corners | None:
    """Detect corners with OpenCV: ChArUco, or chessboards by sectors and, if that fails, by quads."""
    board, grey = of.board, as_bytes(image)
    if isinstance(board, CharucoBoard):
        made = cv2.aruco.CharucoBoard(
            (board.square_columns, board.square_rows), board.square_m, board.marker_m, dictionary_of(board.dictionary)
        )
        made.setLegacyPattern(board.legacy)
        corners, ids, _, _ = cv2.aruco.CharucoDetector(made).detectBoard(grey)
        if ids is None or not len(ids):
            return None
        row, column = np.divmod(np.asarray(ids, np.int64).ravel(), board.square_columns - 1)
        pixel = np.asarray(corners, np.float64).reshape(-1, 2) - OPENCV_PIXEL_SHIFT
        return np.stack([column, row], axis=-1), pixel
    shape = (board.columns, board.rows)
    found, corners = cv2.findChessboardCornersSB(grey, shape, flags=_SECTORS)
    if not found:
        found, corners = cv2.findChessboardCorners(grey, shape)
        if found:
            stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 30, 0.01)
            corners = cv2.cornerSubPix(grey, corners, (5, 5), (-1, -1), stop)
    return (board.indices(), np.asarray(corners, np.float64).reshape(-1, 2) - OPENCV_PIXEL_SHIFT) if found else None


def _calibrated(of: PhotographSet, seen: list[Corners], size: tuple[int, int]) -> tuple[float, float]:
    """Return the rms per corner over both axes, and fx, in pixels."""
    used = [each for each in seen if len(each[0]) >= _LEAST_CORNERS]
    points = [of.board.point_of(index).astype(np.float32) for index, _ in used]
    pixels = [(pixel + OPENCV_PIXEL_SHIFT).astype(np.float32) for _, pixel in used]
    rms, matrix, *_ = cv2.calibrateCamera(points, pixels, size, None, None, flags=_FLAGS[of.lens], criteria=_CONVERGED)
    return float(rms), float(matrix[0, 0])

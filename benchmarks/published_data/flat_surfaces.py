"""Deviation of decoded panel positions from flat surfaces: a plane maps camera to panel pixels by a homography.

The residual of a homography combines the errors of the decoder, of both lenses, and of the surface's flatness. Without
sub-pixel refinement it is at least 1 / sqrt(12) = 0.29 panel pixels per axis, if errors are uniform.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.decoded import Decoded
from wlr_render.evaluation.metrics import Summary, summary
from wlr_render.lenses.lens_camera import OPENCV_PIXEL_SHIFT, LensCamera
from wlr_render.numerics.arrays import FloatArray
from wlr_render.report.blocks import Columns, ReportTable, table

PixelArray = NDArray[np.floating[Any]]

TOLERANCE_PX = 0.75
"""Panel pixels from a plane's homography within which a camera pixel belongs to the plane."""

_FEWEST_SHARE = 0.02  # smallest share of the accepted pixels for a plane
_MOST_PLANES = 8  # largest number of planes
_SAMPLE = 20_000  # most rows in the fit of a homography
_ROUNDS = 5  # repetitions of the fit and the choice of inliers
_CELL_PX = 16  # side of the cells whose means are the smooth part, camera pixels
_FEWEST_IN_CELL = _CELL_PX**2 // 4  # fewest pixels in a cell


@dataclass(frozen=True)
class Lenses:
    """Lenses that undistort pixels before the fit of a homography; None leaves pixels unchanged."""

    camera: LensCamera | None = None
    projector: LensCamera | None = None


NO_LENSES = Lenses()


@dataclass(frozen=True, eq=False)
class PlaneFit:
    """One flat surface.

    Attributes:
        homography: (3, 3) from undistorted camera pixels to undistorted panel pixels.
        share: share of the accepted pixels that belong to the plane.
        residual: summary of the distances between decoded and predicted positions, panel pixels.
        rms_per_axis: rms of the residual per axis, panel pixels.
        smooth_per_axis: rms of the mean residuals of cells of 16 x 16 camera pixels: lens errors and surface shape.
        scatter_per_axis: rms about the cell means: the decoder's noise.
    """

    homography: FloatArray
    share: float
    residual: Summary
    rms_per_axis: float
    smooth_per_axis: float
    scatter_per_axis: float


@dataclass(frozen=True, eq=False)
class PlaneSurvey:
    """Flat surfaces in a decoded picture, in the order of detection.

    Attributes:
        planes: one fit per plane.
        label: (h, w) int8 number of the plane; -1 outside all planes.
    """

    planes: tuple[PlaneFit, ...]
    label: NDArray[np.int8]


def find_planes(decoded: Decoded, lenses: Lenses = NO_LENSES) -> NDArray[np.int8]:
    """Label the accepted pixels (h, w) with flat surfaces, detected one after another by RANSAC; -1 elsewhere."""
    seen, shown = _undistorted(decoded, lenses)
    label = np.full(len(seen), -1, dtype=np.int8)
    for number in range(_MOST_PLANES):
        free = label < 0
        if np.count_nonzero(free) < max(4, _FEWEST_SHARE * len(seen)):
            break
        members = _members(seen, shown, free)
        if np.count_nonzero(members) < max(4, _FEWEST_SHARE * len(seen)):
            break
        label[members] = number
    picture = np.full(decoded.rejection.shape, -1, dtype=np.int8)
    picture[decoded.accepted] = label
    return picture


def fit_planes(decoded: Decoded, label: NDArray[np.int8], lenses: Lenses = NO_LENSES) -> PlaneSurvey:
    """Fit a homography to each of the labelled surfaces (h, w) by least squares."""
    seen, shown = _undistorted(decoded, lenses)
    number_of = label[decoded.accepted]
    planes = []
    for number in range(int(number_of.max(initial=-1)) + 1):
        members = number_of == number
        homography = _homography(seen[members], shown[members])
        residual = np.full((*label.shape, 2), np.nan, dtype=np.float32)
        residual[label == number] = shown[members] - _mapped(homography, seen[members])
        planes.append(_plane_fit(homography, float(members.mean()), residual))
    return PlaneSurvey(tuple(planes), label)


def _plane_fit(homography: FloatArray, share: float, residual: NDArray[np.float32]) -> PlaneFit:
    """Summarise the residual (h, w, 2) of one surface, NaN outside it."""
    length = np.linalg.norm(residual, axis=-1)
    rms = float(np.sqrt(np.nanmean(residual**2)))
    return PlaneFit(homography, share, summary(length[np.isfinite(length)]), rms, *_smooth_and_scatter(residual))


def distance_to_planes(
    planes: Sequence[PlaneFit], camera_pixel: PixelArray, panel_pixel: PixelArray, lenses: Lenses = NO_LENSES
) -> FloatArray:
    """Return the distances (n,) of decoded positions (n, 2) from the prediction of the nearest plane, panel pixels."""
    seen, shown = _straightened(lenses.camera, camera_pixel), _straightened(lenses.projector, panel_pixel)
    distances = [np.linalg.norm(shown - _mapped(plane.homography, seen), axis=1) for plane in planes]
    return np.asarray(np.min(distances, axis=0, initial=np.inf))


def flatness_table(survey: PlaneSurvey, title: str) -> ReportTable:
    """Return the residuals of the homographies of flat surfaces, in panel pixels."""
    columns: Columns = {
        "of accepted (%)": lambda plane: 100.0 * plane.share,
        "rms per axis (px)": "rms_per_axis",
        "median (px)": "residual.median",
        "95 % (px)": "residual.p95",
        "smooth part (px)": "smooth_per_axis",
        "scatter (px)": "scatter_per_axis",
    }
    notes = (
        f"Panel pixels between decoded and predicted; members of a surface lie within {TOLERANCE_PX} px of it.",
        "Smooth part: rms per axis of means over 16 x 16 camera pixels, from lenses and bent surfaces; scatter: "
        "about these means. Whole panel pixels would scatter by 0.29 px.",
    )
    return table(title, enumerate(survey.planes, 1), columns, notes, name="surface")


def _undistorted(decoded: Decoded, lenses: Lenses) -> tuple[FloatArray, FloatArray]:
    """Return the undistorted camera and panel pixels (n, 2) of the accepted pixels."""
    row, column = np.nonzero(decoded.accepted)
    seen = np.stack([column, row], axis=-1) + 0.5
    return _straightened(lenses.camera, seen), _straightened(lenses.projector, decoded.pixel[decoded.accepted])


def _straightened(lens: LensCamera | None, pixel: PixelArray) -> FloatArray:
    exact = np.asarray(pixel, dtype=np.float64)
    if lens is None:
        return exact
    # OpenCV's inverse agrees with `LensCamera.tangents_of_pixel` and is fast enough for every pixel of a picture.
    matrix, of_opencv = lens.opencv_matrix, exact + OPENCV_PIXEL_SHIFT
    undistorted = cv2.undistortPoints(of_opencv[:, None], matrix, lens.distortion, P=matrix)[:, 0]
    return np.asarray(undistorted - OPENCV_PIXEL_SHIFT)


def _members(seen: FloatArray, shown: FloatArray, free: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a mask (n,) of the free rows that agree with the homography of the largest consensus."""
    rows = _thinned(np.flatnonzero(free))
    homography, _ = cv2.findHomography(seen[rows][:, None], shown[rows][:, None], cv2.RANSAC, TOLERANCE_PX)
    members = free
    for _ in range(_ROUNDS):
        if homography is None:
            return np.zeros_like(free)
        distance = np.linalg.norm(shown - _mapped(homography, seen), axis=1)
        members = free & (distance < TOLERANCE_PX)
        homography = _homography(seen[members], shown[members]) if np.count_nonzero(members) >= 4 else None
    return members


def _homography(seen: FloatArray, shown: FloatArray) -> FloatArray:
    """Fit a homography (3, 3) by least squares on panel distances."""
    rows = _thinned(np.arange(len(seen)))
    return np.asarray(cv2.findHomography(seen[rows][:, None], shown[rows][:, None])[0])


def _thinned(rows: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return a random but reproducible subset of at most `_SAMPLE` rows."""
    return np.random.default_rng(0).choice(rows, _SAMPLE, replace=False) if len(rows) > _SAMPLE else rows


def _mapped(homography: FloatArray, pixel: FloatArray) -> FloatArray:
    return np.asarray(cv2.perspectiveTransform(pixel[:, None], homography)[:, 0])


def _smooth_and_scatter(residual: NDArray[np.float32]) -> tuple[float, float]:
    """Return the rms per axis of the cell means of a picture (h, w, 2), and of the deviations from these means.

    Cells that are mostly NaN are ignored; both values are NaN if all cells are.
    """
    row, column = np.nonzero(np.isfinite(residual[..., 0]))
    cell = row // _CELL_PX * (residual.shape[1] // _CELL_PX + 1) + column // _CELL_PX
    count = np.bincount(cell)
    kept = count >= _FEWEST_IN_CELL
    if not kept.any():
        return np.nan, np.nan
    smooth = total = 0.0
    for values in residual[row, column].astype(np.float64).T:
        smooth += float(np.sum(np.bincount(cell, values)[kept] ** 2 / count[kept]))
        total += float(np.sum(np.bincount(cell, values**2)[kept]))
    number = 2 * count[kept].sum()
    return float(np.sqrt(smooth / number)), float(np.sqrt(max(total - smooth, 0.0) / number))

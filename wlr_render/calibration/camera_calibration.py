"""Calibrate a camera from photographs of a board: lens parameters, board poses and their covariance.

OpenCV (Z. Zhang, "A flexible new technique for camera calibration", PAMI 22 (2000) 1330) finds the start; the lens and
all poses are then adjusted together, weighted by the dots' sigmas, so that what poses inherit from the lens is known.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from wlr_render.calibration.board_poses import (
    BoardPoses,
    BoardView,
    rejection_reason,
    robust_scale,
    too_few_dots,
    without_outliers,
)
from wlr_render.calibration.bundle_adjustment import Adjustment, UndeterminedError, adjust_bundle
from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.geometry.lens_camera import DISTORTION_TERMS, LENS_PARAMETERS, OPENCV_PIXEL_SHIFT, LensCamera
from wlr_render.numerics.arrays import FloatArray, IntArray

_COUNT = len(LENS_PARAMETERS)
_PINHOLE, _RADIAL, _TANGENTIAL = (
    tuple(LENS_PARAMETERS.index(name) for name in names)
    for names in (("fx", "fy", "cx", "cy"), ("k1", "k2", "k3"), ("p1", "p2"))
)
_WORTH = 4.0  # chi-square that a distortion term must bring to be kept: two of its sigmas
_FEWEST_VIEWS = 3
_START_DOTS = 80  # per view; the start need not be exact, and OpenCV's time grows with dots
_MISREAD = 10.0  # times as far from a plane's image as usual
_LENS_BENDS_PX = 2.0  # and a distance that some photographs may be off where others are not
_LOOSEST = 0.02  # a focal length or centre known no better than to this part of the focal length is not known


@dataclass(frozen=True, eq=False)
class CameraCalibration:
    """A lens and what was found with it.

    Attributes:
        poses: of the board in each photograph, with the lens as `poses.camera`; their covariance includes the lens's.
        sigma: (9,) standard deviations of the `LENS_PARAMETERS`; 0 for distortion terms that are not used.
        terms: the distortion terms that the photographs carry; the others are zero.
        noise: rms distance of dots from their places in units of the sigmas they came with; they are all scaled by it.
    """

    poses: BoardPoses
    sigma: FloatArray
    terms: tuple[str, ...]
    noise: float

    @property
    def camera(self) -> LensCamera:
        """The lens."""
        return self.poses.camera


def calibrate_camera(views: Sequence[BoardView], size_px: tuple[int, int]) -> CameraCalibration:
    """Calibrate a camera's lens from photographs of a board.

    Photographs that do not fit are rejected by name; outlying dots are left out.

    Raises:
        BadInputError: fewer than three photographs fit, or they do not determine the focal length or the centre.
    """
    rejected = {view.name: reason for view in views if (reason := too_few_dots(view))}
    rejected |= _outlying_photographs([view for view in views if view.name not in rejected])
    usable = [view for view in views if view.name not in rejected]
    while True:
        _refuse_too_few(usable, rejected)
        fit = _adjusted(usable, np.arange(_COUNT), *_start(usable, size_px))
        worst, reason = _worst(fit)
        if not reason:
            break
        rejected[worst] = reason
        usable = [view for view in usable if view.name != worst]
    cleaned = [without_outliers(view, part.residual) for view, part in zip(fit.views, fit.parts, strict=True)]
    fit = _adjusted(cleaned, fit.free, fit.camera, fit.camera_from_board)
    free = _selected_terms(fit)
    fit = _adjusted(cleaned, free, _with_only(fit.camera, free), fit.camera_from_board)
    sigma = np.zeros(_COUNT)
    sigma[free] = np.sqrt(np.diag(fit.lens_covariance))
    if np.any(sigma[: len(_PINHOLE)] > _LOOSEST * np.tile(fit.camera.focal_px, 2)):
        raise _undetermined(fit.views)
    poses = BoardPoses(
        fit.camera,
        tuple(view.name for view in fit.views),
        fit.camera_from_board,
        fit.covariance,
        fit.rms_px,
        rejected,
    )
    return CameraCalibration(poses, sigma, tuple(LENS_PARAMETERS[i] for i in free if i not in _PINHOLE), fit.noise)


def _outlying_photographs(views: Sequence[BoardView]) -> dict[str, str]:
    """Photographs whose dots lie nowhere near a plane's image; a lens bends that of all of them alike."""
    misses = np.array([_plane_residual_px(view) for view in views])
    limit = _LENS_BENDS_PX + _MISREAD * float(np.median(misses)) if views else 0.0
    return {
        view.name: f"its dots miss the image of a flat board by {miss:.2g} px; they are misread"
        for view, miss in zip(views, misses, strict=True)
        if not miss <= limit
    }


def _plane_residual_px(view: BoardView) -> float:
    """Rms distance of dots from the best image of a plane by a lens without distortion; NaN where there is none."""
    plane = view.point[:, :2]
    homography = cv2.findHomography(plane, view.pixel)[0]
    if homography is None:
        return np.nan
    seen = cv2.perspectiveTransform(plane[:, None], homography)[:, 0]
    return float(np.sqrt(np.mean((seen - view.pixel) ** 2)))


def _adjusted(
    views: Sequence[BoardView], free: IntArray, camera: LensCamera, camera_from_board: FloatArray
) -> Adjustment:
    try:
        return adjust_bundle(camera, camera_from_board, views, free)
    except UndeterminedError as undetermined:
        raise _undetermined(views) from undetermined


def _start(views: Sequence[BoardView], size_px: tuple[int, int]) -> tuple[LensCamera, FloatArray]:
    some = [slice(None, None, max(1, len(view) // _START_DOTS)) for view in views]
    flat = [(view.point[part] * [1.0, 1.0, 0.0]).astype(np.float32) for view, part in zip(views, some, strict=True)]
    seen = [(view.pixel[part] + OPENCV_PIXEL_SHIFT).astype(np.float32) for view, part in zip(views, some, strict=True)]
    held = cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST
    try:
        _, matrix, distortion, rotations, translations = cv2.calibrateCamera(
            flat, seen, size_px, None, None, flags=held
        )
    except cv2.error as error:
        raise _undetermined(views) from error
    camera = LensCamera(
        size_px,
        np.diag(matrix)[:2].copy(),
        matrix[:2, 2] - OPENCV_PIXEL_SHIFT,
        distortion.ravel()[: len(DISTORTION_TERMS)].copy(),
    )
    poses = [
        transforms.rigid(cv2.Rodrigues(rotation)[0], translation[:, 0])
        for rotation, translation in zip(rotations, translations, strict=True)
    ]
    return camera, np.array(poses)


def _worst(fit: Adjustment) -> tuple[str, str]:
    """The photograph that fits worst, and why it is no good, if it is."""
    scales = np.array([robust_scale(part.residual) for part in fit.parts])
    worst = int(np.argmax(scales))
    return fit.views[worst].name, rejection_reason(scales[worst], float(np.median(scales)))


def _selected_terms(fit: Adjustment) -> IntArray:
    """Indices of the values to find: of all choices of radial order and tangential terms, the one that is worth most.

    What leaving terms out costs is read off the fit with all of them (A. Wald's test).
    """
    values = np.concatenate([fit.camera.focal_px, fit.camera.centre_px, fit.camera.distortion])
    choices = []
    for tangential in (_TANGENTIAL, ()):
        for order in range(len(_RADIAL) + 1):
            free = np.array(sorted({*_PINHOLE, *tangential, *_RADIAL[:order]}))
            left_out = np.setdiff1d(np.arange(_COUNT), free)
            block = fit.lens_covariance[np.ix_(left_out, left_out)]
            cost = values[left_out] @ np.linalg.solve(block, values[left_out]) if len(left_out) else 0.0
            choices.append((float(cost) + _WORTH * len(free), free))
    return min(choices, key=lambda choice: choice[0])[1]


def _with_only(camera: LensCamera, free: IntArray) -> LensCamera:
    distortion = np.where(np.isin(np.arange(len(_PINHOLE), _COUNT), free), camera.distortion, 0.0)
    return LensCamera(camera.size_px, camera.focal_px, camera.centre_px, distortion)


def _refuse_too_few(views: Sequence[BoardView], rejected: dict[str, str]) -> None:
    if len(views) < _FEWEST_VIEWS:
        why = "".join(f"; {name}: {reason}" for name, reason in rejected.items())
        raise BadInputError(
            f"a camera needs {_FEWEST_VIEWS} or more photographs of the board, tilted in different directions, and "
            f"{len(views)} can be used{why}."
        )


def _undetermined(views: Sequence[BoardView]) -> BadInputError:
    return BadInputError(
        f"the {len(views)} photographs {views[0].name} to {views[-1].name} do not determine the camera's focal length "
        "and centre, because they show the board parallel to the image or always at the same tilt; add photographs of "
        "it tilted by 20 to 40 degrees to the left, right, top and bottom."
    )

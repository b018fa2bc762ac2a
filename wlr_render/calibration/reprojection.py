"""How far dots lie from where a camera and a pose have them, and how that changes with both."""

from dataclasses import dataclass

import cv2
import numpy as np

from wlr_render.calibration.board_views import BoardView
from wlr_render.geometry import transforms
from wlr_render.geometry.lens_camera import OPENCV_PIXEL_SHIFT, LensCamera
from wlr_render.numerics.arrays import FloatArray

STRAY = 6.0
"""A dot this many robust sigmas from its place is no reading of the board."""


@dataclass(frozen=True, eq=False)
class Reprojection:
    """One photograph's share of a least-squares problem, all in units of the dots' sigmas.

    Attributes:
        residual: (2 n,) seen minus predicted.
        by_motion: (2 n, 6) derivative of predicted by a small motion in the camera's frame (rad, m).
        by_camera: (2 n, 9) derivative of predicted by fx, fy, cx, cy, k1, k2, p1, p2, k3.
        per_px: (2 n,) what one pixel counts.
    """

    residual: FloatArray
    by_motion: FloatArray
    by_camera: FloatArray
    per_px: FloatArray

    @property
    def chi_square(self) -> float:
        """Sum of squares."""
        return float(self.residual @ self.residual)

    @property
    def rms_px(self) -> float:
        """Rms distance of dots from their places per axis, pixels, weighted as the dots are."""
        return float(np.sqrt(self.chi_square / np.sum(self.per_px**2)))


def reproject(camera: LensCamera, camera_from_board: FloatArray, view: BoardView) -> Reprojection:
    """Compare the dots of `view` with a camera at a pose (4, 4)."""
    point_in_camera = transforms.apply(camera_from_board, view.point)
    # At no rotation OpenCV's derivative by the rotation vector is the one by a small motion that follows the pose.
    still = np.zeros(3)
    seen, slope = cv2.projectPoints(point_in_camera, still, still, camera.opencv_matrix, camera.distortion)
    per_px = np.repeat(1.0 / view.sigma_px, 2)
    residual = (view.pixel - (seen[:, 0] - OPENCV_PIXEL_SHIFT)).ravel() * per_px
    slope = slope * per_px[:, None]
    return Reprojection(residual, slope[:, :6], slope[:, 6:15], per_px)


def robust_scale(residual: FloatArray) -> float:
    """Standard deviation of the bulk of residuals in units of sigma, whatever a few strays do."""
    return float(1.4826 * np.median(np.abs(residual)))


def without_strays(view: BoardView, residual: FloatArray) -> BoardView:
    """The view without dots that lie far off by their residuals (2 n,)."""
    apart = np.abs(residual).reshape(-1, 2).max(axis=1)
    keep = apart <= STRAY * max(robust_scale(residual), 1e-9)
    return BoardView(view.name, view.point[keep], view.pixel[keep], view.sigma_px[keep])

"""Poses of a board before a camera whose lens is known."""

from collections.abc import Sequence

import cv2
import numpy as np

from wlr_render.calibration.board_views import FEWEST_DOTS, BoardPoses, BoardView
from wlr_render.calibration.poses import small_motion
from wlr_render.calibration.reprojection import Reprojection, reproject, robust_scale, without_strays
from wlr_render.geometry import transforms
from wlr_render.geometry.lens_camera import LensCamera
from wlr_render.numerics.arrays import FloatArray

MISFIT = 3.0
"""A photograph whose dots scatter this many times more than usual does not show a flat board, or shows it blurred."""

_STEPS = 30  # of Gauss and Newton; five do
_SETTLED = 1e-4  # of a sigma


def poses_of(camera: LensCamera, views: Sequence[BoardView]) -> BoardPoses:
    """Find the pose of the board in each photograph.

    The dots' noise is taken from how far they miss the pose, at least as large as in the middle one of the photographs.
    The camera's own values count as exact.
    """
    set_aside = {view.name: reason for view in views if (reason := _unusable(camera, view))}
    sound = [view for view in views if view.name not in set_aside]
    found = [_refined(camera, view) for view in sound]
    scales = np.array([robust_scale(part.residual) for _, part in found])
    usual = float(np.median(scales)) if found else 0.0
    kept = []
    for i, view in enumerate(sound):
        reason = misfit(scales[i], usual) if len(sound) > 2 else ""
        if reason:
            set_aside[view.name] = reason
        else:
            kept.append(i)
    covariance = np.zeros((len(kept), 6, len(kept), 6))
    for row, i in enumerate(kept):
        part = found[i][1]
        own = np.sqrt(part.chi_square / (len(part.residual) - 6))
        covariance[row, :, row] = np.linalg.inv(part.by_motion.T @ part.by_motion) * max(own, usual) ** 2
    return BoardPoses(
        camera,
        tuple(sound[i].name for i in kept),
        np.array([found[i][0] for i in kept]).reshape(-1, 4, 4),
        covariance.reshape(6 * len(kept), 6 * len(kept)),
        np.array([found[i][1].rms_px for i in kept]),
        set_aside,
    )


def misfit(scale: float, usual: float) -> str:
    """Why a photograph whose dots scatter by `scale` is no good where `usual` is usual; empty where it is good."""
    if scale <= MISFIT * usual:
        return ""
    return (
        f"its dots miss the best pose of a flat board {scale / usual:.1f} times as far as those of the other "
        "photographs; it is blurred, or its dots are misread, or the lens was changed"
    )


def too_few_dots(view: BoardView) -> str:
    """Why a photograph has too little of the board for a pose; empty where it has enough."""
    return "" if len(view) >= FEWEST_DOTS else f"shows only {len(view)} dots of the board, fewer than {FEWEST_DOTS}"


def _unusable(camera: LensCamera, view: BoardView) -> str:
    if too_few_dots(view):
        return too_few_dots(view)
    seen = np.isfinite(camera.tangents_of_pixel(view.pixel)).all()
    return "" if seen else "shows dots where the camera's lens model has no inverse; measure the lens again"


def _refined(camera: LensCamera, view: BoardView) -> tuple[FloatArray, Reprojection]:
    """Pose (4, 4) of the better of the two ways in which a flat board can be taken, and its fit without strays."""
    best = min(
        (_settled(camera, start, view) for start in _starts(camera, view)), key=lambda found: found[1].chi_square
    )
    cleaned = without_strays(view, best[1].residual)
    return best if len(cleaned) == len(view) else _settled(camera, best[0], cleaned)


def _starts(camera: LensCamera, view: BoardView) -> list[FloatArray]:
    """Both solutions of T. Collins and A. Bartoli, "Infinitesimal plane-based pose estimation", IJCV 109 (2014) 252."""
    flat = view.point * [1.0, 1.0, 0.0]
    tangents = camera.tangents_of_pixel(view.pixel)
    _, rotations, translations, _ = cv2.solvePnPGeneric(flat, tangents, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    return [
        transforms.rigid(cv2.Rodrigues(rotation)[0], translation[:, 0])
        for rotation, translation in zip(rotations, translations, strict=True)
    ]


def _settled(camera: LensCamera, camera_from_board: FloatArray, view: BoardView) -> tuple[FloatArray, Reprojection]:
    part = reproject(camera, camera_from_board, view)
    for _ in range(_STEPS):
        normal = part.by_motion.T @ part.by_motion
        step = np.asarray(np.linalg.solve(normal, part.by_motion.T @ part.residual), dtype=np.float64)
        camera_from_board = small_motion(step) @ camera_from_board
        part = reproject(camera, camera_from_board, view)
        if step @ normal @ step < _SETTLED**2:
            break
    return camera_from_board, part

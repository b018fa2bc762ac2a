"""Poses of a board in photographs by a camera with a known lens: observed dots, their reprojection, and the fit."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from wlr_render.calibration.poses import Pose, motion_rows, small_motion
from wlr_render.captures.boards.board import Board, BoardObservation
from wlr_render.geometry import transforms
from wlr_render.geometry.lens_camera import LENS_PARAMETERS, OPENCV_PIXEL_SHIFT, LensCamera
from wlr_render.numerics.arrays import FloatArray

FEWEST_DOTS = 8
"""A pose has 6 unknowns; four dots are 8 readings, and twice that tells whether they are right."""

OUTLIER_SIGMAS = 6.0
"""A dot this many robust sigmas from its place is no reading of the board."""
POOR_FIT_RATIO = 3.0
"""A photograph whose dots scatter this many times more than usual does not show a flat board, or shows it blurred."""
_STEPS = 30  # of Gauss and Newton; five do
_SETTLED = 1e-4  # of a sigma


@dataclass(frozen=True, eq=False)
class BoardView:
    """Dots of a flat board in one photograph.

    Attributes:
        name: of the photograph, as messages should have it.
        point: (n, 3) dots, board frame, metres.
        pixel: (n, 2) where they are seen, from the outer corner of the top-left pixel.
        sigma_px: (n,) standard deviation of `pixel` per axis; only their ratios matter to poses.
    """

    name: str
    point: FloatArray
    pixel: FloatArray
    sigma_px: FloatArray

    @classmethod
    def of_observation(cls, name: str, observation: BoardObservation, board: Board) -> "BoardView":
        """Return the view of the board observed in the photograph `name`."""
        return cls(name, board.point_of(observation.index), observation.pixel, observation.sigma_px)

    def __len__(self) -> int:
        return len(self.point)


@dataclass(frozen=True, eq=False)
class BoardPoses:
    """Poses of the board in photographs of one camera, with their joint covariance.

    Attributes:
        camera: the lens that the poses were found with.
        names: n photographs.
        camera_from_board: (n, 4, 4).
        covariance: (6 n, 6 n) of small motions in the camera's frame, of all photographs together: an error of the
            camera's own values moves all poses at once.
        rms_px: (n,) rms distance per axis of dots from where the pose has them.
        rejected: name -> reason, of photographs that gave no pose.
    """

    camera: LensCamera
    names: tuple[str, ...]
    camera_from_board: FloatArray
    covariance: FloatArray
    rms_px: FloatArray
    rejected: Mapping[str, str] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, name: str) -> Pose:
        i = self.names.index(name)
        return Pose(self.camera_from_board[i], self.covariance[6 * i : 6 * i + 6, 6 * i : 6 * i + 6])

    def only(self, names: Sequence[str]) -> "BoardPoses":
        """The poses of some photographs, in the order of `names`."""
        index = np.array([self.names.index(name) for name in names], dtype=np.int64)
        rows = motion_rows(index)
        return replace(
            self,
            names=tuple(names),
            camera_from_board=self.camera_from_board[index],
            covariance=self.covariance[np.ix_(rows, rows)],
            rms_px=self.rms_px[index],
        )


@dataclass(frozen=True, eq=False)
class Reprojection:
    """Residuals of one photograph and their Jacobians, in units of the dots' sigmas.

    Attributes:
        residual: (2 n,) seen minus predicted.
        by_motion: (2 n, 6) derivative of predicted by a small motion in the camera's frame (rad, m).
        by_camera: (2 n, 9) derivative of predicted by the `LENS_PARAMETERS`.
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
    """Return the residuals of `view` for a camera at a pose (4, 4)."""
    point_in_camera = transforms.apply(camera_from_board, view.point)
    # At no rotation OpenCV's derivative by the rotation vector is the one by a small motion that follows the pose.
    still = np.zeros(3)
    seen, slope = cv2.projectPoints(point_in_camera, still, still, camera.opencv_matrix, camera.distortion)
    per_px = np.repeat(1.0 / view.sigma_px, 2)
    residual = (view.pixel - (seen[:, 0] - OPENCV_PIXEL_SHIFT)).ravel() * per_px
    slope = slope * per_px[:, None]
    return Reprojection(residual, slope[:, :6], slope[:, 6 : 6 + len(LENS_PARAMETERS)], per_px)


def robust_scale(residual: FloatArray) -> float:
    """Standard deviation of the bulk of residuals in units of sigma, whatever a few outliers do."""
    return float(1.4826 * np.median(np.abs(residual)))


def without_outliers(view: BoardView, residual: FloatArray) -> BoardView:
    """The view without dots that lie far off by their residuals (2 n,)."""
    apart = np.abs(residual).reshape(-1, 2).max(axis=1)
    keep = apart <= OUTLIER_SIGMAS * max(robust_scale(residual), 1e-9)
    return BoardView(view.name, view.point[keep], view.pixel[keep], view.sigma_px[keep])


def poses_of(camera: LensCamera, views: Sequence[BoardView]) -> BoardPoses:
    """Find the pose of the board in each photograph.

    The dots' noise is taken from how far they miss the pose, at least as large as in the middle one of the photographs.
    The camera's own values count as exact.
    """
    rejected = {view.name: reason for view in views if (reason := _unusable(camera, view))}
    sound = [view for view in views if view.name not in rejected]
    found = [_refined(camera, view) for view in sound]
    scales = np.array([robust_scale(part.residual) for _, part in found])
    usual = float(np.median(scales)) if found else 0.0
    kept = []
    for i, view in enumerate(sound):
        reason = rejection_reason(scales[i], usual) if len(sound) > 2 else ""
        if reason:
            rejected[view.name] = reason
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
        rejected,
    )


def rejection_reason(scale: float, usual: float) -> str:
    """Why a photograph with residual scale `scale` is rejected where `usual` is usual; empty where it is not."""
    if scale <= POOR_FIT_RATIO * usual:
        return ""
    return (
        f"its dots miss the best pose of a flat board {scale / usual:.1f} times as far as those of the other "
        "photographs; it is blurred, or its dots are misread, or the lens was changed"
    )


def too_few_dots(view: BoardView) -> str:
    """Why a photograph shows too few dots for a pose; empty where it shows enough."""
    return "" if len(view) >= FEWEST_DOTS else f"shows only {len(view)} dots of the board, fewer than {FEWEST_DOTS}"


def _unusable(camera: LensCamera, view: BoardView) -> str:
    if too_few_dots(view):
        return too_few_dots(view)
    seen = np.isfinite(camera.tangents_of_pixel(view.pixel)).all()
    return "" if seen else "shows dots where the camera's lens model has no inverse; measure the lens again"


def _refined(camera: LensCamera, view: BoardView) -> tuple[FloatArray, Reprojection]:
    """Pose (4, 4) of the better of the two ways in which a flat board can be taken, and its fit without outliers."""
    best = min(
        (_settled(camera, start, view) for start in _starts(camera, view)), key=lambda found: found[1].chi_square
    )
    cleaned = without_outliers(view, best[1].residual)
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

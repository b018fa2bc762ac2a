"""The photographs of a simulated session: where the camera is told to stand, and how the boards are held."""

from dataclasses import dataclass

import numpy as np

from wlr_render.geometry import transforms
from wlr_render.geometry.lens_camera import LensCamera
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.photographs.photo_bench import PhotoBench, stage_readings

_TILTS_DEG = ((0, 0), (28, 0), (-28, 0), (0, 28), (0, -28), (20, 20), (-20, 20), (20, -20), (-20, -20))
_FILL = (0.75, 1.1)  # of the picture's width by the board, by turns


@dataclass(frozen=True, eq=False)
class PhotoPlan:
    """Places of the photographs of a session.

    Attributes:
        sweep: (m, 3) stage readings for the panel, and for the target through the optics.
        bare: (n, 3) stage readings for the target without the headset, along all axes.
        bare_poses: the target's poses that are photographed without the headset: the first before it is mounted, the
            last after it is taken off again, so that a target that moved in between is noticed.
        eyeball_boards, tracking_boards: (k, 4, 4) camera_from_board, for the intrinsics of each camera.
    """

    sweep: FloatArray
    bare: FloatArray
    bare_poses: tuple[int, ...]
    eyeball_boards: FloatArray
    tracking_boards: FloatArray


def stage_axis_count(bench: PhotoBench) -> int:
    """Number of axes of the bench's stage; 0 for a camera in the hand."""
    return 0 if bench.options.stage == "hand" else len(bench.options.stage)


def plan_photographs(bench: PhotoBench, viewpoints: int) -> PhotoPlan:
    """Plan all photographs of a session with `viewpoints` camera positions."""
    axes = stage_axis_count(bench)
    sweep = stage_readings(bench, viewpoints)
    sweep[:, axes:] = 0.0
    steps = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 2, [0.0]), axis=-1).reshape(-1, 3)
    steps = np.concatenate([steps, [[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]])
    steps = steps[~np.any(steps[:, axes:], axis=1)]
    reach = [*np.abs(sweep[:, :2]).max(axis=0), 0.5 * bench.optics.eye_box.size[2]]
    poses = len(bench.device_from_target)
    return PhotoPlan(
        sweep,
        np.round(steps * reach, 4),
        tuple(dict.fromkeys((0, poses - 1))) if axes else (),
        _boards_before(bench.eyeball.camera, bench.board.size_m),
        _boards_before(bench.tracking.camera, bench.board.size_m),
    )


def _boards_before(camera: LensCamera, board_m: FloatArray) -> FloatArray:
    """camera_from_board (k, 4, 4): the board tilted every way, filling the picture or more, also off its middle."""
    poses = []
    for number, tilt in enumerate(_TILTS_DEG):
        for fill, side in zip(_FILL, (1, -1), strict=True):
            depth = float(np.max(board_m / np.array(camera.size_px) * camera.focal_px)) / fill
            shift = 0.12 * side * depth * np.array(camera.size_px) / camera.focal_px
            turn = transforms.rotations_of_vectors(np.deg2rad([*tilt, 90.0 * (number % 4) + 11.0 * side]))
            poses.append(transforms.rigid(turn, np.array([shift[0], shift[1] * (-1) ** number, depth])))
    return np.stack(poses)

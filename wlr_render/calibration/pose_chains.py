"""Pose chains from the device to the eyeball camera, one through each target pose, and their mean."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from wlr_render.calibration.board_poses import BoardPoses
from wlr_render.calibration.poses import Pose, adjoint, mean_of_dependent, motion_rows
from wlr_render.calibration.stage_fit import StageFit
from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.numerics.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class TrackedTargets:
    """The target in the device frame, as the tracking camera sees it.

    Attributes:
        poses: number of the target pose -> device_from_target.
        covariance: (6 n, 6 n) of small motions of all of them in the device frame; they share the lens.
    """

    poses: Mapping[int, Pose]
    covariance: FloatArray


@dataclass(frozen=True, eq=False)
class PoseChains:
    """The eyeball camera in the device frame by way of each target pose that both cameras saw.

    Attributes:
        targets: n numbers of target poses.
        device_from_camera: (n, 4, 4) at the stage's reference reading.
        covariance: (6 n, 6 n) of small motions in the device frame.
        with_axes: (6 n, 3 m) covariance with the axes of the stage.
    """

    targets: tuple[int, ...]
    device_from_camera: FloatArray
    covariance: FloatArray
    with_axes: FloatArray


def tracked_targets(
    tracking: BoardPoses, by_target: Mapping[int, Sequence[str]], device_from_tracking: FloatArray
) -> TrackedTargets:
    """Return the mean device_from_target of each target pose seen by the tracking camera.

    Args:
        tracking: poses of the board before the tracking camera.
        by_target: number of the target pose -> one or more photographs of it.
        device_from_tracking: (4, 4).
    """
    weights = np.zeros((len(by_target), 6, len(tracking), 6))
    covariance = np.zeros((len(by_target), 6, len(by_target), 6))
    poses = {}
    exact = Pose(device_from_tracking, np.zeros((6, 6)))
    for row, (target, names) in enumerate(by_target.items()):
        some = tracking.only(names)
        mean = mean_of_dependent(some.camera_from_board, some.covariance)
        poses[target] = exact @ mean.pose
        for name, weight in zip(names, mean.weights, strict=True):
            weights[row, :, tracking.names.index(name)] = adjoint(device_from_tracking) @ weight
    flat = weights.reshape(6 * len(by_target), 6 * len(tracking))
    covariance = (flat @ tracking.covariance @ flat.T).reshape(covariance.shape)
    for row, pose in enumerate(poses.values()):
        covariance[row, :, row] = pose.covariance  # this one is widened where photographs contradict each other
    return TrackedTargets(poses, covariance.reshape(len(flat), len(flat)))


def pose_chains(stage: StageFit, targets: TrackedTargets) -> PoseChains:
    """Return device_from_target @ target_from_camera for each target pose that both cameras saw.

    Raises:
        BadInputError: there is none.
    """
    seen, tracked = list(stage.camera_from_target), list(targets.poses)
    common = [target for target in seen if target in tracked]
    if not common:
        raise BadInputError(
            f"no pose of the target has both a photograph without the headset (poses {seen}) and one by the tracking "
            f"camera (poses {tracked}); one pose must have both, to place the eyeball camera in the device frame."
        )
    chains = np.array([targets.poses[k].b_from_a @ transforms.inverse(stage.camera_from_target[k]) for k in common])
    axes = 3 * len(stage.moved_axes)
    of_seen = axes + motion_rows([seen.index(k) for k in common])
    of_tracked = motion_rows([tracked.index(k) for k in common])
    by_seen = np.zeros((len(common), 6, len(common), 6))
    for i, chain in enumerate(chains):
        by_seen[i, :, i] = -adjoint(chain)
    flat = by_seen.reshape(6 * len(common), -1)
    covariance = targets.covariance[np.ix_(of_tracked, of_tracked)]
    covariance = covariance + flat @ stage.covariance[np.ix_(of_seen, of_seen)] @ flat.T
    return PoseChains(tuple(common), chains, covariance, flat @ stage.covariance[of_seen, :axes])


def mean_camera_pose(stage: StageFit, chains: PoseChains) -> tuple[FloatArray, FloatArray]:
    """Return the mean device_from_camera at the reference, and its covariance (6 + 3 m, 6 + 3 m) with the axes."""
    mean = mean_of_dependent(chains.device_from_camera, chains.covariance)
    with_axes = np.concatenate(list(mean.weights), axis=1) @ chains.with_axes
    axes = with_axes.shape[1]
    covariance = np.block([[mean.pose.covariance, with_axes], [with_axes.T, stage.covariance[:axes, :axes]]])
    return mean.pose.b_from_a, covariance

"""Whether the steps of a calibration agree with each other, so that the one that is off is named."""

import numpy as np

from wlr_render.calibration.board_views import BoardPoses
from wlr_render.calibration.chains import Chains
from wlr_render.calibration.check import Change, Check
from wlr_render.calibration.poses import mean_of_dependent, motion_between

_POOR_FIT_PX = 0.5


def lens_check(step: str, poses: BoardPoses) -> Check:
    """Whether dots lie where a lens has them."""
    worst = int(np.argmax(poses.rms_px))
    rms_px = float(poses.rms_px[worst])
    ok = rms_px <= _POOR_FIT_PX
    sentence = f"dots lie where the lens has them to {rms_px:.2g} px rms"
    if not ok:
        sentence = (
            f"dots of {poses.names[worst]} miss the lens model by {rms_px:.2g} px rms; the focal length, centre or "
            "distortion are not this camera's, or the board is not flat: calibrate the camera again"
        )
    return Check(step, "misfit of dots, px", rms_px, 0.0, _POOR_FIT_PX, sentence, ok)


def set_aside_checks(poses: BoardPoses) -> list[Check]:
    """One failed check per photograph that gave no pose."""
    return [
        Check(name, "pose of the board", np.nan, np.nan, np.nan, f"set aside: {name} {reason}", ok=False)
        for name, reason in poses.set_aside.items()
    ]


def chain_check(chains: Chains) -> Check | None:
    """Whether all target poses put the camera at one place; None if there is only one target pose.

    A wrong scale of the board does not show here: it moves the cameras apart by as much at every target pose.
    """
    count = len(chains.targets)
    if count < 2:
        return None
    # Of two, each is as far from the other.
    changes = [_against_others(chains, k) for k in range(count if count > 2 else 1)]
    worst = int(np.argmax([change.sigmas for change in changes]))
    change = changes[worst]
    poses = f"pose {chains.targets[worst]}" if count > 2 else f"pose {chains.targets[0]} or {chains.targets[1]}"
    sentence = (
        f"the target moved between its photographs without the headset and its tracking photographs at target {poses}: "
        f"the camera's place by way of it differs by {change}; take both again"
    )
    right = f"target poses {', '.join(map(str, chains.targets))} put the camera at one place, to {change}"
    return change.check(f"target {poses}", sentence, right)


def _against_others(chains: Chains, k: int) -> Change:
    """How far the camera by way of one target pose is from where the others have it."""
    others = [i for i in range(len(chains.targets)) if i != k]
    rows = (6 * np.array(others)[:, None] + np.arange(6)).ravel()
    own = 6 * k + np.arange(6)
    mean = mean_of_dependent(chains.device_from_camera[others], chains.covariance[np.ix_(rows, rows)])
    by_all = np.zeros((6, len(chains.covariance)))
    by_all[:, own] = np.eye(6)
    by_all[:, rows] = -np.concatenate(list(mean.weights), axis=1)
    motion = motion_between(mean.pose.b_from_a, chains.device_from_camera[k])
    place = mean.pose.b_from_a[:3, 3]
    return Change.of_motion(motion, by_all @ chains.covariance @ by_all.T, place)

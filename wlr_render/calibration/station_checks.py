"""Checks of the stage, and of the calibration steps against each other, that name the step at fault."""

from itertools import combinations

import numpy as np

from wlr_render.calibration.board_poses import BoardPoses
from wlr_render.calibration.check import (
    NEGLIGIBLE_ARCMIN,
    NEGLIGIBLE_MM,
    REFUSED_ARCMIN,
    REFUSED_MM,
    REFUSED_SIGMAS,
    WARNED_SIGMAS,
    Change,
    Check,
)
from wlr_render.calibration.pose_chains import PoseChains
from wlr_render.calibration.poses import mean_of_dependent, motion_between, motion_rows
from wlr_render.calibration.stage_fit import StageFit, TargetMoved
from wlr_render.geometry.directions import ARCMIN
from wlr_render.numerics.arrays import FloatArray

STEP = "photographs without the headset"

_SCALE = 0.002  # 1 mm in the distance of a target at half a metre; good printers and stages do better
_REFUSED_SCALE = 0.02  # 10 mm in the distance of a target at half a metre
_SKEW_DEG = 1.0
_UNIT = 0.1  # how far, in powers of ten, a factor may be from 1000 to be a mistaken unit

_POOR_FIT_PX = 0.5


def stage_checks(stage: StageFit) -> list[Check]:
    """Check straightness, orientation, scales and angles of a fitted stage, and the photographs it rejected."""
    return [*_moved_photographs(stage), *_straightness(stage), *_scales(stage), *_angles(stage)]


def _moved_photographs(stage: StageFit) -> list[Check]:
    """One failed check per rejected photograph."""
    checks = []
    for name, motion in stage.rejected.items():
        shift_mm, turn_arcmin = _size(motion)
        sentence = (
            f"the target or the camera moved at {name}, which lies {shift_mm:.3g} mm and {turn_arcmin:.2g}' from where "
            "the other photographs have it; it was rejected: take it again, or correct its stage reading"
        )
        checks.append(Check(name, "shift, mm", shift_mm, 0.0, NEGLIGIBLE_MM, sentence, ok=False))
    return checks


def _straightness(stage: StageFit) -> list[Check]:
    """Checks of the camera's repeatability in position and orientation; or of the target, where that moved."""
    if stage.target_moved:
        return [_moved_target(stage.target_moved)]
    um, urad = 1e6 * stage.jitter.translation_m, 1e6 * stage.jitter.rotation_rad
    shift_mm, turn_arcmin = np.sqrt(3) * 1e-3 * um, np.sqrt(3) * stage.jitter.rotation_rad / ARCMIN
    relative_sigma = 1.0 / np.sqrt(12 * len(stage.names))
    straight = shift_mm <= NEGLIGIBLE_MM
    steady = turn_arcmin <= NEGLIGIBLE_ARCMIN
    out_of_plane = f", {1e3 * stage.out_of_plane_m:.3g} mm of it out of its plane" if len(stage.moved_axes) == 2 else ""
    return [
        Check(
            STEP,
            "departure from straight motion, mm",
            shift_mm,
            shift_mm * relative_sigma,
            NEGLIGIBLE_MM,
            f"the stage moves straight to {um:.2g} um per axis"
            if straight
            else f"the stage does not move in a straight line or plane: the camera departs by {shift_mm:.3g} mm rms "
            f"({um:.3g} um per axis){out_of_plane}; use a smaller range, and check that stage, camera and target are "
            "fixed",
            ok=straight,
            contradictory=shift_mm > REFUSED_MM,
        ),
        Check(
            STEP,
            "rotation of the camera between stage readings, arcmin",
            turn_arcmin,
            turn_arcmin * relative_sigma,
            NEGLIGIBLE_ARCMIN,
            f"the stage keeps the camera's orientation to {urad:.2g} microradians per axis"
            if steady
            else f"the stage rotates the camera by {turn_arcmin:.2g}' rms ({urad:.3g} microradians per axis) between "
            "its readings; use a smaller range or a stage with less roll, pitch and yaw, and check that the camera is "
            "clamped",
            ok=steady,
            contradictory=turn_arcmin > REFUSED_ARCMIN,
        ),
    ]


def _moved_target(moved: TargetMoved) -> Check:
    shift_mm, turn_arcmin = _size(moved.motion)
    return Check(
        STEP,
        "shift of the target, mm",
        shift_mm,
        0.0,
        NEGLIGIBLE_MM,
        f"the target moved between {moved.before} and {moved.after}, in the eyeball camera's frame by "
        f"{shift_mm:.3g} mm and {turn_arcmin:.2g}'; take the photographs without the headset again",
        ok=False,
        contradictory=shift_mm > REFUSED_MM or turn_arcmin > REFUSED_ARCMIN,
    )


def _size(motion: FloatArray) -> tuple[float, float]:
    """Millimetres and arcminutes of a small motion (6,)."""
    return 1e3 * float(np.linalg.norm(motion[3:])), float(np.linalg.norm(motion[:3])) / ARCMIN


def _scales(stage: StageFit) -> list[Check]:
    checks = []
    for column, axis in enumerate(stage.moved_axes):
        vector = stage.axes[:, column]
        length = float(np.linalg.norm(vector))
        rows = slice(3 * column, 3 * column + 3)
        sigma = float(np.sqrt(vector @ stage.covariance[rows, rows] @ vector)) / length
        off = abs(length - 1.0)
        ok = off <= max(_SCALE, WARNED_SIGMAS * sigma)
        checks.append(
            Check(
                STEP,
                f"travel along axis {'xyz'[axis]} by the board's pitch over the reading, less 1",
                length - 1.0,
                sigma,
                _SCALE,
                _scale_sentence("xyz"[axis], length, ok),
                ok,
                contradictory=off > max(_REFUSED_SCALE, REFUSED_SIGMAS * sigma),
            )
        )
    return checks


def _scale_sentence(axis: str, length: float, ok: bool) -> str:
    if ok:
        return f"the stage's axis {axis} and the board's pitch agree to {100 * (length - 1):+.2g} %"
    if abs(abs(np.log10(length)) - 3) < _UNIT:
        wrong = "small, as metres read as millimetres are" if length > 1 else "large, as millimetres read as metres are"
        return (
            f"the stage readings along axis {axis} are 1000 times too {wrong} (or the board's pitch is in another "
            "unit); correct the unit in the session file"
        )
    return (
        f"1 mm of the stage's axis {axis} is {length:.4g} mm by the board's printed pitch; measure the pitch over many "
        "dots with a rule (printers scale to fit the page), or correct the scale of the stage"
    )


def _angles(stage: StageFit) -> list[Check]:
    checks = []
    for i, j in combinations(range(len(stage.moved_axes)), 2):
        first, second = stage.axes[:, i], stage.axes[:, j]
        size = np.linalg.norm(first) * np.linalg.norm(second)
        skew_deg = float(np.degrees(np.arcsin(first @ second / size)))
        gradient = np.concatenate([second, first]) / size
        rows = np.concatenate([3 * i + np.arange(3), 3 * j + np.arange(3)])
        sigma_deg = float(np.degrees(np.sqrt(gradient @ stage.covariance[np.ix_(rows, rows)] @ gradient)))
        ok = abs(skew_deg) <= max(_SKEW_DEG, WARNED_SIGMAS * sigma_deg)
        pair = f"{'xyz'[stage.moved_axes[i]]} and {'xyz'[stage.moved_axes[j]]}"
        sentence = f"the stage's axes {pair} are {90 - skew_deg:.2f} deg apart"
        if not ok:
            sentence += "; they should be at right angles: are readings of two axes mixed up, or is the stage loose?"
        checks.append(Check(STEP, f"angle of axes {pair} less 90, deg", -skew_deg, sigma_deg, _SKEW_DEG, sentence, ok))
    return checks


def lens_check(step: str, poses: BoardPoses) -> Check:
    """Check the reprojection error of the photograph that fits worst."""
    worst = int(np.argmax(poses.rms_px))
    rms_px = float(poses.rms_px[worst])
    ok = rms_px <= _POOR_FIT_PX
    sentence = f"reprojection error {rms_px:.2g} px rms"
    if not ok:
        sentence = (
            f"reprojection error of {poses.names[worst]} is {rms_px:.2g} px rms; the focal length, centre or "
            "distortion are not this camera's, or the board is not flat: calibrate the camera again"
        )
    return Check(step, "reprojection error, px", rms_px, 0.0, _POOR_FIT_PX, sentence, ok)


def rejection_checks(poses: BoardPoses) -> list[Check]:
    """One failed check per photograph that gave no pose."""
    return [
        Check(name, "pose of the board", np.nan, np.nan, np.nan, f"rejected: {name} {reason}", ok=False)
        for name, reason in poses.rejected.items()
    ]


def chain_check(chains: PoseChains) -> Check | None:
    """Check that all target poses give one camera pose; None if there is only one target pose.

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


def _against_others(chains: PoseChains, k: int) -> Change:
    """Difference of the camera pose by one target pose from the mean by the others."""
    others = [i for i in range(len(chains.targets)) if i != k]
    rows, own = motion_rows(others), motion_rows([k])
    mean = mean_of_dependent(chains.device_from_camera[others], chains.covariance[np.ix_(rows, rows)])
    by_all = np.zeros((6, len(chains.covariance)))
    by_all[:, own] = np.eye(6)
    by_all[:, rows] = -np.concatenate(list(mean.weights), axis=1)
    motion = motion_between(mean.pose.b_from_a, chains.device_from_camera[k])
    place = mean.pose.b_from_a[:3, 3]
    return Change.of_motion(motion, by_all @ chains.covariance @ by_all.T, place)

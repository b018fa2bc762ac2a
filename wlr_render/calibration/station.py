"""The calibration station: where the eyeball camera is in the device frame at any stage reading, and the target.

Without the headset the eyeball camera sees the target; with the headset mounted its tracking camera does. The target
has not moved in between, so that `device_from_camera = device_from_target @ target_from_camera`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from wlr_render.calibration.board_poses import BoardPoses, BoardView
from wlr_render.calibration.check import Change, Check
from wlr_render.calibration.pose_chains import PoseChains, mean_camera_pose, pose_chains, tracked_targets
from wlr_render.calibration.poses import Pose, adjoint, motion_between
from wlr_render.calibration.stage_fit import StageFit, fit_stage
from wlr_render.calibration.station_checks import STEP, chain_check, lens_check, rejection_checks, stage_checks
from wlr_render.calibration.sweep_checks import RepeatedView, TargetChange, sweep_check
from wlr_render.captures.photo_session import BoardPhotograph
from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.numerics.arrays import FloatArray

_TRACKING = "photographs by the tracking camera"


@dataclass(frozen=True, eq=False)
class StationPhotos:
    """Photographs of the target, each list in the order of taking.

    Attributes:
        bare: by the eyeball camera, without the headset.
        tracking: by the tracking camera; the first of a target pose before its sweep, the last after it.
        repeated: through the optics, pairs at one camera place.
    """

    bare: Sequence[BoardPhotograph]
    tracking: Sequence[BoardPhotograph]
    repeated: Sequence[RepeatedView] = ()


def repeated_views(photos: Sequence[BoardPhotograph], views: Mapping[str, BoardView]) -> tuple[RepeatedView, ...]:
    """Return first and last photographs through the optics where target pose and camera place were repeated.

    Args:
        photos: through the optics, in the order of taking.
        views: name of a photograph -> what was found of the board in it; photographs that are not here are left out.
    """
    places: dict[tuple[int, str], list[BoardPhotograph]] = {}
    for photo in photos:
        if photo.name in views:
            places.setdefault((photo.target_pose, photo.place), []).append(photo)
    return tuple(
        RepeatedView(taken[0].target_pose, np.asarray(taken[0].stage), views[taken[0].name], views[taken[-1].name])
        for taken in places.values()
        if len(taken) > 1
    )


@dataclass(frozen=True, eq=False)
class Station:
    """Stage, eyeball camera and target in the device frame.

    Attributes:
        stage: how the stage carries the camera.
        at_reference: device_from_camera (4, 4) at the stage's reference reading.
        covariance: (6 + 3 m, 6 + 3 m) of a small motion of `at_reference` in the device frame and of the m axes.
        device_from_target: number of the target pose -> pose.
        checks: all that was checked; those that are not `ok` say which step is off.
        unchecked: what could not be checked, and what to photograph so that it can.
    """

    stage: StageFit
    at_reference: FloatArray
    covariance: FloatArray
    device_from_target: Mapping[int, Pose]
    checks: Sequence[Check] = ()
    unchecked: Sequence[str] = ()

    def device_from_camera(self, reading: FloatArray) -> FloatArray:
        """(..., 3) stage readings -> (..., 4, 4).

        Raises:
            BadInputError: a reading of an axis that no photograph without the headset moved.
        """
        return np.asarray(self.at_reference @ transforms.rigid(np.eye(3), self.stage.displacement(reading)))

    def pose_at(self, reading: FloatArray) -> Pose:
        """device_from_camera at one reading (3,); its covariance includes the repeatability of the stage."""
        device_from_camera = self.device_from_camera(reading)
        by_axes = (np.asarray(reading) - self.stage.reference)[self.stage.moved_axes]
        by_all = np.zeros((6, len(self.covariance)))
        by_all[:, :6] = np.eye(6)
        by_all[3:, 6:] = np.concatenate([travel * self.at_reference[:3, :3] for travel in by_axes], axis=1)
        in_device = adjoint(device_from_camera)
        repeatability = in_device @ self.stage.jitter.covariance @ in_device.T
        return Pose(device_from_camera, by_all @ self.covariance @ by_all.T + repeatability)

    @property
    def stage_axes_in_device(self) -> FloatArray:
        """(3, m) true displacement per reading of each axis that moved, metres per metre."""
        return np.asarray(self.at_reference[:3, :3] @ self.stage.axes)


def find_station(
    photos: StationPhotos, eyeball: BoardPoses, tracking: BoardPoses, device_from_tracking: FloatArray
) -> Station:
    """Fit the stage, the eyeball camera and the target in the device frame, and check the steps against each other.

    Checks that fail are in the result; `check.refuse_contradictions` stops on those that are too far off.

    Args:
        photos: what was photographed where; those without a pose are left out.
        eyeball: the board before the eyeball camera, in at least the `bare` photographs.
        tracking: the board before the headset's tracking camera.
        device_from_tracking: (4, 4) where the tracking camera sits.

    Raises:
        BadInputError: photographs of a step are missing, or do not determine it.
    """
    bare = [photo for photo in photos.bare if photo.name in eyeball.names]
    seen = eyeball.only([photo.name for photo in bare])
    readings = np.array([photo.stage for photo in bare], dtype=np.float64).reshape(-1, 3)
    stage = fit_stage(seen, [photo.target_pose for photo in bare], readings)
    by_target = _tracked(photos.tracking, tracking)
    targets = tracked_targets(tracking, by_target, device_from_tracking)
    chains = pose_chains(stage, targets)
    station = Station(stage, *mean_camera_pose(stage, chains), targets.poses)
    changes = {
        target: _target_change(tracking.only(names), device_from_tracking)
        for target, names in by_target.items()
        if len(names) > 1
    }
    sweeps = {
        target: sweep_check(
            target,
            changes.get(target),
            [view for view in photos.repeated if view.target == target],
            eyeball.camera,
            station.device_from_camera,
        )
        for target in sorted({*by_target, *(view.target for view in photos.repeated)})
    }
    found = [
        *rejection_checks(eyeball),
        *rejection_checks(tracking),
        lens_check(STEP, seen),
        lens_check(_TRACKING, tracking.only([name for names in by_target.values() for name in names])),
        *stage_checks(stage),
        chain_check(chains),
        *sweeps.values(),
    ]
    checks = tuple(check for check in found if check is not None)
    return replace(station, checks=checks, unchecked=tuple(_unchecked(chains, sweeps)))


def _tracked(photos: Sequence[BoardPhotograph], tracking: BoardPoses) -> dict[int, list[str]]:
    """Number of each target pose -> the photographs by the tracking camera that show it."""
    by_target: dict[int, list[str]] = {}
    for photo in photos:
        if photo.name in tracking.names:
            by_target.setdefault(photo.target_pose, []).append(photo.name)
    if not by_target:
        raise BadInputError(
            "no photograph by the tracking camera shows the target; the device frame needs at least one."
        )
    return by_target


def _target_change(tracking: BoardPoses, device_from_tracking: FloatArray) -> TargetChange:
    """From the first to the last photograph."""
    first, last = tracking.camera_from_board[0], tracking.camera_from_board[-1]
    by_both = np.zeros((6, len(tracking.covariance)))
    by_both[:, :6], by_both[:, -6:] = -adjoint(last @ transforms.inverse(first)), np.eye(6)
    covariance = by_both @ tracking.covariance @ by_both.T
    change = Change.of_motion(motion_between(first, last), covariance, first[:3, 3])
    names = (tracking.names[0], tracking.names[-1])
    return TargetChange(names, device_from_tracking @ first, device_from_tracking @ last, change)


def _unchecked(chains: PoseChains, sweeps: Mapping[int, Check | None]) -> list[str]:
    """Sentences."""
    said = [
        f"whether anything moved during the sweep at target pose {target} is not known: photograph the target with the "
        "tracking camera after the sweep as well, and repeat a photograph through the optics"
        for target, check in sweeps.items()
        if check is None
    ]
    if len(chains.targets) < 2:
        said.append(
            "whether the target moved between its photographs without the headset and its tracking photograph is not "
            "known: photograph it without the headset at a second target pose as well"
        )
    return said

"""Calibrate one eye from the photographs of a session: cameras, station, captures in the device frame, models."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from wlr_render.calibration.board_poses import BoardPoses, BoardView, poses_of
from wlr_render.calibration.camera_calibration import CameraCalibration, calibrate_camera
from wlr_render.calibration.capture_outliers import CaptureOutlier, display_outliers, dot_inliers, see_through_outliers
from wlr_render.calibration.check import refuse_contradictions
from wlr_render.calibration.fit_eye import EyeFit, KindComparison
from wlr_render.calibration.photograph_captures import (
    Headset,
    PanelView,
    TargetView,
    display_captures,
    recorded_of,
    see_through_captures,
    within_field,
)
from wlr_render.calibration.station import Station, StationPhotos, find_station, repeated_views
from wlr_render.calibration.station_file import save_station
from wlr_render.captures.boards.board import BoardObservation
from wlr_render.captures.capture_file import save_captures
from wlr_render.captures.correspondences import EyeCaptures, SeeThroughCaptures, select
from wlr_render.captures.photo_session import BoardPhotograph, PhotoSession, SessionCamera
from wlr_render.captures.session_reading import Excluded, Reading
from wlr_render.errors import BadInputError
from wlr_render.geometry.lens_camera import LensCamera
from wlr_render.numerics.arrays import FloatArray, IntArray

Seen = Sequence[tuple[BoardPhotograph, BoardObservation]]

_NAMED = 3  # excluded photographs that an error message names
_BESIDE_EYE_BOX_M = 0.015  # the middle of all camera positions lies this close to it, whatever their design


@dataclass(frozen=True, eq=False)
class Lens:
    """A camera of the session, calibrated.

    Attributes:
        poses: of the board in its photographs without the headset.
        calibration: how it was found; None where session.toml gives the lens.
    """

    poses: BoardPoses
    calibration: CameraCalibration | None

    @property
    def camera(self) -> LensCamera:
        """The lens."""
        return self.poses.camera


@dataclass(frozen=True, eq=False)
class SessionCalibration:
    """Everything that a session of photographs gives.

    Attributes:
        session: what was photographed.
        reading: what the photographs say, and which were excluded.
        eyeball, tracking: the cameras.
        station: everything in the device frame.
        captures: what the fit takes.
        kinds: the models, of one kind or of several that were compared.
    """

    session: PhotoSession
    reading: Reading
    eyeball: Lens
    tracking: Lens
    station: Station
    captures: EyeCaptures
    kinds: KindComparison

    @property
    def fit(self) -> EyeFit:
        """The best of the models."""
        return self.kinds.chosen

    @property
    def faults(self) -> tuple[str, ...]:
        """Names of what is not as session.toml says; the results were made without it."""
        return tuple(each.name for each in self.reading.excluded if each.fault)

    @property
    def all_excluded(self) -> tuple[tuple[str, str], ...]:
        """Name and reason of every photograph that the results were made without."""
        read = [(each.name, each.reason) for each in self.reading.excluded]
        return (*read, *self.eyeball.poses.rejected.items(), *self.tracking.poses.rejected.items())


def calibrate_session(
    session: PhotoSession, reading: Reading, folder: Path, fit: Callable[[EyeCaptures], KindComparison]
) -> SessionCalibration:
    """Calibrate cameras and station, and fit models to the captures.

    Args:
        session: what was photographed.
        reading: what the photographs say.
        folder: for station-EYE.json and captures-EYE.npz, which are written as soon as they are known.
        fit: fits the models.

    Raises:
        BadInputError: too little could be read, or the steps contradict each other.
    """
    try:
        return _calibrated(session, reading, folder, fit)
    except BadInputError as error:
        # Whatever was excluded is the likely cause of what is missing now.
        reasons = [f"{each.name}: {each.reason}" for each in reading.excluded]
        more = [f"{len(reasons) - _NAMED} more"] if len(reasons) > _NAMED else []
        before = f" Excluded before: {'; '.join(reasons[:_NAMED] + more)}." if reasons else ""
        raise BadInputError(f"{error}{before}") from error


def tracking_of(session: PhotoSession) -> tuple[SessionCamera, FloatArray]:
    """Return the tracking camera and device_from_tracking (4, 4) of a session that can be calibrated.

    Raises:
        BadInputError: session.toml is valid, but describes what calibration does not take yet.
    """
    axes = session.stage.axes if session.stage else ()
    photographs = (*session.bare, *session.see_through)
    orientations = {each.orientation for each in photographs} | {each.orientation for each in session.display}
    cameras = [each for each in (session.eyeball_camera, session.tracking_camera) if each is not None]
    lacking = {
        "has no stage with three linear axes": [axis.kind for axis in axes] != ["linear"] * 3,
        "has a stage axis with a stated direction": any(axis.direction is not None for axis in axes),
        "has several orientations of the camera": len(orientations) > 1,
        "is of both eyes": len(session.eyes) > 1,
        "has [[target]] poses": bool(session.targets),
        "has a 'gauge'": session.gauge is not None,
        "has [[beside]] photographs": bool(session.beside),
        "has sets of single primaries": any(each.channel for each in session.display),
        "has a camera with another lens than Brown's": any(
            camera.lens not in ("auto", "brown")
            or (camera.known is not None and getattr(camera.known, "kind", "") != "brown")
            for camera in cameras
        ),
        **{f"{name!r} is empty": not getattr(session, name) for name in ("bare", "see_through", "display")},
    }
    if reasons := [reason for reason, applies in lacking.items() if applies]:
        raise BadInputError(
            f"{session.folder}: {', '.join(reasons)}; `calibrate photos` needs one eye, a tracking camera, a stage "
            "with three linear axes, Brown's lenses, and [[bare]], [[see_through]] and [[display]] photographs."
        )
    if session.tracking_camera is None or session.device_from_tracking is None:
        raise BadInputError(f"{session.folder}: has no [tracking_camera], which `calibrate photos` needs.")
    unseen = {each.target_pose for each in photographs} - {each.target_pose for each in session.tracking}
    if unseen:
        raise BadInputError(
            f"{session.folder}: there is no [[tracking]] photograph of target pose {min(unseen)}, which "
            "`calibrate photos` needs; add one, or leave out the photographs of that pose."
        )
    return session.tracking_camera, session.device_from_tracking


def _calibrated(
    session: PhotoSession, reading: Reading, folder: Path, fit: Callable[[EyeCaptures], KindComparison]
) -> SessionCalibration:
    tracking_camera, device_from_tracking = tracking_of(session)
    bare, tracked = reading.seen(session.bare), reading.seen(session.tracking)
    eyeball = _lens(session, session.eyeball_camera, "eyeball_camera", bare, reading)
    tracking = _lens(session, tracking_camera, "tracking_camera", tracked, reading)
    through = reading.seen(session.see_through)
    views = {
        each.name: BoardView.of_observation(each.name, observation, session.board) for each, observation in through
    }
    repeated = repeated_views([each for each, _ in through], views)
    photos = StationPhotos([each for each, _ in bare], [each for each, _ in tracked], repeated)
    station = find_station(photos, eyeball.poses, tracking.poses, device_from_tracking)
    file = folder / f"station-{session.eye}.json"
    save_station(file, station, eyeball.camera, tracking.camera, device_from_tracking)
    refuse_contradictions(station.checks)
    places = _camera_places([each for each, _ in through])
    captures = _captures(session, reading, eyeball.camera, station, through, places)
    captures, excluded = _sound_captures(session, reading, captures, _names(through, places))
    reading = replace(reading, excluded=(*reading.excluded, *excluded))
    save_captures(folder / f"captures-{session.eye}.npz", captures)
    return SessionCalibration(session, reading, eyeball, tracking, station, captures, fit(captures))


def _lens(session: PhotoSession, camera: SessionCamera, name: str, seen: Seen, reading: Reading) -> Lens:
    """The camera and the board's poses: from all photographs without the headset, or by the lens that is given."""
    views = [BoardView.of_observation(each.name, observation, session.board) for each, observation in seen]
    if isinstance(camera.known, LensCamera):
        return Lens(poses_of(camera.known, views), None)
    views += [
        BoardView.of_observation(session.name_of(path), reading.boards[path], session.board)
        for path in camera.intrinsics
        if path in reading.boards
    ]
    try:
        found = calibrate_camera(views, camera.size_px)
    except BadInputError as error:
        raise BadInputError(f"[{name}]: {error}") from error
    return Lens(found.poses, found)


def _captures(
    session: PhotoSession,
    reading: Reading,
    camera: LensCamera,
    station: Station,
    through: Seen,
    places: Sequence[int],
) -> EyeCaptures:
    """Captures from both kinds of photographs; `places` numbers the camera position of each see-through photograph."""
    headset = Headset(session.device, session.eye, session.eye_box)
    panels = [
        PanelView(station.device_from_camera(np.asarray(each.stage)), found.samples, recorded_of(each))
        for each, found in reading.decoded(session.display)
    ]
    targets = [
        TargetView(
            station.device_from_camera(np.asarray(each.stage)),
            station.device_from_target[each.target_pose].b_from_a,
            each.target_pose,
            place,
            observation,
            recorded_of(each) | {"visit": visit},
        )
        for visit, ((each, observation), place) in enumerate(zip(through, places, strict=True))
    ]
    display = display_captures(headset, session.pattern.panel, camera, panels)
    see_through = see_through_captures(headset, session.board, camera, targets)
    return EyeCaptures(display, within_field(see_through, display))


def _sound_captures(
    session: PhotoSession, reading: Reading, captures: EyeCaptures, names: dict[tuple[int, int], list[str]]
) -> tuple[EyeCaptures, tuple[Excluded, ...]]:
    """Leave out captures that were not taken where they are said to be, and dots that lie beside their place.

    Returns:
        What is left, and which photographs were left out and why.

    Raises:
        BadInputError: all cameras stand far from the eye box: a pose or a length of session.toml is wrong.
    """
    see_through = captures.see_through
    assert see_through is not None
    display = captures.display
    _refuse_far_places(session, display.viewpoint)
    keys, photograph = _photographs(see_through)
    follows = dot_inliers(see_through, photograph)
    see_through, photograph = select(see_through, follows), photograph[follows]
    moved = display_outliers(display)
    sets = [session.name_of(each.folder) for each, _ in reading.decoded(session.display)]
    excluded = [_exclusion([sets[each.group]], each) for each in moved]
    display = select(display, ~np.isin(display.capture, [each.group for each in moved]))
    gone = see_through_outliers(see_through, photograph)
    excluded += [_exclusion(names[keys[each.group]], each) for each in gone]
    see_through = select(see_through, ~np.isin(photograph, [each.group for each in gone]))
    return replace(captures, display=display, see_through=see_through), tuple(excluded)


def _camera_places(photographs: Sequence[BoardPhotograph]) -> list[int]:
    """A number for each photograph, the same for those of one camera place."""
    numbers: dict[str, int] = {}
    return [numbers.setdefault(each.place, len(numbers)) for each in photographs]


def _photographs(captures: SeeThroughCaptures) -> tuple[list[tuple[int, int]], IntArray]:
    """Target pose and camera position of each photograph, and (n,) the index of each row's photograph."""
    keys, index = np.unique(np.stack([captures.target_pose, captures.capture], axis=1), axis=0, return_inverse=True)
    return [(int(pose), int(place)) for pose, place in keys], np.asarray(index.ravel())


def _names(through: Seen, places: Sequence[int]) -> dict[tuple[int, int], list[str]]:
    """Names of photographs by target pose and camera position; one position may have been photographed twice."""
    names: dict[tuple[int, int], list[str]] = {}
    for (each, _), place in zip(through, places, strict=True):
        names.setdefault((each.target_pose, place), []).append(each.name)
    return names


def _exclusion(names: Sequence[str], moved: CaptureOutlier) -> Excluded:
    reason = (
        f"its points lie {moved.arcmin:.0f}' from the positions predicted from the other photographs: it was taken at "
        "another stage reading or target pose than session.toml says, or something moved; correct its entry, or take "
        "it again."
    )
    return Excluded(" and ".join(names), reason, fault=True)


def _refuse_far_places(session: PhotoSession, viewpoint: FloatArray) -> None:
    box = session.eye_box
    off = np.unique(viewpoint, axis=0).mean(axis=0) - box.centre
    if np.any(np.abs(off) > 0.5 * box.size + _BESIDE_EYE_BOX_M):
        x, y, z = 1e3 * off
        raise BadInputError(
            f"{session.folder}: the camera places lie ({x:.0f}, {y:.0f}, {z:.0f}) mm (x right, y up, z backward) from "
            "the middle of [eye_box]; check [tracking_camera] 'translation_mm' and 'rotation', 'frame' and 'centre_mm'."
        )

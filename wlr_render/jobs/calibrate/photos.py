"""Calibrate one eye from a session of photographs: read them, find the station, bring all into one frame, fit."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from wlr_render.calibration.board_poses import BoardPoses, BoardView, poses_of
from wlr_render.calibration.camera_calibration import CameraCalibration, calibrate_camera
from wlr_render.calibration.check import refuse_contradictions
from wlr_render.calibration.fit_eye import EyeFit, fit_eye
from wlr_render.calibration.photograph_captures import (
    Headset,
    PanelView,
    TargetView,
    display_captures,
    see_through_captures,
    within_field,
)
from wlr_render.calibration.station import Station, StationPhotos, find_station, repeated_views
from wlr_render.calibration.station_file import save_station
from wlr_render.captures.capture_file import save_captures
from wlr_render.captures.correspondences import EyeCaptures
from wlr_render.captures.photo_session import BoardPhotograph, PhotoSession, SessionCamera
from wlr_render.captures.photo_session_file import load_photo_session
from wlr_render.captures.targets.dot_board import BoardObservation
from wlr_render.errors import BadInputError
from wlr_render.files import output_folder
from wlr_render.geometry.lens_camera import LensCamera
from wlr_render.jobs.calibrate.captures import FitOptions
from wlr_render.jobs.calibrate.consistency import camera_places, sound_captures
from wlr_render.jobs.calibrate.reading import Reading, read_session
from wlr_render.jobs.calibrate.store import Store
from wlr_render.models.model_file import add_eye_models
from wlr_render.progress import SILENT, Progress

Seen = Sequence[tuple[BoardPhotograph, BoardObservation]]

_NAMED = 3  # of what was set aside, in one sentence
CHOSEN_BY_HELD_OUT = FitOptions("planar", None, None)
"""Planar models whose degrees held-out camera positions choose."""
READ = "read"
"""Folder, among the results, of what was read from photographs."""


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
        reading: what the photographs say, and which were set aside.
        eyeball, tracking: the cameras.
        station: everything in the device frame.
        captures: what the fit takes.
        fit: the models.
    """

    session: PhotoSession
    reading: Reading
    eyeball: Lens
    tracking: Lens
    station: Station
    captures: EyeCaptures
    fit: EyeFit

    @property
    def faults(self) -> tuple[str, ...]:
        """Names of what is not as session.toml says; the results were made without it."""
        return tuple(each.name for each in self.reading.set_aside if each.fault)

    @property
    def left_out(self) -> tuple[tuple[str, str], ...]:
        """Name and reason of every photograph that the results were made without."""
        read = [(each.name, each.reason) for each in self.reading.set_aside]
        return (*read, *self.eyeball.poses.rejected.items(), *self.tracking.poses.rejected.items())


def run(
    folder: str | Path,
    out: str | Path,
    options: FitOptions = CHOSEN_BY_HELD_OUT,
    workers: int | None = None,
    progress: Progress = SILENT,
) -> SessionCalibration:
    """Calibrate from a session's folder; writes captures.npz, model.json and station.json into `out`.

    What was read from photographs is kept in `out`, so that a later run reads only what is new or changed.

    Args:
        folder: that holds session.toml.
        out: for the results.
        options: which models to fit.
        workers: processes that read photographs; None as in `read_session`.
        progress: shows how far the reading is.

    Raises:
        BadInputError: session.toml is faulty, too little could be read, or the steps contradict each other; what was
            read is kept.
    """
    session = load_photo_session(folder)
    into = output_folder(out)
    reading = read_session(session, Store(into / READ), workers, progress)
    try:
        return _calibrated(session, reading, into, options)
    except BadInputError as error:
        # Whatever was set aside is the likely cause of what is missing now.
        aside = [f"{each.name}: {each.reason}" for each in reading.set_aside]
        more = [f"{len(aside) - _NAMED} more"] if len(aside) > _NAMED else []
        said = f" Set aside before: {'; '.join(aside[:_NAMED] + more)}." if aside else ""
        raise BadInputError(f"{error}{said}") from error


def _calibrated(session: PhotoSession, reading: Reading, into: Path, options: FitOptions) -> SessionCalibration:
    bare, tracked = reading.seen(session.bare), reading.seen(session.tracking)
    eyeball = _lens(session, session.eyeball_camera, "eyeball_camera", bare, reading)
    tracking = _lens(session, session.tracking_camera, "tracking_camera", tracked, reading)
    through = reading.seen(session.see_through)
    views = {
        each.name: BoardView.of_observation(each.name, observation, session.board) for each, observation in through
    }
    repeated = repeated_views([each for each, _ in through], views)
    photos = StationPhotos([each for each, _ in bare], [each for each, _ in tracked], repeated)
    station = find_station(photos, eyeball.poses, tracking.poses, session.device_from_tracking)
    save_station(into / "station.json", station, eyeball.camera, tracking.camera, session.device_from_tracking)
    refuse_contradictions(station.checks)
    captures, aside = sound_captures(session, reading, _captures(session, reading, eyeball.camera, station))
    reading = replace(reading, set_aside=(*reading.set_aside, *aside))
    save_captures(into / "captures.npz", captures)
    fit = fit_eye(captures, options.kind, options.display_degree, options.see_through_degree)
    add_eye_models(into / "model.json", [fit.model()])
    return SessionCalibration(session, reading, eyeball, tracking, station, captures, fit)


def _lens(session: PhotoSession, camera: SessionCamera, name: str, seen: Seen, reading: Reading) -> Lens:
    """The camera and the board's poses: from all photographs without the headset, or by the lens that is given."""
    views = [BoardView.of_observation(each.name, observation, session.board) for each, observation in seen]
    if camera.known is not None:
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


def _captures(session: PhotoSession, reading: Reading, camera: LensCamera, station: Station) -> EyeCaptures:
    headset = Headset(session.device, session.eye, session.eye_box)
    panels = [
        PanelView(station.device_from_camera(each.stage), found.samples)
        for each, found in reading.decoded(session.display)
    ]
    seen = reading.seen(session.see_through)
    places = camera_places([each for each, _ in seen])
    targets = [
        TargetView(
            station.device_from_camera(each.stage),
            station.device_from_target[each.target_pose].b_from_a,
            each.target_pose,
            place,
            observation,
        )
        for (each, observation), place in zip(seen, places, strict=True)
    ]
    display = display_captures(headset, session.pattern.panel, camera, panels)
    see_through = see_through_captures(headset, session.board, camera, targets)
    return EyeCaptures(display, within_field(see_through, display))

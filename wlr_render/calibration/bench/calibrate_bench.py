"""Calibrate the bench of a photographic session by one joint adjustment of its direct views."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from wlr_render.calibration.bench.adjustment import Adjustment, UndeterminedError, adjust
from wlr_render.calibration.bench.bench_checks import Check, bench_checks
from wlr_render.calibration.bench.board_views import (
    APART,
    EYEBALL,
    TRACKING,
    BenchObservations,
    BoardView,
    CameraPlace,
    CameraSetup,
    KnownPose,
)
from wlr_render.calibration.bench.faults import SINGLE, Fault, adjust_without_faults
from wlr_render.calibration.bench.lenses import RefusedViewsError, SoundViews, sound_views
from wlr_render.calibration.bench.start import start_state
from wlr_render.calibration.bench.sweep_checks import RepeatedView, TargetChange, sweep_check
from wlr_render.calibration.poses import Pose, adjoint
from wlr_render.captures.boards.board import BoardObservation
from wlr_render.captures.photo_session import BoardPhotograph, PhotoSession, SessionCamera, SessionEntry
from wlr_render.captures.session_reading import Excluded, Reading
from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.lenses.lens import Lens
from wlr_render.numerics.arrays import FloatArray

_EXACT = (0.0, 0.0)


@dataclass(frozen=True, eq=False)
class CalibratedBench:
    """Cameras, board, target poses and stage of a session in the device frame.

    Attributes:
        session: the photo session that was calibrated.
        adjustment: the joint adjustment, with the covariance of all unknowns.
        faults: single faults, whose views were rejected or assigned a separate target or mounting.
        lenses: rejected photographs and tried kinds of lens, by camera.
        checks: results of all checks; a result that is not `ok` names the faulty step.
        unchecked: sentences about impossible checks, with the photographs that would allow them.
    """

    session: PhotoSession
    adjustment: Adjustment
    faults: Sequence[Fault]
    lenses: Mapping[str, SoundViews]
    checks: Sequence[Check]
    unchecked: Sequence[str]

    @property
    def eyeball(self) -> Lens:
        """The lens of the eyeball camera."""
        return self.adjustment.state.lens[EYEBALL]

    @property
    def rejected(self) -> tuple[Excluded, ...]:
        """All photographs that were left out."""
        found = {name: Excluded(name, reason, fault=False) for name, reason in _rejected_by_lenses(self.lenses).items()}
        for fault in self.faults:
            if fault.kind in SINGLE:
                reason = "its stage reading looks exchanged" if fault.kind == "exchange" else "it lies off its place"
                reason = f"{reason}, by the other photographs"
                found |= {name: Excluded(name, reason, fault=True) for name in fault.names}
        return tuple(found.values())

    @property
    def targets(self) -> dict[int, Pose]:
        """device_from_target by number."""
        return {k: self.adjustment.target_pose(k) for k in self.adjustment.state.targets if k < APART}

    def device_from_camera(self, entry: SessionEntry) -> FloatArray:
        """Return the eyeball camera's pose (4, 4) at an entry of the session."""
        return self.adjustment.state.device_from_camera(place_key(self.session, entry))

    def camera_pose(self, entry: SessionEntry) -> Pose:
        """Return device_from_camera at an entry of the session, with its covariance."""
        return self.adjustment.camera_pose(place_key(self.session, entry))

    def relative_sigma(self, one: SessionEntry, other: SessionEntry) -> FloatArray:
        """Return the sigmas (6,) of the camera's pose at one entry relative to another, device frame.

        They are for rotation (rad), then position (m) of the pupil, without errors that both poses share.
        """
        poses, covariance = self.adjustment.camera_poses([place_key(self.session, each) for each in (one, other)])
        about = [adjoint(transforms.rigid(np.eye(3), -pose[:3, 3])) for pose in poses]
        apart = np.concatenate([about[0], -about[1]], axis=1)
        return np.sqrt(np.diag(apart @ covariance @ apart.T))

    def target_points(self, target_pose: int, observation: BoardObservation) -> FloatArray:
        """Return the true positions (n, 3) of a board's features in the target's frame."""
        nominal = self.session.board_of(target_pose).point_of(observation.index)
        shape = self.adjustment.state.shape.get(board_name(self.session, target_pose))
        return nominal if shape is None else shape.point_of(observation.index, nominal)


def calibrate_bench(session: PhotoSession, reading: Reading) -> CalibratedBench:
    """Adjust all direct views of a session, and check the result.

    Raises:
        BadInputError: photographs of a step are missing, or do not determine it; a RefusedViewsError if some were
            rejected before.
    """
    observations = bench_observations(session, reading)
    lenses: dict[str, SoundViews] = {}
    try:
        return _calibrated(session, reading, observations, lenses)
    except BadInputError as error:
        own = error.rejected if isinstance(error, RefusedViewsError) else {}
        raise RefusedViewsError(str(error), {**_rejected_by_lenses(lenses), **own}) from error


def _calibrated(
    session: PhotoSession, reading: Reading, observations: BenchObservations, lenses: dict[str, SoundViews]
) -> CalibratedBench:
    """Return the bench; store the sound views of each camera in `lenses` as soon as they are known."""
    for name, setup in observations.cameras.items():
        try:
            lenses[name] = sound_views(
                [view for view in observations.views if view.camera == name], setup, observations
            )
        except RefusedViewsError as error:
            raise RefusedViewsError(f"[{name}_camera]: {error}", error.rejected) from error
    kept = {view.name: view for each in lenses.values() for view in each.views}
    views = [kept[view.name] for view in observations.views if view.name in kept]
    observations = replace(observations, views=views)
    try:
        adjustment, faults = adjust_without_faults(
            observations, lambda one: adjust(start_state(one, {name: each.lens for name, each in lenses.items()}))
        )
    except UndeterminedError as error:
        raise BadInputError(
            "the photographs do not determine the bench: add photographs of the target without the headset at other "
            "stage readings, and of the board tilted by 20 to 40 degrees before each camera."
        ) from error
    bench = CalibratedBench(session, adjustment, faults, lenses, (), ())
    sweeps = _sweep_checks(bench, reading)
    said = [_rejected_check(name, reason) for name, reason in _rejected_by_lenses(lenses).items()]
    checks = [*said, *bench_checks(adjustment, faults), *(check for check in sweeps.values() if check is not None)]
    return replace(bench, checks=checks, unchecked=_unchecked(session, adjustment, sweeps))


def place_key(session: PhotoSession, entry: SessionEntry) -> str:
    """Return the name of an entry's visit; photographs of one visit share the camera's random error.

    With a stage, every photograph is a separate visit, except at places with photographs past the optics.
    """
    if session.stage is None or any(each.place == entry.place for each in session.beside):
        return entry.place
    return session.name_of(entry.path)


def bench_observations(session: PhotoSession, reading: Reading) -> BenchObservations:
    """Return the direct views of a session, with its given poses, lenses and board tolerances.

    Raises:
        BadInputError: nothing fixes the device frame, or a gauge is not possible.
    """
    views = [*_free_views(session, reading, EYEBALL, session.eyeball_camera)]
    cameras = {EYEBALL: _setup(session.eyeball_camera)}
    tracking = None
    if session.tracking_camera is not None and session.device_from_tracking is not None:
        views += _free_views(session, reading, TRACKING, session.tracking_camera)
        cameras[TRACKING] = _setup(session.tracking_camera)
        tracking = KnownPose(session.device_from_tracking, session.tracking_sigma or _EXACT)
    views += [
        _view(session, photo, seen, EYEBALL, place_key(session, photo))
        for photo, seen in chain(reading.views_of(session.bare), reading.views_of(session.beside))
    ]
    if tracking is not None:
        views += [_view(session, photo, seen, TRACKING, None) for photo, seen in reading.views_of(session.tracking)]
    targets = {k: KnownPose(given.device_from, given.sigma) for k, given in session.targets.items()}
    device_from_camera = None
    if session.gauge_target is not None:
        targets[session.gauge_target] = KnownPose(transforms.rigid(transforms.OPENXR_FROM_OPENCV, np.zeros(3)))
    elif session.gauge == "camera":
        if session.stage is None:
            raise BadInputError(
                'session.toml: gauge = "camera" needs a stage; without one, write gauge = "target N" or give a '
                "[[target]] pose."
            )
        centre = np.mean([box.centre for box in session.eye_boxes.values()], axis=0)
        device_from_camera = KnownPose(transforms.rigid(transforms.OPENXR_FROM_OPENCV, centre))
    entries: list[SessionEntry] = [*session.bare, *session.beside, *session.see_through, *session.display]
    places = {place_key(session, each): CameraPlace(each.stage, each.orientation, each.time_s) for each in entries}
    boards = {board_name(session, view.target or 0) for view in views} | {"board"}
    tolerances = {name: session.board.tolerances for name in boards} | {
        f"board of target {k}": given.board.tolerances
        for k, given in session.targets.items()
        if given.board is not None
    }
    axes = session.stage.axes if session.stage is not None else ()
    used = {EYEBALL, *(view.camera for view in views)}
    return BenchObservations(
        views,
        {name: setup for name, setup in cameras.items() if name in used},
        places,
        axes,
        tracking if TRACKING in used else None,
        targets,
        device_from_camera,
        tolerances,
    )


def _setup(camera: SessionCamera) -> CameraSetup:
    return CameraSetup(camera.size_px, camera.lens, camera.calibrated, camera.calibrated_sigma)


def board_name(session: PhotoSession, target: int) -> str:
    """Return the adjustment's name of the board at a target pose."""
    given = session.targets.get(target)
    return "board" if given is None or given.board is None else f"board of target {target}"


def _free_views(session: PhotoSession, reading: Reading, name: str, camera: SessionCamera) -> list[BoardView]:
    """Return views of the board held anywhere in front of a camera."""
    return [
        _board_view(session, session.name_of(path), reading.boards[path], name)
        for path in camera.intrinsics
        if path in reading.boards
    ]


def _board_view(session: PhotoSession, name: str, seen: BoardObservation, camera: str, target: int = 0) -> BoardView:
    point = session.board_of(target).point_of(seen.index)
    return BoardView(name, camera, seen.index, point, seen.pixel, seen.sigma_px, discs=seen.discs)


def _view(
    session: PhotoSession, photo: BoardPhotograph, seen: BoardObservation, camera: str, place: str | None
) -> BoardView:
    view = _board_view(session, photo.name, seen, camera, photo.target_pose)
    return replace(view, target=photo.target_pose, place=place, board=board_name(session, photo.target_pose))


def _rejected_by_lenses(lenses: Mapping[str, SoundViews]) -> dict[str, str]:
    """Return name -> reason for photographs rejected from any camera's views."""
    return {name: reason for each in lenses.values() for name, reason in each.rejected.items()}


def _rejected_check(name: str, reason: str) -> Check:
    return Check(name, "pose of the board", np.nan, np.nan, np.nan, f"rejected: {name} {reason}", ok=False)


def _sweep_checks(bench: CalibratedBench, reading: Reading) -> dict[int, Check | None]:
    """Return the check of motion during the sweep at each target pose; None where nothing was photographed twice."""
    session, adjustment = bench.session, bench.adjustment
    tracked = {k: [p.name for p in session.tracking if p.target_pose == k] for k in adjustment.state.targets}
    repeated = _repeated_views(bench, reading)
    checks: dict[int, Check | None] = {}
    for k in sorted({each.target_pose for each in session.see_through}):
        change = None
        if len(tracked.get(k, [])) > 1:
            fault = next((f for f in bench.faults if f.kind == "tracking" and f.target == k), None)
            change = TargetChange.of(adjustment, k, fault, tracked[k])
        own = [view for view in repeated if view.target == k]
        checks[k] = sweep_check(k, change, own, bench.eyeball)
    return checks


def _repeated_views(bench: CalibratedBench, reading: Reading) -> list[RepeatedView]:
    """Return the first and last photographs through the optics for each place and target pose."""
    session = bench.session
    taken: dict[tuple[int, str, str], list[tuple[BoardPhotograph, BoardObservation]]] = {}
    for photo, seen in reading.views_of(session.see_through):
        taken.setdefault((photo.target_pose, photo.place, photo.eye), []).append((photo, seen))
    found = []
    for (target, _, _), pairs in taken.items():
        if len(pairs) > 1 and target in bench.adjustment.state.targets:
            (first, one), (last, other) = pairs[0], pairs[-1]
            lens = bench.adjustment.state.lens_at(target)
            pair = ((first, one), (last, other))
            views = [_board_view(session, p.name, s, EYEBALL, target).seen_by(lens) for p, s in pair]
            poses, covariance = bench.adjustment.relative_motion(
                *(place_key(session, photo) for photo in (first, last))
            )
            to_camera, turned = adjoint(transforms.inverse(poses[0])), poses[1][:3, :3].T @ poses[0][:3, :3]
            motion, board = to_camera @ covariance @ to_camera.T, bench.adjustment.state.targets[target]
            found.append(RepeatedView(target, poses[0], views[0], views[1], turned, motion, board))
    return found


def _unchecked(session: PhotoSession, adjustment: Adjustment, sweeps: Mapping[int, Check | None]) -> list[str]:
    """Return sentences about impossible checks, with the photographs that would allow them."""
    said = [
        f"whether anything moved during the sweep at target pose {target} is not known: photograph the target with the "
        "tracking camera after the sweep as well, and repeat a photograph through the optics"
        for target, check in sweeps.items()
        if check is None
    ]
    tracked = {photo.target_pose for photo in session.tracking}
    if tracked and len(tracked & {photo.target_pose for photo in session.bare}) < 2:
        said.append(
            "whether the target moved between its photographs without the headset and its tracking photograph is not "
            "known: photograph it without the headset at a second target pose as well"
        )
    if session.tracking_camera is not None and session.tracking_sigma is None:
        said.append(
            "[tracking_camera] states no 'sigma_mm' and 'sigma_deg': its pose counts as exact, and its error is in no "
            "sigma of this report"
        )
    return said

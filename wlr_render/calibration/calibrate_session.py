"""Calibrate the eyes of a headset from the photographs of a session: bench, captures in the device frame, models.

If a board looks the same turned by 180 degrees, detection may number its features from either end. The correct end
follows from the other photographs of the target: all cameras are assumed upright except the tracking camera, which has
a known roll, so that the board's columns run the same way in all photographs of one target pose.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path

import numpy as np

from wlr_render.calibration.bench.bench_checks import refuse_contradictions
from wlr_render.calibration.bench.calibrate_bench import CalibratedBench, calibrate_bench
from wlr_render.calibration.bench.lenses import RefusedViewsError
from wlr_render.calibration.bench.station_file import save_station
from wlr_render.calibration.fit_eye import Calibration, KindComparison
from wlr_render.calibration.photograph_captures import sound_captures
from wlr_render.captures.boards.board import Board, BoardObservation
from wlr_render.captures.correspondences import Captures
from wlr_render.captures.photo_session import CHANNELS, BoardPhotograph, PhotoSession
from wlr_render.captures.session_reading import Excluded, Reading
from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.numerics.arrays import FloatArray

_NAMED = 3  # most excluded photographs that an error message names
_CLEAR = 0.5  # least cosine between two column directions that count as the same: 60 degrees


@dataclass(frozen=True, eq=False)
class EyeCalibration:
    """Calibration of one eye from a session.

    Attributes:
        session: the session of this eye.
        captures: the captures to which the models are fitted.
        kinds: the models, of one kind or of several kinds for comparison.
        excluded: photographs that contradict the others, with reasons.
        primaries: display models of further colours, by colour, if the panel was photographed in several; see-through
            has no colour.
    """

    session: PhotoSession
    captures: Captures
    kinds: KindComparison
    excluded: tuple[Excluded, ...]
    primaries: Mapping[str, Calibration] = field(default_factory=dict)

    @property
    def eye(self) -> str:
        """Name of the eye."""
        return self.session.eye

    @property
    def fit(self) -> Calibration:
        """The best of the models."""
        return self.kinds.chosen


@dataclass(frozen=True, eq=False)
class SessionCalibration:
    """Results of a session of photographs: the bench and the models of its eyes.

    Attributes:
        session: the photographed session.
        reading: features and codes read from the photographs, and the photographs that could not be read.
        bench: cameras, board, target poses and stage in the device frame.
        eyes: calibrations of the eyes, by name.
    """

    session: PhotoSession
    reading: Reading
    bench: CalibratedBench
    eyes: Mapping[str, EyeCalibration]

    @property
    def faults(self) -> tuple[str, ...]:
        """Names of the excluded photographs and code sets that contradict session.toml."""
        return tuple(each.name for each in self.all_excluded if each.fault)

    @property
    def all_excluded(self) -> list[Excluded]:
        """All photographs excluded from the results, worst first."""
        of_eyes = (each for eye in self.eyes.values() for each in eye.excluded)
        return worst_first([*self.bench.rejected, *self.reading.excluded, *of_eyes])


class RefusedCalibrationError(BadInputError):
    """Error for a session from which too little could be read, or in which steps contradict each other.

    Attributes:
        reading: see `SessionCalibration`; its `excluded` lists the exclusions that `found` does not contain.
        found: the bench and the finished eyes; None if the bench could not be adjusted.
    """

    reading: Reading = Reading()
    found: SessionCalibration | None = None


def worst_first(excluded: Sequence[Excluded]) -> list[Excluded]:
    """Sort by prediction error, largest first, then faults of the session before photographs that failed."""
    return sorted(excluded, key=lambda each: (-each.off_arcmin, not each.fault))


def calibrate_session(
    session: PhotoSession, reading: Reading, folder: Path, fit: Callable[[Captures], KindComparison]
) -> SessionCalibration:
    """Calibrate the bench, and fit models to the captures of each eye.

    Args:
        session: the photographed session.
        reading: features and codes read from the photographs.
        folder: folder for station-EYE.json and captures-EYE.npz, which are written as soon as they are known.
        fit: function that fits the models.

    Raises:
        RefusedCalibrationError: too little could be read, or the steps contradict each other.
        BadInputError: a file cannot be written.
    """
    with _refusals(reading):
        reading = with_half_turns(session, reading)
    with _refusals(reading):
        bench = calibrate_bench(session, reading)
    for eye in session.eyes:
        save_station(folder / f"station-{eye}.json", bench)
    eyes: dict[str, EyeCalibration] = {}
    found = SessionCalibration(session, reading, bench, eyes)
    with _refusals(reading, found):
        refuse_contradictions(bench.checks)
    for eye in session.eyes:
        own = session.for_eye(eye)
        with _refusals(reading, found):
            captures, moved = sound_captures(own, reading, bench)
        captures.save(folder / f"captures-{eye}.npz")
        with _refusals(reading, found, moved):
            eyes[eye] = _fitted(own, captures, moved, fit)
    return found


@contextmanager
def _refusals(
    reading: Reading, found: SessionCalibration | None = None, moved: Sequence[Excluded] = ()
) -> Iterator[None]:
    """Convert an error to a RefusedCalibrationError with the results and the exclusions so far.

    Args:
        reading, found: see `RefusedCalibrationError`.
        moved: photographs that were excluded for the eye that is being fitted.
    """
    try:
        yield
    except BadInputError as error:
        rejected = error.rejected if isinstance(error, RefusedViewsError) else {}
        of_bench = (Excluded(name, reason, fault=False) for name, reason in rejected.items())
        reading = replace(reading, excluded=(*of_bench, *reading.excluded, *moved))
        found = None if found is None else replace(found, reading=reading)
        excluded = worst_first(reading.excluded) if found is None else found.all_excluded
        refused = RefusedCalibrationError(f"{error}{_excluded_before(excluded)}")
        refused.reading, refused.found = reading, found
        raise refused from error


def _excluded_before(excluded: Sequence[Excluded]) -> str:
    """Return a sentence that lists the exclusions, worst first, because they are the likely cause of the error."""
    if not excluded:
        return ""
    reasons = [f"{each.name}: {each.reason}" for each in excluded[:_NAMED]]
    worst = "the worst " if excluded[0].off_arcmin > 0.0 else ""
    named = f", {worst}{_NAMED} of {len(excluded)}" if len(excluded) > _NAMED else ""
    return f" Excluded before{named}: {'; '.join(reasons)}."


def _fitted(
    session: PhotoSession,
    captures: Captures,
    excluded: tuple[Excluded, ...],
    fit: Callable[[Captures], KindComparison],
) -> EyeCalibration:
    """Fit the models of one eye to green, white or the first colour, and to each other photographed colour."""
    main, primaries = captures.in_colour(), {}
    kinds = fit(main)
    if captures.display is not None and main.display is not None:
        for number in np.setdiff1d(captures.display.channel, [*main.display.channel[:1], -1]):
            primaries[CHANNELS[number]] = fit(captures.in_colour(int(number))).chosen
    return EyeCalibration(session, main, kinds, excluded, primaries)


def with_half_turns(session: PhotoSession, reading: Reading) -> Reading:
    """Return the reading with the features of all photographs of a target pose numbered from the same end.

    Photographs for a camera's lens need no such choice, because each has a separate pose in the fit.

    Raises:
        BadInputError: a photograph shows the board rolled by 60 to 120 degrees from the others, or from the given pose.
    """
    boards: dict[Path, BoardObservation] = dict(reading.boards)
    along: dict[int, FloatArray] = {}
    for photo, to_device in _photographs(session):
        seen = reading.boards.get(photo.path)
        if seen is None or not seen.ambiguous_half_turn:
            continue
        board = session.board_of(photo.target_pose)
        columns = to_device @ np.append(_columns_in_image(board, seen), 0.0)
        columns = columns[:2] / np.linalg.norm(columns[:2])
        expected = along.setdefault(photo.target_pose, _expected(session, photo.target_pose, columns))
        alike = float(columns @ expected)
        if abs(alike) < _CLEAR:
            raise BadInputError(
                f"{photo.name}: the board looks the same turned by 180 degrees, and which way round it hangs at target "
                f"pose {photo.target_pose} is not clear, because its columns run at {np.degrees(np.arccos(alike)):.0f} "
                "degrees to the expected direction; keep cameras and board upright, or use a board that looks "
                "different when turned."
            )
        if alike < 0:
            boards[photo.path] = seen.half_turned(board)
    return replace(reading, boards=boards)


def _photographs(session: PhotoSession) -> Iterator[tuple[BoardPhotograph, FloatArray]]:
    """Yield photographs of targets with device_from_camera (3, 3), of a camera facing ahead or the tracking camera."""
    for photo in chain(session.bare, session.beside, session.see_through):
        yield photo, transforms.OPENXR_FROM_OPENCV
    if session.device_from_tracking is not None:
        for photo in session.tracking:
            yield photo, session.device_from_tracking[:3, :3]


def _expected(session: PhotoSession, target: int, first: FloatArray) -> FloatArray:
    """Return the unit vector (2,), device frame, along the board's columns at a target pose.

    If the pose is not given, the target's rotation is free, and its first photograph defines the direction.
    """
    given = session.targets.get(target)
    if given is not None:
        return np.asarray(given.device_from[:2, 0] / np.linalg.norm(given.device_from[:2, 0]))
    return np.array([1.0, 0.0]) if session.gauge_target == target else first


def _columns_in_image(board: Board, seen: BoardObservation) -> FloatArray:
    """Return the direction (2,) in the image along which column numbers increase."""
    place = board.point_of(seen.index)[:, :2]
    design = np.concatenate([place, np.ones((len(place), 1))], axis=1)
    return np.asarray(np.linalg.lstsq(design, seen.pixel, rcond=None)[0][0])

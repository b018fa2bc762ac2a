"""Calibrate the eyes of a headset from the photographs of a session: bench, captures in the device frame, models."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from wlr_render.calibration.bench.bench_checks import refuse_contradictions
from wlr_render.calibration.bench.calibrate_bench import CalibratedBench, calibrate_bench
from wlr_render.calibration.bench.common_errors import with_bench_errors
from wlr_render.calibration.bench.half_turns import with_half_turns
from wlr_render.calibration.bench.lenses import RefusedViewsError
from wlr_render.calibration.bench.station_file import save_station
from wlr_render.calibration.capture_outliers import CaptureOutlier, display_outliers, dot_inliers, see_through_outliers
from wlr_render.calibration.fit_eye import Calibration, KindComparison
from wlr_render.calibration.photograph_captures import (
    Headset,
    joined_views,
    panel_captures,
    recorded_of,
    target_captures,
    within_field,
)
from wlr_render.captures.boards.board import BoardObservation
from wlr_render.captures.capture_checks import far_from_eye_box
from wlr_render.captures.correspondences import Captures, DisplayCaptures, SeeThroughCaptures, select
from wlr_render.captures.decoded import DecodedSamples
from wlr_render.captures.photo_session import CHANNELS, BoardPhotograph, CodeSet, PhotoSession
from wlr_render.captures.session_reading import Excluded, Reading
from wlr_render.errors import BadInputError
from wlr_render.numerics.arrays import FloatArray

_NAMED = 3  # excluded photographs that an error message names


@dataclass(frozen=True, eq=False)
class EyeCalibration:
    """What a session gives for one eye.

    Attributes:
        session: the session of this eye.
        captures: what the fit takes.
        kinds: the models, of one kind or of several that were compared.
        excluded: photographs that contradict the others, and why.
        primaries: where the panel was photographed in several colours, the models of the others, by colour: each is of
            its display; see-through has no colour.
    """

    session: PhotoSession
    captures: Captures
    kinds: KindComparison
    excluded: tuple[Excluded, ...]
    primaries: Mapping[str, Calibration] = field(default_factory=dict)

    @property
    def eye(self) -> str:
        """Which eye."""
        return self.session.eye

    @property
    def fit(self) -> Calibration:
        """The best of the models."""
        return self.kinds.chosen


@dataclass(frozen=True, eq=False)
class SessionCalibration:
    """Everything that a session of photographs gives.

    Attributes:
        session: what was photographed.
        reading: what the photographs say, and which could not be read.
        bench: cameras, board, target poses and stage in the device frame.
        eyes: by name.
    """

    session: PhotoSession
    reading: Reading
    bench: CalibratedBench
    eyes: Mapping[str, EyeCalibration]

    @property
    def faults(self) -> tuple[str, ...]:
        """Names of what is not as session.toml says; the results were made without it."""
        return tuple(each.name for each in self.all_excluded if each.fault)

    @property
    def all_excluded(self) -> list[Excluded]:
        """Every photograph that the results were made without, the worst first."""
        of_eyes = (each for eye in self.eyes.values() for each in eye.excluded)
        return worst_first([*self.bench.rejected, *self.reading.excluded, *of_eyes])


class RefusedCalibrationError(BadInputError):
    """A session from which too little could be read, or whose steps contradict each other.

    Attributes:
        reading: what the photographs say; excluded in it is what `found` does not hold.
        found: the bench and the eyes that were finished; None where the bench could not be adjusted.
    """

    reading: Reading = Reading()
    found: SessionCalibration | None = None


def worst_first(excluded: Sequence[Excluded]) -> list[Excluded]:
    """Sort by how far captures lie off, then faults of the session before photographs that failed."""
    return sorted(excluded, key=lambda each: (-each.off_arcmin, not each.fault))


def calibrate_session(
    session: PhotoSession, reading: Reading, folder: Path, fit: Callable[[Captures], KindComparison]
) -> SessionCalibration:
    """Calibrate the bench, and fit models to the captures of each eye.

    Args:
        session: what was photographed.
        reading: what the photographs say.
        folder: for station-EYE.json and captures-EYE.npz, which are written as soon as they are known.
        fit: fits the models.

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
    """Say with a refusal how far the calibration came, and what was excluded before.

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
    """Say what was excluded, the worst first: it is the likely cause of what is missing now."""
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
    """Fit the models of one eye to green, white or the first colour, and to each other colour that was photographed."""
    main, primaries = captures.in_colour(), {}
    kinds = fit(main)
    if captures.display is not None and main.display is not None:
        for number in np.setdiff1d(captures.display.channel, [*main.display.channel[:1], -1]):
            primaries[CHANNELS[number]] = fit(captures.in_colour(int(number))).chosen
    return EyeCalibration(session, main, kinds, excluded, primaries)


def sound_captures(
    session: PhotoSession, reading: Reading, bench: CalibratedBench
) -> tuple[Captures, tuple[Excluded, ...]]:
    """Return captures of one eye without those that were not taken where they are said to be, and which those are.

    Raises:
        BadInputError: all cameras stand far from the eye box: a pose or a length of session.toml is wrong.
    """
    headset = Headset(session.device, session.eye, session.eye_box)
    sets, through, excluded = reading.panels_of(session.display), reading.views_of(session.see_through), []
    display: DisplayCaptures | None = None
    if session.display:
        panel, views = session.pattern.panel, []
        for number, (each, found) in enumerate(sets):
            pose, samples = bench.device_from_camera(each), _of_primary(session, each, found.samples)
            known = recorded_of(each) | {"capture": number}
            views.append(panel_captures(headset, panel, bench.eyeball, pose, samples, **known))
        display = joined_views(views, "the panel")
        _refuse_far_places(session, display.viewpoint)
    see_through = _of_targets(headset, bench, through) if session.see_through else None
    display, see_through = with_bench_errors(
        bench,
        None if display is None else (display, [each for each, _ in sets]),
        None if see_through is None else (see_through, [each for each, _ in through]),
    )
    if display is not None:
        colour = np.array([each.channel or "" for each, _ in sets])[display.capture]
        moved = [each for name in np.unique(colour) for each in display_outliers(select(display, colour == name))]
        excluded = [_exclusion(session.name_of(sets[each.group][0].folder), each) for each in moved]
        display = select(display, ~np.isin(display.capture, [each.group for each in moved]))
    if see_through is None:
        return Captures(display), tuple(excluded)
    if display is None:
        _refuse_far_places(session, see_through.viewpoint)
    else:
        see_through = within_field(see_through, display)
    see_through = select(see_through, dot_inliers(see_through, see_through.visit))
    gone = see_through_outliers(see_through, see_through.visit)
    excluded += [_exclusion(through[each.group][0].name, each) for each in gone]
    see_through = select(see_through, ~np.isin(see_through.visit, [each.group for each in gone]))
    return Captures(display, see_through), tuple(excluded)


def _of_targets(
    headset: Headset, bench: CalibratedBench, through: Sequence[tuple[BoardPhotograph, BoardObservation]]
) -> SeeThroughCaptures:
    """Return captures of the targets through the optics; photographs are numbered as visits."""
    places, state = _place_numbers([each for each, _ in through]), bench.adjustment.state
    targets = []
    for number, ((each, seen), place) in enumerate(zip(through, places, strict=True)):
        pose, target = bench.device_from_camera(each), state.targets[each.target_pose]
        point, lens = bench.target_points(each.target_pose, seen), state.lens_at(each.target_pose)
        known = recorded_of(each) | {"visit": number, "capture": place, "target_pose": each.target_pose}
        targets.append(target_captures(headset, lens or bench.eyeball, pose, target, seen, point, **known))
    return joined_views(targets, "the target through the optics")


def _of_primary(session: PhotoSession, entry: CodeSet, samples: DecodedSamples) -> DecodedSamples:
    """Return samples at the places on the panel where the primary that was shown lies in its pixels."""
    offset = session.panels[entry.eye].primary_offsets.get(entry.channel or "")
    return samples if offset is None else replace(samples, panel_pixel=samples.panel_pixel + offset)


def _place_numbers(photographs: Sequence[BoardPhotograph]) -> list[int]:
    """Return a number for each photograph, the same for those of one camera place."""
    numbers: dict[str, int] = {}
    return [numbers.setdefault(each.place, len(numbers)) for each in photographs]


def _exclusion(name: str, moved: CaptureOutlier) -> Excluded:
    reason = (
        f"its points lie {moved.arcmin:.0f}' from the positions predicted from the other photographs, as of another "
        "stage reading or target pose than session.toml says, of something that moved, or of optics that no smooth "
        "prediction follows there: compare its entry and its picture with those of its neighbours, or take it again."
    )
    return Excluded(name, reason, fault=True, off_arcmin=moved.arcmin)


def _refuse_far_places(session: PhotoSession, viewpoint: FloatArray) -> None:
    if (off := far_from_eye_box(viewpoint, session.eye_box)) is not None:
        x, y, z = 1e3 * off
        raise BadInputError(
            f"{session.folder}: the camera places lie ({x:.0f}, {y:.0f}, {z:.0f}) mm (x right, y up, z backward) from "
            "the middle of [eye_box]; check [tracking_camera] 'translation_mm' and 'rotation', 'frame' and "
            "'centre_mm', and that the tracking photographs are of the target poses that their entries state."
        )

"""Captures of one eye from photographs, in the device frame, without photographs and dots that are outliers.

A fit estimates the motion of the camera in each capture (`smooth_search`). A photograph is an outlier if its motion
stands out from the others, because it was not taken at the stated position.

The optics displace every dot from the straight line to it by an amount that varies smoothly over a photograph. A dot is
an outlier if it does not follow this smooth field, or if its stated sigma is far above the others', for example because
an aperture's edge cuts the dot.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wlr_render.calibration.bench.calibrate_bench import CalibratedBench
from wlr_render.calibration.bench.common_errors import with_bench_errors
from wlr_render.calibration.fit_display import fit_display
from wlr_render.calibration.fit_report import AnyModel, ModelFit
from wlr_render.calibration.fit_see_through import fit_see_through
from wlr_render.captures.boards.board import BoardObservation
from wlr_render.captures.capture_checks import far_from_eye_box
from wlr_render.captures.correspondences import (
    AnyCaptures,
    Captures,
    DisplayCaptures,
    SeeThroughCaptures,
    concatenate,
    select,
)
from wlr_render.captures.decoded import DecodedSamples
from wlr_render.captures.photo_session import CHANNELS, BoardPhotograph, CodeSet, PhotoSession, SessionEntry
from wlr_render.captures.session_reading import Excluded, Reading
from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.geometry.directions import ARCMIN, tangents_of_dir
from wlr_render.lenses.lens import Lens, radians_per_pixel
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray
from wlr_render.numerics.polynomial import Box, basis, term_count, total_degree
from wlr_render.usual import CAMERA_SYSTEMATIC_PX

_BEYOND_FIELD = 0.05  # margin on each side of the panel's field, for starts and interpolation of solves
_ROWS = 150  # most rows of a capture in the search for outliers; a motion needs no more
_DEGREE = 4  # degree of the fit that finds outliers; higher degrees could follow an outlier
_LEAST_ARCMIN = 2.0  # least error of an outlier; a smaller one harms no model

_DOT_TOP_DEGREE = 4  # highest degree of the field of a photograph's dots
_DOTS_PER_TERM = 8  # fewest dots for each term, so that a single outlier changes the field little
_DOT_SIGMAS, _DOT_LEAST_ARCMIN = 8.0, 0.3
"""Outlier thresholds, both to be exceeded: robust sigmas, beyond noise and fields of higher degree; and a third of a
camera pixel of 1', below which a dot is noisy but not misread."""
_DOT_SIGMA_RATIO = 5.0  # largest ratio of a dot's sigma to the photograph's median; dots beyond it are cut or blurred
_ROUNDS = 10  # most rounds of rejection; outliers distort the fitted field, so that the worst are rejected first
_AT_ONCE = 3.0  # ratio to the worst dot's error below which an outlier waits for the next round
_MAD = 1.4826  # factor from median absolute deviation to standard deviation


def sound_captures(
    session: PhotoSession, reading: Reading, bench: CalibratedBench
) -> tuple[Captures, tuple[Excluded, ...]]:
    """Return the captures of one eye that agree with their stated positions, and the excluded photographs.

    Raises:
        BadInputError: all cameras are far from the eye box, because a pose or a length in session.toml is wrong.
    """
    sets, through, excluded = reading.panels_of(session.display), reading.views_of(session.see_through), []
    display: DisplayCaptures | None = None
    if session.display:
        views = []
        for number, (each, found) in enumerate(sets):
            pose, samples = bench.device_from_camera(each), _of_primary(session, each, found.samples)
            known = recorded_of(each) | {"capture": number}
            views.append(panel_captures(session, bench.eyeball, pose, samples, **known))
        display = joined_views(views, "the panel")
        _refuse_far_places(session, display.viewpoint)
    see_through = _of_targets(session, bench, through) if session.see_through else None
    display, see_through = with_bench_errors(
        bench,
        None if display is None else (display, [each for each, _ in sets]),
        None if see_through is None else (see_through, [each for each, _ in through]),
    )
    if display is not None:
        colour = np.array([each.channel or "" for each, _ in sets])[display.capture]
        moved: dict[int, float] = {}
        for name in np.unique(colour):
            own = select(display, colour == name)
            moved |= outliers(own, own.capture, fit_display)
        excluded = [_exclusion(session.name_of(sets[group][0].folder), off) for group, off in moved.items()]
        display = select(display, ~np.isin(display.capture, [*moved]))
    if see_through is None:
        return Captures(display), tuple(excluded)
    if display is None:
        _refuse_far_places(session, see_through.viewpoint)
    else:
        see_through = within_field(see_through, display)
    see_through = select(see_through, dot_inliers(see_through, see_through.visit))
    gone = outliers(see_through, see_through.visit, fit_see_through)
    excluded += [_exclusion(through[group][0].name, off) for group, off in gone.items()]
    see_through = select(see_through, ~np.isin(see_through.visit, [*gone]))
    return Captures(display, see_through), tuple(excluded)


def _of_targets(
    session: PhotoSession, bench: CalibratedBench, through: Sequence[tuple[BoardPhotograph, BoardObservation]]
) -> SeeThroughCaptures:
    """Return captures of the targets through the optics; photographs are numbered as visits."""
    places, state = _place_numbers([each for each, _ in through]), bench.adjustment.state
    targets = []
    for number, ((each, seen), place) in enumerate(zip(through, places, strict=True)):
        pose, target = bench.device_from_camera(each), state.targets[each.target_pose]
        point, lens = bench.target_points(each.target_pose, seen), state.lens_at(each.target_pose)
        known = recorded_of(each) | {"visit": number, "capture": place, "target_pose": each.target_pose}
        targets.append(target_captures(session, lens or bench.eyeball, pose, target, seen, point, **known))
    return joined_views(targets, "the target through the optics")


def _of_primary(session: PhotoSession, entry: CodeSet, samples: DecodedSamples) -> DecodedSamples:
    """Return the samples with panel positions shifted to the position of the shown primary within the pixels."""
    offset = session.panels[entry.eye].primary_offsets.get(entry.channel or "")
    return samples if offset is None else replace(samples, panel_pixel=samples.panel_pixel + offset)


def _place_numbers(photographs: Sequence[BoardPhotograph]) -> list[int]:
    """Return a number for each photograph; photographs from one camera position share a number."""
    numbers: dict[str, int] = {}
    return [numbers.setdefault(each.place, len(numbers)) for each in photographs]


def _exclusion(name: str, off_arcmin: float) -> Excluded:
    reason = (
        f"its points lie {off_arcmin:.0f}' from the positions predicted from the other photographs, as of another "
        "stage reading or target pose than session.toml says, of something that moved, or of optics that no smooth "
        "prediction follows there: compare its entry and its picture with those of its neighbours, or take it again."
    )
    return Excluded(name, reason, fault=True, off_arcmin=off_arcmin)


def _refuse_far_places(session: PhotoSession, viewpoint: FloatArray) -> None:
    if (off := far_from_eye_box(viewpoint, session.eye_box)) is not None:
        x, y, z = 1e3 * off
        raise BadInputError(
            f"{session.folder}: the camera places lie ({x:.0f}, {y:.0f}, {z:.0f}) mm (x right, y up, z backward) from "
            "the middle of [eye_box]; check [tracking_camera] 'translation_mm' and 'rotation', 'frame' and "
            "'centre_mm', and that the tracking photographs are of the target poses that their entries state."
        )


def panel_captures(
    session: PhotoSession, camera: Lens, pose: FloatArray, samples: DecodedSamples, **columns: Any
) -> DisplayCaptures:
    """Return captures of the panel decoded at one camera pose.

    Args:
        session: session of one eye.
        camera: the lens; it has OpenCV's axes.
        pose: (4, 4) device_from_camera.
        samples: the decoded panel positions.
        **columns: other columns of captures, i.e. `capture` and the recorded ones.

    Raises:
        BadInputError: the camera does not look at the optics.
    """
    # The sigma of a decoded panel position becomes the sigma of its direction, in camera pixels.
    rows, sound = _rows(session, camera, pose, samples.camera_pixel, samples.sigma_px / samples.scale)
    return DisplayCaptures(panel=session.pattern.panel, pixel=samples.panel_pixel[sound], **rows, **columns)


def target_captures(
    session: PhotoSession,
    camera: Lens,
    pose: FloatArray,
    device_from_target: FloatArray,
    observation: BoardObservation,
    target_point: FloatArray,
    **columns: Any,
) -> SeeThroughCaptures:
    """Return captures of the target observed through the optics at one camera pose.

    Args:
        session, pose, **columns: as in `panel_captures`.
        camera: the lens when focused at this target's distance.
        device_from_target: (4, 4) pose of the target.
        observation: the detected features.
        target_point: (n, 3) true positions of the features, target's frame.

    Raises:
        BadInputError: the camera does not look at the optics.
    """
    pixel, discs = observation.pixel, observation.discs
    if discs is not None:
        pixel = discs.centres(camera, target_point, pixel)
    rows, sound = _rows(session, camera, pose, pixel, observation.sigma_px)
    on_target = target_point[sound]
    point = transforms.apply(device_from_target, on_target)
    return SeeThroughCaptures(point=point, target_point=on_target, **rows, **columns)


def joined_views(views: Sequence[AnyCaptures], what: str) -> AnyCaptures:
    """Return the captures of all views; `what` is the photographed object in the error message.

    Raises:
        BadInputError: `views` is empty.
    """
    if not views:
        raise BadInputError(f"no photographs of {what} are left to fit a model to; see which were rejected.")
    return concatenate(views)


def within_field(see_through: SeeThroughCaptures, display: DisplayCaptures) -> SeeThroughCaptures:
    """Return the dots within the field of view of the panel plus a margin, where the model is used.

    Raises:
        BadInputError: no dot is within this field.
    """
    shown = display.tangents
    low, high = shown.min(axis=0), shown.max(axis=0)
    beyond = _BEYOND_FIELD * (high - low)
    seen = see_through.tangents
    inside = np.all((seen >= low - beyond) & (seen <= high + beyond), axis=-1)
    if not inside.any():
        raise BadInputError("no dot of the target was seen in the directions of the panel; put the target before it.")
    return select(see_through, inside)


def recorded_of(taken: SessionEntry) -> dict[str, Any]:
    """Return the data recorded in session.toml for a photograph or a set, by names of captures' columns."""
    stated = {"stage": taken.stage, "time_s": taken.time_s, "temperature_c": taken.temperature_c}
    if isinstance(taken, CodeSet) and taken.channel is not None:
        stated["channel"] = CHANNELS.index(taken.channel)
    return {name: value for name, value in stated.items() if value is not None}


def _rows(
    session: PhotoSession, camera: Lens, pose: FloatArray, pixel: FloatArray, sigma_px: FloatArray
) -> tuple[dict[str, Any], BoolArray]:
    """Return the columns common to both kinds of captures, for pixels in the lens model's domain, and their mask (n,).

    Args:
        session: session of one eye.
        camera: the lens; it has OpenCV's axes.
        pose: (4, 4) device_from_camera.
        pixel: (n, 2) camera pixels.
        sigma_px: (n,) standard deviations of the pixels.

    Raises:
        BadInputError: some pixels have backward directions in the device frame.
    """
    in_camera = camera.dir_of_pixel(pixel)
    direction = transforms.rotate(pose, in_camera)
    if np.any(direction[:, 2] >= 0):
        raise BadInputError(
            "the eyeball camera looks back, not through the optics; check 'frame' and the tracking camera's 'rotation' "
            "in session.toml."
        )
    sound = np.asarray(np.isfinite(in_camera).all(axis=-1))
    arcmin_per_px = radians_per_pixel(camera, in_camera) / ARCMIN
    rows = {
        "device": session.device,
        "eye": session.eye,
        "eye_box": session.eye_box,
        "viewpoint": pose[:3, 3],
        "view_dir": direction[sound],
        "sigma_arcmin": (np.hypot(sigma_px, CAMERA_SYSTEMATIC_PX.value) * arcmin_per_px)[sound],
        "device_from_camera": pose[:3, :3] @ transforms.OPENXR_FROM_OPENCV,
    }
    return rows, sound


def outliers(
    captures: AnyCaptures, group: IntArray, fit: Callable[[AnyCaptures, str, int | None], ModelFit[AnyModel]]
) -> dict[int, float]:
    """Return the mean error, arcminutes, of photographs that contradict the others, by number.

    The result is empty if there are too few photographs for a test.

    Args:
        captures: captures of the panel in one colour, or of the targets.
        group: (n,) number of each row's photograph.
        fit: `fit_display` or `fit_see_through`.
    """
    names = np.unique(group)
    rows = np.concatenate(
        [own[:: max(1, len(own) // _ROWS)] for own in (np.flatnonzero(group == name) for name in names)]
    )
    try:
        smooth = fit(select(captures, rows), "planar", _DEGREE).smooth
    except BadInputError:
        return {}  # the fit to all rows reports the error
    found = {int(group[rows][smooth.readings.capture == each.capture][0]): each.arcmin for each in smooth.moved}
    return {name: off for name, off in sorted(found.items()) if off > _LEAST_ARCMIN}


def dot_inliers(captures: SeeThroughCaptures, photograph: NDArray[np.int64]) -> BoolArray:
    """Return the mask (n,) of dots that follow the smooth field of their photograph, numbered by `photograph` (n,)."""
    seen = captures.tangents
    displaced = (seen - tangents_of_dir(captures.point - captures.viewpoint)) / ARCMIN
    follows = np.ones(len(captures), dtype=bool)
    for one in np.unique(photograph):
        rows = np.flatnonzero(photograph == one)
        sigma = captures.sigma_arcmin[rows]
        sure = rows[sigma <= _DOT_SIGMA_RATIO * np.median(sigma)]
        follows[rows] = False
        follows[sure] = _smooth(seen[sure], displaced[sure])
    return follows


def _smooth(place: FloatArray, displaced: FloatArray) -> BoolArray:
    """Return the mask (n,) of the values (n, 2) at places (n, 2) that follow a polynomial fitted to them."""
    kept = np.ones(len(place), dtype=bool)
    degree = next((n for n in range(_DOT_TOP_DEGREE, 0, -1) if term_count(2, n) * _DOTS_PER_TERM <= len(place)), 0)
    if degree == 0:
        return kept
    design = basis(place, total_degree(2, degree), Box.around(place))
    for _ in range(_ROUNDS):
        coefficients = np.linalg.lstsq(design[kept], displaced[kept], rcond=None)[0]
        off = np.linalg.norm(displaced - design @ coefficients, axis=1)
        limit = max(_DOT_SIGMAS * _MAD * float(np.median(off[kept])), _DOT_LEAST_ARCMIN)
        worst = float(off[kept].max())
        if worst <= limit:
            break
        kept = off <= max(limit, worst / _AT_ONCE)
    return kept

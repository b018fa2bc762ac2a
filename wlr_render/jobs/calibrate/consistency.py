"""Whether captures agree with each other and with session.toml, before anything is fitted to them."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from wlr_render.calibration.capture_outliers import CaptureOutlier, display_outliers, dot_inliers, see_through_outliers
from wlr_render.captures.correspondences import EyeCaptures, SeeThroughCaptures, select
from wlr_render.captures.photo_session import BoardPhotograph, PhotoSession
from wlr_render.captures.targets.dot_board import BoardObservation
from wlr_render.errors import BadInputError
from wlr_render.jobs.calibrate.reading import Reading
from wlr_render.jobs.calibrate.reading_tasks import SetAside
from wlr_render.numerics.arrays import FloatArray, IntArray

_BESIDE_EYE_BOX_M = 0.015  # the middle of all camera places lies this close to it, whatever the design of the places


def sound_captures(
    session: PhotoSession, reading: Reading, captures: EyeCaptures
) -> tuple[EyeCaptures, tuple[SetAside, ...]]:
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
    aside = [_aside([sets[each.group]], each) for each in moved]
    display = select(display, ~np.isin(display.capture, [each.group for each in moved]))
    names = _names(reading.seen(session.see_through))
    gone = see_through_outliers(see_through, photograph)
    aside += [_aside(names[keys[each.group]], each) for each in gone]
    see_through = select(see_through, ~np.isin(photograph, [each.group for each in gone]))
    return replace(captures, display=display, see_through=see_through), tuple(aside)


def camera_places(photographs: Sequence[BoardPhotograph]) -> list[int]:
    """A number for each photograph, the same for those at one stage reading."""
    numbers: dict[bytes, int] = {}
    return [numbers.setdefault(each.stage.tobytes(), len(numbers)) for each in photographs]


def _photographs(captures: SeeThroughCaptures) -> tuple[list[tuple[int, int]], IntArray]:
    """Target pose and camera position of each photograph, and (n,) the index of each row's photograph."""
    keys, index = np.unique(np.stack([captures.target_pose, captures.capture], axis=1), axis=0, return_inverse=True)
    return [(int(pose), int(place)) for pose, place in keys], np.asarray(index.ravel())


def _names(seen: Sequence[tuple[BoardPhotograph, BoardObservation]]) -> dict[tuple[int, int], list[str]]:
    """Names of photographs by target pose and camera position; one position may have been photographed twice."""
    photographs = [each for each, _ in seen]
    names: dict[tuple[int, int], list[str]] = {}
    for each, place in zip(photographs, camera_places(photographs), strict=True):
        names.setdefault((each.target_pose, place), []).append(each.name)
    return names


def _aside(names: Sequence[str], moved: CaptureOutlier) -> SetAside:
    reason = (
        f"what it shows lies {moved.arcmin:.0f}' from where the other photographs have it: it was taken at another "
        "stage reading or target pose than session.toml says, or something moved; correct its entry, or take it again."
    )
    return SetAside(" and ".join(names), reason, fault=True)


def _refuse_far_places(session: PhotoSession, viewpoint: FloatArray) -> None:
    box = session.eye_box
    off = np.unique(viewpoint, axis=0).mean(axis=0) - box.centre
    if np.any(np.abs(off) > 0.5 * box.size + _BESIDE_EYE_BOX_M):
        x, y, z = 1e3 * off
        raise BadInputError(
            f"{session.folder}: the camera places lie ({x:.0f}, {y:.0f}, {z:.0f}) mm (x right, y up, z backward) from "
            "the middle of [eye_box]; check [tracking_camera] 'translation_mm' and 'rotation', 'frame' and 'centre_mm'."
        )

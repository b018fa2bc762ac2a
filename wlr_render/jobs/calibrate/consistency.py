"""Whether captures agree with each other and with session.toml, before anything is fitted to them."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from wlr_render.calibration.capture_outliers import Moved, follow_their_photograph, moved_display, moved_see_through
from wlr_render.captures.correspondences import EyeCaptures, SeeThroughCaptures, select
from wlr_render.captures.photo_session import BoardPhotograph, PhotoSession
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
    see_through = select(see_through, follow_their_photograph(see_through, _photograph(see_through)))
    moved = moved_display(display)
    sets = [session.name_of(each.folder) for each, _ in reading.decoded(session.display)]
    aside = [_aside([sets[each.group]], each) for each in moved]
    display = select(display, ~np.isin(display.capture, [each.group for each in moved]))
    photographs = _names(session, reading)
    gone = moved_see_through(see_through, _photograph(see_through))
    aside += [_aside(photographs[each.group], each) for each in gone]
    see_through = select(see_through, ~np.isin(_photograph(see_through), [each.group for each in gone]))
    return replace(captures, display=display, see_through=see_through), tuple(aside)


def camera_places(photographs: Sequence[BoardPhotograph]) -> list[int]:
    """A number for each photograph, the same for those at one stage reading."""
    numbers: dict[bytes, int] = {}
    return [numbers.setdefault(each.stage.tobytes(), len(numbers)) for each in photographs]


def _photograph(captures: SeeThroughCaptures) -> IntArray:
    """(n,) one number for each target pose and camera place."""
    return np.asarray(captures.target_pose * _PLACES + captures.capture)


_PLACES = 1_000_000  # more camera places than anybody photographs from


def _names(session: PhotoSession, reading: Reading) -> dict[int, list[str]]:
    """The photographs through the optics by `_photograph`; one place may have been photographed twice."""
    seen = [each for each, _ in reading.seen(session.see_through)]
    names: dict[int, list[str]] = {}
    for each, place in zip(seen, camera_places(seen), strict=True):
        names.setdefault(each.target_pose * _PLACES + place, []).append(session.name_of(each.path))
    return names


def _aside(names: Sequence[str], moved: Moved) -> SetAside:
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

"""Captures that moved: each by far more than the bench's repeatability, and not explained by any cause."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from wlr_render.diagnosis.fit import Fit
from wlr_render.diagnosis.observations import SEE_THROUGH, CaptureName, Observations
from wlr_render.diagnosis.weighed_readings import WeighedReadings
from wlr_render.numerics.arrays import BoolArray
from wlr_render.numerics.scatter import LOG10_ODDS, cost
from wlr_render.numerics.scatter_search import motions_of


@dataclass(frozen=True)
class MovedCapture:
    """An excluded capture.

    Attributes:
        capture: its name.
        shift_mm: (3,) apparent shift of its camera, device frame; None where dots are located by a photograph without
            the headset, which moves with the camera.
        turn_deg: (3,) its apparent rotation; likewise.
        rms_before, rms_after: its rms residual in units of sigma, without and with that move.
        log10_odds: for the move against one of the usual size.
    """

    capture: CaptureName
    shift_mm: tuple[float, ...] | None
    turn_deg: tuple[float, ...] | None
    rms_before: float
    rms_after: float
    log10_odds: float


def moved_captures(readings: WeighedReadings, found: Fit) -> list[MovedCapture]:
    """Return the captures that moved according to a fit.

    Run-time recordings have no camera pose and are never listed.
    """
    observations = readings.observations
    sums = readings.sums_at(found.at)
    motion, least = motions_of(sums, found.scatter), cost(sums, found.scatter)
    made = []
    for number in np.flatnonzero(found.scatter.moved):
        rows = observations.group == number
        before = readings.shared(found.at.residual)[rows]
        after = before - readings.motions[rows] @ motion[number]
        odds = LOG10_ODDS * (cost(sums, found.scatter.with_other(int(number))) - least)
        shift, turn = (1e-3 * motion[number, :3]).tolist(), np.degrees(1e-6 * motion[number, 3:]).tolist()
        name, rms = observations.captures[number], [float(np.sqrt(np.mean(each**2))) for each in (before, after)]
        known = not _is_placed_by_bare(observations, name)
        pose = [tuple(each) if known else None for each in (shift, turn)]
        made.append(MovedCapture(name, pose[0], pose[1], rms[0], rms[1], odds))
    return made


def _is_placed_by_bare(observations: Observations, name: CaptureName) -> bool:
    plan = observations.session.plan.see_through
    return name.part == SEE_THROUGH and plan is not None and plan.bare_pixel is not None


def not_excluded(observations: Observations, excluded: Sequence[MovedCapture]) -> BoolArray:
    """Return the mask (n,) of readings of captures that are not excluded."""
    names = {each.capture for each in excluded}
    bad = [number for number, name in enumerate(observations.captures) if name in names]
    return ~np.isin(observations.group, bad)

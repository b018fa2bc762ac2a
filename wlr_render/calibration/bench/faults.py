"""Single faults among the views of a bench, such as a photograph at another place, or a target or camera that moved.

Each candidate is a small motion (6,) of the board in some views. The increase in evidence by a candidate follows from
the adjusted bench without a new adjustment. The best candidate is accepted if it is significant and large enough: then
single photographs are left out, or later views get a separate target or mounting, and the bench is adjusted again.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise

import numpy as np

from wlr_render.calibration.bench.adjustment import Adjustment
from wlr_render.calibration.bench.bench_blocks import Key, Layout
from wlr_render.calibration.bench.board_views import APART, EYEBALL, TRACKING, BenchObservations, BoardView
from wlr_render.calibration.bench.normal_equations import Normal
from wlr_render.calibration.bench.state import BenchState
from wlr_render.calibration.poses import motion_between
from wlr_render.geometry.directions import ARCMIN
from wlr_render.numerics.arrays import FloatArray

NEGLIGIBLE_M, NEGLIGIBLE_RAD = 3e-5, 0.3 * ARCMIN
"""Largest negligible motions; such a shift moves a target at half a metre by 0.2 arcminutes."""
_PLAUSIBLE = {  # standard deviations of faults of a bench, radians and metres
    "photograph": np.repeat([3e-3, 1e-2], 3),  # a reading differs from the recorded one
    "motion": np.repeat([3e-3, 1e-3], 3),
}
_SIMILAR = 5.0  # log odds, 150 to 1, below which both explanations remain possible
_CONVINCING = 9.2  # least log odds of a fault, 10,000 to 1, plus the log number of candidates
_MOST = 4  # most faults that are named; a session with more must be repeated
_MOST_PAIRED = 40  # most photographs for a test of all pairs, 780
_SHRINKS = [(-a, -b) for a in (0.0, 1.5, 3.0) for b in (0.0, 1.5, 3.0, 4.5, 6.0)]  # steps of log stage errors
_OF_STAGE = ("turn", "smooth turn", "drift"), ("shift", "smooth shift", "screw")
SINGLE = ("photograph", "exchange")
"""Kinds of faults whose photographs are rejected; other kinds lead to a separate target or mounting."""


@dataclass(frozen=True, eq=False)
class Fault:
    """A contradiction to the session's description.

    Attributes:
        kind: "photograph", "exchange", "target in bare", "camera in bare", "target before tracking" or "tracking".
        names: names of the last photograph before the fault and the first one with it, or of a single photograph.
        target: number of the target pose; -1 for all.
        views: names of all affected views.
        motion: (6,) motion of the board in the camera's frame: rotation (rad), translation (m).
        log_odds: natural logarithm of the odds.
        alternatives: other faults that explain the views equally well.
    """

    kind: str
    names: tuple[str, ...]
    target: int
    views: tuple[str, ...]
    motion: FloatArray
    log_odds: float
    alternatives: tuple["Fault", ...] = ()

    @property
    def plausible(self) -> FloatArray:
        """Prior standard deviations (6,) of the motion."""
        return _PLAUSIBLE.get(self.kind, _PLAUSIBLE["motion"])

    @property
    def matters(self) -> bool:
        """True if the rotation exceeds `NEGLIGIBLE_RAD` or the translation exceeds `NEGLIGIBLE_M`."""
        turn, shift = np.linalg.norm(self.motion[:3]), np.linalg.norm(self.motion[3:])
        return bool(turn > NEGLIGIBLE_RAD or shift > NEGLIGIBLE_M)


def adjust_without_faults(
    observations: BenchObservations, adjusted: Callable[[BenchObservations], Adjustment]
) -> tuple[Adjustment, list[Fault]]:
    """Adjust a bench, isolating the views that single faults affect; return the adjustment and the faults.

    If neither the first nor the last adjustment settles, the result is the first one without faults, because odds are
    valid only at a minimum.
    """
    found: list[Fault] = []
    adjustment = first = adjusted(observations)
    while len(found) < _MOST:
        fault = worst_fault(adjustment)
        if fault is None:
            break
        found.append(fault)
        observations = _set_apart(observations, fault, APART * len(found))
        adjustment = adjusted(observations)
    return (adjustment, found) if adjustment.is_settled or first.is_settled else (first, [])


def worst_fault(adjustment: Adjustment) -> Fault | None:
    """Return the candidate of greatest evidence; None if chance explains all, or the motion is negligible."""
    state = adjustment.state
    candidates = _candidates(state)
    if not candidates:
        return None
    base = adjustment.layout
    own, free = len(base.size), [each for each in candidates if each.kind != "exchange"]
    where = dict(base.where) | {("fault", k): slice(own + 6 * k, own + 6 * k + 6) for k in range(len(free))}
    extra: dict[Key, dict[str, FloatArray]] = {
        ("fault", k): dict.fromkeys(each.views, np.eye(6)) for k, each in enumerate(free)
    }
    size = np.concatenate([base.size, *(each.plausible for each in free)])
    layout = Layout(where, size, np.pad(base.features, ((0, 6 * len(free)), (0, 0))))
    rows_of = {each.views: np.arange(6 * k, 6 * k + 6) for k, each in enumerate(free)}
    normal = Normal(state, layout, adjustment.sizes, extra)
    prior = layout.prior
    count = len(candidates)
    odds, motion = np.full(count, -np.inf), np.zeros((count, 6))
    without = -np.inf
    turns, shifts = (np.array([name in ends for name in prior.names], dtype=float) for ends in _OF_STAGE)
    for turn, shift in _SHRINKS:
        # A fault makes the stage look worse than it is, so that the stage's errors may be smaller given the fault.
        hyper = adjustment.hyper + turn * turns + shift * shifts
        width = layout.size * np.exp(prior.mixed_features @ hyper)
        gram, moment = width[:, None] * normal.gram * width, width * normal.moment
        inner = gram[:own, :own] + np.eye(own)
        follow = np.linalg.solve(inner, np.concatenate([gram[:own, own:], moment[:own, None]], axis=1))
        rest_gram = gram[own:, own:] - gram[own:, :own] @ follow[:, :-1]
        rest_moment = moment[own:] - gram[own:, :own] @ follow[:, -1]
        base_odds = 0.5 * float(moment[:own] @ follow[:, -1] - np.linalg.slogdet(inner)[1]) - prior.surprise(hyper)[0]
        without = max(without, base_odds)
        for k, each in enumerate(candidates):
            if each.kind == "exchange":  # the displacement is known from the readings
                rows = np.concatenate([rows_of[(view,)] for view in each.views])
                push = np.concatenate([each.motion, -each.motion]) / size[own + rows]
                drop = push @ rest_gram[np.ix_(rows, rows)] @ push
                gain, value = base_odds + float(push @ rest_moment[rows] - 0.5 * drop), each.motion
            else:
                rows = rows_of[each.views]
                matrix = rest_gram[np.ix_(rows, rows)] + np.eye(6)
                unit = np.linalg.solve(matrix, rest_moment[rows])
                gain = base_odds + 0.5 * float(unit @ rest_moment[rows] - np.linalg.slogdet(matrix)[1])
                value = np.asarray(each.plausible * unit)
            if gain > odds[k]:
                odds[k], motion[k] = gain, value
    return _most_probable(candidates, odds - without, motion)


def _most_probable(candidates: Sequence[Fault], log_odds: FloatArray, motion: FloatArray) -> Fault | None:
    """Return the candidate of greatest odds (n,), with its motion (n, 6) and alternatives of similar probability."""
    least = _CONVINCING + np.log(len(candidates))
    granted = [
        fault
        for each, gain, moved in zip(candidates, log_odds, motion, strict=True)
        if gain > least and (fault := replace(each, motion=moved, log_odds=float(gain))).matters
    ]
    best = max(granted, key=lambda fault: fault.log_odds, default=None)
    if best is None:
        return None
    others = (fault for fault in granted if fault is not best and best.log_odds - fault.log_odds < _SIMILAR)
    return replace(best, alternatives=tuple(sorted(others, key=lambda fault: -fault.log_odds)))


def _exchanges(state: BenchState, staged: Sequence[BoardView]) -> list[Fault]:
    """Return all pairs of photographs whose readings may have been exchanged."""
    found = []
    for one, other in combinations(staged, 2):
        here, there = (state.observations.places[str(view.place)] for view in (one, other))
        assert here.reading is not None
        assert there.reading is not None
        if not here.orientation == there.orientation == state.first_mounting:
            continue
        apart = motion_between(state.stage.nominal(there.reading), state.stage.nominal(here.reading))
        names = (one.name, other.name)
        if np.linalg.norm(apart[:3]) > NEGLIGIBLE_RAD or np.linalg.norm(apart[3:]) > NEGLIGIBLE_M:
            found.append(Fault("exchange", names, int(one.target or 0), names, apart, 0.0))
    return found


def _candidates(state: BenchState) -> list[Fault]:
    """Return possible faults, in the order of taking."""
    observations = state.observations
    none = np.zeros(6)
    bare = [view for view in observations.views if view.camera == EYEBALL and view.target is not None]
    staged = [view for view in bare if observations.places[str(view.place)].reading is not None]
    found = [Fault("photograph", (view.name,), int(view.target or 0), (view.name,), none, 0.0) for view in staged]
    if len(staged) <= _MOST_PAIRED:
        found += _exchanges(state, staged)
    found += [
        Fault("camera in bare", (before.name, view.name), -1, tuple(each.name for each in staged[k + 1 :]), none, 0.0)
        for k, (before, view) in enumerate(pairwise(staged))
        if 1 <= k < len(staged) - 2
    ]
    tracking = [view for view in observations.views if view.camera == TRACKING and view.target is not None]
    for target in dict.fromkeys(int(view.target or 0) for view in [*staged, *tracking]):
        own = [view for view in staged if view.target == target]
        found += [
            Fault("target in bare", (before.name, view.name), target, tuple(e.name for e in own[k + 1 :]), none, 0.0)
            for k, (before, view) in enumerate(pairwise(own))
            if 1 <= k < len(own) - 2
        ]
        tracked = [view for view in tracking if view.target == target]
        if own and tracked and len({view.target for view in tracking}) > 1:
            names = (own[-1].name, tracked[0].name)
            found.append(Fault("target before tracking", names, target, tuple(e.name for e in own), none, 0.0))
        found += [
            Fault("tracking", (before.name, view.name), target, tuple(e.name for e in tracked[k + 1 :]), none, 0.0)
            for k, (before, view) in enumerate(pairwise(tracked))
        ]
    return found


def _set_apart(observations: BenchObservations, fault: Fault, number: int) -> BenchObservations:
    """Return the observations with the views of a fault rejected, or assigned a separate target or mounting."""
    if fault.kind in SINGLE:
        return observations.without(fault.names)
    touched = [view for view in observations.views if view.name in fault.views]
    if fault.kind == "camera in bare":
        places = dict(observations.places)
        for view in touched:
            place = places[str(view.place)]
            places[str(view.place)] = replace(place, orientation=place.orientation + number)
        return replace(observations, places=places)

    def moved(view: BoardView) -> BoardView:
        return replace(view, target=int(view.target or 0) + number) if view.name in fault.views else view

    return replace(observations, views=[moved(view) for view in observations.views])

"""Models of one side of the headset, refitted to a session as two benches believe it to be."""

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from wlr_render.calibration.fit_display import fit_display
from wlr_render.calibration.fit_report import FitReport, HeldOut
from wlr_render.calibration.fit_see_through import fit_see_through
from wlr_render.captures.correspondences import AnyCaptures, DisplayCaptures, SeeThroughCaptures, select
from wlr_render.captures.session import Session
from wlr_render.diagnosis.held_out import HeldOutGain, held_out_gain
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import arcmin_between
from wlr_render.mappings import DisplayMapping, SeeThroughMapping
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.bench import Bench
from wlr_render.simulation.session_captures import display_captures, see_through_captures

AnyMapping = TypeVar("AnyMapping", DisplayMapping, SeeThroughMapping)

_KIND = "planar"
_ROWS = 6_000  # of a fit: five times more lower its error by a twentieth, and take three times as long
_HELD_OUT = 4  # one photograph in so many


@dataclass(frozen=True)
class Refitted:
    """A model refitted to the captures as the nominal and as the extended bench believe them to be.

    Attributes:
        degree: of both fits.
        own_before, own_after: error on held-out captures that are placed by the bench that the fit goes by; None where
            there are too few. What is smooth, such as a stage's scale, does not show: fit and captures share it.
        before, after: rms error in arcminutes on held-out captures, placed where the extended bench says they were.
        gain: of `after` over `before`.
    """

    degree: int
    own_before: HeldOut | None
    own_after: HeldOut | None
    before: float
    after: float
    gain: HeldOutGain


@dataclass(frozen=True)
class Refit(Generic[AnyMapping]):
    """One side of the headset.

    Attributes:
        before, after: the models by the nominal and by the extended bench.
        refitted: how good they are.
    """

    before: AnyMapping
    after: AnyMapping
    refitted: Refitted


@dataclass(frozen=True)
class _Side(Generic[AnyCaptures, AnyMapping]):
    """How one side is fitted, and in which direction (n, 3) a model of it sees what captures saw."""

    degree: int
    fit: Callable[[AnyCaptures, str, int | None], tuple[AnyMapping, FitReport]]
    seen: Callable[[AnyMapping, AnyCaptures], FloatArray]


def _panel_seen(model: DisplayMapping, captures: DisplayCaptures) -> FloatArray:
    return model.view_dir_of_pixel(captures.pixel, captures.viewpoint).value


def _world_seen(model: SeeThroughMapping, captures: SeeThroughCaptures) -> FloatArray:
    return model.view_dir_of_real_point(captures.point, captures.viewpoint).value


# Where the held-out error of the shipped devices levels off, on the grids that benches measure.
_DISPLAY = _Side(6, fit_display, _panel_seen)
_SEE_THROUGH = _Side(3, fit_see_through, _world_seen)


def refit_display(nominal: Bench, extended: Bench, session: Session) -> Refit[DisplayMapping]:
    """Fit the display by both benches.

    Raises:
        BadInputError: the session has no display table, or does not determine a model.
    """
    plan, pixel = session.plan.display, session.readings.panel_pixel
    if plan is None or pixel is None:
        raise BadInputError(f"{session.name}: has no display table, so no display model can be fitted; add one.")
    return _refit(_DISPLAY, display_captures(nominal, plan, pixel), display_captures(extended, plan, pixel))


def refit_see_through(nominal: Bench, extended: Bench, session: Session) -> Refit[SeeThroughMapping]:
    """Fit how the world is seen by both benches.

    Raises:
        BadInputError: the session has no seethrough table, or does not determine a model.
    """
    plan, pixel = session.plan.see_through, session.readings.dot_pixel
    if plan is None or pixel is None:
        raise BadInputError(f"{session.name}: has no seethrough table, so no see-through model can be fitted; add one.")
    return _refit(_SEE_THROUGH, see_through_captures(nominal, plan, pixel), see_through_captures(extended, plan, pixel))


def _refit(side: _Side[AnyCaptures, AnyMapping], before: AnyCaptures, after: AnyCaptures) -> Refit[AnyMapping]:
    rng = np.random.default_rng(0)
    rows = np.sort(rng.permutation(len(before))[:_ROWS])
    before, after = select(before, rows), select(after, rows)
    (model_before, own_before), (model_after, own_after) = _pair(side, before, after, side.degree)
    names = np.unique(before.capture)
    out = np.isin(before.capture, rng.permutation(names)[: max(2, len(names) // _HELD_OUT)])
    partial = _pair(side, select(before, ~out), select(after, ~out), own_before.degree)
    judge = select(after, out)
    old, new = (arcmin_between(side.seen(model, judge), judge.view_dir) for model, _ in partial)
    refitted = _refitted(own_before, own_after, judge.capture, old, new)
    return Refit(model_before, model_after, refitted)


def _pair(
    side: _Side[AnyCaptures, AnyMapping], before: AnyCaptures, after: AnyCaptures, degree: int
) -> tuple[tuple[AnyMapping, FitReport], tuple[AnyMapping, FitReport]]:
    """Two fits at one degree: the given one or, where the captures are too few for it, the best that they support."""
    try:
        first = side.fit(before, _KIND, degree)
    except BadInputError:
        first = side.fit(before, _KIND, None)
    if _same(before, after):
        return first, first
    return first, side.fit(after, _KIND, first[1].degree)


def _same(before: AnyCaptures, after: AnyCaptures) -> bool:
    """Whether two benches make the same of what was read; then the fits must not differ by rounding either."""
    arrays = [(getattr(before, field.name), getattr(after, field.name)) for field in fields(before)]
    return all(np.array_equal(a, b) for a, b in arrays if isinstance(a, np.ndarray))


def _refitted(
    own_before: FitReport, own_after: FitReport, capture: NDArray[np.int64], old: FloatArray, new: FloatArray
) -> Refitted:
    """Of errors (n,) on held-out captures, where both models have an answer."""
    both = np.isfinite(old) & np.isfinite(new)
    names, owner = np.unique(capture[both], return_inverse=True)
    squares = [np.bincount(owner, error[both] ** 2, len(names)).astype(np.float64) for error in (old, new)]
    before, after = (float(np.sqrt(square.sum() / both.sum())) for square in squares)
    return Refitted(
        own_before.degree,
        own_before.held_out_at_degree(),
        own_after.held_out_at_degree(),
        before,
        after,
        held_out_gain(squares[0], squares[1]),
    )

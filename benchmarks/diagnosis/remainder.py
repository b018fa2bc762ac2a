"""Residual of a hidden effect after the best match by another single cause."""

from collections.abc import Iterable, Sequence

import numpy as np

from wlr_render.diagnosis.causes import CAUSES
from wlr_render.diagnosis.fit import Fit, fit
from wlr_render.diagnosis.prediction import Explanation
from wlr_render.diagnosis.screening import Signatures, hypotheses, screen
from wlr_render.diagnosis.weighed_readings import WeighedReadings
from wlr_render.numerics.scatter import Scatter

_OTHERS = 6
_WORTH_A_FIT = 0.3  # smallest share of the truth's gain: less first-order gain leaves far more residual than the truth


def remainder(readings: WeighedReadings, scatter: Scatter, hidden: Sequence[str], name: str) -> float:
    """Return the chi-squared of the best other cause in place of a hidden cause, less the truth's; 25 is 5 sigma.

    "No cause" competes as well. All readings count, including those that a diagnosis excludes: a slip before the last
    captures must not be mistaken for captures that moved.

    Args:
        readings: readings with only the hidden causes and the true noise.
        scatter: true scatter of the captures.
        hidden: all active causes.
        name: the cause to replace; the others stay active.
    """
    rest = fit(readings, Explanation(), scatter, vary_scatter=False)
    assert rest is not None
    for other in hidden:
        if other != name:
            rest = min(_fitted(readings, rest, [other], 1), key=lambda each: each.chi_squared)
    truth = min(each.chi_squared for each in _fitted(readings, rest, [name], _OTHERS))
    least = _WORTH_A_FIT * (rest.chi_squared - truth)
    others = _fitted(readings, rest, set(CAUSES) - set(hidden), _OTHERS, least)
    return float(min([rest.chi_squared, *(each.chi_squared for each in others)]) - truth)


def _fitted(
    readings: WeighedReadings, rest: Fit, names: Iterable[str], most: int, least_gain: float = -np.inf
) -> list[Fit]:
    """Return fits with one more cause, in the most promising ways with at least `least_gain`; else the given fit."""
    causes = {name: CAUSES[name] for name in names}
    candidates = hypotheses(causes)
    screened = screen(Signatures.of(readings, candidates), rest, candidates)
    chosen = [each for each in screened if each.gain > least_gain][:most]
    starts = [rest.explanation.plus(each.hypothesis, each.start) for each in chosen]
    fits = [fit(readings, each, rest.scatter, vary_scatter=False) for each in starts]
    return [each for each in fits if each is not None] or [rest]

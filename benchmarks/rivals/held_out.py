"""Errors on data that was not fitted, with intervals by bootstrap over whole captures."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.report.blocks import Cell

_DRAWS = 4_000
_LEVEL = (2.5, 97.5)  # percentiles of the interval
COLUMNS = ("rms (arcmin)", "95 % interval", "median (arcmin)", "over {}", "95 % interval of that")
"""Column headings of `cells`."""


@dataclass(frozen=True)
class HeldOut:
    """Errors of a method on left-out data.

    Attributes:
        method: name of the method.
        error: (n,) angles in arcminutes; empty if the method refused the captures.
        group: (n,) unit of the bootstrap: the capture, view or sitting.
        refusal: reason why the method cannot use the captures; None if it can.
    """

    method: str
    error: FloatArray
    group: IntArray
    refusal: str | None = None


def held_out(method: str, group: IntArray, error_without: Callable[[int], FloatArray]) -> HeldOut:
    """Fit without each group in turn, and judge the left-out group.

    Args:
        method: name of the method.
        group: (n,) group of each row.
        error_without: function of a group that returns the errors of its rows, arcminutes, for a fit to all other
            groups; NaN without a result.
    """
    error = np.full(len(group), np.nan)
    try:
        for each in np.unique(group).tolist():
            error[group == each] = error_without(each)
    except BadInputError as refused:
        return HeldOut(method, np.empty(0), np.empty(0, np.int64), str(refused))
    return HeldOut(method, error, group)


def cells(found: HeldOut, reference: HeldOut) -> list[Cell]:
    """Return the cells of `COLUMNS`: rms, its interval, median, ratio to a reference's rms and its interval."""
    if (failed := remark(found)) is not None:
        return [None, failed, None, None, None]
    groups = np.unique(np.concatenate([found.group, reference.group]))
    square, count = _sums(found, groups)
    by, by_count = _sums(reference, groups)
    drawn = np.random.default_rng(0).integers(len(groups), size=(_DRAWS, len(groups)))
    rms = np.sqrt(square[drawn].sum(axis=1) / np.maximum(count[drawn].sum(axis=1), 1.0))
    ratio = rms / np.sqrt(by[drawn].sum(axis=1) / np.maximum(by_count[drawn].sum(axis=1), 1.0))
    whole = float(np.sqrt(square.sum() / count.sum()))
    over = whole / float(np.sqrt(by.sum() / by_count.sum()))
    own = found is reference
    return [
        whole,
        _interval(rms),
        float(np.median(found.error)),
        None if own else over,
        None if own else _interval(ratio),
    ]


def remark(found: HeldOut) -> str | None:
    """Return the reason for a missing rms: the refusal, or the number of readings without a result; else None."""
    if found.refusal is not None:
        return f"refused: {found.refusal}"
    missing = ~np.isfinite(found.error)
    return f"no answer for {100.0 * np.mean(missing):.2g} % of the readings" if missing.any() else None


def rms_of(found: HeldOut) -> float:
    """Return the root mean square in arcminutes; infinite if `remark` gives a reason."""
    return float(np.sqrt(np.mean(found.error**2))) if remark(found) is None else np.inf


def _sums(found: HeldOut, groups: IntArray) -> tuple[FloatArray, FloatArray]:
    index = np.searchsorted(groups, found.group)
    return (
        np.asarray(np.bincount(index, weights=found.error**2, minlength=len(groups)), np.float64),
        np.bincount(index, minlength=len(groups)).astype(np.float64),
    )


def _interval(values: FloatArray) -> str:
    low, high = np.percentile(values, _LEVEL)
    return f"{low:.3g} to {high:.3g}"

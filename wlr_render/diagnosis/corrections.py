"""Smooth corrections of the remaining residual, each a function of one set of variables.

They tell where an effect lives. None of them is a cause: each competes by its evidence with what is random, and is
offered as a correction.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from wlr_render.captures.session import DisplayPlan, SeeThroughPlan
from wlr_render.diagnosis.cause_selection import LOG10_ODDS
from wlr_render.diagnosis.diagnosis import Correction
from wlr_render.diagnosis.fit import Fit, off_prior
from wlr_render.diagnosis.held_out import held_out_improvement
from wlr_render.diagnosis.observations import DISPLAY, PART_NAMES, RUN_TIME, SEE_THROUGH, Observations
from wlr_render.diagnosis.scatter import Scatter, best_scatter, cost, marginal, surprise
from wlr_render.diagnosis.weighed_readings import WeighedReadings
from wlr_render.diagnosis.whitening import Whitening
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray, rows_by_label
from wlr_render.numerics.polynomial import Box, basis, total_degree

Design = tuple[str, str, FloatArray]
"""What a correction is bound to, its form, and its terms for each reading of the part."""

_FOLDS = 8
_CODE_PERIOD_PX = 64  # of the finest stripes of a Gray code that are looked for
_SCREW_PERIODS_M = (0.00025, 0.0005, 0.001, 0.002)  # of the leads of micrometer screws
_SIZES = np.geomspace(0.01, 300.0, 30)  # of a correction that are tried, in units of sigma
_LESS_MOTION = (1.0, 0.3, 0.05)  # of what captures scatter by without the correction


@dataclass(frozen=True, eq=False)
class FittedCorrection:
    """A smooth correction of one part, and its columns.

    Attributes:
        correction: its record.
        size: most probable size of its coefficients, in units of sigma.
        columns: (n, 2, c) of all readings, zero in other parts.
    """

    correction: Correction
    size: float
    columns: FloatArray


def corrections(readings: WeighedReadings, found: Fit, part: int) -> list[FittedCorrection]:
    """All corrections of what a fit leaves of one part, the one of best odds first."""
    rows = readings.observations.part == part
    mine = readings.of_rows(rows)
    own = mine.observations
    if len(np.unique(own.group)) < 2:
        return []
    left, whiten = found.at.residual[rows], mine.whitening(found.scatter)
    base = cost(mine.sums(left, np.zeros((*left.shape, 0))), found.scatter, np.zeros(0))
    before = _squares(left, own.group)
    made = []
    designs = list(_designs(own, part))
    for depends_on, form, design in designs:
        columns = _columns(design)
        size, odds = _evidence(mine, left, columns, found.scatter, base)
        odds -= float(np.log10(len(designs)))  # one of so many that were tried
        after = _squares(_held_out(columns, left, whiten, own.group, size), own.group)
        gain = held_out_improvement(before, after)
        full = np.zeros((len(rows), *columns.shape[1:]))
        full[rows] = columns
        made.append(
            FittedCorrection(Correction(PART_NAMES[part], depends_on, form, design.shape[1], gain, odds), size, full)
        )
    return sorted(made, key=lambda each: -each.correction.log10_odds)


def odds_beside(readings: WeighedReadings, found: Fit, number: int, beside: FittedCorrection) -> float:
    """Log10 odds for one of a fit's causes against none where a smooth correction may explain the same.

    The correction's size is what it takes without the cause; so a cause whose effect it can take gains nothing.
    """
    rest, columns = found.owner != number, found.at.jacobian
    mean, without = -off_prior(found.explanation)[found.at.free], found.residual_without(number)
    # The cause's own values count from none.
    mean = np.where(rest, mean, mean + found.effects)

    def least(chosen: BoolArray) -> float:
        both = np.concatenate([columns[:, :, chosen], beside.columns], axis=-1)
        means = np.r_[mean[chosen], np.zeros(beside.columns.shape[-1])]
        sigma = np.r_[np.ones(int(chosen.sum())), np.full(beside.columns.shape[-1], beside.size)]
        return best_scatter(readings.sums(without, both), found.scatter, means, sigma)[1]

    return float(LOG10_ODDS * (least(rest) - least(np.ones_like(rest))))


def _columns(design: FloatArray) -> FloatArray:
    """Columns (n, 2, 2 c) of unit mean square for each axis of a design (n, c)."""
    columns = np.zeros((len(design), 2, 2 * design.shape[1]))
    for axis in (0, 1):
        columns[:, axis, axis::2] = design / np.sqrt(np.mean(design**2, axis=0)).clip(1e-12)
    return columns


def _evidence(
    readings: WeighedReadings, left: FloatArray, columns: FloatArray, scatter: Scatter, base: float
) -> tuple[float, float]:
    """Most probable size of a correction's coefficients, in sigma, and log10 of the odds for it against none."""
    sums = readings.sums(left, columns)
    best = (-np.inf, 0.0)
    for less, noise in product(_LESS_MOTION, {1.0, float(scatter.noise[sums.part_of[sums.used][0]])}):
        at = Scatter(
            np.full_like(scatter.noise, noise), less * scatter.shift_um, less * scatter.turn_urad, scatter.moved
        )
        found, unusual = marginal(sums, at), surprise(at, sums)
        values, axes = np.linalg.eigh(found.information)
        pull, values = axes.T @ found.gradient, values.clip(0.0)
        costs = []
        for size in _SIZES:
            shrunk = pull**2 * size**2 / (1.0 + size**2 * values)
            costs.append(found.minus_two_log + unusual + float(np.sum(np.log1p(size**2 * values) - shrunk)))
        # All sizes are equally likely beforehand.
        least = -2.0 * float(np.logaddexp.reduce(-0.5 * np.array(costs)) - np.log(len(_SIZES)))
        best = max(best, (LOG10_ODDS * (base - least), float(_SIZES[int(np.argmin(costs))])))
    return best[1], best[0]


def _squares(residual: FloatArray, group: IntArray) -> FloatArray:
    """Sum of squares of each capture that has readings."""
    return np.array([np.sum(residual[rows] ** 2) for rows in rows_by_label(group)[1]])


def _held_out(columns: FloatArray, left: FloatArray, whiten: Whitening, group: IntArray, size: float) -> FloatArray:
    """Residual (n, 2) after the correction, each capture by a fit to the captures of the other folds.

    Args:
        columns: (n, 2, c) of the correction.
        left: (n, 2) residual, in units of sigma.
        whiten: by which the fit weighs readings.
        group: (n,) capture of each reading.
        size: of the coefficients, which have normal priors.
    """
    after, (_, captures) = left.copy(), rows_by_label(group)
    # Captures follow each other in space and time; taking turns spreads every fold over both.
    folds = [np.concatenate(captures[number::_FOLDS]) for number in range(min(_FOLDS, len(captures)))]
    white, residual = whiten(columns), whiten(left)
    flat = [white[rows].reshape(2 * len(rows), -1) for rows in folds]
    grams = [each.T @ each for each in flat]
    moments = [each.T @ residual[rows].ravel() for each, rows in zip(flat, folds, strict=True)]
    prior = np.eye(columns.shape[2]) / max(size, 1e-3) ** 2
    for number, rows in enumerate(folds):
        gram, moment = sum(grams) - grams[number], sum(moments) - moments[number]
        after[rows] -= columns[rows] @ np.linalg.solve(gram + prior, moment)
    return after


def _designs(observations: Observations, part: int) -> Iterator[Design]:
    """All that are tried on a part."""
    plan = observations.session.plan
    makers: dict[int, Callable[[Observations], Iterator[Design]]] = {
        DISPLAY: _display_designs,
        SEE_THROUGH: _see_through_designs,
        RUN_TIME: _run_time_designs,
    }
    yield from makers[part](observations)
    timed = plan.parts[part]
    if timed is not None:
        yield "time", "smooth", _polynomial(timed.time_s[:, None], 10)
    if isinstance(timed, DisplayPlan | SeeThroughPlan):
        design = np.concatenate([_polynomial(timed.stage, 4), _screws(timed.stage)], axis=1)
        yield "stage", "smooth, and periods of screws", design


def _display_designs(observations: Observations) -> Iterator[Design]:
    plan, pixel = observations.session.plan.display, observations.session.readings.panel_pixel
    if plan is None or pixel is None:
        return
    smooth = _polynomial(pixel, 8)
    yield "panel pixels", "smooth", smooth
    phase = np.mod(pixel, _CODE_PERIOD_PX).astype(int)
    stripes = [np.eye(_CODE_PERIOD_PX)[phase[:, axis]] for axis in (0, 1)]
    yield "panel pixels", "stripes of a code", np.concatenate([_polynomial(pixel, 2), *stripes], axis=1)
    place = Box.around(plan.stage).scaled(plan.stage)
    coarse = _polynomial(pixel, 6)
    swimming = np.concatenate([smooth, *(coarse * place[:, [axis]] for axis in range(3))], axis=1)
    yield "panel pixels", "smooth, changing with the viewpoint", swimming
    yield "camera pixels", "smooth", _polynomial(plan.camera_pixel, 8)
    if len(np.unique(plan.channel)) > 1:
        affine = _polynomial(pixel, 1)
        design = np.concatenate([affine * (plan.channel == channel)[:, None] for channel in range(3)], axis=1)
        yield "colour", "a shift, scale and shear to each", design


def _see_through_designs(observations: Observations) -> Iterator[Design]:
    plan, pixel = observations.session.plan.see_through, observations.session.readings.dot_pixel
    if plan is None or pixel is None:
        return
    yield "camera pixels", "smooth", _polynomial(pixel, 8)
    pitch = observations.nominal.target.pitch[plan.target_pose][:, None]
    dots = _polynomial(plan.dot / pitch, 6)
    poses = np.unique(plan.target_pose)
    # A pose to each capture leaves nothing to hold out: then all share one function of the dot.
    shared = len(poses) > len(np.unique(plan.capture)) / 2
    each = [np.ones(len(plan), dtype=bool)] if shared else [plan.target_pose == pose for pose in poses]
    form = "smooth, the same at each pose" if shared else "smooth, of its own at each pose"
    yield "target", form, np.concatenate([dots * mine[:, None] for mine in each], axis=1)


def _run_time_designs(observations: Observations) -> Iterator[Design]:
    seen = observations.session.readings.run_time_pixel
    if seen is not None:
        yield "camera pixels", "smooth", _polynomial(seen[:, 2:], 4)


def _polynomial(variables: FloatArray, degree: int) -> FloatArray:
    return basis(variables, total_degree(variables.shape[1], degree), Box.around(variables))


def _screws(stage: FloatArray) -> FloatArray:
    """Sines and cosines of the stage's axes with the periods of common screws."""
    phases = [2 * np.pi * stage / period for period in _SCREW_PERIODS_M]
    return np.concatenate([wave(phase) for phase in phases for wave in (np.sin, np.cos)], axis=1)

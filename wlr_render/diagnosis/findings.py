"""Findings of a fit: causes with their values, detection limits, residuals, and the expected residuals."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from wlr_render.diagnosis.cause import Cause, Role
from wlr_render.diagnosis.cause_selection import CandidateRanking, Search
from wlr_render.diagnosis.diagnosis import (
    CaptureResidual,
    Correlations,
    DegenerateCause,
    DetectionLimit,
    FoundCause,
    MotionSize,
    MovedCapture,
    ParameterValue,
    RankedCandidate,
    ResidualSummary,
)
from wlr_render.diagnosis.fit import (
    Fit,
    few_captures_factor,
    fit,
    reduced_chi_squared,
    times_between_captures,
)
from wlr_render.diagnosis.observations import DISPLAY, PART_NAMES, RUN_TIME, SEE_THROUGH, CaptureName, Observations
from wlr_render.diagnosis.prediction import Explanation, Hypothesis, Predictor
from wlr_render.diagnosis.weighed_readings import WeighedReadings, camera_motions
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray
from wlr_render.numerics.scatter import LOG10_ODDS, cost
from wlr_render.numerics.scatter_search import motions_of, scatter_errors

_RANKED = 8


def found_cause(
    search: Search, found: Fit, number: int, ranking: CandidateRanking, odds_against_fields: float
) -> FoundCause:
    """Describe one cause of a fit.

    Args:
        search: the search that found it.
        found: the fit of all causes.
        number: index of the cause in the fit.
        ranking: the candidates for its place, with the other causes included.
        odds_against_fields: log10 odds for its name against fields.
    """
    hypothesis, values = found.explanation.hypotheses[number], found.explanation.values[number]
    cause = hypothesis.cause
    first = sum(len(each) for each in found.explanation.values[:number])
    sigmas = few_captures_factor(found, search.full.observations) * found.sigmas()[first : first + len(values)]
    parameters = tuple(
        ParameterValue(each.name, float(value), float(sigma), each.unit, each.prior_sigma, each.prior_mean)
        for each, value, sigma in zip(cause.parameters, values, sigmas, strict=True)
    )
    change = search.full.predictor.residual(found.explanation.without(number)) - found.at.residual
    return FoundCause(
        cause.name,
        cause.title,
        cause.part,
        hypothesis.variant,
        parameters,
        search.improvement(ranking.current, found),
        _degenerate(ranking, cause.name, search.settings.degenerate_share),
        _ranked(ranking),
        float(np.sqrt(np.nanmean(change**2))),
        LOG10_ODDS * (ranking.current.minus_two_log_evidence - found.minus_two_log_evidence),
        odds_against_fields,
        cause.remedy,
    )


def _degenerate(ranking: CandidateRanking, name: str, least_share: float) -> tuple[DegenerateCause, ...]:
    """Return the causes with nearly the same first-order gain in evidence as the named cause."""
    best = {each.hypothesis.cause.name: each for each in sorted(ranking.screened, key=lambda each: each.gain)}
    most = best[name].gain if name in best else 0.0
    return tuple(
        DegenerateCause(other, min(1.0, float(each.gain / most)), each.hypothesis.cause.separated_by)
        for other, each in sorted(best.items(), key=lambda item: -item[1].gain)
        if other != name and most > 0.0 and each.gain > most * least_share
    )


def _ranked(ranking: CandidateRanking) -> tuple[RankedCandidate, ...]:
    """Return the fitted candidates, then the others by their first-order gain."""
    ranked: dict[str, RankedCandidate] = {}
    for fits in (ranking.fits, ranking.rough):
        for each in fits:
            last, behind = each.explanation.hypotheses[-1], each.minus_two_log_evidence - fits[0].minus_two_log_evidence
            found = RankedCandidate(last.cause.name, last.variant, reduced_chi_squared(each), LOG10_ODDS * behind)
            ranked.setdefault(found.name, found)
    for screened in ranking.screened:
        name, variant = screened.hypothesis.cause.name, screened.hypothesis.variant
        ranked.setdefault(name, RankedCandidate(name, f"{variant}; to first order", np.nan, np.nan))
    return tuple(ranked.values())[:_RANKED]


def correlations(found: Fit) -> Correlations:
    """Return the correlations between the free values of a fit."""
    hypotheses = found.explanation.hypotheses
    names = [f"{each.cause.name}.{parameter.name}" for each in hypotheses for parameter in each.cause.parameters]
    sigma = np.sqrt(np.diag(found.covariance))
    matrix = found.covariance / sigma / sigma[:, None]
    condition = float(np.linalg.cond(matrix)) if found.at.free.size else 1.0
    rows = tuple(tuple(row) for row in matrix.tolist())
    return Correlations(tuple(names[free] for free in found.at.free), rows, condition)


def detection_limits(search: Search, found: Fit, causes: Mapping[str, Cause]) -> tuple[DetectionLimit, ...]:
    """Return the detection limit of every parameter that the session can show, each cause acting alone.

    The limits of a cause that starts at some time assume the middle of the session.

    Args:
        search: search with a subsample that represents all readings.
        found: the fit without causes.
        causes: causes to consider.
    """
    limits = []
    # A reading of the subsample represents several readings; a capture only itself.
    share = len(search.full.observations) / len(search.subsample.observations)
    scatter = replace(found.scatter, noise=found.scatter.noise / np.sqrt(share))
    times = times_between_captures(search.full.observations.session.plan)
    middle = float(times[len(times) // 2]) if len(times) else 0.0
    for cause in causes.values():
        hypothesis = Hypothesis(cause, next(iter(cause.variants)))
        is_time = [parameter.role is Role.TIME for parameter in cause.parameters]
        if any(is_time) and len(times) == 0:
            continue
        values = np.where(is_time, middle, cause.null())
        start = Explanation().plus(hypothesis, values)
        alone = fit(search.subsample, start, scatter, 0, vary_scatter=False)
        if alone is None:
            continue
        # Remove the prior: a limit depends on the readings alone.
        information = alone.information - np.eye(alone.at.free.size)
        sigma = np.sqrt(np.diag(np.linalg.pinv(information, hermitian=True)).clip(0.0))
        moment = f" (from {middle:.0f} s on)" if any(is_time) else ""
        for number, each in zip(alone.at.free, sigma, strict=True):
            parameter = cause.parameters[number]
            limit = search.settings.detection_limit_se * float(each) * parameter.prior_sigma
            if limit > 0.0:
                limits.append(DetectionLimit(cause.name, f"{parameter.name}{moment}", parameter.unit, limit))
    return tuple(limits)


def rms_of_captures(observations: Observations, residual: FloatArray, rows: BoolArray) -> tuple[IntArray, FloatArray]:
    """Return each capture's number of readings in a mask (n,), and their rms residual (captures,)."""
    group, count = observations.group[rows], len(observations.captures)
    readings = np.bincount(group, minlength=count)
    squares = np.bincount(group, np.mean(residual[rows] ** 2, axis=1), count)
    return readings, np.sqrt(squares / readings.clip(1))


def capture_residuals(
    observations: Observations,
    before: FloatArray,
    after: FloatArray,
    good: BoolArray,
    excluded: Iterable[MovedCapture],
) -> tuple[CaptureResidual, ...]:
    """Return the residual of each capture over its readings that are not outliers."""
    good = good & np.isfinite(before).all(axis=1) & np.isfinite(after).all(axis=1)
    (readings, old), (_, new) = (rms_of_captures(observations, each, good) for each in (before, after))
    names = {each.capture for each in excluded}
    return tuple(
        CaptureResidual(str(name), int(readings[n]), float(old[n]), float(new[n]), name in names)
        for n, name in enumerate(observations.captures)
        if readings[n]
    )


def residual_summary(observations: Observations, residual: FloatArray, used: BoolArray) -> ResidualSummary:
    """Return the rms per axis of a residual in units of sigma, over the used readings.

    Args:
        observations: the readings.
        residual: (n, 2) residual, or (n, 2, q) for q independent parts; their squares add.
        used: (n,) mask of the readings to use.
    """
    parts = residual.reshape(len(observations), 2, -1)
    used = used & np.isfinite(parts).all(axis=(1, 2))

    def rms(part: int) -> float | None:
        rows = used[observations.part == part]
        values = [observations.in_unit_of(part, each)[rows] for each in np.moveaxis(parts, 2, 0)]
        return float(np.sqrt(np.mean(np.sum(np.square(values), axis=0)))) if rows.any() else None

    over_noise = float(np.sqrt(np.mean(np.sum(parts[used] ** 2, axis=2))))
    return ResidualSummary(rms(DISPLAY), rms(SEE_THROUGH), rms(RUN_TIME), over_noise)


def usual_motion(readings: Predictor, found: Fit) -> FloatArray:
    """Return the change of readings (n, 2, 6), in units of sigma, by a camera motion of the usual size."""
    observations, scatter = readings.observations, found.scatter
    usual = replace(scatter.at_rest(), noise=np.ones_like(scatter.noise))
    return camera_motions(readings) * usual.sizes(observations.part_of_capture)[observations.group][:, None, :]


def motion_sizes(readings: WeighedReadings, found: Fit) -> tuple[MotionSize, ...]:
    """Return the repeatability of each part, with standard errors from the curvature of the evidence."""
    sums = readings.sums_at(found.at)
    errors = scatter_errors(sums, found.scatter)
    return tuple(
        MotionSize(
            PART_NAMES[part],
            float(found.scatter.shift_um[part]),
            float(errors[1, part] * found.scatter.shift_um[part]),
            float(found.scatter.turn_urad[part]),
            float(errors[2, part] * found.scatter.turn_urad[part]),
        )
        for part in np.unique(readings.observations.part)
        if part != RUN_TIME and np.sum(sums.used & (sums.part_of == part)) > 1
    )


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
    """Return a mask (n,) of the readings whose captures are not excluded."""
    names = {each.capture for each in excluded}
    bad = [number for number, name in enumerate(observations.captures) if name in names]
    return ~np.isin(observations.group, bad)

"""Diagnose a session with its nominal bench.

Noise, outlier readings, selection of causes, captures that moved, comparison of the candidates for each place, and what
stays unexplained; in that order. Generic over causes: nothing here knows any of them.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from wlr_render.captures.session import Session
from wlr_render.diagnosis.cause import Cause
from wlr_render.diagnosis.causes import CAUSES
from wlr_render.diagnosis.corrections import corrections
from wlr_render.diagnosis.diagnosis import (
    EXPLAINED,
    NO_EFFECT,
    PARTLY,
    UNEXPLAINED,
    CaptureResidual,
    Correlations,
    DegenerateCause,
    DetectionLimit,
    Diagnosis,
    FoundCause,
    ParameterValue,
    RankedCandidate,
    ResidualSummary,
    Unexplained,
)
from wlr_render.diagnosis.fit import (
    Fit,
    correlation_condition,
    correlation_matrix,
    fit,
    instability,
    minus_two_log_evidence,
    reduced_chi_squared,
)
from wlr_render.diagnosis.noise import NoiseFloor, excess_over_noise, noise_floors, outlier_readings, sigma_of
from wlr_render.diagnosis.observations import DISPLAY, PART_NAMES, RUN_TIME, SEE_THROUGH, Observations
from wlr_render.diagnosis.outliers import MovedCapture, moved_captures, not_excluded
from wlr_render.diagnosis.prediction import Explanation, Hypothesis, Predictor
from wlr_render.diagnosis.search import CandidateRanking, Progress, Search, Selection, hypotheses
from wlr_render.diagnosis.settings import DEFAULT, Settings
from wlr_render.geometry.directions import ARCMIN
from wlr_render.numerics.arrays import BoolArray, FloatArray
from wlr_render.simulation.bench import Bench

_RANKED = 8
_LOG10_ODDS = 0.5 / np.log(10.0)  # for each unit of -2 log evidence
_CONTESTS = 3  # times that another candidate may take a place before the comparison ends
_UNPREDICTED = {DISPLAY: "stage", SEE_THROUGH: "stage", RUN_TIME: "time"}


def diagnose(
    nominal: Bench,
    session: Session,
    progress: Progress = lambda _: None,
    causes: Mapping[str, Cause] = CAUSES,
    settings: Settings = DEFAULT,
) -> Diagnosis:
    """Say whether a bench predicts a session down to the noise, and if not, why.

    Args:
        nominal: the bench as its makers believe it to be.
        session: what was measured.
        progress: called with a sentence at each step.
        causes: the candidates.
        settings: thresholds and limits.

    Raises:
        BadInputError: the bench predicts no reading at all.
    """
    progress("predicting the session with the nominal bench")
    prepared = _prepared(Predictor.of_session(nominal, session), causes, settings, progress)
    search, selection = prepared.search, prepared.selection
    observations, used = search.full.observations, search.used
    found, rankings = _compared(search, selection.fit, selection.first)
    progress("looking for structure in the residual")
    left = _unexplained(observations, found, used, settings)
    dropped: list[str] = []
    while left is not None and (spurious := _spurious(search, found)) is not None:
        number, sentence = spurious
        dropped.append(sentence)
        found = fit(search.full, found.explanation.without(number), used)
        rankings = _rankings(search, found, selection.first)
        left = _unexplained(observations, found, used, settings)
    named = tuple(_found_cause(search, found, number, ranking) for number, ranking in enumerate(rankings))
    before, after = (search.full.residual(each) for each in (Explanation(), found.explanation))
    limits: tuple[DetectionLimit, ...] = ()
    if not named and left is None:
        limits = detection_limits(search.subsample, search.subsample_used, used, causes, settings)
    return Diagnosis(
        session=session.name,
        device=nominal.device.name,
        eye=nominal.eye,
        verdict=_verdict(bool(named), left),
        causes=tuple(sorted(named, key=lambda cause: -cause.effect_over_noise)),
        excluded=tuple(prepared.excluded),
        noise_floors=prepared.floors,
        noise=_noise_summary(observations, used),
        before=_residual_summary(observations, before, used),
        after=_residual_summary(observations, after, used),
        unexplained=left,
        detection_limits=limits,
        reasons=(*_about_readings(prepared.good), *dropped, selection.reason),
        captures=_capture_residuals(observations, before, after, prepared.good, prepared.excluded),
        correlations=_correlations(found),
        observations=observations,
        residual_before=before,
        residual_after=after,
        used=used,
        corrected=found.explanation.bench(nominal),
    )


@dataclass(frozen=True, eq=False)
class _Prepared:
    """A selection, with the noise and the outliers by which it was made; `good` (n,) are no outlier readings."""

    floors: tuple[NoiseFloor, ...]
    good: BoolArray
    search: Search
    selection: Selection
    excluded: list[MovedCapture]


def _prepared(as_stated: Predictor, causes: Mapping[str, Cause], settings: Settings, progress: Progress) -> _Prepared:
    """Measure the noise and select causes; again, where the residual by these causes shows another noise."""
    first = _with_noise_left_by(Explanation(), as_stated, causes, settings, progress)
    explanation, stated = first.selection.fit.explanation, as_stated.observations.sigma_px
    sigma = sigma_of(noise_floors(as_stated.observations, as_stated.residual(explanation), settings), stated)
    if np.allclose(sigma, first.search.full.observations.sigma_px, rtol=settings.same_noise):
        return first
    progress("the noise is smaller than it seemed: again")
    return _with_noise_left_by(explanation, as_stated, causes, settings, progress)


def _with_noise_left_by(
    explanation: Explanation, as_stated: Predictor, causes: Mapping[str, Cause], settings: Settings, progress: Progress
) -> _Prepared:
    """Select causes by the noise that an explanation leaves within the photographs.

    Captures that then stand out are excluded, and causes are selected again without them.
    """
    observations, residual = as_stated.observations, as_stated.residual(explanation)
    floors = noise_floors(observations, residual, settings)
    sigma = sigma_of(floors, observations.sigma_px)
    in_sigma = residual * (observations.sigma_px / sigma)[observations.part][:, None]
    good = ~outlier_readings(observations, in_sigma, settings)
    spread, full = observations.spread(settings.subsample), as_stated.with_sigma(sigma)
    subsample, candidates = full.of_rows(spread), hypotheses(causes)
    excluded: list[MovedCapture] = []
    for _ in range(settings.outlier_rounds):
        used = good & not_excluded(full, excluded)
        search = Search(full, subsample, used, used[spread], candidates, progress, settings)
        selection = search.select()
        progress("looking for captures that moved")
        more = moved_captures(full, selection.fit, good, settings)
        if {each.capture for each in more} <= {each.capture for each in excluded}:
            break
        excluded = more
    return _Prepared(floors, good, search, selection, excluded)


def _about_readings(good: BoolArray) -> tuple[str, ...]:
    """A sentence on the single readings that are outliers, if there are any."""
    count = int(np.sum(~good))
    return (f"{count} single readings lie far from their neighbours and were excluded",) if count else ()


def _spurious(search: Search, found: Fit) -> tuple[int, str] | None:
    """The cause whose value depends most on where it is measured, and a sentence on it; None where all are stable."""
    if not found.explanation.hypotheses:
        return None
    change = instability(search.full.observations, found)
    worst = int(np.argmax(change))
    if change[worst] < search.settings.max_instability:
        return None
    return worst, (
        f"{found.explanation.names[worst]} would explain part of it, but its value differs by "
        f"{100 * change[worst]:.0f} % between halves of the readings: a spurious match"
    )


def _compared(search: Search, found: Fit, first: CandidateRanking) -> tuple[Fit, list[CandidateRanking]]:
    """Give each place to the cause of highest evidence, the others being as they are; and the candidates for each."""
    for _ in range(_CONTESTS):
        rankings = _rankings(search, found, first)
        others = [
            candidate.fit
            for name, ranking in zip(found.explanation.names, rankings, strict=True)
            for candidate in ranking.candidates[:1]
            if candidate.fitted_to_all and candidate.hypothesis.cause.name != name
        ]
        best = min(others, key=lambda each: minus_two_log_evidence(each, search.settings), default=found)
        if minus_two_log_evidence(best, search.settings) >= minus_two_log_evidence(found, search.settings):
            break
        found = best
    return found, rankings


def _rankings(search: Search, found: Fit, first: CandidateRanking) -> list[CandidateRanking]:
    """For each cause, the candidates for its place, the others being as they are."""
    if len(found.explanation.hypotheses) == 1:
        return [first]
    rests = [found.explanation.without(number) for number in range(len(found.explanation.hypotheses))]
    return [search.rank(fit(search.full, rest, search.used)) for rest in rests]


def _unexplained(observations: Observations, found: Fit, used: BoolArray, settings: Settings) -> Unexplained | None:
    """The part of the session with the largest residual, if that is more than noise or has structure."""
    left: list[Unexplained] = []
    for part, excess in excess_over_noise(observations, found.residual, used, settings).items():
        tried = corrections(observations, found.residual, used, part)
        structured = bool(tried) and (
            tried[0].improvement.percent > settings.min_structure_percent
            and tried[0].improvement.significance > settings.min_structure_se
        )
        if structured or excess.is_significant:
            # A residual that nothing smooth predicts from one capture to the next depends on where the camera stood.
            depends_on = tried[0].depends_on if structured else _UNPREDICTED[part]
            rms = float(np.sqrt(excess.mean_square))
            left.append(Unexplained(PART_NAMES[part], depends_on, rms, tuple(tried)))
    return max(left, key=lambda each: each.rms_over_noise, default=None)


def _verdict(has_causes: bool, left: Unexplained | None) -> str:
    if left is None:
        return EXPLAINED if has_causes else NO_EFFECT
    return PARTLY if has_causes else UNEXPLAINED


def _found_cause(search: Search, found: Fit, number: int, ranking: CandidateRanking) -> FoundCause:
    """Describe one cause of a fit.

    Args:
        search: what it was found with.
        found: the fit of all causes.
        number: which of them.
        ranking: the candidates for its place, the others being at work.
    """
    hypothesis = found.explanation.hypotheses[number]
    cause = hypothesis.cause
    first = sum(len(values) for values in found.explanation.values[:number])
    # Where more than noise is left, it widens the error bars.
    widened = np.sqrt(max(1.0, reduced_chi_squared(found)))
    sigmas = widened * found.sigmas()[first : first + len(cause.parameters)]
    parameters = tuple(
        ParameterValue(parameter.name, float(value), float(sigma), parameter.unit, parameter.prior_sigma)
        for parameter, value, sigma in zip(cause.parameters, found.explanation.values[number], sigmas, strict=True)
    )
    without = search.full.residual(found.explanation.without(number))
    change = (without - found.residual)[found.used]
    return FoundCause(
        cause.name,
        cause.title,
        cause.part,
        hypothesis.variant,
        parameters,
        search.improvement(ranking.current, found),
        _degenerate(ranking, cause.name, search.settings.degenerate_cosine),
        _ranked(ranking),
        float(np.sqrt(np.nanmean(change**2))),
        cause.remedy,
    )


def _degenerate(ranking: CandidateRanking, name: str, least_cosine: float) -> tuple[DegenerateCause, ...]:
    """Causes whose best match of the effect is at a small angle to it.

    To first order a hypothesis at the angle a to the effect gains cos^2 a of what the effect's own cause gains.
    """
    gains: dict[str, float] = {}
    separating: dict[str, str] = {}
    for each in ranking.screened:
        cause = each.hypothesis.cause
        gains[cause.name] = max(gains.get(cause.name, 0.0), each.gain)
        separating[cause.name] = cause.separated_by
    own = gains.get(name, 0.0)
    degenerate = [
        DegenerateCause(other, min(1.0, float(np.sqrt(gain / own))), separating[other])
        for other, gain in gains.items()
        if other != name and own > 0 and gain / own > least_cosine**2
    ]
    return tuple(sorted(degenerate, key=lambda each: -each.cosine))


def _ranked(ranking: CandidateRanking) -> tuple[RankedCandidate, ...]:
    """Those that were fitted, then the best of the others by their gain to first order."""
    ranked = [
        RankedCandidate(
            each.hypothesis.cause.name, each.hypothesis.variant, each.reduced_chi_squared, _LOG10_ODDS * each.behind
        )
        for each in ranking.candidates
    ]
    named = {each.name for each in ranked}
    values = 2 * int(ranking.subsample.used.sum())
    for screened in ranking.screened:
        name = screened.hypothesis.cause.name
        if name not in named:
            named.add(name)
            left = max(0.0, ranking.subsample.chi_squared - screened.gain) / values
            ranked.append(RankedCandidate(name, f"{screened.hypothesis.variant}; to first order", left, np.nan))
    return tuple(ranked[:_RANKED])


def _correlations(found: Fit) -> Correlations:
    """Correlations between the free values of a fit."""
    hypotheses = found.explanation.hypotheses
    names = [f"{each.cause.name}.{parameter.name}" for each in hypotheses for parameter in each.cause.parameters]
    matrix = tuple(tuple(float(value) for value in row) for row in correlation_matrix(found))
    return Correlations(tuple(names[free] for free in found.at.free), matrix, correlation_condition(found))


def detection_limits(
    subsample: Predictor,
    subsample_used: BoolArray,
    used: BoolArray,
    causes: Mapping[str, Cause],
    settings: Settings = DEFAULT,
) -> tuple[DetectionLimit, ...]:
    """Five standard errors of every parameter, each cause alone; those that a session says nothing of are left out.

    Args:
        subsample: predictor of some of the readings, which stand for all of them.
        subsample_used, used: which readings count, of those and of all.
        causes: to be considered.
        settings: thresholds.
    """
    found = []
    fewer = float(np.sqrt(subsample_used.sum() / used.sum()))
    for cause in causes.values():
        hypothesis = Hypothesis(cause, next(iter(cause.variants)))
        start = np.array([0.0 if not np.isfinite(value) else value for value in cause.null()])
        alone = fit(subsample, Explanation().plus(hypothesis, start), subsample_used, 0)
        for parameter, sigma in zip(cause.parameters, alone.sigmas(), strict=True):
            if sigma > 0.0:
                limit = settings.detection_limit_se * fewer * float(sigma)
                found.append(DetectionLimit(cause.name, parameter.name, parameter.unit, limit))
    return tuple(found)


def _capture_residuals(
    observations: Observations,
    before: FloatArray,
    after: FloatArray,
    good: BoolArray,
    excluded: Iterable[MovedCapture],
) -> tuple[CaptureResidual, ...]:
    """Residual of each capture over its readings that are no outliers by themselves."""
    good = good & np.isfinite(before).all(axis=1) & np.isfinite(after).all(axis=1)
    group, count = observations.group[good], len(observations.captures)
    readings = np.bincount(group, minlength=count)
    rms = [
        np.sqrt(np.bincount(group, np.mean(each[good] ** 2, axis=1), count) / readings.clip(1))
        for each in (before, after)
    ]
    names = {each.capture for each in excluded}
    return tuple(
        CaptureResidual(str(name), int(readings[n]), float(rms[0][n]), float(rms[1][n]), name in names)
        for n, name in enumerate(observations.captures)
        if readings[n]
    )


def _residual_summary(observations: Observations, residual: FloatArray, used: BoolArray) -> ResidualSummary:
    """Root mean squares per axis of a residual (n, 2) in units of sigma, over the readings that count."""
    used = used & np.isfinite(residual).all(axis=1)
    return ResidualSummary(
        _rms(observations.panel_pixels(residual)[used[observations.part == DISPLAY]]),
        _rms(observations.arcminutes(residual, SEE_THROUGH)[used[observations.part == SEE_THROUGH]]),
        _rms(observations.arcminutes(residual, RUN_TIME)[used[observations.part == RUN_TIME]]),
        float(np.sqrt(np.mean(residual[used] ** 2))),
    )


def _noise_summary(observations: Observations, used: BoolArray) -> ResidualSummary:
    """The same for noise alone."""
    camera_px = observations.panel_from_camera[used[observations.part == DISPLAY]] * observations.sigma_px[DISPLAY]
    arcmin = 1.0 / (np.mean(observations.nominal.camera.focal_px) * ARCMIN)
    present = [np.any(observations.part == part) for part in range(3)]
    return ResidualSummary(
        float(np.sqrt(np.mean(np.sum(camera_px**2, axis=(1, 2))) / 2)) if present[DISPLAY] else None,
        float(observations.sigma_px[SEE_THROUGH] * arcmin) if present[SEE_THROUGH] else None,
        float(observations.sigma_px[RUN_TIME] * arcmin) if present[RUN_TIME] else None,
        1.0,
    )


def _rms(values: FloatArray) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if len(values) else None

"""What a record states about fits: causes with their evidence, residuals in usual units, detection limits."""

from collections.abc import Iterable, Mapping

import numpy as np

from wlr_render.diagnosis import evidence
from wlr_render.diagnosis.cause import Cause
from wlr_render.diagnosis.diagnosis import (
    CaptureResidual,
    Correlations,
    DegenerateCause,
    DetectionLimit,
    FoundCause,
    ParameterValue,
    RankedCandidate,
    ResidualSummary,
)
from wlr_render.diagnosis.fit import Fit, fit
from wlr_render.diagnosis.observations import DISPLAY, RUN_TIME, SEE_THROUGH, Observations
from wlr_render.diagnosis.outliers import MovedCapture
from wlr_render.diagnosis.prediction import Explanation, Hypothesis, Predictor
from wlr_render.diagnosis.search import CandidateRanking, Search
from wlr_render.diagnosis.settings import DEFAULT, Settings
from wlr_render.geometry.directions import ARCMIN
from wlr_render.numerics.arrays import BoolArray, FloatArray

_RANKED = 8
_LOG10_ODDS = 0.5 / np.log(10.0)  # for each unit of -2 log evidence


def found_cause(search: Search, found: Fit, number: int, ranking: CandidateRanking) -> FoundCause:
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
    widened = np.sqrt(max(1.0, evidence.reduced_chi_squared(found)))
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


def correlations(found: Fit) -> Correlations:
    """Correlations between the free values of a fit."""
    hypotheses = found.explanation.hypotheses
    names = [f"{each.cause.name}.{parameter.name}" for each in hypotheses for parameter in each.cause.parameters]
    matrix = tuple(tuple(float(value) for value in row) for row in evidence.correlations(found))
    return Correlations(tuple(names[free] for free in found.at.free), matrix, evidence.correlation_condition(found))


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


def capture_residuals(
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


def residual_summary(observations: Observations, residual: FloatArray, used: BoolArray) -> ResidualSummary:
    """Root mean squares per axis of a residual (n, 2) in units of sigma, over the readings that count."""
    used = used & np.isfinite(residual).all(axis=1)
    return ResidualSummary(
        _rms(panel_pixels(observations, residual)[used[observations.part == DISPLAY]]),
        _rms(arcminutes(observations, residual, SEE_THROUGH)[used[observations.part == SEE_THROUGH]]),
        _rms(arcminutes(observations, residual, RUN_TIME)[used[observations.part == RUN_TIME]]),
        float(np.sqrt(np.mean(residual[used] ** 2))),
    )


def noise_summary(observations: Observations, used: BoolArray) -> ResidualSummary:
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


def panel_pixels(observations: Observations, residual: FloatArray) -> FloatArray:
    """Residual of the display readings in panel pixels, (n_display, 2)."""
    own = residual[observations.part == DISPLAY] * observations.sigma_px[DISPLAY]
    return np.asarray((observations.panel_from_camera @ own[:, :, None])[:, :, 0])


def arcminutes(observations: Observations, residual: FloatArray, part: int) -> FloatArray:
    """Residual of a part's readings in arcminutes at the middle of the camera's image, (n_part, 2)."""
    own = residual[observations.part == part] * observations.sigma_px[part]
    return np.asarray(own / (observations.nominal.camera.focal_px * ARCMIN))


def _rms(values: FloatArray) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if len(values) else None

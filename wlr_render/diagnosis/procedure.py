"""Diagnose a session with its nominal bench.

Noise, outlier readings, selection of causes, captures that moved, comparison of the candidates for each place, and what
stays unexplained; in that order. Generic over causes: nothing here knows any of them.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from wlr_render.captures.session import Session
from wlr_render.diagnosis.cause import Cause, Role
from wlr_render.diagnosis.causes import CAUSES
from wlr_render.diagnosis.corrections import corrections, odds_beside
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
    MotionSize,
    ParameterValue,
    RankedCandidate,
    ResidualSummary,
    Unexplained,
)
from wlr_render.diagnosis.fit import (
    Fit,
    correlation_condition,
    correlation_matrix,
    few_captures_factor,
    fit,
    off_prior,
    times_between_captures,
)
from wlr_render.diagnosis.noise import Noise, NoiseFloor, noise_of
from wlr_render.diagnosis.observations import DISPLAY, PART_NAMES, RUN_TIME, SEE_THROUGH, Observations
from wlr_render.diagnosis.outliers import MovedCapture, moved_captures, not_excluded
from wlr_render.diagnosis.prediction import Explanation, Hypothesis, Predictor
from wlr_render.diagnosis.scatter import UNUSUAL_SHIFT, UNUSUAL_TURN, scatter_errors
from wlr_render.diagnosis.search import (
    LOG10_ODDS,
    CandidateRanking,
    Progress,
    Search,
    Selection,
    hypotheses,
)
from wlr_render.diagnosis.settings import DEFAULT, Settings
from wlr_render.diagnosis.stability import instability
from wlr_render.diagnosis.weighed_readings import WeighedReadings, camera_motions
from wlr_render.geometry.directions import ARCMIN
from wlr_render.numerics.arrays import BoolArray, FloatArray
from wlr_render.simulation.bench import Bench

_RANKED = 8
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
    stated = Predictor.of_session(nominal, session)
    prepared = _prepared(stated, causes, settings, progress)
    search, selection = prepared.search, prepared.selection
    readings = search.full
    found, rankings = _compared(search, selection.fit, selection.first)
    progress("looking for structure in the residual")
    left = _unexplained(search, found, prepared.noise, settings)
    dropped: list[str] = []
    if left and found.explanation.hypotheses:
        found, dropped = _without_spurious_matches(search, found, left)
        rankings = _rankings(search, found, selection.first)
        left = _unexplained(search, found, prepared.noise, settings)
    named = tuple(_found_cause(search, found, number, ranking) for number, ranking in enumerate(rankings))
    excluded, too_many = _excluded(readings, found, settings)
    all_readings = stated.with_sigma(prepared.noise.sigma_px)
    observations = all_readings.observations
    before, after = (all_readings.residual(each) for each in (Explanation(), found.explanation))
    used = ~prepared.noise.outlier & not_excluded(observations, excluded)
    motion = _usual_motion(all_readings, found)
    limits: tuple[DetectionLimit, ...] = ()
    if not named and not left and not too_many:
        limits = detection_limits(search, found, causes)
    return Diagnosis(
        session=session.name,
        device=nominal.device.name,
        eye=nominal.eye,
        verdict=_verdict(bool(named), bool(left) or bool(too_many)),
        causes=tuple(sorted(named, key=lambda cause: -cause.effect_over_noise)),
        excluded=excluded,
        too_many_moved=too_many,
        noise_floors=prepared.noise.floors,
        motions=_motion_sizes(readings, found),
        noise=_noise_summary(observations, used),
        expected=_expected_summary(observations, motion, used),
        before=_residual_summary(observations, before, used),
        after=_residual_summary(observations, after, used),
        unexplained=max(left, key=lambda each: each.rms_over_noise, default=None),
        detection_limits=limits,
        reasons=(*_about_readings(prepared.noise.outlier), *dropped, selection.reason),
        captures=_capture_residuals(observations, before, after, ~prepared.noise.outlier, excluded),
        correlations=_correlations(found),
        observations=observations,
        residual_before=before,
        residual_after=after,
        usual_motion=motion,
        used=used,
        corrected=found.explanation.bench(nominal),
        readings=readings,
        fit=found,
    )


@dataclass(frozen=True, eq=False)
class _Prepared:
    """A selection, and the noise by which it was made."""

    noise: Noise
    search: Search
    selection: Selection


def _prepared(as_stated: Predictor, causes: Mapping[str, Cause], settings: Settings, progress: Progress) -> _Prepared:
    """Measure the noise and select causes; again, where the residual by these causes shows another noise."""
    first = _with_noise_left_by(Explanation(), as_stated, causes, settings, progress)
    if not first.selection.fit.explanation.hypotheses:
        return first
    explanation = first.selection.fit.explanation
    noise = noise_of(as_stated.observations, as_stated.residual(explanation), settings)
    now, before = ([floor.shared for floor in each.floors] for each in (noise, first.noise))
    same = np.allclose(noise.sigma_px, first.noise.sigma_px, rtol=settings.same_noise)
    same = same and np.allclose(now, before, atol=settings.same_noise)
    if same and np.array_equal(noise.outlier, first.noise.outlier):
        return first
    progress("the noise differs from the first estimate: again")
    return _with_noise_left_by(explanation, as_stated, causes, settings, progress)


def _with_noise_left_by(
    explanation: Explanation, as_stated: Predictor, causes: Mapping[str, Cause], settings: Settings, progress: Progress
) -> _Prepared:
    """Select causes by the noise that an explanation leaves within the photographs."""
    noise = noise_of(as_stated.observations, as_stated.residual(explanation), settings)
    full = WeighedReadings.of(as_stated.with_sigma(noise.sigma_px).of_rows(~noise.outlier), noise)
    subsample = full.of_rows(full.observations.spread(settings.subsample))
    search = Search(full, subsample, hypotheses(causes), progress, settings)
    return _Prepared(noise, search, search.select())


def _about_readings(outlier: BoolArray) -> tuple[str, ...]:
    """A sentence on the single readings that are outliers, if there are any."""
    count = int(np.sum(outlier))
    return (f"{count} single readings lie far from their neighbours and were excluded",) if count else ()


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
        best = min(others, key=lambda each: each.minus_two_log_evidence, default=found)
        if best.minus_two_log_evidence >= found.minus_two_log_evidence:
            return found, rankings
        found = best
    return found, _rankings(search, found, first)


def _rankings(search: Search, found: Fit, first: CandidateRanking) -> list[CandidateRanking]:
    """For each cause, the candidates for its place, the others being as they are."""
    if len(found.explanation.hypotheses) == 1:
        return [first]
    rests = [found.explanation.without(number) for number in range(len(found.explanation.hypotheses))]
    return [search.rank(search.refitted(rest, found.scatter)) for rest in rests]


def _unexplained(search: Search, found: Fit, noise: Noise, settings: Settings) -> list[Unexplained]:
    """The parts of the session whose residual is more than noise, or has structure."""
    left: list[Unexplained] = []
    observations, raw, scatter = search.full.observations, found.at.residual, found.scatter
    thinned = fit(search.subsample, found.explanation, scatter, 0)
    for part in np.unique(observations.part):
        tried = [each.correction for each in corrections(search.subsample, thinned, part)] if thinned else []
        structured = bool(tried) and tried[0].log10_odds > settings.least_log10_odds
        floor = noise.floor(part)
        error = _variance_error(observations, int(part), floor, settings)
        excess = float(scatter.noise[part] ** 2 - 1.0)
        moves = max(scatter.shift_um[part] / UNUSUAL_SHIFT, scatter.turn_urad[part] / UNUSUAL_TURN)
        if structured or excess > max(settings.significant_se * error, settings.material_excess) or moves > 1.0:
            # A residual that nothing smooth predicts from one capture to the next depends on where the camera stood.
            depends_on = tried[0].depends_on if structured else _UNPREDICTED[part]
            rms = float(np.sqrt(np.mean(raw[observations.part == part] ** 2)))
            left.append(Unexplained(PART_NAMES[part], depends_on, rms, tuple(tried)))
    return left


def _variance_error(observations: Observations, part: int, floor: NoiseFloor, settings: Settings) -> float:
    """Relative standard error of the noise's variance in a part.

    Where photographs have too few readings to tell what neighbours share, it may be anything; at run time it is as
    stated.
    """
    rows = observations.part == part
    few = float(np.sqrt(1.0 / np.sum(rows)))
    if part == RUN_TIME:
        return few
    readings = np.sum(rows) / len(np.unique(observations.photograph[rows]))
    known = floor.error_px > 0 and readings >= settings.fewest_readings
    return float(np.hypot(few, 2.0 * floor.error_px / floor.measured_px)) if known else np.inf


def _without_spurious_matches(search: Search, found: Fit, left: Sequence[Unexplained]) -> tuple[Fit, list[str]]:
    """Leave out the causes that only resemble what no cause explains; and a sentence on each.

    What explains the parts that are explained, by themselves, stays. Of the other causes each must explain more than
    smooth functions of what the residual depends on, and must have the same value in all halves of the readings.
    """
    parts = [PART_NAMES.index(each.part) for each in left]
    clean = ~np.isin(search.full.observations.part, parts)
    kept: set[str] = set()
    if clean.any():
        of_subsample = ~np.isin(search.subsample.observations.part, parts)
        full, subsample = search.full.of_rows(clean), search.subsample.of_rows(of_subsample)
        alone = Search(full, subsample, search.hypotheses, search.progress, search.settings).select().fit
        kept = set(alone.explanation.names)
        if not kept <= set(found.explanation.names):
            joined = found.explanation
            for hypothesis, values in zip(alone.explanation.hypotheses, alone.explanation.values, strict=True):
                if hypothesis.cause.name not in joined.names:
                    joined = joined.plus(hypothesis, values)
            found = search.pruned(search.refitted(joined, found.scatter))
    dropped = []
    while (spurious := _spurious(search, found, kept, parts)) is not None:
        number, sentence = spurious
        dropped.append(sentence)
        found = search.refitted(found.explanation.without(number), found.scatter)
    return found, dropped


def _spurious(search: Search, found: Fit, kept: set[str], parts: Sequence[int]) -> tuple[int, str] | None:
    """A cause that is a spurious match, and a sentence on it; None where all hold."""
    names, settings = found.explanation.names, search.settings
    if set(names) <= kept:
        return None
    change = instability(search.full.observations, found)
    worst = max((number for number, name in enumerate(names) if name not in kept), key=lambda number: change[number])
    if change[worst] > settings.max_instability:
        return worst, (
            f"{names[worst]} would explain part of it, but its value differs by {100 * change[worst]:.0f} % between "
            "halves of the readings: a spurious match"
        )
    thinned = fit(search.subsample, found.explanation, found.scatter, 0)
    if thinned is None:
        return None
    for number in reversed(range(len(names))):
        if names[number] in kept:
            continue
        rest = search.refitted(found.explanation.without(number), found.scatter)
        without = fit(search.subsample, rest.explanation, rest.scatter, 0)
        beside = (
            [each for part in parts for each in corrections(search.subsample, without, part)[:1]] if without else []
        )
        beside = [each for each in beside if each.correction.log10_odds > settings.least_log10_odds]
        odds = [odds_beside(search.subsample, thinned, number, each) for each in beside]
        if odds and min(odds) < settings.least_log10_odds:
            smooth = beside[int(np.argmin(odds))].correction
            return number, (
                f"{names[number]} would explain part of it, but smooth functions of {smooth.depends_on} explain as "
                "much: a spurious match"
            )
    return None


def _excluded(
    readings: WeighedReadings, found: Fit, settings: Settings
) -> tuple[tuple[MovedCapture, ...], tuple[MovedCapture, ...]]:
    """The captures that moved, and those of parts of which too many moved to tell which did."""
    moved = moved_captures(readings, found)
    of_part = Counter(name.part for name in readings.observations.captures)
    moved_of_part = Counter(each.capture.part for each in moved)
    too_many = {part for part, count in moved_of_part.items() if count > settings.max_moved_captures * of_part[part]}
    return (
        tuple(each for each in moved if each.capture.part not in too_many),
        tuple(each for each in moved if each.capture.part in too_many),
    )


def _motion_sizes(readings: WeighedReadings, found: Fit) -> tuple[MotionSize, ...]:
    """How far the captures of each part repeat, with standard errors by the curvature of the evidence."""
    sums = readings.sums(found.at.residual, found.at.jacobian)
    errors = scatter_errors(sums, found.scatter, -off_prior(found.explanation)[found.at.free])
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


def _verdict(has_causes: bool, has_more: bool) -> str:
    if not has_more:
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
    widened = few_captures_factor(found, search.full.observations)
    sigmas = widened * found.sigmas()[first : first + len(cause.parameters)]
    parameters = tuple(
        ParameterValue(
            parameter.name, float(value), float(sigma), parameter.unit, parameter.prior_sigma, parameter.prior_mean
        )
        for parameter, value, sigma in zip(cause.parameters, found.explanation.values[number], sigmas, strict=True)
    )
    without = search.full.predictor.residual(found.explanation.without(number))
    change = without - found.at.residual
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
        LOG10_ODDS * (ranking.current.minus_two_log_evidence - found.minus_two_log_evidence),
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
            each.hypothesis.cause.name, each.hypothesis.variant, each.reduced_chi_squared, LOG10_ODDS * each.behind
        )
        for each in ranking.candidates
    ]
    named = {each.name for each in ranked}
    for screened in ranking.screened:
        name = screened.hypothesis.cause.name
        if name not in named:
            named.add(name)
            ranked.append(RankedCandidate(name, f"{screened.hypothesis.variant}; to first order", np.nan, np.nan))
    return tuple(ranked[:_RANKED])


def _correlations(found: Fit) -> Correlations:
    """Correlations between the free values of a fit."""
    hypotheses = found.explanation.hypotheses
    names = [f"{each.cause.name}.{parameter.name}" for each in hypotheses for parameter in each.cause.parameters]
    matrix = tuple(tuple(float(value) for value in row) for row in correlation_matrix(found))
    return Correlations(tuple(names[free] for free in found.at.free), matrix, correlation_condition(found))


def detection_limits(search: Search, found: Fit, causes: Mapping[str, Cause]) -> tuple[DetectionLimit, ...]:
    """Five standard errors of every parameter, each cause alone; those that a session says nothing of are left out.

    Those of a cause that acts from some moment on are for the middle of the session.

    Args:
        search: with the subsample of the readings, which stands for all of them.
        found: the fit without causes.
        causes: to be considered.
    """
    limits = []
    # Each reading of the subsample stands for several, but each capture for itself.
    scatter = replace(found.scatter, noise=found.scatter.noise / np.sqrt(search.share))
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
        # Without the prior, which says nothing about what would have been seen.
        information = alone.information - np.eye(alone.at.free.size)
        sigma = np.sqrt(np.diag(np.linalg.pinv(information, hermitian=True)).clip(0.0))
        moment = f" (from {middle:.0f} s on)" if any(is_time) else ""
        for number, each in zip(alone.at.free, sigma, strict=True):
            parameter = cause.parameters[number]
            limit = search.settings.detection_limit_se * float(each) * parameter.prior_sigma
            if limit > 0.0:
                limits.append(DetectionLimit(cause.name, f"{parameter.name}{moment}", parameter.unit, limit))
    return tuple(limits)


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
    sigma = observations.sigma_px[used]
    arcmin = 1.0 / (np.mean(observations.nominal.camera.focal_px) * ARCMIN)

    def of(part: int) -> float | None:
        return _rms(sigma[observations.part[used] == part] * arcmin)

    display = used[observations.part == DISPLAY]
    camera_px = observations.panel_from_camera[display] * observations.sigma_of(DISPLAY)[display][:, :, None]
    panel_px = float(np.sqrt(np.mean(np.sum(camera_px**2, axis=(1, 2))) / 2)) if display.any() else None
    return ResidualSummary(panel_px, of(SEE_THROUGH), of(RUN_TIME), 1.0)


def _usual_motion(readings: Predictor, found: Fit) -> FloatArray:
    """Change of readings (n, 2, 6), in units of sigma, by a motion of their capture of the usual size."""
    observations, scatter = readings.observations, found.scatter
    usual = replace(scatter.at_rest(), noise=np.ones_like(scatter.noise))
    part_of = np.array([name.part for name in observations.captures])
    return camera_motions(readings) * usual.sizes(part_of)[observations.group][:, None, :]


def _expected_summary(observations: Observations, motion: FloatArray, used: BoolArray) -> ResidualSummary:
    """The same for noise and the usual motion of each capture (n, 2, 6)."""
    noise = _noise_summary(observations, used)
    by_axis = [_residual_summary(observations, each, used) for each in np.moveaxis(motion, 2, 0)]

    def total(attribute: str) -> float | None:
        own = getattr(noise, attribute)
        return None if own is None else float(np.linalg.norm([own, *(getattr(each, attribute) for each in by_axis)]))

    display, see_through, run_time = (
        total(name) for name in ("display_rms_px", "see_through_rms_arcmin", "run_time_rms_arcmin")
    )
    return ResidualSummary(display, see_through, run_time, total("over_noise") or 1.0)


def _rms(values: FloatArray) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if len(values) else None

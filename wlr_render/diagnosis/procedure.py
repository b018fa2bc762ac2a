"""Diagnose a session with its nominal bench.

Noise, outlier readings, selection of causes, captures that moved, comparison of the candidates for each place, and what
stays unexplained; in that order. Generic over causes: nothing here knows any of them.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from wlr_render.bench.bench import Bench
from wlr_render.captures.session import Session
from wlr_render.diagnosis.cause import Cause
from wlr_render.diagnosis.cause_selection import CandidateRanking, Progress, Search, Selection
from wlr_render.diagnosis.causes import CAUSES
from wlr_render.diagnosis.corrections import corrections, odds_beside
from wlr_render.diagnosis.diagnosis import (
    EXPLAINED,
    NO_EFFECT,
    PARTLY,
    UNEXPLAINED,
    DetectionLimit,
    Diagnosis,
    Unexplained,
)
from wlr_render.diagnosis.findings import (
    capture_residuals,
    correlations,
    detection_limits,
    expected_summary,
    found_cause,
    motion_sizes,
    noise_summary,
    residual_summary,
    usual_motion,
)
from wlr_render.diagnosis.fit import (
    Fit,
    fit,
)
from wlr_render.diagnosis.noise import Noise, NoiseFloor, noise_of
from wlr_render.diagnosis.observations import DISPLAY, PART_NAMES, RUN_TIME, SEE_THROUGH, Observations
from wlr_render.diagnosis.outliers import MovedCapture, moved_captures, not_excluded
from wlr_render.diagnosis.prediction import Explanation, Predictor
from wlr_render.diagnosis.scatter import UNUSUAL_SHIFT, UNUSUAL_TURN
from wlr_render.diagnosis.screening import hypotheses
from wlr_render.diagnosis.settings import DEFAULT, Settings
from wlr_render.diagnosis.stability import instability
from wlr_render.diagnosis.weighed_readings import WeighedReadings
from wlr_render.numerics.arrays import BoolArray

_CONTESTS = 3  # times that another candidate may take a place before the comparison ends
_UNPREDICTED = {DISPLAY: "stage", SEE_THROUGH: "stage", RUN_TIME: "time"}


def diagnose(
    nominal: Bench,
    session: Session,
    progress: Progress = lambda _: None,
    causes: Mapping[str, Cause] = CAUSES,
    settings: Settings = DEFAULT,
) -> Diagnosis:
    """Compare a measured session with its bench model, and find the physical causes of any difference.

    Args:
        nominal: the nominal bench, as bench.toml describes it, from `load_session`.
        session: the measured readings, from `load_session`.
        progress: called with a sentence at each step.
        causes: the candidates.
        settings: thresholds and limits.

    Returns:
        The diagnosis; `print` shows its verdict and advice, `save` writes the report and the corrected session.

    Raises:
        BadInputError: the bench predicts no reading at all.

    Example:
        >>> import wlr_render as wlr
        >>> diagnosis = wlr.diagnose(*wlr.load_session("examples/data/session"))
        >>> diagnosis.verdict
        'explained'
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
    named = tuple(found_cause(search, found, number, ranking) for number, ranking in enumerate(rankings))
    excluded, too_many = _excluded(readings, found, settings)
    all_readings = stated.with_sigma(prepared.noise.sigma_px)
    observations = all_readings.observations
    before, after = (all_readings.residual(each) for each in (Explanation(), found.explanation))
    used = ~prepared.noise.outlier & not_excluded(observations, excluded)
    motion = usual_motion(all_readings, found)
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
        motions=motion_sizes(readings, found),
        noise=noise_summary(observations, used),
        expected=expected_summary(observations, motion, used),
        before=residual_summary(observations, before, used),
        after=residual_summary(observations, after, used),
        unexplained=max(left, key=lambda each: each.rms_over_noise, default=None),
        detection_limits=limits,
        reasons=(*_about_readings(prepared.noise.outlier), *dropped, selection.reason),
        captures=capture_residuals(observations, before, after, ~prepared.noise.outlier, excluded),
        correlations=correlations(found),
        observations=observations,
        residual_before=before,
        residual_after=after,
        usual_motion=motion,
        used=used,
        corrected=found.explanation.bench(nominal),
        readings=readings,
        fit=found,
        settings=settings,
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


def _verdict(has_causes: bool, has_more: bool) -> str:
    if not has_more:
        return EXPLAINED if has_causes else NO_EFFECT
    return PARTLY if has_causes else UNEXPLAINED

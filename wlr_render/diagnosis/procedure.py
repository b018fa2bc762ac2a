"""Diagnose a session with its nominal bench: explain its readings (`explain.py`), and fill the record."""

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from wlr_render.bench.bench import Bench
from wlr_render.captures.session import Session
from wlr_render.diagnosis.cause import Cause
from wlr_render.diagnosis.cause_selection import Progress
from wlr_render.diagnosis.causes import CAUSES
from wlr_render.diagnosis.diagnosis import (
    EXPLAINED,
    LOCATED,
    NO_EFFECT,
    PARTLY,
    UNEXPLAINED,
    DetectionLimit,
    Diagnosis,
    StationEffect,
)
from wlr_render.diagnosis.explain import Explained, explain
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
from wlr_render.diagnosis.fit import Fit
from wlr_render.diagnosis.outliers import MovedCapture, moved_captures, not_excluded
from wlr_render.diagnosis.prediction import Explanation, Predictor
from wlr_render.diagnosis.settings import DEFAULT, Settings
from wlr_render.diagnosis.weighed_readings import WeighedReadings


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
    explained = explain(stated, causes, settings, progress)
    located, noise, effects, corrected = explained.located, explained.noise, explained.effects, explained.corrected
    search, readings, found = located.search, located.search.full, located.found
    structure = located.structure(effects)
    named = tuple(
        found_cause(search, found, number, ranking, odds)
        for number, (ranking, odds) in enumerate(zip(explained.rankings, located.odds, strict=True))
    )
    excluded, too_many = _excluded(readings, found, settings)
    all_readings = stated.with_sigma(noise.sigma_px)
    observations = all_readings.observations
    before, after = all_readings.residual(Explanation()), all_readings.residual_of_bench(corrected)
    used = ~noise.outlier & not_excluded(observations, excluded)
    motion = usual_motion(all_readings, found)
    limits: tuple[DetectionLimit, ...] = ()
    has_rest = bool(explained.left or too_many)
    if not named and not effects and not has_rest:
        limits = detection_limits(search, found, causes)
    return Diagnosis(
        session=session.name,
        device=nominal.device.name,
        eye=nominal.eye,
        verdict=_verdict(bool(named), effects, has_rest or bool(structure), settings),
        causes=tuple(sorted(named, key=lambda cause: -cause.effect_over_noise)),
        effects=effects,
        excluded=excluded,
        too_many_moved=too_many,
        noise_floors=noise.floors,
        motions=motion_sizes(readings, found),
        noise=noise_summary(observations, used),
        expected=expected_summary(observations, motion, used),
        before=residual_summary(observations, before, used),
        after=residual_summary(observations, after, used),
        unexplained_parts=tuple(sorted(explained.left, key=lambda each: -each.rms_over_noise)),
        fields=located.tried,
        detection_limits=limits,
        reasons=_reasons(explained, structure),
        captures=capture_residuals(observations, before, after, ~noise.outlier, excluded),
        correlations=correlations(found),
        observations=observations,
        residual_before=before,
        residual_after=after,
        usual_motion=motion,
        used=used,
        corrected=corrected,
        readings=readings,
        fit=found,
        settings=settings,
    )


def _reasons(explained: Explained, structure: Sequence[str]) -> tuple[str, ...]:
    """Return sentences on outliers, rejected causes, remainders of effects, structure, and the end of the selection."""
    located, count = explained.located, int(np.sum(explained.noise.outlier))
    outliers = [f"{count} single readings lie far from their neighbours and were excluded"] if count else []
    return (*outliers, *located.dropped, *located.about_rests(), *structure, explained.end_of_selection)


def _excluded(
    readings: WeighedReadings, found: Fit, settings: Settings
) -> tuple[tuple[MovedCapture, ...], tuple[MovedCapture, ...]]:
    """Return the captures that moved, and the captures of parts of which too many moved to tell which did."""
    moved = moved_captures(readings, found)
    of_part = Counter(name.part for name in readings.observations.captures)
    moved_of_part = Counter(each.capture.part for each in moved)
    too_many = {part for part, count in moved_of_part.items() if count > settings.max_moved_captures * of_part[part]}
    return (
        tuple(each for each in moved if each.capture.part not in too_many),
        tuple(each for each in moved if each.capture.part in too_many),
    )


def _verdict(has_causes: bool, effects: Sequence[StationEffect], has_more: bool, settings: Settings) -> str:
    if has_more:
        return PARTLY if has_causes or effects else UNEXPLAINED
    if effects:
        share = max(each.share_of_excess_removed for each in effects)
        return LOCATED if share >= settings.min_share_located else PARTLY
    return EXPLAINED if has_causes else NO_EFFECT

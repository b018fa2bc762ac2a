"""Diagnose a session with its nominal bench.

The steps are: noise and outliers, selection of causes, comparison of the candidates for each place, location of effects
that no cause explains, correction of the bench, unexplained residual, and record.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from wlr_render.bench.bench import Bench
from wlr_render.captures.session import Session
from wlr_render.diagnosis.cause import Cause
from wlr_render.diagnosis.cause_selection import CandidateRanking, Progress, Search, Selection
from wlr_render.diagnosis.causes import CAUSES
from wlr_render.diagnosis.coherence import ROUNDS, FineEffect, fine_effect
from wlr_render.diagnosis.combiner_fields import footprints
from wlr_render.diagnosis.diagnosis import (
    EXPLAINED,
    LOCATED,
    NO_EFFECT,
    PARTLY,
    UNEXPLAINED,
    FoundCause,
    MovedCapture,
    StationEffect,
    Unexplained,
)
from wlr_render.diagnosis.effect_findings import station_effects
from wlr_render.diagnosis.field_terms import neighbours_agree
from wlr_render.diagnosis.findings import (
    capture_residuals,
    correlations,
    detection_limits,
    found_cause,
    motion_sizes,
    moved_captures,
    not_excluded,
    residual_summary,
    usual_motion,
)
from wlr_render.diagnosis.fine_in_bench import with_fine
from wlr_render.diagnosis.fit import Fit
from wlr_render.diagnosis.located_beside import Located, locate
from wlr_render.diagnosis.noise import SIGNIFICANT_SE, Noise, NoiseFloor, measured_at_run_time, noise_of
from wlr_render.diagnosis.observations import PART_NAMES, RUN_TIME, Observations
from wlr_render.diagnosis.prediction import Explanation, Predictor
from wlr_render.diagnosis.report import Diagnosis
from wlr_render.diagnosis.screening import hypotheses
from wlr_render.diagnosis.settings import DEFAULT, Settings
from wlr_render.diagnosis.station_fields import station_fields
from wlr_render.diagnosis.weighed_readings import WeighedReadings
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import Box
from wlr_render.numerics.scatter import UNUSUAL_SHIFT, UNUSUAL_TURN

_ALIKE = 4.0  # standard errors beyond which neighbours at a station count as correlated
_WILD = 10.0  # sigma at which residuals are clipped when two corrections are compared
_SAME_NOISE = 0.1  # change of sigma, or of the shared part, below which causes are not selected again
_FEWEST_READINGS = 30  # fewest readings of a photograph that tell noise from a smooth effect
_CONTESTS = 3  # most rounds of replacing a cause by a better candidate


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
    search, selection, fine = _prepared(stated, causes, settings, progress)
    found, rankings = _compared(search, selection.fit, selection.first)
    progress("looking for effects that no cause has")
    located = locate(search, found)
    if located.found is not found:
        rankings = _rankings(located.search, located.found)
    fine = located.fine_beside(fine)
    noise = _with_run_time(search.full.noise, located, stated.observations)
    left = _unexplained(located, noise, fine, stated.observations, settings)
    corrected, effects = _corrected(located, fine, stated, settings)
    if effects:
        noise = _with_run_time(_noise_beside(corrected, stated, noise), located, stated.observations)
    named = [
        found_cause(located.search, located.found, number, ranking, odds)
        for number, (ranking, odds) in enumerate(zip(rankings, located.odds, strict=True))
    ]
    said = _record(stated.with_sigma(noise.sigma_px), located, named, effects, noise, corrected, left)
    said = replace(said, reasons=(*said.reasons, selection.reason))
    if named or effects or left or said.too_many_moved:
        return said
    return replace(said, detection_limits=detection_limits(located.search, located.found, causes))


def _record(
    all_readings: Predictor,
    located: Located,
    named: Sequence[FoundCause],
    effects: Sequence[StationEffect],
    noise: Noise,
    corrected: Bench,
    left: Sequence[Unexplained],
) -> Diagnosis:
    """Return the record of a diagnosis, without detection limits and without the reason why the selection ended."""
    readings, found, settings = located.search.full, located.found, located.search.settings
    observations, structure = all_readings.observations, located.structure(effects)
    excluded, too_many = _excluded(readings, found, settings)
    before, after = all_readings.residual(Explanation()), all_readings.residual_of_bench(corrected)
    used = ~noise.outlier & not_excluded(observations, excluded)
    motion, count = usual_motion(all_readings, found), int(np.sum(noise.outlier))
    noise_alone = np.broadcast_to(np.eye(2), (len(observations), 2, 2))  # the two axes are independent
    outliers = [f"{count} single readings lie far from their neighbours and were excluded"] if count else []
    return Diagnosis(
        session=observations.session.name,
        device=observations.nominal.device.name,
        eye=observations.nominal.eye,
        verdict=_verdict(bool(named), effects, bool(left or too_many or structure), settings),
        causes=tuple(sorted(named, key=lambda cause: -cause.effect_over_noise)),
        effects=tuple(effects),
        excluded=excluded,
        too_many_moved=too_many,
        noise_floors=noise.floors,
        motions=motion_sizes(readings, found),
        noise=residual_summary(observations, noise_alone, used),
        expected=residual_summary(observations, np.concatenate([noise_alone, motion], axis=2), used),
        before=residual_summary(observations, before, used),
        after=residual_summary(observations, after, used),
        unexplained_parts=tuple(left),
        fields=located.tried,
        detection_limits=(),
        reasons=(*outliers, *located.dropped, *located.about_rests(), *structure),
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


def _excluded(
    readings: WeighedReadings, found: Fit, settings: Settings
) -> tuple[tuple[MovedCapture, ...], tuple[MovedCapture, ...]]:
    """Return the captures that moved, and separately captures of parts where too many moved to identify them."""
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


def _corrected(
    located: Located, fine: FineEffect | None, as_stated: Predictor, settings: Settings
) -> tuple[Bench, list[StationEffect]]:
    """Return the bench with causes and effects applied, and the records of these effects."""
    bench = located.bench(located.found.explanation.bench(as_stated.observations.nominal))
    # The remainder of a smooth effect after its functions is also fine.
    if fine is not None or located.effects:
        residual = as_stated.residual_of_bench(bench)
        left = fine_effect(as_stated, residual, settings.least_log10_odds, ROUNDS)
        with_cells = with_fine(bench, left, as_stated, settings.least_log10_odds)
        # Cells describe the residual about surfaces through photographs; otherwise they may worsen the prediction.
        if _size(as_stated.residual_of_bench(with_cells)) < _size(residual):
            bench = with_cells
        fine = None if fine is None else left
    return bench, station_effects(located.contest, located.effects, located.scatter, fine, as_stated)


def _size(residual: FloatArray) -> float:
    """Return the rms length of a residual (n, 2), clipped at `_WILD`."""
    return float(np.sqrt(np.nanmean(np.minimum(np.sum(residual**2, axis=1), _WILD**2))))


def _prepared(
    as_stated: Predictor, causes: Mapping[str, Cause], settings: Settings, progress: Progress
) -> tuple[Search, Selection, FineEffect | None]:
    """Measure the noise and select causes; repeat both if the residual of these causes shows another noise.

    Returns:
        The search, the selection, and the fine effect common to different captures, if there is one.
    """
    start, spot = Explanation(), None
    done: tuple[Search, Selection, FineEffect | None] | None = None
    while True:
        # Keep the spot that was found without causes: its fields must rival a cause that explains it.
        noise, fine, spot = _noise_left_by(start, as_stated, settings, spot)
        if done is not None:
            if _are_alike(noise, done[0].full.noise):
                return done
            progress("the noise differs from the first estimate: again")
        full = WeighedReadings.of(as_stated.with_sigma(noise.sigma_px).of_rows(~noise.outlier), noise)
        subsample = full.of_rows(full.observations.spread(settings.subsample))
        progress("what each cause and each field would do")
        fields = station_fields(subsample, spot=spot)
        search = Search(full, subsample, hypotheses(causes), progress, settings, fields, spot)
        selection = search.select(start)
        if done is not None:
            return search, selection, fine
        progress("measuring the noise again")
        done, start = (search, selection, fine), selection.fit.explanation
        if not start.hypotheses:
            return done


def _are_alike(noise: Noise, before: Noise) -> bool:
    """Return whether two estimates of the noise are so close that causes need not be selected again."""
    now, old = ([floor.shared for floor in each.floors] for each in (noise, before))
    alike = np.allclose(noise.sigma_px, before.sigma_px, rtol=_SAME_NOISE) and np.allclose(now, old, atol=_SAME_NOISE)
    return alike and np.array_equal(noise.outlier, before.outlier)


def _noise_left_by(
    explanation: Explanation, as_stated: Predictor, settings: Settings, spot: Box | None
) -> tuple[Noise, FineEffect | None, Box | None]:
    """Return the noise in an explanation's residual, without the fine effect common to different captures.

    Returns:
        The noise, the common effect, and `spot`, or if None the spot on the combiner that the common effect shows.
    """
    residual = as_stated.residual(explanation)
    fine = fine_effect(as_stated, residual, settings.least_log10_odds)
    if fine is not None:
        residual[fine.rows] -= fine.change
        spot = fine.spot_on_combiner if spot is None else spot
    noise = noise_of(as_stated.observations, residual)
    if spot is None:
        return noise, fine, None
    # Readings in the spot that lie far from their neighbours show the effect; they are not outliers.
    place = footprints(as_stated)
    is_in_spot = np.all((place > spot.low) & (place < spot.high), axis=1)
    return replace(noise, outlier=noise.outlier & ~is_in_spot), fine, spot


def _compared(search: Search, found: Fit, first: CandidateRanking) -> tuple[Fit, list[CandidateRanking]]:
    """Return the fit with the best candidate in each place, given the other causes, and the candidates for each."""
    for _ in range(_CONTESTS):
        rankings = _rankings(search, found, first)
        others = [
            each
            for name, ranking in zip(found.explanation.names, rankings, strict=True)
            for each in ranking.fits[:1]
            if each.explanation.names[-1] != name
        ]
        best = min(others, key=lambda each: each.minus_two_log_evidence, default=found)
        if best.minus_two_log_evidence >= found.minus_two_log_evidence:
            return found, rankings
        found = best
    return found, _rankings(search, found, first)


def _rankings(search: Search, found: Fit, first: CandidateRanking | None = None) -> list[CandidateRanking]:
    """Return the candidates for the place of each cause, given the other causes; for a single cause, `first`."""
    if len(found.explanation.hypotheses) == 1 and first is not None:
        return [first]
    rests = [found.explanation.without(number) for number in range(len(found.explanation.hypotheses))]
    return [search.rank(search.refitted(rest, found.scatter)) for rest in rests]


def _noise_beside(corrected: Bench, as_stated: Predictor, noise: Noise) -> Noise:
    """Return the noise measured with a corrected bench, with the same outliers.

    Before the correction, noise included the part of an effect that surfaces through photographs do not follow.
    """
    residual = np.nan_to_num(as_stated.residual_of_bench(corrected))
    return replace(noise_of(as_stated.observations, residual), outlier=noise.outlier)


def _with_run_time(noise: Noise, located: Located, observations: Observations) -> Noise:
    """Return the noise with the run-time part measured from its residual, if no station explains any of the residual.

    Each photograph shows its noise; for a recording, the only test is that neighbours correlate at no station.
    """
    at_run_time, scatter, contest = observations.part == RUN_TIME, located.scatter, located.contest
    # The fit never makes noise smaller than stated; at that limit it is not a measurement.
    is_measured = at_run_time.sum() >= _FEWEST_READINGS and scatter.noise[RUN_TIME] > 1.0
    if not is_measured:
        return noise
    in_contest, left = contest.readings.observations.part == RUN_TIME, contest.left(located.effects, scatter)
    fields = [each for each in contest.fields if np.any(each.acts & in_contest)]
    if any(neighbours_agree(field, left, _ALIKE) for field in fields):
        return noise
    floor = noise.floor(RUN_TIME)
    measured = measured_at_run_time(floor, float(scatter.noise[RUN_TIME]), int(at_run_time.sum()))
    floors = tuple(measured if each is floor else each for each in noise.floors)
    sigma = np.where(at_run_time, measured.used_px / floor.used_px, 1.0) * noise.sigma_px
    return replace(noise, floors=floors, sigma_px=sigma)


def _unexplained(
    located: Located, noise: Noise, fine: FineEffect | None, as_stated: Observations, settings: Settings
) -> list[Unexplained]:
    """Return the parts whose residual after causes and effects exceeds noise and repeatability.

    Args:
        located: causes and smooth effects.
        noise: noise measured with these.
        fine: the effect that is too fine for a field, if any.
        as_stated: all readings, with the noise as stated.
        settings: thresholds.
    """
    left: list[Unexplained] = []
    observations, raw = located.search.full.observations, located.found.at.residual
    scatter, before = located.scatter, located.search.full.noise
    for part in np.unique(observations.part):
        floor = before.floor(part)
        error = _variance_error(observations, int(part), floor)
        # Noise within photographs counts as noise, even where a smaller stated noise was believable.
        within = max(1.0, float(np.nan_to_num(noise.floor(part).measured_px)) / floor.used_px)
        excess = float((scatter.noise[part] / within) ** 2 - 1.0)
        if fine is not None:
            change = fine.change * (as_stated.sigma_px / before.sigma_px)[fine.rows, None]
            of_part = as_stated.part == part
            excess -= float(0.5 * np.sum(change[of_part[fine.rows]] ** 2) / np.sum(of_part))
        moves = max(scatter.shift_um[part] / UNUSUAL_SHIFT, scatter.turn_urad[part] / UNUSUAL_TURN)
        if excess > max(SIGNIFICANT_SE * error, settings.material_excess) or moves > 1.0:
            rms = float(np.sqrt(np.mean(raw[observations.part == part] ** 2)))
            left.append(Unexplained(PART_NAMES[part], excess, rms))
    return sorted(left, key=lambda each: -each.rms_over_noise)


def _variance_error(observations: Observations, part: int, floor: NoiseFloor) -> float:
    """Return the relative standard error of the noise variance of a part.

    It is infinite where photographs have too few readings to show the noise that neighbours share. At run time it is
    the error from the number of readings alone.
    """
    rows = observations.part == part
    few = float(np.sqrt(1.0 / np.sum(rows)))
    if part == RUN_TIME:
        return few
    readings = np.sum(rows) / len(np.unique(observations.photograph[rows]))
    known = floor.error_px > 0 and readings >= _FEWEST_READINGS
    return float(np.hypot(few, 2.0 * floor.error_px / floor.measured_px)) if known else np.inf

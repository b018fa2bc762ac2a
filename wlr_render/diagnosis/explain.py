"""Explain the readings of a session by causes and located effects.

The steps are: noise and outliers, selection of causes, comparison of the candidates for each place, effects at stations
without a cause, correction of the bench, and the unexplained residual.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from wlr_render.bench.bench import Bench
from wlr_render.diagnosis.cause import Cause
from wlr_render.diagnosis.cause_selection import CandidateRanking, Progress, Search, Selection
from wlr_render.diagnosis.coherence import ROUNDS, FineEffect, fine_effect
from wlr_render.diagnosis.combiner_fields import footprints
from wlr_render.diagnosis.diagnosis import StationEffect, Unexplained
from wlr_render.diagnosis.effect_findings import station_effects
from wlr_render.diagnosis.field_terms import neighbours_agree
from wlr_render.diagnosis.fine_in_bench import with_fine
from wlr_render.diagnosis.fit import Fit
from wlr_render.diagnosis.located_beside import Located, locate
from wlr_render.diagnosis.noise import SIGNIFICANT_SE, Noise, NoiseFloor, measured_at_run_time, noise_of
from wlr_render.diagnosis.observations import PART_NAMES, RUN_TIME, Observations
from wlr_render.diagnosis.prediction import Explanation, Predictor
from wlr_render.diagnosis.screening import hypotheses
from wlr_render.diagnosis.settings import Settings
from wlr_render.diagnosis.station_fields import station_fields
from wlr_render.diagnosis.weighed_readings import WeighedReadings
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import Box
from wlr_render.numerics.scatter import UNUSUAL_SHIFT, UNUSUAL_TURN

_ALIKE = 4.0  # standard errors beyond which neighbours at a station correlate
_WILD = 10.0  # sigma, from which a reading says nothing of a correction
_SAME_NOISE = 0.1  # change of sigma, or of the shared part, below which causes are not selected again
_FEWEST_READINGS = 30  # fewest readings of a photograph that tell noise from a smooth effect
_CONTESTS = 3  # times that another candidate may take a place before the comparison ends


@dataclass(frozen=True, eq=False)
class _Prepared:
    """A selection, and the noise by which it was made.

    Attributes:
        noise: noise without the effect that different captures have in common.
        fine: that effect, if there is one.
        fine_variance: mean square per axis of that effect over the readings of its part, in units of the noise.
        search, selection: of causes.
    """

    noise: Noise
    fine: FineEffect | None
    fine_variance: Mapping[int, float]
    search: Search
    selection: Selection


@dataclass(frozen=True, eq=False)
class Explained:
    """Causes and located effects that explain the readings of a session.

    Attributes:
        located: causes and effects, fitted together.
        rankings: the candidates for the place of each cause.
        noise: noise with the corrected bench.
        left: parts of the session with an unexplained residual.
        corrected: the nominal bench with causes and effects.
        effects: records of the located effects.
        end_of_selection: why no further cause was selected.
    """

    located: Located
    rankings: list[CandidateRanking]
    noise: Noise
    left: list[Unexplained]
    corrected: Bench
    effects: tuple[StationEffect, ...]
    end_of_selection: str


def explain(stated: Predictor, causes: Mapping[str, Cause], settings: Settings, progress: Progress) -> Explained:
    """Select causes, locate effects in addition to them, and correct the bench by both.

    Args:
        stated: predictor of all readings, with the noise as stated.
        causes: the candidates.
        settings: thresholds and limits.
        progress: called with a sentence at each step.
    """
    prepared = _prepared(stated, causes, settings, progress)
    selection = prepared.selection
    found, rankings = _compared(prepared.search, selection.fit, selection.first)
    progress("looking for effects that no cause has")
    located = locate(prepared.search, found)
    if located.found is not found:
        rankings = _rankings(located.search, located.found)
    fine = located.fine_beside(prepared.fine)
    noise = _with_run_time(prepared.noise, located, stated.observations)
    left = _unexplained(located, prepared, noise, fine, settings)
    corrected, effects = _corrected(located, fine, stated, settings)
    if effects:
        noise = _with_run_time(_noise_beside(corrected, stated, noise), located, stated.observations)
    return Explained(located, rankings, noise, left, corrected, tuple(effects), selection.reason)


def _corrected(
    located: Located, fine: FineEffect | None, as_stated: Predictor, settings: Settings
) -> tuple[Bench, list[StationEffect]]:
    """Return the bench with causes and effects at work, and the records of these effects."""
    bench = located.bench(located.found.explanation.bench(as_stated.observations.nominal))
    # What the functions of a smooth effect leave of it is fine, too.
    if fine is not None or located.effects:
        residual = as_stated.residual_of_bench(bench)
        left = fine_effect(as_stated, residual, settings.least_log10_odds, ROUNDS)
        with_cells = with_fine(bench, left, as_stated, settings.least_log10_odds)
        # Cells describe the residual of surfaces through photographs; their other changes may make the fit worse.
        if _size(as_stated.residual_of_bench(with_cells)) < _size(residual):
            bench = with_cells
        fine = None if fine is None else left
    return bench, station_effects(located.contest, located.effects, located.scatter, fine, as_stated)


def _size(residual: FloatArray) -> float:
    """Return the rms length of a residual (n, 2), of which wild readings count no more than others."""
    return float(np.sqrt(np.nanmean(np.minimum(np.sum(residual**2, axis=1), _WILD**2))))


def _prepared(as_stated: Predictor, causes: Mapping[str, Cause], settings: Settings, progress: Progress) -> _Prepared:
    """Measure the noise and select causes; again, where the residual by these causes shows another noise."""
    start = Explanation()
    first = _selected(start, _noise_left_by(start, as_stated, settings, None), as_stated, causes, settings, progress)
    progress("measuring the noise again")
    start = first.selection.fit.explanation
    if not start.hypotheses:
        return first
    # A spot that was there without the explanation: a cause that explains it has its fields as rivals.
    noise, fine, spot = _noise_left_by(start, as_stated, settings, first.search.spot)
    now, before = ([floor.shared for floor in each.floors] for each in (noise, first.noise))
    same = np.allclose(noise.sigma_px, first.noise.sigma_px, rtol=_SAME_NOISE)
    same = same and np.allclose(now, before, atol=_SAME_NOISE)
    if same and np.array_equal(noise.outlier, first.noise.outlier):
        return first
    progress("the noise differs from the first estimate: again")
    return _selected(start, (noise, fine, spot), as_stated, causes, settings, progress)


def _selected(
    start: Explanation,
    left: tuple[Noise, FineEffect | None, Box | None],
    as_stated: Predictor,
    causes: Mapping[str, Cause],
    settings: Settings,
    progress: Progress,
) -> _Prepared:
    """Select causes from an explanation on, with the noise and effects that `_noise_left_by` finds with it."""
    noise, fine, spot = left
    observations, variance = as_stated.observations, dict[int, float]()
    if fine is not None:
        part = observations.part[fine.rows]
        change = fine.change * (observations.sigma_px / noise.sigma_px)[fine.rows, None]
        for number in np.unique(part):
            square = np.sum(change[part == number] ** 2)
            variance[int(number)] = float(0.5 * square / np.sum(observations.part == number))
    full = WeighedReadings.of(as_stated.with_sigma(noise.sigma_px).of_rows(~noise.outlier), noise)
    subsample = full.of_rows(full.observations.spread(settings.subsample))
    progress("what each cause and each field would do")
    fields = station_fields(subsample, spot=spot)
    search = Search(full, subsample, hypotheses(causes), progress, settings, fields, spot)
    return _Prepared(noise, fine, variance, search, search.select(start))


def _noise_left_by(
    explanation: Explanation, as_stated: Predictor, settings: Settings, spot: Box | None
) -> tuple[Noise, FineEffect | None, Box | None]:
    """Return the noise in an explanation's residual, without the effect that different captures have in common.

    Returns:
        The noise, the common effect, and `spot`, or without it the spot on the combiner that the common effect shows.
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


def _rankings(search: Search, found: Fit, first: CandidateRanking | None = None) -> list[CandidateRanking]:
    """Return the candidates for the place of each cause, given the other causes; `first` for a single cause."""
    if len(found.explanation.hypotheses) == 1 and first is not None:
        return [first]
    rests = [found.explanation.without(number) for number in range(len(found.explanation.hypotheses))]
    return [search.rank(search.refitted(rest, found.scatter)) for rest in rests]


def _noise_beside(corrected: Bench, as_stated: Predictor, noise: Noise) -> Noise:
    """Return the noise with a corrected bench at work, with the same outliers.

    What a surface through a photograph does not follow of an effect was counted as noise before.
    """
    residual = np.nan_to_num(as_stated.residual_of_bench(corrected))
    return replace(noise_of(as_stated.observations, residual), outlier=noise.outlier)


def _with_run_time(noise: Noise, located: Located, observations: Observations) -> Noise:
    """Return the noise with the run-time part measured from its residual, if no station explains any of the residual.

    A photograph shows its noise alone; a recording only shows that neighbours correlate at no station.
    """
    at_run_time, scatter, contest = observations.part == RUN_TIME, located.scatter, located.contest
    # The fit never makes noise smaller than stated: at that limit it does not measure the noise.
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
    located: Located, prepared: _Prepared, noise: Noise, fine: FineEffect | None, settings: Settings
) -> list[Unexplained]:
    """Return the parts whose residual exceeds noise and repeatability with causes, effects and a fine one at work."""
    left: list[Unexplained] = []
    observations, raw = located.search.full.observations, located.found.at.residual
    scatter = located.scatter
    for part in np.unique(observations.part):
        floor = prepared.noise.floor(part)
        error = _variance_error(observations, int(part), floor)
        # What photographs show within is noise, if a stated noise that is smaller is believed, too.
        within = max(1.0, float(np.nan_to_num(noise.floor(part).measured_px)) / floor.used_px)
        excess = float((scatter.noise[part] / within) ** 2 - 1.0)
        if fine is not None:
            excess -= prepared.fine_variance.get(int(part), 0.0)
        moves = max(scatter.shift_um[part] / UNUSUAL_SHIFT, scatter.turn_urad[part] / UNUSUAL_TURN)
        if excess > max(SIGNIFICANT_SE * error, settings.material_excess) or moves > 1.0:
            rms = float(np.sqrt(np.mean(raw[observations.part == part] ** 2)))
            left.append(Unexplained(PART_NAMES[part], excess, rms))
    return left


def _variance_error(observations: Observations, part: int, floor: NoiseFloor) -> float:
    """Relative standard error of the noise's variance in a part.

    Where photographs have too few readings to tell what neighbours share, it may be anything; at run time it is as
    stated.
    """
    rows = observations.part == part
    few = float(np.sqrt(1.0 / np.sum(rows)))
    if part == RUN_TIME:
        return few
    readings = np.sum(rows) / len(np.unique(observations.photograph[rows]))
    known = floor.error_px > 0 and readings >= _FEWEST_READINGS
    return float(np.hypot(few, 2.0 * floor.error_px / floor.measured_px)) if known else np.inf

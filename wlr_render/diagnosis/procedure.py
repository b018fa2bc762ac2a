"""From a session and the bench as its makers believe it to be, to a diagnosis.

Noise floor, stray readings, selection of causes, captures that moved, a contest for the place of each cause, and what
stays unexplained; in that order. Generic over causes: nothing here knows any of them.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from wlr_render.captures.session import Session
from wlr_render.diagnosis import evidence, figures
from wlr_render.diagnosis.cause import Cause
from wlr_render.diagnosis.causes import CAUSES
from wlr_render.diagnosis.corrections import corrections
from wlr_render.diagnosis.diagnosis import (
    EXPLAINED,
    NO_EFFECT,
    PARTLY,
    UNEXPLAINED,
    Diagnosis,
    FoundCause,
    Unexplained,
)
from wlr_render.diagnosis.extension import Extension, Predictor
from wlr_render.diagnosis.fit import Fit, fit
from wlr_render.diagnosis.found import found_cause
from wlr_render.diagnosis.hypotheses import hypotheses
from wlr_render.diagnosis.limits import detection_limits
from wlr_render.diagnosis.noise import NoiseFloor, excess_over_noise, noise_floors, sigma_of, stray_readings
from wlr_render.diagnosis.observations import DISPLAY, PART_NAMES, RUN_TIME, SEE_THROUGH, Observations, observe
from wlr_render.diagnosis.outliers import MovedCapture, kept, moved_captures
from wlr_render.diagnosis.search import Progress, Round, Search, Selection
from wlr_render.diagnosis.steadiness import unsteadiness
from wlr_render.numerics.arrays import BoolArray
from wlr_render.simulation.bench import Bench

_MOST_CAUSES = 5
_OUTLIER_ROUNDS = 3
_SAME_NOISE = 0.02  # relative; noise that differs by less needs no second selection
_CONTESTS = 3  # times that a rival may take a place before the contest ends
_THIN = 6000  # readings for the first comparison of candidates
_UNSTEADY = 0.35
_STRUCTURED = 1.0  # percent that a correction must gain on held-out captures, to count as structure
_SIGNIFICANT = 4.0  # standard errors, likewise
_UNPREDICTED = {DISPLAY: "stage", SEE_THROUGH: "stage", RUN_TIME: "time"}


@dataclass(frozen=True)
class Options:
    """What a diagnosis may be told.

    Attributes:
        causes: to be considered.
        thin: readings on which candidates are first compared.
    """

    causes: Mapping[str, Cause]
    thin: int = _THIN


def diagnose(
    nominal: Bench, session: Session, progress: Progress = lambda _: None, options: Options | None = None
) -> Diagnosis:
    """Say whether a bench predicts a session down to the noise, and if not, why.

    Args:
        nominal: the bench as its makers believe it to be.
        session: what was measured.
        progress: told what is being done.
        options: causes and sizes other than the usual.

    Raises:
        BadInputError: the bench predicts no reading at all.
    """
    options = options or Options(CAUSES)
    progress("predicting the session with the nominal bench")
    as_stated = observe(nominal, session)
    measured = _measured(as_stated, options, progress)
    observations, search, selection = measured.observations, measured.search, measured.selection
    found, rounds = _contested(search, selection.fit, selection.first)
    progress("looking for structure in what is left")
    left = _unexplained(observations, found, search.used)
    dropped: list[str] = []
    while left is not None and (imitation := _imitation(search, found)) is not None:
        number, sentence = imitation
        dropped.append(sentence)
        found = fit(search.full, found.extension.without(number), search.used)
        rounds = _contests(search, found, selection.first)
        left = _unexplained(observations, found, search.used)
    causes = tuple(found_cause(search, found, number, contest) for number, contest in enumerate(rounds))
    after = search.full.residual(found.extension)
    reasons = [*dropped, selection.reason]
    if measured.strays:
        reasons.insert(0, f"{measured.strays} single readings lie far from their neighbours and were left out")
    before = search.full.residual(Extension())
    return Diagnosis(
        verdict=_verdict(causes, left),
        causes=tuple(sorted(causes, key=lambda cause: -cause.effect_over_noise)),
        outliers=tuple(measured.outliers),
        floors=measured.floors,
        noise=figures.of_noise(observations, search.used),
        before=figures.of_residual(observations, before, search.used),
        after=figures.of_residual(observations, after, search.used),
        unexplained=left,
        limits=() if causes or left else detection_limits(search.thin, search.thin_used, search.used, options.causes),
        reasons=tuple(reasons),
        observations=observations,
        residual_before=before,
        residual_after=after,
        used=search.used,
        extended=found.extension.bench(nominal),
        condition=evidence.condition(found),
    )


@dataclass(frozen=True, eq=False)
class _Measured:
    """A selection, with the noise by which it was made."""

    observations: Observations
    floors: tuple[NoiseFloor, ...]
    strays: int
    search: Search
    selection: Selection
    outliers: list[MovedCapture]


def _measured(as_stated: Observations, options: Options, progress: Progress) -> _Measured:
    """Measure the noise and select causes; again, where what the causes leave shows another noise: it is smoother."""
    predictor = Predictor(as_stated)
    first = _by_noise_of(predictor, Extension(), options, progress)
    left = predictor.residual(first.selection.fit.extension)
    sigma = sigma_of(noise_floors(as_stated, left), as_stated.sigma_px)
    if np.allclose(sigma, first.observations.sigma_px, rtol=_SAME_NOISE):
        return first
    progress("noise is smaller than it seemed: again")
    return _by_noise_of(predictor, first.selection.fit.extension, options, progress)


def _by_noise_of(as_stated: Predictor, extension: Extension, options: Options, progress: Progress) -> _Measured:
    """Select causes by the noise that an extension leaves within the photographs."""
    observations, residual = as_stated.observations, as_stated.residual(extension)
    floors = noise_floors(observations, residual)
    sigma = sigma_of(floors, observations.sigma_px)
    strays = stray_readings(observations, residual * (observations.sigma_px / sigma)[observations.part][:, None])
    measured = observations.with_sigma(sigma)
    search, selection, outliers = _selected(measured, ~strays, options, progress)
    return _Measured(measured, floors, int(strays.sum()), search, selection, outliers)


def _selected(
    observations: Observations, good: BoolArray, options: Options, progress: Progress
) -> tuple[Search, Selection, list[MovedCapture]]:
    """Select causes, set aside the captures that then stand out, and select again without them."""
    spread = observations.spread(options.thin)
    full, thin = Predictor(observations), Predictor(observations.of_rows(spread))
    outliers: list[MovedCapture] = []
    for _ in range(_OUTLIER_ROUNDS):
        used = good & kept(full, outliers)
        search = Search(full, thin, used, used[spread], hypotheses(options.causes), progress)
        selection = search.select(_MOST_CAUSES)
        progress("looking for captures that moved")
        more = moved_captures(full, selection.fit, good)
        if {each.capture for each in more} <= {each.capture for each in outliers}:
            break
        outliers = more
    return search, selection, outliers


def _imitation(search: Search, found: Fit) -> tuple[int, str] | None:
    """The cause whose value depends most on where it is measured, and what to say of it; None where all are steady."""
    if not found.extension.hypotheses:
        return None
    change = unsteadiness(search.full.observations, found)
    worst = int(np.argmax(change))
    if change[worst] < _UNSTEADY:
        return None
    return worst, (
        f"{found.extension.names[worst]} would explain part of it, but its value differs by "
        f"{100 * change[worst]:.0f} % between halves of the readings: an imitation"
    )


def _contested(search: Search, found: Fit, first: Round) -> tuple[Fit, list[Round]]:
    """Give each place to the cause that, the others being as they are, costs least; and the candidates for each."""
    for _ in range(_CONTESTS):
        rounds = _contests(search, found, first)
        rivals = [
            candidate.fit
            for name, contest in zip(found.extension.names, rounds, strict=True)
            for candidate in contest.candidates[:1]
            if candidate.whole and candidate.hypothesis.cause.name != name
        ]
        best = min(rivals, key=evidence.cost, default=found)
        if evidence.cost(best) >= evidence.cost(found):
            break
        found = best
    return found, rounds


def _contests(search: Search, found: Fit, first: Round) -> list[Round]:
    """For each cause, the candidates for its place, the others being as they are."""
    if len(found.extension.hypotheses) == 1:
        return [first]
    rests = [found.extension.without(number) for number in range(len(found.extension.hypotheses))]
    return [search.round(fit(search.full, rest, search.used)) for rest in rests]


def _unexplained(observations: Observations, found: Fit, used: BoolArray) -> Unexplained | None:
    """The part of the session in which most is left, if it is more than noise or has structure."""
    left: list[Unexplained] = []
    for part, excess in excess_over_noise(observations, found.residual, used).items():
        tried = corrections(observations, found.residual, used, part)
        gain = tried[0].gain if tried else None
        structured = gain is not None and gain.percent > _STRUCTURED and gain.significance > _SIGNIFICANT
        if structured or excess.is_significant:
            # What nothing smooth carries from one capture to the next comes and goes with where the camera stood.
            bound_to = tried[0].bound_to if structured else _UNPREDICTED[part]
            rms = float(np.sqrt(excess.mean_square))
            left.append(Unexplained(PART_NAMES[part], bound_to, rms, tuple(tried)))
    return max(left, key=lambda each: each.rms_over_noise, default=None)


def _verdict(causes: tuple[FoundCause, ...], left: Unexplained | None) -> str:
    if left is None:
        return EXPLAINED if causes else NO_EFFECT
    return PARTLY if causes else UNEXPLAINED

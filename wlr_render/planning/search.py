"""Search for the session with the fewest camera places that reaches an accuracy."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from wlr_render.numerics.arrays import FloatArray
from wlr_render.planning.designs import CHOSEN, SPREAD, Design, offered, spread
from wlr_render.planning.place_choice import PlaceChoice, further_distance
from wlr_render.planning.planned_bench import PlannedBench
from wlr_render.planning.planned_errors import (
    DesignErrors,
    DesignPredictor,
    EyeTests,
    PlannedFit,
    Scales,
    simulated_captures,
)

LEAST_PLACES = 9
PILOT_PLACES = 30
"""Camera places of the pilot session."""
_GUESSES = 4  # most numbers of places at which a chosen design is predicted
_FIRST_STEP = 16  # number of first steps over all designs; steps double until a design reaches the accuracy
_MORE = 1.25  # factor on the number of places if the simulated session misses the accuracy
_TRIALS = 3
_AGREES = 1.1  # tolerance factor on the goal, because the errors of a single session scatter by as much


@dataclass(frozen=True)
class PredictedDesign:
    """A design with its predicted errors."""

    design: Design
    errors: DesignErrors

    @property
    def p95(self) -> float:
        """Registration error, in arcminutes, that is not exceeded in 95 % of the eye box."""
        return self.errors.registration.p95


@dataclass(frozen=True, eq=False)
class DesignSearch:
    """Result of a search.

    Attributes:
        predictor: predictor of designs' errors; its pilot is the simulated session of the recommended design.
        tried: designs of each family with their predicted errors, by number of places.
        recommended: the design to use.
        simulated: errors of a simulated session with this design, against the traced headset.
        limits: predicted errors with one change of the bench or the design, by the name of the change.
        reaches: True if prediction and simulation reach the accuracy.
    """

    predictor: DesignPredictor
    tried: Mapping[str, tuple[PredictedDesign, ...]]
    recommended: PredictedDesign
    simulated: DesignErrors
    limits: Mapping[str, DesignErrors]
    reaches: bool


def find_design(bench: PlannedBench, accuracy_arcmin: float, most: int, say: Callable[[str], object]) -> DesignSearch:
    """Find the design with the fewest places that reaches an accuracy in prediction and in simulation.

    Args:
        bench: the planned bench.
        accuracy_arcmin: goal for the registration error of 95 % of the eye box.
        most: largest number of places.
        say: called with a sentence at each step.

    Raises:
        BadInputError: the captures of a design do not determine a model.
    """
    seed = bench.recipe.bench.seed

    def spread_of(count: int) -> Design:
        return spread(bench.truth.eye_box, bench.field_reach, count)

    say("fitting the captures of a pilot session")
    pilot = PlannedFit.to(simulated_captures(bench, spread_of(min(PILOT_PLACES, most)).unit, seed))
    predictor = DesignPredictor(bench, pilot, EyeTests.of(bench.truth, seed))
    say("predicting designs")
    by_family = {
        SPREAD: _bisected(predictor, [spread_of(count) for count in range(LEAST_PLACES, most + 1)], accuracy_arcmin),
    }
    by_family[CHOSEN] = _chosen(predictor, min(most, _smallest(by_family, accuracy_arcmin)), accuracy_arcmin)
    enough = [each for tried in by_family.values() for each in tried if each.p95 <= accuracy_arcmin]
    every = [each for tried in by_family.values() for each in tried]
    best = (
        min(enough, key=lambda each: (len(each.design), each.p95)) if enough else min(every, key=lambda each: each.p95)
    )
    for trial in range(_TRIALS):
        say(f"simulating the session: {len(best.design)} camera places")
        fit = PlannedFit.to(simulated_captures(bench, best.design.unit, seed + 1))
        simulated = predictor.simulated(fit)
        reaches = best.p95 <= accuracy_arcmin and simulated.registration.p95 <= _AGREES * accuracy_arcmin
        more = min(most, int(np.ceil(_MORE * len(best.design))))
        if reaches or not enough or more == len(best.design) or trial == _TRIALS - 1:
            break
        # A fit to few places must also estimate the smoothness of the optics, which the prediction takes as known.
        best = _predicted(predictor, spread_of(more))
        by_family[SPREAD] = (*by_family[SPREAD], best)
    say("predicting what limits the accuracy")
    # The apparent smoothness of the optics depends on the number of places: use this design's session as the pilot.
    predictor = replace(predictor, pilot=fit)
    best = _predicted(predictor, best.design)
    return DesignSearch(predictor, by_family, best, simulated, _limits(predictor, best.design), reaches)


def _predicted(predictor: DesignPredictor, design: Design) -> PredictedDesign:
    return PredictedDesign(design, predictor.errors(design.unit))


def _bisected(
    predictor: DesignPredictor, designs: Sequence[Design], accuracy_arcmin: float
) -> tuple[PredictedDesign, ...]:
    """Search the designs, sorted by size, for the first that reaches the accuracy; return all predictions made."""
    tried: dict[int, PredictedDesign] = {}

    def reaches(number: int) -> bool:
        tried[number] = _predicted(predictor, designs[number])
        return tried[number].p95 <= accuracy_arcmin

    low, high, step, last = -1, 0, max(1, len(designs) // _FIRST_STEP), len(designs) - 1
    while high <= last and not reaches(high):
        low, high, step = high, last + 1 if high == last else min(high + step, last), 2 * step
    while high <= last and high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if reaches(middle) else (middle, high)
    return tuple(sorted(tried.values(), key=lambda each: len(each.design)))


def _smallest(by_family: Mapping[str, tuple[PredictedDesign, ...]], accuracy_arcmin: float) -> int:
    """Return the number of places of the smallest design that reaches the accuracy, or else of the largest."""
    every = [each for tried in by_family.values() for each in tried]
    enough = [len(each.design) for each in every if each.p95 <= accuracy_arcmin]
    return min(enough) if enough else max(len(each.design) for each in every)


def _chosen(predictor: DesignPredictor, most: int, accuracy_arcmin: float) -> tuple[PredictedDesign, ...]:
    """Search for the smallest chosen design that reaches the accuracy; return all predictions made."""
    tried: dict[int, PredictedDesign] = {}
    tail, (_, errors) = 2.0, _choice(predictor, most)[0].one_by_one(most)
    for _ in range(_GUESSES):
        # Errors from the choice are cheap; predicted errors of a design need a posterior and its low-rank factors.
        enough = [count for count in range(LEAST_PLACES, most) if tail * errors[count - 1] <= accuracy_arcmin]
        count = enough[0] if enough else most
        if count in tried:
            break
        tried[count] = _predicted(predictor, chosen_design(predictor, count))
        tail = tried[count].p95 / errors[count - 1]
    return tuple(tried[count] for count in sorted(tried))


def chosen_design(predictor: DesignPredictor, count: int) -> Design:
    """Return the design of `count` places chosen by the pilot's posterior, at least as good as a regular spread."""
    choice, unit = _choice(predictor, count)
    taken = choice.chosen(count, start=range(len(unit) - count, len(unit)))
    return Design(f"{CHOSEN} {count}", unit[taken])


def _choice(predictor: DesignPredictor, count: int) -> tuple[PlaceChoice, FloatArray]:
    """Return the choice, and its places (n, 3), see `Design.unit`; the last `count` are a regular spread."""
    bench = predictor.bench
    box, reach = bench.truth.eye_box, bench.field_reach
    unit = np.concatenate([offered(box, reach, bench.in_depth), spread(box, reach, count).unit])
    depths = bench.recipe.bench.target_depths_m
    return PlaceChoice.of(predictor.pilot, bench.places(unit), depths, is_added=False), unit


def _limits(predictor: DesignPredictor, design: Design) -> dict[str, DesignErrors]:
    """Return the predicted errors for single changes of the bench or the design, by the name of the change."""
    bench, unit = predictor.bench, design.unit
    now_m = bench.recipe.bench.target_depths_m
    depths = (
        *now_m,
        further_distance(predictor.pilot, bench.places(unit), now_m, is_added=False)[0],
    )
    twice = spread(bench.truth.eye_box, bench.field_reach, 2 * len(design))
    return {
        "half the noise of dots and decoding": predictor.errors(unit, Scales(noise=0.5)),
        "half the repeatability and random turns": predictor.errors(unit, Scales(random=0.5, smooth=0.5)),
        "four times the photographs without the headset": predictor.errors(unit, Scales(smooth=0.5)),
        f"one more target, at {depths[-1]:g} m": predictor.errors(unit, depths_m=depths),
        f"twice the camera places, {len(twice)}": predictor.errors(twice.unit),
    }

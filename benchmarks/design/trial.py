"""One trial: a pilot session chooses camera positions, and another session is simulated and fitted for each design."""

from dataclasses import dataclass, replace
from typing import Any

from wlr_render.jobs.plan.plan import PlanOptions
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.planning.designs import CHOSEN, SPREAD, spread
from wlr_render.planning.planned_bench import PlannedBench, ReadingOptions
from wlr_render.planning.planned_errors import DesignPredictor, EyeTests, PlannedFit, simulated_captures
from wlr_render.planning.search import PILOT_PLACES, chosen_design

FEW, MANY = 16, 25
"""Numbers of camera positions."""
DESIGNS = (f"{SPREAD} {FEW}", f"{SPREAD} {MANY}", f"{CHOSEN} {FEW}")
"""Names of the designs that are compared."""


@dataclass(frozen=True)
class DesignTrial:
    """A simulated session of a headset; for `in_depth` see `PlannedBench`."""

    headset: str
    in_depth: bool
    number: int

    @property
    def file(self) -> str:
        """Name of the outcome's file."""
        return f"design-{self.headset}-{'depth' if self.in_depth else 'plane'}-{self.number:03d}.json"


@dataclass(frozen=True)
class DesignOutcome:
    """Outcome of a trial.

    Attributes:
        trial: the session.
        p95: 95th percentile of the registration error over the eye box, arcminutes, by name of the design.
    """

    trial: DesignTrial
    p95: dict[str, float]


def loaded_outcome(trial: DesignTrial, content: dict[str, Any]) -> DesignOutcome:
    """Return the outcome of a trial from its JSON fields."""
    return DesignOutcome(trial, {name: float(content["p95"][name]) for name in DESIGNS})


def run_trial(trial: DesignTrial, seed: int) -> DesignOutcome:
    """Run a trial; the same seed gives the same outcome.

    Each trial has its own pilot session, so that the scatter of trials includes the randomness of the chosen positions.
    """
    recipe = PlanOptions(trial.headset).recipe
    built = recipe.build()
    truth = replace(traced_eye(built.device, recipe.eye), name=built.device.name)
    bench = PlannedBench(truth, recipe, ReadingOptions(), built, trial.in_depth)
    box, reach, number = truth.eye_box, bench.field_reach, 2 * (1000 * (seed - 1) + trial.number)
    pilot = PlannedFit.to(simulated_captures(bench, spread(box, reach, PILOT_PLACES).unit, number))
    predictor = DesignPredictor(bench, pilot, EyeTests.of(truth, seed))
    p95 = {}
    for design in (spread(box, reach, FEW), spread(box, reach, MANY), chosen_design(predictor, FEW)):
        fit = PlannedFit.to(simulated_captures(bench, design.unit, number + 1))
        p95[design.name] = predictor.simulated(fit).registration.p95
    return DesignOutcome(trial, p95)

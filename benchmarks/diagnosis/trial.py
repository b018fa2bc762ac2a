"""One trial: simulate a session with hidden effects, diagnose it, and compare with the truth."""

import tempfile
import time
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from oracle.captures import Plan
from oracle.devices import NAMES
from oracle.effects import (
    LISTED_AT_RUN_TIME,
    OUTLIER,
    Effect,
    draw_effect,
    draw_outlier,
)
from oracle.run_time import RunTimePlan
from oracle.session_writer import write_run_time_session, write_session

from benchmarks.diagnosis.remainder import remainder
from benchmarks.diagnosis.truths import truth_of
from wlr_render.captures.session import Session
from wlr_render.diagnosis.diagnosis import Diagnosis
from wlr_render.diagnosis.observations import PART_NAMES, SEE_THROUGH, CaptureName, observe
from wlr_render.diagnosis.procedure import diagnose
from wlr_render.diagnosis.settings import Settings
from wlr_render.simulation.bench import Bench
from wlr_render.simulation.session_folder import load_session
from wlr_render.simulation.simulate_session import simulate

AnyPlan = Plan | RunTimePlan

_GRID, _COLOUR_GRID, _DOTS = (12, 9), (8, 6), (9, 6)
_IN_COLOUR = 0.25  # of the sessions, besides those whose effect is one of colour
_SIGMA_PX = (0.05, 0.2)
_SUBSAMPLE = 2000  # about a third of the readings, as in a session of full size


class TrialKind(StrEnum):
    """What is hidden."""

    CLEAN = "nothing"
    CLEAN_RUN_TIME = "nothing, at run time"
    ONE = "one cause"
    TWO = "two causes"
    UNLISTED = "an effect that no cause stands for"
    MOVED = "one cause and a capture that moved"


@dataclass(frozen=True)
class DiagnosisTrial:
    """What is to be hidden; everything else is drawn.

    Attributes:
        kind: see `TrialKind`.
        effects: names of the effects, but for that of a capture that moved.
        number: tells trials alike from each other.
    """

    kind: TrialKind
    effects: tuple[str, ...]
    number: int

    @property
    def at_run_time(self) -> bool:
        """Whether its session is one of glasses that run."""
        return self.kind is TrialKind.CLEAN_RUN_TIME or not set(self.effects).isdisjoint(LISTED_AT_RUN_TIME)

    def generator(self, seed: int) -> np.random.Generator:
        """Random numbers that depend on the study's seed and this trial alone."""
        name = "/".join((self.kind, *self.effects))
        return np.random.default_rng([seed, zlib.crc32(name.encode()), self.number])


@dataclass(frozen=True)
class DiagnosisOutcome:
    """What became of a trial.

    Attributes:
        trial: which.
        device: name of the headset.
        amounts: of the hidden effects, in order, as the generator has them.
        verdict: of the diagnosis.
        named: causes, most important first.
        depends_on: what is left unexplained depends on this; empty where nothing is.
        excluded: excluded captures.
        moved: the captures that truly moved.
        deviations: (estimate - truth) / sigma of every parameter of the hidden causes, where exactly those were named.
        size: rms change of the readings by all that is hidden, in units of sigma.
        remainder: see `remainder.remainder`; one for each hidden cause, none for effects that no cause stands for.
        held_out: rms residual of a second session of the same bench by the corrected bench, in units of sigma.
        seconds: that the diagnosis took.
    """

    trial: DiagnosisTrial
    device: str
    amounts: tuple[dict[str, float], ...]
    verdict: str
    named: tuple[str, ...]
    depends_on: str
    excluded: tuple[str, ...]
    moved: tuple[str, ...]
    deviations: tuple[float, ...]
    size: float
    remainder: tuple[float, ...]
    held_out: float
    seconds: float

    @property
    def exact(self) -> bool:
        """Whether the hidden causes were named and no other."""
        return sorted(self.named) == sorted(self.trial.effects)

    @property
    def first(self) -> str:
        """The first cause named, else the verdict."""
        return self.named[0] if self.named else self.verdict


def run_trial(trial: DiagnosisTrial, seed: int) -> DiagnosisOutcome:
    """Run one trial; the same seed gives the same outcome."""
    rng = trial.generator(seed)
    plan = _plan(trial, rng)
    effects = [draw_effect(name, rng) for name in trial.effects]
    moved = [draw_outlier(plan, rng)] if trial.kind is TrialKind.MOVED and isinstance(plan, Plan) else []
    nominal, session = observed(plan, [*effects, *moved], rng)
    start = time.perf_counter()
    said = diagnose(nominal, session, settings=Settings(subsample=_SUBSAMPLE))
    seconds = time.perf_counter() - start
    hidden = trial.effects if trial.kind in (TrialKind.ONE, TrialKind.TWO) else ()
    return DiagnosisOutcome(
        trial,
        plan.device,
        tuple(dict(effect.amount) for effect in [*effects, *moved]),
        said.verdict,
        tuple(cause.name for cause in said.causes),
        said.unexplained.depends_on if said.unexplained else "",
        tuple(str(moved_capture.capture) for moved_capture in said.excluded),
        tuple(_capture_name(effect) for effect in moved),
        _deviations(said, effects, plan),
        float(np.sqrt(max(0.0, said.before.over_noise**2 - 1.0))),
        tuple(remainder(said, hidden, name) for name in hidden),
        _held_out(said.corrected, observed(plan, effects, rng)[1]),
        seconds,
    )


def observed(plan: AnyPlan, effects: Sequence[Effect], rng: np.random.Generator) -> tuple[Bench, Session]:
    """What the makers of a bench with hidden effects believe it to be, and what they measure."""
    with tempfile.TemporaryDirectory() as folder:
        if isinstance(plan, RunTimePlan):
            write_run_time_session(folder, plan, effects, rng)
        else:
            write_session(folder, plan, effects, rng)
        return load_session(folder)


def _plan(trial: DiagnosisTrial, rng: np.random.Generator) -> AnyPlan:
    device = NAMES[rng.integers(len(NAMES))]
    sigma_px = float(np.round(np.exp(rng.uniform(*np.log(_SIGMA_PX))), 4))
    if trial.at_run_time:
        return RunTimePlan(device, sigma_px=sigma_px)
    if rng.uniform() < _IN_COLOUR or "lateral_colour" in trial.effects:
        return Plan(device, _COLOUR_GRID, _DOTS, sigma_px=sigma_px, channels=(0, 1, 2))
    return Plan(device, _GRID, _DOTS, sigma_px=sigma_px)


def _capture_name(moved: Effect) -> str:
    assert moved.name == OUTLIER
    pose, number = int(moved.amount["target_pose"]), int(moved.amount["capture"])
    return str(CaptureName(PART_NAMES.index("display") if pose < 0 else SEE_THROUGH, pose, number))


def _deviations(said: Diagnosis, effects: Sequence[Effect], plan: AnyPlan) -> tuple[float, ...]:
    hidden = {effect.name: truth_of(effect, plan) for effect in effects}
    if sorted(hidden) != sorted(cause.name for cause in said.causes):
        return ()
    return tuple(
        (parameter.value - hidden[cause.name][parameter.name]) / parameter.sigma
        for cause in said.causes
        for parameter in cause.parameters
        if parameter.sigma > 0.0 and parameter.name in hidden[cause.name]
    )


def _held_out(corrected: Bench, session: Session) -> float:
    observations = observe(corrected, session)
    residual = observations.residual(simulate(corrected, observations.session.plan))
    return float(np.sqrt(np.mean(residual**2)))

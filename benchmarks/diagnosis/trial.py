"""One trial: simulate a session with hidden effects, diagnose it, and compare with the truth."""

import tempfile
import time
import zlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from typing import Any

import numpy as np
from oracle.captures import Plan
from oracle.devices import NAMES, own_device
from oracle.effects import (
    LISTED_AT_RUN_TIME,
    OUTLIER,
    UNLISTED_AT_RUN_TIME,
    Effect,
    draw_effect,
    draw_late_slip,
    draw_outlier,
    draw_outliers,
)
from oracle.nature import PERFECT, BenchNature
from oracle.run_time import RunTimePlan
from oracle.session_writer import write_run_time_session, write_session

from benchmarks.diagnosis.conditions import Condition, nature_of
from benchmarks.diagnosis.remainder import remainder
from benchmarks.diagnosis.truths import truth_of
from wlr_render.bench.bench import Bench
from wlr_render.bench.session_folder import load_session
from wlr_render.bench.simulate_session import simulate
from wlr_render.captures.session import Session
from wlr_render.diagnosis.causes import CAUSES
from wlr_render.diagnosis.noise import noise_of
from wlr_render.diagnosis.observations import PART_NAMES, SEE_THROUGH, CaptureName
from wlr_render.diagnosis.prediction import Explanation, Predictor
from wlr_render.diagnosis.procedure import diagnose
from wlr_render.diagnosis.report import Diagnosis
from wlr_render.diagnosis.settings import Settings
from wlr_render.diagnosis.weighed_readings import WeighedReadings
from wlr_render.errors import BadInputError
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.scatter import Scatter
from wlr_render.optics.assembly import combiner_middle

AnyPlan = Plan | RunTimePlan

_GRID, _COLOUR_GRID, _DOTS = (12, 9), (8, 6), (9, 6)
_LARGE, _SMALL, _EIGHTEEN = (6, 12), (4, 8), (4, 2)  # nodes per axis and captures off the plane
_IN_COLOUR = 0.25  # share of sessions in colour, in addition to those with a colour effect
_SIGMA_PX = (0.05, 0.2)
_MOST_MOVED = 6
_LATE = 2  # number of captures after a late slip
_LEAST_UNITS = 0.1  # smallest motion, micrometres and microradians
_SUBSAMPLE = 2000  # number of readings, about a third, as in a session of full size
_UNLISTED_SIGMA = (3.0, 10.0)  # range of the rms change of readings that an unlisted effect changes, in sigma
_CHANGED, _LARGEST = 0.1, 0.99  # share of the largest change from which a reading is used; quantile of the largest


class TrialKind(StrEnum):
    """Kind of the hidden effects."""

    CLEAN = "nothing"
    CLEAN_RUN_TIME = "nothing, at run time"
    ONE = "one cause"
    TWO = "two causes"
    THREE = "three causes"
    LATE_SLIP = "a slip before the last two captures"
    UNLISTED = "an effect outside the list of causes"
    UNLISTED_BESIDE = "an effect outside the list of causes, and a cause at another station"
    MOVED = "one cause and a capture that moved"
    MOVED_MANY = "1 to 6 of 18 captures of the display that moved"


JUDGED_BY_REMAINDER = (
    TrialKind.ONE,
    TrialKind.TWO,
    TrialKind.THREE,
    TrialKind.LATE_SLIP,
    TrialKind.UNLISTED_BESIDE,
)
"""Kinds of trials in which a diagnosis has to find all causes whose residual no other cause explains well enough."""


@dataclass(frozen=True)
class DiagnosisTrial:
    """Hidden effects of a trial; everything else is drawn.

    Attributes:
        kind: see `TrialKind`.
        effects: names of the effects, except captures that moved.
        number: distinguishes equal trials. Late slips happen before the last captures of the session in odd trials, and
            before the last display captures in even trials.
        condition: condition of the bench.
    """

    kind: TrialKind
    effects: tuple[str, ...]
    number: int
    condition: Condition = Condition.WHITE

    @property
    def causes(self) -> tuple[str, ...]:
        """Names of the effects that are listed causes."""
        return tuple(name for name in self.effects if name in CAUSES)

    @property
    def file(self) -> str:
        """Name of the outcome's file."""
        return f"{'-'.join((self.kind.name.lower(), self.condition, *self.effects))}-{self.number:04d}.json"

    @property
    def at_run_time(self) -> bool:
        """True if the session is a run-time recording."""
        at_run_time = {*LISTED_AT_RUN_TIME, *UNLISTED_AT_RUN_TIME}
        return self.kind is TrialKind.CLEAN_RUN_TIME or not at_run_time.isdisjoint(self.effects)

    def generator(self, seed: int) -> np.random.Generator:
        """Return a generator of random numbers that depend on the study's seed and this trial alone."""
        name = "/".join((self.kind, self.condition, *self.effects))
        return np.random.default_rng([seed, zlib.crc32(name.encode()), self.number])


@dataclass(frozen=True)
class DiagnosisOutcome:
    """Outcome of a trial.

    Attributes:
        trial: the trial.
        device: name of the headset.
        nature: nature of the bench, see `oracle.nature.BenchNature`.
        amounts: amounts of the hidden effects, in order, in the generator's units.
        verdict: verdict of the diagnosis, or the error that ended it.
        named: named causes, most important first.
        stations: stations of the effects that were located, best odds first.
        excluded: excluded captures.
        moved: the captures that truly moved.
        deviations: (estimate - truth) / sigma of every parameter of the hidden causes, if exactly these were named.
        size: rms change of the readings by the effects, in units of sigma.
        remainder: see `remainder.remainder`; one for each hidden cause if the kind is in `JUDGED_BY_REMAINDER`.
        held_out: rms residual of a second session of the bench against the corrected bench, in units of sigma; that
            session has white noise of the stated size, whatever the condition.
        seconds: duration of the diagnosis.
        again: verdict on the same session with the corrected bench, if only an unlisted effect was hidden; empty if
            nothing was corrected.
        place_off: distance of a bubble from its stated position, over its radius; None for other effects.
    """

    trial: DiagnosisTrial
    device: str
    nature: dict[str, float]
    amounts: tuple[dict[str, float], ...]
    verdict: str
    named: tuple[str, ...]
    stations: tuple[str, ...]
    excluded: tuple[str, ...]
    moved: tuple[str, ...]
    deviations: tuple[float, ...]
    size: float
    remainder: tuple[float, ...]
    held_out: float
    seconds: float
    again: str = ""
    place_off: float | None = None

    @property
    def exact(self) -> bool:
        """True if exactly the hidden causes were named."""
        return sorted(self.named) == sorted(self.trial.causes)

    @property
    def first(self) -> str:
        """The first named cause, else the verdict."""
        return self.named[0] if self.named else self.verdict


def run_trial(trial: DiagnosisTrial, seed: int) -> DiagnosisOutcome:
    """Run one trial; the same seed gives the same outcome. A diagnosis that ends in an error is also an outcome."""
    rng = trial.generator(seed)
    nature, plan = nature_of(trial.condition, rng), _plan(trial, rng)
    effects, moved = _effects(trial, plan, rng), _moved(trial, plan, rng)
    if trial.kind in (TrialKind.UNLISTED, TrialKind.UNLISTED_BESIDE):
        effects[0] = _of_size(effects[0], plan, rng)
    nominal, session = observed(plan, [*effects, *moved], rng, nature)
    of_bench = observed(plan, effects, rng)[1]
    outcome = DiagnosisOutcome(
        trial,
        plan.device,
        {name: value for name, value in asdict(nature).items() if value != getattr(PERFECT, name)},
        tuple(dict(effect.amount) for effect in [*effects, *moved]),
        verdict="",
        named=(),
        stations=(),
        excluded=(),
        moved=tuple(_capture_name(effect) for effect in moved),
        deviations=(),
        size=float(np.sqrt(max(0.0, _rms(nominal, of_bench) ** 2 - 1.0))),
        remainder=(np.inf,) * len(trial.causes) if trial.kind in JUDGED_BY_REMAINDER else (),
        held_out=np.nan,
        seconds=np.nan,
    )
    start = time.perf_counter()
    try:
        said = diagnose(nominal, session, settings=Settings(subsample=_SUBSAMPLE))
    except (BadInputError, np.linalg.LinAlgError) as error:
        return replace(outcome, verdict=f"{type(error).__name__}: {error}")
    seconds = time.perf_counter() - start
    again = trial.kind is TrialKind.UNLISTED and said.is_corrected
    return replace(
        outcome,
        verdict=said.verdict,
        named=tuple(cause.name for cause in said.causes),
        stations=tuple(effect.station for effect in said.effects),
        excluded=tuple(str(moved_capture.capture) for moved_capture in said.excluded),
        deviations=_deviations(said, [effect for effect in effects if effect.name in CAUSES], plan),
        remainder=_remainders(_readings(trial, said, effects, plan, nature), trial, nature),
        held_out=_rms(said.corrected, of_bench),
        seconds=seconds,
        again=diagnose(said.corrected, session, settings=Settings(subsample=_SUBSAMPLE)).verdict if again else "",
        place_off=_place_off(said, effects, plan) if trial.effects == ("combiner_bubble",) else None,
    )


def loaded_outcome(trial: DiagnosisTrial, content: dict[str, Any]) -> DiagnosisOutcome:
    """Return the outcome of a trial from its JSON fields, which have lists in place of tuples."""
    fields: dict[str, Any] = {name: tuple(v) if isinstance(v, list) else v for name, v in content.items()}
    return DiagnosisOutcome(**{**fields, "trial": trial})


def observed(
    plan: AnyPlan, effects: Sequence[Effect], rng: np.random.Generator, nature: BenchNature = PERFECT
) -> tuple[Bench, Session]:
    """Simulate a bench with hidden effects; return the nominal bench and the measured session."""
    with tempfile.TemporaryDirectory() as folder:
        if isinstance(plan, RunTimePlan):
            write_run_time_session(folder, plan, effects, rng, nature)
        else:
            write_session(folder, plan, effects, rng, nature)
        return load_session(folder)


def _plan(trial: DiagnosisTrial, rng: np.random.Generator) -> AnyPlan:
    device = NAMES[rng.integers(len(NAMES))]
    sigma_px = float(np.round(np.exp(rng.uniform(*np.log(_SIGMA_PX))), 4))
    if trial.at_run_time:
        return RunTimePlan(device, sigma_px=sigma_px)
    nodes, off_plane = _EIGHTEEN if trial.kind is TrialKind.MOVED_MANY else (_LARGE, _SMALL)[rng.integers(2)]
    if rng.uniform() < _IN_COLOUR or "lateral_colour" in trial.effects:
        return Plan(device, _COLOUR_GRID, _DOTS, nodes, off_plane, sigma_px, channels=(0, 1, 2))
    return Plan(device, _GRID, _DOTS, nodes, off_plane, sigma_px)


def _effects(trial: DiagnosisTrial, plan: AnyPlan, rng: np.random.Generator) -> list[Effect]:
    if trial.kind is TrialKind.LATE_SLIP and isinstance(plan, Plan):
        return [draw_late_slip(plan, rng, _LATE, of_session=trial.number % 2 == 1)]
    return [draw_effect(name, rng) for name in trial.effects]


def _moved(trial: DiagnosisTrial, plan: AnyPlan, rng: np.random.Generator) -> Sequence[Effect]:
    if trial.kind is TrialKind.MOVED and isinstance(plan, Plan):
        return [draw_outlier(plan, rng)]
    if trial.kind is TrialKind.MOVED_MANY and isinstance(plan, Plan):
        return draw_outliers(plan, rng, 1 + trial.number % _MOST_MOVED)
    return ()


def _of_size(effect: Effect, plan: AnyPlan, rng: np.random.Generator) -> Effect:
    """Scale an effect so that the readings that it changes are off by 3 to 10 sigma, rms per axis."""
    nominal, session = observed(plan, [effect], np.random.default_rng(0), BenchNature(noise_factor=0.0))
    square = np.mean(_residual(nominal, session) ** 2, axis=1)
    changed = float(np.sqrt(np.mean(square[square > _CHANGED**2 * np.quantile(square, _LARGEST)])))
    return effect.scaled(float(np.exp(rng.uniform(*np.log(_UNLISTED_SIGMA)))) / changed)


def _readings(
    trial: DiagnosisTrial, said: Diagnosis, effects: Sequence[Effect], plan: AnyPlan, nature: BenchNature
) -> WeighedReadings:
    """Return the readings that must distinguish causes: the diagnosis' readings if no unlisted effect acts."""
    if trial.kind is not TrialKind.UNLISTED_BESIDE:
        return said.readings
    listed = [effect for effect in effects if effect.name in CAUSES]
    predictor = Predictor.of_session(*observed(plan, listed, np.random.default_rng(0), nature))
    noise = noise_of(predictor.observations, predictor.residual(Explanation()))
    return WeighedReadings.of(predictor.with_sigma(noise.sigma_px).of_rows(~noise.outlier), noise)


def _remainders(readings: WeighedReadings, trial: DiagnosisTrial, nature: BenchNature) -> tuple[float, ...]:
    """Return the `remainder` of each hidden cause."""
    if trial.kind not in JUDGED_BY_REMAINDER:
        return ()
    shift, turn = (max(each, _LEAST_UNITS) for each in (1e3 * nature.repeatability_mm, 1e6 * nature.turns_rad))
    usual = Scatter.usual(len(readings.observations.captures))
    scatter = replace(usual, shift_um=np.full(3, shift), turn_urad=np.full(3, turn))
    return tuple(remainder(readings, scatter, trial.causes, name) for name in trial.causes)


def _place_off(said: Diagnosis, effects: Sequence[Effect], plan: AnyPlan) -> float:
    """Return the distance of a bubble from its stated position, over its radius; infinite if no position is stated."""
    place = next((effect.place for effect in said.effects if effect.station == "combiner"), None)
    if place is None:
        return float("inf")
    bubble, pivot = effects[0].amount, own_device(plan.device).pivot * [1.0, -1.0, -1.0]
    middle = 1e3 * combiner_middle(said.observations.nominal.optics)
    off = (pivot - middle)[:2] + [bubble["x_mm"], -bubble["y_mm"]] - np.array(place)
    return float(np.linalg.norm(off)) / bubble["radius_mm"]


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


def _rms(bench: Bench, session: Session) -> float:
    """Return the rms residual of a session against a bench, in units of sigma."""
    return float(np.sqrt(np.mean(_residual(bench, session) ** 2)))


def _residual(bench: Bench, session: Session) -> FloatArray:
    observations = Predictor.of_session(bench, session).observations
    return observations.residual(simulate(bench, observations.session.plan))

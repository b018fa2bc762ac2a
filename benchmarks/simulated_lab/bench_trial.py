"""One trial: simulate the readings of a session, calibrate the bench, and compare it with the truth."""

import time
import zlib
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

import numpy as np

from benchmarks.simulated_lab.bench_models import model_errors
from benchmarks.simulated_lab.bench_sigmas import SquaredErrors, errors_over_sigma
from benchmarks.simulated_lab.faults import NO_FAULTS, BoardMove, Exchange, Faults, HeadsetSlip, Shift
from benchmarks.simulated_lab.simulate_readings import SimulatedReadings, simulate_readings
from wlr_render.calibration.bench.calibrate_bench import CalibratedBench, calibrate_bench
from wlr_render.calibration.photograph_captures import sound_captures
from wlr_render.errors import BadInputError
from wlr_render.planning.planned_bench import ReadingOptions
from wlr_render.simulation.photographs.photo_bench import Family, PhotoBenchOptions
from wlr_render.simulation.photographs.recipe import SimulationRecipe

DEVICES = ("northstar", "freeform40", "birdbath28")

_SHIFT_MM, _TURN_DEG, _AXIS_DEG = (0.5, 2.0), (0.05, 0.2), 2.0
_DOTS, _SAMPLES = ReadingOptions.most_dots, ReadingOptions.panel_samples
_NOTHING: tuple[tuple[str, ...], ...] = ()
_APART_M = 1e-3  # smallest difference of readings that are exchanged


class BenchTrialKind(StrEnum):
    """Purpose of a simulated session."""

    CLEAN = "clean"
    MODELS = "models"
    MOVED = "board moved before the sweep"
    MOVED_IN_SWEEP = "board moved during a sweep"
    SLIPPED = "headset slipped during a sweep"
    BARE_EXCHANGED = "photographs without the headset exchanged"
    SEEN_EXCHANGED = "photographs through the optics exchanged"
    AXIS = "stage axis 2 degrees off"


FAULTY = tuple(BenchTrialKind)[2:]


@dataclass(frozen=True)
class BenchTrial:
    """A simulated session.

    Attributes:
        kind: the fault, or the measurement.
        number: number of the session; devices alternate.
        family: family of the errors of stage, board, lenses and warm-up.
        dots: largest number of dots per photograph.
    """

    kind: BenchTrialKind
    number: int
    family: Family = "polynomial"
    dots: int = ReadingOptions.most_dots

    @property
    def device(self) -> str:
        """Name of the headset."""
        return DEVICES[self.number % len(DEVICES)]

    @property
    def file(self) -> str:
        """Name of the outcome's file."""
        return f"{self.kind.replace(' ', '-')}-{self.number:03d}-{self.device}-{self.family}-{self.dots}.json"


@dataclass(frozen=True)
class FailedCheck:
    """A check that is not ok, or an excluded photograph."""

    step: str
    quantity: str
    sentence: str
    contradictory: bool = False


@dataclass(frozen=True)
class BenchOutcome:
    """Outcome of a trial.

    Attributes:
        trial: the simulated trial.
        truth: description of the fault.
        failed: checks that are not ok.
        excluded: photographs excluded from the captures.
        refused: error that stopped the calibration; "" if there was none.
        named: True if the fault is named.
        first: True if it is the only named fault.
        sigmas: errors over stated sigmas, by kind of unknown.
        sizes: variance components of the stage, by name.
        errors: rms errors of the models, by side and source.
        seconds: time of the bench calibration on one processor.
    """

    trial: BenchTrial
    truth: str = ""
    failed: list[FailedCheck] = field(default_factory=list)
    excluded: list[FailedCheck] = field(default_factory=list)
    refused: str = ""
    named: bool = False
    first: bool = False
    sigmas: dict[str, SquaredErrors] = field(default_factory=dict)
    sizes: dict[str, float] = field(default_factory=dict)
    errors: dict[str, dict[str, float]] = field(default_factory=dict)
    seconds: float = 0.0

    @property
    def accepted(self) -> bool:
        """True if the calibration continues."""
        return not self.refused and not any(check.contradictory for check in self.failed)


def loaded_outcome(trial: BenchTrial, content: dict[str, Any]) -> BenchOutcome:
    """Return the outcome of a trial from its JSON fields."""
    content["trial"] = trial
    for name in ("failed", "excluded"):
        content[name] = [FailedCheck(**each) for each in content[name]]
    content["sigmas"] = {name: SquaredErrors(**each) for name, each in content["sigmas"].items()}
    return BenchOutcome(**content)


def run_bench_trial(trial: BenchTrial, seed: int) -> BenchOutcome:
    """Run a trial; the same seed gives the same outcome."""
    bench_seed = int(np.random.default_rng([seed, zlib.crc32(trial.kind.encode()), trial.number]).integers(1, 2**31))
    if trial.kind in (BenchTrialKind.CLEAN, BenchTrialKind.MODELS):
        bench_seed = 1000 * seed + trial.number
    recipe = SimulationRecipe(trial.device, bench=PhotoBenchOptions(seed=bench_seed, family=trial.family))
    options = ReadingOptions(most_dots=trial.dots, panel_samples=_SAMPLES * trial.dots // _DOTS)
    faults, truth, wanted = NO_FAULTS, "", _NOTHING
    if trial.kind in FAULTY:
        clean = simulate_readings(recipe, options)
        faults, truth, wanted = _fault(trial.kind, clean, np.random.default_rng([bench_seed, 77]))
    simulated = simulate_readings(recipe, options, faults=faults)
    outcome = BenchOutcome(trial, truth)
    begun = time.process_time()
    try:
        bench = calibrate_bench(simulated.session, simulated.reading)
    except BadInputError as error:
        failed = [FailedCheck("", "", str(error))]
        return _judged(replace(outcome, refused=str(error)), failed, wanted)
    seconds = time.process_time() - begun
    sizes = bench.adjustment.sizes
    found = dict(sizes.by)
    found |= {f"noise {name}": value for name, value in sizes.noise.items()}
    found |= {f"features {name}": value for name, value in sizes.feature_m.items()}
    found |= {f"kind {name}": float(len(each.lens.names)) for name, each in bench.lenses.items()}
    failed = [FailedCheck(c.step, c.quantity, c.sentence, c.contradictory) for c in bench.checks if not c.ok]
    outcome = replace(outcome, failed=failed, seconds=seconds, sizes=found)
    if trial.kind is BenchTrialKind.CLEAN:
        outcome = replace(outcome, sigmas=errors_over_sigma(bench, simulated.truth))
    if trial.kind is BenchTrialKind.MODELS:
        outcome = replace(outcome, errors=model_errors(bench, simulated, seed))
    if trial.kind in (BenchTrialKind.MODELS, BenchTrialKind.SEEN_EXCHANGED):
        outcome = replace(outcome, excluded=_excluded(bench, simulated))
    return _judged(outcome, [*failed, *outcome.excluded], wanted)


def _excluded(bench: CalibratedBench, simulated: SimulatedReadings) -> list[FailedCheck]:
    try:
        _, excluded = sound_captures(simulated.session, simulated.reading, bench)
    except BadInputError as error:
        return [FailedCheck("captures", "", str(error))]
    return [FailedCheck(each.name, "captures", f"{each.name}: {each.reason}") for each in excluded]


def _judged(outcome: BenchOutcome, said: list[FailedCheck], wanted: tuple[tuple[str, ...], ...]) -> BenchOutcome:
    """Record whether for each of `wanted` a sentence has all its words, and whether other sentences exist."""
    if outcome.trial.kind not in FAULTY:
        return outcome
    texts = [f"{each.step}: {each.sentence}" for each in said]
    hits = [[all(word in text for word in words) for text in texts] for words in wanted]
    return replace(
        outcome, named=all(map(any, hits)), first=bool(texts) and all(any(each) for each in zip(*hits, strict=True))
    )


def _fault(
    kind: BenchTrialKind, clean: SimulatedReadings, rng: np.random.Generator
) -> tuple[Faults, str, tuple[tuple[str, ...], ...]]:
    """Draw a fault; return it, its description, and the words that the report must contain."""
    session = clean.session
    poses = sorted({each.target_pose for each in session.see_through})
    sweep = len(session.see_through) // len(poses)
    pose, visit = int(rng.choice(poses)), int(rng.integers(1, sweep - 1))
    shift = _shift(rng)
    said = f"pose {pose}, by {np.linalg.norm(shift.mm):.2f} mm and {60 * np.linalg.norm(shift.deg):.1f}'"
    step = f"sweep at target pose {pose}"
    if kind is BenchTrialKind.MOVED:
        return (
            Faults(board_moved=BoardMove(pose, shift)),
            said,
            ((f"the target moved at pose {pose} between its photographs without the headset",),),
        )
    if kind is BenchTrialKind.MOVED_IN_SWEEP:
        fault = Faults(board_moved_in_sweep=BoardMove(pose, shift, visit))
        return fault, f"{said}, from visit {visit}", ((step, ": the target moved between"),)
    if kind is BenchTrialKind.SLIPPED:
        fault = Faults(headset_slipped=HeadsetSlip(pose, visit, shift))
        return fault, f"{said}, from visit {visit}", ((step, "the headset shifted between"),)
    if kind is BenchTrialKind.AXIS:
        off = _AXIS_DEG * float(rng.choice([-1.0, 1.0]))
        return Faults(axis_off_deg=off), f"{off:g} degrees", (("axes x and y",),)
    of = "bare" if kind is BenchTrialKind.BARE_EXCHANGED else "see_through"
    entries = getattr(session, of)
    while True:
        first, second = sorted(int(each) for each in rng.choice(len(entries), 2, replace=False))
        apart = np.linalg.norm(entries[first].stage - entries[second].stage)
        if apart > _APART_M:
            break
    names = entries[first].name, entries[second].name
    return (
        Faults(exchanged=Exchange(of, first, second)),
        f"{' and '.join(names)}, {1e3 * apart:.1f} mm",
        tuple((name,) for name in names),
    )


def _shift(rng: np.random.Generator) -> Shift:
    """Draw a shift in a random direction and a rotation about a random axis."""
    direction, axis = rng.standard_normal((2, 3))
    mm = rng.uniform(*_SHIFT_MM) * direction / np.linalg.norm(direction)
    deg = rng.uniform(*_TURN_DEG) * axis / np.linalg.norm(axis)
    return Shift((mm[0], mm[1], mm[2]), (deg[0], deg[1], deg[2]))

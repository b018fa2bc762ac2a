"""Trials: simulate captures of a traced device, fit a model to them, and measure its errors at random viewpoints."""

import hashlib
import json
import time
import zlib
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from enum import StrEnum
from functools import lru_cache, partial
from importlib import metadata
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from benchmarks.kept_trials import kept_outcome, outcome_folder
from benchmarks.moved_observations import displaced, straight_error
from wlr_render.calibration.fit_display import fit_display
from wlr_render.calibration.fit_report import AnyModel, ModelFit
from wlr_render.calibration.fit_see_through import fit_see_through
from wlr_render.captures.correspondences import AnyCaptures, SeeThroughCaptures
from wlr_render.evaluation import mapping_error
from wlr_render.evaluation.metrics import Summary, summary
from wlr_render.io.input_files import LIMITS, read_bytes
from wlr_render.mappings import Eye, EyeBox
from wlr_render.models.fitted_model import FittedDisplay, FittedSeeThrough
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device_file import device_path, load_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.simulation import viewpoints
from wlr_render.simulation.capture_setup import CaptureSetup, SeeThroughRays
from wlr_render.simulation.simulate_captures import simulate_display, simulate_see_through, with_camera_noise
from wlr_render.work.progress import Progress
from wlr_render.work.workers import WorkerPool, as_finished

AnyFit = ModelFit[FittedDisplay] | ModelFit[FittedSeeThrough]
BoxSize = tuple[float, float, float]
Simulate = Callable[[CaptureSetup, NDArray[np.float64], np.random.Generator], AnyCaptures]

TEST_VIEWPOINTS = 128
TEST_RAYS = 64
"""Number of test rays from each test viewpoint."""
NEAREST_M, FARTHEST_M = 0.3, 5.0
"""Nearest and farthest real points."""
BACK_M = 0.010
"""Distance by which viewpoints are moved back along their own rays."""


@dataclass(frozen=True)
class EvaluatedEye:
    """One eye of a device, its eye box, and its field of view.

    Attributes:
        device: a shipped device's name, or the path of its file.
        eye: "left" or "right".
        eye_box_mm: edge lengths of the eye box, about the centre of the device's own.
        whole_panel: True if the whole panel is captured and evaluated instead of the nominal field.
        name: name of the device.
    """

    device: str
    eye: str
    eye_box_mm: BoxSize
    whole_panel: bool = False
    name: str = field(default="", compare=False)

    def __str__(self) -> str:
        return f"{self.name} ({self.eye})"


# Exact tracing takes far longer than a fit, so each process traces a device, its captures and its test rays once.


@lru_cache
def truth(at: EvaluatedEye) -> Eye:
    """Return the traced eye."""
    device = load_device(at.device)
    eye = traced_eye(device, at.eye)
    box = EyeBox(eye.eye_box.centre, np.array(at.eye_box_mm) * 1e-3)
    return replace(eye, name=device.name, eye_box=box, field=None if at.whole_panel else eye.field)


@lru_cache
def capture_setup(at: EvaluatedEye) -> CaptureSetup:
    """Return a bench without errors whose camera sees the nominal field, if the device has one."""
    eye = truth(at)
    return CaptureSetup(eye, camera_field=eye.field)


@lru_cache(maxsize=32)
def exact_captures(simulate: Simulate[AnyCaptures], at: EvaluatedEye, kind: str, count: int) -> AnyCaptures:
    """Return noise-free captures."""
    setup = capture_setup(at)
    return simulate(setup, setup.camera_positions(kind, count), np.random.default_rng(0))


@lru_cache
def display_observations(at: EvaluatedEye, seed: int) -> mapping_error.DisplayObservations:
    """Return observations in the field, or of the whole panel, from random viewpoints, most off the base plane."""
    setup = capture_setup(at)
    rng = np.random.default_rng(seed)
    viewpoint = viewpoints.random_in_eye_box(setup.truth.eye_box, TEST_VIEWPOINTS, rng)[:, None]
    if setup.truth.field is None:
        pixel = rng.uniform(0.0, 1.0, (TEST_VIEWPOINTS, TEST_RAYS, 2)) * setup.truth.display.panel.size_px
        return mapping_error.observations_of_pixels(setup.truth.display, viewpoint, pixel)
    view_dir = setup.camera_dirs()[rng.integers(0, len(setup.camera_dirs()), (TEST_VIEWPOINTS, TEST_RAYS))]
    return mapping_error.observations_of_dirs(setup.truth.display, viewpoint, view_dir)


@lru_cache
def see_through_observations(at: EvaluatedEye, seed: int) -> mapping_error.SeeThroughObservations:
    """Return observations of real points in the directions of `display_observations`, at depths uniform in dioptres."""
    seen = display_observations(at, seed)
    dioptres = np.random.default_rng(seed + 1).uniform(1.0 / FARTHEST_M, 1.0 / NEAREST_M, len(seen.pixel))
    return mapping_error.see_through_observations(truth(at).see_through, seen.viewpoint, seen.view_dir, 1.0 / dioptres)


class Measure(StrEnum):
    """A kind of error, always at random viewpoints in the eye box.

    FORWARD: direction of a pixel. BACKWARD: pixel of a direction. REAL_POINT: direction of a real point. REAL_RAY:
    direction of the real ray of a view direction. MISS: distance of this ray from the real point. PREDICTED: standard
    error that the model predicts for FORWARD, or for REAL_POINT if it is a see-through model.
    """

    FORWARD = "forward (arcmin)"
    BACKWARD = "backward (px)"
    REAL_POINT = "real point (arcmin)"
    REAL_RAY = "real ray (arcmin)"
    MISS = "miss (mm)"
    PREDICTED = "predicted (arcmin)"


@dataclass(frozen=True)
class FoundBench:
    """Bench errors estimated by a fit, standard deviations per axis.

    Attributes:
        noise_arcmin: noise of a reading.
        repeatability_um, wobble_urad: random shift and rotation of the camera at each visit of a position.
    """

    noise_arcmin: float
    repeatability_um: float
    wobble_urad: float

    @classmethod
    def of(cls, fit: AnyFit) -> "FoundBench":
        """Extract the bench errors from a fit; its whole report would take as long as the fit."""
        unit = float(np.median(fit.captures.sigma_arcmin)) or 1.0
        return cls(unit * fit.smooth.noise, 1e6 * fit.smooth.shift_m, 1e6 * fit.smooth.turn_rad)


@dataclass(frozen=True)
class Outcome:
    """Result of a trial.

    Attributes:
        errors: errors by measure.
        found: bench errors estimated by the fit; None without a fit.
        readings: number of measured directions.
        seconds: process time of the fit.
        refused: reason for a missing model; empty if the fit succeeded.
        figures: further numbers by name.
    """

    errors: Mapping[str, Summary]
    found: FoundBench | None = None
    readings: int = 0
    seconds: float = field(default=0.0, compare=False)
    refused: str = ""
    figures: Mapping[str, float] = field(default_factory=dict)

    def rms(self, measure: str) -> float:
        """Return the root mean square error; NaN if it was not measured."""
        return self.errors[measure].rms if measure in self.errors else float("nan")


@dataclass(frozen=True)
class Trial:
    """The bench and the model of a trial; equal trials run once.

    Attributes:
        device: a shipped device's name, or the path of its file.
        kind: model type; it also determines the camera positions.
        degree: limit of the total degree N; None for the limits of the fit.
        viewpoints: number of camera positions.
        eye_box_mm: edge lengths of the eye box.
        camera_noise_arcmin, stage_error_mm, stage_turn_urad: standard deviations per axis of the bench's errors.
        repeat: number of the repetition; each has other random errors.
        whole_panel: True if the whole panel is captured and evaluated instead of the nominal field.
        eye: "left" or "right".
    """

    device: str
    kind: str
    degree: int | None
    viewpoints: int
    eye_box_mm: BoxSize
    camera_noise_arcmin: float = 0.0
    stage_error_mm: float = 0.0
    stage_turn_urad: float = 0.0
    repeat: int = 0
    whole_panel: bool = False
    eye: str = field(default="right", repr=False)

    def run(self, seed: int) -> Outcome:
        """Fit and evaluate."""
        raise NotImplementedError

    @property
    def at(self) -> EvaluatedEye:
        """The eye that the trial evaluates."""
        return EvaluatedEye(self.device, self.eye, self.eye_box_mm, self.whole_panel)

    @property
    def has_random_errors(self) -> bool:
        """True if repetitions differ."""
        return bool(self.camera_noise_arcmin or self.stage_error_mm or self.stage_turn_urad)

    @property
    def shared(self) -> object:
        """Key that is equal for trials that share captures and should thus run in one process."""
        return type(self), self.at, self.kind, self.viewpoints

    @property
    def file(self) -> str:
        """Name of the file that keeps the outcome."""
        return _file_of(self)

    def rng(self, seed: int) -> np.random.Generator:
        """Return a generator of random numbers that depend only on the seed, the eye and the trial."""
        eye = () if self.eye == "right" else (1,)
        key = zlib.crc32(repr(self).encode())
        return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(key, *eye)))


@dataclass(frozen=True)
class DisplayTrial(Trial):
    """A trial of the display model.

    Attributes:
        tracking_error_mm: standard deviation per axis of the viewpoint at which the fitted model is queried.
    """

    tracking_error_mm: float = 0.0

    @property
    def has_random_errors(self) -> bool:
        """True if repetitions differ."""
        return super().has_random_errors or bool(self.tracking_error_mm)

    def run(self, seed: int) -> Outcome:
        """Fit and evaluate."""
        rng = self.rng(seed)
        fitted, seconds = _timed(fit_display, _measured(self, simulate_display, rng), self)
        return Outcome(self.errors(fitted.mapping, rng, seed), FoundBench.of(fitted), len(fitted.captures), seconds)

    def errors(self, model: FittedDisplay, rng: np.random.Generator, seed: int) -> dict[str, Summary]:
        """Return the errors of a fitted model."""
        observations = display_observations(self.at, seed)
        offset = rng.normal(0.0, 1e-3 * self.tracking_error_mm, observations.viewpoint.shape)
        error = mapping_error.display_error(model, displaced(observations, offset))
        return {
            Measure.FORWARD: summary(error.forward_arcmin),
            Measure.BACKWARD: summary(error.backward_px),
            Measure.PREDICTED: summary(model.sigma(observations.pixel, observations.viewpoint)),
        }


@dataclass(frozen=True)
class SeeThroughTrial(Trial):
    """A trial of the see-through model."""

    RAYS: ClassVar[SeeThroughRays] = "backward"

    def run(self, seed: int) -> Outcome:
        """Fit and evaluate."""
        captures = _measured(self, _SIMULATE[self.RAYS], self.rng(seed))
        fitted, seconds = _timed(fit_see_through, captures, self)
        return Outcome(self.errors(fitted.mapping, seed), FoundBench.of(fitted), len(fitted.captures), seconds)

    def errors(self, model: FittedSeeThrough, seed: int) -> dict[str, Summary]:
        """Return the errors of a fitted model."""
        seen = see_through_observations(self.at, seed)
        error = mapping_error.see_through_error(model, seen)
        return {
            Measure.REAL_POINT: summary(error.backward_arcmin),
            Measure.REAL_RAY: summary(error.forward_arcmin),
            Measure.MISS: summary(1e3 * error.forward_miss_m),
            Measure.PREDICTED: summary(model.sigma(seen.point, seen.viewpoint)),
        }


def _simulate_forwards(setup: CaptureSetup, viewpoint: FloatArray, rng: np.random.Generator) -> SeeThroughCaptures:
    return simulate_see_through(replace(setup, see_through_rays="forward"), viewpoint, rng)


_SIMULATE = {"backward": simulate_see_through, "forward": _simulate_forwards}


@dataclass(frozen=True)
class NoModelTrial:
    """The error if the combiner is ignored, so that real points are assumed to be seen along straight lines."""

    at: EvaluatedEye
    viewpoints: ClassVar[int] = 1

    @property
    def shared(self) -> object:
        """Key of trials that share data; see `Trial`."""
        return self

    @property
    def file(self) -> str:
        """Name of the outcome's file; see `Trial`."""
        return _file_of(self)

    def run(self, seed: int) -> Outcome:
        """Measure the angle between the straight line to a real point and the direction in which it is seen."""
        observations = see_through_observations(self.at, seed)
        return Outcome({Measure.REAL_POINT: summary(straight_error(observations))})


AnyTrial = Trial | NoModelTrial


def run_trials(
    trials: Iterable[AnyTrial], seed: int, workers: WorkerPool, progress: Progress, folder: Path, resume: bool
) -> dict[AnyTrial, Outcome]:
    """Run each different trial once, in several processes.

    Outcomes depend only on the seed and the trial; outcomes of networks also depend on the speed of the machine,
    because their training time is fixed. The folder keeps the outcomes; with `resume`, existing ones are not repeated.
    """
    tasks, kept = tasks_of(trials), outcome_folder(folder, seed, resume)
    finished = (pair for found in as_finished(partial(_run, kept, seed), tasks, workers, kept) for pair in found)
    return dict(progress(finished, sum(map(len, tasks)), "trials"))


def tasks_of(trials: Iterable[AnyTrial]) -> list[list[AnyTrial]]:
    """Return the different trials, grouped by the captures that they share; the longest groups first."""
    groups: dict[object, list[AnyTrial]] = defaultdict(list)
    for trial in dict.fromkeys(trials):
        groups[trial.shared].append(trial)
    return sorted(groups.values(), key=lambda group: sum(trial.viewpoints for trial in group), reverse=True)


def _run(folder: Path, seed: int, task: list[AnyTrial]) -> list[tuple[AnyTrial, Outcome]]:
    return [(trial, kept_outcome(_run_one, _load, folder, seed, trial)) for trial in task]


def _run_one(trial: AnyTrial, seed: int) -> Outcome:
    return trial.run(seed)


def _load(_: AnyTrial, content: dict[str, Any]) -> Outcome:
    errors = {name: Summary(**each) for name, each in content.pop("errors").items()}
    found = content.pop("found")
    return Outcome(errors, FoundBench(**found) if found else None, **content)


def _file_of(trial: "AnyTrial") -> str:
    """Return the name of the file that keeps an outcome; it depends on the trial, the device file and the version."""
    what = json.dumps([metadata.version("wlr_render"), type(trial).__name__, asdict(trial)])
    digest = hashlib.sha256(what.encode() + read_bytes(device_path(trial.at.device), LIMITS.text_bytes))
    return f"{digest.hexdigest()[:32]}.json"


def _timed(
    fit: Callable[[AnyCaptures, str, int | None], ModelFit[AnyModel]], captures: AnyCaptures, trial: Trial
) -> tuple[ModelFit[AnyModel], float]:
    """Return a trial's fit and its process time in seconds."""
    started = time.process_time()
    fitted = fit(captures, trial.kind, trial.degree)
    return fitted, time.process_time() - started


def _measured(trial: Trial, simulate: Simulate[AnyCaptures], rng: np.random.Generator) -> AnyCaptures:
    """Simulate the trial's captures; only a displaced camera requires new tracing, camera noise does not."""
    if trial.stage_error_mm == trial.stage_turn_urad == 0.0:
        captures: AnyCaptures = exact_captures(simulate, trial.at, trial.kind, trial.viewpoints)
        return with_camera_noise(captures, trial.camera_noise_arcmin, rng)
    setup = replace(
        capture_setup(trial.at),
        camera_noise_arcmin=trial.camera_noise_arcmin,
        stage_error_m=1e-3 * trial.stage_error_mm,
        stage_turn_rad=1e-6 * trial.stage_turn_urad,
    )
    return simulate(setup, setup.camera_positions(trial.kind, trial.viewpoints), rng)

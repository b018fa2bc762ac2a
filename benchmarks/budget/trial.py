"""One trial: simulate a session, calibrate it, and compare true registration errors with the predicted covariance."""

from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from benchmarks.simulated_lab.bench_trial import DEVICES
from benchmarks.simulated_lab.simulate_readings import (
    SimulatedReadings,
    simulate_readings,
)
from wlr_render.budget.error_sizes import Drawing, ErrorSizes, PerAxis, Truncation
from wlr_render.budget.registration_budget import registration_covariance
from wlr_render.budget.statement import REGIONS, region_of, variance
from wlr_render.calibration.bench.calibrate_bench import CalibratedBench, calibrate_bench
from wlr_render.calibration.calibrate_session import with_half_turns
from wlr_render.calibration.fit_eye import Calibration, calibrate
from wlr_render.calibration.photograph_captures import sound_captures
from wlr_render.captures.session_reading import Reading
from wlr_render.errors import BadInputError
from wlr_render.geometry import rays, transforms
from wlr_render.geometry.directions import ARCMIN
from wlr_render.jobs.budget_options import BudgetOptions
from wlr_render.mappings import Eye
from wlr_render.models.registration import right_and_up
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.planning.planned_bench import ReadingOptions
from wlr_render.simulation.photographs.photo_bench import PhotoBenchOptions
from wlr_render.simulation.photographs.recipe import SimulationRecipe

MODEL_ALONE, CAMERA_FRAME, WITH_TRACKERS = "models alone", "models, camera's frame", "with trackers"
CONDITIONS = (MODEL_ALONE, CAMERA_FRAME, WITH_TRACKERS)
SHARES = (0.68, 0.95)
"""Probabilities of the ellipses."""

_PLACES = 16
_READINGS = ReadingOptions(most_dots=300, panel_samples=800)  # half the usual: the bench dominates, not noise
_POINTS = 600  # number of pixels, viewpoints and depths per session
_NEAR_M, _FAR_M = 0.3, 5.0
_TAIL = 5  # degrees of freedom of Student's t, from which noise is drawn
_ALIKE = 0.6  # correlation of the trackers' errors along different axes


@dataclass(frozen=True)
class BudgetTrial:
    """A simulated session; the sessions alternate between devices."""

    number: int

    @property
    def device(self) -> str:
        """Name of the headset."""
        return DEVICES[self.number % len(DEVICES)]

    @property
    def file(self) -> str:
        """Name of the outcome's file."""
        return f"budget-{self.number:03d}-{self.device}.json"


@dataclass(frozen=True)
class Coverage:
    """True errors of one region of a panel and their predicted covariance.

    Attributes:
        condition: one of `CONDITIONS`.
        region: one of `REGIONS`.
        points: number of errors.
        inside: number of errors within each ellipse of `SHARES`.
        true, predicted: sums of squared lengths, square arcminutes.
    """

    condition: str
    region: str
    points: int
    inside: tuple[int, ...]
    true: float
    predicted: float


@dataclass(frozen=True)
class BudgetOutcome:
    """Outcome of a trial.

    Attributes:
        trial: the session.
        coverage: coverage by condition and region.
        truncation: truncation errors of the models.
        refused: error that stopped the calibration; "" if there was none.
    """

    trial: BudgetTrial
    coverage: list[Coverage] = field(default_factory=list)
    truncation: Truncation = field(default_factory=Truncation)
    refused: str = ""


def loaded_outcome(trial: BudgetTrial, content: dict[str, Any]) -> BudgetOutcome:
    """Return the outcome of a trial from its JSON fields."""
    content["trial"] = trial
    content["coverage"] = [Coverage(**each | {"inside": tuple(each["inside"])}) for each in content["coverage"]]
    content["truncation"] = Truncation(**content["truncation"])
    return BudgetOutcome(**content)


def run_trial(trial: BudgetTrial, seed: int) -> BudgetOutcome:
    """Run a trial; the same seed gives the same outcome."""
    bench_seed = 1000 * (seed - 1) + trial.number // len(DEVICES) + 1
    try:
        simulated, reading, bench = _calibrated(trial.device, bench_seed)
        captures, _ = sound_captures(simulated.session, reading, bench)
        fit = calibrate(captures, "planar")
    except BadInputError as error:
        return BudgetOutcome(trial, refused=str(error))
    made = simulated.truth.bench
    truncation = Truncation.from_report(_report(fit))
    truth = traced_eye(made.device, made.eye)
    stated_from_true = made.stated_device_from_tracking @ transforms.inverse(made.device_from_tracking)
    coverage = []
    for number, condition in enumerate(CONDITIONS):
        rng = np.random.default_rng([seed, 31, trial.number, number])
        frame = stated_from_true if condition == CAMERA_FRAME else np.eye(4)
        trackers = replace(BudgetOptions(trial.device).sizes(0.0, truncation), drawing=Drawing())
        sizes = trackers if condition == WITH_TRACKERS else ErrorSizes(truncation=truncation)
        coverage += judged(condition, fit.mappings, truth, frame, sizes, rng)
    return BudgetOutcome(trial, coverage, truncation)


def _calibrated(device: str, bench_seed: int) -> tuple[SimulatedReadings, Reading, CalibratedBench]:
    recipe = SimulationRecipe(device, viewpoints=_PLACES, bench=PhotoBenchOptions(seed=bench_seed))
    simulated = simulate_readings(recipe, _READINGS)
    reading = with_half_turns(simulated.session, simulated.reading)
    return simulated, reading, calibrate_bench(simulated.session, reading)


def _report(fit: Calibration) -> dict[str, Any]:
    return {name.replace("-", "_"): asdict(side.report) for name, side in fit.sides.items()}


def judged(
    condition: str,
    eye: Eye,
    truth: Eye,
    model_from_true: FloatArray,
    sizes: ErrorSizes,
    rng: np.random.Generator,
) -> list[Coverage]:
    """Compare true registration errors at random pixels, viewpoints and depths with the predicted covariance.

    Args:
        condition: one of `CONDITIONS`.
        eye: the models, in the frame of the calibration.
        truth: the headset, in its own frame.
        model_from_true: (4, 4) transform between the frames; identity if the trackers measure in the true frame.
        sizes: sizes of truncation errors and of tracker errors, which are drawn from other distributions.
        rng: generator of the points and of the tracker errors.
    """
    pixel = rng.uniform(0.0, 1.0, (_POINTS, 2)) * eye.display.panel.size_px
    viewpoint = eye.eye_box.at(rng.uniform(-1.0, 1.0, (_POINTS, 3)))
    depth = 1.0 / rng.uniform(1.0 / _FAR_M, 1.0 / _NEAR_M, _POINTS)
    predicted = registration_covariance(eye, pixel, viewpoint, depth, sizes)
    predicted = predicted.in_camera_frame() if condition == CAMERA_FRAME else predicted
    # The renderer draws at this pixel the point that, according to its trackers, lies behind the pixel.
    believed_viewpoint = viewpoint + _eye_errors(sizes, rng)
    shown = eye.display.view_dir_of_pixel(pixel, believed_viewpoint).value
    ray = eye.see_through.real_ray_of_view_dir(shown, believed_viewpoint).value
    believed = rays.split(rays.at_z(ray, believed_viewpoint[:, 2] - depth))[0]
    motion = _head_errors(sizes, rng)
    point = np.einsum("nij,nj->ni", motion[:, :3, :3], believed) + motion[:, :3, 3]
    error = _true_error(truth, transforms.inverse(model_from_true), pixel, viewpoint, point)
    error = np.einsum("nij,nj->ni", right_and_up(predicted.view_dir), error) / ARCMIN
    total = predicted.total
    known = predicted.is_inside & np.isfinite(error).all(axis=1) & np.isfinite(total).all(axis=(1, 2))
    inverse = np.linalg.inv(np.where(known[:, None, None], total, np.eye(2)))
    distance = np.einsum("ni,nij,nj->n", error, inverse, error)
    found = []
    for number, region in enumerate(REGIONS):
        own = known & (region_of(eye.display.panel, pixel) == number)
        inside = tuple(int(np.sum(distance[own] <= -2.0 * np.log(1.0 - share))) for share in SHARES)
        true, expected = float(np.sum(error[own] ** 2)), float(np.sum(variance(total[own])))
        found.append(Coverage(condition, region, int(own.sum()), inside, true, expected))
    return found


def _true_error(
    truth: Eye, true_from_model: FloatArray, pixel: FloatArray, viewpoint: FloatArray, point: FloatArray
) -> FloatArray:
    """Return true directions (n, 3) of pixels less true directions of points, in the axes of the model's frame."""
    viewpoint, point = (transforms.apply(true_from_model, each) for each in (viewpoint, point))
    shown = truth.display.view_dir_of_pixel(pixel, viewpoint).value
    seen = truth.see_through.view_dir_of_real_point(point, viewpoint).value
    return transforms.rotate(transforms.inverse(true_from_model), shown - seen)


def _eye_errors(sizes: ErrorSizes, rng: np.random.Generator) -> FloatArray:
    """Draw errors (n, 3) of the tracked viewpoint: a session bias, heavy-tailed noise, motions along gaze paths."""
    eye = sizes.eye
    bias = _axes(eye.bias_m) * rng.uniform(-np.sqrt(3.0), np.sqrt(3.0), 3)
    late = eye.latency_s * _axes(eye.speed_m_s) * rng.laplace(0.0, np.sqrt(0.5), (_POINTS, 3))
    return bias + _tailed(rng, 3) * _axes(eye.noise_m) + late


def _head_errors(sizes: ErrorSizes, rng: np.random.Generator) -> FloatArray:
    """Draw errors of the head tracker, as motions (n, 4, 4) of the world in the device frame."""
    head = sizes.head
    noise, speed = _tailed(rng, 6), rng.laplace(0.0, np.sqrt(0.5), (_POINTS, 6))
    turn = noise[:, :3] * _axes(head.rotation_rad) + head.latency_s * speed[:, :3] * _axes(head.angular_speed_rad_s)
    shift = noise[:, 3:] * _axes(head.position_m) + head.latency_s * speed[:, 3:] * _axes(head.speed_m_s)
    return transforms.rigid(transforms.rotations_of_vectors(turn), shift)


def _axes(size: PerAxis) -> FloatArray:
    return np.broadcast_to(np.asarray(size, np.float64), (3,))


def _tailed(rng: np.random.Generator, count: int) -> FloatArray:
    """Draw heavy-tailed numbers (n, count) of unit variance, correlated between columns."""
    correlation = _ALIKE + (1.0 - _ALIKE) * np.eye(count)
    drawn = rng.standard_t(_TAIL, (_POINTS, count)) / np.sqrt(_TAIL / (_TAIL - 2.0))
    return np.asarray(drawn @ np.linalg.cholesky(correlation).T)

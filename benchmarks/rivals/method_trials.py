"""Trials of our methods and published methods: all fit the same captures and are judged at the same viewpoints."""

import time
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import lru_cache, partial

import numpy as np

from benchmarks import moved_observations
from benchmarks.rivals.methods import METHODS, MethodData, Rival
from benchmarks.trials import (
    BACK_M,
    EvaluatedEye,
    Measure,
    Outcome,
    Simulate,
    Trial,
    capture_setup,
    display_observations,
    exact_captures,
    see_through_observations,
    truth,
)
from benchmarks.wrong_headset import wrong_headset
from wlr_render.captures.correspondences import AnyCaptures, Captures
from wlr_render.errors import BadInputError
from wlr_render.evaluation import mapping_error
from wlr_render.evaluation.mapping_error import DisplayObservations, SeeThroughObservations
from wlr_render.evaluation.metrics import Summary, summary
from wlr_render.evaluation.misalignment import misalignment_arcmin
from wlr_render.geometry.directions import ARCMIN, arcmin_between, dir_of_tangents, normalised
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device import EyeOptics
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.simulation.capture_setup import CaptureSetup
from wlr_render.simulation.simulate_captures import simulate_display, simulate_see_through
from wlr_render.warp.ray_map import RayMapPlan, middle_axes, solve_pixels

DEPTHS_M = (0.25, 0.5, 1.0, 10.0)
"""Distances of real points between and beyond the targets of the captures."""
OUTLIER_PX = 8.0
TURN_DEG, SHIFT_MM = 0.2, 0.3
"""Assembly errors per axis by which a headset differs from its drawn prescription."""
TRACKING_MM = 0.05
"""Error of eye tracking per axis."""
FRAME_NODES = 17
"""Number of nodes along each axis of the panel at which a frame's rays are solved."""
EVERY = 4
"""Step between the observations that are used."""
_FRAMES = 5


class MethodMeasure(StrEnum):
    """Errors in addition to `trials.Measure`.

    COMPOSITE: angle at the eye between a real point and the pixel that the method shows for it. TRACKED: COMPOSITE with
    an error of eye tracking. MOVED_BACK: direction of a pixel from farther back on its ray. ALONG_RAY: the two
    directions of a pixel at two points of one of its rays. FRAME_MS: time of a frame's rays.
    """

    COMPOSITE = "composite (arcmin)"
    TRACKED = "eye-tracking error (arcmin)"
    MOVED_BACK = "moved back (arcmin)"
    ALONG_RAY = "along a ray (arcmin)"
    FRAME_MS = "a frame's rays (ms)"
    NUMBERS = "numbers stored"


def at_depth(depth_m: float) -> str:
    """Return the name of the composite error of points at one distance."""
    return f"composite at {depth_m:g} m (arcmin)"


@dataclass(frozen=True)
class MethodTrial(Trial):
    """A trial of the method named `kind`; `camera_noise_arcmin` is the noise of a camera's pixels, in pixels.

    Attributes:
        outliers: share of readings that are wrong by `OUTLIER_PX`.
        tracking_error_mm: standard deviation per axis of the viewpoints of `MethodMeasure.TRACKED`.
        in_depth: True to judge it also along rays, at single distances and with an error of eye tracking, and to time
            it.
    """

    outliers: float = 0.0
    tracking_error_mm: float = TRACKING_MM
    in_depth: bool = False

    @property
    def has_random_errors(self) -> bool:
        """True if repetitions differ. With exact captures only drawn prescriptions differ, and one of them is used."""
        return super().has_random_errors or self.outliers > 0

    @property
    def shared(self) -> object:
        """All methods share the captures."""
        return replace(self, kind="", in_depth=False)

    def run(self, seed: int) -> Outcome:
        """Fit and evaluate."""
        data = _data(replace(self, kind="", in_depth=False), seed)
        method = METHODS[self.kind]
        started = time.process_time()
        try:
            rival = method.fit(data)
        except BadInputError as error:
            return Outcome({}, refused=str(error))
        seconds = time.process_time() - started + rival.shared_seconds
        rng = np.random.default_rng(seed)
        errors = _composite_errors(self.at, rival, seed, self.tracking_error_mm if self.in_depth else None)
        if not method.lumps:
            errors |= _separate_errors(self.at, rival, seed)
        if self.in_depth:
            errors |= {
                at_depth(depth): summary(_composite(truth(self.at), rival, _at_depth(self.at, seed, depth)))
                for depth in DEPTHS_M
            }
            errors |= {} if method.lumps else _errors_along_rays(self.at, rival, seed)
            errors[MethodMeasure.FRAME_MS] = summary([_frame_ms(truth(self.at), rival, rng)])
        errors[MethodMeasure.NUMBERS] = summary([float(rival.numbers)])
        return Outcome(errors, seconds=seconds)


@lru_cache(maxsize=1)
def _data(trial: MethodTrial, seed: int) -> MethodData:
    """Simulate captures with errors and prescriptions with other errors, which all methods of a trial share."""
    rng = trial.rng(seed)
    eyes = {kind: _captures(trial, kind, rng) for kind in ("planar", "volumetric")}
    drawn = partial(_drawn, trial.at, (seed, trial.repeat))
    return MethodData(**eyes, drawn=drawn, bench_of=partial(_bench_of, trial.at))


def _drawn(at: EvaluatedEye, seeds: tuple[int, int], shape: float) -> EyeOptics:
    """Return a prescription from which the headset differs by assembly errors and by an error of the shape."""
    optics = load_device(at.device).eyes[at.eye]
    return wrong_headset(optics, np.random.default_rng(seeds), TURN_DEG, SHIFT_MM, shape)


def _bench_of(at: EvaluatedEye, optics: EyeOptics) -> CaptureSetup:
    """Return a bench on which a prescription replaces the headset."""
    device, here = load_device(at.device), truth(at)
    eye = traced_eye(replace(device, eyes={at.eye: optics}), at.eye)
    return CaptureSetup(replace(eye, eye_box=here.eye_box, field=here.field), camera_field=here.field)


def _captures(trial: MethodTrial, kind: str, rng: np.random.Generator) -> Captures:
    display = _simulated(trial, kind, simulate_display, rng)
    see_through = _simulated(trial, kind, simulate_see_through, rng)
    step = _wrong_by(len(display), trial.outliers, rng)
    kick = np.pad(_wrong_by(len(see_through), trial.outliers, rng), ((0, 0), (0, 1))) * ARCMIN
    return Captures(
        replace(display, pixel=display.pixel + step),
        replace(see_through, view_dir=normalised(see_through.view_dir + kick)),
    )


def _simulated(trial: MethodTrial, kind: str, simulate: Simulate[AnyCaptures], rng: np.random.Generator) -> AnyCaptures:
    if trial.stage_error_mm == trial.stage_turn_urad == 0.0:
        captures: AnyCaptures = exact_captures(simulate, trial.at, kind, trial.viewpoints)
    else:
        setup = replace(
            capture_setup(trial.at),
            stage_error_m=1e-3 * trial.stage_error_mm,
            stage_turn_rad=1e-6 * trial.stage_turn_urad,
        )
        captures = simulate(setup, setup.camera_positions(kind, trial.viewpoints), rng)
    return with_pixel_noise(captures, trial.camera_noise_arcmin, rng)


def _wrong_by(count: int, share: float, rng: np.random.Generator) -> FloatArray:
    """Draw errors (count, 2) of `OUTLIER_PX` in random directions for a share of the rows, as by misdetection."""
    wrong = rng.uniform(size=count) < share
    angle = rng.uniform(0.0, 2.0 * np.pi, count)
    return np.asarray(OUTLIER_PX * wrong[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]))


@lru_cache(maxsize=4)
def _judged(at: EvaluatedEye, seed: int) -> tuple[DisplayObservations, SeeThroughObservations]:
    """Return observations of pixels, and of real points at distances of 0.3 to 5 m."""
    shown, seen = display_observations(at, seed), see_through_observations(at, seed)
    pixels = DisplayObservations(shown.viewpoint[::EVERY], shown.pixel[::EVERY], shown.view_dir[::EVERY])
    points = SeeThroughObservations(
        seen.viewpoint[::EVERY], seen.view_dir[::EVERY], seen.real_ray[::EVERY], seen.point[::EVERY]
    )
    return pixels, points


@lru_cache(maxsize=16)
def _at_depth(at: EvaluatedEye, seed: int, depth_m: float) -> SeeThroughObservations:
    """Return observations of real points at one distance."""
    seen = _judged(at, seed)[0]
    depth = np.full(len(seen.pixel), depth_m)
    return mapping_error.see_through_observations(truth(at).see_through, seen.viewpoint, seen.view_dir, depth)


def _composite(exact: Eye, rival: Rival, seen: SeeThroughObservations, offset: FloatArray | None = None) -> FloatArray:
    """Return the angles (n,) at the eye between real points and the pixels that a method shows for them.

    The method is queried at viewpoints that are wrong by `offset` (n, 3) metres.
    """
    queried = seen.viewpoint if offset is None else seen.viewpoint + offset
    view_dir = rival.see_through.view_dir_of_real_point(seen.point, queried).value
    pixel = rival.display.pixel_of_view_dir(view_dir, queried).value
    return misalignment_arcmin(exact, seen.viewpoint, pixel, seen.point)


def _composite_errors(at: EvaluatedEye, rival: Rival, seed: int, tracking_error_mm: float | None) -> dict[str, Summary]:
    exact, (_, points) = truth(at), _judged(at, seed)
    errors: dict[str, Summary] = {MethodMeasure.COMPOSITE: summary(_composite(exact, rival, points))}
    if tracking_error_mm is not None:
        offset = np.random.default_rng(seed).normal(0.0, 1e-3 * tracking_error_mm, points.viewpoint.shape)
        errors[MethodMeasure.TRACKED] = summary(_composite(exact, rival, points, offset))
    return errors


def _separate_errors(at: EvaluatedEye, rival: Rival, seed: int) -> dict[str, Summary]:
    pixels, points = _judged(at, seed)
    shown = mapping_error.display_error(rival.display, pixels)
    seen = mapping_error.see_through_error(rival.see_through, points)
    return {
        Measure.FORWARD: summary(shown.forward_arcmin),
        Measure.BACKWARD: summary(shown.backward_px),
        Measure.REAL_POINT: summary(seen.backward_arcmin),
    }


def _errors_along_rays(at: EvaluatedEye, rival: Rival, seed: int) -> dict[str, Summary]:
    pixels, _ = _judged(at, seed)
    back = moved_observations.moved_back(pixels, BACK_M)
    moved = rival.display.view_dir_of_pixel(back.pixel, back.viewpoint).value
    through = moved_observations.through_depth(pixels.view_dir, 1e-3 * at.eye_box_mm[2])
    front = moved_observations.moved_back(pixels, -0.5 * through).viewpoint
    apart = moved_observations.self_inconsistency_arcmin(rival.display, front, pixels.pixel, through)
    return {
        MethodMeasure.MOVED_BACK: summary(arcmin_between(moved, pixels.view_dir)),
        MethodMeasure.ALONG_RAY: summary(apart),
    }


def _frame_ms(exact: Eye, rival: Rival, rng: np.random.Generator) -> float:
    """Return the median process time of a frame's rays for a moving eye, started from the last frame's solution."""
    eye = replace(exact, display=rival.display, see_through=rival.see_through)
    axes = middle_axes(exact)
    nodes = RayMapPlan.with_nodes(exact.display.panel, FRAME_NODES, axes).node_pixel
    step = 1e-4 * rng.normal(size=(_FRAMES, 3))
    warm, taken = None, []
    for viewpoint in exact.eye_box.centre + np.cumsum(step, axis=0):
        started = time.process_time()
        warm = solve_pixels(eye, axes, nodes, viewpoint, warm).warm_start
        taken.append(1e3 * (time.process_time() - started))
    return float(np.median(taken[1:]))


def with_pixel_noise(captures: AnyCaptures, sigma_px: float, rng: np.random.Generator) -> AnyCaptures:
    """Displace every measured direction by a pinhole camera's pixel noise, and record its sigma.

    The camera looks along -z; a pixel in its middle is an arcminute wide. Off axis the same pixel covers a smaller
    angle: `sigma_arcmin` is the geometric mean over the radial and the tangential axis. (Paper, section 4.3.)
    """
    if sigma_px == 0.0:
        return captures
    tangents = captures.tangents + rng.normal(0.0, sigma_px * ARCMIN, captures.tangents.shape)
    sigma = sigma_px * (1.0 + np.sum(captures.tangents**2, axis=1)) ** -0.75
    return replace(captures, view_dir=dir_of_tangents(tangents), sigma_arcmin=sigma)

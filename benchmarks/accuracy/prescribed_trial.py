"""Trials of models that use the prescription of a headset that differs from it."""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from benchmarks.trials import (
    FARTHEST_M,
    NEAREST_M,
    TEST_RAYS,
    TEST_VIEWPOINTS,
    DisplayTrial,
    EvaluatedEye,
    FoundBench,
    Measure,
    Outcome,
)
from benchmarks.wrong_headset import wrong_headset
from wlr_render.calibration.fit_eye import calibrate
from wlr_render.captures.correspondences import Captures
from wlr_render.evaluation import mapping_error
from wlr_render.evaluation.metrics import summary
from wlr_render.mappings import EyeBox
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.simulation import viewpoints
from wlr_render.simulation.capture_setup import CaptureSetup
from wlr_render.simulation.simulate_captures import simulate_display, simulate_see_through, with_camera_noise

SEE_THROUGH_PREDICTED = "see-through predicted (arcmin)"
"""A measure in addition to `Measure`: the standard error that the see-through model states."""


@dataclass(frozen=True)
class PrescribedTrial(DisplayTrial):
    """A trial of display and see-through of a headset whose parts are displaced.

    Attributes:
        turn_deg, shift_mm: standard deviations of the displacements, drawn anew for each repetition.
        shape: relative error of one semi-axis or curvature of each surface, see `wrong_headset`.
    """

    turn_deg: float = 0.2
    shift_mm: float = 0.3
    shape: float = 0.0

    @property
    def has_random_errors(self) -> bool:
        """True: repetitions differ in the displacements."""
        return True

    def run(self, seed: int) -> Outcome:
        """Fit and evaluate."""
        exact, setup = _bench(self.at, self.turn_deg, self.shift_mm, self.shape, self.repeat, self.viewpoints, seed)
        rng = self.rng(seed)
        panel, world = exact.both
        captures = Captures(
            with_camera_noise(panel, self.camera_noise_arcmin, rng),
            with_camera_noise(world, self.camera_noise_arcmin, rng),
        )
        prescription = load_device(self.device).eyes[self.eye]
        fit = calibrate(captures, self.kind, prescription=None if self.kind == "planar" else prescription)
        shown, seen = _observations(setup, seed)
        display, see_through = fit.both[0].mapping, fit.both[1].mapping
        errors = {
            Measure.FORWARD: summary(mapping_error.display_error(display, shown).forward_arcmin),
            Measure.PREDICTED: summary(display.sigma(shown.pixel, shown.viewpoint)),
            Measure.REAL_POINT: summary(mapping_error.see_through_error(see_through, seen).backward_arcmin),
            SEE_THROUGH_PREDICTED: summary(see_through.sigma(seen.point, seen.viewpoint)),
        }
        return Outcome(errors, FoundBench.of(fit.both[0]), len(captures.both[0]))


@lru_cache(maxsize=2)
def _bench(
    at: EvaluatedEye, turn_deg: float, shift_mm: float, shape: float, repeat: int, count: int, seed: int
) -> tuple[Captures, CaptureSetup]:
    """Simulate noise-free captures of a headset that differs from its prescription; also return their setup."""
    device = load_device(at.device)
    wrong = wrong_headset(device.eyes[at.eye], np.random.default_rng([seed, repeat]), turn_deg, shift_mm, shape)
    eye = traced_eye(replace(device, eyes={at.eye: wrong}), at.eye)
    eye = replace(eye, name=device.name, eye_box=EyeBox(eye.eye_box.centre, np.array(at.eye_box_mm) * 1e-3))
    setup, rng = CaptureSetup(eye, camera_field=eye.field), np.random.default_rng(0)
    positions = setup.camera_positions("planar", count)
    return Captures(simulate_display(setup, positions, rng), simulate_see_through(setup, positions, rng)), setup


def _observations(
    setup: CaptureSetup, seed: int
) -> tuple[mapping_error.DisplayObservations, mapping_error.SeeThroughObservations]:
    """Return directions in the captured field, and real points in these directions, from random viewpoints."""
    rng = np.random.default_rng(seed)
    viewpoint = viewpoints.random_in_eye_box(setup.truth.eye_box, TEST_VIEWPOINTS, rng)[:, None]
    view_dir = setup.camera_dirs()[rng.integers(0, len(setup.camera_dirs()), (TEST_VIEWPOINTS, TEST_RAYS))]
    shown = mapping_error.observations_of_dirs(setup.truth.display, viewpoint, view_dir)
    depth = 1.0 / rng.uniform(1.0 / FARTHEST_M, 1.0 / NEAREST_M, len(shown.pixel))
    exact = setup.truth.see_through
    return shown, mapping_error.see_through_observations(exact, shown.viewpoint, shown.view_dir, depth)

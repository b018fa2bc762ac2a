"""One trial of the sampling study: capture, fit, and judge by true sightings."""

import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from wlr_render.calibration.fit_display import fit_display
from wlr_render.calibration.fit_see_through import fit_see_through
from wlr_render.captures.correspondences import DisplayCaptures, SeeThroughCaptures
from wlr_render.errors import BadInputError
from wlr_render.evaluation import mapping_error
from wlr_render.evaluation.metrics import Summary, summary
from wlr_render.geometry.directions import arcmin_between
from wlr_render.jobs.designs import camera_positions
from wlr_render.jobs.evaluate import world
from wlr_render.mappings import DisplayMapping
from wlr_render.numerics.polynomial import term_count
from wlr_render.report.blocks import Cell
from wlr_render.simulation.simulate_captures import (
    CaptureSetup,
    simulate_display,
    simulate_see_through,
    with_camera_noise,
)

AnyCaptures = TypeVar("AnyCaptures", DisplayCaptures, SeeThroughCaptures)

BACK_M = 0.010
"""How far viewpoints are moved back along their own rays in the depth experiment."""


class Measure(StrEnum):
    """What an outcome holds errors of, all at random viewpoints of the eye box.

    FORWARD: direction of a pixel. BACKWARD: pixel of a direction. MOVED_BACK: as FORWARD, from `BACK_M` farther back
    along the same rays. ALONG_RAY: between the model's answers at two points of one of its rays, the eye box's depth
    apart. REAL_POINT: direction of a real point. REAL_RAY: direction of the real ray of a view direction. MISS: by
    which that ray misses the real point.
    """

    FORWARD = "forward (arcmin)"
    BACKWARD = "backward (px)"
    MOVED_BACK = "moved back (arcmin)"
    ALONG_RAY = "along a ray (arcmin)"
    REAL_POINT = "real point (arcmin)"
    REAL_RAY = "real ray (arcmin)"
    MISS = "miss (mm)"


@dataclass(frozen=True)
class Outcome:
    """What became of a trial: errors, or why there is no model."""

    errors: Mapping[Measure, Summary]
    refused: str = ""

    def rms(self, measure: Measure) -> float:
        """Root mean square error; NaN where there is no model."""
        return self.errors[measure].rms if measure in self.errors else float("nan")

    def cell(self, measure: Measure) -> Cell:
        """`rms` for a table, or why there is none."""
        return self.refused or self.rms(measure)


@dataclass(frozen=True)
class Trial:
    """What is varied; trials are compared by value, so that experiments share them.

    Attributes:
        device: a shipped device's name, or the path of its file.
        kind: of the model; it also decides where the captures are taken.
        degree: total degree N.
        viewpoints: number of camera positions.
        eye_box_mm: the eye box.
        camera_noise_arcmin, stage_error_mm: errors of the bench.
        repeat: number of the repetition, for other random errors.
        whole_panel: all that the panel shows is captured and judged, not only the nominal field.
    """

    device: str
    kind: str
    degree: int
    viewpoints: int
    eye_box_mm: world.BoxSize = world.EYE_BOX_MM
    camera_noise_arcmin: float = 0.0
    stage_error_mm: float = 0.0
    repeat: int = 0
    whole_panel: bool = False

    @property
    def setting(self) -> world.Setting:
        """Where captures are taken and errors are stated."""
        return world.Setting(self.device, self.eye_box_mm, self.whole_panel)

    @property
    def needed_viewpoints(self) -> int:
        """The least number of camera positions that determine the model: as many as a polynomial in them has terms."""
        axes = {"planar": 2, "volumetric": 3}.get(self.kind, 0)
        return term_count(axes, self.degree)

    def refusal(self, fault: BadInputError) -> Outcome:
        """The outcome of a refused fit; the fault goes on where too few camera positions do not explain it."""
        if self.viewpoints >= self.needed_viewpoints:
            raise fault
        return Outcome({}, f"refused: needs {self.needed_viewpoints}")

    def rng(self, seed: int) -> np.random.Generator:
        """The trial's own random numbers: they depend on the study's seed and the trial, on nothing else."""
        key = zlib.crc32(repr(self).encode())
        return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(key,)))


@dataclass(frozen=True)
class DisplayTrial(Trial):
    """A trial of the display model.

    Attributes:
        tracking_error_mm: standard deviation per axis of the viewpoint that the fitted model is asked at.
    """

    tracking_error_mm: float = 0.0

    def run(self, seed: int) -> Outcome:
        """Fit and judge, unless the fit is refused for want of camera positions."""
        rng = self.rng(seed)
        captures = _measured(self, world.exact_display, simulate_display, rng)
        try:
            model, _ = fit_display(captures, self.kind, self.degree)
        except BadInputError as fault:
            return self.refusal(fault)
        return Outcome(self._errors(model, rng, seed))

    def _errors(self, model: DisplayMapping, rng: np.random.Generator, seed: int) -> dict[Measure, Summary]:
        sightings = world.display_sightings(self.setting, seed)
        offset = rng.normal(0.0, 1e-3 * self.tracking_error_mm, sightings.viewpoint.shape)
        error = mapping_error.display_error(model, mapping_error.displaced(sightings, offset))
        back = mapping_error.moved_back(sightings, BACK_M)
        shown_back = model.view_dir_of_pixel(back.pixel, back.viewpoint).value
        return {
            Measure.FORWARD: summary(error.forward_arcmin),
            Measure.BACKWARD: summary(error.backward_px),
            Measure.MOVED_BACK: summary(arcmin_between(shown_back, back.view_dir)),
            Measure.ALONG_RAY: summary(_along_ray(model, sightings, 1e-3 * self.eye_box_mm[2])),
        }


def _along_ray(model: DisplayMapping, sightings: mapping_error.DisplaySightings, depth_m: float) -> NDArray[np.float64]:
    """Self-contradiction from half a depth before each viewpoint to half behind it, arcminutes (n,)."""
    through = depth_m / -sightings.view_dir[:, 2]
    front = mapping_error.moved_back(sightings, -0.5 * through).viewpoint
    return mapping_error.self_inconsistency_arcmin(model, front, sightings.pixel, through)


@dataclass(frozen=True)
class SeeThroughTrial(Trial):
    """A trial of the see-through model."""

    def run(self, seed: int) -> Outcome:
        """Fit and judge, unless the fit is refused for want of camera positions."""
        captures = _measured(self, world.exact_see_through, simulate_see_through, self.rng(seed))
        try:
            model, _ = fit_see_through(captures, self.kind, self.degree)
        except BadInputError as fault:
            return self.refusal(fault)
        sightings = world.see_through_sightings(self.setting, seed)
        error = mapping_error.see_through_error(model, sightings)
        return Outcome(
            {
                Measure.REAL_POINT: summary(error.backward_arcmin),
                Measure.REAL_RAY: summary(error.forward_arcmin),
                Measure.MISS: summary(1e3 * error.forward_miss_m),
            }
        )


@dataclass(frozen=True)
class NoModelTrial:
    """What an eye is wrong by that takes the world through the combiner to be the world without it."""

    device: str

    def run(self, seed: int) -> Outcome:
        """The straight line to a real point against the direction in which it is seen."""
        sightings = world.see_through_sightings(world.Setting(self.device), seed)
        return Outcome({Measure.REAL_POINT: summary(mapping_error.straight_error(sightings))})


def _measured(
    trial: Trial,
    exact: Callable[[world.Setting, str, int], AnyCaptures],
    simulate: Callable[[CaptureSetup, NDArray[np.float64], np.random.Generator], AnyCaptures],
    rng: np.random.Generator,
) -> AnyCaptures:
    """The trial's captures; camera noise needs no new tracing, a camera that stands elsewhere does."""
    if trial.stage_error_mm == 0.0:
        captures = exact(trial.setting, trial.kind, trial.viewpoints)
        return with_camera_noise(captures, trial.camera_noise_arcmin, rng)
    on = replace(
        world.capture_setup(trial.setting),
        camera_noise_arcmin=trial.camera_noise_arcmin,
        stage_error_m=1e-3 * trial.stage_error_mm,
    )
    return simulate(on, camera_positions(on, trial.kind, trial.viewpoints), rng)

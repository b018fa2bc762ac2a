"""Predicted and simulated errors of a calibration over the eye box, by the design of its session."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from wlr_render.budget.statement import variance
from wlr_render.calibration.fit_display import fit_display
from wlr_render.calibration.fit_report import ModelFit
from wlr_render.calibration.fit_see_through import fit_see_through
from wlr_render.captures.correspondences import Captures
from wlr_render.evaluation import mapping_error
from wlr_render.evaluation.metrics import Summary, summary
from wlr_render.geometry.directions import ARCMIN, arcmin_between
from wlr_render.mappings import Eye
from wlr_render.models.fitted_model import FittedDisplay, FittedSeeThrough
from wlr_render.models.registration import model_registration_covariance
from wlr_render.numerics.arrays import FloatArray
from wlr_render.planning.planned_bench import PlannedBench
from wlr_render.simulation import viewpoints

_VIEWPOINTS, _EACH = 150, 8
NEAR_M, FAR_M = 0.3, 5.0
"""Distances of real points, evenly in dioptres."""
_CURVES = 4  # number of smooth stage errors to average over
_DRAWS = 8  # number of draws of the random part of each error
_TESTS, _PILOT = 72, 73  # streams of random numbers


@dataclass(frozen=True)
class PlannedFit:
    """Planar models of both mappings of an eye, fitted to the captures of a design."""

    display: ModelFit[FittedDisplay]
    see_through: ModelFit[FittedSeeThrough]

    @classmethod
    def to(cls, captures: Captures) -> "PlannedFit":
        """Fit as calibration does, but without a search for outliers, because these captures have none."""
        shown, seen = captures.both
        return cls(fit_display(shown, weights=np.ones(len(shown))), fit_see_through(seen, weights=np.ones(len(seen))))


@dataclass(frozen=True, eq=False)
class EyeTests:
    """Real points and the pixels that cover them, seen from viewpoints all over the eye box.

    Attributes:
        viewpoint: (n, 3) viewpoints.
        pixel: (n, 2) pixels.
        point: (n, 3) real points.
        view_dir: (n, 3) common direction of pixel and point.
    """

    viewpoint: FloatArray
    pixel: FloatArray
    point: FloatArray
    view_dir: FloatArray

    @classmethod
    def of(cls, truth: Eye, seed: int) -> "EyeTests":
        """Draw random directions in the nominal field, or on the whole panel if the device states no field."""
        rng = np.random.default_rng([seed, _TESTS])
        viewpoint = viewpoints.random_in_eye_box(truth.eye_box, _VIEWPOINTS, rng)[:, None]
        shown = mapping_error.observations_at_random(truth, viewpoint, _EACH, rng, truth.field)
        seen = truth.see_through.real_ray_of_view_dir(shown.view_dir, shown.viewpoint).usable
        viewpoint, view_dir = shown.viewpoint[seen], shown.view_dir[seen]
        depth = 1.0 / rng.uniform(1.0 / FAR_M, 1.0 / NEAR_M, len(view_dir))
        points = mapping_error.see_through_observations(truth.see_through, viewpoint, view_dir, depth)
        return cls(viewpoint, shown.pixel[seen], points.point, view_dir)

    def directions(self, display: FittedDisplay, see_through: FittedSeeThrough) -> tuple[FloatArray, FloatArray]:
        """Return the directions (n, 3) in which models see the pixel, and the point."""
        return (
            display.view_dir_of_pixel(self.pixel, self.viewpoint).value,
            see_through.view_dir_of_real_point(self.point, self.viewpoint).value,
        )


@dataclass(frozen=True)
class DesignErrors:
    """Errors of a calibration over the eye box, arcminutes.

    Attributes:
        display: error of a pixel's direction.
        see_through: error of a real point's direction.
        registration: angle between a real point and its virtual overlay.
    """

    display: Summary
    see_through: Summary
    registration: Summary


@dataclass(frozen=True)
class Scales:
    """Sizes of the errors of a bench as multiples of the planned ones.

    Attributes:
        noise: noise of dots and decoded positions.
        random: repeatability and random turns of the stage.
        smooth: error of the stage's calibration.
    """

    noise: float = 1.0
    random: float = 1.0
    smooth: float = 1.0


@dataclass(frozen=True, eq=False)
class DesignPredictor:
    """Prediction of the errors of designs from the fit of one simulated session, the pilot.

    The pilot gives the smoothness of the optics. The covariance of another design follows from its places, its readings
    and that smoothness, without a fit.

    Attributes:
        bench: the planned bench.
        pilot: models fitted to captures of one design.
        tests: pixels and points whose errors are predicted.
    """

    bench: PlannedBench
    pilot: PlannedFit
    tests: EyeTests

    def models(
        self, unit: FloatArray, scales: Scales = Scales(), depths_m: tuple[float, ...] | None = None
    ) -> tuple[FittedDisplay, FittedSeeThrough]:
        """Return models with the covariance of a design with places (m, 3), see `Design.unit`."""
        display, see_through = self.bench.captures(self.bench.places(unit), [0, _PILOT], None, depths_m).both
        changes = {"noise": scales.noise, "shift": scales.random, "turn": scales.random}
        # Use the pilot's estimate of the stage: a fit counts unmodelled smooth errors as random motions.
        shown, seen = (
            {name: float(side.smooth.posterior.hyper[name] + np.log(scale)) for name, scale in changes.items()}
            for side in (self.pilot.display, self.pilot.see_through)
        )
        return (
            self.pilot.display.with_design(display, shown),
            self.pilot.see_through.with_design(see_through, seen),
        )

    def errors(
        self, unit: FloatArray, scales: Scales = Scales(), depths_m: tuple[float, ...] | None = None
    ) -> DesignErrors:
        """Return the predicted errors of a design with places (m, 3)."""
        return self.errors_of(*self.models(unit, scales, depths_m), scales.smooth)

    def errors_of(self, display: FittedDisplay, see_through: FittedSeeThrough, smooth: float = 1.0) -> DesignErrors:
        """Return the errors predicted from the covariance of two models and the error of the stage's calibration."""
        shown = display.sigma(self.tests.pixel, self.tests.viewpoint)
        seen = see_through.sigma(self.tests.point, self.tests.viewpoint)
        sizes = (shown, seen, np.hypot(shown, seen))
        return DesignErrors(
            *(_lengths(size, smooth * curve) for size, curve in zip(sizes, self._by_curves, strict=True))
        )

    @cached_property
    def _by_curves(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Errors (curves, n) of display, see-through and registration from the error of the stage's calibration.

        The fits mistake that error for optics. Both sides use the same places, so that it partly cancels in
        registration.
        """
        now = self.tests.directions(self.pilot.display.mapping, self.pilot.see_through.mapping)
        found = []
        for draw in range(_CURVES):
            curve = self.bench.curve(1 + draw)
            changed = self.tests.directions(
                self.pilot.display.with_camera_motions(curve), self.pilot.see_through.with_camera_motions(curve)
            )
            shown, seen = (new - old for new, old in zip(changed, now, strict=True))
            found.append([np.linalg.norm(each, axis=1) / ARCMIN for each in (shown, seen, shown - seen)])
        shown, seen, both = (np.array(each) for each in zip(*found, strict=True))
        return shown, seen, both

    def simulated(self, fit: PlannedFit) -> DesignErrors:
        """Return the errors of a fit against the traced headset."""
        shown, seen = self.tests.directions(fit.display.mapping, fit.see_through.mapping)
        pairs = ((shown, self.tests.view_dir), (seen, self.tests.view_dir), (shown, seen))
        return DesignErrors(*(summary(arcmin_between(*pair)) for pair in pairs))


def place_variance(
    display: FittedDisplay, see_through: FittedSeeThrough, place: FloatArray, tests: EyeTests
) -> FloatArray:
    """Return the mean predicted variance (k,) of registration as seen from places (k, 3), square arcminutes."""
    rows = np.linspace(0, len(tests.pixel) - 1, 60).astype(int)
    pixel, point = tests.pixel[rows][:, None], tests.point[rows][:, None]
    return np.asarray(np.nanmean(registration_variance(display, see_through, pixel, place[None], point), axis=0))


def registration_variance(
    display: FittedDisplay, see_through: FittedSeeThrough, pixel: FloatArray, viewpoint: FloatArray, point: FloatArray
) -> FloatArray:
    """Return the predicted mean square length (...) of the registration error, square arcminutes.

    Errors common to both models count only by their difference; see `model_registration_covariance` for the arguments.
    """
    by_source = model_registration_covariance(display, see_through, pixel, viewpoint, point)
    return variance(np.asarray(sum(by_source.values())))


def _lengths(sigma: FloatArray, curve: FloatArray) -> Summary:
    """Summarise lengths of errors: random ones of rms length `sigma` (n,), added to smooth ones `curve` (curves, n)."""
    rng = np.random.default_rng(0)
    along, across = rng.standard_normal((2, _DRAWS, 1, len(sigma))) * sigma / np.sqrt(2.0)
    return summary(np.hypot(curve + along, across))


def simulated_captures(bench: PlannedBench, unit: FloatArray, seed: int) -> Captures:
    """Simulate one session with all errors of the bench; its smooth errors differ from the predicted ones."""
    return bench.captures(bench.places(unit), [seed, _PILOT], bench.curve(_CURVES + 1 + seed))

"""The errors of a planned session's bench in its captures: noise, repeatability, and smooth errors of the stage."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from wlr_render.captures.correspondences import Captures
from wlr_render.captures.patterns.catalogue import make_pattern
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import ARCMIN, arcmin_between
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import FloatArray
from wlr_render.planning.designs import places_of
from wlr_render.simulation.capture_setup import CaptureSetup
from wlr_render.simulation.photographs.photo_bench import PhotoBench
from wlr_render.simulation.photographs.photo_plan import bare_steps, plan_photographs
from wlr_render.simulation.photographs.recipe import SimulationRecipe
from wlr_render.simulation.photographs.stage_errors import StageErrors
from wlr_render.simulation.simulate_captures import simulate_display, simulate_see_through
from wlr_render.usual import CODE_NOISE_PX, DOT_NOISE_PX, STAGE_SCREW_M

GRID = (17, 13)
"""Directions of a simulated capture: fewer than are read, each with less noise, for the same information."""
_DEGREE = 3  # degree of the curve along an axis
_CURVE = 71  # stream of random numbers
_PITCH_M = 1e-3  # pitch of lead screws


@dataclass(frozen=True)
class ReadingOptions:
    """Noise and number of the readings of a photograph.

    Attributes:
        dot_px: standard deviation of a dot's position, per axis, camera pixels.
        panel_px: standard deviation of a panel position, per axis, panel pixels.
        most_dots: maximum number of dots per photograph.
        panel_samples: approximate number of panel positions per panel set.
    """

    dot_px: float = DOT_NOISE_PX.value
    panel_px: float = CODE_NOISE_PX.value
    most_dots: int = 600
    panel_samples: int = 1500


@dataclass(frozen=True, eq=False)
class StageCurve:
    """Smooth errors of a stage that remain after its calibration.

    Cubic curves along the axes are fitted to photographs without the headset, which have the stage's random errors.

    Attributes:
        errors: the stage's true errors.
        centre: (3,) centre of the stage's travel.
        degrees: (3,) degree of the curve along each axis.
        found: (k, 6) coefficients of the curves.
    """

    errors: StageErrors
    centre: FloatArray
    degrees: tuple[int, ...]
    found: FloatArray

    @classmethod
    def fitted(cls, errors: StageErrors, centre: FloatArray, steps: FloatArray, random: FloatArray) -> "StageCurve":
        """Fit the curves.

        Args:
            errors, centre: as in the class.
            steps: (n, 3) stage positions between -1 and 1 along each axis.
            random: (n, 6) random rotation (rad) and displacement (m) of the camera at these positions.
        """
        degrees = tuple(min(_DEGREE, len(np.unique(along)) - 1) for along in steps.T)
        motion = np.stack([errors.motion(each) for each in steps * errors.half_travel_m]) + random
        found = np.asarray(np.linalg.lstsq(_powers(steps, degrees), motion, rcond=None)[0], np.float64)
        return cls(errors, centre, degrees, found)

    def __call__(self, position: FloatArray) -> FloatArray:
        """Return rotation (rad) and displacement (m) of the camera (m, 6) at positions (m, 3)."""
        away = position - self.centre
        motion = np.stack([self.errors.motion(each) for each in away])
        return np.asarray(motion - _powers(away / self.errors.half_travel_m, self.degrees) @ self.found)


def _powers(unit: FloatArray, degrees: tuple[int, ...]) -> FloatArray:
    """Return 1 and the powers of each coordinate of `unit` (n, 3) as columns (n, k)."""
    powers = [unit[:, axis] ** power for axis, degree in enumerate(degrees) for power in range(1, degree + 1)]
    return np.stack([np.ones(len(unit)), *powers], axis=1)


def _with_screws(curve: StageCurve, phase: FloatArray) -> Callable[[FloatArray], FloatArray]:
    """Return the sum of a curve and periodic lead-screw errors of usual size, which calibrations do not find."""

    def motion(position: FloatArray) -> FloatArray:
        screw = np.sqrt(2.0) * STAGE_SCREW_M.value * np.sin(2.0 * np.pi * position / _PITCH_M + phase)
        return np.asarray(curve(position) + np.hstack([np.zeros_like(screw), screw]))

    return motion


@dataclass(frozen=True, eq=False)
class PlannedBench:
    """A bench and the captures that it would give.

    Attributes:
        truth: the traced eye.
        recipe: device, code, camera, targets and imperfections.
        noise: noise of a dot and of a decoded panel position.
        bench: the simulated bench of the recipe.
        in_depth: whether the camera also stands in front of and behind the middle plane; the stage is then also
            calibrated at five levels of that axis.
    """

    truth: Eye
    recipe: SimulationRecipe
    noise: ReadingOptions
    bench: PhotoBench
    in_depth: bool = False

    @property
    def camera_arcmin(self) -> float:
        """Arcminutes per pixel of the eyeball camera."""
        return float(1.0 / np.sqrt(np.prod(self.bench.eyeball.camera.focal_px)) / ARCMIN)

    @cached_property
    def panel_arcmin(self) -> float:
        """Arcminutes per pixel of the panel, in its middle.

        Raises:
            BadInputError: the eye does not see all pixels up to four pixels from the middle.
        """
        middle = 0.5 * np.array(self.truth.display.panel.size_px)
        pixel = middle + np.array([[-4.0, 0.0], [4.0, 0.0], [0.0, -4.0], [0.0, 4.0]])
        seen = self.truth.display.view_dir_of_pixel(pixel, self.truth.eye_box.centre).value
        if not np.isfinite(seen).all():
            raise BadInputError(
                f"{self.truth.name}: the 8 x 8 pixels in the middle of the panel are not all seen from the middle of "
                "the eye box; check the panel, the surfaces and their apertures."
            )
        return float(np.mean(arcmin_between(seen[::2], seen[1::2])) / 8.0)

    @cached_property
    def reach_m(self) -> FloatArray:
        """(2,) half width and height of the region of camera places, which rays through the eye box cover."""
        box = self.truth.eye_box
        return np.asarray(0.5 * box.size[:2] + 0.5 * box.size[2] * self.field_reach)

    @cached_property
    def field_reach(self) -> FloatArray:
        """(2,) largest |tx| and |ty| of the display's rays."""
        return self.setup().field.reach

    def places(self, unit: FloatArray) -> FloatArray:
        """Return the camera places (m, 3), in metres, of places (m, 3) between -1 and 1; see `designs.places_of`."""
        return places_of(unit, self.truth.eye_box, self.field_reach)

    def setup(self, depths_m: tuple[float, ...] | None = None) -> CaptureSetup:
        """Return the bench without errors."""
        depths = depths_m or self.recipe.bench.target_depths_m
        return CaptureSetup(self.truth, grid=GRID, target_depths_m=depths)

    @cached_property
    def bare_steps(self) -> FloatArray:
        """Stage positions (n, 3), -1 to 1, of the photographs without the headset: before it is mounted, and after."""
        return np.tile(bare_steps(len(self.bench.options.stage), self.in_depth), (2, 1))

    def curve(self, draw: int) -> StageCurve:
        """Draw a stage and return its smooth errors after calibration."""
        rng = np.random.default_rng([self.recipe.bench.seed, _CURVE, draw])
        sizes, half = self.recipe.bench.imperfections, np.append(self.reach_m, 0.5 * self.truth.eye_box.size[2])
        errors = StageErrors.draw(sizes, half, rng)
        random = 1e-6 * rng.standard_normal((len(self.bare_steps), 6))
        random *= np.repeat([sizes.turn_jitter_urad, sizes.repeatability_um], 3)
        return StageCurve.fitted(errors, self.truth.eye_box.centre, self.bare_steps, random)

    def captures(
        self, places: FloatArray, seed: list[int], curve: StageCurve | None, depths_m: tuple[float, ...] | None = None
    ) -> Captures:
        """Simulate the captures of a session with camera places (m, 3)."""
        sizes, rng = self.recipe.bench.imperfections, np.random.default_rng(seed)
        phase = rng.uniform(0.0, 2.0 * np.pi, 3)
        shown, seen = (
            replace(
                self.setup(depths_m),
                camera_noise_arcmin=noise * arcmin * float(np.sqrt(np.prod(GRID) / count)),
                stage_error_m=1e-6 * sizes.repeatability_um,
                stage_turn_rad=1e-6 * sizes.turn_jitter_urad,
                stage_curve=curve and _with_screws(curve, phase),
            )
            for noise, arcmin, count in (
                (self.noise.panel_px, self.panel_arcmin, self.noise.panel_samples),
                (self.noise.dot_px, self.camera_arcmin, self.noise.most_dots),
            )
        )
        return Captures(simulate_display(shown, places, rng), simulate_see_through(seen, places, rng))

    def photographs(self, places: int) -> dict[str, int]:
        """Return the number of photographs of a session by subject."""
        plan = plan_photographs(self.bench, places)
        poses = len(self.bench.device_from_target)
        code = make_pattern(self.recipe.pattern, self.bench.optics.panel.pixels)
        return {
            "codes on the display": places * len(code.names()),
            # The first place of each target pose is photographed again, to detect motion in the meantime.
            "board through the optics": (places + 1) * poses,
            "board without the headset": len(self.bare_steps),
            "board by the tracking camera": 2 * poses,
            "board for the lenses": len(plan.eyeball_boards) + len(plan.tracking_boards),
        }

"""What the bench of a planned session leaves in its captures: noise, repeatability, and smooth errors of the stage."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from wlr_render.captures.correspondences import EyeCaptures
from wlr_render.captures.patterns.catalogue import make_pattern
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import ARCMIN, arcmin_between
from wlr_render.jobs.plan.designs import places_of
from wlr_render.mappings import EyeMappings
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.photographs.photo_bench import PhotoBench
from wlr_render.simulation.photographs.photo_plan import plan_photographs
from wlr_render.simulation.photographs.recipe import SimulationRecipe
from wlr_render.simulation.photographs.simulate_readings import ReadingOptions
from wlr_render.simulation.photographs.stage_errors import StageErrors
from wlr_render.simulation.simulate_captures import CaptureSetup, simulate_display, simulate_see_through

GRID = (17, 13)
"""Directions of a simulated capture: fewer than are read, each with less noise, so that a capture tells as much."""
BARE_LEVELS = 3
"""Levels of each stage axis at which the board is photographed without the headset."""
DEPTH_LEVELS = 5
"""The same where places differ in depth: smooth errors of the stage are then no function of the base plane's points,
which display and see-through would share."""
_CURVE = 71  # stream of random numbers


@dataclass(frozen=True)
class StageCurve:
    """What the calibration of a bench leaves of the smooth errors of its stage.

    Photographs without the headset at some levels of each axis determine a curve through these levels.

    Attributes:
        errors: the stage's own.
        centre: (3,) of the stage's travel.
        levels: number of levels of each axis.
    """

    errors: StageErrors
    centre: FloatArray
    levels: int

    def __call__(self, position: FloatArray) -> FloatArray:
        """Rotation (rad) and displacement (m) of the camera (m, 6) at positions (m, 3)."""
        half = self.errors.half_travel_m
        away = position - self.centre
        left = np.stack([self.errors.motion(each) for each in away])
        levels = np.linspace(-1.0, 1.0, self.levels)
        for axis in range(3):
            at = np.zeros((self.levels, 3))
            at[:, axis] = levels * half[axis]
            known = np.stack([self.errors.motion(each) for each in at])
            found = np.polynomial.polynomial.polyfit(levels, known, self.levels - 1)
            left -= np.polynomial.polynomial.polyval(away[:, axis] / half[axis], found).T
        return left


@dataclass(frozen=True, eq=False)
class PlannedBench:
    """A bench and the captures that it would give.

    Attributes:
        truth: the traced eye.
        recipe: device, code, camera, targets and imperfections.
        noise: of a dot and of a decoded panel position.
        bench: the simulated bench of the recipe.
        in_depth: whether the camera stands before and behind the middle plane, too; the stage is then calibrated at
            more levels.
    """

    truth: EyeMappings
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
            BadInputError: four pixels from the middle, in each direction, is not seen.
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
        """(2,) from the middle of the region of camera places to its edges: where rays through the eye box meet it."""
        box = self.truth.eye_box
        return np.asarray(0.5 * box.size[:2] + 0.5 * box.size[2] * self.field_reach)

    @cached_property
    def field_reach(self) -> FloatArray:
        """(2,) largest |tx| and |ty| of the display's rays."""
        return self.setup().field.reach

    def places(self, unit: FloatArray) -> FloatArray:
        """Camera places (m, 3) of places (m, 3) between -1 and 1; see `designs.places_of`."""
        return places_of(unit, self.truth.eye_box, self.field_reach)

    def setup(self, depths_m: tuple[float, ...] | None = None) -> CaptureSetup:
        """The bench without errors."""
        depths = depths_m or self.recipe.bench.target_depths_m
        return CaptureSetup(self.truth, grid=GRID, target_depths_m=depths)

    def curve(self, draw: int, levels: int | None = None) -> StageCurve:
        """Smooth errors of one of many such stages."""
        rng = np.random.default_rng([self.recipe.bench.seed, _CURVE, draw])
        half = np.append(self.reach_m, 0.5 * self.truth.eye_box.size[2])
        errors = StageErrors.draw(self.recipe.bench.imperfections, half, rng)
        return StageCurve(errors, self.truth.eye_box.centre, levels or (DEPTH_LEVELS if self.in_depth else BARE_LEVELS))

    def captures(
        self, places: FloatArray, seed: list[int], curve: StageCurve | None, depths_m: tuple[float, ...] | None = None
    ) -> EyeCaptures:
        """Simulate the captures of a session with camera places (m, 3)."""
        sizes, rng = self.recipe.bench.imperfections, np.random.default_rng(seed)
        shown, seen = (
            replace(
                self.setup(depths_m),
                camera_noise_arcmin=noise * arcmin * float(np.sqrt(np.prod(GRID) / count)),
                stage_error_m=1e-6 * sizes.repeatability_um,
                stage_turn_rad=1e-6 * sizes.turn_jitter_urad,
                stage_curve=curve,
            )
            for noise, arcmin, count in (
                (self.noise.panel_px, self.panel_arcmin, self.noise.panel_samples),
                (self.noise.dot_px, self.camera_arcmin, self.noise.most_dots),
            )
        )
        return EyeCaptures(simulate_display(shown, places, rng), simulate_see_through(seen, places, rng))

    def photographs(self, places: int) -> dict[str, int]:
        """Number of photographs of a session by what they show."""
        plan = plan_photographs(self.bench, places)
        poses = len(self.bench.device_from_target)
        code = make_pattern(self.recipe.pattern, self.bench.optics.panel.pixels)
        return {
            "codes on the display": places * len(code.names()),
            # The first place of each target pose once more: what moved meanwhile shows there.
            "board through the optics": (places + 1) * poses,
            "board without the headset": len(plan.bare) * len(plan.bare_poses),
            "board by the tracking camera": 2 * poses,
            "board for the lenses": len(plan.eyeball_boards) + len(plan.tracking_boards),
        }

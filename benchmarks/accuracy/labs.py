"""Lab sessions with errors of other function classes than the fitted models: captures and truth.

captures, truth = lab_captures("northstar", level=1.0, seed=3, stated=())
"""

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from benchmarks.accuracy.lab_errors import LAB_SWITCHES, LabWorkshop
from benchmarks.accuracy.lab_statements import SHARED, with_common, with_motion
from benchmarks.accuracy.workshop_captures import display_captures, see_through_captures
from benchmarks.trials import EvaluatedEye, capture_setup, display_observations, see_through_observations
from wlr_render.captures.correspondences import Captures
from wlr_render.errors import BadInputError
from wlr_render.evaluation.mapping_error import DisplayObservations, SeeThroughObservations
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import FloatArray, IntArray

Places = Literal["raster", "planned"]
DEPTHS_M, GRID = (0.6, 1.0, 1.7), (22, 18)
NOISE_ARCMIN = (0.25, 1.0)
"""Range of the noise of a reading, drawn log-uniformly."""
_JITTER = 0.1  # largest shift of planned positions over half their range, as `plan` proposes


@dataclass(frozen=True, eq=False)
class LabTruth:
    """The truth of a session.

    Attributes:
        workshop: errors of the bench.
        shown, seen: exact observations from random viewpoints in the eye box.
        bumped: numbers of the camera positions at which the camera was bumped in the first sweep.
    """

    workshop: LabWorkshop
    shown: DisplayObservations
    seen: SeeThroughObservations
    bumped: IntArray


def lab_captures(
    device: str = "northstar",
    level: float = 1.0,
    seed: int = 1,
    positions: int = 25,
    places: Places = "raster",
    switches: Collection[str] = LAB_SWITCHES,
    stated: Collection[str] = SHARED,
    *,
    bump_um: tuple[float, float] = (20.0, 50.0),
    noise_arcmin: float | None = None,
    eye_box_mm: tuple[float, float, float] = (10.0, 8.0, 6.0),
) -> tuple[Captures, LabTruth]:
    """Simulate one lab session.

    Args:
        device: a shipped device or a device file.
        level: factor on all imperfections except the noise of the readings: 0, 0.5 or 1.
        seed: seed of the imperfections, of all random numbers, and of the truth's viewpoints.
        positions: number of camera positions, a square number.
        places: a serpentine raster, or positions off the raster in random order.
        switches: imperfections that are on, some of `LAB_SWITCHES`.
        stated: errors that the captures state with sizes within 10 %: some of `SHARED`, and "repeatability".
        bump_um: smallest and largest displacement of a bumped visit, times the level.
        noise_arcmin: noise of a reading; None to draw it from the seed.
        eye_box_mm: edge lengths of the eye box.

    Raises:
        BadInputError: an unknown device or switch, or a number of positions that is not a square.
    """
    workshop = LabWorkshop(seed, level, frozenset(switches), bump_um)
    rng = np.random.default_rng([seed, positions, int(places == "raster")])
    drawn = float(np.exp(np.random.default_rng(seed).uniform(*np.log(NOISE_ARCMIN))))
    at = EvaluatedEye(device, "right", eye_box_mm)
    setup = replace(
        capture_setup(at),
        camera_noise_arcmin=drawn if noise_arcmin is None else noise_arcmin,
        grid=GRID,
        target_depths_m=DEPTHS_M,
    )
    viewpoint = lab_positions(setup.truth, setup.field.reach, positions, places, rng)
    display = display_captures(setup, workshop, viewpoint, rng)
    captures = Captures(display, see_through_captures(setup, workshop, viewpoint, rng))
    knowledge = np.random.default_rng([seed, 1])
    if named := [name for name in SHARED if name in stated and name in workshop.switches and level]:
        captures = with_common(captures, setup, workshop, named, knowledge)
    if "repeatability" in stated and level:
        captures = with_motion(captures, level, knowledge)
    bumped = np.flatnonzero(workshop.bumps(positions).any(axis=1))
    return captures, LabTruth(workshop, display_observations(at, seed), see_through_observations(at, seed), bumped)


def lab_positions(eye: Eye, reach: FloatArray, count: int, places: Places, rng: np.random.Generator) -> FloatArray:
    """Return camera positions (count, 3) in the order of their visits, in the middle plane of the eye box."""
    side = round(np.sqrt(count))
    if side * side != count or side < 2:
        raise BadInputError(f"{count} camera positions do not make a square raster; give 4, 9, 16, 25, ...")
    half = 0.5 * eye.eye_box.size[:2] + 0.5 * eye.eye_box.size[2] * reach
    line = np.linspace(-1.0, 1.0, side)
    rows = [np.column_stack([line[:: (-1) ** k], np.full(side, y)]) for k, y in enumerate(line)]
    unit = np.concatenate(rows)
    if places == "planned":
        unit = rng.permutation(unit + rng.uniform(-_JITTER, _JITTER, unit.shape))
        unit = 2.0 * (unit - unit.min(axis=0)) / np.ptp(unit, axis=0) - 1.0
    return np.asarray(eye.eye_box.centre + np.column_stack([unit * half, np.zeros(count)]))

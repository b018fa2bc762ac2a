"""What the extended bench is worth in use: models refitted by it, and the picture that is rendered with them.

How much closer the simulation comes to the measurement is the third way, in `diagnosis.Diagnosis.before` and `after`;
of run-time sessions that is the misalignment already. Causes of the station (camera, stage, target, tracking) spoil the
captures that a calibration is given, so that its models gain. Causes in the device are absorbed by a black-box fit,
whatever the prescription says: there it is the picture that is rendered with the prescription that gains.
"""

from dataclasses import dataclass

import numpy as np

from wlr_render.captures.session import Session
from wlr_render.diagnosis.refit import Refitted, refit_display, refit_see_through
from wlr_render.errors import BadInputError
from wlr_render.evaluation import mapping_error
from wlr_render.evaluation.metrics import Summary, summary
from wlr_render.evaluation.misalignment import misalignment_arcmin
from wlr_render.mappings import DisplayMapping, EyeMappings, SeeThroughMapping
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.traced_mappings import TracedDisplay, TracedSeeThrough
from wlr_render.simulation.bench import Bench
from wlr_render.simulation.viewpoints import random_in_eye_box

DISTANCES_M = (0.5, 1.0, 2.0)
"""Of the real points that the picture is rendered onto, in front of the eye."""

_VIEWPOINTS, _PIXELS = 20, (8, 8)
_GREEN = 1


@dataclass(frozen=True)
class Rendered:
    """Misalignment in arcminutes of virtual points rendered onto real ones, at the same points before and after.

    Attributes:
        before, after: as the nominal and as the extended bench would have it rendered.
    """

    before: Summary
    after: Summary


@dataclass(frozen=True)
class Gains:
    """What the extension is worth; None where the session does not allow the comparison.

    Attributes:
        display, see_through: refitted models on held-out captures.
        calibrated: the picture rendered with refitted models, as the extended device shows it.
        prescribed: the picture rendered with the device's prescription, as the models that were refitted by the
            extended bench show it: the judge is measured, not simulated.
        lacking: a sentence on each part that could not be refitted.
    """

    display: Refitted | None
    see_through: Refitted | None
    calibrated: Rendered | None
    prescribed: Rendered | None
    lacking: tuple[str, ...]


def gains(nominal: Bench, extended: Bench, session: Session) -> Gains:
    """Measure what the extension is worth.

    Args:
        nominal: the bench as its makers believe it to be.
        extended: the bench with what was found.
        session: without the captures that were set aside.
    """
    display = see_through = None
    lacking = []
    try:
        display = refit_display(nominal, extended, session)
    except BadInputError as error:
        lacking.append(str(error))
    try:
        see_through = refit_see_through(nominal, extended, session)
    except BadInputError as error:
        lacking.append(str(error))
    calibrated = prescribed = None
    if display is not None and see_through is not None:
        old = _eye(extended, display.before, see_through.before)
        new = _eye(extended, display.after, see_through.after)
        was, truth = _traced(nominal), _traced(extended)
        viewpoint, point = _places(truth, new)
        calibrated = _rendered(truth, old, new, viewpoint, point)
        prescribed = _rendered(new, was, truth, viewpoint, point)
    return Gains(
        display.refitted if display else None,
        see_through.refitted if see_through else None,
        calibrated,
        prescribed,
        tuple(lacking),
    )


def _eye(bench: Bench, display: DisplayMapping, see_through: SeeThroughMapping) -> EyeMappings:
    return EyeMappings(bench.device.name, bench.eye, display, see_through, bench.optics.eye_box)


def _traced(bench: Bench) -> EyeMappings:
    """The device as the session's captures saw it: its panel in green, the world in the targets' light."""
    display = TracedDisplay(bench.optics, bench.wavelengths_um[_GREEN])
    return _eye(bench, display, TracedSeeThrough(bench.optics, bench.target_wavelength_um))


def _places(truth: EyeMappings, model: EyeMappings) -> tuple[FloatArray, FloatArray]:
    """Viewpoints (n, 3) in the eye box and real points (n, 3) that the panel covers, none outside the model's fit."""
    rng = np.random.default_rng(0)
    eyes = random_in_eye_box(truth.eye_box, _VIEWPOINTS, rng)[:, None, None]
    shown = mapping_error.sightings_of_pixels(truth.display, eyes, truth.display.panel.grid(*_PIXELS)[None])
    depth = rng.choice(DISTANCES_M, len(shown.pixel))
    seen = mapping_error.see_through_sightings(truth.see_through, shown.viewpoint, shown.view_dir, depth)
    kept = model.display.pixel_of_view_dir(seen.view_dir, seen.viewpoint).ok
    kept &= model.see_through.view_dir_of_real_point(seen.point, seen.viewpoint).ok
    return seen.viewpoint[kept], seen.point[kept]


def _rendered(
    judge: EyeMappings, before: EyeMappings, after: EyeMappings, viewpoint: FloatArray, point: FloatArray
) -> Rendered:
    old, new = (
        misalignment_arcmin(judge, viewpoint, _lit_pixel(eye, viewpoint, point), point) for eye in (before, after)
    )
    both = np.isfinite(old) & np.isfinite(new)
    return Rendered(summary(old[both]), summary(new[both]))


def _lit_pixel(eye: EyeMappings, viewpoint: FloatArray, point: FloatArray) -> FloatArray:
    """The panel position (n, 2) that rendering with an eye's mappings lights for a real point."""
    seen = eye.see_through.view_dir_of_real_point(point, viewpoint)
    return eye.display.pixel_of_view_dir(seen.value, viewpoint).value

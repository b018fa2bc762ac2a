"""Improvement in use: models refitted with the corrected bench, and the picture rendered with them.

`diagnosis.Diagnosis.before` and `after` compare the simulation with the measurement; for run-time sessions they are
the misalignment itself. Causes in the station (camera, stage, target, tracking) spoil the captures for a calibration,
so correcting them improves its models. Causes in the device are absorbed by a black-box fit, whatever the prescription
says: correcting them improves the picture that is rendered with the prescription.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np

from wlr_render.bench.bench import Bench
from wlr_render.bench.session_captures import display_captures, see_through_captures
from wlr_render.calibration.fit_display import fit_display
from wlr_render.calibration.fit_report import AnyModel, ModelFit
from wlr_render.calibration.fit_see_through import fit_see_through
from wlr_render.captures.correspondences import AnyCaptures, select
from wlr_render.captures.session import AnyPlan, Session
from wlr_render.diagnosis.held_out import HeldOutImprovement, held_out_improvement
from wlr_render.errors import BadInputError
from wlr_render.evaluation import mapping_error
from wlr_render.evaluation.metrics import Summary, summary
from wlr_render.evaluation.misalignment import misalignment_arcmin
from wlr_render.geometry.directions import arcmin_between
from wlr_render.mappings import DisplayMapping, Eye, SeeThroughMapping
from wlr_render.numerics.arrays import BoolArray, FloatArray
from wlr_render.optics.traced_mappings import TracedDisplay, TracedSeeThrough
from wlr_render.simulation.viewpoints import random_in_eye_box

_ROWS = 6_000  # most rows of a fit; five times as many lower its error by a twentieth and take three times as long
_HELD_OUT = 4  # one photograph in this many is held out


@dataclass(frozen=True)
class Refitted:
    """A model refitted to the captures as the nominal and as the corrected bench describe them.

    Attributes:
        before, after: rms error in arcminutes on held-out captures, placed by the corrected bench.
        improvement: improvement of `after` over `before`.
    """

    before: float
    after: float
    improvement: HeldOutImprovement


def _refit(
    before: AnyCaptures, after: AnyCaptures, fit: Callable[[AnyCaptures], ModelFit[AnyModel]]
) -> tuple[AnyModel, AnyModel, Refitted]:
    """Fit one side of the headset to its captures as the nominal and as the corrected bench describe them.

    Returns:
        The model fitted with each bench, and the errors of both.

    Raises:
        BadInputError: the captures do not determine a model.
    """

    def models(rows: BoolArray) -> tuple[ModelFit[AnyModel], ModelFit[AnyModel]]:
        old, new = select(before, rows), select(after, rows)
        first = fit(old)
        return first, first if _same(old, new) else fit(new)

    rng = np.random.default_rng(0)
    rows = np.sort(rng.permutation(len(before))[:_ROWS])
    before, after = select(before, rows), select(after, rows)
    names = np.unique(before.capture)
    out = np.isin(before.capture, rng.permutation(names)[: max(2, len(names) // _HELD_OUT)])
    (old, new), judge = models(np.ones_like(out)), select(after, out)
    errors = np.array([arcmin_between(model.seen(judge).value, judge.view_dir) for model in models(~out)])
    both = np.isfinite(errors).all(axis=0)
    was, now = (float(np.sqrt(np.mean(each[both] ** 2))) for each in errors)
    improvement = held_out_improvement(errors[0][both], errors[1][both], judge.capture[both])
    return old.mapping, new.mapping, Refitted(was, now, improvement)


def _same(before: AnyCaptures, after: AnyCaptures) -> bool:
    """Return whether both benches yield identical captures, so that one fit can serve both."""
    arrays = [(getattr(before, field.name), getattr(after, field.name)) for field in fields(before)]
    return all(np.array_equal(a, b) for a, b in arrays if isinstance(a, np.ndarray))


DISTANCES_M = (0.5, 1.0, 2.0)
"""Distances from the eye of the real points onto which the picture is rendered."""

_VIEWPOINTS, _PIXELS = 20, (8, 8)  # samples of the rendered picture: viewpoints, and a grid of panel pixels
_GREEN = 1


@dataclass(frozen=True)
class Rendered:
    """Misalignment in arcminutes of virtual points rendered onto real ones, at the same points before and after.

    Attributes:
        before, after: picture rendered with the nominal and with the corrected bench.
    """

    before: Summary
    after: Summary


@dataclass(frozen=True)
class ImprovementInUse:
    """Improvement by the corrected bench; None where the session does not allow the comparison.

    Attributes:
        display, see_through: refitted models on held-out captures.
        calibrated: the picture rendered with refitted models, as the corrected device shows it.
        prescribed: the picture rendered with the device's prescription, as the models refitted with the corrected
            bench show it: these models come from measurements, not from simulation.
        unavailable: a sentence on each part that could not be refitted.
    """

    display: Refitted | None
    see_through: Refitted | None
    calibrated: Rendered | None
    prescribed: Rendered | None
    unavailable: tuple[str, ...]


def improvement_in_use(nominal: Bench, corrected: Bench, session: Session) -> ImprovementInUse:
    """Compare models and pictures made with two benches.

    Args:
        nominal: the bench as described.
        corrected: the bench with the causes found.
        session: session without excluded captures.
    """
    plan, readings, unavailable = session.plan, session.readings, list[str]()

    def refitted(
        what: tuple[str, str],
        rows: AnyPlan | None,
        pixel: FloatArray | None,
        captures: Callable[[Bench, AnyPlan, FloatArray], AnyCaptures],
        fit: Callable[[AnyCaptures], ModelFit[AnyModel]],
    ) -> tuple[AnyModel, AnyModel, Refitted] | None:
        try:
            if rows is None or pixel is None:
                table, side = what
                raise BadInputError(f"{session.name}: has no {table} table, so no {side} model can be fitted; add one.")
            return _refit(captures(nominal, rows, pixel), captures(corrected, rows, pixel), fit)
        except BadInputError as error:
            unavailable.append(str(error))
            return None

    display = refitted(("display", "display"), plan.display, readings.panel_pixel, display_captures, fit_display)
    see_through = refitted(
        ("seethrough", "see-through"), plan.see_through, readings.dot_pixel, see_through_captures, fit_see_through
    )
    calibrated = prescribed = None
    if display is not None and see_through is not None:
        old, new = _eye(corrected, display[0], see_through[0]), _eye(corrected, display[1], see_through[1])
        was, truth = _traced(nominal), _traced(corrected)
        places = _places(truth, new)
        calibrated, prescribed = _rendered(truth, old, new, *places), _rendered(new, was, truth, *places)
    first, second = (each[2] if each else None for each in (display, see_through))
    return ImprovementInUse(first, second, calibrated, prescribed, tuple(unavailable))


def _eye(bench: Bench, display: DisplayMapping, see_through: SeeThroughMapping) -> Eye:
    return Eye(bench.device.name, bench.eye, display, see_through, bench.optics.eye_box)


def _traced(bench: Bench) -> Eye:
    """Return the device at the wavelengths of the captures: its panel in green, the world in the targets' light."""
    display = TracedDisplay(bench.optics, bench.wavelengths_um[_GREEN])
    return _eye(bench, display, TracedSeeThrough(bench.optics, bench.target_wavelength_um))


def _places(truth: Eye, model: Eye) -> tuple[FloatArray, FloatArray]:
    """Return viewpoints (n, 3) in the eye box, and real points (n, 3) within the panel's field and the model's fit."""
    rng = np.random.default_rng(0)
    eyes = random_in_eye_box(truth.eye_box, _VIEWPOINTS, rng)[:, None, None]
    shown = mapping_error.observations_of_pixels(truth.display, eyes, truth.display.panel.grid(*_PIXELS)[None])
    depth = rng.choice(DISTANCES_M, len(shown.pixel))
    seen = mapping_error.see_through_observations(truth.see_through, shown.viewpoint, shown.view_dir, depth)
    kept = model.display.pixel_of_view_dir(seen.view_dir, seen.viewpoint).ok
    kept &= model.see_through.view_dir_of_real_point(seen.point, seen.viewpoint).ok
    return seen.viewpoint[kept], seen.point[kept]


def _rendered(judge: Eye, before: Eye, after: Eye, viewpoint: FloatArray, point: FloatArray) -> Rendered:
    errors = []
    for eye in (before, after):
        seen = eye.see_through.view_dir_of_real_point(point, viewpoint).value
        lit = eye.display.pixel_of_view_dir(seen, viewpoint).value
        errors.append(misalignment_arcmin(judge, viewpoint, lit, point))
    both = np.isfinite(errors).all(axis=0)
    return Rendered(*(summary(each[both]) for each in errors))

"""Camera places to add to a calibration, each chosen to lower the predicted registration error most."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from wlr_render.calibration.fit_display import fit_display
from wlr_render.calibration.fit_see_through import fit_see_through
from wlr_render.captures.capture_file import load_captures
from wlr_render.captures.correspondences import AnyCaptures, DisplayCaptures, select
from wlr_render.errors import BadInputError
from wlr_render.evaluation.metrics import Summary, summary
from wlr_render.geometry import rays
from wlr_render.jobs.plan.plan_report import error_map, places_table
from wlr_render.mappings import Eye
from wlr_render.models.fitted_model import FittedDisplay, FittedSeeThrough
from wlr_render.numerics.arrays import FloatArray
from wlr_render.planning.designs import offered, places_of
from wlr_render.planning.place_choice import PlaceChoice, further_distance
from wlr_render.planning.planned_bench import PlannedBench
from wlr_render.planning.planned_errors import FAR_M, NEAR_M, EyeTests, PlannedFit, registration_variance
from wlr_render.report.blocks import Block, Cell, Columns, Number, Report, table

_ROWS = 220  # most rows of each capture; a smaller sigma gives them the same information at less cost
_TESTS = 800
_WORTH = 0.02  # smallest gain worth another place, as a share of the error


@dataclass(frozen=True)
class _Step:
    """Predicted registration errors with places (m, 3) added."""

    places: FloatArray
    models: tuple[FittedDisplay, FittedSeeThrough]
    errors: Summary


def plan_next_places(
    bench: PlannedBench, folder: Path, accuracy_arcmin: float, most: int, say: Callable[[str], object]
) -> tuple[Report, FloatArray]:
    """Plan the places to add to a calibration; return the report and the places (m, 3) from the eye box's centre.

    Args:
        bench: the headset and the stage.
        folder: folder with captures-EYE.npz.
        accuracy_arcmin: goal for the registration error of 95 % of the eye box.
        most: largest number of places.
        say: called with a sentence at each step.

    Raises:
        BadInputError: the folder has no captures of this eye, or they lack the display or see-through.
    """
    truth = bench.truth
    path = folder / f"captures-{truth.eye}.npz"
    if not path.is_file():
        raise BadInputError(f"{path}: there is no such file; name the output folder of a calibrate verb with this eye.")
    display, see_through = load_captures(path).both
    say("fitting the captures")
    fit = PlannedFit(fit_display(_thinned(display)), fit_see_through(_thinned(see_through)))
    box = display.eye_box
    tests = _tests(fit, display)
    reach = np.abs(display.tangents).max(axis=0)
    now = (fit.display.mapping, fit.see_through.mapping)
    steps = [_Step(np.zeros((0, 3)), now, _predicted(*now, tests))]
    target, order = None, np.zeros((0, 3))
    poses = np.unique(see_through.target_pose)
    depths = [float(box.centre[2] - see_through.point[see_through.target_pose == each, 2].mean()) for each in poses]
    if steps[0].errors.p95 > accuracy_arcmin:
        say("choosing places")
        places = places_of(offered(box, reach, bench.in_depth), box, reach)
        order = places[PlaceChoice.of(fit, places, depths, is_added=True).one_by_one(most)[0]]
    while len(steps[-1].places) < len(order) and steps[-1].errors.p95 > accuracy_arcmin:
        say(f"predicting with {len(steps)} places")
        steps.append(_with_places(fit, order[: len(steps)], tests))
    added = steps[-1].places
    if len(added):
        target = further_distance(fit, added, depths, is_added=True)
    return _report(truth, path, display.device, steps, accuracy_arcmin, tests, target), added - box.centre


def _thinned(captures: AnyCaptures) -> AnyCaptures:
    """Return fewer rows of each capture, with a smaller sigma instead."""
    rng, kept, factor = np.random.default_rng(0), [], np.ones(len(captures))
    pose = getattr(captures, "target_pose", np.zeros(len(captures), dtype=np.int64))
    for name in np.unique(np.stack([captures.capture, pose], axis=1), axis=0):
        rows = np.flatnonzero((captures.capture == name[0]) & (pose == name[1]))
        chosen = rng.permutation(rows)[:_ROWS]
        factor[chosen] = np.sqrt(len(chosen) / len(rows))
        kept.append(np.sort(chosen))
    return select(replace(captures, sigma_arcmin=captures.sigma_arcmin * factor), np.concatenate(kept))


def _tests(fit: PlannedFit, shown: DisplayCaptures) -> EyeTests:
    """Return tests at random viewpoints and captured pixels, with directions and points from the models."""
    rng = np.random.default_rng(0)
    viewpoint = shown.eye_box.at(rng.uniform(-1.0, 1.0, (_TESTS, 3)))
    pixel = shown.pixel[rng.integers(0, len(shown), _TESTS)]
    view_dir = fit.display.mapping.view_dir_of_pixel(pixel, viewpoint)
    ray = fit.see_through.mapping.real_ray_of_view_dir(view_dir.value, viewpoint)
    depth = 1.0 / rng.uniform(1.0 / FAR_M, 1.0 / NEAR_M, _TESTS)
    known = view_dir.usable & ray.usable
    point = rays.split(rays.at_z(ray.value[known], viewpoint[known, 2] - depth[known]))[0]
    return EyeTests(viewpoint[known], pixel[known], point, view_dir.value[known])


def _with_places(fit: PlannedFit, places: FloatArray, tests: EyeTests) -> _Step:
    models = fit.display.with_positions(places), fit.see_through.with_positions(places)
    return _Step(places, models, _predicted(*models, tests))


def _predicted(display: FittedDisplay, see_through: FittedSeeThrough, tests: EyeTests) -> Summary:
    """Return the predicted registration error: a summary of the lengths of random errors."""
    sigma = np.sqrt(registration_variance(display, see_through, tests.pixel, tests.viewpoint, tests.point))
    return summary(sigma / np.sqrt(2.0) * np.random.default_rng(0).rayleigh(1.0, (8, len(sigma))))


def _report(
    truth: Eye,
    path: Path,
    device: str,
    steps: list[_Step],
    accuracy_arcmin: float,
    tests: EyeTests,
    target: tuple[float, float] | None,
) -> Report:
    first, last, box = steps[0], steps[-1], steps[0].models[0].eye_box
    found = f"predicted registration error {first.errors.median:.2g}' in the median, {first.errors.p95:.2g}' at 95 %"
    if len(steps) == 1:
        verdict = f"The calibration reaches the wanted {accuracy_arcmin:g}' ({found} of the eye box): add no places."
        advice: list[str] = []
    else:
        reached = "reaches" if last.errors.p95 <= accuracy_arcmin else "does not reach"
        verdict = (
            f"Add {len(last.places)} camera places: the {found} of the eye box, falls to {last.errors.p95:.2g}' at "
            f"95 %, which {reached} the wanted {accuracy_arcmin:g}'."
        )
        advice = ["Photograph the display and the board at the places of places.csv, then calibrate again."]
        if last.errors.p95 > accuracy_arcmin:
            advice.append("Plan more places with --add, or improve the bench: `plan` without --calibration says what.")
    if target is not None and target[1] < 1.0 - _WORTH:
        gain = 100.0 * (1.0 - target[1])
        advice.append(f"Photograph the board from them at {target[0]:g} m, too: this lowers the error by {gain:.0f} %.")

    def of_last(k: int) -> Callable[[_Step], Cell]:
        return lambda step: Number(1e3 * (step.places[-1] - box.centre)[k], "+z.3f") if len(step.places) else None

    columns: Columns = {
        **{f"{axis} (mm)": of_last(k) for k, axis in enumerate("xyz")},
        "registration, median (arcmin)": "errors.median",
        "registration, 95 % (arcmin)": "errors.p95",
    }
    notes = (
        "Each place lowers the predicted error most, given the places above it. The choice ignores errors that all "
        "captures share; the predictions include them if the captures state them.",
    )
    blocks: list[Block] = [
        table("Places to add, one by one", enumerate(steps), columns, notes, name="places added"),
        error_map(*first.models, box, last.places, tests),
    ]
    if len(last.places):
        blocks.append(places_table(last.places - box.centre))
    warnings = [] if device == truth.name else [f"The captures are of {device}, not of {truth.name}; check HEADSET."]
    title = f"Places to add to the calibration of {device}, {truth.eye} eye"
    record = {"predicted": [step.errors for step in steps]}
    return Report(title, verdict, advice, warnings, blocks, inputs=[path], record=record)

"""Camera places to add to a calibration, each where it lowers the predicted registration error most."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from wlr_render.calibration.base_plane import choose_base_plane
from wlr_render.calibration.fit_display import fit_display
from wlr_render.calibration.fit_see_through import fit_see_through
from wlr_render.captures.capture_file import load_captures
from wlr_render.captures.correspondences import AnyCaptures, DisplayCaptures, select
from wlr_render.errors import BadInputError
from wlr_render.evaluation.metrics import Summary, summary
from wlr_render.geometry import rays
from wlr_render.jobs.plan.designs import candidates, largest
from wlr_render.jobs.plan.plan_report import error_map, places_table
from wlr_render.jobs.plan.prediction import EyeTests, PlannedFit, place_variance
from wlr_render.mappings import EyeMappings
from wlr_render.models.fitted_model import FittedDisplay, FittedSeeThrough
from wlr_render.numerics.arrays import FloatArray
from wlr_render.report.blocks import Block, Cell, Report, ReportTable

_ROWS = 220  # of each capture, with smaller sigma: it tells as much, and costs less
_TRIED = 3  # places of large variance among which the one that helps most is taken
_TESTS = 800
_WORTH = 0.02  # of the error: fewer is no gain
_NEAR_M, _FAR_M = 0.3, 5.0


@dataclass(frozen=True)
class _Step:
    """Predicted registration errors with places (m, 3) added."""

    places: FloatArray
    models: tuple[FittedDisplay, FittedSeeThrough]
    errors: Summary


def plan_next_places(
    truth: EyeMappings, folder: Path, accuracy_arcmin: float, most: int, say: Callable[[str], object]
) -> tuple[Report, FloatArray]:
    """Plan the places to add to a calibration; returns the report and the places (m, 3) from the eye box's centre.

    Args:
        truth: the headset.
        folder: with captures-EYE.npz.
        accuracy_arcmin: wanted registration error of 95 % of the eye box.
        most: places at most.
        say: is told what is being done.

    Raises:
        BadInputError: there are no captures of this eye, or they lack the display or see-through.
    """
    path = folder / f"captures-{truth.eye}.npz"
    if not path.is_file():
        raise BadInputError(f"{path}: there is no such file; name the output folder of a calibrate verb with this eye.")
    display, see_through = load_captures(path).both
    say("fitting the captures")
    fit = PlannedFit(fit_display(_thinned(display)), fit_see_through(_thinned(see_through)))
    box, plane = display.eye_box, choose_base_plane(display.viewpoint, display.eye_box)
    tests = _tests(fit, display)
    reach = 0.5 * box.size[:2] + 0.5 * box.size[2] * np.abs(display.tangents).max(axis=0)
    flat = box.centre[:2] + candidates() * reach
    offered = np.concatenate([flat, plane.z_at(flat)[:, None]], axis=1)
    taken = (np.unique(display.viewpoint, axis=0)[:, :2] - box.centre[:2]) / reach
    now = (fit.display.mapping, fit.see_through.mapping)
    steps = [_Step(np.zeros((0, 3)), now, _predicted(*now, tests))]
    while len(steps[-1].places) < most and steps[-1].errors.p95 > accuracy_arcmin:
        say(f"choosing place {len(steps)}")
        last = steps[-1]
        own = (last.places[:, :2] - box.centre[:2]) / reach
        variance = place_variance(*last.models, offered, tests)
        best = largest(variance, candidates(), np.concatenate([taken, own]), _TRIED)
        tried = [_with_places(fit, np.concatenate([last.places, offered[each][None]]), tests) for each in best]
        steps.append(min(tried, key=lambda each: each.errors.rms))
    return _report(truth, path, display.device, steps, accuracy_arcmin, tests), steps[-1].places - box.centre


def _thinned(captures: AnyCaptures) -> AnyCaptures:
    """Fewer rows of each capture, with smaller sigma instead."""
    rng, kept, factor = np.random.default_rng(0), [], np.ones(len(captures))
    pose = getattr(captures, "target_pose", np.zeros(len(captures), dtype=np.int64))
    for name in np.unique(np.stack([captures.capture, pose], axis=1), axis=0):
        rows = np.flatnonzero((captures.capture == name[0]) & (pose == name[1]))
        chosen = rng.permutation(rows)[:_ROWS]
        factor[chosen] = np.sqrt(len(chosen) / len(rows))
        kept.append(np.sort(chosen))
    return select(replace(captures, sigma_arcmin=captures.sigma_arcmin * factor), np.concatenate(kept))


def _tests(fit: PlannedFit, shown: DisplayCaptures) -> EyeTests:
    """Random viewpoints, and directions that the captures saw, as the models have them."""
    rng = np.random.default_rng(0)
    viewpoint = shown.eye_box.at(rng.uniform(-1.0, 1.0, (_TESTS, 3)))
    pixel = shown.pixel[rng.integers(0, len(shown), _TESTS)]
    view_dir = fit.display.mapping.view_dir_of_pixel(pixel, viewpoint)
    ray = fit.see_through.mapping.real_ray_of_view_dir(view_dir.value, viewpoint)
    depth = 1.0 / rng.uniform(1.0 / _FAR_M, 1.0 / _NEAR_M, _TESTS)
    known = view_dir.usable & ray.usable
    point = rays.split(rays.at_z(ray.value[known], viewpoint[known, 2] - depth[known]))[0]
    return EyeTests(viewpoint[known], pixel[known], point, view_dir.value[known])


def _with_places(fit: PlannedFit, places: FloatArray, tests: EyeTests) -> _Step:
    models = fit.display.with_positions(places), fit.see_through.with_positions(places)
    return _Step(places, models, _predicted(*models, tests))


def _predicted(display: FittedDisplay, see_through: FittedSeeThrough, tests: EyeTests) -> Summary:
    """Registration error: median and 95 % of the lengths of random errors."""
    sigma = np.hypot(display.sigma(tests.pixel, tests.viewpoint), see_through.sigma(tests.point, tests.viewpoint))
    return summary(sigma / np.sqrt(2.0) * np.random.default_rng(0).rayleigh(1.0, (8, len(sigma))))


def _report(
    truth: EyeMappings, path: Path, device: str, steps: list[_Step], accuracy_arcmin: float, tests: EyeTests
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
    rows: list[list[Cell]] = []
    for number, step in enumerate(steps):
        at: list[Cell] = [None, None]
        if number:
            at = [f"{1e3 * each:+.3f}" for each in (step.places[-1] - box.centre)[:2]]
        rows.append([number, *at, step.errors.median, step.errors.p95])
    columns = ["places added", "x (mm)", "y (mm)", "registration, median (arcmin)", "registration, 95 % (arcmin)"]
    notes = (
        "Each place is the one that lowers the predicted error most. Errors common to all captures are not in it.",
    )
    blocks: list[Block] = [
        ReportTable("Places to add, one by one", columns, rows, notes),
        error_map(*first.models, box, last.places, tests),
    ]
    if len(last.places):
        blocks.append(places_table(last.places - box.centre))
    warnings = [] if device == truth.name else [f"The captures are of {device}, not of {truth.name}; check HEADSET."]
    title = f"Places to add to the calibration of {device}, {truth.eye} eye"
    record = {"predicted": [step.errors for step in steps]}
    return Report(title, verdict, advice, warnings, blocks, inputs=[path], record=record)

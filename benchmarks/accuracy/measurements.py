"""Measurements: errors of models by device, number of camera positions, camera noise, field and stage."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from benchmarks.accuracy import wanted
from benchmarks.accuracy.prescribed_trial import SEE_THROUGH_PREDICTED, PrescribedTrial
from benchmarks.trial_study import Findings, Lines, Study, error_curves, pooled, trial_at
from benchmarks.trials import (
    FARTHEST_M,
    NEAREST_M,
    DisplayTrial,
    EvaluatedEye,
    FoundBench,
    Measure,
    NoModelTrial,
    Outcome,
    SeeThroughTrial,
)
from wlr_render.report.blocks import Cell, ReportTable

POSITIONS, FEW_POSITIONS = 25, 16
NOISES_ARCMIN = (wanted.EXACT, wanted.FINE, wanted.COARSE)
STAGES_UM_URAD = ((0.0, 0.0), (10.0, 30.0), (30.0, 100.0))
STAGE_NOISE_ARCMIN = 0.25
STUCK_DEVICE, STUCK_STAGE = "northstar", STAGES_UM_URAD[-1]
TRACKING_MM = 0.05
"""Error of eye tracking per axis."""
SAMPLINGS = ("planar", "volumetric")
_OTHER_DISPLAYS, _SEE_THROUGHS = ("volumetric", "point-per-pixel", "static"), ("planar", "volumetric", "static")
_PRESCRIBED = ("planar", "prescription", "grey-box")
_ERROR_COLUMNS = ("rms (arcmin)", "standard error", "wanted", "predicted (arcmin)", "predicted / true")
_FOUND_COLUMNS = ("noise found (arcmin)", "stage shift found (um)", "stage turn found (urad)")


def camera_positions(study: Study, counts: Sequence[int]) -> Findings:
    """Measure the display error by number of camera positions, planar and volumetric, with exact captures."""
    rows: list[list[Cell]] = []
    lines: Lines = {}
    predicted: Lines = {}
    for eye, kind in product(study.eyes, SAMPLINGS):
        outcomes = [[study.outcome_of(trial_at(DisplayTrial, eye, kind, None, count))] for count in counts]
        rows += [
            [str(eye), kind, count, *_errors(each, Measure.FORWARD, None)]
            for count, each in zip(counts, outcomes, strict=True)
        ]
        for curves, measure in ((lines, Measure.FORWARD), (predicted, Measure.PREDICTED)):
            curves[f"{eye}, {kind}"] = counts, [pooled(each, measure) for each in outcomes]
    title = "Camera positions: direction of a pixel, exact captures"
    table = ReportTable(title, ["eye", "model", "camera positions", *_ERROR_COLUMNS], rows)
    return Findings((table, error_curves(title, "number of camera positions", lines, predicted)))


def display(study: Study) -> Findings:
    """Measure the direction of a pixel: in the nominal field, over the panel, with few positions, by other models."""
    designs = [
        ("planar", "nominal field", False, POSITIONS, wanted.DISPLAY),
        ("planar", "whole panel", True, POSITIONS, wanted.WHOLE_PANEL),
        ("planar", "nominal field", False, FEW_POSITIONS, wanted.FEW_POSITIONS),
        *((kind, "nominal field", False, POSITIONS, {}) for kind in _OTHER_DISPLAYS),
    ]
    rows: list[list[Cell]] = []
    for (kind, field, whole, positions, goals), eye, noise in product(designs, study.eyes, NOISES_ARCMIN):
        trial = trial_at(DisplayTrial, replace(eye, whole_panel=whole), kind, None, positions)
        draws = study.repeated(replace(trial, camera_noise_arcmin=noise))
        errors = _errors(draws, Measure.FORWARD, _goal(goals, eye, noise))
        rows.append([str(eye), kind, field, positions, noise, *errors, pooled(draws, Measure.BACKWARD), *_fit(draws)])
    columns = ["eye", "model", "field", "camera positions", "camera noise (arcmin)", *_ERROR_COLUMNS]
    columns += ["backward (px)", "noise found (arcmin)", "fit (s)"]
    notes = ("Backward: pixel of a direction. A static model is fitted at one of the camera positions.",)
    return Findings((ReportTable(f"Display: direction of a pixel, {_draws(study)}", columns, rows, notes),))


def see_through(study: Study) -> Findings:
    """Measure the direction of a real point: without a model, and by each kind of model."""
    rows: list[list[Cell]] = []
    for eye in study.eyes:
        without = study.outcome_of(NoModelTrial(eye)).rms(Measure.REAL_POINT)
        rows.append([str(eye), "none", None, without, *[None] * 8])
        for kind, noise in product(_SEE_THROUGHS, NOISES_ARCMIN):
            draws = study.repeated(trial_at(SeeThroughTrial, eye, kind, None, POSITIONS, camera_noise_arcmin=noise))
            goal = _goal(wanted.SEE_THROUGH, eye, noise) if kind == "planar" else None
            world = [pooled(draws, measure) for measure in (Measure.REAL_RAY, Measure.MISS)]
            rows.append([str(eye), kind, noise, *_errors(draws, Measure.REAL_POINT, goal), *world, *_fit(draws)])
    columns = ["eye", "model", "camera noise (arcmin)", *_ERROR_COLUMNS]
    columns += ["real ray (arcmin)", "miss (mm)", "noise found (arcmin)", "fit (s)"]
    where = f"real points at {NEAREST_M:g} to {FARTHEST_M:g} m, {POSITIONS} camera positions"
    notes = ("Real ray: its direction; miss: its distance from the real point.",)
    return Findings(
        (ReportTable(f"See-through: direction of a real point, {where}, {_draws(study)}", columns, rows, notes),)
    )


def stage(study: Study) -> Findings:
    """Compare predicted with true errors of display and see-through, with errors of the stage."""
    rows: list[list[Cell]] = []
    models = (("display", DisplayTrial, Measure.FORWARD), ("see-through", SeeThroughTrial, Measure.REAL_POINT))
    for (name, kind, measure), eye, (shift, turn) in product(models, study.eyes, STAGES_UM_URAD):
        errors = {"stage_error_mm": 1e-3 * shift, "stage_turn_urad": turn, "camera_noise_arcmin": STAGE_NOISE_ARCMIN}
        draws = study.repeated(trial_at(kind, eye, "planar", None, POSITIONS, **errors))
        rms = pooled(draws, measure)
        predicted = pooled(draws, Measure.PREDICTED)
        rows.append([str(eye), name, shift, turn, rms, predicted, predicted / rms, *_found(draws)])
    columns = ["eye", "model", "stage shift (um)", "stage turn (urad)", "rms (arcmin)", "predicted (arcmin)"]
    columns += ["predicted / true", *_FOUND_COLUMNS]
    low, high = wanted.PREDICTED_OVER_TRUE
    title = f"Errors of the stage: {POSITIONS} camera positions, {STAGE_NOISE_ARCMIN:g}' camera noise, {_draws(study)}"
    notes = (f"Wanted: predicted / true of {low:g} to {high:g}.", "Errors of the stage are drawn anew at each visit.")
    return Findings((ReportTable(title, columns, rows, notes),))


def tracking(study: Study) -> Findings:
    """Measure the direction of a pixel with an error of eye tracking in use."""
    rows: list[list[Cell]] = []
    for eye in study.eyes:
        exact = trial_at(DisplayTrial, eye, "planar", None, POSITIONS, camera_noise_arcmin=STAGE_NOISE_ARCMIN)
        pair = [study.repeated(replace(exact, tracking_error_mm=error)) for error in (0.0, TRACKING_MM)]
        rows.append([str(eye), *(pooled(draws, Measure.FORWARD) for draws in pair)])
    columns = ["eye", "exact viewpoint (arcmin)", f"tracked to {TRACKING_MM:g} mm per axis (arcmin)"]
    title = f"Eye tracking: direction of a pixel, {POSITIONS} camera positions, {STAGE_NOISE_ARCMIN:g}' camera noise"
    return Findings((ReportTable(f"{title}, {_draws(study)}", columns, rows),))


def prescribed(study: Study) -> Findings:
    """Compare models that use a prescription differing from the headset with a model that uses none."""
    rows: list[list[Cell]] = []
    for eye, (positions, noise, shape, goal), kind in product(study.eyes, wanted.GREY_BOX, _PRESCRIBED):
        errors = {"camera_noise_arcmin": noise, "shape": shape}
        draws = study.repeated(trial_at(PrescribedTrial, eye, kind, None, positions, **errors))
        limit = goal if kind == "grey-box" else None
        see_through = [pooled(draws, measure) for measure in (Measure.REAL_POINT, SEE_THROUGH_PREDICTED)]
        where: list[Cell] = [str(eye), positions, noise, 100.0 * shape, kind]
        rows.append([*where, *_errors(draws, Measure.FORWARD, limit), *see_through])
    columns = ["eye", "camera positions", "camera noise (arcmin)", "error of the shape (%)", "model", *_ERROR_COLUMNS]
    columns += ["see-through rms (arcmin)", "see-through predicted (arcmin)"]
    title = f"Headsets that differ from their prescription: 0.2 degrees, 0.3 mm and a wrong shape, {_draws(study)}"
    return Findings((ReportTable(title, columns, rows),))


def time(study: Study) -> Findings:
    """Measure the process time of display fits."""
    rows: list[list[Cell]] = []
    for eye, (positions, goal) in product(study.eyes, wanted.FIT_SECONDS.items()):
        trial = trial_at(DisplayTrial, eye, "planar", None, positions, camera_noise_arcmin=STAGE_NOISE_ARCMIN)
        draws = study.repeated(trial)
        seconds = [each.seconds for each in draws]
        rows.append([str(eye), positions, draws[0].readings, float(np.mean(seconds)), max(seconds), goal])
    columns = ["eye", "camera positions", "readings", "fit (s)", "longest (s)", "wanted (s)"]
    return Findings((ReportTable(f"Process time of a display fit, {_draws(study)}", columns, rows),))


def stuck(study: Study, draws: int) -> Findings:
    """Count fits in a wrong maximum of the evidence, among many draws."""
    shift, turn = STUCK_STAGE
    errors = {"stage_error_mm": 1e-3 * shift, "stage_turn_urad": turn, "camera_noise_arcmin": STAGE_NOISE_ARCMIN}
    rows: list[list[Cell]] = []
    for eye in study.eyes:
        if eye.name != STUCK_DEVICE:
            continue
        trial = trial_at(DisplayTrial, eye, "planar", None, POSITIONS, **errors)
        outcomes = [study.outcome_of(replace(trial, repeat=k)) for k in range(draws)]
        found = np.array([[each.found.repeatability_um, each.found.wobble_urad] for each in outcomes if each.found])
        ratio = found.reshape(-1, 2) / STUCK_STAGE
        beyond = np.any((ratio > wanted.STUCK_FACTOR) | (ratio < 1.0 / wanted.STUCK_FACTOR), axis=1)
        rms = [each.rms(Measure.FORWARD) for each in outcomes]
        spread = (
            [float(each) for each in np.quantile(ratio, (0.0, 1.0), axis=0).T.ravel()] if len(ratio) else [np.nan] * 4
        )
        predicted = pooled(outcomes, Measure.PREDICTED) / pooled(outcomes, Measure.FORWARD)
        rows.append([str(eye), draws, int(beyond.sum()), *spread, max(rms), predicted])
    columns = ["eye", "draws", "stuck", "least shift found / true", "largest shift", "least turn found / true"]
    columns += ["largest turn", "largest rms (arcmin)", "predicted / true"]
    title = f"Wrong maxima: {shift:g} um and {turn:g} urad, {POSITIONS} camera positions"
    note = f"Stuck: found shift or turn off by more than a factor of {wanted.STUCK_FACTOR:g}. Wanted: none."
    return Findings((ReportTable(title, columns, rows, (note,)),))


def _goal(goals: Mapping[str, Mapping[float, float]], eye: EvaluatedEye, noise_arcmin: float) -> float | None:
    return goals.get(eye.name, {}).get(noise_arcmin)


def _errors(draws: Sequence[Outcome], measure: str, goal: float | None) -> list[Cell]:
    """Return the cells of `_ERROR_COLUMNS`."""
    rms = [each.rms(measure) for each in draws]
    standard_error = float(np.std(rms, ddof=1) / np.sqrt(len(rms))) if len(rms) > 1 else None
    predicted = pooled(draws, Measure.PREDICTED)
    return [float(np.mean(rms)), standard_error, goal, predicted, predicted / pooled(draws, measure)]


def _found(draws: Sequence[Outcome]) -> list[Cell]:
    """Return the cells of `_FOUND_COLUMNS`: root mean squares over the draws."""
    found = [outcome.found or FoundBench(np.nan, np.nan, np.nan) for outcome in draws]
    values = [[each.noise_arcmin, each.repeatability_um, each.wobble_urad] for each in found]
    return [float(each) for each in np.sqrt(np.mean(np.square(values), axis=0))]


def _fit(draws: Sequence[Outcome]) -> list[Cell]:
    return [_found(draws)[0], float(np.mean([each.seconds for each in draws]))]


def _draws(study: Study) -> str:
    return f"mean of {study.repeats} draws"

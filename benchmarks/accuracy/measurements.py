"""Measurements: random draws of captures by device, camera noise, field and errors of the stage."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from benchmarks.accuracy import wanted
from benchmarks.accuracy.prescribed_trial import SEE_THROUGH_PREDICTED, PrescribedTrial
from wlr_render.jobs.evaluate.study import FOUND_COLUMNS, Findings, Study, found_cells, pooled, trial_at
from wlr_render.jobs.evaluate.trials import DisplayTrial, EvaluatedEye, Measure, Outcome, SeeThroughTrial
from wlr_render.report.blocks import Cell, ReportTable

POSITIONS, FEW_POSITIONS = 25, 16
NOISES_ARCMIN = (wanted.EXACT, wanted.FINE, wanted.COARSE)
STAGES_UM_URAD = ((0.0, 0.0), (10.0, 30.0), (30.0, 100.0))
STAGE_NOISE_ARCMIN = 0.25
STUCK_DEVICE, STUCK_STAGE = "northstar", STAGES_UM_URAD[-1]
_KINDS = ("planar", "prescription", "grey-box")
_ERROR_COLUMNS = ("rms (arcmin)", "standard error", "wanted", "predicted (arcmin)", "predicted / true")


def display(study: Study) -> Findings:
    """Direction of a pixel: nominal field, whole panel, and fewer camera positions."""
    designs = (
        ("nominal field", False, POSITIONS, wanted.DISPLAY),
        ("whole panel", True, POSITIONS, wanted.WHOLE_PANEL),
        ("nominal field", False, FEW_POSITIONS, wanted.FEW_POSITIONS),
    )
    rows: list[list[Cell]] = []
    for (field, whole, positions, goals), eye, noise in product(designs, study.eyes, NOISES_ARCMIN):
        trial = trial_at(DisplayTrial, replace(eye, whole_panel=whole), "planar", None, positions)
        draws = study.repeated(replace(trial, camera_noise_arcmin=noise))
        goal = _goal(goals, eye, noise)
        rows.append([str(eye), field, positions, noise, *_errors(draws, Measure.FORWARD, goal), *_fit(draws)])
    columns = ["eye", "field", "camera positions", "camera noise (arcmin)", *_ERROR_COLUMNS]
    columns += ["noise found (arcmin)", "fit (s)"]
    return Findings((ReportTable(f"Display: direction of a pixel, {_draws(study)}", columns, rows),))


def see_through(study: Study) -> Findings:
    """Direction of a real point."""
    rows: list[list[Cell]] = []
    for eye, noise in product(study.eyes, NOISES_ARCMIN):
        trial = trial_at(SeeThroughTrial, eye, "planar", None, POSITIONS, camera_noise_arcmin=noise)
        draws = study.repeated(trial)
        goal = _goal(wanted.SEE_THROUGH, eye, noise)
        rows.append([str(eye), noise, *_errors(draws, Measure.REAL_POINT, goal), *_fit(draws)])
    columns = ["eye", "camera noise (arcmin)", *_ERROR_COLUMNS, "noise found (arcmin)", "fit (s)"]
    title = f"See-through: direction of a real point, {POSITIONS} camera positions, {_draws(study)}"
    return Findings((ReportTable(title, columns, rows),))


def stage(study: Study) -> Findings:
    """Honest predictions with errors of the stage: display and see-through."""
    rows: list[list[Cell]] = []
    models = (("display", DisplayTrial, Measure.FORWARD), ("see-through", SeeThroughTrial, Measure.REAL_POINT))
    for (name, kind, measure), eye, (shift, turn) in product(models, study.eyes, STAGES_UM_URAD):
        errors = {"stage_error_mm": 1e-3 * shift, "stage_turn_urad": turn, "camera_noise_arcmin": STAGE_NOISE_ARCMIN}
        draws = study.repeated(trial_at(kind, eye, "planar", None, POSITIONS, **errors))
        rms = pooled(draws, measure)
        predicted = pooled(draws, Measure.PREDICTED)
        rows.append([str(eye), name, shift, turn, rms, predicted, predicted / rms, *found_cells(draws)])
    columns = ["eye", "model", "stage shift (um)", "stage turn (urad)", "rms (arcmin)", "predicted (arcmin)"]
    columns += ["predicted / true", *FOUND_COLUMNS]
    low, high = wanted.PREDICTED_OVER_TRUE
    title = f"Errors of the stage: {POSITIONS} camera positions, {STAGE_NOISE_ARCMIN:g}' camera noise, {_draws(study)}"
    return Findings((ReportTable(title, columns, rows, (f"Wanted: predicted / true of {low:g} to {high:g}.",)),))


def prescribed(study: Study) -> Findings:
    """Models that know the prescription of a headset that differs from it, beside one that does not."""
    rows: list[list[Cell]] = []
    for eye, (positions, noise, shape, goal), kind in product(study.eyes, wanted.GREY_BOX, _KINDS):
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
    """Process time of display fits."""
    rows: list[list[Cell]] = []
    for eye, (positions, goal) in product(study.eyes, wanted.FIT_SECONDS.items()):
        trial = trial_at(DisplayTrial, eye, "planar", None, positions, camera_noise_arcmin=STAGE_NOISE_ARCMIN)
        draws = study.repeated(trial)
        seconds = [each.seconds for each in draws]
        rows.append([str(eye), positions, draws[0].readings, float(np.mean(seconds)), max(seconds), goal])
    columns = ["eye", "camera positions", "readings", "fit (s)", "longest (s)", "wanted (s)"]
    return Findings((ReportTable(f"Process time of a display fit, {_draws(study)}", columns, rows),))


def stuck(study: Study, draws: int) -> Findings:
    """Fits in a wrong maximum of the evidence, among many draws."""
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
    """Cells of `_ERROR_COLUMNS`."""
    rms = [each.rms(measure) for each in draws]
    standard_error = float(np.std(rms, ddof=1) / np.sqrt(len(rms))) if len(rms) > 1 else None
    predicted = pooled(draws, Measure.PREDICTED)
    return [float(np.mean(rms)), standard_error, goal, predicted, predicted / pooled(draws, measure)]


def _fit(draws: Sequence[Outcome]) -> list[Cell]:
    return [found_cells(draws)[0], float(np.mean([each.seconds for each in draws]))]


def _draws(study: Study) -> str:
    return f"mean of {study.repeats} draws"

"""Comparison of our methods and published methods, fitted to the same simulated captures."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any

import numpy as np

from benchmarks.rivals.method_trials import (
    DEPTHS_M,
    EVERY,
    FRAME_NODES,
    TRACKING_MM,
    MethodMeasure,
    MethodTrial,
    at_depth,
)
from benchmarks.rivals.methods import METHODS, REGRESSORS, STRUCTURES, TRACED_POSITIONS
from benchmarks.trial_study import Findings, Study, trial_at
from benchmarks.trials import BACK_M, TEST_RAYS, EvaluatedEye, Measure, Outcome
from wlr_render.errors import BadInputError
from wlr_render.report.blocks import Block, Cell, Plot, ReportTable, Section, Text
from wlr_render.report.plots import curves

DEFAULT_METHODS = (
    "planar",
    "static",
    "prescription-fitted",
    "linear-table-volumetric",
    "linear-table-planar",
    "components-planar",
    "point-table",
    "plane",
    "spaam",
)
"""Default methods: cheap methods, and one method of each kind."""
EVERYWHERE = frozenset(DEFAULT_METHODS) | {
    "grey-box",
    "thin-plate-table-planar",
    "kernel-ridge-planar",
    "gaussian-process-planar",
    "network-planar",
    "decoded-components-planar",
    "indica-recycle",
    "plane-and-polynomial-planar",
}
"""Methods that are run in every condition; the others run with exact captures and at `_NOISY` only."""
COSTLY = frozenset(
    {
        "volumetric",
        "grey-box-misshapen",
        "free-kernel-ridge-planar",
        "kernel-ridge-volumetric",
        "gaussian-process-volumetric",
        "network-volumetric",
        "offset-network",
        "distortion-field",
        "traced-components-drawn",
        "traced-components-fitted",
        "plane-and-polynomial-volumetric",
    }
)
"""Methods with at most `_FEW` repetitions."""
_FEW = 3
POSITIONS = 25
COUNTS = (9, 16, 25, 49, 84)
GOALS_ARCMIN = (1.0, 0.3, 0.1)
CONDITIONS: Mapping[str, Mapping[str, Any]] = {
    "exact": {},
    "0.25 px": {"camera_noise_arcmin": 0.25},
    "1 px": {"camera_noise_arcmin": 1.0},
    "stage 50 um": {"camera_noise_arcmin": 0.25, "stage_error_mm": 0.05},
    "1 % outliers": {"camera_noise_arcmin": 0.25, "outliers": 0.01},
}
"""Errors of the bench by column; a camera's pixel is an arcminute wide in its middle."""
_NOISY, _USUAL = "1 px", "0.25 px"
_LEAST_DRAWN = 1e-4  # smallest error in the plot of methods, arcminutes
_LEADERS = 12  # number of curves in the plot of camera positions
_TIES, _ONE_DRAW = 2.0, 0.1
"""Number of standard errors within which two methods are equally good; with one draw, share of the error."""


@dataclass(frozen=True)
class _Table:
    """Outcomes of the methods for one eye.

    Attributes:
        outcomes: outcomes of the repetitions, by condition, then method.
        by_count: outcomes at `_USUAL` noise, by number of camera positions, then method.
    """

    outcomes: Mapping[str, Mapping[str, Sequence[Outcome]]]
    by_count: Mapping[int, Mapping[str, Outcome]]

    def rms(self, condition: str, method: str, measure: str) -> float:
        """Return the mean over repetitions of the rms of an error; NaN without data."""
        values = [outcome.rms(measure) for outcome in self.outcomes[condition].get(method, ())]
        return float(np.mean(values)) if values else float("nan")

    def standard_error(self, condition: str, method: str, measure: str) -> float | None:
        """Return the standard error of `rms`; None for a single repetition."""
        values = [outcome.rms(measure) for outcome in self.outcomes[condition].get(method, ())]
        return float(np.std(values, ddof=1) / np.sqrt(len(values))) if len(values) > 1 else None

    def refusals(self) -> list[str]:
        """Return a sentence for each method without a model, with conditions and reason."""
        where: dict[tuple[str, str], list[str]] = {}
        for condition, by_method in self.outcomes.items():
            for method, outcomes in by_method.items():
                for why in dict.fromkeys(outcome.refused for outcome in outcomes if outcome.refused):
                    where.setdefault((method, why), []).append(condition)
        return [f"{method} ({', '.join(conditions)}): {why}" for (method, why), conditions in where.items()]

    def ranked(self, condition: str, measure: str = MethodMeasure.COMPOSITE) -> list[str]:
        """Return the methods for which the error is known, best first."""
        error = {method: self.rms(condition, method, measure) for method in self.outcomes[condition]}
        known = [method for method in error if np.isfinite(error[method])]
        return sorted(known, key=error.__getitem__)


def chosen_methods(names: Sequence[str]) -> Sequence[str]:
    """Return the methods with these names; "all" selects all methods.

    Raises:
        BadInputError: a name is unknown, or "all" is given with other names.
    """
    if tuple(names) == ("all",):
        return tuple(METHODS)
    for name in names:
        if name == "all":
            raise BadInputError("--methods has 'all' and other names; give 'all' alone.")
        if name not in METHODS:
            close = get_close_matches(name, METHODS, 1)
            meant = f"did you mean {close[0]}? Choose" if close else "choose"
            raise BadInputError(f"--methods has {name}; {meant} all, or from {', '.join(METHODS)}.")
    return tuple(dict.fromkeys(names))


def compare_methods(study: Study, chosen: Sequence[str]) -> Findings:
    """Compare methods on the same captures, by error of the bench, structure, number of positions and cost.

    If all are chosen, some run in some conditions only (see `EVERYWHERE`), and some less often (see `COSTLY`).
    """
    blocks: list[Block] = [_sources(chosen)]
    verdict: list[str] = []
    record = {}
    for eye in study.eyes:
        found = _outcomes(chosen, study, eye)
        blocks += [
            Section(f"{eye}: what wins"),
            Text("By composite error:", [_what_wins(eye, found, condition) for condition in CONDITIONS]),
            *([Text("Methods that could not use the captures:", refused)] if (refused := found.refusals()) else []),
            _conditions_table(eye, found),
            _conditions_plot(eye, found),
            _separate_table(eye, found),
            _beyond_table(eye, found),
            *_structures_table(eye, found),
            _cost_table(eye, found),
            _positions_plot(eye, found),
        ]
        verdict.append(_what_wins(eye, found, _USUAL))
        record[str(eye)] = {name: found.ranked(name) for name in CONDITIONS}
    return Findings(blocks, verdict, record={"ranked": record})


def _outcomes(chosen: Sequence[str], study: Study, eye: EvaluatedEye) -> _Table:
    def trial(method: str, count: int, **errors: Any) -> MethodTrial:
        return trial_at(MethodTrial, eye, method, None, count, **errors)

    are_all = len(chosen) == len(METHODS)
    everywhere = [method for method in chosen if not are_all or method in EVERYWHERE]
    few = {method: _FEW for method in COSTLY if are_all}
    outcomes = {
        condition: {
            method: study.repeated(trial(method, POSITIONS, in_depth=not errors, **errors), few.get(method))
            for method in (chosen if condition in ("exact", _NOISY) else everywhere)
        }
        for condition, errors in CONDITIONS.items()
    }
    by_count = {
        count: {method: study.outcome_of(trial(method, count, **CONDITIONS[_USUAL])) for method in everywhere}
        for count in COUNTS
    }
    return _Table(outcomes, by_count)


def _sources(chosen: Sequence[str]) -> ReportTable:
    rows: list[list[Cell]] = [[name, METHODS[name].source, METHODS[name].structure] for name in chosen]
    notes = (
        "Structure: the method's use of the eye's position. static: none; volumetric: three coordinates; planar: the "
        "point where the ray crosses the base plane; a point, a flat screen: the viewpoint of an image in space.",
        "Methods of the structure volumetric are fitted to camera positions in the eye box, others to as many in "
        f"a plane. Traced components take {TRACED_POSITIONS} positions on the prescription; drawn needs nothing else.",
    )
    return ReportTable("Methods", ["method", "source", "structure"], rows, notes)


def _conditions_table(eye: EvaluatedEye, found: _Table) -> ReportTable:
    rows: list[list[Cell]] = []
    for method in found.ranked(_NOISY):
        row: list[Cell] = [method]
        for condition in CONDITIONS:
            row.append(_or_none(found.rms(condition, method, MethodMeasure.COMPOSITE)))
            if condition != "exact":
                row.append(found.standard_error(condition, method, MethodMeasure.COMPOSITE))
        answers = found.outcomes[_NOISY][method][0].errors[MethodMeasure.COMPOSITE]
        row.append(len(found.outcomes[_NOISY][method]))
        rows.append([*row, 100.0 * answers.missing / (answers.missing + answers.count)])
    columns = ["method"]
    for condition in CONDITIONS:
        columns += [f"{condition} (arcmin)", f"{condition} +-"] if condition != "exact" else ["exact (arcmin)"]
    columns += [f"repetitions at {_NOISY}", "no answer (%)"]
    notes = (
        f"Rms angle at the eye between a real point and the pixel shown for it; {POSITIONS} camera positions; over "
        f"{TEST_RAYS // EVERY} rays from each viewpoint. Noise is of a camera's pixels; stage and outliers come with "
        f"{_USUAL}.",
        "+- is the standard error over repetitions. Exact captures are fitted once, so that methods which know a "
        "prescription have one draw of its errors there.",
        "No answer: points for which the method has no pixel, or a pixel outside the panel, in the first of those "
        "repetitions. They do not count in the errors.",
    )
    return ReportTable(f"{eye}: composite error", columns, rows, notes)


def _conditions_plot(eye: EvaluatedEye, found: _Table) -> Plot:
    names = found.ranked(_NOISY)[::-1]
    data = [
        {
            "type": "scatter",
            "mode": "markers",
            "name": condition,
            "x": [_drawn_at(found.rms(condition, name, MethodMeasure.COMPOSITE)) for name in names],
            "y": names,
        }
        for condition in CONDITIONS
    ]
    layout = {
        "xaxis": {"type": "log", "title": {"text": "composite rms (arcmin)"}, "exponentformat": "power", "dtick": 1},
        "yaxis": {"automargin": True, "dtick": 1},
    }
    caption = f"Errors below {_LEAST_DRAWN:g}' are drawn there."
    return Plot(f"{eye}: composite error by method", data, layout, caption, height_px=160 + 20 * len(names))


def _separate_table(eye: EvaluatedEye, found: _Table) -> ReportTable:
    rows: list[list[Cell]] = []
    for method in found.ranked(_NOISY, Measure.FORWARD):
        row: list[Cell] = [method]
        for condition in ("exact", _NOISY):
            first = found.outcomes[condition][method][0].errors.get(Measure.FORWARD)
            row += [
                found.rms(condition, method, Measure.FORWARD),
                None if first is None else first.p95,
                None if first is None else first.maximum,
            ]
            row += [found.rms(condition, method, each) for each in (Measure.BACKWARD, Measure.REAL_POINT)]
        rows.append(row)
    names = ["forward (arcmin)", "p95 (arcmin)", "max (arcmin)", "backward (px)", "real point (arcmin)"]
    columns = ["method", *(f"{condition}: {name}" for condition in ("exact", _NOISY) for name in names)]
    notes = (
        "Forward: direction of a pixel; backward: pixel of a direction; real point: view direction of a real point.",
        "All are rms; p95 and max are of forward in the first repetition.",
        "Methods that map the world to pixels in one are left out.",
    )
    return ReportTable(f"{eye}: display and see-through separately", columns, rows, notes)


def _beyond_table(eye: EvaluatedEye, found: _Table) -> ReportTable:
    measures = [MethodMeasure.TRACKED, MethodMeasure.MOVED_BACK, MethodMeasure.ALONG_RAY, *map(at_depth, DEPTHS_M)]
    rows: list[list[Cell]] = [
        [method, *(_or_none(found.rms("exact", method, measure)) for measure in measures)]
        for method in found.ranked("exact")
    ]
    columns = ["method", f"eye tracking {1e3 * TRACKING_MM:g} um (arcmin)", "moved back 10 mm (arcmin)"]
    columns += ["self-contradiction (arcmin)", *(f"point at {depth:g} m (arcmin)" for depth in DEPTHS_M)]
    notes = (
        "Exact captures, of targets at 0.4 and 3 m. Eye tracking and points: the composite error.",
        f"Moved back: the direction of a pixel from {1e3 * BACK_M:g} mm behind on its ray. Self-contradiction: the "
        "angle between a pixel's directions at two points of one of the model's rays, one eye box depth between them.",
    )
    return ReportTable(f"{eye}: beyond the captures", columns, rows, notes)


def _structures_table(eye: EvaluatedEye, found: _Table) -> list[ReportTable]:
    """Compare regressors across structures; empty unless a regressor ran in all structures."""
    own = {"polynomials by evidence": dict(zip(STRUCTURES, STRUCTURES, strict=True))}
    regressors = own | {name: {each: f"{name}-{each}" for each in STRUCTURES} for name in REGRESSORS}
    rows: list[list[Cell]] = []
    for name, by_structure in regressors.items():
        if not all(method in found.outcomes[_NOISY] for method in by_structure.values()):
            continue
        row: list[Cell] = [name]
        for condition in ("exact", _NOISY):
            error = {
                each: found.rms(condition, method, MethodMeasure.COMPOSITE) for each, method in by_structure.items()
            }
            row += [*error.values(), error["volumetric"] / error["planar"]]
        rows.append(row)
    if not rows:
        return []
    columns = ["regressor"]
    columns += [
        f"{condition}: {name}"
        for condition in ("exact", _NOISY)
        for name in (*(f"{each} (arcmin)" for each in STRUCTURES), "volumetric / planar")
    ]
    notes = ("Composite error of each regressor in each structure: the paper's claim, on more than polynomials.",)
    return [ReportTable(f"{eye}: structure and regressor", columns, rows, notes)]


def _cost_table(eye: EvaluatedEye, found: _Table) -> ReportTable:
    rows: list[list[Cell]] = []
    for method in found.ranked(_NOISY):
        outcome = found.outcomes["exact"][method][0]
        needed = [_positions_needed(found, method, goal) for goal in GOALS_ARCMIN]
        seconds = float(np.median([each.seconds for each in found.outcomes[_NOISY][method]]))
        numbers = outcome.rms(MethodMeasure.NUMBERS)
        stored = int(numbers) if np.isfinite(numbers) else None
        rows.append([method, *needed, stored, seconds, _or_none(outcome.rms(MethodMeasure.FRAME_MS))])
    columns = ["method", *(f"positions for {goal:g}'" for goal in GOALS_ARCMIN), "numbers stored", "fit (s)"]
    notes = (
        f"Camera positions: the fewest of {', '.join(map(str, COUNTS))} from which on the composite error is that "
        "small, at 0.25 px; empty: none, or not tried. Numbers and fit: display and see-through; process time.",
        f"A frame: {FRAME_NODES} x {FRAME_NODES} rays of the panel from the last frame's solution, in NumPy.",
    )
    return ReportTable(f"{eye}: cost", [*columns, "a frame's rays (ms)"], rows, notes)


def _positions_needed(found: _Table, method: str, goal_arcmin: float) -> int | None:
    needed = None
    for count in reversed(COUNTS):
        outcome = found.by_count[count].get(method)
        if outcome is None or not outcome.rms(MethodMeasure.COMPOSITE) <= goal_arcmin:
            break
        needed = count
    return needed


def _positions_plot(eye: EvaluatedEye, found: _Table) -> Plot:
    lines = {
        method: (COUNTS, [found.by_count[count][method].rms(MethodMeasure.COMPOSITE) for count in COUNTS])
        for method in found.ranked(_USUAL)[:_LEADERS]
    }
    title = f"{eye}: composite error over the number of camera positions, 0.25 px"
    return curves(title, lines, ("number of camera positions", "composite rms (arcmin)"), log_y=True)


def _what_wins(eye: EvaluatedEye, found: _Table, condition: str) -> str:
    """Name the best method in a condition, and the rank of our planar model."""
    ranked = found.ranked(condition)
    if not ranked:
        return f"{eye}, {condition}: no method could use the captures."
    rms = {name: found.rms(condition, name, MethodMeasure.COMPOSITE) for name in ranked}
    text = f"{eye}, {condition}: {ranked[0]} is best with {rms[ranked[0]]:.2g}'"
    if "planar" in ranked[1:]:
        better = [name for name in ranked[: ranked.index("planar")] if _clearly(found, condition, name)]
        place = f"clearly better: {', '.join(better)}" if better else "none is clearly better"
        text += f"; planar gives {rms['planar']:.2g}' ({place})"
    return text + "."


def _clearly(found: _Table, condition: str, method: str) -> bool:
    """Return whether a method is better than planar by more than the scatter of the repetitions."""
    measure = MethodMeasure.COMPOSITE
    gain = found.rms(condition, "planar", measure) - found.rms(condition, method, measure)
    own, other = (found.standard_error(condition, name, measure) for name in ("planar", method))
    if own is None or other is None:
        return gain > _ONE_DRAW * found.rms(condition, "planar", measure)
    return gain > _TIES * float(np.hypot(own, other))


def _or_none(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _drawn_at(value: float) -> float | None:
    return float(f"{max(value, _LEAST_DRAWN):.4g}") if np.isfinite(value) else None

"""Predicted and true errors of fits to lab sessions, see `lab_captures`."""

import time
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.stats import chi2

from benchmarks.accuracy import wanted
from benchmarks.accuracy.lab_errors import LAB_SWITCHES
from benchmarks.accuracy.lab_statements import SHARED
from benchmarks.accuracy.labs import LabTruth, Places, lab_captures
from benchmarks.intervals import interval_percent
from benchmarks.trial_study import Findings, Study, trial_at
from benchmarks.trials import AnyFit, EvaluatedEye, Measure, Outcome, Trial
from wlr_render.calibration.fit_eye import calibrate
from wlr_render.errors import BadInputError
from wlr_render.evaluation.mapping_error import display_error, see_through_error
from wlr_render.evaluation.metrics import Summary, summary
from wlr_render.numerics.arrays import FloatArray
from wlr_render.report.blocks import Cell, ReportTable

SIDES = ("display", "see-through")
SHARES = (0.68, 0.95)
_FEW, _MANY = 25, 49  # numbers of camera positions
_STATEMENTS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "own part": (SHARED, ()),
    "shared errors stated": ((), SHARED),
    "nothing stated": ((), ()),
}
_PLACES: tuple[Places, ...] = ("raster", "planned")


@dataclass(frozen=True)
class LabTrial(Trial):
    """One lab session, and the fit to it; its seed is the study's seed plus `repeat`.

    Attributes:
        level, places, stated: see `lab_captures`.
        without: imperfections that are off.
    """

    level: float = 1.0
    places: Places = "raster"
    without: tuple[str, ...] = ()
    stated: tuple[str, ...] = SHARED

    @property
    def has_random_errors(self) -> bool:
        """True: each repetition is another session."""
        return True

    @property
    def shared(self) -> object:
        """Key that is different for all sessions, because they share no captures; see `Trial`."""
        return self

    def run(self, seed: int) -> Outcome:
        """Fit and evaluate."""
        switches = [name for name in LAB_SWITCHES if name not in self.without]
        captures, truth = lab_captures(
            self.device,
            self.level,
            seed + self.repeat,
            self.viewpoints,
            self.places,
            switches,
            self.stated,
            eye_box_mm=self.eye_box_mm,
        )
        started = time.process_time()
        try:
            display, see_through = calibrate(captures).both
        except BadInputError as error:
            return Outcome({}, refused=str(error))
        seconds = time.process_time() - started
        shown, seen = truth.shown, truth.seen
        errors = (
            display_error(display.mapping, shown).forward_arcmin,
            see_through_error(see_through.mapping, seen).backward_arcmin,
        )
        figures = [
            _figures(display, truth, errors[0], display.mapping.sigma(shown.pixel, shown.viewpoint)),
            _figures(see_through, truth, errors[1], see_through.mapping.sigma(seen.point, seen.viewpoint)),
        ]
        named = {f"{side} {name}": each[name] for side, each in zip(SIDES, figures, strict=True) for name in each}
        measures: dict[str, Summary] = {Measure.FORWARD: summary(errors[0]), Measure.REAL_POINT: summary(errors[1])}
        return Outcome(measures, None, sum(map(len, captures.both)), seconds, figures=named)


def _figures(fit: AnyFit, truth: LabTruth, error: FloatArray, sigma: FloatArray) -> dict[str, float]:
    """Return true and predicted rms (arcmin), shares within the intervals, and counts of captures found to be moved."""
    known = np.isfinite(error) & np.isfinite(sigma)
    error, sigma = error[known], sigma[known]
    figures = {"true": float(np.sqrt(np.mean(error**2))), "predicted": float(np.sqrt(np.mean(sigma**2)))}
    for share in SHARES:  # sigma is the rms angle over both axes
        figures[f"in {100 * share:g} %"] = float(np.mean(error < sigma * np.sqrt(0.5 * chi2.ppf(share, 2))))
    accused = [np.flatnonzero(fit.captures.visits[1] == each.capture)[0] for each in fit.smooth.moved]
    bumped = [
        row for row in accused if fit.captures.capture[row] in truth.bumped and fit.captures.target_pose[row] <= 0
    ]
    found = {"bumped": len(truth.bumped), "found": len(bumped), "accused falsely": len(accused) - len(bumped)}
    return figures | {name: float(count) for name, count in found.items()}


def labs(study: Study, sessions: int) -> Findings:
    """Compare predictions with errors in sessions with imperfections of other function classes than the models."""
    rows: list[list[Cell]] = []
    groups: dict[tuple[Cell, ...], list[dict[str, float]]] = defaultdict(list)
    for eye, trial in _trials(study.eyes):
        where: list[Cell] = [trial.level, _statement_of(trial), "off" if "neighbours" in trial.without else "on"]
        outcomes = [study.outcome_of(replace(trial, repeat=number)) for number in range(sessions)]
        for (number, outcome), side in product(enumerate(outcomes), SIDES):
            figures = {name: outcome.figures.get(f"{side} {name}", np.nan) for name in _FIGURES}
            groups[*where, side].append(figures)
            at: list[Cell] = [str(eye), trial.viewpoints, trial.places, *where, number, side]
            errors: list[Cell] = [figures["true"], figures["predicted"], figures["true"] / figures["predicted"]]
            rows.append([*at, *errors, *(figures[name] for name in _FIGURES[2:]), outcome.seconds])
    conditions = ["level", "statement", "neighbours", "side"]
    columns = ["eye", "camera positions", "places", *conditions[:3], "session", "side"]
    columns += ["true rms (arcmin)", "predicted (arcmin)", "true / predicted", *_FIGURES[2:], "fit (s)"]
    notes = ("The seed of a session is the study's plus the session's number.",)
    return Findings(
        (
            ReportTable("Labs: kinds of sessions", [*conditions, *_SUMMARY, *_FIGURES[2:]], _summary(groups)),
            ReportTable("Labs: each session", columns, rows, notes),
        )
    )


_FIGURES = ("true", "predicted", *(f"in {100 * share:g} %" for share in SHARES), "bumped", "found", "accused falsely")
_SUMMARY = (
    "sessions",
    "refused",
    "ratio in .8 to 1.25 (%)",
    "95 % interval (%)",
    "true / predicted, median",
    "least",
    "largest",
)


def _summary(groups: dict[tuple[Cell, ...], list[dict[str, float]]]) -> list[list[Cell]]:
    rows: list[list[Cell]] = []
    low, high = wanted.PREDICTED_OVER_TRUE
    for where, sessions in groups.items():
        table = np.array([[each[name] for name in _FIGURES] for each in sessions])
        table = table[np.isfinite(table[:, 0])]
        if len(table) == 0:
            rows.append([*where, len(sessions), len(sessions), *[None] * (len(_SUMMARY) + len(_FIGURES) - 4)])
            continue
        ratio = table[:, 0] / table[:, 1]
        honest, count = int(np.sum((1.0 / ratio >= low) & (1.0 / ratio <= high))), len(sessions)
        share: list[Cell] = [100 * honest / count, interval_percent(honest, count)]
        spread = [float(each) for each in [*np.quantile(ratio, [0.5, 0.0, 1.0]), *table[:, 2:4].mean(axis=0)]]
        moved = [int(each) for each in table[:, 4:].sum(axis=0)]
        rows.append([*where, count, count - len(table), *share, *spread, *moved])
    return rows


def _trials(eyes: Sequence[EvaluatedEye]) -> list[tuple[EvaluatedEye, LabTrial]]:
    """Return trials with white noise only; with half the imperfections; with all, at 25 and 49 camera positions."""
    kinds: list[tuple[float, int, tuple[str, ...], tuple[str, ...]]] = [(0.0, _FEW, (), ())]
    for (level, count), (off, stated) in product(((0.5, _FEW), (1.0, _FEW), (1.0, _MANY)), _STATEMENTS.values()):
        kinds += [(level, count, off, stated), (level, count, (*off, "neighbours"), stated)]
    return [
        (eye, trial_at(LabTrial, eye, "planar", None, count, level=level, places=places, without=off, stated=stated))
        for eye, (level, count, off, stated), places in product(eyes, kinds, _PLACES)
    ]


def _statement_of(trial: LabTrial) -> str:
    if trial.level == 0.0:
        return "white noise only"
    parts = (tuple(name for name in trial.without if name != "neighbours"), trial.stated)
    return next(name for name, each in _STATEMENTS.items() if each == parts)

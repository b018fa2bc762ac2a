"""Cross-validation of a diagnosis: the causes found predict captures and target distances that were left out.

The causes and their variants stay as the diagnosis found them; their values are fitted again to the remaining
readings.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from wlr_render.diagnosis.diagnosis import DiagnosisRecord
from wlr_render.diagnosis.findings import not_excluded
from wlr_render.diagnosis.fit import fit
from wlr_render.diagnosis.held_out import held_out_residual, jackknife
from wlr_render.diagnosis.observations import PART_NAMES, SEE_THROUGH
from wlr_render.diagnosis.prediction import Explanation
from wlr_render.diagnosis.tables import OfCause, with_unit
from wlr_render.numerics.arrays import BoolArray, FloatArray
from wlr_render.report.blocks import Report, ReportTable, Section, table


@dataclass(frozen=True)
class HeldOutResidual:
    """RMS residual of readings that were held out of a fit, in arcminutes, both axes together.

    Attributes:
        fitted_to, tested_on: names of the fitted and of the held-out readings.
        readings: number of held-out readings.
        before, after: measured minus simulated, with the bench as described and as corrected.
        noise: expected from the noise alone.
    """

    fitted_to: str
    tested_on: str
    readings: int
    before: float
    after: float
    noise: float


def with_held_out(report: Report, found: DiagnosisRecord) -> Report:
    """Add the predictions of held-out captures and distances to a report."""
    if not found.causes:
        nothing = (
            "No cause was found, so nothing is held out; to test a bench model on other captures, use wlr-render "
            "predict BENCH SESSION."
        )
        return replace(report, warnings=[*report.warnings, nothing])
    residuals = _residuals(found)
    verdict = " ".join((report.verdict, *_sentences(residuals)))
    tables = [_table(found, residuals), _values(found)]
    blocks = [*report.blocks, Section("Cross-validation"), *tables]
    return replace(report, verdict=verdict, blocks=blocks)


def _residuals(diagnosis: DiagnosisRecord) -> list[HeldOutResidual]:
    """Return the residuals of each capture with the fit to all others, then the residuals of the splits by distance."""
    readings, predictor = diagnosis.readings, diagnosis.readings.predictor
    observations, before = readings.observations, predictor.residual(Explanation())
    counted = not_excluded(observations, diagnosis.excluded)

    def residual(words: tuple[str, str], part: int, tested: BoolArray, after: FloatArray) -> HeldOutResidual:
        rows = tested[observations.part == part]
        angles = (observations.arcminutes(each, part)[rows] for each in (before, after, np.ones_like(after)))
        rms = (float(np.sqrt(np.mean(np.sum(each**2, axis=1)))) for each in angles)
        return HeldOutResidual(*words, int(rows.sum()), *rms)

    left_out = held_out_residual(diagnosis.fit, observations)
    found = [
        residual(("all other captures", f"each {PART_NAMES[part]} capture"), part, counted, left_out)
        for part in np.unique(observations.part)
    ]
    for words, tested in _splits(observations.target_distances(), counted):
        refitted = fit(readings.of_rows(~tested), diagnosis.fit.explanation, diagnosis.fit.scatter)
        if refitted is not None:
            found.append(residual(words, SEE_THROUGH, tested, predictor.residual(refitted.explanation)))
    return found


def _splits(at_distance: dict[str, BoolArray], counted: BoolArray) -> Iterator[tuple[tuple[str, str], BoolArray]]:
    """Yield names for the target distances to fit and to test, and the mask (n,) of the readings to test."""
    distance = {name: rows & counted for name, rows in at_distance.items() if np.any(rows & counted)}
    if len(distance) < 2:
        return
    for name, rows in distance.items():
        yield ("all other distances", name), rows
    everything = np.any(list(distance.values()), axis=0)
    for name, rows in distance.items() if len(distance) > 2 else ():
        yield (f"{name} only", "all other distances"), everything & ~rows


def _sentences(residuals: Sequence[HeldOutResidual]) -> Iterator[str]:
    """Yield one sentence per kind of fit, on the readings with the largest ratio of residual to noise."""
    for fitted_to in dict.fromkeys(each.fitted_to for each in residuals):
        alike = (each for each in residuals if each.fitted_to == fitted_to)
        worst = max(alike, key=lambda each: each.after / each.noise)
        yield (
            f"Fitted to {fitted_to}, the causes found predict {worst.tested_on} to {worst.after:.2g}' rms; the bench "
            f"as described is wrong by {worst.before:.2g}', and the noise is {worst.noise:.2g}'."
        )


def _table(diagnosis: DiagnosisRecord, residuals: Sequence[HeldOutResidual]) -> ReportTable:
    """Return the table of the residuals of held-out readings, with the bench as described and as corrected."""
    acting = "; ".join(f"{cause.name}, {cause.variant}" for cause in diagnosis.causes)
    captures = ", ".join(str(moved.capture) for moved in diagnosis.excluded) or "no capture"
    single = np.sum(not_excluded(diagnosis.observations, diagnosis.excluded) & ~diagnosis.used)
    return table(
        f"Held out of {diagnosis.session}",
        residuals,
        {
            "fitted to": "fitted_to",
            "tested on": "tested_on",
            "readings": "readings",
            "bench as described (arcmin)": "before",
            "corrected (arcmin)": "after",
            "noise (arcmin)": "noise",
        },
        (
            f"Rms of the angle, both axes together. At work: {acting}.",
            f"Neither fitted nor tested: {captures}; {single} single readings far from their neighbours.",
        ),
    )


def _values(diagnosis: DiagnosisRecord) -> ReportTable:
    """Return the table of fitted values, with the standard errors of the fit and of the jackknife over captures."""
    fitted = diagnosis.fit
    causes = [hypothesis.cause for hypothesis in fitted.explanation.hypotheses]
    names = [(cause.name, parameter.name) for cause in causes for parameter in cause.parameters]
    errors = jackknife(fitted, diagnosis.readings.observations)
    by_name = {names[free]: float(error) for free, error in zip(fitted.at.free, errors, strict=True)}
    note = (
        "By the captures: jackknife, from the change of each value when one capture is left out. A larger figure than "
        "that of the diagnosis means that captures differ by more than the noise of their readings."
    )
    return table(
        "Values found, and how captures scatter about them",
        [OfCause(cause, each) for cause in diagnosis.causes for each in cause.parameters],
        {
            "cause": "cause.name",
            "parameter": lambda row: with_unit(row.each.name, row.each.unit),
            "value": "each.value",
            "one sigma by the diagnosis": "each.sigma",
            "one sigma by the captures": lambda row: by_name.get((row.cause.name, row.each.name), np.nan),
        },
        (note,),
    )

"""Cross-validation of a diagnosis: the causes found predict captures and target distances that were left out.

The causes and their variants stay as the diagnosis found them; their values are fitted again to all that is not left
out.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from wlr_render.diagnosis.diagnosis import Diagnosis
from wlr_render.diagnosis.fit import fit
from wlr_render.diagnosis.held_out import held_out_residual, jackknife
from wlr_render.diagnosis.observations import PART_NAMES, SEE_THROUGH
from wlr_render.diagnosis.outliers import not_excluded
from wlr_render.diagnosis.prediction import Explanation
from wlr_render.numerics.arrays import BoolArray, FloatArray
from wlr_render.report.blocks import Cell, ReportTable


def hold_out_sentences(table: ReportTable) -> Iterator[str]:
    """Yield, for each kind of prediction, a sentence on the row that exceeds the noise most."""
    worst: dict[Cell, Sequence[Cell]] = {}
    for row in table.rows:
        worst[row[0]] = max(worst.get(row[0], row), row, key=lambda each: float(each[4] or 0) / float(each[5] or 1))
    for fitted_to, tested_on, _, *errors in worst.values():
        before, after, noise = (f"{cell:.2g}'" for cell in errors)
        yield (
            f"Fitted to {fitted_to}, the causes found predict {tested_on} to {after} rms; the bench as described is "
            f"wrong by {before}, and the noise is {noise}."
        )


def hold_out_table(found: Diagnosis) -> ReportTable:
    """Return rms angles of held-out readings, measured minus simulated, by the bench as described and as corrected."""
    rows = _by_capture(found)
    for fitted_to, tested_on, tested in _splits(found):
        rest = found.readings.of_rows(~tested)
        refitted = fit(rest, found.fit.explanation, found.fit.scatter)
        if refitted is None:
            continue
        after = found.readings.predictor.residual(refitted.explanation)
        rows.append([fitted_to, tested_on, *_figures(found, SEE_THROUGH, tested, after)])
    columns = (
        "fitted to",
        "tested on",
        "readings",
        "bench as described (arcmin)",
        "corrected (arcmin)",
        "noise (arcmin)",
    )
    return ReportTable(f"Held out of {found.session}", columns, rows, _notes(found))


def hold_out_values(found: Diagnosis) -> ReportTable:
    """Return the values found, with the standard errors of the fit and of leaving out each capture in turn."""
    observations, whole = found.readings.observations, found.fit
    errors = np.full(len(whole.explanation.vector()), np.nan)
    errors[whole.at.free] = jackknife(whole, observations.group, len(observations.captures))
    by_name = dict(zip(_value_names(whole.explanation), errors, strict=True))
    rows: list[list[Cell]] = [
        [cause.name, each.name, each.value, each.unit, each.sigma, float(by_name[cause.name, each.name])]
        for cause in found.causes
        for each in cause.parameters
    ]
    columns = ("cause", "parameter", "value", "unit", "one sigma by the diagnosis", "one sigma by the captures")
    note = (
        "By the captures: jackknife, from the change of each value when one capture is left out. A larger figure than "
        "that of the diagnosis means that captures differ by more than the noise of their readings."
    )
    return ReportTable("Values found, and how captures scatter about them", columns, rows, (note,))


def _value_names(explanation: Explanation) -> list[tuple[str, str]]:
    """Cause and parameter of each value."""
    causes = [hypothesis.cause for hypothesis in explanation.hypotheses]
    return [(cause.name, parameter.name) for cause in causes for parameter in cause.parameters]


def _by_capture(found: Diagnosis) -> list[list[Cell]]:
    """For each part of the session: every capture as the fit to all others predicts it."""
    observations, rows = found.readings.observations, list[list[Cell]]()
    after = held_out_residual(found.fit, observations)
    for part in np.unique(observations.part):
        figures = _figures(found, part, _counted(found) & (observations.part == part), after)
        rows.append(["all other captures", f"each {PART_NAMES[part]} capture", *figures])
    return rows


def _counted(found: Diagnosis) -> BoolArray:
    """Readings (n,) of captures that did not move."""
    return not_excluded(found.readings.observations, found.excluded)


def _splits(found: Diagnosis) -> Iterator[tuple[str, str, BoolArray]]:
    """What is fitted to, what is tested on, and its readings (n,): target distances held out, and fitted to alone."""
    counted = _counted(found)
    at_distance = found.readings.observations.target_distances()
    distance = {name: rows & counted for name, rows in at_distance.items() if np.any(rows & counted)}
    if len(distance) < 2:
        return
    everything = np.any(list(distance.values()), axis=0)
    for name, rows in distance.items():
        yield "all other distances", name, rows
    for name, rows in distance.items() if len(distance) > 2 else ():
        yield f"{name} only", "all other distances", everything & ~rows


def _figures(found: Diagnosis, part: int, tested: BoolArray, after: FloatArray) -> list[Cell]:
    """A count of readings, and rms angles of their residual by both benches and of the noise, arcminutes."""
    observations = found.readings.observations
    before = found.readings.predictor.residual(Explanation())
    rows = tested[observations.part == part]
    noise = np.ones_like(after)
    angles = (observations.arcminutes(each, part)[rows] for each in (before, after, noise))
    return [int(rows.sum()), *(float(np.sqrt(np.mean(np.sum(each**2, axis=1)))) for each in angles)]


def _notes(found: Diagnosis) -> tuple[str, ...]:
    observations, excluded = found.observations, [moved.capture for moved in found.excluded]
    kept = not_excluded(observations, found.excluded)
    acting = "; ".join(f"{cause.name}, {cause.variant}" for cause in found.causes)
    captures = ", ".join(str(capture) for capture in excluded) or "no capture"
    return (
        f"Rms of the angle, both axes together. At work: {acting}.",
        f"Neither fitted nor tested: {captures}; {int(np.sum(kept & ~found.used))} single readings far from their "
        "neighbours.",
    )

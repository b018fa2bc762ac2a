"""A diagnosis as tables; those that would be empty have no rows."""

import numpy as np

from wlr_render.diagnosis.diagnosis import Diagnosis
from wlr_render.diagnosis.held_out import HeldOutImprovement
from wlr_render.diagnosis.improvement import ImprovementInUse
from wlr_render.diagnosis.noise_sentences import undetermined_parts
from wlr_render.diagnosis.outliers import MovedCapture
from wlr_render.diagnosis.report_warnings import stated_prior
from wlr_render.diagnosis.verdict_sentences import (
    AXES_NOTE,
    RESIDUALS,
    odds_text,
    value_and_sigma,
    value_text,
)
from wlr_render.report.blocks import Cell, ReportTable

_UNITS = {" panel px": "panel px", "'": "arcmin"}
_UNCHANGED = 0.05  # percent: rounds to 0.0
_RANKED = 6  # of each place that are shown


def residuals_table(diagnosis: Diagnosis) -> ReportTable:
    """Residual with both benches, beside what noise alone would give."""
    states = [("bench as described", diagnosis.before), ("corrected bench", diagnosis.after)]
    states = [
        *states[: 2 if diagnosis.is_corrected else 1],
        ("noise", diagnosis.noise),
        ("expected", diagnosis.expected),
    ]
    unknown = undetermined_parts(diagnosis)
    measures = [(f"{name} ({_UNITS[unit]})", attribute, part in unknown) for part, name, attribute, unit in RESIDUALS]
    rows: list[list[Cell]] = []
    for name, attribute, is_unknown in (*measures, ("all readings (sigma)", "over_noise", bool(unknown))):
        *values, noise, expected = (getattr(summary, attribute) for _, summary in states)
        if values[0] is not None:
            usual = (None, None) if is_unknown else (expected, values[-1] / expected)
            rows.append([name, *values, noise, values[-1] / noise, *usual])
    last = states[-3][0]
    columns = (
        "residual, rms per axis",
        *(name for name, _ in states[:-1]),
        f"{last} / noise",
        "expected",
        f"{last} / expected",
    )
    notes = [
        "Noise: of the readings alone. Expected: with the motion that each capture has because positions do not repeat "
        "exactly."
    ]
    if unknown:
        notes.append(
            "No expected residual is stated where no cause explains the residual: the motions of its captures, as "
            "fitted, contain it."
        )
    return ReportTable("Simulation against measurement", columns, rows, notes)


def causes_table(diagnosis: Diagnosis) -> ReportTable:
    """One row for each cause found."""
    rows: list[list[Cell]] = [
        [
            cause.name,
            cause.title,
            cause.part,
            "; ".join(value_text(parameter) for parameter in cause.parameters),
            cause.effect_over_noise,
            _odds(cause.log10_odds),
            _percent(cause.improvement),
        ]
        for cause in diagnosis.causes
    ]
    columns = (
        "cause",
        "what it is",
        "part",
        "value +- one sigma",
        "effect (sigma)",
        "log10 odds",
        "held-out improvement (%)",
    )
    note = (
        "Effect: rms change of the readings. Log10 odds: for the cause against none, the others being as found, by the "
        "evidence of all readings. Held-out improvement: by how much the rms residual of captures that were "
        "not fitted falls when this cause joins the others (cross-validation by capture)."
    )
    return ReportTable("Causes", columns, rows, (note, AXES_NOTE))


def in_use_table(in_use: ImprovementInUse) -> ReportTable:
    """Errors of models and pictures with both benches."""
    rows: list[list[Cell]] = [
        [f"{side} model refitted to the session", each.before, each.after, _gain(each.improvement)]
        for side, each in (("display", in_use.display), ("see-through", in_use.see_through))
        if each is not None
    ]
    rows += [
        [
            f"picture rendered with the {what}",
            each.before.rms,
            each.after.rms,
            f"{gain:.1f}" if abs(gain) >= _UNCHANGED else "unchanged",
        ]
        for what, each in (("refitted models", in_use.calibrated), ("device's prescription", in_use.prescribed))
        if each is not None
        for gain in [100 * (1 - each.after.rms / each.before.rms)]
    ]
    columns = ("error, rms (arcmin)", "bench as described", "corrected bench", "improvement (%)")
    notes = (
        "Refitted model: a model is calibrated from most captures by each bench, and predicts the captures that were "
        "left out. Their true places are taken from the corrected bench.",
        "Picture rendered with the refitted models: angle between virtual and real points as a wearer of the corrected "
        "device would see them, with the models calibrated by each bench.",
        "Picture rendered with the device's prescription: the same angle with the device file of each bench in place "
        "of a calibrated model; the models calibrated by the corrected bench stand for the real device.",
        *in_use.unavailable,
    )
    return ReportTable("Improvement in use", columns, rows, notes)


def parameters_table(diagnosis: Diagnosis) -> ReportTable:
    """One row for each fitted number."""
    rows: list[list[Cell]] = []
    is_stated = any(stated_prior(diagnosis, cause, each) for cause in diagnosis.causes for each in cause.parameters)
    for cause in diagnosis.causes:
        for parameter in cause.parameters:
            value, sigma = value_and_sigma(parameter)
            ratio = abs(parameter.value) / parameter.sigma if parameter.sigma > 0 else None
            mean, usual = stated_prior(diagnosis, cause, parameter) or (parameter.prior_mean, parameter.prior_sigma)
            prior: Cell = f"{mean:g}, {usual:g}" if is_stated else usual
            rows.append([cause.name, parameter.name, value, sigma, parameter.unit, ratio, prior, cause.variant])
    size = "prior (mean, sigma)" if is_stated else "usual size"
    columns = ("cause", "parameter", "value", "one sigma", "unit", "value / sigma", size, "variant")
    note = "Usual size: standard deviation of what is met in practice; check a value that is many times larger."
    if is_stated:
        note = (
            "Prior: from [prior] of bench.toml, or 0 and the standard deviation of what is met in practice; check a "
            "value that is many sigmas from the mean."
        )
    return ReportTable("Parameters", columns, rows, (note, AXES_NOTE))


def degenerate_table(diagnosis: Diagnosis) -> ReportTable:
    """Causes that could be confused with each other."""
    rows: list[list[Cell]] = [
        [cause.name, other.name, f"{other.cosine:.4f}", other.separated_by]
        for cause in diagnosis.causes
        for other in cause.degenerate
    ]
    columns = ("cause", "nearly the same effect", "cosine", "measurement that separates them")
    note = (
        "Cosine of the angle between the effect found and its best match by the other cause. Condition of the "
        f"correlations between all values found: {diagnosis.correlations.condition:.2g} (1: each is known by itself)."
    )
    return ReportTable("Degenerate causes", columns, rows, (note,))


def ranking_table(diagnosis: Diagnosis) -> ReportTable:
    """Candidates for the place of each cause, the others being as found."""
    rows: list[list[Cell]] = [
        [f"{place}: {cause.name}", each.name, each.variant, _odds(each.log10_odds)]
        for place, cause in enumerate(diagnosis.causes, start=1)
        for each in cause.ranking[:_RANKED]
    ]
    columns = ("place", "candidate", "variant", "log10 odds against")
    note = (
        "Odds of the best candidate against this one, from their marginal likelihoods, each with the noise and the "
        "repeatability that suit it best; a dash: to first order too far behind to be fitted."
    )
    return ReportTable("Ranking of candidates", columns, rows, (note,))


def captures_table(diagnosis: Diagnosis) -> ReportTable:
    """One row for each capture."""
    white = _whitened_rms(diagnosis)
    # Without causes both benches are one.
    states = ("rms before (sigma)", "rms after (sigma)") if diagnosis.is_corrected else ("rms (sigma)",)
    rows: list[list[Cell]] = [
        [
            each.capture,
            each.readings,
            *(each.rms_before, each.rms_after)[: len(states)],
            white.get(each.capture),
            "yes" if each.excluded else "",
        ]
        for each in diagnosis.captures
    ]
    columns = ("capture", "readings", *states, "rms, whitened", "excluded")
    note = (
        "Before: with the bench as described. After: with the causes found. Both contain what the capture moved by. "
        "Whitened: without the motion and the shared noise that the bench has; 1 is noise."
    )
    return ReportTable("Captures", columns, rows, (note,))


def _whitened_rms(diagnosis: Diagnosis) -> dict[str, float]:
    """Rms of each capture's residual with independent errors, by its name."""
    observations, squares = diagnosis.readings.observations, np.mean(diagnosis.fit.residual**2, axis=1)
    count = np.bincount(observations.group, minlength=len(observations.captures))
    rms = np.sqrt(np.bincount(observations.group, squares, len(count)) / count.clip(1))
    return {str(name): float(rms[n]) for n, name in enumerate(observations.captures) if count[n]}


def excluded_table(diagnosis: Diagnosis) -> ReportTable:
    """Excluded captures, and the move that would explain each."""
    rows: list[list[Cell]] = [
        [
            str(moved.capture),
            *(None if value is None else f"{value:+.3f}" for value in _pose(moved)),
            moved.rms_before,
            moved.rms_after,
            _odds(moved.log10_odds),
        ]
        for moved in (*diagnosis.excluded, *diagnosis.too_many_moved)
    ]
    moves = (*(f"shift {axis} (mm)" for axis in "xyz"), *(f"turn {axis} (deg)" for axis in "xyz"))
    columns = ("capture", *moves, "rms (sigma)", "rms, moved (sigma)", "log10 odds")
    notes = ["Log10 odds: for such a move of the capture against one of the usual size."]
    if diagnosis.too_many_moved:
        notes.append("Captures of a part of which too many stand out were not excluded.")
    return ReportTable("Captures that moved", columns, rows, notes)


def effects_table(diagnosis: Diagnosis) -> ReportTable:
    """Effects that no cause has."""
    rows: list[list[Cell]] = [
        [
            each.station,
            each.coordinates,
            each.displaced,
            each.form,
            f"{each.size:.3g} {each.unit}",
            _odds(each.log10_odds),
            each.next_station or None,
            _odds(each.odds_against_next_station),
            _percent(each.held_out_improvement),
            100.0 * each.share_of_excess_removed,
        ]
        for each in diagnosis.effects
    ]
    columns = (
        "station",
        "function of",
        "displaces",
        "form",
        "rms size",
        "log10 odds",
        "next station",
        "log10 odds against it",
        "held-out improvement (%)",
        "excess removed (%)",
    )
    note = "Log10 odds: for the effect against noise and motions, beside what was found before it."
    return ReportTable("Effects that no cause has", columns, rows, (note,))


def fields_table(diagnosis: Diagnosis) -> ReportTable:
    """All fields that were judged, where something was found."""
    rows: list[list[Cell]] = [
        [each.station, each.coordinates, each.displaced, each.degree, _odds(each.log10_odds)]
        for each in (diagnosis.fields if diagnosis.effects or diagnosis.unexplained else ())
    ]
    note = (
        "A field is a displacement at a station, of any smooth shape up to a degree. All are charged for their number."
    )
    return ReportTable("Fields", ("station", "function of", "displaces", "degree", "log10 odds"), rows, (note,))


def limits_table(diagnosis: Diagnosis) -> ReportTable:
    """Detection limits, where nothing was found."""
    rows: list[list[Cell]] = [
        [each.cause, each.parameter, each.limit, each.unit] for each in diagnosis.detection_limits
    ]
    columns = ("cause", "parameter", "detection limit", "unit")
    note = f"{diagnosis.settings.detection_limit_se:g} standard errors, each cause acting alone."
    return ReportTable("Detection limits", columns, rows, (note,))


def _percent(improvement: HeldOutImprovement) -> str:
    return f"{improvement.percent:.1f} +- {improvement.sigma:.1f}"


def _gain(improvement: HeldOutImprovement) -> str:
    return _percent(improvement) if abs(improvement.percent) >= _UNCHANGED else "unchanged"


def _odds(log10_odds: float) -> Cell:
    return odds_text(log10_odds) if np.isfinite(log10_odds) else None


def _pose(moved: MovedCapture) -> tuple[float | None, ...]:
    return (*(moved.shift_mm or (None,) * 3), *(moved.turn_deg or (None,) * 3))

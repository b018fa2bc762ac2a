"""The tables of a diagnosis; a table without content has no rows."""

from functools import partial
from typing import Any, NamedTuple

import numpy as np

from wlr_render.diagnosis.diagnosis import DiagnosisRecord, FoundCause, MovedCapture
from wlr_render.diagnosis.findings import rms_of_captures
from wlr_render.diagnosis.held_out import HeldOutImprovement
from wlr_render.diagnosis.improvement import ImprovementInUse
from wlr_render.diagnosis.observations import PART_NAMES, PART_UNITS
from wlr_render.diagnosis.report_warnings import stated_prior
from wlr_render.diagnosis.verdict_sentences import (
    AXES_NOTE,
    CERTAIN,
    RESIDUALS,
    odds_text,
    undetermined_parts,
    value_text,
)
from wlr_render.report.blocks import Cell, Estimate, Number, ReportTable, table

_UNCHANGED = 0.05  # improvement in percent that rounds to 0.0
_RANKED = 6  # number of candidates shown for each place


class OfCause(NamedTuple):
    """A table row: one parameter or candidate of a cause."""

    cause: FoundCause
    each: Any


def residuals_table(diagnosis: DiagnosisRecord) -> ReportTable:
    """Return the residuals under the nominal and the corrected bench, next to the level expected from noise."""
    benches = {"bench as described": diagnosis.before, "corrected bench": diagnosis.after}
    if not diagnosis.is_corrected:
        del benches["corrected bench"]
    (*_, (last, left)) = benches.items()
    unknown = undetermined_parts(diagnosis)
    measures = [
        (f"{name} ({PART_UNITS[PART_NAMES.index(part)]})", attribute, part in unknown)
        for part, (name, attribute, _) in RESIDUALS.items()
        if getattr(diagnosis.before, attribute) is not None
    ]
    rows: list[list[Cell]] = []
    for name, attribute, is_unknown in (*measures, ("all readings (sigma)", "over_noise", bool(unknown))):
        after, noise, expected = (getattr(each, attribute) for each in (left, diagnosis.noise, diagnosis.expected))
        usual = (None, None) if is_unknown else (expected, after / expected)
        rows.append([name, *(getattr(each, attribute) for each in benches.values()), noise, after / noise, *usual])
    columns = ("residual, rms per axis", *benches, "noise", f"{last} / noise", "expected", f"{last} / expected")
    notes = [
        "Noise: residual from the noise of the readings alone. Expected: from noise and the random motion of each "
        "capture, because positions do not repeat exactly."
    ]
    if unknown:
        notes.append(
            "No expected residual is stated where no cause explains the residual: the fitted motions of the captures "
            "contain it."
        )
    return ReportTable("Simulation against measurement", columns, rows, notes)


def causes_table(diagnosis: DiagnosisRecord) -> ReportTable:
    """Return one row for each cause that was found."""
    note = (
        "Effect: rms change of the readings. Log10 odds: evidence of all readings for the cause against no cause, with "
        "the other causes as found. Held-out improvement: reduction of the rms residual of left-out captures when this "
        "cause is added to the others (cross-validation by capture)."
    )
    return table(
        "Causes",
        diagnosis.causes,
        {
            "cause": "name",
            "what it is": "title",
            "part": "part",
            "value +- one sigma": lambda cause: "; ".join(map(value_text, cause.parameters)),
            "effect (sigma)": "effect_over_noise",
            "log10 odds": lambda each: _odds(each.log10_odds),
            "held-out improvement (%)": lambda cause: _percent(cause.improvement),
        },
        (note, AXES_NOTE),
    )


def in_use_table(in_use: ImprovementInUse) -> ReportTable:
    """Return the errors of models and pictures made with both benches."""
    rows: list[list[Cell]] = [
        [f"{side} model refitted to the session", each.before, each.after, _percent(each.improvement, "unchanged")]
        for side, each in (("display", in_use.display), ("see-through", in_use.see_through))
        if each is not None
    ]
    for what, each in (("refitted models", in_use.calibrated), ("device's prescription", in_use.prescribed)):
        if each is not None:
            gain = 100 * (1 - each.after.rms / each.before.rms)
            said = Number(gain, ".1f") if abs(gain) >= _UNCHANGED else "unchanged"
            rows.append([f"picture rendered with the {what}", each.before.rms, each.after.rms, said])
    columns = ("error, rms (arcmin)", "bench as described", "corrected bench", "improvement (%)")
    notes = (
        "Refitted model: for each bench, a model is calibrated from most captures and predicts the left-out ones. The "
        "corrected bench gives the true positions.",
        "Picture rendered with the refitted models: angle between virtual and real points as a wearer of the corrected "
        "device would see them, with the models calibrated with each bench.",
        "Picture rendered with the device's prescription: the same angle with the device file of each bench in place "
        "of a calibrated model; the models calibrated with the corrected bench represent the real device.",
        *in_use.unavailable,
    )
    return ReportTable("Improvement in use", columns, rows, notes)


def parameters_table(diagnosis: DiagnosisRecord) -> ReportTable:
    """Return one row for each fitted number."""
    numbers = [OfCause(cause, each) for cause in diagnosis.causes for each in cause.parameters]
    is_stated = any(stated_prior(diagnosis, *row) for row in numbers)
    size, note = (
        "usual size",
        "Usual size: standard deviation in practice; check a value that is many times larger.",
    )
    if is_stated:
        size, note = (
            "prior (mean, sigma)",
            "Prior: from [prior] of bench.toml, or 0 and the standard deviation in practice; check a value "
            "that is many sigmas from the mean.",
        )

    def prior(row: OfCause) -> Cell:
        mean, sigma = stated_prior(diagnosis, *row) or (row.each.prior_mean, row.each.prior_sigma)
        return f"{mean:g}, {sigma:g}" if is_stated else sigma

    return table(
        "Parameters",
        numbers,
        {
            "cause": "cause.name",
            "parameter": lambda row: with_unit(row.each.name, row.each.unit),
            "value +- one sigma": lambda row: Estimate(row.each.value, row.each.sigma, digits=2),
            "value / sigma": lambda row: abs(row.each.value) / row.each.sigma if row.each.sigma > 0 else None,
            size: prior,
            "variant": "cause.variant",
        },
        (note, AXES_NOTE),
    )


def ranking_table(diagnosis: DiagnosisRecord) -> ReportTable:
    """Return the candidates for the place of each cause, with the other causes as found."""
    note = (
        "Odds of the best candidate against this one: the ratio of their marginal likelihoods, each with its best "
        "noise and repeatability. A dash: too unlikely to first order to be fitted."
    )
    return table(
        "Ranking of candidates",
        [OfCause(cause, each) for cause in diagnosis.causes for each in cause.ranking[:_RANKED]],
        {
            "place": lambda row: f"{diagnosis.causes.index(row.cause) + 1}: {row.cause.name}",
            "candidate": "each.name",
            "variant": "each.variant",
            "log10 odds against": lambda row: _odds(row.each.log10_odds),
        },
        (note,),
    )


def captures_table(diagnosis: DiagnosisRecord) -> ReportTable:
    """Return one row for each capture."""
    observations, residual = diagnosis.readings.observations, diagnosis.fit.residual
    readings, white = rms_of_captures(observations, residual, np.ones(len(residual), dtype=bool))
    whitened = {str(name): float(white[n]) for n, name in enumerate(observations.captures) if readings[n]}
    rms = {"rms before (sigma)": "rms_before", "rms after (sigma)": "rms_after"}
    note = (
        "Before: bench as described. After: bench with the causes found. Both contain the motion of the capture. "
        "Whitened: without this motion and without noise that neighbouring readings share; 1 is the noise alone."
    )
    return table(
        "Captures",
        diagnosis.captures,
        {
            "capture": "capture",
            "readings": "readings",
            # Without a correction, both benches are the same.
            **(rms if diagnosis.is_corrected else {"rms (sigma)": "rms_before"}),
            "rms, whitened": lambda each: whitened.get(each.capture),
            "excluded": lambda each: "yes" if each.excluded else "",
        },
        (note,),
    )


def excluded_table(diagnosis: DiagnosisRecord) -> ReportTable:
    """Return the captures that moved, and the move that would explain each."""
    notes = ["Log10 odds: for such a motion of the capture against one of the usual size."]
    if diagnosis.too_many_moved:
        notes.append("Captures of a part of which too many stand out were not excluded.")
    return table(
        "Captures that moved",
        (*diagnosis.excluded, *diagnosis.too_many_moved),
        {
            "capture": lambda moved: str(moved.capture),
            **{f"shift {axis} (mm)": partial(_component, "shift_mm", number) for number, axis in enumerate("xyz")},
            **{f"turn {axis} (deg)": partial(_component, "turn_deg", number) for number, axis in enumerate("xyz")},
            "rms (sigma)": "rms_before",
            "rms, moved (sigma)": "rms_after",
            "log10 odds": lambda each: _odds(each.log10_odds),
        },
        notes,
    )


def _component(attribute: str, number: int, moved: MovedCapture) -> Cell:
    """Return one component of a move; None where the move is not known."""
    values = getattr(moved, attribute)
    return None if values is None else Number(values[number], "+z.3f")


def effects_table(diagnosis: DiagnosisRecord) -> ReportTable:
    """Return the located effects that no cause explains."""
    return table(
        "Effects that no cause has",
        diagnosis.effects,
        {
            "station": "station",
            "function of": "coordinates",
            "displaces": "displaced",
            "form": "form",
            "size": lambda each: Estimate(each.size, each.size_sigma, each.unit),
            "log10 odds": lambda each: _odds(each.log10_odds),
            "next station": lambda each: each.next_station or None,
            "log10 odds against it": lambda each: _odds(each.odds_against_next_station),
            "held-out improvement (%)": lambda each: _percent(each.held_out_improvement),
            "excess removed (%)": lambda each: 100.0 * each.share_of_excess_removed,
        },
        (
            "Size: rms displacement over the readings that the effect acts on; of a spot, in its strongest cell; of a "
            "bump, its largest height.",
            "Log10 odds: for the effect against noise and motions, with the effects of higher odds present.",
        ),
    )


def fields_table(diagnosis: DiagnosisRecord) -> ReportTable:
    """Return all fields that were judged, if something was found."""
    return table(
        "Fields",
        diagnosis.fields if diagnosis.effects or diagnosis.unexplained_parts else (),
        {
            "station": "station",
            "function of": "coordinates",
            "displaces": "displaced",
            "degree": "degree",
            "log10 odds": lambda each: _odds(each.log10_odds),
        },
        (
            "A field is a displacement at a station, of any smooth shape up to a degree. The odds account for "
            "the number of fields that were tried.",
        ),
    )


def limits_table(diagnosis: DiagnosisRecord) -> ReportTable:
    """Return the detection limits, if nothing was found."""
    return table(
        "Detection limits",
        diagnosis.detection_limits,
        {"cause": "cause", "parameter": lambda each: with_unit(each.parameter, each.unit), "detection limit": "limit"},
        (f"{diagnosis.settings.detection_limit_se:g} standard errors, each cause acting alone.",),
    )


def repeatability_table(diagnosis: DiagnosisRecord) -> ReportTable:
    """Return the repeatability of the captures of each part."""
    unknown = undetermined_parts(diagnosis)
    notes = [
        "Standard deviation, per axis, of the random motion of the camera relative to the headset in each capture."
    ]
    if unknown:
        notes.append("Not determined: no cause explains the residual, and the motions contain it.")
    return table(
        "Repeatability",
        diagnosis.motions,
        {
            "part": lambda each: f"{each.part} (not determined)" if each.part in unknown else each.part,
            "positions (um)": lambda each: Estimate(each.shift_um, each.shift_error_um),
            "turns (urad)": lambda each: Estimate(each.turn_urad, each.turn_error_urad),
        },
        notes,
    )


def noise_table(diagnosis: DiagnosisRecord) -> ReportTable:
    """Return the noise of each part: stated, measured, and used."""
    note = (
        "Within photographs: residual of a smooth surface fitted to each photograph. Repeats: photographs taken twice "
        "from one place. Measured: both combined by inverse variance; at run time the remaining residual, if "
        "neighbouring readings do not resemble each other at any station. Used: mean of measured and stated, weighted "
        "by their errors, or the measured one where the stated one does not agree. Shared: part of the variance that "
        "neighbouring points of a photograph share."
    )
    return table(
        "Noise",
        diagnosis.noise_floors,
        {
            "noise (camera px)": "part",
            "stated": "stated_px",
            "within photographs": "within_px",
            "repeats": "repeats_px",
            "measured": lambda floor: Estimate(floor.measured_px, floor.error_px),
            "used": "used_px",
            "stated agrees": lambda floor: "yes" if floor.is_believable else "no",
            "corner / middle": "rim_factor",
            "photographs differ (%)": lambda floor: 100 * float(np.expm1(floor.photographs_differ)),
            "shared (%)": lambda floor: 100 * floor.shared,
        },
        (note,),
    )


def _percent(improvement: HeldOutImprovement, unchanged: str = "") -> Cell:
    """Return an improvement with its error, or `unchanged`, if given, where it rounds to zero."""
    if unchanged and abs(improvement.percent) < _UNCHANGED:
        return unchanged
    return Estimate(improvement.percent, improvement.sigma)


def with_unit(parameter: str, unit: str) -> str:
    """Return the name of a parameter with its unit, as in column heads."""
    return parameter if unit == "1" else f"{parameter} ({unit})"


def _odds(log10_odds: float) -> Cell:
    """Return log10 odds, as text where they are capped; None where they are unknown."""
    if not np.isfinite(log10_odds):
        return None
    return odds_text(log10_odds) if log10_odds > CERTAIN else Number(log10_odds, ".1f")

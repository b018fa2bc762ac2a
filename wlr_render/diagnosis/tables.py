"""A diagnosis as tables; those that would be empty have no rows."""

import numpy as np

from wlr_render.diagnosis.diagnosis import Diagnosis
from wlr_render.diagnosis.explain import RESIDUALS, odds_text, value_and_sigma, value_text
from wlr_render.diagnosis.fit import HeldOutImprovement
from wlr_render.diagnosis.improvement import ImprovementInUse
from wlr_render.diagnosis.noise_sentences import with_error
from wlr_render.diagnosis.outliers import MovedCapture
from wlr_render.report.blocks import Cell, ReportTable

_UNITS = {" px": "panel px", "'": "arcmin"}
_RANKED = 6  # of each place that are shown


def residuals_table(diagnosis: Diagnosis) -> ReportTable:
    """Residual with both benches, beside what noise alone would give."""
    states = [("bench as described", diagnosis.before), ("corrected bench", diagnosis.after)]
    states = [*states[: 2 if diagnosis.causes else 1], ("noise", diagnosis.noise), ("expected", diagnosis.expected)]
    measures = [(f"{name} ({_UNITS[unit]})", attribute) for name, attribute, unit in RESIDUALS]
    rows: list[list[Cell]] = []
    for name, attribute in (*measures, ("all readings (sigma)", "over_noise")):
        values = [getattr(summary, attribute) for _, summary in states]
        if values[0] is not None:
            rows.append([name, *values, values[-3] / values[-1]])
    columns = ("residual, rms per axis", *(name for name, _ in states), f"{states[-3][0]} / expected")
    notes = (
        "Noise: of the readings alone. Expected: with the motion that each capture has because positions do not repeat "
        "exactly.",
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
    return ReportTable("Causes", columns, rows, (note,))


def in_use_table(in_use: ImprovementInUse) -> ReportTable:
    """What the corrected bench improves in use."""
    rows: list[list[Cell]] = [
        [f"{side} model refitted to the session", each.before, each.after, _percent(each.improvement)]
        for side, each in (("display", in_use.display), ("see-through", in_use.see_through))
        if each is not None
    ]
    rows += [
        [
            f"picture rendered with the {what}",
            each.before.rms,
            each.after.rms,
            100 * (1 - each.after.rms / each.before.rms),
        ]
        for what, each in (("refitted models", in_use.calibrated), ("device's prescription", in_use.prescribed))
        if each is not None
    ]
    columns = ("error, rms (arcmin)", "bench as described", "corrected bench", "improvement (%)")
    notes = (
        "Refitted model: its error on held-out captures, which the corrected bench locates.",
        "Picture rendered with the refitted models: misalignment between virtual and real points in the corrected "
        "device.",
        "Picture rendered with the device's prescription: the same misalignment by the models that were refitted with "
        "the corrected bench.",
        *in_use.unavailable,
    )
    return ReportTable("Improvement in use", columns, rows, notes)


def parameters_table(diagnosis: Diagnosis) -> ReportTable:
    """One row for each fitted number."""
    rows: list[list[Cell]] = []
    for cause in diagnosis.causes:
        for parameter in cause.parameters:
            value, sigma = value_and_sigma(parameter)
            ratio = abs(parameter.value) / parameter.sigma if parameter.sigma > 0 else None
            rows.append(
                [cause.name, parameter.name, value, sigma, parameter.unit, ratio, parameter.prior_sigma, cause.variant]
            )
    columns = ("cause", "parameter", "value", "one sigma", "unit", "value / sigma", "usual size", "variant")
    note = "Usual size: standard deviation of what is met in practice; check a value that is many times larger."
    return ReportTable("Parameters", columns, rows, (note,))


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
    states = ("rms before (sigma)", "rms after (sigma)") if diagnosis.causes else ("rms (sigma)",)
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


def repeatability_table(diagnosis: Diagnosis) -> ReportTable:
    """How far the captures of each part repeat."""
    rows: list[list[Cell]] = [
        [
            each.part,
            with_error(each.shift_um, each.shift_error_um),
            with_error(each.turn_urad, each.turn_error_urad),
        ]
        for each in diagnosis.motions
    ]
    columns = ("part", "positions (um)", "turns (urad)")
    note = "Standard deviation, per axis, of the random motion of the camera against the headset in each capture."
    return ReportTable("Repeatability", columns, rows, (note,))


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


def unexplained_table(diagnosis: Diagnosis) -> ReportTable:
    """Smooth corrections of what no cause explains."""
    left = diagnosis.unexplained
    title = "" if left is None else f"Unexplained {left.part} residual, {left.rms_over_noise:.3g} times the noise"
    rows: list[list[Cell]] = [
        [each.depends_on, each.form, each.terms, _odds(each.log10_odds), _percent(each.improvement)]
        for each in (left.corrections if left else ())
    ]
    columns = ("smooth function of", "form", "terms per axis", "log10 odds", "held-out improvement (%)")
    note = (
        "A smooth correction describes the residual; it is no cause, and says nothing about other benches. Log10 "
        "odds: for it against noise and motions alone."
    )
    return ReportTable(title, columns, rows, (note,))


def limits_table(diagnosis: Diagnosis) -> ReportTable:
    """Detection limits, where nothing was found."""
    rows: list[list[Cell]] = [
        [each.cause, each.parameter, each.limit, each.unit] for each in diagnosis.detection_limits
    ]
    columns = ("cause", "parameter", "detection limit", "unit")
    return ReportTable("Detection limits", columns, rows, ("Five standard errors, each cause acting alone.",))


def noise_table(diagnosis: Diagnosis) -> ReportTable:
    """Noise of each part: stated, measured, and used."""
    rows: list[list[Cell]] = [
        [
            floor.part,
            floor.stated_px,
            floor.within_px,
            floor.repeats_px,
            with_error(floor.measured_px, floor.error_px),
            floor.used_px,
            "yes" if floor.is_believable else "no",
            floor.rim_factor,
            100 * float(np.expm1(floor.photographs_differ)),
            100 * floor.shared,
        ]
        for floor in diagnosis.noise_floors
    ]
    columns = (
        "noise (camera px)",
        "stated",
        "within photographs",
        "repeats",
        "measured",
        "used",
        "stated agrees",
        "corner / middle",
        "photographs differ (%)",
        "shared (%)",
    )
    note = (
        "Within photographs: residual of a smooth surface fitted to each photograph. Repeats: photographs taken twice "
        "from one place. Measured: both combined by inverse variance. Used: measured and stated weighted by their "
        "errors. Shared: of the variance, by neighbouring points of a photograph."
    )
    return ReportTable("Noise", columns, rows, (note,))


def _percent(improvement: HeldOutImprovement) -> str:
    return f"{improvement.percent:.1f} +- {improvement.sigma:.1f}"


def _odds(log10_odds: float) -> Cell:
    return odds_text(log10_odds) if np.isfinite(log10_odds) else None


def _pose(moved: MovedCapture) -> tuple[float | None, ...]:
    return (*(moved.shift_mm or (None,) * 3), *(moved.turn_deg or (None,) * 3))

"""A diagnosis as tables; those that would be empty have no rows."""

from wlr_render.diagnosis.diagnosis import Diagnosis, RankedCandidate
from wlr_render.diagnosis.explain import RESIDUALS, value_and_sigma, value_text
from wlr_render.diagnosis.fit import HeldOutImprovement
from wlr_render.diagnosis.improvement import ImprovementInUse
from wlr_render.diagnosis.outliers import MovedCapture
from wlr_render.report.blocks import Cell, ReportTable, cell_text

_UNITS = {" px": "panel px", "'": "arcmin"}
_RANKED = 6  # of each place that are shown
_CERTAIN = 20.0  # log10 odds beyond which the number says no more


def residuals_table(diagnosis: Diagnosis) -> ReportTable:
    """Residual with both benches, beside what noise alone would give."""
    states = [("bench as described", diagnosis.before), ("corrected bench", diagnosis.after)]
    states = [*states[: 2 if diagnosis.causes else 1], ("noise", diagnosis.noise)]
    measures = [(f"{name} ({_UNITS[unit]})", attribute) for name, attribute, unit in RESIDUALS]
    rows: list[list[Cell]] = []
    for name, attribute in (*measures, ("all readings (sigma)", "over_noise")):
        values = [getattr(summary, attribute) for _, summary in states]
        if values[0] is not None:
            rows.append([name, *values, values[-2] / values[-1]])
    columns = ("residual, rms per axis", *(name for name, _ in states), f"{states[-2][0]} / noise")
    return ReportTable("Simulation against measurement", columns, rows)


def causes_table(diagnosis: Diagnosis) -> ReportTable:
    """One row for each cause found."""
    rows: list[list[Cell]] = [
        [
            cause.name,
            cause.title,
            cause.part,
            "; ".join(value_text(parameter) for parameter in cause.parameters),
            cause.effect_over_noise,
            _percent(cause.improvement),
        ]
        for cause in diagnosis.causes
    ]
    columns = ("cause", "what it is", "part", "value +- one sigma", "effect (sigma)", "held-out improvement (%)")
    note = (
        "Effect: rms change of the readings. Held-out improvement: by how much the rms residual of captures that were "
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
        [f"{place}: {cause.name}", each.name, each.variant, each.reduced_chi_squared, _odds(each)]
        for place, cause in enumerate(diagnosis.causes, start=1)
        for each in cause.ranking[:_RANKED]
    ]
    columns = ("place", "candidate", "variant", "reduced chi-squared", "log10 odds against")
    note = (
        "Reduced chi-squared: mean square residual over the noise's; 1 is noise. Odds of the best candidate against "
        "this one, from their marginal likelihoods; a dash: to first order too far behind to be fitted."
    )
    return ReportTable("Ranking of candidates", columns, rows, (note,))


def captures_table(diagnosis: Diagnosis) -> ReportTable:
    """One row for each capture."""
    rows: list[list[Cell]] = [
        [
            each.capture,
            each.readings,
            each.rms_before,
            each.rms_after,
            each.reduced_chi_squared,
            "yes" if each.excluded else "",
        ]
        for each in diagnosis.captures
    ]
    columns = ("capture", "readings", "rms before (sigma)", "rms after (sigma)", "reduced chi-squared", "excluded")
    return ReportTable("Captures", columns, rows, ("Before: bench as described. After: with the causes found.",))


def excluded_table(diagnosis: Diagnosis) -> ReportTable:
    """Excluded captures, and the move that would explain each."""
    rows: list[list[Cell]] = [
        [
            str(moved.capture),
            *(None if value is None else f"{value:+.3f}" for value in _pose(moved)),
            moved.rms_before,
            moved.rms_after,
        ]
        for moved in diagnosis.excluded
    ]
    moves = (*(f"shift {axis} (mm)" for axis in "xyz"), *(f"turn {axis} (deg)" for axis in "xyz"))
    columns = ("excluded capture", *moves, "rms (sigma)", "rms, moved (sigma)")
    return ReportTable("Captures that moved", columns, rows)


def unexplained_table(diagnosis: Diagnosis) -> ReportTable:
    """Smooth corrections of what no cause explains."""
    left = diagnosis.unexplained
    title = "" if left is None else f"Unexplained {left.part} residual, {left.rms_over_noise:.3g} times the noise"
    rows: list[list[Cell]] = [
        [each.depends_on, each.form, each.terms, _percent(each.improvement), each.improvement.significance]
        for each in (left.corrections if left else ())
    ]
    columns = ("smooth function of", "form", "terms per axis", "held-out improvement (%)", "standard errors")
    note = "A smooth correction describes the residual; it is no cause, and says nothing about other benches."
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
            f"{cell_text(floor.measured_px)} +- {cell_text(floor.error_px)}",
            floor.used_px,
            "yes" if floor.is_believable else "no",
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
    )
    note = (
        "Within photographs: residual of a smooth surface fitted to each photograph. Repeats: photographs taken twice "
        "from one place. Measured: both combined by inverse variance."
    )
    return ReportTable("Noise", columns, rows, (note,))


def _percent(improvement: HeldOutImprovement) -> str:
    return f"{improvement.percent:.1f} +- {improvement.sigma:.1f}"


def _odds(candidate: RankedCandidate) -> Cell:
    return f"> {_CERTAIN:.0f}" if candidate.log10_odds > _CERTAIN else candidate.log10_odds


def _pose(moved: MovedCapture) -> tuple[float | None, ...]:
    return (*(moved.shift_mm or (None,) * 3), *(moved.turn_deg or (None,) * 3))

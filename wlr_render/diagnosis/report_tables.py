"""A diagnosis as tables; those that would be empty are left out."""

from wlr_render.diagnosis.diagnosis import NO_EFFECT, Diagnosis
from wlr_render.diagnosis.gain import Gains
from wlr_render.diagnosis.outliers import MovedCapture
from wlr_render.diagnosis.report_text import FIGURES, value_and_sigma, value_text
from wlr_render.report.blocks import Cell, ReportTable

_UNITS = {" px": "panel px", "'": "arcmin"}
_RIVALS = 6  # of each place that are shown


def tables(diagnosis: Diagnosis, gains: Gains | None = None) -> list[ReportTable]:
    """All tables that have rows, in reading order."""
    first = [make(diagnosis) for make in (figures_table, causes_table)]
    worth = [gains_table(gains)] if gains else []
    rest = (overlaps_table, outliers_table, unexplained_table, limits_table, ranking_table, noise_table)
    return [table for table in (*first, *worth, *(make(diagnosis) for make in rest)) if table.rows]


def figures_table(diagnosis: Diagnosis) -> ReportTable:
    """How far both benches are from the measurement, and how far noise alone would be."""
    states = [("bench as described", diagnosis.before), ("extended bench", diagnosis.after)]
    states = [*states[: 2 if diagnosis.causes else 1], ("noise", diagnosis.noise)]
    measures = [(f"{name} ({_UNITS[unit]})", attribute) for name, attribute, unit in FIGURES]
    rows: list[list[Cell]] = []
    for name, attribute in (*measures, ("all readings (sigma)", "over_noise")):
        values = [getattr(figures, attribute) for _, figures in states]
        if values[0] is not None:
            rows.append([name, *values, values[-2] / values[-1]])
    columns = ("residual, rms per axis", *(name for name, _ in states), f"{states[-2][0]} over noise")
    return ReportTable("Simulation against measurement", columns, rows)


def causes_table(diagnosis: Diagnosis) -> ReportTable:
    """One row for each cause found."""
    rows: list[list[Cell]] = [
        [
            cause.name,
            cause.title,
            cause.part,
            "\n".join(value_text(parameter) for parameter in cause.parameters),
            cause.effect_over_noise,
            f"{cause.gain.percent:.1f} +- {cause.gain.sigma:.1f}",
        ]
        for cause in diagnosis.causes
    ]
    columns = ("cause", "what it is", "part", "size", "effect (sigma)", "held-out gain (%)")
    note = (
        "Effect: rms change of the readings. Held-out gain: by how much the rms residual of captures that were not "
        "fitted falls when this cause joins the others."
    )
    return ReportTable("Causes", columns, rows, (note,))


def gains_table(gains: Gains) -> ReportTable:
    """What the extended bench is worth in use."""
    rows: list[list[Cell]] = [
        [f"{side} model refitted to the session", r.before, r.after, f"{r.gain.percent:.1f} +- {r.gain.sigma:.1f}"]
        for side, r in (("display", gains.display), ("see-through", gains.see_through))
        if r is not None
    ]
    rows += [
        [
            f"picture rendered with the {what}",
            r.before.rms,
            r.after.rms,
            100 * (1 - r.after.rms / r.before.rms),
        ]
        for what, r in (("refitted models", gains.calibrated), ("device's prescription", gains.prescribed))
        if r is not None
    ]
    columns = ("error, rms (arcmin)", "bench as described", "extended bench", "gain (%)")
    notes = (
        "Refitted: on held-out captures, placed where the extended bench has them. Rendered: misalignment of virtual "
        "points with the real ones that they are drawn onto, seen through the extended device (refitted models) or "
        "through the models that were refitted by the extended bench (prescription).",
        *gains.lacking,
    )
    return ReportTable("What the extended bench is worth in use", columns, rows, notes)


def parameters_table(diagnosis: Diagnosis) -> ReportTable:
    """One row for each fitted number."""
    rows: list[list[Cell]] = []
    for cause in diagnosis.causes:
        for parameter in cause.parameters:
            value, sigma = value_and_sigma(parameter)
            ratio = abs(parameter.value) / parameter.sigma if parameter.sigma > 0 else None
            plausible = parameter.plausible
            rows.append([cause.name, parameter.name, value, sigma, parameter.unit, ratio, plausible, cause.variant])
    columns = ("cause", "parameter", "value", "one sigma", "unit", "value / sigma", "usual size", "acting")
    note = "Usual size: standard deviation of what is met in practice; a value many times that asks for a second look."
    return ReportTable("Parameters", columns, rows, (note,))


def overlaps_table(diagnosis: Diagnosis) -> ReportTable:
    """Causes that could be mistaken for each other."""
    rows: list[list[Cell]] = [
        [cause.name, overlap.name, f"{overlap.cosine:.4f}", overlap.separated_by]
        for cause in diagnosis.causes
        for overlap in cause.overlaps
    ]
    columns = ("cause", "looks like", "cosine", "what tells them apart")
    note = (
        "Cosine of the angle between the effect found and the best imitation of it by the other cause. Condition of "
        f"the correlations between all values found: {diagnosis.condition:.2g} (1: each is known by itself)."
    )
    return ReportTable("Look-alikes", columns, rows, (note,))


def ranking_table(diagnosis: Diagnosis) -> ReportTable:
    """Candidates for the place of each cause, the others being as found."""
    rows: list[list[Cell]] = [
        [f"{place}: {cause.name}", rival.name, rival.variant, rival.misfit, rival.cost_behind]
        for place, cause in enumerate(diagnosis.causes, start=1)
        for rival in cause.rivals[:_RIVALS]
    ]
    columns = ("place", "candidate", "acting", "misfit (noise is 1)", "cost behind the best")
    note = (
        "Misfit: mean square residual over the noise's. Cost: -2 log of the marginal likelihood; 10 behind is a chance "
        "of 1 in 150, all else being equal."
    )
    return ReportTable("Ranking", columns, rows, (note,))


def _pose(moved: MovedCapture) -> tuple[float | None, ...]:
    return (*(moved.shift_mm or (None,) * 3), *(moved.turn_deg or (None,) * 3))


def outliers_table(diagnosis: Diagnosis) -> ReportTable:
    """Captures set aside, and the move that would explain each."""
    rows: list[list[Cell]] = [
        [
            str(moved.capture),
            *(None if value is None else f"{value:+.3f}" for value in _pose(moved)),
            moved.rms_before,
            moved.rms_after,
        ]
        for moved in diagnosis.outliers
    ]
    moves = (*(f"shift {axis} (mm)" for axis in "xyz"), *(f"turn {axis} (deg)" for axis in "xyz"))
    columns = ("capture set aside", *moves, "rms (sigma)", "rms, moved (sigma)")
    return ReportTable("Captures that moved", columns, rows)


def unexplained_table(diagnosis: Diagnosis) -> ReportTable:
    """Smooth corrections of what no cause explains."""
    left = diagnosis.unexplained
    title = "" if left is None else f"What is left in the {left.part} part, {left.rms_over_noise:.3g} times the noise"
    rows: list[list[Cell]] = [
        [c.bound_to, c.form, c.terms, f"{c.gain.percent:.1f} +- {c.gain.sigma:.1f}", c.gain.significance]
        for c in (left.corrections if left else ())
    ]
    columns = ("correction as a function of", "form", "terms per axis", "held-out gain (%)", "standard errors")
    note = "A correction describes what is left; it is no cause, and says nothing of other benches."
    return ReportTable(title, columns, rows, (note,))


def limits_table(diagnosis: Diagnosis) -> ReportTable:
    """The smallest effects that would have been found, where none was."""
    limits = diagnosis.limits if diagnosis.verdict == NO_EFFECT else ()
    rows: list[list[Cell]] = [[limit.cause, limit.parameter, limit.smallest, limit.unit] for limit in limits]
    columns = ("cause", "parameter", "smallest", "unit")
    return ReportTable("What would have been found", columns, rows, ("Five standard errors, acting alone.",))


def noise_table(diagnosis: Diagnosis) -> ReportTable:
    """How the noise of each part was measured."""
    rows: list[list[Cell]] = [
        [
            floor.part,
            floor.stated_px,
            floor.within_px,
            floor.repeats_px,
            floor.used_px,
            "yes" if floor.believable else "no",
        ]
        for floor in diagnosis.floors
    ]
    columns = ("noise (camera px)", "stated", "within photographs", "repeats", "gone by", "stated believable")
    note = (
        "Within photographs: what is left of each after a smooth surface, since every physical effect is smooth over "
        "the image. Repeats: photographs taken twice from one place."
    )
    return ReportTable("Noise", columns, rows, (note,))

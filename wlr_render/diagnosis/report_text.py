"""A diagnosis in sentences: the verdict, what to do about it, and what to beware of."""

from math import floor, log10

from wlr_render.diagnosis.diagnosis import (
    EXPLAINED,
    NO_EFFECT,
    PARTLY,
    Diagnosis,
    FoundCause,
    Overlap,
    ParameterValue,
)
from wlr_render.report.blocks import cell_text

_DECIDED = 20.0  # of the cost: e^10 to 1 against whoever is so far behind

_REMEDIES = {
    "device": "calibrate and render with the extended device, or have the headset readjusted",
    "camera": "calibrate the eyeball camera again, or go on with the extended bench's",
    "stage": "have the stage adjusted, or go on with the extended bench, which corrects its readings",
    "target": "enter the target's true form in bench.toml, or print it anew",
    "tracking": "correct the tracking camera's pose, or go on with the extended bench's",
    "mount": "see to the mount before the next session; the extended bench corrects this one",
    "eye tracking": "calibrate the eye tracking again, or give it the extended bench's correction",
    "clock": "draw each frame for the later moment at which it is seen",
}
"""What to do about a cause, by the part of the bench that it belongs to."""

_DEPENDENT = 1e4
"""Condition of the values found from which the report warns."""

_MEANWHILE = {
    "panel pixels": "Until it is found, render with models fitted to the session (calibrate --captures): like this "
    "function they absorb what is fixed in the headset.",
}
"""What to do about what is left, by what it is bound to."""

FIGURES = (
    ("display", "display_rms_px", " px"),
    ("see-through", "see_through_rms_arcmin", "'"),
    ("virtual against real dot", "run_time_rms_arcmin", "'"),
)
"""Of each part: what it is called, its attribute of `Figures`, and its unit as it is appended to a number."""


def verdict_sentence(diagnosis: Diagnosis) -> str:
    """The verdict with its figures, in one sentence."""
    causes, left = diagnosis.causes, diagnosis.unexplained
    if diagnosis.verdict == NO_EFFECT:
        return (
            f"No effect found: the bench as described predicts the session down to its noise ({_changes(diagnosis)})."
        )
    named = "; ".join(f"{cause.title} ({cause.name}: {_clearest(cause)})" for cause in causes)
    head = {EXPLAINED: "Explained", PARTLY: "Partly explained"}.get(diagnosis.verdict, "Unexplained")
    told = f"{head}: {named or 'no cause in the list accounts for what is measured'}; {_changes(diagnosis)}"
    if left is None:
        return f"{told}."
    return (
        f"{told}; in the {left.part} part {cell_text(left.rms_over_noise)} times the noise is left, and it goes with "
        f"{left.bound_to}."
    )


def advice(diagnosis: Diagnosis) -> list[str]:
    """What to do next, most urgent first; each a sentence."""
    if diagnosis.verdict == NO_EFFECT:
        return ["Keep the bench as it is; effects below the smallest sizes listed would not have been seen."]
    told = [_before_acting(cause, rival) for cause in diagnosis.causes for rival in _open(cause)]
    told += [f"{_capital(cause.title)}: {cause.remedy or _REMEDIES[cause.part]}." for cause in diagnosis.causes]
    left = diagnosis.unexplained
    if left is not None:
        told.append(
            f"Look for something bound to {left.bound_to} in the {left.part} part that is not in the list of causes."
        )
        best = max((correction.gain.percent for correction in left.corrections), default=0.0)
        if best > 0:
            told.append(
                f"A smooth function of {left.bound_to} takes away {best:.0f} % of it on held-out captures. "
                + _MEANWHILE.get(left.bound_to, "It is no cause; calibrate when the effect is gone.")
            )
    if diagnosis.outliers:
        names = ", ".join(str(moved.capture) for moved in diagnosis.outliers)
        told.append(f"Take again, or leave out: {names}.")
    return told


def warnings(diagnosis: Diagnosis) -> list[str]:
    """What to beware of when reading the rest; each a sentence."""
    told = [
        f"The stated noise of the {noise.part} readings, {cell_text(noise.stated_px)} px, is not believable: they "
        f"scatter by {cell_text(noise.measured_px)} px, and the diagnosis goes by {cell_text(noise.used_px)} px."
        for noise in diagnosis.floors
        if not noise.believable
    ]
    told += [_look_alikes(cause) for cause in diagnosis.causes if cause.overlaps]
    if diagnosis.condition > _DEPENDENT:
        told.append(
            f"The values found depend on each other (condition {diagnosis.condition:.0g}): several sets of them fit "
            "nearly as well, and each error bar holds with the others free."
        )
    if diagnosis.outliers:
        told.append(f"Captures that moved were set aside ({len(diagnosis.outliers)}); no figure counts them.")
    return told


def value_text(parameter: ParameterValue) -> str:
    """Name, value, one standard error and unit."""
    value, sigma = value_and_sigma(parameter)
    unit = "" if parameter.unit == "1" else f" {parameter.unit}"
    return f"{parameter.name} {value} +- {sigma}{unit}" if parameter.sigma > 0 else f"{parameter.name} {value}{unit}"


def value_and_sigma(parameter: ParameterValue) -> tuple[str, str]:
    """Both as text, to two digits of the standard error."""
    if not 0 < parameter.sigma < float("inf"):
        return f"{parameter.value:.5g}", "-"
    decimals = max(0, 1 - floor(log10(parameter.sigma)))
    return f"{parameter.value:.{decimals}f}", f"{parameter.sigma:.{decimals}f}"


def _clearest(cause: FoundCause) -> str:
    """The value that stands out most from its error, and whether there are others."""
    known = [parameter for parameter in cause.parameters if parameter.sigma > 0] or list(cause.parameters)
    best = max(known, key=lambda parameter: abs(parameter.value) / (parameter.sigma or 1.0))
    return value_text(best) + (", ..." if len(cause.parameters) > 1 else "")


def _open(cause: FoundCause) -> list[Overlap]:
    """Look-alikes between which and the cause the session does not decide."""
    close = {rival.name for rival in cause.rivals if rival.cost_behind < _DECIDED}
    return [overlap for overlap in cause.overlaps if overlap.name in close]


def _before_acting(cause: FoundCause, rival: Overlap) -> str:
    return (
        f"Before acting on {cause.name}, tell it from {rival.name}, which explains this session nearly as well, by an "
        f"extra measurement: {rival.separated_by}."
    )


def _look_alikes(cause: FoundCause) -> str:
    names = ", ".join(f"{overlap.name} (cosine {overlap.cosine:.3f})" for overlap in cause.overlaps)
    nearest = cause.overlaps[0]
    decided = "The session does not decide." if _open(cause) else "The session decides for it."
    return f"{cause.name} looks much like {names}. {decided} More certain: from {nearest.name}, {nearest.separated_by}."


def _changes(diagnosis: Diagnosis) -> str:
    """Residual and noise of each part that the causes change; of all parts where none does."""
    told = []
    for name, attribute, unit in FIGURES:
        if getattr(diagnosis.before, attribute) is not None:
            figures = (diagnosis.before, diagnosis.after, diagnosis.noise)
            told.append((name, *(cell_text(getattr(each, attribute)) + unit for each in figures)))
    changed = [row for row in told if row[1] != row[2]]
    texts = [f"{name} residual {before} -> {after}, noise {noise}" for name, before, after, noise in changed]
    return "; ".join(texts or [f"{name} residual {before}, noise {noise}" for name, before, _, noise in told])


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]

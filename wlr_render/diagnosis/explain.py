"""A diagnosis in sentences: the verdict, what to do, and what limits the result."""

from collections.abc import Iterable
from math import floor, log10
from typing import Any

from wlr_render.diagnosis.diagnosis import (
    EXPLAINED,
    NO_EFFECT,
    PARTLY,
    DegenerateCause,
    Diagnosis,
    FoundCause,
    ParameterValue,
    ResidualSummary,
)
from wlr_render.diagnosis.settings import DEFAULT, Settings
from wlr_render.report.blocks import cell_text
from wlr_render.simulation.bench_file import WRITTEN_FRAME, changed_keys

_REMEDIES = {
    "device": "calibrate and render with the corrected device, or have the headset readjusted",
    "camera": "calibrate the eyeball camera again, or use the corrected bench",
    "stage": "have the stage adjusted, or use the corrected bench, which corrects its readings",
    "target": "enter the target's true shape in bench.toml, or print it anew",
    "tracking": "correct the tracking camera's pose, or use the corrected bench",
    "mount": "check the mount before the next session; the corrected bench describes this one",
    "eye tracking": "calibrate the eye tracking again, or enter the correction",
    "clock": "draw each frame for the later time at which it is seen",
}
"""What to do about a cause, by the part of the bench that it belongs to."""

_TABLES = {"device": "readout", "eye tracking": "eye_tracking"}
"""Table of bench.toml of a part, where its name differs."""

_MEANWHILE = {
    "panel pixels": "Until the cause is found, render with models fitted to the session (calibrate captures): like "
    "this function they absorb what is fixed in the headset.",
}
"""What to do about a residual that no cause explains, by the variables that it depends on."""

RESIDUALS = (
    ("display", "display_rms_px", " px"),
    ("see-through", "see_through_rms_arcmin", "'"),
    ("virtual against real dot", "run_time_rms_arcmin", "'"),
)
"""Of each part: its name, its attribute of `ResidualSummary`, and its unit as it is appended to a number."""


def verdict_sentence(diagnosis: Diagnosis) -> str:
    """The verdict with its numbers, in one sentence."""
    causes, left = diagnosis.causes, diagnosis.unexplained
    if diagnosis.verdict == NO_EFFECT:
        return f"No effect found: the bench as described predicts the session to its noise ({_changes(diagnosis)})."
    named = "; ".join(f"{cause.title} ({cause.name}: {_clearest(cause)})" for cause in causes)
    head = {EXPLAINED: "Explained", PARTLY: "Partly explained"}.get(diagnosis.verdict, "Unexplained")
    sentence = f"{head}: {named or 'no cause in the list explains the residual'}; {_changes(diagnosis)}"
    if left is None:
        return f"{sentence}."
    return (
        f"{sentence}; the {left.part} residual is still {cell_text(left.rms_over_noise)} times the noise and depends "
        f"on {left.depends_on}."
    )


def advice(diagnosis: Diagnosis, settings: Settings = DEFAULT) -> list[str]:
    """What to do next, most urgent first; each a sentence."""
    if diagnosis.verdict == NO_EFFECT:
        return ["Keep using the bench file; effects below the detection limits would not have been seen."]
    steps = [_before_acting(cause, other) for cause in diagnosis.causes for other in _undecided(cause, settings)]
    values = changed_keys(diagnosis.observations.nominal, diagnosis.corrected)
    for cause in diagnosis.causes:
        step = f"{_capital(cause.title)}: {cause.remedy or _REMEDIES[cause.part]}."
        keys = values.get(_TABLES.get(cause.part, cause.part), {})
        steps.append(f"{step} In bench.toml: {toml_line(cause.part, keys)}." if keys else step)
    left = diagnosis.unexplained
    if left is not None:
        steps.append(
            f"Look for an effect in the {left.part} part that depends on {left.depends_on} and is not in the list of "
            "causes."
        )
        best = max((correction.improvement.percent for correction in left.corrections), default=0.0)
        if best > 0:
            steps.append(
                f"A smooth function of {left.depends_on} reduces the residual of held-out captures by {best:.0f} %. "
                + _MEANWHILE.get(left.depends_on, "It is no cause; calibrate when the effect is gone.")
            )
    if diagnosis.excluded:
        names = ", ".join(str(moved.capture) for moved in diagnosis.excluded)
        steps.append(f"Take again, or leave out: {names}.")
    return steps


def toml_line(part: str, keys: dict[str, Any]) -> str:
    """Keys of one table of bench.toml as they are typed, e.g. "[target] scale = [0.99696, 0.99692]"."""
    typed = ", ".join(f"{key} = {_rounded(value)}" for key, value in keys.items())
    return f"[{_TABLES.get(part, part)}] {typed}"


def values_to_type(diagnosis: Diagnosis) -> list[str]:
    """Lines that make the bench file describe the corrected bench, all but changes of the device's prescription."""
    values = changed_keys(diagnosis.observations.nominal, diagnosis.corrected)
    return [toml_line(table, keys) for table, keys in values.items()]


FRAME_NOTE = f'Vectors and rotations are in frame = "{WRITTEN_FRAME}".'


def warnings(diagnosis: Diagnosis, settings: Settings = DEFAULT) -> list[str]:
    """What limits the result; each a sentence."""
    found = [
        f"The stated noise of the {noise.part} readings, {cell_text(noise.stated_px)} px, is wrong: they scatter by "
        f"{cell_text(noise.measured_px)} +- {cell_text(noise.error_px)} px, which is used instead."
        for noise in diagnosis.noise_floors
        if not noise.is_believable
    ]
    found += [_confusable(cause, settings) for cause in diagnosis.causes if cause.degenerate]
    found += [
        f"{cause.name}: {value_text(parameter)} is {abs(parameter.value) / parameter.prior_sigma:.0f} times its usual "
        "size; suspect a cause that is not in the list."
        for cause in diagnosis.causes
        for parameter in cause.parameters
        if parameter.sigma > 0 and abs(parameter.value) > _UNUSUAL * parameter.prior_sigma
    ]
    if diagnosis.correlations.condition > settings.max_condition:
        found.append(
            f"The values found are correlated (condition {diagnosis.correlations.condition:.0g}): several sets of them "
            "fit nearly as well, and each error bar holds with the others free."
        )
    if diagnosis.excluded:
        found.append(f"Captures that moved were excluded ({len(diagnosis.excluded)}) from all numbers.")
    return found


_UNUSUAL = 5.0  # prior sigmas


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
    """The value with the largest ratio to its error, and how many others there are."""
    known = [parameter for parameter in cause.parameters if parameter.sigma > 0] or list(cause.parameters)
    best = max(known, key=lambda parameter: abs(parameter.value) / (parameter.sigma or 1.0))
    others = len(cause.parameters) - 1
    return value_text(best) + (f" and {others} more value{'s' * (others > 1)}" if others else "")


def _undecided(cause: FoundCause, settings: Settings) -> list[DegenerateCause]:
    """Degenerate causes between which and the cause the session does not decide."""
    close = {each.name for each in cause.ranking if each.log10_odds < settings.decisive_odds}
    return [other for other in cause.degenerate if other.name in close]


def _before_acting(cause: FoundCause, other: DegenerateCause) -> str:
    return (
        f"Before acting on {cause.name}, separate it from {other.name}, which explains this session nearly as well: "
        f"{other.separated_by}."
    )


def _confusable(cause: FoundCause, settings: Settings) -> str:
    names = ", ".join(f"{other.name} (cosine {other.cosine:.3f})" for other in cause.degenerate)
    nearest = cause.degenerate[0]
    decided = "does not decide" if _undecided(cause, settings) else "decides for it"
    return (
        f"{cause.name} is nearly degenerate with {names}. The session {decided}. To separate it from {nearest.name}: "
        f"{nearest.separated_by}."
    )


def _changes(diagnosis: Diagnosis) -> str:
    """Residual and noise of each part that the causes change; of all parts where none does."""
    rows = [
        (
            name,
            *(_with_unit(summary, attribute, unit) for summary in (diagnosis.before, diagnosis.after, diagnosis.noise)),
        )
        for name, attribute, unit in RESIDUALS
        if getattr(diagnosis.before, attribute) is not None
    ]
    changed = [row for row in rows if row[1] != row[2]]
    texts = [f"{name} residual {before} -> {after}, noise {noise}" for name, before, after, noise in changed]
    return "; ".join(texts or [f"{name} residual {before}, noise {noise}" for name, before, _, noise in rows])


def _with_unit(summary: ResidualSummary, attribute: str, unit: str) -> str:
    return cell_text(getattr(summary, attribute)) + unit


def _rounded(value: Any) -> str:
    if isinstance(value, Iterable) and not isinstance(value, str):
        return f"[{', '.join(_rounded(each) for each in value)}]"
    return f"{value:.7g}"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]

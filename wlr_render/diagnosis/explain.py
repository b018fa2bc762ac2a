"""A diagnosis in sentences: the verdict, what to do, and what limits the result."""

from collections import Counter
from collections.abc import Iterable
from math import floor, log10
from typing import Any

from wlr_render.diagnosis.diagnosis import (
    EXPLAINED,
    NO_EFFECT,
    PARTLY,
    Correction,
    DegenerateCause,
    Diagnosis,
    FoundCause,
    ParameterValue,
    ResidualSummary,
    Unexplained,
)
from wlr_render.diagnosis.noise_sentences import with_error
from wlr_render.diagnosis.observations import PART_NAMES, RUN_TIME
from wlr_render.diagnosis.outliers import MovedCapture
from wlr_render.diagnosis.scatter import FEWEST_TO_STAND_OUT, USUAL_SHIFT, USUAL_TURN
from wlr_render.diagnosis.search import times_between_captures
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
    causes, left, moved = diagnosis.causes, diagnosis.unexplained, diagnosis.too_many_moved
    if diagnosis.verdict == NO_EFFECT:
        return "No effect found: the bench as described predicts the session to its noise and repeatability."
    named = "; ".join(f"{cause.title} ({cause.name}: {_clearest(cause)})" for cause in causes)
    head = {EXPLAINED: "Explained", PARTLY: "Partly explained"}.get(diagnosis.verdict, "Unexplained")
    nothing = (
        "no cause in the list explains the residual" if left or not moved else "the captures contradict each other"
    )
    sentence = f"{head}: {named or nothing}; {_changes(diagnosis)}"
    if left is not None:
        sentence += f"; {_left_over(left)}"
    if moved:
        sentence += (
            f"; {len(moved)} of {_captures_beside(diagnosis, moved)} captures stand out, too many to tell which "
            "of them moved"
        )
    return f"{sentence}."


def _left_over(left: Unexplained) -> str:
    """What no cause explains, as the end of a sentence."""
    size = f"the {left.part} residual is still {cell_text(left.rms_over_noise)} times the noise"
    best = _smooth_match(left)
    if best is None:
        return f"{size} and follows no smooth function that was tried"
    return f"{size} and depends on {best.depends_on} (log10 odds {odds_text(best.log10_odds)})"


def _smooth_match(left: Unexplained, settings: Settings = DEFAULT) -> Correction | None:
    """The smooth function of best odds; None where none has good odds."""
    best = max(left.corrections, key=lambda each: each.log10_odds, default=None)
    return best if best is not None and best.log10_odds > settings.least_log10_odds else None


def _captures_beside(diagnosis: Diagnosis, moved: Iterable[MovedCapture]) -> int:
    """How many captures the parts of some captures have."""
    parts = {each.capture.part for each in moved}
    return sum(name.part in parts for name in diagnosis.readings.observations.captures)


def advice(diagnosis: Diagnosis, settings: Settings = DEFAULT) -> list[str]:
    """What to do next, most urgent first; each a sentence."""
    if diagnosis.verdict == NO_EFFECT:
        return ["Keep using the bench file; effects below the detection limits would not have been seen."]
    steps = [_before_acting(cause, other) for cause in diagnosis.causes for other in _undecided(cause, settings)]
    steps += _remedies(diagnosis)
    left = diagnosis.unexplained
    if left is not None:
        best = _smooth_match(left, settings)
        dependence = f" that depends on {best.depends_on} and is not in the list of causes" if best else ""
        steps.append(
            f"Look for an effect in the {left.part} part{dependence}."
            if best
            else f"Look for what differs from one capture of the {left.part} part to the next."
        )
        if best is not None and best.improvement.percent > 0:
            steps.append(
                f"A smooth function of {best.depends_on} reduces the residual of held-out captures by "
                f"{best.improvement.percent:.0f} %. "
                + _MEANWHILE.get(best.depends_on, "It is no cause; calibrate when the effect is gone.")
            )
    if diagnosis.too_many_moved:
        names = ", ".join(str(moved.capture) for moved in diagnosis.too_many_moved)
        steps.append(
            "Check that the headset and the camera sit firmly, and take the session again. These captures stand out "
            f"from the others of their part, and none of them was excluded: {names}."
        )
    if diagnosis.excluded:
        names = ", ".join(str(moved.capture) for moved in diagnosis.excluded)
        steps.append(f"Take again, or leave out: {names}.")
    return steps


def _remedies(diagnosis: Diagnosis) -> list[str]:
    """What to do about each cause, with what to type for all causes of its part together."""
    steps, values = [], changed_keys(diagnosis.observations.nominal, diagnosis.corrected)
    for cause in diagnosis.causes:
        step = f"{_capital(cause.title)}: {cause.remedy or _REMEDIES[cause.part]}."
        together = [other.name for other in diagnosis.causes if other.part == cause.part]
        keys = values.get(_TABLES.get(cause.part, cause.part), {}) if together[0] == cause.name else {}
        if keys:
            both = f" ({' and '.join(together)} together)" if len(together) > 1 else ""
            step += f" In bench.toml{both}: {toml_line(cause.part, keys)}."
        elif cause.part == "device":
            step += " The corrected device is device.toml in the corrected session."
        steps.append(step)
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
    wrong = [
        f"{noise.part} {noise.stated_px:#.3g} px stated, {with_error(noise.measured_px, noise.error_px)} px measured"
        for noise in diagnosis.noise_floors
        if not noise.is_believable
    ]
    found = [f"The stated noise is wrong, and the measured noise is used: {'; '.join(wrong)}."] if wrong else []
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
    return [*found, *_too_few(diagnosis)]


def _too_few(diagnosis: Diagnosis) -> list[str]:
    """What cannot be told of parts with few captures, and what would be needed."""
    observations, found = diagnosis.readings.observations, []
    counts = Counter(name.part for name in observations.captures)
    for part, count in sorted(counts.items()):
        if count >= FEWEST_TO_STAND_OUT or part == RUN_TIME:
            continue
        cannot = "which of them moved cannot be told, and how far captures repeat is hardly known"
        if count == 1:
            cannot = (
                f"how far captures repeat cannot be told, and what is usual is assumed (about {USUAL_SHIFT:.0f} um and "
                f"{USUAL_TURN:.0f} urad); an error of the camera's place in it looks like a cause"
            )
        found.append(
            f"The {PART_NAMES[part]} part has {count} capture{'s' * (count > 1)}: {cannot}. {ENOUGH_CAPTURES} or more "
            "captures of the part from different places are needed."
        )
    times = len({float(t) for part in observations.session.plan.parts if part is not None for t in part.time_s})
    if times > 1 and not len(times_between_captures(observations.session.plan)):
        found.append(
            f"Only {times} captures differ in time: a slip, or another cause with a moment, cannot be told from a "
            "capture that moved. Two captures on either side of the moment are needed."
        )
    return found


ENOUGH_CAPTURES = 6
"""Captures of a part from which its repeatability and the captures that moved are known well enough to be useful."""


_UNUSUAL = 5.0  # prior sigmas


def odds_text(log10_odds: float) -> str:
    """Log10 odds, capped where the number says no more."""
    return f"> {_CERTAIN:.0f}" if log10_odds > _CERTAIN else f"{log10_odds:.1f}"


_CERTAIN = 20.0  # log10 odds


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
    odds = next(each.log10_odds for each in cause.ranking if each.name == other.name)
    return (
        f"Before acting on {cause.name}, separate it from {other.name}, which explains this session nearly as well "
        f"(log10 odds against it {odds_text(odds)}): {other.separated_by}."
    )


def _confusable(cause: FoundCause, settings: Settings) -> str:
    names = ", ".join(f"{other.name} (cosine {other.cosine:.3f})" for other in cause.degenerate)
    undecided = _undecided(cause, settings)
    if not undecided:
        return f"{cause.name} is nearly degenerate with {names}. The session decides for it."
    doubtful = "; ".join(f"from {other.name}: {other.separated_by}" for other in undecided)
    return f"{cause.name} is nearly degenerate with {names}. The session does not decide. To separate it {doubtful}."


def _changes(diagnosis: Diagnosis) -> str:
    """Residual of each part that the causes change, beside what noise and motions give; of all parts if none does."""
    rows = [
        (
            name,
            *(
                _with_unit(summary, attribute, unit)
                for summary in (diagnosis.before, diagnosis.after, diagnosis.expected)
            ),
        )
        for name, attribute, unit in RESIDUALS
        if getattr(diagnosis.before, attribute) is not None
    ]
    changed = [row for row in rows if row[1] != row[2]]
    texts = [f"{name} residual {before} -> {after}, expected {usual}" for name, before, after, usual in changed]
    return "; ".join(texts or [f"{name} residual {before}, expected {usual}" for name, before, _, usual in rows])


def _with_unit(summary: ResidualSummary, attribute: str, unit: str) -> str:
    return cell_text(getattr(summary, attribute)) + unit


def _rounded(value: Any) -> str:
    if isinstance(value, Iterable) and not isinstance(value, str):
        return f"[{', '.join(_rounded(each) for each in value)}]"
    return f"{value:.7g}"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]

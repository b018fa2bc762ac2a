"""A diagnosis in sentences: the verdict and the advice."""

from collections.abc import Iterable, Mapping
from contextlib import suppress
from math import floor, log10
from typing import Any

import numpy as np

from wlr_render.bench.bench_file import WRITTEN_FRAME, changed_keys
from wlr_render.diagnosis.diagnosis import (
    EXPLAINED,
    LOCATED,
    NO_EFFECT,
    PARTLY,
    DegenerateCause,
    Diagnosis,
    FoundCause,
    ParameterValue,
    ResidualSummary,
    StationEffect,
    Unexplained,
)
from wlr_render.diagnosis.effect_findings import SEPARATED_BY
from wlr_render.diagnosis.noise_sentences import undetermined_parts
from wlr_render.diagnosis.outliers import MovedCapture
from wlr_render.diagnosis.settings import Settings
from wlr_render.errors import BadInputError
from wlr_render.report.blocks import cell_text

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
"""Remedies of a cause, by the part of the bench that it belongs to."""

_TABLES = {"device": "readout", "eye tracking": "eye_tracking"}
"""Table of bench.toml of a part, where its name differs."""

RESIDUALS = (
    ("display", "display", "display_rms_px", " panel px"),
    ("see-through", "see-through", "see_through_rms_arcmin", "'"),
    ("run-time", "virtual against real dot", "run_time_rms_arcmin", "'"),
)
"""Each part, the name of its residual, the attribute of `ResidualSummary`, and the unit to append to a number."""


def verdict_sentence(diagnosis: Diagnosis) -> str:
    """The verdict and its causes in one sentence, then the residuals and what is left of them."""
    causes, left, moved = diagnosis.causes, diagnosis.unexplained, diagnosis.too_many_moved
    if diagnosis.verdict == NO_EFFECT:
        floors = [floor for floor in diagnosis.noise_floors if floor.measured_px > 0.0]  # NaN where not measured
        noise = max((floor.measured_px / floor.stated_px for floor in floors), default=1.0)
        found = "No effect found: the bench as described predicts the session to its noise and repeatability"
        if noise > _MUCH_NOISE:
            found = f"No effect found, but the readings are {cell_text(noise)} times as noisy as the bench states"
        return f"{found}. {_capital(_changes(diagnosis))}."
    named = "; ".join(f"{cause.title} ({cause.name}: {_clearest(cause)})" for cause in causes)
    head = {EXPLAINED: "Explained", PARTLY: "Partly explained", LOCATED: "Effect located"}.get(
        diagnosis.verdict, "Unexplained"
    )
    named = "; ".join([each for each in (named,) if each] + [effect_sentence(each) for each in diagnosis.effects])
    nothing = (
        "no cause, and no effect at any station, explains the residual"
        if left or not moved
        else "the captures contradict each other"
    )
    sentences = [f"{head}: {named or nothing}", _capital(_changes(diagnosis))]
    if left is not None:
        sentences.append(_capital(_left_over(diagnosis, left)))
    elif diagnosis.verdict == PARTLY and not diagnosis.effects and not moved:
        sentences.append("The readings have structure that no cause and no field describes")
    elif diagnosis.verdict == PARTLY and not moved:
        sentences.append(
            "The effects remove less than half of the excess of captures left out: motions of the captures may hide "
            "the rest"
        )
    if moved:
        sentences.append(
            f"{len(moved)} of {_captures_beside(diagnosis, moved)} captures stand out, too many to tell which "
            "of them moved"
        )
    return f"{'. '.join(sentences)}."


def times_the_noise(diagnosis: Diagnosis, part: str) -> float:
    """Residual of a part with the causes found, over the residual that noise alone gives."""
    attribute = next(attribute for name, _, attribute, _ in RESIDUALS if name == part)
    return float(getattr(diagnosis.after, attribute) / getattr(diagnosis.noise, attribute))


def effect_sentence(effect: StationEffect) -> str:
    """What acts where, and how large it is."""
    if effect.form == "smooth":
        what = (
            f"{effect.displaced}, a smooth function of {effect.coordinates}, {cell_text(effect.size)} {effect.unit} rms"
        )
    elif effect.place is None or effect.length is None:
        what = f"a fine pattern, {cell_text(effect.size)} times the noise"
    else:
        place, unit = ", ".join(f"{each:.3g}" for each in effect.place), effect.length_unit
        what = f"a spot {cell_text(effect.length)} {unit} wide at ({place}) {unit}"
    odds = f"log10 odds {odds_text(effect.log10_odds)}"
    sentence = f"an effect {_WHERE[effect.station]} that no listed cause has: {what} ({odds})"
    if _is_ambiguous(effect):
        sentence += f"; the session hardly tells it from an effect {_WHERE[effect.next_station]}"
    return sentence


def _is_ambiguous(effect: StationEffect) -> bool:
    return bool(effect.next_station) and effect.odds_against_next_station < _DECIDED


_MUCH_NOISE = 1.5  # times the stated one, from which "to its noise" would mislead
_DECIDED = 2.0  # log10 odds against another station from which the session tells them apart
_WHERE = {
    "panel": "on the panel",
    "combiner": "on the combiner",
    "camera": "in the camera",
    "target": "on the target",
    "stage": "of the stage",
    "time": "in the course of the session",
    "head motion": "of the head's motion",
    "eye tracking": "of the eye tracking",
}
"""Stations as they stand in a sentence."""


def _left_over(diagnosis: Diagnosis, left: Unexplained) -> str:
    """The sentence on the residual that neither causes nor effects explain."""
    times = cell_text(times_the_noise(diagnosis, left.part))
    still = "still " if diagnosis.causes or diagnosis.effects else ""
    return f"the {left.part} residual is {still}{times} times the noise, and no field at any station explains the rest"


def _captures_beside(diagnosis: Diagnosis, moved: Iterable[MovedCapture]) -> int:
    """How many captures the parts of some captures have."""
    parts = {each.capture.part for each in moved}
    return sum(name.part in parts for name in diagnosis.readings.observations.captures)


def advice(diagnosis: Diagnosis) -> list[str]:
    """Next steps, most urgent first; each a sentence."""
    if diagnosis.verdict == NO_EFFECT:
        return ["Keep using the bench file; effects below the detection limits would not have been seen."]
    left, settings = diagnosis.unexplained, diagnosis.settings
    steps = [_before_acting(cause, other) for cause in diagnosis.causes for other in undecided(cause, settings)]
    steps += _remedies(diagnosis)
    steps += [step for effect in diagnosis.effects for step in _about_effect(effect)]
    if left is not None:
        steps.append(f"Look for what differs from one capture of the {left.part} part to the next.")
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


def _about_effect(effect: StationEffect) -> list[str]:
    """What to look for, what to measure, and what the effect's correction is worth."""
    where, gain = _WHERE[effect.station], effect.held_out_improvement.percent
    worth = "A correction by the other captures does not improve captures left out."
    if gain > 0.0:
        share = 100 * min(max(effect.share_of_excess_removed, 0.0), 1.0)
        worth = (
            f"Its correction takes {gain:.0f} % off the residual of captures left out, {share:.0f} % of their excess "
            "over noise."
        )
    in_bench = " The corrected session's bench.toml has it as an [[effect]]." if effect.is_in_bench else ""
    likely = " or ".join(effect.likely)
    steps = [f"Effects {where} of this kind often come from {likely}: look for that first. {worth}{in_bench}"]
    if _is_ambiguous(effect):
        apart = [SEPARATED_BY[each] for each in (effect.station, effect.next_station) if each in SEPARATED_BY]
        steps.append(f"To tell the {effect.station} from the {effect.next_station}: {'; or '.join(apart)}.")
    if effect.station in ("panel", "combiner"):
        steps.append(
            "Until it is found, render with models fitted to the session (`calibrate`): they absorb what is fixed in "
            "the headset."
        )
    return steps


def _remedies(diagnosis: Diagnosis) -> list[str]:
    """One sentence for each remedy, naming the causes that it is for; with the values to type for each part."""
    values = _typed_keys(diagnosis)
    titles: dict[tuple[str, str], list[str]] = {}
    for cause in diagnosis.causes:
        titles.setdefault((cause.part, cause.remedy or _REMEDIES[cause.part]), []).append(cause.title)
    steps, parts = [], [part for part, _ in titles]
    for number, ((part, remedy), named) in enumerate(titles.items()):
        step = f"{_capital(' and '.join(named))}: {remedy}."
        table = _TABLES.get(part, part)
        keys = values.get(table, {}) if part not in parts[:number] else {}
        matrices = [key for key, typed in keys.items() if typed.startswith(_MATRIX)]
        line = toml_line(table, {key: typed for key, typed in keys.items() if key not in matrices})
        if keys:
            together = [cause.name for cause in diagnosis.causes if cause.part == part]
            both = f" ({' and '.join(together)} together)" if parts.count(part) > 1 else ""
            step += f" In bench.toml{both}: {line}." if len(matrices) < len(keys) else ""
            step += (
                f" The corrected session's bench.toml has {' and '.join(matrices)} of [{table}]." if matrices else ""
            )
        elif part == "device" and diagnosis.corrected.device is not diagnosis.observations.nominal.device:
            step += " The corrected device is device.toml in the corrected session."
        steps.append(step)
    return steps


_MATRIX = "[["  # what is typed of a list of lists: too long for a sentence


def toml_line(table: str, keys: Mapping[str, str]) -> str:
    """Keys of one table of bench.toml as they are typed, e.g. "[target] scale = [0.99696, 0.99692]"."""
    return f"[{table}] {', '.join(f'{key} = {typed}' for key, typed in keys.items())}"


def values_to_type(diagnosis: Diagnosis) -> list[str]:
    """Lines that make the bench file describe the corrected bench, all but changes of the device's prescription."""
    return [toml_line(table, keys) for table, keys in _typed_keys(diagnosis).items()]


def _typed_keys(diagnosis: Diagnosis) -> dict[str, dict[str, str]]:
    """The keys of the bench file that the causes change, by table, each number to two digits of its error.

    The error is that with the other values as found: of correlated values, it is what the readings allow one to round.
    """
    nominal, found = diagnosis.observations.nominal, diagnosis.fit
    values = changed_keys(nominal, diagnosis.corrected)
    prior_sigma = np.array([parameter.prior_sigma for parameter in found.explanation.parameters()])[found.at.free]
    steps = prior_sigma / np.sqrt(np.diag(found.information))
    moved = [_keys_beside(diagnosis, *each) for each in zip(found.at.free, steps, strict=True)]

    def typed(table: str, key: str, value: Any) -> str:
        off = [np.subtract(each.get(table, {}).get(key, value), value) for each in moved]
        # A matrix of a rotation is one only with all its digits.
        sigma = np.zeros(np.shape(value)) if key == "rotation" else np.sqrt(np.sum(np.square(off), axis=0))
        return _typed(value, sigma + np.zeros(np.shape(value)))

    return {table: {key: typed(table, key, value) for key, value in keys.items()} for table, keys in values.items()}


def _keys_beside(diagnosis: Diagnosis, free: int, step: float) -> dict[str, dict[str, Any]]:
    """The changed keys with one value a step higher, or lower where its cause fails there; none if it fails at both."""
    nominal, explanation = diagnosis.observations.nominal, diagnosis.fit.explanation
    for by in (step, -step):
        vector = explanation.vector()
        vector[free] += by
        with suppress(BadInputError):
            return changed_keys(nominal, explanation.at(vector).bench(nominal))
    return {}


AXES_NOTE = (
    "Parameters are in OpenXR axes (x right, y up, z towards the wearer), whatever `frame` the bench file states."
)
FRAME_NOTE = f'Vectors and rotations are in frame = "{WRITTEN_FRAME}".'


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
    decimals = _decimals(parameter.sigma)
    return f"{parameter.value:.{decimals}f}", f"{parameter.sigma:.{decimals}f}"


def _clearest(cause: FoundCause) -> str:
    """The value with the largest ratio to its error, and how many others differ clearly from zero."""
    known = [parameter for parameter in cause.parameters if parameter.sigma > 0] or list(cause.parameters)
    best = max(known, key=lambda parameter: abs(parameter.value) / (parameter.sigma or 1.0))
    others = sum(abs(each.value) > _CLEAR * each.sigma > 0 for each in cause.parameters if each is not best)
    return value_text(best) + (f" and {others} more value{'s' * (others > 1)}" if others else "")


_CLEAR = 3.0  # standard errors from which the verdict counts a value


def undecided(cause: FoundCause, settings: Settings) -> list[DegenerateCause]:
    """Degenerate causes between which and the cause the session does not decide."""
    close = {each.name for each in cause.ranking if each.log10_odds < settings.decisive_odds}
    return [other for other in cause.degenerate if other.name in close]


def _before_acting(cause: FoundCause, other: DegenerateCause) -> str:
    odds = next(each.log10_odds for each in cause.ranking if each.name == other.name)
    return (
        f"Before acting on {cause.name}, separate it from {other.name}, which explains this session nearly as well "
        f"(log10 odds against it {odds_text(odds)}): {other.separated_by}."
    )


def _changes(diagnosis: Diagnosis) -> str:
    """Residual of each part that the causes change, beside what noise and motions give; of all parts if none does."""
    unknown = undetermined_parts(diagnosis)
    rows = [
        (
            name,
            *(_with_unit(summary, attribute, unit) for summary in (diagnosis.before, diagnosis.after)),
            "" if part in unknown else f", expected {_with_unit(diagnosis.expected, attribute, unit)}",
        )
        for part, name, attribute, unit in RESIDUALS
        if getattr(diagnosis.before, attribute) is not None
    ]
    changed = [row for row in rows if row[1] != row[2]]
    texts = [f"{name} residual {before} -> {after}{usual}" for name, before, after, usual in changed]
    return "; ".join(texts or [f"{name} residual {before}{usual}" for name, before, _, usual in rows])


def _with_unit(summary: ResidualSummary, attribute: str, unit: str) -> str:
    return cell_text(getattr(summary, attribute)) + unit


def _typed(value: Any, sigma: Any) -> str:
    """A number, or lists of numbers, to two digits of the standard error; to seven where there is none."""
    if np.ndim(value):
        return f"[{', '.join(_typed(*each) for each in zip(value, sigma, strict=True))}]"
    if not 0 < sigma < float("inf"):
        return f"{value:.7g}"
    decimals = _decimals(float(sigma))
    return f"{round(float(value), decimals) + 0.0:.{decimals}f}"  # + 0.0 turns -0.0 into 0.0


def _decimals(sigma: float) -> int:
    """Decimal places that show two digits of a standard error."""
    return max(0, 1 - floor(log10(sigma)))


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]

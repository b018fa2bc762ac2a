"""Sentences of a diagnosis: the verdict, the noise and repeatability, the advice, and the values for the bench file."""

from contextlib import suppress
from math import exp, expm1, isfinite
from typing import Any

import numpy as np

from wlr_render.bench.bench_file import WRITTEN_FRAME, changed_keys
from wlr_render.diagnosis.diagnosis import (
    NO_EFFECT,
    PARTLY,
    DegenerateCause,
    DiagnosisRecord,
    FoundCause,
    MotionSize,
    ParameterValue,
    StationEffect,
)
from wlr_render.diagnosis.effect_findings import STATIONS
from wlr_render.diagnosis.noise import NoiseFloor
from wlr_render.diagnosis.observations import PART_NAMES, RUN_TIME
from wlr_render.diagnosis.settings import Settings
from wlr_render.errors import BadInputError
from wlr_render.numerics.scatter import UNUSUAL_SHIFT, UNUSUAL_TURN
from wlr_render.report.blocks import Estimate, capitalised, cell_text, decimals

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

RESIDUALS = {
    "display": ("display", "display_rms_px", " panel px"),
    "see-through": ("see-through", "see_through_rms_arcmin", "'"),
    "run-time": ("virtual against real dot", "run_time_rms_arcmin", "'"),
}
"""Name of the residual of each part, the attribute of `ResidualSummary`, and the unit to append to a number."""

_MUCH_NOISE = 1.5  # ratio of measured to stated noise beyond which "to its noise" would mislead
_DECIDED = 2.0  # least log10 odds against another station at which the session decides between the two
_CLEAR = 3.0  # standard errors beyond which the verdict counts a value
_UNSURE = 0.5  # relative error of a size beyond which only an upper limit is stated
_ABOUT_HALF = 0.05  # difference of a share from one half below which it is called half
_AS_STATED = 0.02  # relative difference of the noise below which it is called as stated
CERTAIN = 20.0  # log10 odds beyond which the exact number does not matter
_MATRIX = "[["  # start of a typed list of lists, which is too long for a sentence

AXES_NOTE = (
    "Parameters are in OpenXR axes (x right, y up, z towards the wearer), whatever 'frame' the bench file states."
)
FRAME_NOTE = f'Vectors and rotations are in frame = "{WRITTEN_FRAME}".'


def verdict_sentence(diagnosis: DiagnosisRecord) -> str:
    """Return the verdict with its causes and effects, the residuals, and any unexplained remainder."""
    noise = _larger_noise(diagnosis)
    if diagnosis.verdict == NO_EFFECT:
        to_its_noise = ": the bench as described predicts the session to its noise and repeatability"
        return f"No effect found{f', but {noise}' if noise else to_its_noise}. {capitalised(_changes(diagnosis))}."
    named = [f"{cause.title} ({cause.name}: {_clearest(cause)})" for cause in diagnosis.causes]
    named += [effect_sentence(effect) for effect in diagnosis.effects]
    if not named and diagnosis.too_many_moved and not diagnosis.unexplained_parts:
        named = ["the captures contradict each other"]
    named = named or ["no cause, and no effect at any station, explains the residual"]
    sentences = [f"{diagnosis.verdict}: {'; '.join(named)}", *filter(None, [noise])]
    return " ".join(f"{capitalised(each)}." for each in (*sentences, _changes(diagnosis), *_left_over(diagnosis)))


def _larger_noise(diagnosis: DiagnosisRecord) -> str:
    """Return a clause on noise that is much larger than stated; empty if it is not, or if it was not measured."""
    floors = {floor.part: floor.measured_px / floor.stated_px for floor in diagnosis.noise_floors}
    noise = {part: ratio for part, ratio in floors.items() if ratio > _MUCH_NOISE}  # NaN where not measured
    if not noise:
        return ""
    parts = " and ".join(f"the {part} readings are {cell_text(ratio)} times" for part, ratio in noise.items())
    said = f"{parts} as noisy as the bench states"
    if PART_NAMES[RUN_TIME] in noise:
        said += " (at run time, by anything that changes from one reading to the next, as the eye tracker's jitter)"
    return said


def _left_over(diagnosis: DiagnosisRecord) -> list[str]:
    """Return sentences on the residual that neither causes nor effects explain, and on captures that stand out."""
    left, moved, sentences = diagnosis.unexplained_parts, diagnosis.too_many_moved, list[str]()
    if left:
        still = "still " if diagnosis.causes or diagnosis.effects else ""
        worst_first = " and ".join(
            f"the {each.part} residual is {still}{cell_text(_times_the_noise(diagnosis, each.part))} times the noise"
            for each in left
        )
        sentences.append(f"{worst_first}, and no field at any station explains the rest")
    elif diagnosis.verdict == PARTLY and not moved:
        sentences.append(
            "the effects remove less than half of the excess of captures left out: motions of the captures may hide "
            "the rest"
            if diagnosis.effects
            else "the readings have structure that no cause and no field describes"
        )
    if moved:
        parts = {each.capture.part for each in moved}
        count = sum(name.part in parts for name in diagnosis.readings.observations.captures)
        sentences.append(f"{len(moved)} of {count} captures stand out, too many to tell which of them moved")
    return sentences


def _times_the_noise(diagnosis: DiagnosisRecord, part: str) -> float:
    """Return the ratio of a part's residual after the correction to the residual expected from noise alone."""
    _, attribute, _ = RESIDUALS[part]
    return float(getattr(diagnosis.after, attribute) / getattr(diagnosis.noise, attribute))


def _changes(diagnosis: DiagnosisRecord) -> str:
    """Return the residual before and after, and its expected level, of each part that changed, or else of all parts."""
    unknown, changed, unchanged = undetermined_parts(diagnosis), list[str](), list[str]()
    for part, (name, attribute, unit) in RESIDUALS.items():
        if getattr(diagnosis.before, attribute) is None:
            continue
        before, after, expected = (
            cell_text(getattr(each, attribute)) + unit
            for each in (diagnosis.before, diagnosis.after, diagnosis.expected)
        )
        usual = "" if part in unknown else f", expected {expected}"
        changed += [f"{name} residual {before} -> {after}{usual}"] if before != after else []
        unchanged.append(f"{name} residual {before}{usual}")
    return "; ".join(changed or unchanged)


def bench_sentence(diagnosis: DiagnosisRecord) -> str:
    """Return the repeatability and the noise of the bench: one sentence for each part of the session."""
    motions, unknown = {motion.part: motion for motion in diagnosis.motions}, undetermined_parts(diagnosis)
    sentences = []
    for floor in diagnosis.noise_floors:
        motion = motions.get(floor.part)
        is_unknown = floor.part in unknown
        figures = [_repeatability(motion)] if motion and not is_unknown else []
        sentences.append(f"{capitalised(floor.part)}: {', '.join([*figures, _level(floor), *_shape(floor)])}.")
        if motion and is_unknown:
            sentences.append(f"Repeatability of the {floor.part} is not determined, as no cause explains its residual.")
    return " ".join(sentences)


def undetermined_parts(diagnosis: DiagnosisRecord) -> set[str]:
    """Return the parts with an unexplained residual.

    The fit attributes that residual to motions of the captures, so that their size is not the repeatability.
    """
    return {each.part for each in diagnosis.unexplained_parts}


def _repeatability(motion: MotionSize) -> str:
    shift = _size(motion.shift_um, motion.shift_error_um, "um", UNUSUAL_SHIFT)
    turn = _size(motion.turn_urad, motion.turn_error_urad, "urad", UNUSUAL_TURN)
    return (
        f"{f'positions repeat to {shift}' if shift else 'repeatability of positions unknown'}, "
        f"{f'turns to {turn}' if turn else 'repeatability of turns unknown'}"
    )


def _size(value: float, error: float, unit: str, unusual: float) -> str:
    """Return a size with its error, or its upper limit where the error is too large; empty if unknown."""
    if error <= _UNSURE * value:
        return str(Estimate(value, error, unit))
    # A size that no reading depends on has an error of many powers of ten.
    limit = value * exp(min(2.0 * error / value, 100.0))
    return "" if limit > unusual else f"better than {cell_text(float(f'{limit:.2g}'))} {unit}"


def _level(noise: NoiseFloor) -> str:
    stated = f"{noise.stated_px:#.3g}"
    if abs(noise.measured_px / noise.stated_px - 1.0) >= _AS_STATED:  # NaN where not measured
        return f"noise {noise.measured_px:#.3g} camera px where {stated} is stated"
    unmeasured = "" if isfinite(noise.measured_px) else " (too few points to measure it)"
    return f"noise {stated} camera px as stated{unmeasured}"


def _shape(noise: NoiseFloor) -> list[str]:
    """Return phrases on how the noise differs between places and photographs, and how much neighbours share."""
    texts = []
    if noise.rim_factor != 1.0:
        trend = "rising" if noise.rim_factor > 1.0 else "falling"
        texts.append(f"{trend} to {noise.rim_factor:.2g} times in the corner of the image")
    if noise.photographs_differ > 0.0:
        texts.append(f"photographs differ in noise by {100 * expm1(noise.photographs_differ):.0f} %")
    if noise.shared > 0.0:
        share = "half" if abs(noise.shared - 0.5) < _ABOUT_HALF else f"{100 * noise.shared:.0f} %"
        reach = f"(within {noise.shared_reach_px:.0f} camera px)"
        texts.append(f"{share} of the noise variance is shared by neighbouring points {reach}")
    return texts


def effect_sentence(effect: StationEffect) -> str:
    """Return the station, the shape, the size and the odds of a located effect."""
    size = Estimate(abs(effect.size), effect.size_sigma, effect.unit)
    if effect.form == "smooth":
        shape = f"{effect.displaced}, a smooth function of {effect.coordinates}, {size} rms"
    elif effect.place is None or effect.length is None:
        shape = f"a fine pattern of {size} rms"
    else:
        noun = "spot" if effect.unit != "um" else "dent" if effect.size < 0.0 else "bump"
        shape = f"a {noun} of {size}, {cell_text(effect.length)} {effect.length_unit} wide, {_place_text(effect)}"
    odds = f"log10 odds {odds_text(effect.log10_odds)}"
    sentence = f"an effect {STATIONS[effect.station][0]} that no listed cause has: {shape} ({odds})"
    if _is_ambiguous(effect):
        sentence += f"; the session hardly tells it from an effect {STATIONS[effect.next_station][0]}"
    return sentence


def _place_text(effect: StationEffect) -> str:
    """Return a phrase for the place of a spot at its station."""
    across, up = effect.place or (0.0, 0.0)
    if effect.station != "combiner":
        return f"at ({across:.3g}, {up:.3g}) {effect.length_unit}"
    sides = "left" if across < 0.0 else "right", "below" if up < 0.0 else "above"
    return f"{abs(across):.2g} mm {sides[0]} of and {abs(up):.2g} mm {sides[1]} the line of sight"


def _is_ambiguous(effect: StationEffect) -> bool:
    return bool(effect.next_station) and effect.odds_against_next_station < _DECIDED


def advice(diagnosis: DiagnosisRecord) -> list[str]:
    """Return the next steps as sentences, most urgent first."""
    if diagnosis.verdict == NO_EFFECT:
        return ["Keep using the bench file; effects below the detection limits would not have been seen."]
    settings = diagnosis.settings
    steps = [_before_acting(cause, other) for cause in diagnosis.causes for other in undecided(cause, settings)]
    steps += [*_remedies(diagnosis), *_corrected_values(diagnosis)]
    clearest = {effect.station: effect for effect in reversed(diagnosis.effects)}
    of_stations = [effect for effect in diagnosis.effects if clearest[effect.station] is effect]
    steps += dict.fromkeys(step for effect in of_stations for step in _about_effect(effect))
    if diagnosis.unexplained_parts:
        parts = " and of the ".join(f"{each.part} part" for each in diagnosis.unexplained_parts)
        steps.append(f"Look for what differs from one capture of the {parts} to the next.")
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


def _before_acting(cause: FoundCause, other: DegenerateCause) -> str:
    odds = next(each.log10_odds for each in cause.ranking if each.name == other.name)
    return (
        f"Before acting on {cause.name}, separate it from {other.name}, which explains this session nearly as well "
        f"(log10 odds against it {odds_text(odds)}): {other.separated_by}."
    )


def _remedies(diagnosis: DiagnosisRecord) -> list[str]:
    """Return one sentence for each remedy, with the causes that need it."""
    titles: dict[str, list[str]] = {}
    for cause in diagnosis.causes:
        titles.setdefault(cause.remedy or _REMEDIES[cause.part], []).append(cause.title)
    return [f"{capitalised(' and '.join(named))}: {remedy}." for remedy, named in titles.items()]


def _corrected_values(diagnosis: DiagnosisRecord) -> list[str]:
    """Return the step that turns bench.toml and device.toml into the corrected bench."""
    lines = values_to_type(diagnosis)
    short = [line for line in lines if _MATRIX not in line]
    long = [line.partition(" = ")[0] for line in lines if _MATRIX in line]
    sentences = [f"In bench.toml: {'; '.join(short)}."] if short else []
    sentences += [f"The corrected session's bench.toml has {' and '.join(long)}."] if long else []
    if diagnosis.corrected.device is not diagnosis.observations.nominal.device:
        sentences.append("The corrected device is device.toml in the corrected session.")
    return [" ".join(sentences)] if sentences else []


def _about_effect(effect: StationEffect) -> list[str]:
    """Return steps: sources to look for, the gain by a correction, and the measurement that separates two stations."""
    where, gain = STATIONS[effect.station][0], effect.held_out_improvement.percent
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
        apart = [STATIONS[each][1] for each in (effect.station, effect.next_station)]
        steps.append(f"To tell the {effect.station} from the {effect.next_station}: {'; or '.join(apart)}.")
    if effect.station in ("panel", "combiner"):
        steps.append(
            "Until it is found, render with models fitted to the session (`calibrate`): they absorb fixed errors of "
            "the headset."
            if effect.form == "smooth"
            else "Models fitted to the session (`calibrate`) are too smooth to follow it: until it is found, pictures "
            "drawn with them have its error at that place, and their predicted error does not contain it."
        )
    return steps


def values_to_type(diagnosis: DiagnosisRecord) -> list[str]:
    """Return the keys of bench.toml that the causes change, e.g. "[target] scale = [0.99696, 0.99692]".

    Each number is rounded to two digits of its error with the other values held fixed: coarser rounding of correlated
    values would spoil the fit. A changed prescription of the headset is not included.
    """
    nominal, fit = diagnosis.observations.nominal, diagnosis.fit
    steps = fit.explanation.prior_sigma[fit.at.free] / np.sqrt(np.diag(fit.information))
    stepped = [_changed_after_step(diagnosis, *each) for each in zip(fit.at.free, steps, strict=True)]
    lines = []
    for table, keys in changed_keys(nominal, diagnosis.corrected).items():
        for key, value in keys.items():
            change = [np.subtract(each.get(table, {}).get(key, value), value) for each in stepped]
            # Rounding would make a rotation matrix non-orthogonal.
            sigma = np.zeros(np.shape(value)) if key == "rotation" else np.sqrt(np.sum(np.square(change), axis=0))
            lines.append(f"[{table}] {key} = {_typed(value, sigma + np.zeros(np.shape(value)))}")
    return lines


def _changed_after_step(diagnosis: DiagnosisRecord, free: int, step: float) -> dict[str, dict[str, Any]]:
    """Return the changed keys with one value a step higher, or lower if its cause fails there; empty if both fail."""
    nominal, explanation = diagnosis.observations.nominal, diagnosis.fit.explanation
    for by in (step, -step):
        vector = explanation.vector()
        vector[free] += by
        with suppress(BadInputError):
            return changed_keys(nominal, explanation.at(vector).bench(nominal))
    return {}


def _typed(value: Any, sigma: Any) -> str:
    """Return a number, or lists of numbers, to two digits of the standard error; without one, to seven digits."""
    if np.ndim(value):
        return f"[{', '.join(_typed(*each) for each in zip(value, sigma, strict=True))}]"
    if not 0 < sigma < float("inf"):
        return f"{value:.7g}"
    places = decimals(float(sigma), 2)
    return f"{round(float(value), places) + 0.0:.{places}f}"  # + 0.0 turns -0.0 into 0.0


def odds_text(log10_odds: float) -> str:
    """Return log10 odds, capped at `CERTAIN`."""
    return f"> {CERTAIN:.0f}" if log10_odds > CERTAIN else f"{log10_odds:.1f}"


def value_text(parameter: ParameterValue) -> str:
    """Return the name, the value with its standard error, and the unit of a parameter."""
    unit = "" if parameter.unit == "1" else parameter.unit
    return f"{parameter.name} {Estimate(parameter.value, parameter.sigma, unit, digits=2)}"


def _clearest(cause: FoundCause) -> str:
    """Return the value with the largest ratio to its error, and the number of others that clearly differ from zero."""
    known = [parameter for parameter in cause.parameters if parameter.sigma > 0] or list(cause.parameters)
    best = max(known, key=lambda parameter: abs(parameter.value) / (parameter.sigma or 1.0))
    others = sum(abs(each.value) > _CLEAR * each.sigma > 0 for each in cause.parameters if each is not best)
    return value_text(best) + (f" and {others} more value{'s' * (others > 1)}" if others else "")


def undecided(cause: FoundCause, settings: Settings) -> list[DegenerateCause]:
    """Return the degenerate causes that the session does not distinguish from the cause."""
    close = {each.name for each in cause.ranking if each.log10_odds < settings.decisive_odds}
    return [other for other in cause.degenerate if other.name in close]

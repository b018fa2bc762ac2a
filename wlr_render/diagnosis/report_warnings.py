"""Warnings of a diagnosis: limits of the result, in sentences."""

from collections import Counter

import numpy as np

from wlr_render.diagnosis.diagnosis import DiagnosisRecord, FoundCause, ParameterValue
from wlr_render.diagnosis.fit import times_between_captures
from wlr_render.diagnosis.observations import PART_NAMES, RUN_TIME
from wlr_render.diagnosis.settings import Settings
from wlr_render.diagnosis.verdict_sentences import undecided, undetermined_parts, value_text
from wlr_render.numerics.scatter import USUAL_SHIFT, USUAL_TURN
from wlr_render.numerics.scatter_search import FEWEST_TO_STAND_OUT
from wlr_render.report.blocks import cell_text

_SAME_STATED = 1e-3  # relative difference of two stated sigmas that is due to rounding
_NEARLY_ONE = 1.1  # ratio of the parts' noise up to which one number serves for both
ENOUGH_CAPTURES = 6
"""Fewest captures of a part that show its repeatability and its moved captures well enough to be useful."""
_UNUSUAL = 5.0  # distance of a value from its prior mean, in prior sigmas, beyond which it is unusual
_ORDINARY_UM, _ORDINARY_URAD = 30.0, 100.0
"""Repeatability per axis of an ordinary stage: four usual sizes, 1.1 sigmas of their logarithms."""
_DIFFER, _TWICE = 3.0, 2.0  # standard errors and ratio beyond which two parts' repeatabilities differ


def warnings(diagnosis: DiagnosisRecord) -> list[str]:
    """Return the limits of the result as sentences."""
    found, settings = _noise_to_state(diagnosis), diagnosis.settings
    found += [_confusable(cause, settings) for cause in diagnosis.causes if cause.degenerate]
    for cause in diagnosis.causes:
        for parameter in cause.parameters:
            stated = stated_prior(diagnosis, cause, parameter)
            mean, sigma = stated or (parameter.prior_mean, parameter.prior_sigma)
            off = abs(parameter.value - mean) / sigma
            if parameter.sigma > 0 and off > _UNUSUAL:
                unlike = f"{off:.0f} times its usual size; suspect"
                if stated:
                    prior = f"the prior in bench.toml ([{mean:g}, {sigma:g}]); check that prior"
                    unlike = f"{off:.0f} sigma from {prior}, or suspect"
                found.append(f"{cause.name}: {value_text(parameter)} is {unlike} a cause that is not in the list.")
    if diagnosis.correlations.condition > settings.max_condition:
        found.append(
            f"The values found are correlated (condition {diagnosis.correlations.condition:.0g}): several sets of them "
            "fit nearly as well, and each error bar holds with the others free."
        )
    if diagnosis.excluded:
        found.append(f"Captures that moved were excluded ({len(diagnosis.excluded)}) from all numbers.")
    return [*found, *_about_repeatability(diagnosis), *_too_few(diagnosis)]


def _about_repeatability(diagnosis: DiagnosisRecord) -> list[str]:
    """Return warnings of a repeatability worse than an ordinary stage's, and of parts whose repeatabilities differ."""
    sentences, unknown = [], undetermined_parts(diagnosis)
    motions = [motion for motion in diagnosis.motions if motion.part not in unknown]
    for unit, ordinary, sizes in (
        ("um", _ORDINARY_UM, [(each.part, each.shift_um, each.shift_error_um) for each in motions]),
        ("urad", _ORDINARY_URAD, [(each.part, each.turn_urad, each.turn_error_urad) for each in motions]),
    ):
        sentences += [
            f"The captures of the {part} part repeat to {cell_text(size)} {unit} only; ordinary stages repeat to "
            f"{ordinary:g} {unit}: look for what moves."
            for part, size, error in sizes
            if size - 2.0 * error > ordinary
        ]
        if len(sizes) == 2:
            (first, one, one_error), (second, other, other_error) = sizes
            apart = abs(np.log(one / other)) / np.hypot(one_error / one, other_error / other)
            if apart > _DIFFER and max(one, other) > _TWICE * min(one, other):
                sentences.append(
                    f"The {first} repeats to {cell_text(one)} {unit}, the {second} to {cell_text(other)} {unit}, with "
                    "one stage: one of the parts has an effect that looks like motion."
                )
    return sentences


def stated_prior(
    diagnosis: DiagnosisRecord, cause: FoundCause, parameter: ParameterValue
) -> tuple[float, float] | None:
    """Return mean and sigma of a parameter from [prior] of the bench file, in its unit; None if not stated."""
    return diagnosis.observations.nominal.priors.get(cause.name, {}).get(parameter.name)


def _noise_to_state(diagnosis: DiagnosisRecord) -> list[str]:
    """Return the noise to type into the bench file, where the stated noise is not believable."""
    floors = diagnosis.noise_floors
    wrong = [floor for floor in floors if not floor.is_believable]
    if not wrong:
        return []
    measured = [floor.measured_px for floor in wrong]
    stated = diagnosis.observations.nominal.camera.point_sigma_px
    is_one = len(wrong) == len(floors) and max(measured) < _NEARLY_ONE * min(measured)
    if is_one and all(abs(floor.stated_px / stated - 1.0) < _SAME_STATED for floor in wrong):
        typed = float(np.average(measured, weights=[floor.error_px**-2 for floor in wrong]))
        off = 100 * abs(typed / stated - 1.0)
        return [f"The noise differs from point_sigma_px by {off:.0f} %: type point_sigma_px = {typed:#.3g}."]
    parts = " and ".join(
        f"{floor.part} by {100 * abs(floor.measured_px / floor.stated_px - 1.0):.0f} %" for floor in wrong
    )
    return [f"The noise differs from the stated one: {parts}. The diagnosis uses the measured noise."]


def _too_few(diagnosis: DiagnosisRecord) -> list[str]:
    """Return the limits of parts with few captures, and the captures that they need."""
    observations, found = diagnosis.readings.observations, []
    counts = Counter(name.part for name in observations.captures)
    for part, count in sorted(counts.items()):
        if count >= FEWEST_TO_STAND_OUT or part == RUN_TIME:
            continue
        cannot = "it does not show which of them moved, and hardly shows their repeatability"
        if count == 1:
            cannot = (
                f"its repeatability is unknown, and the usual one is assumed (about {USUAL_SHIFT:.0f} um and "
                f"{USUAL_TURN:.0f} urad); an error of the camera's position looks like a cause"
            )
        found.append(
            f"The {PART_NAMES[part]} part has {count} capture{'s' * (count > 1)}: {cannot}. {ENOUGH_CAPTURES} or more "
            "captures of the part from different places are needed."
        )
    times = len({float(t) for part in observations.session.plan.parts if part is not None for t in part.time_s})
    if times > 1 and not len(times_between_captures(observations.session.plan)):
        found.append(
            f"Only {times} captures differ in time: a slip, or another cause that begins at some time, cannot be "
            "distinguished from a capture that moved. Two captures before and two after that time are needed."
        )
    return found


def _confusable(cause: FoundCause, settings: Settings) -> str:
    names = ", ".join(f"{other.name} ({100 * other.share_of_gain:.0f} % of its gain)" for other in cause.degenerate)
    close = undecided(cause, settings)
    if not close:
        return f"{cause.name} is nearly degenerate with {names}. The session decides for it."
    doubtful = "; ".join(f"from {other.name}: {other.separated_by}" for other in close)
    return f"{cause.name} is nearly degenerate with {names}. The session does not decide. To separate it {doubtful}."

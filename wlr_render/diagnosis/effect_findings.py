"""Located effects as the report states them: place, size, usual sources, and improvement on held-out captures."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from wlr_render.bench.bench_effects import BenchEffect
from wlr_render.diagnosis.coherence import FineEffect
from wlr_render.diagnosis.diagnosis import StationEffect
from wlr_render.diagnosis.field_contest import FieldContest
from wlr_render.diagnosis.field_terms import LocatedEffect
from wlr_render.diagnosis.fine_in_bench import UNITS, size_of
from wlr_render.diagnosis.observations import PART_NAMES
from wlr_render.diagnosis.prediction import Predictor
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.scatter import Scatter
from wlr_render.numerics.waves import LocalWaves

_LIKELY = {
    ("panel", "shift"): (
        "a panel warped by its bonding",
        "a flexible printed circuit that pulls",
        "a wrong code table",
    ),
    ("panel", "shift that repeats"): ("a misread stripe of the code", "moire of the panel and the camera"),
    ("panel", "shift of each colour"): ("dispersion of the optics", "displaced subpixels of one colour"),
    ("panel", "delay"): ("rows that light up in turn", "pixels that answer slowly"),
    ("combiner", "height of its outer"): (
        "a wedge of the substrate",
        "a gradient of its index",
        "its outer face's form",
    ),
    ("combiner", "height"): ("moulding flow", "stress by its mount", "a coating of uneven thickness"),
    ("combiner", "fine"): ("a bubble", "a scratch", "ripples of the mould", "a coating defect"),
    ("combiner", "turn and shift"): ("optics in the view that are not described", "a curved or uneven cover"),
    ("camera", "shift"): ("a decentred element of the lens", "a window before the camera", "a tilted sensor"),
    ("camera", "stretch"): ("a focus that follows the temperature", "a sensor that warms up"),
    ("camera", "delay"): ("a rolling shutter",),
    ("target", "displacement"): ("the printer", "paper that has moved with humidity", "the board's mounting"),
    ("stage", "pose"): ("pitch and yaw with travel", "sag", "backlash"),
    ("stage", "shift along"): ("the lead screw",),
    ("time", "shift of the panel"): ("temperature", "creep of the panel's mount"),
    ("time", "pose"): ("temperature", "a mount that creeps", "a drifting tracker"),
    ("time", "turn"): ("temperature", "a drifting tracker"),
    ("time", "delay"): ("clocks that run apart", "frames that queue up"),
    ("head motion", "turn"): ("a hinge or frame that flexes", "a filter of the head tracker"),
    ("head motion", "delay"): ("time stamps", "prediction of the head's motion"),
    ("eye tracking", "shift of the picture"): ("a display that is calibrated for few pupils",),
    ("eye tracking", "place"): ("errors of the eye tracker that depend on gaze", "the pupil's motion with gaze"),
}
"""Usual sources of an effect, by its station and the start of its form."""

_BUMP_PLACES = 4000  # number of places at which a bump's height is computed

STATIONS = {
    "panel": ("on the panel", "a photograph of the bare panel that shows a lit grid"),
    "combiner": (
        "on the combiner",
        "display captures from more viewpoints: what is on the combiner moves over the panel with them",
    ),
    "camera": ("in the camera", "the same captures with the camera turned by 90 degrees about its axis"),
    "target": ("on the target", "the same captures with the target turned by 180 degrees in its plane"),
    "stage": ("of the stage", "the same positions by another stage, or a mirror on the carriage and an autocollimator"),
    "time": (
        "in the course of the session",
        "the same captures in another order, the first ones repeated at the end",
    ),
    "head motion": ("of the head's motion", "the same rates of the head in other directions of gravity"),
    "eye tracking": ("of the eye tracking", "the same gaze from several places of the headset"),
}
"""Each station as a phrase for sentences, and the measurement that separates its effects from other stations'."""


def station_effects(
    contest: FieldContest,
    located: Sequence[LocatedEffect],
    scatter: Scatter,
    fine: FineEffect | None,
    as_stated: Predictor,
) -> list[StationEffect]:
    """Return the records of effects, largest odds first, without effects that may be remainders of others.

    Args:
        contest: contest in which the smooth effects were located.
        located: the smooth effects.
        scatter: sizes of noise and motions with all smooth effects included.
        fine: the effect that is too fine for a field, if any.
        as_stated: predictor of all readings, with the noise as stated.
    """
    estimates = contest.values_and_covariances(located, scatter)
    records = [
        _smooth(contest, effect, *estimate, scatter, [each for each in located if each is not effect])
        for effect, estimate in zip(located, estimates, strict=True)
        if not effect.is_rest
    ]
    records += [_fine(fine, as_stated)] if fine is not None else []
    return sorted(records, key=lambda each: -each.log10_odds)


def _smooth(
    contest: FieldContest,
    effect: LocatedEffect,
    values: FloatArray,
    covariance: FloatArray,
    scatter: Scatter,
    beside: Sequence[LocatedEffect],
) -> StationEffect:
    field, acts = effect.field, effect.field.acts
    bump = _bump(effect.in_bench(values, covariance))
    # Truncation at a hard edge changes the height about as much as a change of the degree does.
    fewer = [each for each in field.degrees if each < effect.degree][-1:]
    others = fewer or [each for each in field.degrees if each > effect.degree][:1]
    if bump and others:
        other = replace(effect, degree=others[0])
        height = _bump(other.in_bench(*contest.values_and_covariances([other, *beside], scatter)[0]))
        if height:
            bump["size_sigma"] = float(np.hypot(bump["size_sigma"], bump["size"] - height["size"]))
    size, size_sigma, unit = effect.size_of(values, covariance)
    smooth = {"form": "smooth", "size": size, "size_sigma": size_sigma, "unit": unit, "length": None, "place": None}
    improvement, share = contest.held_out(effect, scatter, beside)
    part = contest.readings.observations.part[acts]
    moves = np.any(effect.acting.columns[acts] != 0.0, axis=(1, 2))
    return StationEffect(
        station=field.station,
        coordinates=field.coordinates,
        displaced=field.form,
        parts=tuple(PART_NAMES[number] for number in np.unique(part[moves])),
        log10_odds=float(effect.log10_odds),
        next_station=effect.next_station,
        odds_against_next_station=float(effect.odds_against_next),
        held_out_improvement=improvement,
        share_of_excess_removed=share,
        likely=_likely(field.station, "fine" if bump else field.form),
        is_in_bench=field.in_bench is not None,
        map_place=field.place[acts],
        map_displacement=effect.acting.displacement(values)[acts],
        map_unit=field.unit,
        **(bump or smooth),
    )


def _bump(effects: Sequence[BenchEffect]) -> dict[str, Any]:
    """Return form, size and place of the bump that a bench states for a field; empty if the effect is not a bump.

    A bump is a height in a spot of the combiner. Its size is the largest height, um; its place and length describe
    the region above half that height, millimetres.
    """
    function = effects[0].function if effects else None
    if not isinstance(function, LocalWaves) or effects[0].covariance is None:
        return {}
    places = function.box.places(_BUMP_PLACES)
    heights = function(places)[:, 0]
    top = int(np.argmax(np.abs(heights)))
    high = heights / heights[top] > 0.5
    by_coefficient = replace(function, coefficients=np.eye(len(function.orders)))(places[[top]])[0]
    sigma = float(np.sqrt(by_coefficient @ effects[0].covariance @ by_coefficient))
    right, up = places[high].mean(axis=0)
    area = float(np.mean(high) * np.prod(function.box.high - function.box.low))
    size = {"form": "fine", "size": float(heights[top]), "size_sigma": sigma, "unit": "um"}
    return size | {
        "place": (float(right), float(up)),
        "length": float(np.sqrt(4.0 * area / np.pi)),
        "length_unit": "mm",
    }


def _fine(fine: FineEffect, as_stated: Predictor) -> StationEffect:
    located, (size, size_sigma) = bool(np.isfinite(fine.width)), size_of(fine, as_stated)
    return StationEffect(
        station=fine.station,
        coordinates=fine.coordinates,
        displaced="readings in cells",
        form="fine",
        parts=(fine.part,),
        log10_odds=float(fine.log10_odds),
        next_station=fine.next_station,
        odds_against_next_station=float(fine.odds_against_next),
        size=size,
        size_sigma=size_sigma,
        unit=UNITS[fine.station],
        length=2.0 * fine.width if located else fine.cell,
        place=(float(fine.place[0]), float(fine.place[1])) if located else None,
        held_out_improvement=fine.improvement,
        share_of_excess_removed=fine.share_removed,
        likely=_likely(fine.station, "fine" if fine.station == "combiner" else ""),
        map_place=fine.cells,
        map_displacement=fine.means,
        map_unit="sigma",
        length_unit=fine.unit,
        is_in_bench=fine.predicts,
    )


def _likely(station: str, form: str) -> tuple[str, ...]:
    """Return the usual sources of effects at a station, from the longest key with which the form starts."""
    fitting = [key for key in _LIKELY if key[0] == station and form.startswith(key[1])]
    key = max(fitting, key=lambda each: len(each[1]), default=None)
    return _LIKELY[key] if key else next((likely for each, likely in _LIKELY.items() if each[0] == station), ())

"""Signature of a cause: what it would do to the readings of a session, before anything is fitted."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wlr_render.bench.bench import Bench
from wlr_render.captures.session import Session
from wlr_render.diagnosis.cause import Cause, Role
from wlr_render.diagnosis.diagnosis_plots import field_maps
from wlr_render.diagnosis.fit import times_between_captures
from wlr_render.diagnosis.observations import DISPLAY, PART_NAMES
from wlr_render.diagnosis.prediction import Explanation, Hypothesis, Predictor
from wlr_render.diagnosis.residual_views import part_view
from wlr_render.numerics.arrays import FloatArray
from wlr_render.report.blocks import Block, Report, ReportTable, table

_CAPTION = (
    "Each arrow is the mean change of the readings around it by one usual size of the parameter; all maps have one "
    "scale. The menu lists captures far from each other, the one with the largest change first."
)


@dataclass(frozen=True, eq=False)
class Signature:
    """What one parameter of a cause does to the readings, to first order.

    Attributes:
        variant: way in which the cause acts.
        parameter: name. size: its usual size. unit: of that.
        change: (n, 2) of the readings by the usual size, in units of sigma.
        rms: of the change in each part, in the part's unit; None where it does nothing.
    """

    variant: str
    parameter: str
    size: float
    unit: str
    change: FloatArray
    rms: dict[str, float | None]


def signature_report(nominal: Bench, session: Session, cause: Cause, inputs: Sequence[Path] = ()) -> Report:
    """Return tables and maps of what a cause would do to the readings of a session.

    Args:
        nominal: the bench as described.
        session: the readings; only their places count.
        cause: the cause.
        inputs: files and folders that were read.

    Raises:
        BadInputError: the bench predicts no reading.
    """
    predictor = Predictor.of_session(nominal, session)
    signatures = [each for variant in cause.variants for each in _signatures(predictor, cause, variant)]
    blocks: list[Block] = [_table(signatures)]
    for variant in dict.fromkeys(each.variant for each in signatures):
        mine = [each for each in signatures if each.variant == variant]
        blocks += _maps(predictor, variant, mine)
    largest = max(signatures, key=lambda each: float(np.mean(each.change**2)), default=None)
    if largest is None:
        verdict = f"{cause.name} ({cause.title}) does nothing to the readings of this session."
    else:
        sigmas = float(f"{np.sqrt(np.mean(largest.change**2)):.2g}")
        verdict = (
            f"{cause.name} ({cause.title}) acts at the station '{cause.station}'. Of its parameters "
            f"{largest.parameter} moves the readings most: {largest.size:g} {largest.unit}, a usual size, by "
            f"{sigmas:g} sigma rms."
        )
    advice = [f"To tell it from causes that look alike: {cause.separated_by}."] if cause.separated_by else []
    record = {
        "cause": cause.name,
        "station": cause.station,
        "source": cause.source,
        "parameters": [
            {"variant": each.variant, "name": each.parameter, "size": each.size, "unit": each.unit, "rms": each.rms}
            for each in signatures
        ],
    }
    return Report(
        f"Signature of {cause.name} in {session.name}", verdict, advice, [], blocks, tuple(inputs), record=record
    )


def _signatures(predictor: Predictor, cause: Cause, variant: str) -> list[Signature]:
    """Return what each parameter of one variant does; a cause that acts from some moment on, from the middle on."""
    times, start = times_between_captures(predictor.observations.session.plan), cause.null()
    for number, parameter in enumerate(cause.parameters):
        if parameter.role is Role.TIME and len(times):
            start[number] = times[len(times) // 2]
        elif parameter.role is Role.SHAPE and len(parameter.starts) > 1:
            start[number] = parameter.starts[len(parameter.starts) // 2]
    nothing = Explanation()
    at = predictor.added(predictor.state(nothing), nothing.plus(Hypothesis(cause, variant), start))
    return [
        Signature(
            variant,
            cause.parameters[number].name,
            cause.parameters[number].prior_sigma,
            cause.parameters[number].unit,
            change,
            _rms(predictor, change),
        )
        for number, change in zip(at.free, np.moveaxis(at.jacobian, 2, 0), strict=True)
    ]


def _rms(predictor: Predictor, change: FloatArray) -> dict[str, float | None]:
    observations, rms = predictor.observations, dict[str, float | None]()
    for part in np.unique(observations.part):
        seen = observations.panel_pixels(change) if part == DISPLAY else observations.arcminutes(change, int(part))
        size = float(np.sqrt(np.mean(seen**2)))
        rms[PART_NAMES[part]] = size if size > 0.0 else None
    return rms


def _table(signatures: Sequence[Signature]) -> ReportTable:
    parts = list(signatures[0].rms) if signatures else []
    units = {part: "panel px" if part == PART_NAMES[DISPLAY] else "arcmin" for part in parts}
    return table(
        "What each parameter does",
        signatures,
        {
            "variant": "variant",
            "parameter": "parameter",
            "usual size": lambda each: f"{each.size:g} {each.unit}",
            **{f"{part} ({units[part]})": _in_part(part) for part in parts},
        },
    )


def _in_part(part: str) -> Callable[[Signature], float | None]:
    return lambda each: each.rms[part]


def _maps(predictor: Predictor, variant: str, signatures: Sequence[Signature]) -> list[Block]:
    observations = predictor.observations
    everything, still = np.ones(len(observations), dtype=bool), np.zeros((len(observations), 2, 1))
    maps: list[Block] = []
    for part in np.unique(observations.part):
        moving = {
            f"{each.parameter} by {each.size:g} {each.unit}": each.change
            for each in signatures
            if each.rms[PART_NAMES[part]]
        }
        if moving:
            view = part_view(observations, int(part), everything, moving, still)
            maps.append(field_maps(view, f"{variant}: {view.name}", _CAPTION))
    return maps

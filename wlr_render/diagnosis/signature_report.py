"""Signature of a cause: its change of the readings of a session, before anything is fitted."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from wlr_render.bench.bench import Bench
from wlr_render.captures.session import Session
from wlr_render.diagnosis.cause import Cause, Parameter, Role
from wlr_render.diagnosis.diagnosis_plots import field_maps
from wlr_render.diagnosis.fit import times_between_captures
from wlr_render.diagnosis.observations import PART_NAMES, PART_UNITS
from wlr_render.diagnosis.prediction import Hypothesis, Predictor
from wlr_render.diagnosis.residual_views import part_view
from wlr_render.numerics.arrays import FloatArray
from wlr_render.report.blocks import Block, Report, ReportTable, table

_CAPTION = (
    "Each arrow is the mean change of the readings around it by one usual size of the parameter; all maps have one "
    "scale. The menu lists captures far from each other, the one with the largest change first."
)


@dataclass(frozen=True, eq=False)
class Signature:
    """Change of the readings by one parameter of a cause, to first order.

    Attributes:
        variant: way in which the cause acts.
        parameter: parameter of the cause.
        change: (n, 2) change of the readings by the usual size of the parameter, in units of sigma.
        rms: rms change in each part, in the part's unit; None where it has no effect.
    """

    variant: str
    parameter: Parameter
    change: FloatArray
    rms: dict[str, float | None]

    @property
    def size(self) -> str:
        """Usual size of the parameter, with its unit."""
        return f"{self.parameter.prior_sigma:g} {self.parameter.unit}"


def signature_report(nominal: Bench, session: Session, cause: Cause, inputs: Sequence[Path] = ()) -> Report:
    """Return tables and maps of the change of a session's readings by a cause.

    Args:
        nominal: the bench as described.
        session: the readings; only their places are used.
        cause: the cause.
        inputs: files and folders that were read.

    Raises:
        BadInputError: the bench predicts no reading.
    """
    predictor = Predictor.of_session(nominal, session)
    by_variant = {variant: _signatures(predictor, cause, variant) for variant in cause.variants}
    signatures = [each for of_variant in by_variant.values() for each in of_variant]
    blocks: list[Block] = [_table(signatures)]
    for of_variant in by_variant.values():
        blocks += _maps(predictor, of_variant)
    largest = max(signatures, key=lambda each: float(np.mean(each.change**2)), default=None)
    if largest is None:
        verdict = f"{cause.name} ({cause.title}) does nothing to the readings of this session."
    else:
        sigmas = float(f"{np.sqrt(np.mean(largest.change**2)):.2g}")
        verdict = (
            f"{cause.name} ({cause.title}) acts at the station '{cause.station}'. Of its parameters "
            f"{largest.parameter.name} moves the readings most: {largest.size}, a usual size, by {sigmas:g} sigma rms."
        )
    advice = [f"To tell it from causes that look alike: {cause.separated_by}."] if cause.separated_by else []
    parameters = [
        {"variant": each.variant, "name": each.parameter.name, "size": each.parameter.prior_sigma}
        | {"unit": each.parameter.unit, "rms": each.rms}
        for each in signatures
    ]
    return Report(
        f"Signature of {cause.name} in {session.name}",
        verdict,
        advice,
        blocks=blocks,
        inputs=tuple(inputs),
        record={"cause": cause.name, "station": cause.station, "source": cause.source, "parameters": parameters},
    )


def _signatures(predictor: Predictor, cause: Cause, variant: str) -> list[Signature]:
    """Return the signature of each parameter of one variant; a cause with a start time starts in the middle."""
    observations, start = predictor.observations, cause.null()
    times = times_between_captures(observations.session.plan)
    for number, parameter in enumerate(cause.parameters):
        if parameter.role is Role.TIME and len(times):
            start[number] = times[len(times) // 2]
        elif parameter.role is Role.SHAPE and len(parameter.starts) > 1:
            start[number] = parameter.starts[len(parameter.starts) // 2]
    at = predictor.signature(Hypothesis(cause, variant), start)
    signatures = []
    for number, change in zip(at.free, np.moveaxis(at.jacobian, 2, 0), strict=True):
        seen = {part: observations.in_unit_of(int(part), change) for part in np.unique(observations.part)}
        rms = {PART_NAMES[part]: float(np.sqrt(np.mean(each**2))) or None for part, each in seen.items()}
        signatures.append(Signature(variant, cause.parameters[number], change, rms))
    return signatures


def _table(signatures: Sequence[Signature]) -> ReportTable:
    parts = list(signatures[0].rms) if signatures else []
    return table(
        "What each parameter does",
        signatures,
        {
            "variant": "variant",
            "parameter": "parameter.name",
            "usual size": "size",
            **{f"{part} ({PART_UNITS[PART_NAMES.index(part)]})": partial(_rms, part) for part in parts},
        },
    )


def _rms(part: str, signature: Signature) -> float | None:
    return signature.rms[part]


def _maps(predictor: Predictor, signatures: Sequence[Signature]) -> Iterator[Block]:
    """Yield a map for each part of the session that the parameters of a variant change."""
    observations = predictor.observations
    everything, still = np.ones(len(observations), dtype=bool), np.zeros((len(observations), 2, 1))
    for part in np.unique(observations.part):
        moving = {
            f"{each.parameter.name} by {each.size}": each.change for each in signatures if each.rms[PART_NAMES[part]]
        }
        if moving:
            view = part_view(observations, int(part), everything, moving, still)
            yield field_maps(view, f"{signatures[0].variant}: {view.name}", _CAPTION)

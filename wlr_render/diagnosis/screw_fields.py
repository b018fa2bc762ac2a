"""Errors of a stage that repeat with its screws: a shift along an axis that is periodic in the axis' reading."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from wlr_render.bench.bench_effects import BenchEffect
from wlr_render.diagnosis.field_terms import StationField, Terms, field_of
from wlr_render.diagnosis.observations import RUN_TIME
from wlr_render.diagnosis.prediction import Explanation
from wlr_render.diagnosis.weighed_readings import WeighedReadings
from wlr_render.numerics.arrays import FloatArray, IntArray, rows_by_label
from wlr_render.numerics.polynomial import Box, Polynomial
from wlr_render.numerics.scatter import USUAL_SHIFT, USUAL_TURN
from wlr_render.numerics.waves import Wave

_PERIODS_M = 0.00025, 0.004  # of the leads of screws and their fractions
_ALONG = "shift along {}"  # the start of a field's form
_ANYWHERE_MM = np.full(3, 1000.0)  # bounds of what does not depend on the reading
_PER_RANGE = 3.0  # frequencies tried for each wave over an axis' range: between them a wave hardly changes
_CLOSER = 41  # periods tried around the best of these, from the one before it to the one after it


def screw_fields(
    readings: WeighedReadings, stage: FloatArray, like: Sequence[StationField] = ()
) -> Iterator[StationField]:
    """Return the field of the likeliest period of each axis; its alternatives are all periods that were tried.

    Args:
        readings: of the session.
        stage: (n, 3) readings of the stage's axes, metres.
        like: fields of other readings, of which those of screws have the periods to take.
    """
    periods_mm = {field.form.partition(" with ")[0]: field.period for field in like if field.period > 0.0}
    observations = readings.observations
    still = observations.part != RUN_TIME
    names, rows = rows_by_label(observations.group[still])
    first = np.flatnonzero(still)[[mine[0] for mine in rows]]
    place, part = stage[first], observations.part[first]
    # Linear functions of the stage's readings, and a constant of each part.
    smooth = np.column_stack([Box.around(place).scaled(place), *(part == each for each in np.unique(part))])
    shift, variance = _shifts(readings, names)
    for axis, name in enumerate("xyz"):
        reading = place[:, axis]
        periods = _periods(float(np.ptp(reading)))
        if not periods.size:
            continue
        likeliest = _likeliest(reading, periods, partial(_gains, reading, smooth, shift[:, axis], variance[:, axis]))
        period_mm = periods_mm.get(start := _ALONG.format(name), 1e3 * likeliest)
        along = stage[still][:, [axis]]
        phase = 2e3 * np.pi * along / period_mm
        waves = np.concatenate([np.sin(phase), np.cos(phase)], axis=1)
        # A shift that is the same everywhere is the camera's.
        mean = waves.mean(axis=0)
        terms = Terms("stage readings", 1e3 * along, waves - mean, np.ones(2, dtype=np.int64), (1,))
        terms = replace(terms, in_bench=partial(_in_bench, axis, period_mm, mean))
        form = f"{start} with a period of {period_mm:.3g} mm"
        field = field_of("stage", form, "um", terms, readings.camera_motions[still][:, :, [axis]], still)
        yield replace(field, period=period_mm, alternatives=len(periods))


def _in_bench(axis: int, period_mm: float, mean: FloatArray, values: FloatArray) -> tuple[BenchEffect, ...]:
    """Return a wave by coefficients (2,) of its sine and cosine, and the constant that takes its mean off."""
    wave, constant = np.zeros((2, 6)), np.zeros((1, 6))
    wave[:, axis], constant[:, axis] = values, -mean @ values
    everywhere = Polynomial(np.zeros((1, 3), dtype=np.int64), Box(-_ANYWHERE_MM, _ANYWHERE_MM), constant)
    return (
        BenchEffect("stage", "pose", Wave(axis, period_mm, wave)),
        BenchEffect("stage", "pose", everywhere),
    )


def _periods(over: float) -> FloatArray:
    """Return the periods, metres, that differ over a range in metres."""
    if over <= 0.0:
        return np.zeros(0)
    low, high = 1.0 / _PERIODS_M[1], 1.0 / _PERIODS_M[0]
    return np.asarray(1.0 / np.arange(max(low, 2.0 / over), high, 1.0 / (_PER_RANGE * over)))


def _shifts(readings: WeighedReadings, captures: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return the shift (g, 3) of each capture's camera that its residual shows, micrometres, and its variance.

    The other shifts and turns of that capture are as large as usual; the variance contains the usual shift.
    """
    nothing = readings.predictor.residual(Explanation())
    sums = readings.sums(nothing, np.zeros((*nothing.shape, 0)))
    ee, ey = sums.ee[captures], sums.ey[captures]
    usual = np.repeat([USUAL_SHIFT, USUAL_TURN], 3) ** -2.0
    shift, variance = np.zeros((len(captures), 3)), np.zeros((len(captures), 3))
    for axis in range(3):
        prior = usual.copy()
        prior[axis] = 0.0
        covariance = np.linalg.pinv(ee + np.diag(prior))
        shift[:, axis] = np.einsum("gk,gk->g", covariance[:, axis], ey)
        variance[:, axis] = covariance[:, axis, axis] + USUAL_SHIFT**2
    return shift, variance


def _likeliest(reading: FloatArray, periods: FloatArray, gains: Callable[[FloatArray], FloatArray]) -> float:
    """Return the period of largest gain among some, and then among closer ones around it."""
    best = float(periods[int(np.argmax(gains(periods)))])
    step = 1.0 / (_PER_RANGE * float(np.ptp(reading)))
    closer = 1.0 / (1.0 / best + step * np.linspace(-1.0, 1.0, _CLOSER))
    closer = closer[(closer >= periods.min()) & (closer <= periods.max())]
    return float(closer[int(np.argmax(gains(closer)))])


def _gains(
    reading: FloatArray, smooth: FloatArray, shift: FloatArray, variance: FloatArray, periods: FloatArray
) -> FloatArray:
    """Return the part of a weighted sum of squares that each period's wave takes off beside smooth functions."""
    weight = 1.0 / np.sqrt(variance)
    axes = np.linalg.qr(smooth * weight[:, None])[0]
    phase = 2.0 * np.pi * reading[:, None] / periods
    waves = np.stack([np.sin(phase), np.cos(phase)], axis=-1) * weight[:, None, None]
    waves -= np.einsum("gk,kpw->gpw", axes, np.einsum("gk,gpw->kpw", axes, waves))
    left = shift * weight
    left -= axes @ (axes.T @ left)
    normal = np.einsum("gpv,gpw->pvw", waves, waves) + np.eye(2) * 1e-9
    pull = np.einsum("gpw,g->pw", waves, left)
    return np.asarray(np.einsum("pw,pw->p", pull, np.linalg.solve(normal, pull[..., None])[..., 0]))

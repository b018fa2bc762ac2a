"""Errors that repeat: a stage's with its screws, and decoded positions with the stripes of a code.

A shift along an axis is periodic in the place along that axis. Each axis has one field, of the likeliest period.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from wlr_render.bench.bench_effects import BenchEffect
from wlr_render.diagnosis.field_terms import StationField, Terms, field_of
from wlr_render.diagnosis.observations import DISPLAY, RUN_TIME
from wlr_render.diagnosis.prediction import Explanation
from wlr_render.diagnosis.weighed_readings import WeighedReadings
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray, rows_by_label
from wlr_render.numerics.polynomial import Box, Polynomial, basis, total_degree
from wlr_render.numerics.scatter import USUAL_SHIFT, USUAL_TURN
from wlr_render.numerics.waves import Wave

_CODE_DEGREE = 6  # degree of the smooth shifts on the panel that are taken off before stripes are looked for
_ANYWHERE = 1e6  # bound of what does not depend on the place
_PER_RANGE = 3.0  # frequencies tried for each wave over an axis' range: between them a wave hardly changes
_ROUNDS, _CLOSER = 2, 21
"""Rounds of periods ever closer to the best one, and their number in a round. A round reaches from one neighbour of the
best period in the round before to the other."""


@dataclass(frozen=True, eq=False)
class _Axis:
    """An axis along which a shift may repeat.

    Attributes:
        name: name of the axis.
        number: index of the axis among the components of a bench effect's displacement.
        place: (m,) of each reading along the axis, in the unit of the period.
        lever: (m, 2) change of each reading by a shift, in sigma per unit of the shift.
        tried: places along the axis (k,), with the measured shifts (k,), their variances (k,), and smooth functions (k,
            f) that are fitted together with each wave.
    """

    name: str
    number: int
    place: FloatArray
    lever: FloatArray
    tried: tuple[FloatArray, FloatArray, FloatArray, FloatArray]


@dataclass(frozen=True, eq=False)
class _Kind:
    """A kind of periodic field: its station, coordinates and effect in a bench, its units, and the periods to try."""

    station: str
    coordinates: str
    displaces: str
    variables: int
    components: int
    unit: str
    unit_of_period: str
    periods: tuple[float, float]


_SCREW = _Kind(
    station="stage",
    coordinates="stage readings",
    displaces="pose",
    variables=3,
    components=6,
    unit="um",
    unit_of_period="mm",
    periods=(0.25, 4.0),  # leads of screws and their fractions
)
_STRIPES = _Kind(
    station="panel",
    coordinates="panel pixels",
    displaces="shift",
    variables=2,
    components=2,
    unit="panel px",
    unit_of_period="px",
    periods=(8.0, 160.0),  # fringes, and stripes of a code that are misread
)


def screw_fields(
    readings: WeighedReadings, stage: FloatArray, like: Sequence[StationField] = ()
) -> Iterator[StationField]:
    """Return the field of the likeliest period of each axis of the stage.

    Args:
        readings: of the session.
        stage: (n, 3) readings of the stage's axes, metres.
        like: fields of other readings, whose periods are taken.
    """
    observations = readings.observations
    still = observations.part != RUN_TIME
    names, rows = rows_by_label(observations.group[still])
    first = np.flatnonzero(still)[[mine[0] for mine in rows]]
    place, part = 1e3 * stage[first], observations.part[first]
    smooth = np.column_stack([Box.around(place).scaled(place), *(part == each for each in np.unique(part))])
    shift, variance = _shifts(readings, names)
    for axis, name in enumerate("xyz"):
        tried = place[:, axis], shift[:, axis], variance[:, axis], smooth
        lever = readings.camera_motions[still][:, :, axis]
        yield from _fields(_SCREW, _Axis(name, axis, 1e3 * stage[still][:, axis], lever, tried), still, like)


def stripe_fields(
    readings: WeighedReadings, pixel: FloatArray, lever: FloatArray, like: Sequence[StationField] = ()
) -> Iterator[StationField]:
    """Return the field of the likeliest period along each axis of the panel.

    Args:
        readings: of the session.
        pixel: (m, 2) predicted positions on the panel of the readings of the display.
        lever: (m, 2, 2) change of these readings by a panel pixel along u and v, in sigma.
        like: fields of other readings, whose periods are taken.
    """
    shown, inverse = readings.observations.part == DISPLAY, np.linalg.inv(lever)
    shift = np.einsum("nij,nj->ni", inverse, readings.predictor.residual(Explanation())[shown])
    variance = np.sum(inverse**2, axis=2)
    smooth = basis(pixel, total_degree(2, _CODE_DEGREE), Box.around(pixel))
    for axis, name in enumerate("uv"):
        tried = pixel[:, axis], shift[:, axis], variance[:, axis], smooth
        yield from _fields(_STRIPES, _Axis(name, axis, pixel[:, axis], lever[:, :, axis], tried), shown, like)


def _fields(kind: _Kind, axis: _Axis, rows: BoolArray, like: Sequence[StationField]) -> Iterator[StationField]:
    """Return the field of an axis, at some of the readings (n,); its alternatives are the periods that are tried."""
    form = f"shift along {axis.name} with a period of"
    periods = _periods(kind.periods, float(np.ptp(axis.tried[0])))
    if not periods.size:
        return
    known = [each.period for each in like if each.station == kind.station and each.form.startswith(form)]
    period = known[0] if known else _likeliest(periods, axis)
    phase = 2.0 * np.pi * axis.place / period
    waves = np.stack([np.sin(phase), np.cos(phase)], axis=1)
    # A wave that few places sample may be nearly constant there. A constant rivals no cause of another station.
    mean = waves.mean(axis=0)
    functions, order = np.column_stack([np.ones(len(waves)), waves - mean]), np.array([0, 1, 1])
    in_bench = partial(_in_bench, kind, axis.number, period, mean)
    terms = Terms(kind.coordinates, axis.place[:, None], functions, order, (1,), in_bench=in_bench)
    words = f"{form} {period:.3g} {kind.unit_of_period}"
    field = field_of(kind.station, words, kind.unit, terms, axis.lever[:, :, None], rows)
    yield replace(field, period=period, alternatives=len(periods))


def _in_bench(kind: _Kind, axis: int, period: float, mean: FloatArray, values: FloatArray) -> tuple[BenchEffect, ...]:
    """Return a wave and a constant by coefficients (3,) of the constant and of the sine and cosine less their means."""
    wave, constant = np.zeros((2, kind.components)), np.zeros((1, kind.components))
    wave[:, axis], constant[:, axis] = values[1:], values[0] - mean @ values[1:]
    anywhere = np.full(kind.variables, _ANYWHERE)
    everywhere = Polynomial(np.zeros((1, kind.variables), dtype=np.int64), Box(-anywhere, anywhere), constant)
    functions = Wave(axis, period, wave), everywhere
    return tuple(BenchEffect(kind.station, kind.displaces, function) for function in functions)


def _periods(limits: tuple[float, float], over: float) -> FloatArray:
    """Return the periods within limits that differ over a range."""
    if over <= 0.0:
        return np.zeros(0)
    low, high = 1.0 / limits[1], 1.0 / limits[0]
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


def _likeliest(periods: FloatArray, axis: _Axis) -> float:
    """Return the period of largest gain among some, and then among closer and closer ones around it."""
    best = float(periods[int(np.argmax(_gains(periods, *axis.tried)))])
    step = 1.0 / (_PER_RANGE * float(np.ptp(axis.tried[0])))
    for _ in range(_ROUNDS):
        closer = 1.0 / (1.0 / best + step * np.linspace(-1.0, 1.0, _CLOSER))
        closer = closer[(closer >= periods.min()) & (closer <= periods.max())]
        best = float(closer[int(np.argmax(_gains(closer, *axis.tried)))])
        step *= 2.0 / (_CLOSER - 1)
    return best


def _gains(
    periods: FloatArray, place: FloatArray, shift: FloatArray, variance: FloatArray, smooth: FloatArray
) -> FloatArray:
    """Return the fall of the weighted sum of squares by each period's wave, fitted with the smooth functions."""
    weight = 1.0 / np.sqrt(variance)
    axes = np.linalg.qr(smooth * weight[:, None])[0]
    left = shift * weight
    left -= axes @ (axes.T @ left)
    gains = []
    for period in periods:
        phase = 2.0 * np.pi * place / period
        waves = np.column_stack([np.sin(phase), np.cos(phase)]) * weight[:, None]
        waves -= axes @ (axes.T @ waves)
        pull = waves.T @ left
        gains.append(float(pull @ np.linalg.solve(waves.T @ waves + np.eye(2) * 1e-9, pull)))
    return np.array(gains)

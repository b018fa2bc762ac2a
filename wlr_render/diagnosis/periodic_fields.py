"""Periodic errors: of a stage with its lead screws, and of decoded positions with the stripes of a code.

A shift along an axis is periodic in the position along that axis. Each axis has one field, with the likeliest period.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from wlr_render.diagnosis.field_terms import StationField, Terms, field_of, polynomials
from wlr_render.diagnosis.observations import DISPLAY, RUN_TIME
from wlr_render.diagnosis.prediction import Explanation
from wlr_render.diagnosis.weighed_readings import WeighedReadings
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray, rows_by_label
from wlr_render.numerics.polynomial import Box, basis, total_degree
from wlr_render.numerics.scatter import USUAL_SHIFT, USUAL_TURN
from wlr_render.numerics.waves import Wave

_LEADS_MM = (0.25, 4.0)  # limits of periods: leads of screws and their fractions
_STRIPES_PX = (8.0, 160.0)  # limits of periods: fringes, and misread stripes of a code
_CODE_DEGREE = 6  # degree of the smooth shifts on the panel that are subtracted before the search for stripes
_ANYWHERE = 1e6  # bounds of the constant, which acts everywhere
_PER_RANGE = 3.0  # frequencies tried per cycle over an axis' range; a wave hardly changes between them
_ROUNDS, _CLOSER = 2, 21
"""Rounds of refining the best period, and periods per round. Each round spans the two neighbours of the previous
round's best period."""


@dataclass(frozen=True, eq=False)
class _Axes:
    """Axes of a station along which a shift may repeat.

    Attributes:
        station, coordinates, displaces: as in the station's fields and bench effects.
        units: units of the shift and of places.
        names: name of each axis.
        periods: limits of the periods to try.
        rows: (n,) mask of the readings.
        place: (m, v) places of these readings along each axis.
        lever: (m, 2, d) change of each reading by a displacement; the first v components are shifts along the axes.
        tried: places along the axes (k, v), with the measured shifts (k, v), their variances (k, v), and smooth
            functions (k, f) that are fitted together with each wave.
    """

    station: str
    coordinates: str
    displaces: str
    units: tuple[str, str]
    names: str
    periods: tuple[float, float]
    rows: BoolArray
    place: FloatArray
    lever: FloatArray
    tried: tuple[FloatArray, FloatArray, FloatArray, FloatArray]

    def fields(self, like: Sequence[StationField]) -> Iterator[StationField]:
        """Yield the field with the likeliest period of each axis, or with the period of its field in `like`."""
        variables, components = self.place.shape[1], self.lever.shape[2]
        anywhere = np.full(variables, _ANYWHERE)
        constant = polynomials(np.zeros((1, variables), dtype=np.int64), Box(-anywhere, anywhere))
        for axis, name in enumerate(self.names):
            form = f"shift along {name} with a period of"
            tried = (*(each[:, axis] for each in self.tried[:3]), self.tried[3])
            periods = _periods(self.periods, float(np.ptp(tried[0])))
            if not periods.size:
                continue
            known = [each.period for each in like if each.station == self.station and each.form.startswith(form)]
            period = known[0] if known else _likeliest(periods, tried)
            wave = Wave(axis, period, np.eye(2))
            functions = np.column_stack([wave(self.place), np.ones(len(self.place))])
            terms = Terms(
                self.coordinates, self.place[:, [axis]], functions, np.array([1, 1, 0]), (1,), (wave, constant)
            )
            # Subtract means: a wave sampled at few places may be nearly constant, and a constant must not rival causes.
            field = field_of(
                self.station,
                f"{form} {period:.3g} {self.units[1]}",
                self.units[0],
                terms.varying(),
                self.lever[:, :, [axis]],
                self.rows,
                self.displaces,
                np.eye(components)[[axis]],
            )
            yield replace(field, period=period, alternatives=len(periods))


def screw_fields(
    readings: WeighedReadings, stage: FloatArray, like: Sequence[StationField] = ()
) -> Iterator[StationField]:
    """Return the field with the likeliest period of each axis of the stage.

    Args:
        readings: readings of the session.
        stage: (n, 3) readings of the stage's axes, metres.
        like: fields of other readings; their periods are used.
    """
    observations = readings.observations
    still = observations.part != RUN_TIME
    names, rows = rows_by_label(observations.group[still])
    first = np.flatnonzero(still)[[mine[0] for mine in rows]]
    place, part = 1e3 * stage[first], observations.part[first]
    smooth = np.column_stack([Box.around(place).scaled(place), *(part == each for each in np.unique(part))])
    tried, lever = (place, *_shifts(readings, names), smooth), readings.camera_motions[still]
    units, places = ("um", "mm"), 1e3 * stage[still]
    axes = _Axes("stage", "stage readings", "pose", units, "xyz", _LEADS_MM, still, places, lever, tried)
    return axes.fields(like)


def stripe_fields(
    readings: WeighedReadings, pixel: FloatArray, lever: FloatArray, like: Sequence[StationField] = ()
) -> Iterator[StationField]:
    """Return the field with the likeliest period along each axis of the panel.

    Args:
        readings: readings of the session.
        pixel: (m, 2) predicted panel positions of the display readings.
        lever: (m, 2, 2) change of these readings by a panel pixel along u and v, in sigma.
        like: fields of other readings; their periods are used.
    """
    shown, inverse = readings.observations.part == DISPLAY, np.linalg.inv(lever)
    shift = np.einsum("nij,nj->ni", inverse, readings.predictor.residual(Explanation())[shown])
    smooth = basis(pixel, total_degree(2, _CODE_DEGREE), Box.around(pixel))
    tried, units = (pixel, shift, np.sum(inverse**2, axis=2), smooth), ("panel px", "px")
    axes = _Axes("panel", "panel pixels", "shift", units, "uv", _STRIPES_PX, shown, pixel, lever, tried)
    return axes.fields(like)


def _periods(limits: tuple[float, float], over: float) -> FloatArray:
    """Return the periods within limits that can be distinguished over a range of places."""
    if over <= 0.0:
        return np.zeros(0)
    low, high = 1.0 / limits[1], 1.0 / limits[0]
    return np.asarray(1.0 / np.arange(max(low, 2.0 / over), high, 1.0 / (_PER_RANGE * over)))


def _shifts(readings: WeighedReadings, captures: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return the shift (g, 3) of each capture's camera, from its residual, in micrometres, and its variance.

    The capture's other shifts and turns have the usual size as prior; the variance includes the usual shift.
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


def _likeliest(periods: FloatArray, tried: tuple[FloatArray, ...]) -> float:
    """Return the period of largest gain, refined from the best of some periods."""
    best = float(periods[int(np.argmax(_gains(periods, *tried)))])
    step = 1.0 / (_PER_RANGE * float(np.ptp(tried[0])))
    for _ in range(_ROUNDS):
        closer = 1.0 / (1.0 / best + step * np.linspace(-1.0, 1.0, _CLOSER))
        closer = closer[(closer >= periods.min()) & (closer <= periods.max())]
        best = float(closer[int(np.argmax(_gains(closer, *tried)))])
        step *= 2.0 / (_CLOSER - 1)
    return best


def _gains(
    periods: FloatArray, place: FloatArray, shift: FloatArray, variance: FloatArray, smooth: FloatArray
) -> FloatArray:
    """Return the reduction of the weighted sum of squares by each period's wave, fitted with the smooth functions."""
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

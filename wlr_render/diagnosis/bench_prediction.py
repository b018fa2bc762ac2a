"""How well a bench model predicts a session that it was not fitted to: by part, target distance and capture."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from wlr_render.captures.session import Session
from wlr_render.diagnosis.observations import DISPLAY, PART_NAMES, SEE_THROUGH, Observations, observe
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray
from wlr_render.numerics.polynomial import Box, basis, total_degree
from wlr_render.simulation.bench import Bench
from wlr_render.simulation.simulate_session import simulate

_OUTLIER = 6.0  # sigmas, as the median length of a capture's residuals has them
_MEDIAN_LENGTH = np.sqrt(2.0 * np.log(2.0))  # of a two-vector of unit normal components
_SMOOTH_DEGREE = 4  # of the surface about which the readings of a photograph scatter
_READINGS_PER_TERM = 2.5
_SIGNIFICANT = 3.0  # standard errors


@dataclass(frozen=True)
class PredictedGroup:
    """How well some readings of one part are predicted. No value is fitted to them.

    Attributes:
        name: of the readings.
        part: of the session.
        captures, readings: how many.
        rms_arcmin: residual, rms per axis.
        mean_arcmin: mean residual, right and down.
        noise_arcmin: stated noise per axis.
        reduced_chi_squared: mean square of the residual over the stated variance.
        error: its standard error where only the stated noise is left.
        by_own_bench: reduced chi-squared by the session's own bench; None if that is not known.
        within_arcmin: scatter per axis about a smooth surface over each photograph; None where photographs have too
            few readings.
        against_within: reduced chi-squared against that scatter in place of the stated noise.
    """

    name: str
    part: str
    captures: int
    readings: int
    rms_arcmin: float
    mean_arcmin: tuple[float, float]
    noise_arcmin: float
    reduced_chi_squared: float
    error: float
    by_own_bench: float | None = None
    within_arcmin: float | None = None
    against_within: float | None = None

    @property
    def is_noise(self) -> bool:
        """Whether the residual is no more than the stated noise, or no more than the scatter within photographs."""
        least = min(each for each in (self.reduced_chi_squared, self.against_within) if each is not None)
        return least < 1.0 + _SIGNIFICANT * self.error

    @property
    def beyond_noise_arcmin(self) -> float:
        """Rms per axis of the residual that is not stated noise."""
        return self.noise_arcmin * float(np.sqrt(max(0.0, self.reduced_chi_squared - 1.0)))


@dataclass(frozen=True)
class BenchPrediction:
    """What a bench predicts of a session.

    Attributes:
        session: its name.
        reduced_chi_squared: of all readings against the stated noise.
        by_own_bench: the same by the session's own bench; None if that is not known.
        without_slip: the same without the slip that the bench states; None without one.
        parts, distances, captures: how well each is predicted.
        outliers: number of readings far from all others of their capture; no figure contains them.
        unseen: number of readings for which the bench predicts nothing.
        observations: the readings that are predicted.
        residual: (n, 2) measured minus predicted, in units of the stated sigma.
        used: (n,) which are no outliers.
    """

    session: str
    reduced_chi_squared: float
    by_own_bench: float | None
    without_slip: float | None
    parts: tuple[PredictedGroup, ...]
    distances: tuple[PredictedGroup, ...]
    captures: tuple[PredictedGroup, ...]
    outliers: int
    unseen: int
    observations: Observations = field(metadata={"json": False})
    residual: FloatArray = field(metadata={"json": False})
    used: BoolArray = field(metadata={"json": False})


def predict_session(bench: Bench, session: Session, own: Bench | None = None) -> BenchPrediction:
    """Compare the readings of a session, from one capture on, with those that a bench predicts.

    Args:
        bench: with the target poses of the session (`session_folder.bench_for_session`).
        session: the session.
        own: the session's own bench, for comparison.

    Raises:
        BadInputError: the bench predicts no reading.
    """
    observations = observe(bench, session)
    plan = observations.session.plan

    def residual_by(other: Bench) -> FloatArray:
        return observations.residual(simulate(other, plan))

    residual = residual_by(bench)
    by_own = None if own is None else residual_by(own)
    used = _without_outliers(observations, residual)
    slipped = np.isfinite(bench.mount.slip_time_s)
    still = replace(bench.mount, slip_time_s=np.inf)
    groups = _Groups(observations, residual, by_own, used)
    return BenchPrediction(
        session.name,
        _mean_square(residual, used),
        None if by_own is None else _mean_square(by_own, used),
        _mean_square(residual_by(replace(bench, mount=still)), used) if slipped else None,
        tuple(groups.part(int(part)) for part in np.unique(observations.part[used])),
        tuple(
            groups.group(name, used & rows)
            for name, rows in observations.target_distances().items()
            if np.any(used & rows)
        ),
        tuple(
            groups.group(str(observations.captures[number]), used & (observations.group == number))
            for number in np.unique(observations.group[used])
        ),
        int(np.sum(~used)),
        sum(0 if part is None else len(part) for part in session.plan.parts) - len(observations),
        observations,
        residual,
        used,
    )


@dataclass(frozen=True, eq=False)
class _Groups:
    """Figures of groups of readings: residuals (n, 2) by the bench and by the session's own; which are used (n,)."""

    observations: Observations
    residual: FloatArray
    by_own: FloatArray | None
    used: BoolArray

    def part(self, part: int) -> PredictedGroup:
        """All readings of a part, also against the scatter within its photographs."""
        group = self.group(PART_NAMES[part], self.used & (self.observations.part == part))
        photographs = list(_photographs(self.observations, self.used, part))
        found = [each for rows, place in photographs if (each := _scatter(place, self.residual[rows])) is not None]
        if not found:
            return group
        variance = float(np.median(found))
        return replace(
            group,
            within_arcmin=group.noise_arcmin * float(np.sqrt(variance)),
            against_within=group.reduced_chi_squared / variance,
        )

    def group(self, name: str, rows: BoolArray) -> PredictedGroup:
        """Readings (n,) of one part."""
        observations, part = self.observations, int(self.observations.part[rows][0])
        seen = np.zeros_like(self.residual)
        seen[observations.part == part] = observations.arcminutes(self.residual, part)
        right, down = seen[rows].mean(axis=0)
        readings, reduced = int(rows.sum()), _mean_square(self.residual, rows)
        rms = float(np.sqrt(np.mean(seen[rows] ** 2)))
        return PredictedGroup(
            name,
            PART_NAMES[part],
            len(np.unique(observations.group[rows])),
            readings,
            rms,
            (float(right), float(down)),
            rms / float(np.sqrt(reduced)) if reduced > 0.0 else 0.0,
            reduced,
            float(np.sqrt(1.0 / readings)),  # of the mean of 2 n squares of normal numbers
            None if self.by_own is None else _mean_square(self.by_own, rows),
        )


def _mean_square(residual: FloatArray, rows: BoolArray) -> float:
    """Mean square per axis of those of some readings (n,) that are predicted; NaN if none is."""
    values = residual[rows]
    values = values[np.isfinite(values).all(axis=1)]
    return float(np.mean(values**2)) if len(values) else float("nan")


def _without_outliers(observations: Observations, residual: FloatArray) -> BoolArray:
    """Mask (n,) of the readings that are no farther off than others of their capture."""
    length = np.linalg.norm(residual, axis=1)
    used = np.ones(len(observations), dtype=bool)
    for number in np.unique(observations.group):
        rows = observations.group == number
        used[rows] = length[rows] <= _OUTLIER * np.median(length[rows]) / _MEDIAN_LENGTH
    return used


def _photographs(observations: Observations, used: BoolArray, part: int) -> Iterator[tuple[IntArray, FloatArray]]:
    """Readings (k,) and their camera pixels (k, 2) of each photograph of a part, in one colour."""
    plan, readings = observations.session.plan, observations.session.readings
    rows = np.flatnonzero(observations.part == part)
    colour = np.zeros(len(rows), dtype=np.int64)
    if part == DISPLAY and plan.display is not None:
        place, colour = plan.display.camera_pixel, plan.display.channel
    elif part == SEE_THROUGH and readings.dot_pixel is not None:
        place = readings.dot_pixel
    else:
        return
    photograph = 3 * observations.group[rows] + colour
    for number in np.unique(photograph):
        mine = (photograph == number) & used[rows]
        yield rows[mine], place[mine]


def _scatter(place: FloatArray, residual: FloatArray) -> float | None:
    """Variance per axis of a residual (k, 2) about a smooth surface over its place (k, 2); None for too few."""
    terms = total_degree(2, _SMOOTH_DEGREE)
    if len(place) < _READINGS_PER_TERM * len(terms):
        return None
    design = basis(place, terms, Box.around(place))
    left = residual - design @ np.linalg.lstsq(design, residual, rcond=None)[0]
    return float(np.sum(left**2) / (2 * (len(place) - design.shape[1])))

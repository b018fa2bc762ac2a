"""How well a bench model predicts a session that it was not fitted to: by part, target distance and capture.

The noise and the repeatability are those that a diagnosis measures (`noise`, `scatter`); no cause is fitted. The errors
of the bench's effects, as their covariances state them, are errors of all readings in common.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from wlr_render.bench.bench import Bench
from wlr_render.bench.simulate_session import simulate
from wlr_render.captures.session import Session
from wlr_render.diagnosis.effect_errors import effect_errors
from wlr_render.diagnosis.fit import Fit, fit
from wlr_render.diagnosis.noise import noise_of
from wlr_render.diagnosis.observations import PART_NAMES, RUN_TIME, Observations
from wlr_render.diagnosis.prediction import Explanation, Predictor
from wlr_render.diagnosis.settings import DEFAULT
from wlr_render.diagnosis.weighed_readings import WeighedReadings
from wlr_render.errors import BadInputError
from wlr_render.numerics.arrays import BoolArray, FloatArray
from wlr_render.numerics.scatter import LOG10_ODDS, UNUSUAL_SHIFT, UNUSUAL_TURN, Scatter
from wlr_render.numerics.scatter_search import best_scatter


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
        effects_arcmin: standard error per axis of what is predicted, rms, by the covariances of the bench's effects.
        reduced_chi_squared: mean square of the residual over the stated variance.
        whitened: mean square of the residual over the measured variance, less the motions of the camera that the
            repeatability admits, and of the errors of the bench's effects.
        by_own_bench: reduced chi-squared by the session's own bench; None if that is not known.
    """

    name: str
    part: str
    captures: int
    readings: int
    rms_arcmin: float
    mean_arcmin: tuple[float, float]
    noise_arcmin: float
    effects_arcmin: float
    reduced_chi_squared: float
    whitened: float
    by_own_bench: float | None


@dataclass(frozen=True)
class PredictedPart(PredictedGroup):
    """How well a part of the session is predicted.

    Attributes:
        is_noise: whether noise plus the usual repeatability of stages explains the residual; a motion common to all
            captures is an error of the bench.
        shift_um, turn_urad: repeatability: standard deviations of the camera's position and rotation per axis; None
            where one capture cannot show it, and at run time.
    """

    is_noise: bool
    shift_um: float | None
    turn_urad: float | None


@dataclass(frozen=True)
class BenchPrediction:
    """What a bench predicts of a session.

    Attributes:
        session: its name.
        reduced_chi_squared: of all readings against the stated noise.
        by_own_bench: the same by the session's own bench; None if that is not known.
        without_slip: the same without the slip that the bench states; None without one.
        parts, distances, captures: how well each is predicted.
        outliers: number of readings far from their neighbours in the photograph; no figure contains them.
        unseen: number of readings for which the bench predicts nothing.
        observations: the readings that are predicted.
        residual: (n, 2) measured minus predicted, in units of the stated sigma.
        used: (n,) which are no outliers.
    """

    session: str
    reduced_chi_squared: float
    by_own_bench: float | None
    without_slip: float | None
    parts: tuple[PredictedPart, ...]
    distances: tuple[PredictedGroup, ...]
    captures: tuple[PredictedGroup, ...]
    outliers: int
    unseen: int
    observations: Observations = field(metadata={"json": False})
    residual: FloatArray = field(metadata={"json": False})
    used: BoolArray = field(metadata={"json": False})

    @property
    def is_noise(self) -> bool:
        """Whether every part is predicted to noise and repeatability."""
        return all(part.is_noise for part in self.parts)


def predict_session(bench: Bench, session: Session, own: Bench | None = None) -> BenchPrediction:
    """Compare the readings of a session, from one capture on, with those that a bench predicts.

    Args:
        bench: with the target poses of the session (`session_folder.bench_for_session`).
        session: the session.
        own: the session's own bench, for comparison.

    Raises:
        BadInputError: the bench predicts no reading.
    """
    predictor = Predictor.of_session(bench, session)
    observations = predictor.observations

    def residual_by(other: Bench) -> FloatArray:
        return observations.residual(simulate(other, observations.session.plan))

    residual = predictor.residual(Explanation())
    by_own = None if own is None else residual_by(own)
    noise = noise_of(observations, residual, DEFAULT)
    used = ~noise.outlier
    errors = effect_errors(predictor)
    by_noise = (observations.sigma_px / noise.sigma_px)[used, None, None]
    readings = WeighedReadings.of(predictor.with_sigma(noise.sigma_px).of_rows(used), noise)
    readings = readings.with_effects(errors[used] * by_noise, np.ones(errors.shape[2]))
    found = fit(readings, Explanation(), Scatter.usual(len(observations.captures)), 0)
    if found is None:
        raise BadInputError(f"{session.name}: the bench does not predict every reading; check its stage and targets.")
    scatter, systematic = _about_common_motions(readings, found)
    slipped = np.isfinite(bench.mount.slip_time_s)
    still = replace(bench.mount, slip_time_s=np.inf)
    effects = np.sqrt(np.sum(errors**2, axis=2))
    groups = _Groups(observations, residual, by_own, used, _whitened(readings, scatter, used), effects)
    return BenchPrediction(
        session.name,
        _mean_square(residual, used),
        None if by_own is None else _mean_square(by_own, used),
        _mean_square(residual_by(replace(bench, mount=still)), used) if slipped else None,
        tuple(
            groups.part(int(part), scatter, int(part) not in systematic) for part in np.unique(observations.part[used])
        ),
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


def _about_common_motions(readings: WeighedReadings, found: Fit) -> tuple[Scatter, set[int]]:
    """Return how captures scatter about a motion common to their part, and the parts that clearly have such a motion.

    Such a motion is an error of the bench, which repeatability alone would hide: captures scatter about zero.
    """
    observations, scatter, systematic = readings.observations, found.scatter, set[int]()
    for part in np.unique(observations.part[observations.part != RUN_TIME]):
        rows = observations.part == part
        if len(np.unique(observations.group[rows])) < 2:
            continue
        sums = readings.sums(found.at.residual, readings.camera_motions * rows[:, None, None])
        _, without = best_scatter(sums.of_columns(np.arange(0)), found.scatter, np.zeros(0))
        about, cost = best_scatter(sums, found.scatter, np.zeros(6), np.repeat([UNUSUAL_SHIFT, UNUSUAL_TURN], 3))
        if LOG10_ODDS * (without - cost) > DEFAULT.least_log10_odds:
            systematic.add(int(part))
            mine = np.arange(len(PART_NAMES)) == part
            new, old = (each.vector().reshape(3, -1) for each in (about, scatter))
            scatter = scatter.at(np.where(mine, new, old).ravel())
    return scatter, systematic


def _whitened(readings: WeighedReadings, scatter: Scatter, used: BoolArray) -> FloatArray:
    """Return the residual (n, 2) over the noise within photographs, less the camera's motions; NaN for outliers."""
    white = np.full((len(used), 2), np.nan)
    residual = readings.whitening(scatter)(readings.predictor.residual(Explanation()))
    # A fit scales noise until its residual is of unit size.
    white[used] = residual * scatter.noise[readings.observations.part, None]
    return white


@dataclass(frozen=True, eq=False)
class _Groups:
    """Figures of groups of readings.

    Residuals (n, 2) are by the bench and by the session's own in units of the stated sigma, and whitened; `used` (n,);
    `effects` (n, 2) are standard errors by the bench's effects, in units of the stated sigma.
    """

    observations: Observations
    residual: FloatArray
    by_own: FloatArray | None
    used: BoolArray
    white: FloatArray
    effects: FloatArray

    def part(self, part: int, scatter: Scatter, random: bool) -> PredictedPart:
        """Return the figures of a part; `random` where its captures have no motion in common."""
        group = self.group(PART_NAMES[part], self.used & (self.observations.part == part))
        shows = part != RUN_TIME and group.captures > 1
        return PredictedPart(
            **vars(group),
            is_noise=random and scatter.is_ordinary(part, DEFAULT.material_excess),
            shift_um=float(scatter.shift_um[part]) if shows else None,
            turn_urad=float(scatter.turn_urad[part]) if shows else None,
        )

    def group(self, name: str, rows: BoolArray) -> PredictedGroup:
        """Return the figures of some readings (n,) of one part."""
        observations, part = self.observations, int(self.observations.part[rows][0])
        seen, errors = np.zeros_like(self.residual), np.zeros_like(self.residual)
        seen[observations.part == part] = observations.arcminutes(self.residual, part)
        errors[observations.part == part] = observations.arcminutes(self.effects, part)
        right, down = seen[rows].mean(axis=0)
        reduced = _mean_square(self.residual, rows)
        rms, by_effects = (float(np.sqrt(np.mean(each[rows] ** 2))) for each in (seen, errors))
        return PredictedGroup(
            name,
            PART_NAMES[part],
            len(np.unique(observations.group[rows])),
            int(rows.sum()),
            rms,
            (float(right), float(down)),
            rms / float(np.sqrt(reduced)) if reduced > 0.0 else 0.0,
            by_effects,
            reduced,
            _mean_square(self.white, rows),
            None if self.by_own is None else _mean_square(self.by_own, rows),
        )


def _mean_square(residual: FloatArray, rows: BoolArray) -> float:
    """Return the mean square per axis over the predicted ones of some readings (n,); NaN if none is."""
    values = residual[rows]
    values = values[np.isfinite(values).all(axis=1)]
    return float(np.mean(values**2)) if len(values) else float("nan")

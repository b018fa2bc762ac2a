"""Prediction of a session by a bench model that was not fitted to it: errors by part, target distance and capture.

Noise and repeatability are measured as in a diagnosis (`noise`, `scatter`); no cause is fitted. The errors
of the bench's effects, as their covariances state them, are errors of all readings in common.
"""

from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from wlr_render.bench.bench import Bench
from wlr_render.bench.bench_effects import AnyFunction, BenchEffect
from wlr_render.bench.simulate_session import simulate
from wlr_render.captures.session import Session
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

_FEW = 400  # number of readings from which the principal errors are chosen
_TELLING = 0.02  # rms change of the readings, in sigma, below which an error is left out
_DECIMALS = 6  # decimals kept of changes in sigma: the precision of the solved viewing directions
_NEGLIGIBLE = 1e-6  # variance of coefficients, relative to the largest of their effect, that counts as zero


@dataclass(frozen=True)
class PredictedGroup:
    """Prediction errors of some readings of one part. No value is fitted to these readings.

    Attributes:
        name: name of the readings.
        part: part of the session.
        captures, readings: numbers of captures and of readings.
        rms_arcmin: residual, rms per axis.
        mean_arcmin: mean residual, right and down.
        noise_arcmin: stated noise per axis.
        effects_arcmin: standard error of the prediction per axis, rms, from the covariances of the bench's effects.
        reduced_chi_squared: mean square of the residual over the stated variance.
        whitened: mean square of the whitened residual: over the measured variance, less the camera motions that the
            repeatability allows and the errors of the bench's effects.
        by_own_bench: reduced chi-squared with the session's own bench; None if that bench is not known.
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
    """Prediction errors of a part of the session.

    Attributes:
        is_noise: whether noise plus the usual repeatability of stages explains the residual; a motion common to all
            captures is an error of the bench.
        shift_um, turn_urad: repeatability: standard deviations of the camera's position and rotation per axis; None
            for a single capture and at run time.
    """

    is_noise: bool
    shift_um: float | None
    turn_urad: float | None


@dataclass(frozen=True)
class BenchPrediction:
    """Comparison of a session with the prediction of a bench.

    Attributes:
        session: name of the session.
        reduced_chi_squared: reduced chi-squared of all readings with the stated noise.
        by_own_bench: the same with the session's own bench; None if that bench is not known.
        without_slip: the same without the slip that the bench states; None if it states none.
        parts, distances, captures: prediction errors of each part, target distance and capture.
        outliers: number of readings far from their neighbours in the photograph; no figure includes them.
        unseen: number of readings that the bench does not predict.
        observations: the predicted readings.
        residual: (n, 2) measured minus predicted, in units of the stated sigma.
        used: (n,) mask of the readings that are not outliers.
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
        """True if every part is predicted to within noise and repeatability."""
        return all(part.is_noise for part in self.parts)


def predict_session(bench: Bench, session: Session, own: Bench | None = None) -> BenchPrediction:
    """Compare the readings of a session with the prediction of a bench; one capture is enough.

    Args:
        bench: bench with the target poses of the session (`session_folder.bench_for_session`).
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
    noise = noise_of(observations, residual)
    used = ~noise.outlier
    errors = effect_errors(predictor)
    by_noise = (observations.sigma_px / noise.sigma_px)[used, None, None]
    readings = WeighedReadings.of(predictor.with_sigma(noise.sigma_px).of_rows(used), noise)
    readings = replace(readings, effects=errors[used] * by_noise, effect_sizes=np.ones(errors.shape[2]))
    found = fit(readings, Explanation(), Scatter.usual(len(observations.captures)), 0)
    if found is None:
        raise BadInputError(f"{session.name}: the bench does not predict every reading; check its stage and targets.")
    scatter, systematic = _about_common_motions(readings, found)
    white = np.full(residual.shape, np.nan)
    # A fit scales noise until its residual is of unit size.
    white[used] = readings.whitening(scatter)(found.at.residual) * scatter.noise[readings.observations.part, None]
    group = partial(_group, observations, residual, by_own, white, np.sqrt(np.sum(errors**2, axis=2)))

    def part(number: int) -> PredictedPart:
        figures = group(PART_NAMES[number], used & (observations.part == number))
        shows = number != RUN_TIME and figures.captures > 1
        return PredictedPart(
            **vars(figures),
            is_noise=number not in systematic and scatter.is_ordinary(number, DEFAULT.material_excess),
            shift_um=float(scatter.shift_um[number]) if shows else None,
            turn_urad=float(scatter.turn_urad[number]) if shows else None,
        )

    def groups(named: dict[str, BoolArray]) -> tuple[PredictedGroup, ...]:
        return tuple(group(name, used & rows) for name, rows in named.items() if np.any(used & rows))

    still = replace(bench, mount=replace(bench.mount, slip_time_s=np.inf))
    return BenchPrediction(
        session.name,
        _mean_square(residual, used),
        None if by_own is None else _mean_square(by_own, used),
        _mean_square(residual_by(still), used) if np.isfinite(bench.mount.slip_time_s) else None,
        tuple(part(int(number)) for number in np.unique(observations.part[used])),
        groups(observations.target_distances()),
        groups({str(name): observations.group == number for number, name in enumerate(observations.captures)}),
        int(np.sum(noise.outlier)),
        sum(0 if each is None else len(each) for each in session.plan.parts) - len(observations),
        observations,
        residual,
        used,
    )


def _about_common_motions(readings: WeighedReadings, found: Fit) -> tuple[Scatter, set[int]]:
    """Return the scatter of captures about the common motion of their part, and the parts with a clear common motion.

    A common motion is an error of the bench. A scatter about zero would count it as repeatability.
    """
    observations, scatter, systematic = readings.observations, found.scatter, set[int]()
    for part in np.unique(observations.part[observations.part != RUN_TIME]):
        rows = observations.part == part
        if len(np.unique(observations.group[rows])) < 2:
            continue
        motions, sigma = readings.camera_motions * rows[:, None, None], np.repeat([UNUSUAL_SHIFT, UNUSUAL_TURN], 3)
        sums = readings.sums(found.at.residual, motions, sigma=sigma)
        _, without = best_scatter(sums.of_columns(np.arange(0)), found.scatter)
        about, cost = best_scatter(sums, found.scatter)
        if LOG10_ODDS * (without - cost) > DEFAULT.least_log10_odds:
            systematic.add(int(part))
            mine = np.arange(len(PART_NAMES)) == part
            new, old = (each.vector().reshape(3, -1) for each in (about, scatter))
            scatter = scatter.at(np.where(mine, new, old).ravel())
    return scatter, systematic


def _group(
    observations: Observations,
    residual: FloatArray,
    by_own: FloatArray | None,
    white: FloatArray,
    effects: FloatArray,
    name: str,
    rows: BoolArray,
) -> PredictedGroup:
    """Return the prediction errors of some readings of one part.

    Args:
        observations: all readings.
        residual, by_own: (n, 2) residual with the bench and with the session's own, in units of the stated sigma.
        white: (n, 2) whitened residual with the bench.
        effects: (n, 2) standard errors from the bench's effects, in units of the stated sigma.
        name: name of the readings.
        rows: mask (n,) of the readings.
    """
    part = int(observations.part[rows][0])
    mine = rows[observations.part == part]
    seen, errors = (observations.arcminutes(each, part)[mine] for each in (residual, effects))
    right, down = seen.mean(axis=0)
    reduced = _mean_square(residual, rows)
    rms, by_effects = (float(np.sqrt(np.mean(each**2))) for each in (seen, errors))
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
        _mean_square(white, rows),
        None if by_own is None else _mean_square(by_own, rows),
    )


def _mean_square(residual: FloatArray, rows: BoolArray) -> float:
    """Return the mean square per axis over the predicted readings in a mask (n,); NaN if none is predicted."""
    values = residual[rows]
    values = values[np.isfinite(values).all(axis=1)]
    return float(np.mean(values**2)) if len(values) else float("nan")


def effect_errors(predictor: Predictor) -> FloatArray:
    """Return the change (n, 2, k) of the predicted readings, in sigma, by the principal errors of the bench's effects.

    Each principal error is one standard error and independent of the others, because the effects of a bench are
    independent of each other. Effects without a covariance are exact.
    """
    effects = predictor.observations.nominal.effects
    roots = [_root(effect) for effect in effects]
    ends = np.cumsum([root.shape[1] for root in roots])
    count = int(ends[-1]) if roots else 0
    nothing = np.zeros((len(predictor.observations), 2, 0))
    if not count:
        return nothing

    def change(by: Predictor, errors: FloatArray) -> FloatArray:
        """Return the change (n, 2) of the readings for errors (count,) of all effects."""
        parts = np.split(errors, ends[:-1])
        moved = (_moved(*each) for each in zip(effects, roots, parts, strict=True))
        bench = replace(by.observations.nominal, effects=tuple(moved))
        away = by.residual(Explanation()) - by.residual_of_bench(bench)
        return np.asarray(np.round(np.nan_to_num(away), _DECIMALS), np.float64)

    few = predictor.of_rows(predictor.observations.spread(_FEW))
    columns = np.stack([change(few, error).ravel() for error in np.eye(count)], axis=1)
    sizes, axes = np.linalg.svd(columns, full_matrices=False)[1:]
    telling = axes[sizes > _TELLING * np.sqrt(len(columns))]
    return np.stack([change(predictor, axis) for axis in telling], axis=-1) if len(telling) else nothing


def _root(effect: BenchEffect) -> FloatArray:
    """Return a square root (p, k) of the covariance of an effect's coefficients."""
    if effect.covariance is None:
        return np.zeros((0, 0))
    values, axes = np.linalg.eigh(effect.covariance)
    kept = values > _NEGLIGIBLE * values.max(initial=0.0)
    return np.asarray(axes[:, kept] * np.sqrt(values[kept]))


def _moved(effect: BenchEffect, root: FloatArray, errors: FloatArray) -> BenchEffect:
    """Return the effect with errors (k,), in standard errors, added to its coefficients."""
    function = effect.function
    if not errors.any() or isinstance(function, AnyFunction):
        return effect
    coefficients = function.coefficients + (root @ errors).reshape(function.coefficients.shape)
    return replace(effect, function=replace(function, coefficients=coefficients))

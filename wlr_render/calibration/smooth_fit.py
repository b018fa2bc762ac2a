"""Fits of smooth polynomials to captures by maximum evidence: one mechanism for all kinds of models.

The readings decide how smooth the optics are (`smooth_prior.py`). What the readings of one capture share, a small shift
and turn of the camera, is unknown, too; its size is the repeatability of the stage, which the captures state or the
readings tell. They also tell which terms matter (`fit_within`). No design is refused: where camera positions are few,
the posterior is wide.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from wlr_render.calibration.moved_captures import CaptureMotion, moved_odds, usual_motion
from wlr_render.calibration.posterior_spread import lower_root, spread_of
from wlr_render.calibration.readings import (
    FitReadings,
    Limits,
    Trend,
    design_of,
    free_part,
    motion_columns,
    polynomial_of,
    response_of,
    rows_by_capture,
    sums_of,
)
from wlr_render.calibration.smooth_prior import (
    LEAST_MOTION,
    SHIFT,
    TURN,
    MotionFactors,
    Stage,
    motion_scale,
    motion_sizes,
    motion_start,
    noise_floor,
    prior_squares,
    search_starts,
    smoothness_prior,
)
from wlr_render.errors import BadInputError
from wlr_render.models.spread import Covariance
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray
from wlr_render.numerics.evidence import Prior, Sums, maximise, posterior
from wlr_render.numerics.polynomial import Box, Polynomial, basis, total_degree
from wlr_render.numerics.posterior import Posterior
from wlr_render.numerics.shared_noise import SharedNoise, find_shared_noise, neighbour_distance

_GROSS, _LOST = 5.0, 10.0  # residual over noise from which a reading's weight falls, and where it ends
_BEYOND = 0.05  # share of a fit's variance that is expected of the terms beyond its own before it gets more of them
_UNSEEN = 0.1  # of the least noise: what terms beyond may always add
_WIDENINGS = 3
_MOTION_ROUNDS = 3
_ROUNDS = 4  # of outlier weights
_MAD_OF_RAYLEIGH = 1.17741  # median length of a pair of standard normal numbers
_SMOOTH_ORDER = 3  # of the place: motions that vary with it no faster are no motions
_REST_IF_UNKNOWN, _REST_IF_STATED = 0.5, 0.35  # share of the motions that is left to tell their sizes
_NEAR_CLEAREST = 0.7  # of the odds of the clearest one: what is less clear may be its doing
_ANY_MOTION = 0.03  # metres, radians: prior size of the motion of a capture that stands out
_ALIKE = 0.05  # shares of the noise's variance that count as the same
_SETTLED = 0.02  # largest distance of a logarithm from its optimum where the search for it ends
_SIDES_DIFFER = 0.1  # logarithm of the sizes of the motions of a headset's display captures over the others'
_MOST, _MOST_THAT_MOVE = 0.25, 0.5  # share of the captures that may be left out, and that may seem to have moved
_ROUNDS_OF_MOTIONS = 8  # fits without some of the captures
_ORDERS_BEYOND, _ENOUGH_ORDERS = 2, 7  # that a capture is judged by beside those of a fit, up to so many in all
_FEW_ORDERS = 3  # in all, of the fit that finds captures far off
_CONTRADICTION_ARCMIN = 30.0  # more noise than any camera has


@dataclass(frozen=True)
class MotionAgreement:
    """Motions of the camera as the captures state them, beside those that a fit found.

    Attributes:
        shift_m, turn_rad: stated, rms per axis over all captures.
        shift_factor, turn_factor: found over stated.
        shift_sigmas, turn_sigmas: how many standard deviations of their logarithms the factors are from 1, by what the
            captures state of them and by what the readings alone say.
    """

    shift_m: float
    turn_rad: float
    shift_factor: float
    turn_factor: float
    shift_sigmas: float
    turn_sigmas: float


@dataclass(frozen=True)
class SmoothFit:
    """A fitted polynomial with its posterior covariance, and what the fit found of the bench.

    Attributes:
        polynomial: its outputs are those of block 0, then block 1, and so on.
        posterior: of coefficients, motions and hyperparameters.
        readings: what was fitted.
        kept: (n,) weights of the readings, from 1 down to 0 for outliers.
        moved: captures that moved by far more than the others; their weights are zero.
        beyond: (blocks,) variance of each output of a block that is expected of terms beyond those of the fit; None for
            limits that the user states.
    """

    polynomial: Polynomial
    posterior: Posterior
    readings: FitReadings
    kept: FloatArray
    moved: tuple[CaptureMotion, ...]
    _prior: Prior
    _columns: FloatArray | None
    _start: Polynomial
    _sums: Sums
    _motion_curvature: FloatArray | None = None
    beyond: FloatArray | None = None

    @property
    def noise(self) -> float:
        """Found standard deviation of a reading per axis, over the stated one; in arcminutes where none is stated."""
        return self.posterior.noise

    @property
    def shift_m(self) -> float:
        """Repeatability of the captures' positions, rms per axis; 0 where no motion was modelled."""
        return float(self._motion_factors[0] * motion_scale(self.readings)[0])

    @property
    def turn_rad(self) -> float:
        """Wobble of the captures' orientations, rms per axis; 0 where no motion was modelled."""
        return float(self._motion_factors[1] * motion_scale(self.readings)[1])

    @property
    def motion_agreement(self) -> MotionAgreement | None:
        """Whether the readings agree with the motions that the captures state; None where they state none."""
        known = self.readings.motion_prior
        if known is None or self._motion_curvature is None:
            return None
        shift_m, turn_rad = motion_scale(self.readings)
        # The prior pulls the logarithms of the factors to its mean, the readings to where they alone would have them.
        mean, sigma = self._prior.expected[-2:].T
        curvature = np.maximum(self._motion_curvature, 1e-9)
        off = np.log(self._motion_factors)
        alone = off + (off - mean) / sigma**2 / curvature
        # Readings that say nothing have nearly no curvature: what the search left to go would look like a pull.
        unfinished = _SETTLED / sigma**2 / curvature
        sigmas = np.abs(alone) / np.sqrt(known.log_sigma**2 + 1.0 / curvature + unfinished**2)
        return MotionAgreement(float(shift_m), float(turn_rad), *map(float, self._motion_factors), *map(float, sigmas))

    @property
    def motion_factors(self) -> MotionFactors | None:
        """What other captures of the same bench may expect of their motions; None where these state none."""
        known = self.readings.motion_prior
        if known is None or self._motion_curvature is None:
            return None
        sigma = 1.0 / np.sqrt(self._motion_curvature + known.log_sigma**-2)
        return MotionFactors(np.log(self._motion_factors), np.hypot(sigma, _SIDES_DIFFER))

    @property
    def _motion_factors(self) -> FloatArray:
        """(2,) of shift and turn: the sizes found over those known before."""
        hyper = self.posterior.hyper
        return np.exp([hyper.get("shift", -np.inf), hyper.get("turn", -np.inf)])

    @property
    def _motion_sizes(self) -> FloatArray:
        """(captures, 6) prior sizes of the shifts and turns, as found; (captures, 0) where no motion was modelled."""
        groups = self.posterior.group_mean.shape[0]
        size = np.exp(self._prior.group_offset + self._prior.group_features @ self._hyper)
        return np.broadcast_to(size, (groups, len(self._prior.group_features)))

    def require_agreement(self, what: str, sigma_arcmin: FloatArray) -> None:
        """Refuse readings that contradict each other beyond any noise.

        Args:
            what: the readings, in a sentence.
            sigma_arcmin: (n,) their stated sigma.

        Raises:
            BadInputError: they do.
        """
        stated = float(np.median(sigma_arcmin)) or 1.0
        if (found := self.noise * stated) > _CONTRADICTION_ARCMIN:
            raise BadInputError(
                f"{what} contradict each other: no smooth optics brings them within {found:.0f}' of one another; check "
                "that viewpoints and directions are in the device frame (metres, OpenXR axes), that pixels count from "
                "the panel's outer top left corner, and that rows belong together."
            )

    @property
    def _hyper(self) -> FloatArray:
        return np.array(list(self.posterior.hyper.values()))

    @property
    def stage(self) -> Stage:
        """Repeatability and wobble as found."""
        return self.shift_m, self.turn_rad

    @property
    def determined(self) -> tuple[float, int]:
        """How many coefficients and parameters of the trend the readings determine, and of how many."""
        found, own = self.posterior, self.readings.coefficients
        variance = np.diag(found.side_covariance)[found.mixed_mean.size :]
        others = float(np.sum(1.0 - variance / self._motion_sizes.ravel() ** 2))
        for follow in found.by_side[:, :, own:]:  # waves of the print
            variance = np.diag(found.alone)[own:] + np.einsum("sc,st,tc->c", follow, found.side_covariance, follow)
            others += float(np.sum(1.0 - variance / self._prior.sizes(self._hyper)[own:] ** 2))
        return found.determined - others, 2 * own + found.mixed_mean.size

    @property
    def trend_parameters(self) -> tuple[FloatArray, FloatArray]:
        """Posterior mean (parameters,) and covariance (parameters, parameters) of the trend's parameters."""
        count = self.readings.trend.parameters if self.readings.trend else 0
        return self.posterior.mixed_mean[:count], self.posterior.side_covariance[:count, :count]

    def with_trend(self, trend: Trend) -> "SmoothFit":
        """The fit with another prior of the trend's parameters, at the same hyperparameters and weights."""
        readings = replace(self.readings, trend=trend)
        sums = sums_of(readings, self._start, self._columns, self.kept)
        found = posterior(sums, self._prior, self._hyper)
        polynomial = polynomial_of(readings, self._start, found)
        return replace(self, polynomial=polynomial, posterior=found, readings=readings, _sums=sums)

    def orders_that_matter(self, widest: FitReadings) -> IntArray | None:
        """The fewest of the terms of `widest` with which the others do not matter; None where no more are needed."""
        most = _BEYOND * self.noise**2 * self.determined[0] / self._sums.count
        most = max(most, (_UNSEEN * noise_floor(self.readings)) ** 2)
        readings = self.readings
        weight = readings.weight.reshape(-1, *[1] * (readings.multiplier.ndim - 1))
        by_block = np.mean((readings.multiplier * weight) ** 2, axis=tuple(range(readings.multiplier.ndim - 1)))
        square = by_block @ prior_squares(widest, self.posterior.hyper)
        lacking = ~_among(widest.orders, self.readings.orders)
        if square[lacking].sum() <= most:
            return None
        rank = np.argsort(-square, kind="stable")
        rest = np.cumsum(square[rank][::-1])[::-1]
        chosen = np.sort(rank[rest > 0.5 * most])
        return widest.orders[chosen] if lacking[chosen].any() else None

    def beyond_of(self, widest: FitReadings) -> FloatArray:
        """(blocks,) variance of an output that is expected of the terms of `widest` that the fit lacks."""
        lacking = ~_among(widest.orders, self.readings.orders)
        return np.asarray(prior_squares(widest, self.posterior.hyper)[:, lacking].sum(axis=1))

    @cached_property
    def spread(self) -> Covariance:
        """Low-rank factors of the covariance of `polynomial`."""
        return self._with_common(self.readings, self.posterior, self.polynomial, self.kept)

    def _with_common(
        self, readings: FitReadings, found: Posterior, polynomial: Polynomial, kept: FloatArray
    ) -> Covariance:
        """Covariance of a fit with these prior sizes, common errors included."""
        if readings.common is None:
            return spread_of(readings, found, beyond=self.beyond)
        width = self._prior.sizes(np.array(list(found.hyper.values()))) / found.noise
        sums = sums_of(readings, None, None, kept)
        response = response_of(readings, polynomial, kept, sums, width, found.noise)
        return spread_of(readings, found, response, self.beyond)

    @property
    def _captures(self) -> int:
        return int(self.readings.capture.max()) + 1

    def left_out(self, rows: BoolArray) -> tuple[float, float]:
        """Predict readings (n,) bool by a fit to the others at the same hyperparameters.

        Returns:
            rms length of the prediction's errors in arcminutes, and what the fit expects of it.
        """
        readings, out = self.readings, rows & (self.kept > 0)
        chosen = readings.select(out)
        columns = None if self._columns is None else self._columns[out]
        # Readings of a capture share noise: those that stay enter anew.
        touched = np.isin(readings.capture, chosen.capture)
        sums = self._sums - (self._sums_of(touched) - self._sums_of(touched & ~out))
        rest = posterior(sums, self._prior, self._hyper, evidence=False)
        polynomial = polynomial_of(readings, self._start, rest)
        error = (chosen.observed - chosen.values(polynomial)) * chosen.metric[:, None]
        spread = spread_of(readings, rest, beyond=self.beyond)  # without common errors: what was left out shares them
        covariance = spread.covariance(chosen.inputs)
        if chosen.mixed:
            variance = np.einsum("nrb,nbc,nrc->n", chosen.multiplier, covariance, chosen.multiplier)
        else:
            by_block = sum(covariance[:, axis::2, axis::2] for axis in (0, 1))
            variance = np.einsum("nb,nbc,nc->n", chosen.multiplier, by_block, chosen.multiplier)
        variance = variance * chosen.metric**2 + 2.0 * (self.noise * chosen.metric / chosen.weight) ** 2
        if columns is not None:
            own = self._motion_sizes[chosen.capture]
            variance += np.einsum("nok,nk->n", columns**2, own**2) * chosen.metric**2
        return float(np.sqrt(np.mean(np.sum(error**2, axis=1)))), float(np.sqrt(np.mean(variance)))

    def _sums_of(self, rows: BoolArray) -> Sums:
        """Sums over some of the readings, whole captures or what is left of them."""
        columns = None if self._columns is None else self._columns[rows]
        return sums_of(self.readings.select(rows), self._start, columns, self.kept[rows], captures=self._captures)

    def spread_with(self, readings: FitReadings) -> Covariance:
        """Covariance that further readings would give: `readings` are those of this fit, then more, at this noise."""
        return self._spread(readings, np.concatenate([self.kept, np.ones(len(readings) - len(self.kept))]), self._hyper)

    def spread_from(self, readings: FitReadings, hyper: Mapping[str, float]) -> Covariance:
        """Covariance of a fit to other readings of optics as smooth as these.

        Args:
            readings: of the same headset, none beyond the box of this fit.
            hyper: hyperparameters, logarithms, in place of those found: "noise", "shift" and "turn".
        """
        values = [hyper.get(name, value) for name, value in self.posterior.hyper.items()]
        return self._spread(readings.within(self.readings.box), np.ones(len(readings)), np.array(values))

    def _spread(self, readings: FitReadings, kept: FloatArray, hyper: FloatArray) -> Covariance:
        columns, prior, readings = None, self._prior, readings.with_shared(self.readings.shared)
        if self._columns is not None:
            columns = motion_columns(readings, self.polynomial)
            prior = replace(prior, group_offset=np.log(motion_sizes(readings)))
        if readings.print_errors is None and self.readings.print_errors is not None:
            own = self.readings.coefficients
            prior = replace(prior, features=prior.features[:own], offset=0.0)
        sums = sums_of(readings, None, columns, kept)
        found = posterior(sums, prior, hyper, evidence=False)
        return self._with_common(readings, found, self.polynomial, kept)

    def with_motions(self, motion: FloatArray) -> Polynomial:
        """The polynomial that these readings would give if their cameras had moved by `motion`.

        Args:
            motion: (captures, 6) shift in metres, then turn in radians.
        """
        readings = self.readings
        if self._columns is None:
            return self.polynomial
        moved = np.einsum("nok,nk->no", self._columns, motion[readings.capture])
        sums = sums_of(replace(readings, observed=readings.observed - moved), self._start, self._columns, self.kept)
        return polynomial_of(readings, self._start, posterior(sums, self._prior, self._hyper, evidence=False))

    @property
    def prior_size(self) -> FloatArray:
        """(columns,) prior sizes of the coefficients of each output."""
        return self._prior.sizes(self._hyper)[: self.readings.coefficients]

    @property
    def coefficient_root(self) -> FloatArray:
        """F (columns, columns), F F' = posterior covariance of the coefficients of an output, the mean of both."""
        found = self.posterior
        own = self.readings.coefficients
        follow = [each[:, :own].T @ found.side_covariance @ each[:, :own] for each in found.by_side]
        covariance = found.alone[:own, :own] + np.mean(follow, axis=0)
        size = np.sqrt(np.diag(covariance))
        values, vectors = np.linalg.eigh(covariance / size[:, None] / size)
        return np.asarray(size[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))

    def whitened(self, readings: FitReadings, place: IntArray, places: int) -> list[FloatArray]:
        """Designs (n, columns) of an output in combinations of readings whose noise is 1 and independent.

        What motions of the camera, with the sizes found, add to the noise is averaged over both outputs.

        Args:
            readings: of the same headset, none beyond the box of this fit.
            place: (n,) numbers of the camera places. places: how many; one that sees nothing has a design of no rows.
        """
        readings = readings.within(self.readings.box)
        design = design_of(readings, slice(None), basis(readings.inputs, readings.orders, readings.box))
        weight = (readings.weight / self.noise)[:, None]
        own = np.zeros((len(readings), 2, 6))
        if self._columns is not None:
            size = motion_sizes(readings) * np.exp(self._prior.group_features @ self._hyper)
            own = motion_columns(readings, self.polynomial) * (size[readings.capture] * weight)[:, None]
        found, shared = [], self.readings.shared
        for number in range(places):
            rows = np.flatnonzero(place == number)
            visit = readings.capture[rows]
            moved = own[rows].reshape(len(rows), 12)
            noise = np.eye(len(rows)) + 0.5 * (visit[:, None] == visit) * (moved @ moved.T)
            if shared is not None:
                own_field = (visit[:, None] == visit) * shared.correlation(readings.image[rows])
                noise += shared.share * (own_field - np.eye(len(rows)))
            found.append(
                np.asarray(np.linalg.solve(np.linalg.cholesky(noise), design[rows] * weight[rows]), np.float64)
            )
        return found


def fit_within(
    readings_of: Callable[[Limits], FitReadings],
    limits: Sequence[Limits],
    weights: FloatArray | None = None,
    stage: Stage | MotionFactors | None = None,
) -> SmoothFit:
    """Fit with the terms that matter, as the readings themselves tell.

    A fit within the first limits that can be computed finds how fast coefficients fall with their order. While that
    leads to expect more than `_BEYOND` of the fit's variance from the terms that it lacks, it is repeated with those of
    the last limits that matter. The variance of all others adds to that of the fit.

    Args:
        readings_of: (limits) -> readings.
        limits: the narrowest first; a single one holds whatever the readings tell.
        weights, stage: as of `fit`.

    Raises:
        BadInputError: as `fit`.
    """
    widest = readings_of(limits[-1])
    for each in limits[:-1]:
        try:
            smooth = fit(readings_of(each), None, weights, stage)
            break
        except np.linalg.LinAlgError:  # motions of the captures, of any size, stood in for what the limits cut off
            continue
    else:
        smooth = fit(widest, None, weights, stage)
    if len(limits) == 1:
        return smooth
    for _ in range(_WIDENINGS):
        orders = smooth.orders_that_matter(widest)
        if orders is None:
            break
        readings = replace(widest, orders=orders)
        try:
            smooth = fit(readings, smooth.posterior.hyper, weights, stage)
        except np.linalg.LinAlgError:
            smooth = fit(readings, None, weights, stage)
    return replace(smooth, beyond=smooth.beyond_of(widest))


def fit(
    readings: FitReadings,
    start_at: Mapping[str, float] | None = None,
    weights: FloatArray | None = None,
    stage: Stage | MotionFactors | None = None,
) -> SmoothFit:
    """Fit by maximum evidence.

    Args:
        readings: what was measured.
        start_at: hyperparameters of a fit to the same readings, to start from; None searches from several starts.
        weights: (n,) of the readings, 1 to 0 for outliers; None to find them. Evidence of models is comparable only
            with the same readings and weights.
        stage: repeatability and wobble, or what is known of them beside what the captures state; None to find them.

    Raises:
        BadInputError: the readings determine nothing, or contradict each other.
    """
    search = _Search(readings, free_part(readings), start_at, weights, stage)
    smooth = search.without(())
    if smooth._columns is None:
        return smooth
    if weights is not None:
        gone = np.setdiff1d(readings.capture, readings.capture[weights > 0])
        smooth = replace(smooth, moved=tuple(CaptureMotion(int(name), 0.0, 0.0, 0.0, 0.0) for name in gone))
        return replace(smooth, moved=tuple(_suspects(smooth)[1].values()))
    if not any(each.stands_out for each in _suspects(smooth)[0].values()):
        return smooth
    if readings.trend is None:  # few orders cannot follow a capture that is far off; many find those that are less so
        few = readings.orders.sum(axis=1) <= _FEW_ORDERS
        coarse = replace(search, readings=replace(readings, orders=readings.orders[few]), start_at=None)
        smooth = search.without(_without_moved(coarse, coarse.without(())).moved)
    return _without_moved(search, smooth)


def _without_moved(search: "_Search", smooth: SmoothFit) -> SmoothFit:
    """The fit without all captures that moved, from one without some of them."""
    captures, rejections = len(np.unique(search.readings.capture)), Counter[int]()
    most = int(_MOST * captures)
    for round_ in range(_ROUNDS_OF_MOTIONS):
        others, judged = _suspects(smooth)
        rejections.update(name for name, each in judged.items() if not each.stands_out)
        moved = tuple(each for each in judged.values() if each.stands_out)
        # One capture that moved makes others seem to have moved: the clearest go first, and some come back. One that
        # came back goes again only if it is clear, and stays when it came back twice.
        least = _NEAR_CLEAREST * max((each.log10_odds for each in others.values()), default=0.0)
        more = tuple(
            each
            for name, each in others.items()
            if each.log10_odds >= least and rejections[name] <= int(each.stands_out)
        )
        if not more and len(moved) == len(judged):
            return replace(smooth, moved=moved)
        if len(moved) + len(more) > most or round_ == _ROUNDS_OF_MOTIONS - 1:
            # Where most captures seem to have moved, they contradict each other, and none of them is to blame.
            clear = len(moved) + sum(each.stands_out for each in others.values())
            moved = moved if clear <= _MOST_THAT_MOVE * captures else ()
            break
        smooth = search.without(moved + more)
    return replace(smooth, moved=moved) if len(moved) == len(judged) else search.without(moved)


@dataclass(frozen=True)
class _Search:
    """Fits to the same readings without some of the captures; see `fit`."""

    readings: FitReadings
    start: Polynomial
    start_at: Mapping[str, float] | None
    weights: FloatArray | None
    stage: Stage | MotionFactors | None

    def without(self, moved: tuple[CaptureMotion, ...]) -> SmoothFit:
        """Fit to all captures but those that moved."""
        readings, start = self.readings, self.start
        stays = ~np.isin(readings.capture, [each.capture for each in moved])
        kept = stays * (np.ones(len(readings)) if self.weights is None else self.weights)
        prior = smoothness_prior(readings, moving=False)
        starts = [dict(self.start_at)] if self.start_at is not None else search_starts(readings, prior, start, kept)
        is_noisy = bool(np.any(readings.sigma > 0))
        moves = readings.motion is not None and is_noisy
        columns: FloatArray | None = None
        if is_noisy:  # a fit that takes shared noise for optics leaves none to be found
            spacing = neighbour_distance([readings.image[rows] for rows in rows_by_capture(readings.capture)])
            readings = readings.with_shared(SharedNoise(0.5, 1.4 * spacing) if spacing > 0 else None)
        still = sums_of(readings, start, None, kept)
        for _ in range(_ROUNDS):
            found = maximise(still, prior, starts)
            polynomial = polynomial_of(readings, start, found)
            columns = motion_columns(readings, polynomial) if moves else None
            weights = kept if self.weights is not None else _weights(readings, polynomial, columns, kept) * stays
            shared = _shared_noise(readings, polynomial, found, weights) if is_noisy else None
            if np.allclose(weights, kept, atol=0.05) and _alike(shared, readings.shared):
                break
            kept, starts, readings = weights, [dict(found.hyper)], readings.with_shared(shared)
            still = sums_of(readings, start, None, kept)
        if columns is None:
            return SmoothFit(polynomial, found, readings, kept, moved, prior, columns, start, still)
        if isinstance(self.stage, MotionFactors):
            prior = smoothness_prior(readings, moving=True, factors=self.stage)
        else:
            prior = smoothness_prior(readings, moving=True)
        if isinstance(self.stage, tuple):
            prior.bounds[-2:] = np.log(np.maximum(self.stage, LEAST_MOTION) / motion_scale(readings))[:, None]
        rough, hyper = _rough(readings, kept), dict(found.hyper)
        of_rough, curvature = replace(prior, group_offset=0.0), np.zeros(2)
        # Motions act through the slopes of the fit, which motions spoil: both are found in turns.
        for round_ in range(_MOTION_ROUNDS):
            columns = motion_columns(readings, polynomial)
            sums = sums_of(readings, start, columns, kept, still=still)
            if round_ == 0:
                hyper = motion_start(sums.combined(rough), of_rough, hyper)
            else:
                found = maximise(sums.combined(rough), of_rough, [hyper])
                hyper, curvature = dict(found.hyper), found.curvature[-2:]
            found = posterior(sums, prior, np.array(list(hyper.values())))
            polynomial = polynomial_of(readings, start, found)
        return SmoothFit(polynomial, found, readings, kept, moved, prior, columns, start, sums, curvature)


def _shared_noise(
    readings: FitReadings, polynomial: Polynomial, found: Posterior, kept: FloatArray
) -> SharedNoise | None:
    """Noise that neighbouring readings of a capture share, by what a polynomial leaves of good readings."""
    off = (readings.observed - readings.values(polynomial)) * readings.weight[:, None]
    captures = [rows[kept[rows] == 1.0] for rows in rows_by_capture(readings.capture)]
    root = lower_root(found.alone)

    def unsure(number: int, rows: IntArray) -> FloatArray:
        chosen = captures[number][rows]
        if readings.mixed:
            return np.zeros((len(chosen), 0))
        return np.asarray((readings.design(chosen) * readings.weight[chosen, None]) @ root)

    return find_shared_noise([readings.image[rows] for rows in captures], [off[rows] for rows in captures], unsure)


def _alike(shared: SharedNoise | None, before: SharedNoise | None) -> bool:
    """Whether two findings of noise that neighbours share are alike."""
    if shared is None or before is None:
        return shared is before
    return shared.length == before.length and abs(shared.share - before.share) < _ALIKE


def _among(orders: IntArray, others: IntArray) -> BoolArray:
    """(n,) whether each row of orders (n, variables) is one of others (m, variables)."""
    known = set(map(tuple, others.tolist()))
    return np.array([tuple(row) in known for row in orders.tolist()], dtype=bool)


def _rough(readings: FitReadings, kept: FloatArray) -> FloatArray:
    """Combinations (6, captures, k) of the captures' motions without those that vary smoothly with the place.

    Smooth motions are another way to write the place; where the orders end before the optics do, they would be taken
    for motions of the camera, of any size. The unknowns of the combinations are standard normal before the fit, up to
    the factors.
    """
    captures = int(readings.capture.max()) + 1
    used = np.flatnonzero(np.bincount(readings.capture, kept > 0, captures))
    place = readings.inputs[:, readings.is_place]
    count = np.maximum(np.bincount(readings.capture, minlength=captures), 1)
    middle = np.stack([np.bincount(readings.capture, axis, captures) / count for axis in place.T], axis=-1)[used]
    orders = [total_degree(place.shape[1], order) for order in range(_SMOOTH_ORDER + 1)]
    rest = _REST_IF_UNKNOWN if readings.motion_prior is None else _REST_IF_STATED
    smooth = [order for order in orders if len(order) <= (1.0 - rest) * len(used)]
    if not smooth:
        return np.zeros((6, captures, 0))
    values, extent, _ = np.linalg.svd(basis(middle, smooth[-1], Box.around(middle)), full_matrices=False)
    values = values[:, extent > 1e-6 * extent[0]]
    rough = np.zeros((6, captures, len(used) - values.shape[1]))
    for axis, own in enumerate(motion_sizes(readings)[used].T):
        # In units of the prior sizes motions are independent, and so are their parts along and across smooth ones.
        across = np.linalg.qr(values / own[:, None], mode="complete")[0][:, values.shape[1] :]
        rough[axis, used] = own[:, None] * across
    return rough


def _with_terms_beyond(readings: FitReadings) -> FitReadings:
    """Readings of a fit of few orders with more of them: what the orders cut off looks like motions of the camera."""
    limits, variables = readings.limits, readings.is_place
    if readings.trend is not None or not _FEW_ORDERS < limits.total < _ENOUGH_ORDERS:
        return readings
    most = (limits.pixel, limits.place, limits.total)
    more = Limits(*(min(order + _ORDERS_BEYOND, _ENOUGH_ORDERS) for order in most))
    wider = replace(readings, orders=more.orders(int(np.sum(~variables)), int(np.sum(variables))))
    return wider.within(readings.box)


def _suspects(smooth: SmoothFit) -> tuple[dict[int, CaptureMotion], dict[int, CaptureMotion]]:
    """Captures that may have moved, and those left out before, measured by the rest; by their indices."""
    readings, out = smooth.readings, [each.capture for each in smooth.moved]
    kept = np.where(np.isin(readings.capture, out), 1.0, smooth.kept)
    offset = np.log(motion_sizes(readings))
    hyper = smooth.posterior.hyper
    offset[out, SHIFT], offset[out, TURN] = (np.log(_ANY_MOTION) - hyper[name] for name in ("shift", "turn"))
    columns, judge = motion_columns(readings, smooth.polynomial), _with_terms_beyond(readings)
    still = smooth._sums if judge is readings and not out else None
    prior = smoothness_prior(judge, moving=True)
    found = posterior(
        sums_of(judge, smooth._start, columns, kept, still=still), replace(prior, group_offset=offset), smooth._hyper
    )
    size = np.exp(offset + smooth._prior.group_features @ smooth._hyper)
    factors = np.exp(smooth._prior.group_features @ smooth._hyper)
    usual = usual_motion(readings, factors, found.group_mean, np.setdiff1d(readings.capture, out))
    off = (readings.observed - readings.values(smooth.polynomial)) * readings.metric[:, None]
    found_of = {}
    for name in map(int, np.unique(readings.capture)):
        block = found.mixed_mean.size + 6 * name + np.arange(6)
        covariance = found.side_covariance[np.ix_(block, block)]
        odds, motion = moved_odds(found.group_mean[name], covariance, size[name], usual[name])
        shift, turn = (float(np.linalg.norm(motion[part])) for part in (SHIFT, TURN))
        arcmin = float(np.linalg.norm(off[readings.capture == name].mean(axis=0)))
        found_of[name] = CaptureMotion(name, shift, turn, arcmin, odds)
    before = {name: found_of.pop(name) for name in out}
    return {name: each for name, each in found_of.items() if each.is_suspect}, before


def _weights(readings: FitReadings, polynomial: Polynomial, columns: FloatArray | None, kept: FloatArray) -> FloatArray:
    """1 for readings near the model, falling to 0 for those far off; Hampel's descending function.

    Where cameras may have moved, a reading is judged beside the others of its capture.
    """
    off = (readings.observed - readings.values(polynomial)) * readings.weight[:, None]
    if columns is not None:
        columns = columns * readings.weight[:, None, None]
        for rows in rows_by_capture(readings.capture):
            design = (columns[rows] * kept[rows, None, None]).reshape(-1, 6)
            size = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
            motion = np.linalg.lstsq(design / size, (off[rows] * kept[rows, None]).ravel(), rcond=1e-6)[0] / size
            off[rows] -= columns[rows] @ motion
    far = np.linalg.norm(off, axis=1)
    far = far / max(float(np.median(far[kept > 0])) / _MAD_OF_RAYLEIGH, noise_floor(readings))
    fall = _GROSS / np.maximum(far, _GROSS) * np.clip((_LOST - far) / (_LOST - _GROSS), 0.0, 1.0)
    return np.asarray(np.sqrt(np.where(far <= _GROSS, 1.0, fall)))

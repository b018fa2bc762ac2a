"""A smooth polynomial fitted to captures by maximum evidence, the same for all kinds of models.

The readings determine how smooth the optics are (`smooth_prior.py`). A small shift and turn of the camera in each
capture is also unknown; its size is the repeatability of the stage, which the captures state or the fit estimates. The
readings also determine which terms matter (`smooth_search.py`). No design is refused: with few camera positions, the
posterior is wide.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from wlr_render.calibration.moved_captures import CaptureMotion, MotionAgreement
from wlr_render.calibration.posterior_spread import label_response, principal_root, spread_of
from wlr_render.calibration.reading_sums import Response, label_values, polynomial_of, response_of, sums_of
from wlr_render.calibration.readings import FitReadings, Trend, design_of, motion_columns
from wlr_render.calibration.smooth_prior import (
    Stage,
    motion_scale,
    motion_sizes,
    noise_floor,
    prior_squares,
    smoothness_prior,
)
from wlr_render.errors import BadInputError
from wlr_render.models.spread import Covariance
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray
from wlr_render.numerics.evidence import Prior, Sums, posterior
from wlr_render.numerics.polynomial import Polynomial, basis
from wlr_render.numerics.posterior import Posterior

_BEYOND = 0.05  # share of a fit's variance expected from missing terms above which the fit gets more terms
_UNSEEN = 0.1  # error that missing terms may always add, as a share of the least noise
_SETTLED = 0.02  # largest distance of a logarithm from its optimum at the end of the search
_SIDES_DIFFER = 0.1  # sigma of the log ratio of stage errors between display and see-through captures
_CONTRADICTION_ARCMIN = 30.0  # noise that exceeds any camera's


@dataclass(frozen=True)
class SmoothFit:
    """A fitted polynomial with its posterior covariance, and the estimated errors of the bench.

    Attributes:
        polynomial: polynomial with the outputs of block 0, then block 1, and so on.
        posterior: posterior of coefficients, motions and hyperparameters.
        readings: the fitted readings.
        kept: (n,) weights of the readings, from 1 down to 0 for outliers.
        moved: captures that moved by far more than the others; their weights are zero.
        beyond: (blocks,) expected variance of the terms outside the fit, for each output of a block; None for limits
            stated by the user.
        of_labels: errors by label in addition to the fitted errors; None without a search for them.
        others: sources of the other model's errors by label, before and after this model's sources.
        unsure: captures whose camera moved, or where the optics are less smooth than the model; they keep their
            weights.
        prior: prior of coefficients and motions.
        columns: (n, 2, 6) change of the readings by the motions; None if no motions are modelled.
        start: the free part, which is subtracted in the sums.
        sums: sums over the readings, with their weights.
        curvature: (hyperparameters,) information of the readings on each; None if no motions are modelled.
    """

    polynomial: Polynomial
    posterior: Posterior
    readings: FitReadings
    kept: FloatArray
    moved: tuple[CaptureMotion, ...]
    prior: Prior
    columns: FloatArray | None
    start: Polynomial
    sums: Sums
    curvature: FloatArray | None = None
    beyond: FloatArray | None = None
    of_labels: Response | None = None
    others: tuple[tuple[str, ...], tuple[str, ...]] = ((), ())
    unsure: tuple[CaptureMotion, ...] = ()

    @property
    def noise(self) -> float:
        """Estimated sigma of a reading per axis, relative to the stated sigma; in arcminutes if none is stated."""
        return self.posterior.noise

    @property
    def shift_m(self) -> float:
        """Repeatability of the captures' positions, rms per axis; 0 if no motion was modelled."""
        return float(self._motion_factors[0] * motion_scale(self.readings)[0])

    @property
    def turn_rad(self) -> float:
        """Wobble of the captures' orientations, rms per axis; 0 if no motion was modelled."""
        return float(self._motion_factors[1] * motion_scale(self.readings)[1])

    @property
    def motion_agreement(self) -> MotionAgreement | None:
        """Comparison of fitted and stated motions; None without stated motions."""
        known = self.readings.motion_prior
        if known is None or self.curvature is None:
            return None
        shift_m, turn_rad = motion_scale(self.readings)
        # The prior pulls the factors' logarithms to its mean, and the readings pull them to `alone`.
        mean, sigma = self.prior.expected[-2:].T
        curvature = np.maximum(self.curvature[-2:], 1e-9)
        off = np.log(self._motion_factors)
        alone = off + (off - mean) / sigma**2 / curvature
        # With almost no curvature, from uninformative readings, the search's remaining distance would look like a pull.
        unfinished = _SETTLED / sigma**2 / curvature
        sigmas = np.abs(alone) / np.sqrt(known.log_sigma**2 + 1.0 / curvature + unfinished**2)
        return MotionAgreement(float(shift_m), float(turn_rad), *map(float, self._motion_factors), *map(float, sigmas))

    @property
    def stage(self) -> Stage:
        """Prior of the stage's errors for other captures of the same bench; empty if no motions were modelled."""
        if self.curvature is None:
            return {}
        names = self.prior.names
        told = [names.index(each.name) for each in self.readings.stage_terms] + [len(names) - 2, len(names) - 1]
        information = self.curvature[told] + self.prior.expected[told, 1] ** -2.0
        sigma = np.hypot(information**-0.5, _SIDES_DIFFER)
        return {names[row]: (float(self.hyper[row]), float(each)) for row, each in zip(told, sigma, strict=True)}

    @property
    def _motion_factors(self) -> FloatArray:
        """Ratios (2,) of estimated to prior size, for shift and turn."""
        hyper = self.posterior.hyper
        return np.exp([hyper.get("shift", -np.inf), hyper.get("turn", -np.inf)])

    def require_agreement(self, what: str, sigma_arcmin: FloatArray) -> None:
        """Refuse readings that contradict each other beyond any noise.

        Args:
            what: name of the readings in the error message.
            sigma_arcmin: (n,) stated sigma of the readings.

        Raises:
            BadInputError: the readings contradict each other.
        """
        stated = float(np.median(sigma_arcmin)) or 1.0
        if (found := self.noise * stated) > _CONTRADICTION_ARCMIN:
            raise BadInputError(
                f"{what} contradict each other: no smooth optics brings them within {found:.0f}' of one another; check "
                "that viewpoints and directions are in the device frame (metres, OpenXR axes), that pixels count from "
                "the panel's outer top left corner, and that rows belong together."
            )

    @property
    def hyper(self) -> FloatArray:
        """Estimated hyperparameters (hyperparameters,), logarithms."""
        return np.array(list(self.posterior.hyper.values()))

    @property
    def determined(self) -> tuple[float, int]:
        """Effective number of coefficients and trend parameters that the readings determine, and their total number."""
        found, own = self.posterior, self.readings.coefficients
        parameters, side = self.readings.parameters, len(found.side_covariance)
        variance = np.diag(found.side_covariance)[parameters:]
        others = float(np.sum(1.0 - variance / found.sizes[parameters:side] ** 2))
        for follow in found.by_side[:, :, own:]:
            variance = np.diag(found.alone)[own:] + np.einsum("sc,st,tc->c", follow, found.side_covariance, follow)
            others += float(np.sum(1.0 - variance / found.sizes[side + own :] ** 2))
        return found.determined - others, 2 * own + parameters

    @property
    def trend_parameters(self) -> tuple[FloatArray, FloatArray]:
        """Posterior mean (parameters,) of the trend's parameters, and the root of their covariance."""
        count = self.readings.trend.parameters if self.readings.trend else 0
        root = np.linalg.cholesky(self.posterior.side_covariance[:count, :count])
        return self.posterior.mixed_mean[:count], np.asarray(root, np.float64)

    def with_trend(self, trend: Trend) -> "SmoothFit":
        """Return the fit with another prior of the trend's parameters, and the same hyperparameters and weights."""
        readings = replace(self.readings, trend=trend)
        sums = sums_of(readings, self.start, self.columns, self.kept)
        found = posterior(sums, self.prior, self.hyper)
        polynomial = polynomial_of(readings, self.start, found)
        return replace(self, polynomial=polynomial, posterior=found, readings=readings, sums=sums)

    def orders_that_matter(self, widest: FitReadings) -> IntArray | None:
        """Return the fewest terms of `widest` beyond which no term matters; None if the fit needs no more terms."""
        most = _BEYOND * self.noise**2 * self.determined[0] / self.sums.count
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
        """Return the variance (blocks,) of an output expected from the terms of `widest` that the fit lacks."""
        lacking = ~_among(widest.orders, self.readings.orders)
        return np.asarray(prior_squares(widest, self.posterior.hyper)[:, lacking].sum(axis=1))

    @cached_property
    def spread(self) -> Covariance:
        """Low-rank factors of the covariance of `polynomial`."""
        return self._with_common(self.readings, self.posterior, self.sums, self.kept)

    def _with_common(self, readings: FitReadings, found: Posterior, sums: Sums, kept: FloatArray) -> Covariance:
        """Return the covariance of a fit from sums over readings, including errors that the fit does not estimate."""
        response = label_response(readings, found)
        if self.of_labels is not None:
            response = self.of_labels.beside(response)
        response = response.between(*self.others)
        if (common := readings.common) is not None:
            errors = common.columns(readings.slopes(self.polynomial))
            response = response.beside(response_of(readings, errors, common.sources, kept, sums, found))
        return spread_of(readings, found, response, self.beyond)

    @property
    def residual(self) -> FloatArray:
        """Residuals (n, 2) of `observed`, without errors by label and motions of the camera."""
        readings, found = self.readings, self.posterior
        left = readings.observed - readings.values(self.polynomial) - label_values(readings, found)
        if self.columns is not None:
            left = left - np.einsum("nok,nk->no", self.columns, found.group_mean[readings.capture])
        return left

    def side_columns(self, rows: IntArray) -> FloatArray:
        """Return columns (r, 2, side) of unknowns common to both tangents: mixed ones, then captures' motions."""
        readings, mixed = self.readings, self.posterior.mixed_mean.size
        columns = np.zeros((len(rows), 2, len(self.posterior.side_covariance)))
        columns[:, :, :mixed] = readings.shared_columns(rows)
        if self.columns is not None:
            own = (mixed + 6 * readings.capture[rows, None] + np.arange(6))[:, None]
            np.put_along_axis(columns, np.broadcast_to(own, (len(rows), 2, 6)), self.columns[rows], axis=2)
        return columns

    def left_out(self, rows: BoolArray) -> tuple[float, float]:
        """Predict the readings of a mask (n,) by a fit to the others with the same hyperparameters.

        Returns:
            Rms length of the prediction's errors, and the rms that the fit expects, both in arcminutes.
        """
        readings, out = self.readings, rows & (self.kept > 0)
        chosen = readings.select(out)
        # Readings of a capture share noise, so that its remaining readings need new sums.
        touched = np.isin(readings.capture, chosen.capture)
        sums = self.sums - (self._sums_of(touched) - self._sums_of(touched & ~out))
        rest = posterior(sums, self.prior, self.hyper, evidence=False)
        polynomial = polynomial_of(readings, self.start, rest)
        error = (chosen.observed - chosen.values(polynomial)) * chosen.metric[:, None]
        known = np.sum(label_values(chosen, rest) ** 2, axis=1) * chosen.metric**2
        variance = known + self._reading_variance(np.flatnonzero(out), rest)
        variance += 2.0 * (self.noise * chosen.metric / chosen.weight) ** 2
        return float(np.sqrt(np.mean(np.sum(error**2, axis=1)))), float(np.sqrt(np.mean(variance)))

    def own_arcmin(self, rows: IntArray) -> float:
        """Return the rms error that the fit expects for its predictions of some readings, without common errors."""
        variance = self._own_variance(self.readings.select(rows), self.posterior)
        return float(np.sqrt(np.mean(variance)))

    def _own_variance(self, chosen: FitReadings, found: Posterior) -> FloatArray:
        """Return the variance (n,) of predicted readings, square arcminutes, without common errors."""
        covariance = spread_of(self.readings, found, beyond=self.beyond).covariance(chosen.inputs)
        if chosen.mixed:
            variance = np.einsum("nrb,nbc,nrc->n", chosen.multiplier, covariance, chosen.multiplier)
        else:
            by_block = sum(covariance[:, axis::2, axis::2] for axis in (0, 1))
            variance = np.einsum("nb,nbc,nc->n", chosen.multiplier, by_block, chosen.multiplier)
        return np.asarray(variance * chosen.metric**2)

    def _reading_variance(self, rows: IntArray, found: Posterior) -> FloatArray:
        """Return the variance (r,) of readings, square arcminutes, due to model, errors by label and motions only."""
        readings, side = self.readings, self.side_columns(rows)
        variance = np.zeros(len(rows))
        for axis in range(0 if readings.mixed else 2):
            design = readings.design(rows)
            variance += np.sum(design @ found.alone * design, axis=1)
            side[:, axis] += design @ found.by_side[axis].T
        variance += sum(np.sum(each @ found.side_covariance * each, axis=1) for each in side.transpose(1, 0, 2))
        if self.beyond is not None:
            axes = tuple(range(1, readings.multiplier.ndim - 1))
            variance += (1 if readings.mixed else 2) * np.sum(readings.multiplier[rows] ** 2, axis=axes) @ self.beyond
        return np.asarray(variance * readings.metric[rows] ** 2)

    def _sums_of(self, rows: BoolArray) -> Sums:
        """Return sums over some of the readings: whole captures or parts of captures."""
        columns = None if self.columns is None else self.columns[rows]
        return sums_of(
            self.readings.select(rows),
            self.start,
            columns,
            self.kept[rows],
            captures=int(self.readings.capture.max()) + 1,
        )

    def spread_with(self, readings: FitReadings) -> Covariance:
        """Return the covariance with further readings of the same noise, which follow this fit's in `readings`."""
        return self._spread(
            readings, np.concatenate([self.kept, np.ones(len(readings) - len(self.kept))]), self.posterior.hyper
        )

    def spread_from(self, readings: FitReadings, hyper: Mapping[str, float]) -> Covariance:
        """Return the covariance of a fit to other readings, of equally smooth optics.

        Args:
            readings: readings of the same headset, within the box of this fit.
            hyper: hyperparameters, logarithms, that replace the estimated "noise", "shift" and "turn".
        """
        known = {**self.posterior.hyper, **hyper}
        return self._spread(readings.within(self.readings.box), np.ones(len(readings)), known)

    def _spread(self, readings: FitReadings, kept: FloatArray, hyper: Mapping[str, float]) -> Covariance:
        columns, readings = None, readings.with_shared(self.readings.shared)
        if self.columns is not None:
            columns = motion_columns(readings, self.polynomial)
            readings = readings.moving(columns)
        prior = smoothness_prior(readings, moving=columns is not None)
        sums = sums_of(readings, None, columns, kept)
        usual = dict(zip(prior.names, prior.expected[:, 0], strict=True))  # defaults for further labels
        found = posterior(sums, prior, np.array([hyper.get(name, usual[name]) for name in usual]), evidence=False)
        return self._with_common(readings, found, sums, kept)

    def with_motions(self, motion: FloatArray) -> Polynomial:
        """Return the polynomial that these readings would give if their cameras had moved by `motion`.

        Args:
            motion: (captures, 6) shift in metres, then turn in radians.
        """
        readings = self.readings
        if self.columns is None:
            return self.polynomial
        moved = np.einsum("nok,nk->no", self.columns, motion[readings.capture])
        sums = sums_of(replace(readings, observed=readings.observed - moved), self.start, self.columns, self.kept)
        return polynomial_of(readings, self.start, posterior(sums, self.prior, self.hyper, evidence=False))

    @property
    def prior_size(self) -> FloatArray:
        """Prior sizes (columns,) of the coefficients of each output."""
        return self.prior.sizes(self.hyper)[: self.readings.coefficients]

    @property
    def coefficient_root(self) -> FloatArray:
        """Root F (columns, columns) of F F', the outputs' mean posterior covariance of coefficients."""
        found = self.posterior
        own = self.readings.coefficients
        follow = [each[:, :own].T @ found.side_covariance @ each[:, :own] for each in found.by_side]
        covariance = found.alone[:own, :own] + np.mean(follow, axis=0)
        return principal_root(covariance)

    def whitened(self, readings: FitReadings, place: IntArray, places: int) -> list[FloatArray]:
        """Return the whitened design (n, columns) of an output for each camera position.

        The noise includes camera motions of the estimated sizes, averaged over both outputs.

        Args:
            readings: readings of the same headset, within the box of this fit.
            place: (n,) numbers of the camera positions. places: number of positions; one without readings has a design
                without rows.
        """
        readings = readings.within(self.readings.box)
        design = design_of(readings, slice(None), basis(readings.inputs, readings.orders, readings.box))
        weight = (readings.weight / self.noise)[:, None]
        own, of_place = np.zeros((len(readings), 2, 6)), np.zeros((len(readings), 2, 0))
        if self.columns is not None:
            size = motion_sizes(readings) * np.exp(self.prior.group_features @ self.hyper)
            columns = motion_columns(readings, self.polynomial) * weight[:, None]
            own, stage = columns * size[readings.capture, None], self.readings.stage
            if stage is not None and stage.axes:  # visits of one place share the stage axes' errors
                of_place = columns[:, :, stage.axes] * np.exp(self.posterior.hyper["axes"])
        found, shared = [], self.readings.shared
        for number in range(places):
            rows = np.flatnonzero(place == number)
            visit = readings.capture[rows]
            moved, placed = (each[rows].reshape(len(rows), 2 * each.shape[2]) for each in (own, of_place))
            noise = np.eye(len(rows)) + 0.5 * ((visit[:, None] == visit) * (moved @ moved.T) + placed @ placed.T)
            if shared is not None:
                own_field = (visit[:, None] == visit) * shared.correlation(readings.image[rows])
                noise += shared.share * (own_field - np.eye(len(rows)))
            found.append(
                scipy.linalg.solve_triangular(np.linalg.cholesky(noise), design[rows] * weight[rows], lower=True)
            )
        return found


def _among(orders: IntArray, others: IntArray) -> BoolArray:
    """Return the mask (n,) of rows of orders (n, variables) that are among others (m, variables)."""
    known = set(map(tuple, others.tolist()))
    return np.array([tuple(row) in known for row in orders.tolist()], dtype=bool)

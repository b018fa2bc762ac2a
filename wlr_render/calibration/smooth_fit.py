"""Fits of smooth polynomials to captures by maximum evidence: one mechanism for all kinds of models.

A coefficient of order a in the pixel (or direction) and b in the place has the prior size exp(size - lambda a - mu b):
the readings decide how smooth the optics are. What the readings of one capture share, a small shift and turn of the
camera, is unknown, too; its size is the repeatability of the stage. Orders are limits only, and no design is refused:
where camera positions are few, the posterior is wide.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import ARCMIN
from wlr_render.models.spread import Spread
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray
from wlr_render.numerics.evidence import Posterior, Prior, Sums, maximise, posterior
from wlr_render.numerics.polynomial import Box, Polynomial, basis, limited_orders, total_degree

NOISE_FLOOR_ARCMIN = 1e-3
"""Least noise of a reading: exact data would send it to zero, where rounding decides."""
BEST_CAMERA_ARCMIN = 0.02
"""Least noise beside motions of the camera: with less, motions would take what the polynomial cannot follow."""
LARGEST_SHIFT_M, LARGEST_TURN_RAD = 1e-3, 3e-3
"""Bounds of a stage's repeatability; beyond, it is not a stage that is wrong."""
USUAL_SHIFT_M, USUAL_TURN_RAD = 2e-6, 1e-5
"""Repeatability of good motorised stages; where positions are many, the readings overrule it."""
_STAGES_DIFFER = 1.2  # standard deviation of the logarithms: by a factor of 3.3
_CHUNK = 4_096  # readings whose design is held at once
_FLAT = 1e-6  # metres: no extent
_UNKNOWN_EXTENT_M = 0.01  # of places, where all captures have the same: an eye box
_BOX_MARGIN = 0.025  # of the box per side: half a cell of the coarsest usual grid, 20 samples across the panel
_SHIFT, _TURN = slice(0, 3), slice(3, 6)
_LEAST_MOTION = 1e-9  # metres, radians
_SHIFTS_M, _TURNS_RAD = (1e-6, 8e-6, 6e-5), (3e-6, 2.5e-5, 2e-4)  # where the search for motions starts
_STARTS = ((-1.0, 0.7, 0.7, 0.3), (-1.0, 1.2, 1.5, 0.03), (-4.0, 0.7, 0.7, 1.0))  # size, lambda, mu, noise
_USUAL_SLOPES = (2.5, 1.5)  # of the prior by place and by pixel, for readings that tell little; give or take one
_NO_SIZE = -25.0  # logarithm of a prior size that leaves no term
_GROSS, _LOST = 5.0, 10.0  # residual over noise from which a reading's weight falls, and where it ends
_SATURATED = 0.75  # share of the coefficients that the readings determine above which wider limits are tried
_MOTION_ROUNDS = 3
_ROUNDS = 4  # of outlier weights
_MAD_OF_RAYLEIGH = 1.17741  # median length of a pair of standard normal numbers
_SMOOTH_ORDER = 3  # of the place: motions that vary with it no faster are no motions
_SUSPICIOUS, _SURE = 4.0, 6.0  # a capture's motion over what it is uncertain by, the others' size included
_NEAR_WORST = 0.8  # of the most suspicious one's: what is less so may be its doing
_LARGER, _STANDS_OUT = 2.0, 8.0  # a capture's motion over the median one: of a suspect, and of one that moved
_DOUBTFUL = 0.5  # of the largest score
_ORDINARY_SHIFT_M, _ORDINARY_TURN_RAD = 5e-6, 2e-5  # nothing stands out that is less than so many times these
_ANY_MOTION = 0.03  # metres, radians: prior size of the motion of a capture that stands out
_BAD_STAGE_M, _BAD_STAGE_RAD = 1e-4, 3e-4  # repeatability per axis
_MOST = 0.25  # of the captures may stand out
_FEW_ORDERS = 3  # in all, of the fit that finds captures far off
_CONTRADICTION_ARCMIN = 30.0  # more noise than any camera has
_KEPT = 0.98  # of the variance of predictions at the readings that the low-rank factors keep
_SAMPLES = 500  # readings at which that is judged


Stage = tuple[float, float]
"""Repeatability in metres and wobble in radians, standard deviations per axis."""


def angular_metric(tangents: FloatArray) -> FloatArray:
    """Arcminutes per unit of tangent at tangents (n, 2): (n,).

    With n^2 = 1 + tx^2 + ty^2 a small step of tangents is an angle of 1 / n^2 of it radially and 1 / n across; camera
    noise is the same in both. Their geometric mean is taken (within 8 % of either at 30 degrees off axis), so that one
    design serves both outputs.
    """
    square = 1.0 + np.sum(tangents**2, axis=-1)
    return np.asarray(square**-0.75 / ARCMIN)


def turn_columns(tangents: FloatArray) -> FloatArray:
    """Derivative (n, 2, 3) of view tangents (n, 2) by a turn of the camera about x, y, z, radians."""
    (tx, ty), one = tangents.T, np.ones(len(tangents))
    by_turn = [[tx * ty, -(one + tx**2), -ty], [one + ty**2, -tx * ty, tx]]
    return np.moveaxis(np.array(by_turn), -1, 0)


@dataclass(frozen=True)
class Limits:
    """Highest orders of a fit.

    Attributes:
        pixel: joint order of the pixel's or direction's variables. place: of the place's. total: of all; negative for
            no terms at all.
    """

    pixel: int
    place: int
    total: int

    def orders(self, pixels: int, places: int) -> IntArray:
        """(terms, pixels + places) for numbers of variables."""
        if self.total < 0:
            return np.zeros((0, pixels + places), np.int64)
        return limited_orders(pixels, self.pixel, places, self.place, self.total)

    def words(self, noun: str, places: bool) -> str:
        """In a table: "pixel 8, place 5"."""
        if self.total < 0:
            return "none"
        if not places or self.pixel == self.place:
            return f"{noun} {self.pixel}" if not places else f"total {self.total}"
        return f"{noun} {self.pixel}, place {self.place}"


TREND_ALONE = Limits(-1, -1, -1)
"""No terms: the trend alone."""


@dataclass(frozen=True)
class Trend:
    """What is known before the fit, e.g. a prescription with its assembly errors: a mean and unknown parameters.

    Attributes:
        mean: inputs -> outputs, where the parameters are at their prior mean.
        by_parameter: inputs -> (outputs * parameters), change per prior standard deviation of each parameter.
    """

    mean: Polynomial
    by_parameter: Polynomial

    def about(self, mean: FloatArray, root: FloatArray) -> "Trend":
        """The trend in other parameters q, standard normal before the fit: parameters = mean + root @ q.

        Args:
            mean: (parameters,).
            root: (parameters, parameters).
        """
        orders, box = self.by_parameter.orders, self.by_parameter.box
        change = self.by_parameter.coefficients.reshape(len(orders), -1, self.parameters)
        turned = Polynomial(orders, box, (change @ root).reshape(len(orders), -1))
        return Trend(self.mean.plus(Polynomial(orders, box, change @ mean)), turned)

    @property
    def parameters(self) -> int:
        """Number of parameters."""
        return int(self.by_parameter.coefficients.shape[1] // self.mean.coefficients.shape[1])


@dataclass(frozen=True)
class Readings:
    """observed = sum over blocks b of multiplier_b * polynomial_b(inputs), for n readings of two tangents.

    Attributes:
        inputs: (n, variables).
        is_place: (variables,) whether a variable is of the place, else of the pixel or direction.
        observed: (n, 2).
        multiplier: (n, blocks) for both tangents, or (n, 2, blocks) for polynomials of one output each.
        metric: (n,) arcminutes per unit of `observed`.
        sigma: (n,) arcminutes; all zero for exact data.
        capture: (n,) indices 0..captures - 1 of what shares a motion of the camera.
        motion: (slope of the modelled values (n, 2, variables)) -> (n, 2, 6): by how much `observed` less the model
            changes with a shift (metres) and a turn (radians) of the camera; None where no motion is modelled.
        orders: (terms, variables) of the fit. limits: that they keep.
        trend: what is known before; None for nothing.
    """

    inputs: FloatArray
    is_place: BoolArray
    observed: FloatArray
    multiplier: FloatArray
    metric: FloatArray
    sigma: FloatArray
    capture: IntArray
    motion: Callable[[FloatArray], FloatArray] | None
    orders: IntArray
    limits: Limits
    trend: Trend | None = None

    def __len__(self) -> int:
        return len(self.inputs)

    @property
    def mixed(self) -> bool:
        """Whether each polynomial has one output, which both tangents share."""
        return self.multiplier.ndim == 3

    @property
    def blocks(self) -> int:
        """Number of polynomials that share the inputs."""
        return int(self.multiplier.shape[-1])

    @cached_property
    def box(self) -> Box:
        """Of the inputs, grown by a margin; a trend brings its own."""
        if self.trend is not None:
            return self.trend.mean.box
        return fitted_box(self.inputs, self.is_place)

    @cached_property
    def weight(self) -> FloatArray:
        """(n,) one over sigma, in units of `observed`; sigma 1' where the data are exact."""
        sigma = self.sigma if np.any(self.sigma > 0) else np.ones(len(self))
        return np.asarray(self.metric / sigma)

    @cached_property
    def free(self) -> BoolArray:
        """(terms,) constant and slopes in pixel or direction: their prior size is one unit. None beside a trend."""
        at_place = self.orders[:, self.is_place].any(axis=1)
        return np.asarray(~at_place & (self.orders.sum(axis=1) <= 1) & (self.trend is None))

    def select(self, rows: BoolArray) -> "Readings":
        """Some of the readings; captures keep their indices, and the box is that of all."""
        per_row = ("inputs", "observed", "multiplier", "metric", "sigma", "capture")
        chosen = replace(self, **{name: getattr(self, name)[rows] for name in per_row}, motion=None)
        chosen.__dict__["box"] = self.box
        return chosen

    def values(self, polynomial: Polynomial) -> FloatArray:
        """What a polynomial says of `observed`, (n, 2)."""
        return self._combined(polynomial(self.inputs))[..., 0]

    def slopes(self, polynomial: Polynomial) -> FloatArray:
        """Its derivative by the inputs, (n, 2, variables)."""
        return self._combined(polynomial.with_jacobian(self.inputs)[1])

    def _combined(self, value: FloatArray) -> FloatArray:
        """(n, outputs, ...) of the blocks -> (n, 2, k)."""
        value = value.reshape(len(self), self.blocks, 1 if self.mixed else 2, -1)
        equation = "nrb,nbok->nrk" if self.mixed else "nb,nbok->nok"
        return np.asarray(np.einsum(equation, self.multiplier, value))


def _flat_places(inputs: FloatArray, is_place: BoolArray) -> BoolArray:
    """Variables (variables,) of the place along which inputs (n, variables) have no extent."""
    return np.asarray(is_place & (np.ptp(inputs, axis=0) <= _FLAT * np.where(is_place, 1.0, np.inf)))


def fitted_box(inputs: FloatArray, is_place: BoolArray) -> Box:
    """Box of a fit to inputs (n, variables); a place without extent along an axis gets that of the others."""
    box, flat = Box.around(inputs), _flat_places(inputs, is_place)
    if flat.any():
        known = is_place & ~flat
        wide = float((box.high - box.low)[known].max()) if known.any() else _UNKNOWN_EXTENT_M
        centre = 0.5 * (box.low + box.high)
        box = Box(np.where(flat, centre - 0.5 * wide, box.low), np.where(flat, centre + 0.5 * wide, box.high))
    margin = _BOX_MARGIN * (box.high - box.low)
    return Box(box.low - margin, box.high + margin)


@dataclass(frozen=True)
class MovedCapture:
    """A capture whose camera stood elsewhere than stated, by far more than the others'.

    Attributes:
        capture: its index among the readings.
        shift_m, turn_rad: length of its shift, and its turn.
        times: how many times the median of the captures'.
        arcmin: mean error of its readings, predicted by the other captures.
        score: its motion over what it is uncertain by, the others' motions included.
    """

    capture: int
    shift_m: float
    turn_rad: float
    times: float
    arcmin: float
    score: float


@dataclass(frozen=True)
class SmoothFit:
    """A fitted polynomial, how sure it is, and what the fit found of the bench.

    Attributes:
        polynomial: its outputs are those of block 0, then block 1, and so on.
        posterior: of coefficients, motions and hyperparameters.
        readings: what was fitted.
        kept: (n,) weights of the readings, from 1 down to 0 for outliers.
        moved: captures that stand out; they are left out.
    """

    polynomial: Polynomial
    posterior: Posterior
    readings: Readings
    kept: FloatArray
    moved: tuple[MovedCapture, ...]
    _prior: Prior
    _columns: FloatArray | None
    _start: Polynomial

    @property
    def captures(self) -> int:
        """Number of captures."""
        return len(np.unique(self.readings.capture))

    @property
    def noise(self) -> float:
        """Found standard deviation of a reading per axis, over the stated one; in arcminutes where none is stated."""
        return self.posterior.noise

    @property
    def shift_m(self) -> float:
        """Repeatability of the captures' positions per axis; 0 where no motion was modelled."""
        return float(np.exp(self.posterior.hyper["shift"])) if "shift" in self.posterior.hyper else 0.0

    @property
    def turn_rad(self) -> float:
        """Wobble of the captures' orientations per axis; 0 where no motion was modelled."""
        return float(np.exp(self.posterior.hyper["turn"])) if "turn" in self.posterior.hyper else 0.0

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
    def stage(self) -> Stage:
        """As found."""
        return self.shift_m, self.turn_rad

    @property
    def outputs(self) -> int:
        """Of the polynomial."""
        return int(self.polynomial.coefficients.shape[1])

    @property
    def trend_parameters(self) -> tuple[FloatArray, FloatArray]:
        """Posterior mean (parameters,) and covariance (parameters, parameters) of the trend's parameters."""
        count = self.readings.trend.parameters if self.readings.trend else 0
        return self.posterior.mixed_mean[:count], self.posterior.side_covariance[:count, :count]

    def with_trend(self, trend: Trend) -> "SmoothFit":
        """The fit with another prior of the trend's parameters, at the same hyperparameters and weights."""
        readings = replace(self.readings, trend=trend)
        sums = _sums(readings, self._start, self._columns, self.kept)
        found = posterior(sums, self._prior, np.array(list(self.posterior.hyper.values())))
        return replace(self, polynomial=_polynomial(readings, self._start, found), posterior=found, readings=readings)

    @cached_property
    def spread(self) -> Spread:
        """Low-rank factors of the covariance of `polynomial`."""
        return _spread(self.readings, self.posterior)

    def left_out(self, rows: BoolArray) -> tuple[float, float]:
        """Predict readings (n,) bool by a fit to the others at the same hyperparameters.

        Returns:
            rms length of the prediction's errors in arcminutes, and what the fit expects of it.
        """
        readings = self.readings
        sums = _sums(readings, self._start, self._columns, np.where(rows, 0.0, self.kept))
        rest = posterior(sums, self._prior, np.array(list(self.posterior.hyper.values())), evidence=False)
        chosen = readings.select(rows & (self.kept > 0))
        polynomial = _polynomial(readings, self._start, rest)
        error = (chosen.observed - chosen.values(polynomial)) * chosen.metric[:, None]
        spread = _spread(readings, rest)
        covariance = spread.covariance(chosen.inputs)
        if chosen.mixed:
            variance = np.einsum("nrb,nbc,nrc->n", chosen.multiplier, covariance, chosen.multiplier)
        else:
            by_block = sum(covariance[:, axis::2, axis::2] for axis in (0, 1))
            variance = np.einsum("nb,nbc,nc->n", chosen.multiplier, by_block, chosen.multiplier)
        variance = variance * chosen.metric**2 + 2.0 * (self.noise * chosen.metric / chosen.weight) ** 2
        if self._columns is not None:
            own = np.exp(self._prior.own_offset + self._prior.own_features @ list(self.posterior.hyper.values()))
            own = np.broadcast_to(own, (self.posterior.own_mean.shape[0], 6))[chosen.capture]
            columns = self._columns[rows & (self.kept > 0)]
            variance += np.einsum("nok,nk->n", columns**2, own**2) * chosen.metric**2
        return float(np.sqrt(np.mean(np.sum(error**2, axis=1)))), float(np.sqrt(np.mean(variance)))

    def spread_with(self, readings: Readings) -> Spread:
        """Covariance that further readings would give: those of this fit and more, in `readings`, at this noise."""
        columns = None if self._columns is None else _motion(readings, self.polynomial)
        prior = replace(self._prior, own_offset=np.zeros(self._prior.own_features.shape[0]))
        sums = _sums(readings, None, columns, np.ones(len(readings)))
        return _spread(readings, posterior(sums, prior, np.array(list(self.posterior.hyper.values()))))


def fit_within(
    readings_of: Callable[[Limits], Readings],
    limits: Sequence[Limits],
    weights: FloatArray | None = None,
    stage: Stage | None = None,
) -> SmoothFit:
    """Fit within the first limits of the orders that leave most coefficients to the prior, or within the last.

    Where the readings determine nearly all coefficients, it is the limits that stop them, not the noise.

    Raises:
        BadInputError: as `fit`.
    """
    smooth = fit(readings_of(limits[0]), None, weights, stage)
    for wider in limits[1:]:
        if smooth.posterior.determined < _SATURATED * len(smooth.readings.orders) * smooth.outputs:
            break
        smooth = fit(readings_of(wider), smooth.posterior.hyper, weights, stage)
    return smooth


def fit(
    readings: Readings,
    start_at: Mapping[str, float] | None = None,
    weights: FloatArray | None = None,
    stage: Stage | None = None,
) -> SmoothFit:
    """Fit by maximum evidence.

    Args:
        readings: what was measured.
        start_at: hyperparameters of a fit to the same readings, to start from; None searches from several starts.
        weights: (n,) of the readings, 1 to 0 for outliers; None to find them. Evidence of models is comparable only
            with the same readings and weights.
        stage: repeatability and wobble; None to find them.

    Raises:
        BadInputError: the readings determine nothing, or contradict each other.
    """
    search = _Search(readings, _free_part(readings), start_at, weights, stage)
    smooth = search.without(())
    if smooth._columns is None:
        return smooth
    if weights is not None:
        gone = np.setdiff1d(readings.capture, readings.capture[weights > 0])
        smooth = replace(smooth, moved=tuple(MovedCapture(int(name), 0.0, 0.0, 0.0, 0.0, 0.0) for name in gone))
        return replace(smooth, moved=tuple(_standing_out(smooth)[1].values()))
    if not _standing_out(smooth)[0]:
        return smooth
    # Few orders cannot follow a capture that is far off; many find those that are less so.
    few = readings.orders.sum(axis=1) <= _FEW_ORDERS
    suspects: dict[int, MovedCapture] = {}
    if readings.trend is None:
        coarse = _Search(replace(readings, orders=readings.orders[few]), search.start, None, None, stage)
        suspects = _suspects(coarse, {})
        suspects = {name: each for name, each in suspects.items() if each.times > _STANDS_OUT and each.score > _SURE}
    suspects = _suspects(search, suspects)
    moved = [each for each in suspects.values() if each.times > _STANDS_OUT and each.score > _SURE]
    moved.sort(key=lambda each: -each.score)
    if not moved:
        return smooth
    smooth = search.without(tuple(moved))
    # Without so many the rest judge badly: the least suspicious come back unless they stand out again.
    while moved[-1].score < _DOUBTFUL * moved[0].score:
        trial = search.without(tuple(moved[:-1]))
        if moved[-1].capture in _standing_out(trial)[0]:
            break
        smooth = trial
        moved.pop()
    return smooth


def _suspects(search: "_Search", suspects: dict[int, MovedCapture]) -> dict[int, MovedCapture]:
    """More captures that stand out beside some, and all of them judged by the rest.

    One that stands out makes others seem to: the worst go first.
    """
    while True:
        smooth = search.without(tuple(suspects.values()))
        others, suspects = _standing_out(smooth)
        if not others or len(suspects) + len(others) > _MOST * smooth.captures:
            return suspects
        suspects |= others


@dataclass(frozen=True)
class _Search:
    """Fits to the same readings without some of the captures; see `fit`."""

    readings: Readings
    start: Polynomial
    start_at: Mapping[str, float] | None
    weights: FloatArray | None
    stage: Stage | None

    def without(self, moved: tuple[MovedCapture, ...]) -> SmoothFit:
        """Fit to all captures but those that moved."""
        readings, start = self.readings, self.start
        stays = ~np.isin(readings.capture, [each.capture for each in moved])
        kept = stays * (np.ones(len(readings)) if self.weights is None else self.weights)
        prior = _prior(readings, moving=False)
        starts = [dict(self.start_at)] if self.start_at is not None else _starts(readings, prior, start, kept)
        moves = readings.motion is not None and bool(np.any(readings.sigma > 0))
        columns: FloatArray | None = None
        for _ in range(_ROUNDS):
            found = maximise(_sums(readings, start, None, kept), prior, starts)
            polynomial = _polynomial(readings, start, found)
            columns = _motion(readings, polynomial) if moves else None
            if self.weights is not None:
                break
            weights = _weights(readings, polynomial, columns, kept) * stays
            if np.allclose(weights, kept, atol=0.05):
                break
            kept, starts = weights, [dict(found.hyper)]
        if columns is None:
            return SmoothFit(polynomial, found, readings, kept, moved, prior, columns, start)
        prior = _prior(readings, moving=True)
        if self.stage is not None:
            prior.bounds[-2:] = np.log(np.maximum(self.stage, _LEAST_MOTION))[:, None]
        rough, hyper = _rough(readings, kept), dict(found.hyper)
        # Motions act through the slopes of the fit, which motions spoil: both are found in turns.
        for round_ in range(_MOTION_ROUNDS):
            columns = _motion(readings, polynomial)
            sums = _sums(readings, start, columns, kept)
            if round_ == 0:
                hyper = _motion_start(sums.combined(rough), prior, hyper)
            else:
                hyper = dict(maximise(sums.combined(rough), prior, [hyper]).hyper)
            found = posterior(sums, prior, np.array(list(hyper.values())))
            polynomial = _polynomial(readings, start, found)
        return SmoothFit(polynomial, found, readings, kept, moved, prior, columns, start)


def _rough(readings: Readings, kept: FloatArray) -> FloatArray:
    """Orthonormal combinations (captures, k) of the captures' motions without those that vary smoothly with the place.

    Smooth motions are another way to write the place; where the orders end before the optics do, they would be taken
    for motions of the camera, of any size.
    """
    captures = int(readings.capture.max()) + 1
    used = np.flatnonzero(np.bincount(readings.capture, kept > 0, captures))
    place = readings.inputs[:, readings.is_place]
    count = np.maximum(np.bincount(readings.capture, minlength=captures), 1)
    middle = np.stack([np.bincount(readings.capture, axis, captures) / count for axis in place.T], axis=-1)[used]
    orders = [total_degree(place.shape[1], order) for order in range(_SMOOTH_ORDER + 1)]
    smooth = [order for order in orders if 2 * len(order) <= len(used)]
    rough = np.zeros((captures, 0))
    if smooth:
        left, size, _ = np.linalg.svd(basis(middle, smooth[-1], Box.around(middle)))
        rank = int(np.sum(size > 1e-6 * size[0]))
        rough = np.zeros((captures, len(used) - rank))
        rough[used] = left[:, rank:]
    return rough


def _standing_out(smooth: SmoothFit) -> tuple[dict[int, MovedCapture], dict[int, MovedCapture]]:
    """Captures that stand out by their motion, and those left out before, measured by the rest; by their indices."""
    readings, out = smooth.readings, [each.capture for each in smooth.moved]
    kept = np.where(np.isin(readings.capture, out), 1.0, smooth.kept)
    offset = np.zeros((int(readings.capture.max()) + 1, 6))
    hyper = smooth.posterior.hyper
    offset[out, _SHIFT], offset[out, _TURN] = (np.log(_ANY_MOTION) - hyper[name] for name in ("shift", "turn"))
    columns = _motion(readings, smooth.polynomial)
    found = posterior(
        _sums(readings, smooth._start, columns, kept),
        replace(smooth._prior, own_offset=offset),
        np.array(list(hyper.values())),
    )
    variance = np.diag(found.side_covariance)[-found.own_mean.size :].reshape(found.own_mean.shape)
    size = np.exp(offset + smooth._prior.own_features @ list(hyper.values()))
    # What the readings say of each motion before its own prior: a common prior draws the largest to the others.
    alone = 1.0 / np.maximum(1.0 / variance - 1.0 / size**2, 1e-9 / size**2)
    motion = found.own_mean * alone / variance
    times, score = np.zeros(len(motion)), np.zeros(len(motion))
    for part, least, name in ((_SHIFT, _ORDINARY_SHIFT_M, "shift"), (_TURN, _ORDINARY_TURN_RAD, "turn")):
        usual = max(float(np.exp(hyper[name])), least)
        this_score = np.linalg.norm(motion[:, part] / np.sqrt(alone[:, part] + usual**2), axis=1)
        length = np.linalg.norm(found.own_mean[:, part], axis=1)
        this_times = length / max(float(np.median(length)), least)
        larger = this_score > score
        score, times = np.where(larger, this_score, score), np.where(larger, this_times, times)
    shift, turn = (np.linalg.norm(found.own_mean[:, part], axis=1) for part in (_SHIFT, _TURN))
    off = (readings.observed - readings.values(smooth.polynomial)) * readings.metric[:, None]
    found_of = {
        int(name): MovedCapture(
            int(name),
            float(shift[name]),
            float(turn[name]),
            float(times[name]),
            float(np.linalg.norm(off[readings.capture == name].mean(axis=0))),
            float(score[name]),
        )
        for name in np.unique(readings.capture)
    }
    before = {name: found_of.pop(name) for name in out}
    # No stage is so bad: where all seem to have moved, a few have.
    bad_stage = smooth.shift_m > _BAD_STAGE_M or smooth.turn_rad > _BAD_STAGE_RAD
    larger = {name: each for name, each in found_of.items() if bad_stage or each.times > _LARGER}
    worst = max((each.score for each in larger.values()), default=0.0)
    enough = max(_SUSPICIOUS / (2.0 if bad_stage else 1.0), _NEAR_WORST * worst)
    return {name: each for name, each in larger.items() if each.score >= enough}, before


def _design(readings: Readings, rows: slice, phi: FloatArray) -> FloatArray:
    """Columns of all blocks: (rows, blocks * terms), or (rows, 2, blocks * terms) if mixed; phi is (rows, terms)."""
    multiplier = readings.multiplier[rows]
    design = multiplier[..., None] * (phi[:, None, None] if readings.mixed else phi[:, None])
    return np.asarray(design.reshape(*multiplier.shape[:-1], -1))


def _free_part(readings: Readings) -> Polynomial:
    """Least squares by the few free terms: what is left of the observed values is small, so that sums keep digits.

    Raises:
        BadInputError: the readings do not determine them.
    """
    orders = readings.orders[readings.free]
    outputs = readings.blocks * (1 if readings.mixed else 2)
    if len(orders) == 0:
        return Polynomial(orders, readings.box, np.zeros((0, outputs)))
    design = _design(readings, slice(None), basis(readings.inputs, orders, readings.box))
    values = readings.observed[:, :, None] if readings.mixed else readings.observed
    weight = readings.weight.reshape(-1, *[1] * (design.ndim - 1))
    design, values = design * weight, values * weight
    columns = design.shape[-1]
    design, values = design.reshape(-1, columns), values.reshape(-1, values.shape[-1])
    scale = np.linalg.norm(design, axis=0)
    solution, _, rank, _ = np.linalg.lstsq(design / np.where(scale > 0, scale, 1.0), values, rcond=1e-7)
    if rank < columns:
        raise UndeterminedError(f"{rank} of {columns} unknowns that no prior holds are determined")
    solution = solution / scale[:, None]
    by_term = solution.reshape(readings.blocks, len(orders), -1).transpose(1, 0, 2)
    return Polynomial(orders, readings.box, np.ascontiguousarray(by_term.reshape(len(orders), -1)))


class UndeterminedError(BadInputError):
    """The readings do not determine an unknown that no prior holds."""


def _prior(readings: Readings, moving: bool) -> Prior:
    blocks, orders, free = readings.blocks, readings.orders, readings.free
    sizes = [f"size {block}" for block in range(blocks)]
    smooth_as = _smooth_as(readings)
    axes = sorted(set(smooth_as))
    slopes = [f"{'mu' if readings.is_place[axis] else 'lambda'} {axis}" for axis in axes]
    names = (*sizes, *slopes, "noise", *(("shift", "turn") if moving else ()))
    features = np.zeros((blocks, len(orders), len(names)))
    for block in range(blocks):
        features[block, ~free, block] = 1.0
        for axis, other in enumerate(smooth_as):
            features[block, ~free, blocks + axes.index(other)] -= orders[~free, axis]
    flat = features.reshape(-1, len(names))
    none = np.zeros((0, len(names)))
    parameters = np.zeros((readings.trend.parameters if readings.trend else 0, len(names)))
    shared, mixed = (none, flat) if readings.mixed else (flat, parameters)
    own = np.zeros((6 if moving else 0, len(names)))
    if moving:
        own[_SHIFT, -2] = own[_TURN, -1] = 1.0
    bounds = [(_NO_SIZE, 8.0)] * blocks + [(0.0, 8.0)] * len(slopes)
    bounds += [(np.log(_noise_floor(readings, moving)), 12.0)]
    if moving:
        bounds += [(np.log(_LEAST_MOTION), np.log(most)) for most in (LARGEST_SHIFT_M, LARGEST_TURN_RAD)]
    expected = np.tile([0.0, np.inf], (len(names), 1))
    by_place = np.array([readings.is_place[axis] for axis in axes])
    expected[blocks : blocks + len(slopes), 0] = np.where(by_place, *_USUAL_SLOPES)
    expected[blocks : blocks + len(slopes), 1] = 1.0
    if moving:
        expected[-2:] = [[np.log(usual), _STAGES_DIFFER] for usual in (USUAL_SHIFT_M, USUAL_TURN_RAD)]
    return Prior(
        names,
        np.array(bounds),
        expected,
        shared,
        np.zeros(len(shared)),
        mixed,
        np.zeros(len(mixed)),
        own,
        np.zeros(len(own)),
    )


def _smooth_as(readings: Readings) -> list[int]:
    """Each variable's own slope of the prior, but where the captures have no extent along it, that of another.

    Readings at one place cannot tell how fast the optics change beside it; they would call them constant.
    """
    flat = _flat_places(readings.inputs, readings.is_place)
    known = np.flatnonzero(readings.is_place & ~flat)
    other = int(known[0]) if known.size else int(np.flatnonzero(~readings.is_place)[0])
    return [other if flat[axis] else axis for axis in range(len(flat))]


def _noise_floor(readings: Readings, moving: bool = False) -> float:
    stated = readings.sigma[readings.sigma > 0]
    return (BEST_CAMERA_ARCMIN if moving else NOISE_FLOOR_ARCMIN) / (float(np.median(stated)) if stated.size else 1.0)


def _starts(readings: Readings, prior: Prior, start: Polynomial, kept: FloatArray) -> list[dict[str, float]]:
    """Where the search for hyperparameters starts.

    Beside a trend the sizes are those of what it leaves of the readings, and nothing is left to find if it is right.
    """
    starts: Sequence[tuple[float, float, float, float]] = _STARTS
    if readings.trend is not None:
        alone = replace(readings, orders=readings.orders[:0])
        without = _prior(alone, moving=False)
        sums = _sums(alone, start, None, kept)
        rest = posterior(sums, without, np.array(list(_start_hyper(without, *_STARTS[-1]).values())))
        left = max(float(np.sqrt(rest.square / max(sums.count, 1))), _noise_floor(readings))
        size = float(np.log(left / np.median(readings.weight)))
        starts = [(_NO_SIZE, 0.7, 0.7, left)]
        if len(readings.orders):
            starts += [(size, 0.7, 0.7, 0.3 * left), (size, 1.3, 2.5, left), (size - 3.0, 0.7, 0.7, left)]
    return [_start_hyper(prior, *values) for values in starts]


def _start_hyper(prior: Prior, size: float, slope: float, by_place: float, noise: float) -> dict[str, float]:
    values = {"size": size, "lambda": slope, "mu": by_place, "noise": float(np.log(noise))}
    return {name: values[name.split()[0]] for name in prior.names}


def _motion_start(sums: Sums, prior: Prior, still: dict[str, float]) -> dict[str, float]:
    """The best of a few sizes of the motion: the evidence may have several maxima."""
    starts = [still | {"shift": np.log(shift), "turn": np.log(turn)} for shift, turn in product(_SHIFTS_M, _TURNS_RAD)]
    starts.append(still | {"shift": np.log(_LEAST_MOTION), "turn": np.log(_LEAST_MOTION)})

    def evidence(start: dict[str, float]) -> float:
        try:
            hyper = np.clip([start[name] for name in prior.names], *prior.bounds.T)
            return posterior(sums, prior, hyper).log_evidence - prior.surprise(hyper)[0]
        except np.linalg.LinAlgError:
            return -np.inf

    return max(starts, key=evidence)


def _sums(readings: Readings, start: Polynomial | None, motion: FloatArray | None, kept: FloatArray) -> Sums:
    """Sums over the readings less their free part and trend; without values if `start` is None."""
    terms, own = len(readings.orders), 0 if motion is None else 6
    groups = int(readings.capture.max()) + 1 if own else 0
    trend = readings.trend
    parameters = trend.parameters if trend else 0
    columns = 0 if readings.mixed else readings.blocks * terms
    sums = Sums(columns, 2, readings.blocks * terms if readings.mixed else parameters, groups, own)
    observed = np.zeros_like(readings.observed)
    if start is not None:
        observed = readings.observed - readings.values(start)
        observed = observed - (readings.values(trend.mean) if trend else 0.0)
    for first in range(0, len(readings), _CHUNK):
        rows = slice(first, first + _CHUNK)
        design = _design(readings, rows, basis(readings.inputs[rows], readings.orders, readings.box))
        mixed = design if readings.mixed else None
        if trend:
            by_parameter = trend.by_parameter(readings.inputs[rows])
            by_parameter = by_parameter.reshape(len(design), readings.blocks, 2, parameters)
            mixed = np.einsum("nb,nbop->nop", readings.multiplier[rows], by_parameter)
        sums.add(
            observed[rows],
            (readings.weight * kept)[rows],
            np.empty((len(design), 0)) if readings.mixed else design,
            mixed,
            None if motion is None else motion[rows],
            readings.capture[rows],
        )
    return sums


def _polynomial(readings: Readings, start: Polynomial, found: Posterior) -> Polynomial:
    blocks, terms = readings.blocks, len(readings.orders)
    outputs = 1 if readings.mixed else 2
    mean = found.mixed_mean if readings.mixed else found.mean
    by_term = mean.reshape(outputs, blocks, terms).transpose(2, 1, 0).reshape(terms, blocks * outputs)
    coefficients = by_term.copy()
    coefficients[readings.free] += start.coefficients
    polynomial = Polynomial(readings.orders, readings.box, coefficients)
    if readings.trend is None:
        return polynomial
    mean_part, by_parameter = readings.trend.mean, readings.trend.by_parameter
    moved = (
        by_parameter.coefficients.reshape(len(by_parameter.orders), -1, readings.trend.parameters) @ found.mixed_mean
    )
    return polynomial.plus(mean_part).plus(Polynomial(by_parameter.orders, by_parameter.box, moved))


def _motion(readings: Readings, polynomial: Polynomial) -> FloatArray:
    assert readings.motion is not None
    return readings.motion(readings.slopes(polynomial))


def _weights(readings: Readings, polynomial: Polynomial, columns: FloatArray | None, kept: FloatArray) -> FloatArray:
    """1 for readings near the model, falling to 0 for those far off; Hampel's descending function.

    Where cameras may have moved, a reading is judged beside the others of its capture.
    """
    off = (readings.observed - readings.values(polynomial)) * readings.weight[:, None]
    if columns is not None:
        columns = columns * readings.weight[:, None, None]
        for rows in _by_capture(readings.capture):
            design = (columns[rows] * kept[rows, None, None]).reshape(-1, 6)
            size = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
            motion = np.linalg.lstsq(design / size, (off[rows] * kept[rows, None]).ravel(), rcond=1e-6)[0] / size
            off[rows] -= columns[rows] @ motion
    far = np.linalg.norm(off, axis=1)
    far = far / max(float(np.median(far[kept > 0])) / _MAD_OF_RAYLEIGH, _noise_floor(readings))
    fall = _GROSS / np.maximum(far, _GROSS) * np.clip((_LOST - far) / (_LOST - _GROSS), 0.0, 1.0)
    return np.asarray(np.sqrt(np.where(far <= _GROSS, 1.0, fall)))


def _by_capture(capture: IntArray) -> list[IntArray]:
    order = np.argsort(capture, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(capture[order])) + 1)


def _spread(readings: Readings, found: Posterior) -> Spread:
    """Low-rank factors of the posterior covariance, judged by the variance that they keep at some of the readings."""
    orders, box, blocks = readings.orders, readings.box, readings.blocks
    outputs = blocks * (1 if readings.mixed else 2)
    rng = np.random.default_rng(0)
    rows = rng.permutation(len(readings))[:_SAMPLES]
    inputs = readings.inputs[rows]
    # Half of them elsewhere in the box: what the readings do not know counts, too.
    elsewhere = rng.uniform(box.low, box.high, inputs.shape)
    inputs = np.where(readings.is_place & (np.arange(len(rows)) % 2 == 0)[:, None], elsewhere, inputs)
    sample = basis(inputs, orders, box)
    weight = readings.metric[rows]
    if readings.mixed:
        shared = 0
        design = np.einsum("nrb,nt->nrbt", readings.multiplier[rows] * weight[:, None, None], sample)
        root = _root(found.side_covariance)
        joint = root @ _principal(design.reshape(2 * len(rows), -1) @ root)
        joint = joint.reshape(blocks, len(orders), -1).transpose(1, 0, 2)
        apart = np.zeros((len(orders), 0))
        joint_orders = orders
    else:
        design = (readings.multiplier[rows] * weight[:, None])[:, :, None] * sample[:, None]
        design = design.reshape(len(rows), -1)
        root = _root(found.alone)
        apart_root = root @ _principal(design @ root)
        rank = apart_root.shape[1]
        apart = apart_root.reshape(blocks, len(orders), rank).transpose(1, 0, 2).reshape(len(orders), blocks * rank)
        # What the coefficients do with the side unknowns, the trend's parameters among them.
        trend = readings.trend
        shared = trend.parameters if trend else 0
        follow = found.by_side.transpose(0, 2, 1)  # (2, columns, side)
        by_axis = follow.reshape(2, blocks, len(orders), follow.shape[2]).transpose(2, 1, 0, 3)
        by_term = by_axis.reshape(len(orders), outputs, follow.shape[2])
        side = Polynomial(orders, box, by_axis.reshape(len(orders), outputs * follow.shape[2]))
        if trend:
            by_parameter = trend.by_parameter.coefficients.reshape(len(trend.by_parameter.orders), outputs, -1)
            padded = np.zeros((*by_parameter.shape[:2], by_term.shape[2]))
            padded[..., :shared] = by_parameter
            side = side.plus(Polynomial(trend.by_parameter.orders, box, padded.reshape(len(padded), -1)))
        joint_orders = side.orders
        joint = side.coefficients.reshape(len(joint_orders), outputs, -1) @ _lower_root(found.side_covariance)
        sampled = Polynomial(joint_orders, box, joint.reshape(len(joint_orders), -1))(inputs)
        sampled = np.einsum("nb,nbok->nok", readings.multiplier[rows], sampled.reshape(len(rows), blocks, 2, -1))
        sampled = (sampled * weight[:, None, None]).reshape(2 * len(rows), -1)
        keep = _principal(sampled[:, shared:], float(np.sum((design @ apart_root) ** 2)) * 2.0)
        joint = np.concatenate([joint[..., :shared], joint[..., shared:] @ keep], axis=-1)
    return Spread(
        outputs,
        Polynomial(orders, box, apart),
        Polynomial(joint_orders, box, joint.reshape(len(joint_orders), -1)),
        shared,
    )


def _root(covariance: FloatArray) -> FloatArray:
    """F with F F' = covariance, whatever the scales of the unknowns."""
    scale = np.sqrt(np.diag(covariance))
    scale = np.where(scale > 0, scale, 1.0)
    values, vectors = np.linalg.eigh(covariance / scale[:, None] / scale)
    return np.asarray(scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))


def _lower_root(covariance: FloatArray) -> FloatArray:
    """Lower triangular F with F F' = covariance: the first unknowns follow the first variables alone."""
    scale = np.sqrt(np.diag(covariance))
    scale = np.where(scale > 0, scale, 1.0)
    correlation = covariance / scale[:, None] / scale + 1e-12 * np.eye(len(covariance))
    return np.asarray(scale[:, None] * np.linalg.cholesky(correlation))


def _principal(sampled: FloatArray, others: float = 0.0) -> FloatArray:
    """Directions (k, rank) of standard normal variables that keep `_KEPT` of the variance of samples (n, k).

    Scaled so that the mean variance of the samples stays what it is. None is kept where all are nothing beside
    `others`, the sum of squares of further samples.
    """
    values, vectors = np.linalg.eigh(sampled.T @ sampled)
    values, vectors = np.maximum(values[::-1], 0.0), vectors[:, ::-1]
    total = float(values.sum())
    if total <= (1.0 - _KEPT) * 0.01 * others or total == 0.0:
        return np.zeros((sampled.shape[1], 0))
    running = np.cumsum(values)
    rank = int(np.searchsorted(running, _KEPT * total)) + 1
    return np.asarray(vectors[:, :rank] * np.sqrt(total / running[rank - 1]))

"""Search for the smooth fit of highest evidence: terms, outliers, noise, and captures that moved.

Each search starts from the previous fit, because the same readings with more terms, or without some captures, have
nearly the same hyperparameters and, with the same captures, nearly the same weights and noise.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from wlr_render.calibration.label_terms import means_by, smooth_basis
from wlr_render.calibration.moved_captures import CaptureMotion, moved_odds, usual_motion
from wlr_render.calibration.reading_sums import free_part, polynomial_of, sums_of
from wlr_render.calibration.readings import FitReadings, Limits, motion_columns, rows_by_capture
from wlr_render.calibration.smooth_fit import SmoothFit
from wlr_render.calibration.smooth_prior import (
    SHIFT,
    TURN,
    Stage,
    motion_scale,
    motion_sizes,
    motion_start,
    noise_floor,
    search_starts,
    smoothness_prior,
)
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.evidence import maximise, posterior
from wlr_render.numerics.polynomial import Polynomial
from wlr_render.numerics.posterior import Posterior
from wlr_render.numerics.shared_noise import SharedNoise, find_shared_noise, neighbour_distance

_GROSS, _LOST = 5.0, 10.0  # residuals over noise at which weights begin to fall and are zero; 4e-6 of normal noise
_WIDENINGS = 3  # most fits with more terms, each of which takes as long as the first
_MOTION_ROUNDS = 3  # alternations of slopes and motions, because motions distort the slopes of the first fit
_ROUNDS = 4  # most rounds of outlier weights and shared noise; they end earlier without changes
_MAD_OF_RAYLEIGH = 1.17741  # median length of a pair of standard normal numbers
_REST_IF_UNKNOWN, _REST_IF_STATED = 0.5, 0.35  # least share of motions to estimate sizes; fewer if stated
_NEAR_CLEAREST = 0.7  # least log odds over the largest for rejection in a round; the clearest may cause the others
_ANY_MOTION = 0.03  # prior size of an outlier's motion, metres or radians; larger than any bump
_MOST, _MOST_THAT_MOVE = 0.25, 0.5  # largest share of captures left out, and of captures that moved
_ROUNDS_OF_MOTIONS = 8  # most fits without some captures; each leaves out the few clearest ones
_ORDERS_BEYOND, _ENOUGH_ORDERS = 2, 7  # orders added to a fit for tests of captures, and highest order with them
_FEW_ORDERS = 3  # total order of the fit that finds captures with large motions


def fit_within(
    readings_of: Callable[[Limits], FitReadings],
    limits: Sequence[Limits],
    weights: FloatArray | None = None,
    stage: Stage | None = None,
) -> SmoothFit:
    """Fit with the terms that matter according to the readings.

    A fit within the first limits that can be computed estimates how fast coefficients fall with their order. While the
    missing terms are expected to exceed `_BEYOND` of the fit's variance, the fit is repeated with the terms that matter
    within the last limits. The variance of all other terms adds to the fit's variance.

    Args:
        readings_of: (limits) -> readings.
        limits: limits, narrowest first; a single one is always used.
        weights, stage: as in `fit`.

    Raises:
        BadInputError: as `fit`.
    """
    widest = readings_of(limits[-1])
    smooth = _first_fit(readings_of, limits, weights, stage)
    if len(limits) == 1:
        return smooth
    for _ in range(_WIDENINGS):
        orders = smooth.orders_that_matter(widest)
        if orders is None:
            break
        smooth = _fit_from(smooth, replace(widest, orders=orders), weights, stage)
    return replace(smooth, beyond=smooth.beyond_of(widest))


def _first_fit(
    readings_of: Callable[[Limits], FitReadings],
    limits: Sequence[Limits],
    weights: FloatArray | None,
    stage: Stage | None,
) -> SmoothFit:
    """Fit within the first limits that can be computed."""
    for each in limits[:-1]:
        try:
            return fit(readings_of(each), None, weights, stage)
        except np.linalg.LinAlgError:  # unbounded motions of the captures replaced the terms outside the limits
            continue
    return fit(readings_of(limits[-1]), None, weights, stage)


def _fit_from(before: SmoothFit, readings: FitReadings, weights: FloatArray | None, stage: Stage | None) -> SmoothFit:
    """Fit from the previous fit, or from nothing if this leads to sums without an inverse."""
    try:
        return fit(readings, before, weights, stage)
    except np.linalg.LinAlgError:
        return fit(readings, None, weights, stage)


def fit(
    readings: FitReadings,
    before: SmoothFit | None = None,
    weights: FloatArray | None = None,
    stage: Stage | None = None,
) -> SmoothFit:
    """Fit by maximum evidence.

    Args:
        readings: the measured readings.
        before: starting fit to the same readings with other terms; None for a search from several starts.
        weights: (n,) weights of the readings, from 1 to 0 for outliers; None to find them. Evidence of models is
            comparable only for the same readings and weights.
        stage: prior of the stage's errors from other captures of the bench; None to estimate them.

    Raises:
        BadInputError: the readings determine nothing, or contradict each other.
    """
    search = _Search(readings, free_part(readings), weights, stage)
    moved = () if before is None else before.moved
    smooth = search.without(moved, before)
    if smooth.columns is None:
        return smooth
    if weights is not None:
        gone = np.setdiff1d(readings.capture, readings.capture[weights > 0])
        smooth = replace(smooth, moved=tuple(CaptureMotion(int(name), 0.0, 0.0, 0.0, 0.0) for name in gone))
        kept = np.where(np.isin(readings.capture, gone), 1.0, smooth.kept)
        return replace(smooth, moved=tuple(_suspects(smooth, kept)[1].values()))
    if moved:
        return _without_moved(search, smooth)
    others, _ = _suspects(smooth, smooth.kept)
    if not others:
        return smooth
    is_likely = any(each.log10_odds > 0.0 for each in others.values())
    if is_likely and readings.trend is None:  # low orders cannot follow a large motion; high orders find smaller ones
        few = readings.orders.sum(axis=1) <= _FEW_ORDERS
        coarse = replace(search, readings=replace(readings, orders=readings.orders[few]))
        smooth = search.without(_without_moved(coarse, coarse.without((), smooth)).moved, smooth)
    return _without_moved(search, smooth)


def _without_moved(search: "_Search", smooth: SmoothFit) -> SmoothFit:
    """Return the fit without all captures that moved, from a fit without some of them."""
    captures, rejections = len(np.unique(search.readings.capture)), Counter[int]()
    most, beside = int(_MOST * captures), {each.capture: each.log10_odds for each in smooth.moved}
    kept, tested = np.ones(len(smooth.kept)), dict[int, CaptureMotion]()
    fits, more = {frozenset(beside): smooth}, tuple[CaptureMotion, ...]()

    def without(gone: tuple[CaptureMotion, ...]) -> SmoothFit:
        names = frozenset(each.capture for each in gone)
        if names not in fits:
            fits[names] = search.without(gone, smooth)
        return fits[names]

    for round_ in range(_ROUNDS_OF_MOTIONS):
        out = np.isin(smooth.readings.capture, [each.capture for each in smooth.moved])
        kept = np.where(out, kept, smooth.kept)
        others, judged = _suspects(smooth, kept)
        # The hyperparameters of a fit with the capture favour that it did not move, without it that it did. The mean of
        # both odds is, to second order, the odds with the most probable hyperparameters of either case. Odds that the
        # other captures alone do not confirm are due to hyperparameters of other terms.
        beside |= {name: each.log10_odds for name, each in others.items()}
        judged = {
            name: replace(each, log10_odds=min(each.log10_odds, 0.5 * (each.log10_odds + beside[name])))
            for name, each in judged.items()
        }
        fresh = {each.capture for each in more}
        if fresh and not any(judged[name].stands_out for name in fresh):  # the others were judged better with them
            judged |= {name: tested[name] for name in judged.keys() & tested.keys() - fresh}
        tested |= judged
        rejections.update(name for name, each in judged.items() if not each.stands_out)
        moved = tuple(each for each in judged.values() if each.stands_out)
        # A capture that moved makes others seem to have moved: the clearest are rejected first, and some come back. One
        # that came back is rejected again only if it is clear, and not after it came back twice. Because a capture that
        # moved may hide in the hyperparameters, the clearest is tested even at low odds.
        clearest = max((each.log10_odds for each in others.values()), default=0.0)
        least = _NEAR_CLEAREST * max(clearest, 0.0) if tested or clearest > 0.0 else clearest
        more = tuple(
            each
            for name, each in others.items()
            if each.log10_odds >= least and rejections[name] <= int(each.stands_out)
        )
        if not more and len(moved) == len(judged):
            break
        if len(moved) + len(more) > most or round_ == _ROUNDS_OF_MOTIONS - 1:
            # If most captures seem to have moved, they contradict each other, and no single capture is the cause.
            clear = len(moved) + sum(each.stands_out for each in others.values())
            moved = moved if clear <= _MOST_THAT_MOVE * captures else ()
            break
        smooth = without(moved + more)
    smooth = without(moved)
    stay = tested.keys() - {each.capture for each in moved}
    return replace(smooth, moved=moved, unsure=tuple(tested[name] for name in sorted(stay) if tested[name].is_unsure))


@dataclass(frozen=True)
class _Search:
    """Fits to the same readings without some of the captures; see `fit`."""

    readings: FitReadings
    start: Polynomial
    weights: FloatArray | None
    stage: Stage | None

    def without(self, moved: tuple[CaptureMotion, ...], before: SmoothFit | None = None) -> SmoothFit:
        """Fit to all captures except `moved`, starting from the fit `before`, or from nothing if it is None."""
        still = self._without_motions(moved, before)
        if still.columns is None:
            return still
        return self._with_motions(still, before if before is not None and before.moved == moved else None)

    def _without_motions(self, moved: tuple[CaptureMotion, ...], before: SmoothFit | None) -> SmoothFit:
        """Fit with weights and noise consistent with the fit's residuals; `columns` is set if motions will be added."""
        readings, start = self.readings, self.start
        stays = ~np.isin(readings.capture, [each.capture for each in moved])
        kept = stays * (np.ones(len(readings)) if self.weights is None else self.weights)
        prior = smoothness_prior(readings, moving=False)
        is_noisy = bool(np.any(readings.sigma > 0))
        moves = readings.motion is not None and is_noisy
        starts = [dict(before.posterior.hyper)] if before is not None else search_starts(readings, prior, start, kept)
        if before is not None and before.moved == moved:
            kept = kept if self.weights is not None else kept * before.kept
            readings = readings.with_shared(before.readings.shared)
        elif is_noisy:  # otherwise the fit could absorb shared noise as optics
            spacing = neighbour_distance([readings.image[rows] for rows in rows_by_capture(readings.capture)])
            readings = readings.with_shared(SharedNoise(0.5, 1.4 * spacing) if spacing > 0 else None)
        sums = sums_of(readings, start, None, kept)
        for _ in range(_ROUNDS):
            found = maximise(sums, prior, starts)
            polynomial = polynomial_of(readings, start, found)
            columns = motion_columns(readings, polynomial) if moves else None
            weights = kept if self.weights is not None else _weights(readings, polynomial, columns, kept) * stays
            shared = _shared_noise(readings, polynomial, found, weights) if is_noisy else None
            if np.allclose(weights, kept, atol=0.05) and shared == readings.shared:
                break
            kept, starts, readings = weights, [dict(found.hyper)], readings.with_shared(shared)
            sums = sums_of(readings, start, None, kept)
        return SmoothFit(polynomial, found, readings, kept, moved, prior, columns, start, sums)

    def _with_motions(self, still: SmoothFit, before: SmoothFit | None) -> SmoothFit:
        """Add motions of the captures, starting from the sizes of `before`, a fit to the same captures, if given."""
        start, kept, polynomial = still.start, still.kept, still.polynomial
        readings = still.readings.moving(motion_columns(still.readings, polynomial))
        prior = smoothness_prior(readings, moving=True, stage=self.stage)
        rough, hyper = _rough(readings, kept), dict(zip(prior.names, map(float, prior.expected[:, 0]), strict=True))
        hyper |= {} if before is None else before.posterior.hyper
        hyper |= still.posterior.hyper
        mixed, rows = _rough_axes(readings)
        features, offset = prior.mixed_features[rows], np.broadcast_to(prior.mixed_offset, len(mixed))[rows]
        of_rough = replace(prior, group_offset=0.0, mixed_features=features, mixed_offset=offset)
        curvature = np.zeros(len(prior.names))
        # Motions act through the slopes of the fit and also distort them, so that both are estimated alternately.
        for round_ in range(_MOTION_ROUNDS):
            columns = motion_columns(readings, polynomial)
            readings = readings.moving(columns)
            sums = sums_of(readings, start, columns, kept, still=still.sums)
            if round_ > 0:
                found = maximise(sums.combined(mixed, rough), of_rough, [hyper])
                hyper, curvature = dict(found.hyper), found.curvature
            elif before is None:
                hyper = motion_start(sums.combined(mixed, rough), of_rough, hyper)
            found = posterior(sums, prior, np.clip([hyper[name] for name in prior.names], *prior.bounds.T))
            polynomial = polynomial_of(readings, start, found)
        return SmoothFit(polynomial, found, readings, kept, still.moved, prior, columns, start, sums, curvature)


def _shared_noise(
    readings: FitReadings, polynomial: Polynomial, found: Posterior, kept: FloatArray
) -> SharedNoise | None:
    """Return the noise that neighbouring readings of a capture share, estimated from residuals of inliers."""
    off = (readings.observed - readings.values(polynomial)) * readings.weight[:, None]
    captures = [rows[kept[rows] == 1.0] for rows in rows_by_capture(readings.capture)]

    def unsure(number: int, rows: IntArray) -> FloatArray:
        chosen = captures[number][rows]
        if readings.mixed:
            return np.zeros((len(chosen), 0))
        return found.root_of(readings.design(chosen) * readings.weight[chosen, None])

    return find_shared_noise([readings.image[rows] for rows in captures], [off[rows] for rows in captures], unsure)


def _rough(readings: FitReadings, kept: FloatArray) -> FloatArray:
    """Return combinations (6, captures, k) of the captures' motions that exclude smooth functions of the place.

    Smooth motions are degenerate with the optics' dependence on the place: optics of higher order than the fit would
    look like camera motions of any size. The unknowns of the combinations have a standard normal prior, up to the
    factors.
    """
    captures = int(readings.capture.max()) + 1
    used = np.flatnonzero(np.bincount(readings.capture, kept > 0, captures))
    middle = means_by(readings.capture, readings.inputs[:, readings.is_place])[used]
    # Smooth motions must include those linear in the place, unless the sizes of motions are stated.
    rest, fewest = (
        (_REST_IF_STATED, 1) if readings.motion_prior is not None else (_REST_IF_UNKNOWN, 1 + middle.shape[1])
    )
    if (1.0 - rest) * len(used) < fewest:
        return np.zeros((6, captures, 0))
    values, extent, _ = np.linalg.svd(smooth_basis(middle, 1.0 - rest), full_matrices=False)
    values = values[:, extent > 1e-6 * extent[0]]
    rough = np.zeros((6, captures, len(used) - values.shape[1]))
    for axis, own in enumerate(motion_sizes(readings)[used].T):
        # In units of the prior sizes, motions are independent, and so are their parts along and across smooth motions.
        across = np.linalg.qr(values / own[:, None], mode="complete")[0][:, values.shape[1] :]
        rough[axis, used] = own[:, None] * across
    return rough


def _rough_axes(readings: FitReadings) -> tuple[FloatArray, IntArray]:
    """Return combinations of unknowns common to both outputs, without smooth errors by reading of an axis.

    Returns:
        Combinations (mixed, k), and the number (k,) of an unknown with the same prior size for each.
    """
    first = readings.parameters + sum(len(each.offset) for each in readings.joint_terms)
    last = first + sum(len(each.offset) for each in readings.stage_terms)
    rough = np.zeros((0, 0)) if readings.stage is None else readings.stage.rough()
    mixed = scipy.linalg.block_diag(np.eye(first), rough, np.eye(last - first - len(rough)))
    return mixed, np.delete(np.arange(last), first + np.arange(rough.shape[1], len(rough)))


def _with_terms_beyond(readings: FitReadings) -> FitReadings:
    """Return the readings of a low-order fit with higher orders, because missing orders look like camera motions."""
    limits, variables = readings.limits, readings.is_place
    if readings.trend is not None or not _FEW_ORDERS < limits.total < _ENOUGH_ORDERS:
        return readings
    most = (limits.pixel, limits.place, limits.total)
    more = Limits(*(min(order + _ORDERS_BEYOND, _ENOUGH_ORDERS) for order in most))
    wider = replace(readings, orders=more.orders(int(np.sum(~variables)), int(np.sum(variables))))
    return wider.within(readings.box)


def _suspects(smooth: SmoothFit, kept: FloatArray) -> tuple[dict[int, CaptureMotion], dict[int, CaptureMotion]]:
    """Return captures that may have moved, and captures left out before, tested against the others, by index.

    Args:
        smooth: a fit.
        kept: (n,) weights of the readings, from 1 to 0 for outliers, with those of captures that are left out.
    """
    readings, out = smooth.readings, [each.capture for each in smooth.moved]
    offset = np.log(motion_sizes(readings))
    columns, judge = motion_columns(readings, smooth.polynomial), _with_terms_beyond(readings)
    still = smooth.sums if judge is readings and not out else None
    prior = smoothness_prior(judge, moving=True)
    values, sums = _without_axes(readings, smooth), sums_of(judge, smooth.start, columns, kept, still=still)
    offset[out, SHIFT], offset[out, TURN] = np.log(_ANY_MOTION) - values[-2:]
    found = posterior(sums, replace(prior, group_offset=offset), values)
    factors = np.exp(smooth.prior.group_features @ values)
    size = np.exp(offset) * factors
    usual = usual_motion(readings, factors, found.group_mean, np.setdiff1d(readings.capture, out))
    off = (readings.observed - readings.values(smooth.polynomial)) * readings.metric[:, None]
    first, place = found.mixed_mean.size, means_by(readings.capture, readings.inputs[:, readings.is_place])
    odds, motion = moved_odds(found.group_mean, found.side_covariance[first:, first:], size, usual, place)
    found_of = {}
    for name in map(int, np.unique(readings.capture)):
        shift, turn = (float(np.linalg.norm(motion[name, part])) for part in (SHIFT, TURN))
        arcmin = float(np.linalg.norm(off[readings.capture == name].mean(axis=0)))
        found_of[name] = CaptureMotion(name, shift, turn, arcmin, float(odds[name]))
    before = {name: found_of.pop(name) for name in out}
    return {name: each for name, each in found_of.items() if each.is_suspect}, before


def _without_axes(readings: FitReadings, smooth: SmoothFit) -> FloatArray:
    """Return hyperparameters with ordinary errors by reading of the stage's axes, and the excess added to motions.

    A capture that moved makes the errors at its own readings look large.
    """
    values, names = smooth.hyper.copy(), smooth.prior.names
    for term in readings.stage_terms:
        row, most = names.index(term.name), float(np.log(term.usual.value)) + term.usual.log_sigma
        more = max(np.exp(2.0 * values[row]) - np.exp(2.0 * most), 0.0) / motion_scale(readings)[0] ** 2
        values[row] = min(values[row], most)
        values[-2] = 0.5 * np.log(np.exp(2.0 * values[-2]) + more)
    return values


def _weights(readings: FitReadings, polynomial: Polynomial, columns: FloatArray | None, kept: FloatArray) -> FloatArray:
    """Return weights of 1 for readings near the model, falling to 0 far from it (Hampel's descending function).

    If cameras may have moved, a capture's fitted motion is first removed from the residuals.
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

"""Priors of optics, noise and stage for a fit, with the bounds and starting points of the hyperparameter search.

A coefficient of order a in the pixel (or direction) and b in the place has the prior size exp(size - lambda a - mu b),
with a slope for each variable.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np
import scipy

from wlr_render.calibration.label_terms import FALLS_DIFFER, USUAL_FALL, LabelTerm
from wlr_render.calibration.reading_sums import sums_of
from wlr_render.calibration.readings import FitReadings, flat_places
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.evidence import Prior, Sums, posterior
from wlr_render.numerics.polynomial import Polynomial
from wlr_render.usual import STAGE_REPEATABILITY_M, STAGE_TURN_RAD

NOISE_FLOOR_ARCMIN = 1e-3
"""Least noise of readings that state more or none; for exact data, smaller noise would depend on rounding."""
LARGEST_SHIFT_M, LARGEST_TURN_RAD = 1e-3, 3e-3
"""Largest repeatability of a stage; larger motions have another cause."""
SHIFT, TURN = slice(0, 3), slice(3, 6)
LEAST_MOTION = 1e-9  # least size of motions, metres and radians
_MOST_TIMES = 10.0  # largest factor by which stated sizes may be wrong
_SHIFTS, _TURNS = (-0.6, 1.2, 2.8), (-1.0, 0.8, 2.5)  # starts of the search for motion sizes, in log sigmas
_STARTS = ((-1.0, 0.7, 0.7, 0.3), (-1.0, 1.2, 1.5, 0.03), (-4.0, 0.7, 0.7, 1.0))  # size, lambda, mu, noise
_USUAL_SLOPES = (2.5, 1.5)  # prior means of mu and lambda, for uninformative readings; sigma 1
_FOOTPRINT, _USUAL_FOOTPRINT = "footprint", (1.0, 0.5)  # exponent of `_log_ways`: name, prior mean and sigma
_FALL = "fall"  # name of the hyperparameter for the decrease of wave sizes with frequency
_LEAST_SHARE, _MOST_TIMES_USUAL = 7.0, 2.5  # bounds of the size of errors by label, in log ratios to the usual size
_MOTIONS = "shift", "turn"  # names of the hyperparameters for motion sizes
_NO_SIZE = -25.0  # logarithm of a prior size that suppresses all terms
Stage = Mapping[str, tuple[float, float]]
"""Estimates of a stage's errors from other captures, by hyperparameter: mean and sigma of the natural logarithm of the
size. "shift" and "turn" are in units of `motion_scale`, "axes" and "travel" in metres."""


def smoothness_prior(readings: FitReadings, moving: bool, stage: Stage | None = None) -> Prior:
    """Return the prior of a fit to the readings, with or without motions of the captures.

    Args:
        readings: the readings to fit.
        moving: True to include motions of the captures.
        stage: prior of the stage's errors from other captures; None for stated errors, or usual ones.
    """
    blocks, orders, free = readings.blocks, readings.orders, readings.free
    smooth_as, ways = _smooth_as(readings), _log_ways(readings)
    axes = sorted(set(smooth_as))
    unknown = _hyperparameters(readings, axes, bool(np.any(ways)), moving, stage or {})
    names = tuple(each.name for each in unknown)
    by_term = np.zeros((blocks, len(orders), len(names)))
    for block in range(blocks):
        by_term[block, ~free, block] = 1.0
        for axis, other in enumerate(smooth_as):
            by_term[block, ~free, blocks + axes.index(other)] -= orders[~free, axis]
        if _FOOTPRINT in names:
            by_term[block, ~free, names.index(_FOOTPRINT)] = ways[~free]
    flat = by_term.reshape(-1, len(names))
    none = np.zeros((0, len(names)))
    own_part, shared_part = (none, flat) if readings.mixed else (flat, np.zeros((readings.parameters, len(names))))
    features, offset = _with_terms(own_part, readings.axis_terms, names)
    mixed_features, mixed_offset = _with_terms(shared_part, readings.shared_terms, names)
    own = np.zeros((6 if moving else 0, len(names)))
    group_offset: FloatArray | float = 0.0
    if moving:
        own[SHIFT, -2] = own[TURN, -1] = 1.0
        group_offset = np.log(motion_sizes(readings))
    bounds = np.array([[each.least, each.most] for each in unknown])
    expected = np.array([[each.mean, each.sigma] for each in unknown])
    return Prior(names, bounds, expected, features, mixed_features, own, group_offset, offset, mixed_offset)


class _Hyperparameter(NamedTuple):
    """A natural logarithm or a slope, with its bounds and the mean and sigma of its prior."""

    name: str
    least: float
    most: float
    mean: float = 0.0
    sigma: float = np.inf


def _hyperparameters(
    readings: FitReadings, axes: Sequence[int], has_footprint: bool, moving: bool, stage: Stage
) -> list[_Hyperparameter]:
    """Return sizes of polynomials, slopes by axis, sizes of errors by label, noise, and sizes of motions."""
    unknown = [_Hyperparameter(f"size {block}", _NO_SIZE, 8.0) for block in range(readings.blocks)]
    for axis in axes:
        name, usual = ("mu", _USUAL_SLOPES[0]) if readings.is_place[axis] else ("lambda", _USUAL_SLOPES[1])
        unknown.append(_Hyperparameter(f"{name} {axis}", 0.0, 8.0, usual, 1.0))
    if has_footprint:
        unknown.append(_Hyperparameter(_FOOTPRINT, 0.0, 2.0, *_USUAL_FOOTPRINT))
    terms = readings.axis_terms + readings.shared_terms
    for term in terms:
        usual = float(np.log(term.usual.value))
        bounds = usual - _LEAST_SHARE, usual + _MOST_TIMES_USUAL  # range of ordinary errors
        unknown.append(_Hyperparameter(term.name, *bounds, usual, term.usual.log_sigma))
    if any(each.frequency is not None for each in terms):
        unknown.append(_Hyperparameter(_FALL, 0.0, 5.0, USUAL_FALL, FALLS_DIFFER))
    unknown.append(_Hyperparameter("noise", float(np.log(noise_floor(readings))), 12.0))
    if moving:
        stated = readings.motion_prior
        sigma = STAGE_REPEATABILITY_M.log_sigma if stated is None else stated.log_sigma
        for name, size, most in zip(_MOTIONS, motion_scale(readings), (LARGEST_SHIFT_M, LARGEST_TURN_RAD), strict=True):
            bounds = np.log(LEAST_MOTION / size), np.log(max(most / size, _MOST_TIMES))
            unknown.append(_Hyperparameter(name, *bounds, 0.0, sigma))
    for row, each in enumerate(unknown):
        if each.name in stage:
            mean, sigma = stage[each.name]
            unknown[row] = each._replace(mean=mean, sigma=sigma)
    return unknown


def _with_terms(
    features: FloatArray, terms: Sequence[LabelTerm], names: Sequence[str]
) -> tuple[FloatArray, FloatArray]:
    """Return features (k, hyperparameters) and offset of the model's unknowns, then of errors by label."""
    parts, offset = [features], [np.zeros(len(features))]
    for term in terms:
        own = np.zeros((len(term.offset), len(names)))
        own[:, names.index(term.name)] = 1.0
        if term.frequency is not None:
            own[:, names.index(_FALL)] = -term.frequency
        parts.append(own)
        offset.append(term.offset)
    return np.concatenate(parts), np.concatenate(offset)


def prior_squares(readings: FitReadings, hyper: Mapping[str, float]) -> FloatArray:
    """Return the prior mean square (blocks, terms) of each term over the box, infinite for free terms.

    Args:
        readings: readings with these terms.
        hyper: hyperparameters estimated by a fit, logarithms.
    """
    prior = smoothness_prior(readings, moving=False)
    every = prior.mixed_features if readings.mixed else prior.features
    features = every[: readings.blocks * len(readings.orders)]
    size = np.exp(features @ [hyper[name] for name in prior.names]).reshape(readings.blocks, -1)
    square = size**2 * 0.5 ** np.count_nonzero(readings.orders, axis=1)  # a Chebyshev polynomial's mean square is 1/2
    square[:, readings.free] = np.inf
    return np.asarray(square)


def _log_ways(readings: FitReadings) -> FloatArray:
    """Return the logarithm (terms,) of the coefficient of a product of powers in a power of the ray's footprint.

    The footprint on a surface of the optics is the sum of the place and a multiple of the pixel or direction; its
    powers have mixed terms with binomial coefficients.
    """
    place = np.flatnonzero(readings.is_place)
    subject = np.flatnonzero(~readings.is_place)
    pairs = zip(readings.orders[:, subject].T, readings.orders[:, place].T, strict=False)
    ways = np.ones(len(readings.orders))
    for of_subject, of_place in pairs:
        ways = ways * scipy.special.binom(of_subject + of_place, of_place)
    return np.asarray(np.log(ways))


def motion_sizes(readings: FitReadings) -> FloatArray:
    """Return prior sizes (captures, 6) of the camera's shift (m) and turn (rad), up to a common factor for each."""
    if readings.motion_prior is None:
        usual = np.repeat([STAGE_REPEATABILITY_M.value, STAGE_TURN_RAD.value], 3)
        return np.tile(usual, (int(readings.capture.max()) + 1, 1))
    return np.maximum(np.roll(readings.motion_prior.size, 3, axis=1), LEAST_MOTION)


def motion_scale(readings: FitReadings) -> FloatArray:
    """Return the root mean square (2,) of `motion_sizes` per axis: shift in metres, turn in radians."""
    return np.asarray(np.sqrt(np.mean(motion_sizes(readings).reshape(-1, 2, 3) ** 2, axis=(0, 2))))


def _smooth_as(readings: FitReadings) -> list[int]:
    """Return, for each variable, the variable with its prior slope: itself, or another one if it has no extent.

    Readings at one place do not determine how fast the optics change around it; a fit would find constant optics.
    """
    flat = flat_places(readings.inputs, readings.is_place)
    known = np.flatnonzero(readings.is_place & ~flat)
    other = int(known[0]) if known.size else int(np.flatnonzero(~readings.is_place)[0])
    return [other if flat[axis] else axis for axis in range(len(flat))]


def noise_floor(readings: FitReadings) -> float:
    """Return the least noise of a fit, relative to the stated sigma and at most 1; in arcminutes if none is stated."""
    stated = readings.sigma[readings.sigma > 0]
    return min(NOISE_FLOOR_ARCMIN / float(np.median(stated)), 1.0) if stated.size else NOISE_FLOOR_ARCMIN


def search_starts(readings: FitReadings, prior: Prior, start: Polynomial, kept: FloatArray) -> list[dict[str, float]]:
    """Return the starting points of the hyperparameter search.

    With a trend, the starting sizes come from its residuals; one start has no terms, in case the trend is exact.
    """
    starts: Sequence[tuple[float, float, float, float]] = _STARTS
    if readings.trend is not None:
        alone = replace(readings, orders=readings.orders[:0])
        without = smoothness_prior(alone, moving=False)
        sums = sums_of(alone, start, None, kept)
        rest = posterior(sums, without, np.array(list(_start_hyper(without, *_STARTS[-1]).values())))
        left = max(float(np.sqrt(rest.square / max(sums.count, 1))), noise_floor(readings))
        size = float(np.log(left / np.median(readings.weight)))
        starts = [(_NO_SIZE, 0.7, 0.7, left)]
        if len(readings.orders):
            starts += [(size, 0.7, 0.7, 0.3 * left), (size, 1.3, 2.5, left), (size - 3.0, 0.7, 0.7, left)]
    return [_start_hyper(prior, *values) for values in starts]


def _start_hyper(prior: Prior, size: float, slope: float, by_place: float, noise: float) -> dict[str, float]:
    values = {
        "size": size,
        "lambda": slope,
        "mu": by_place,
        _FOOTPRINT: _USUAL_FOOTPRINT[0],
        "noise": float(np.log(noise)),
    }
    of_labels = dict(zip(prior.names, map(float, prior.expected[:, 0]), strict=True))
    return {name: values.get(name.split()[0], of_labels[name]) for name in prior.names}


def motion_start(sums: Sums, prior: Prior, still: dict[str, float]) -> dict[str, float]:
    """Return the best of a few sizes of the motion, because the evidence may have several maxima."""
    mean, sigma = prior.expected[-2:].T
    starts = [still | dict(zip(_MOTIONS, mean + at * sigma, strict=True)) for at in product(_SHIFTS, _TURNS)]
    starts.append(still | dict(zip(_MOTIONS, prior.bounds[-2:, 0], strict=True)))

    def evidence(start: dict[str, float]) -> float:
        try:
            hyper = np.clip([start[name] for name in prior.names], *prior.bounds.T)
            return posterior(sums, prior, hyper).log_evidence - prior.surprise(hyper)[0]
        except np.linalg.LinAlgError:
            return -np.inf

    return max(starts, key=evidence)

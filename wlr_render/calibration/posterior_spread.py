"""Low-rank factors of a fit's posterior covariance, as stored in models."""

import numpy as np
import scipy

from wlr_render.calibration.reading_sums import Response
from wlr_render.calibration.readings import FitReadings, design_of
from wlr_render.error_sources import ErrorSource
from wlr_render.models.spread import Covariance
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.polynomial import Polynomial, basis
from wlr_render.numerics.posterior import Posterior

_KEPT = 0.98  # share of the predictions' variance that low-rank factors keep, which makes sigmas 1 % too small
_SAMPLES = 500  # number of readings for the estimate of this share
_OF_LABEL = 12  # most variables of an error by label; display and see-through need the same number


def spread_of(
    readings: FitReadings, found: Posterior, response: Response | None = None, beyond: FloatArray | None = None
) -> Covariance:
    """Return low-rank factors of the posterior covariance that keep most of the variance at some of the readings.

    Args:
        readings: the fitted readings.
        found: the posterior.
        response: response of the fit to errors that it does not estimate.
        beyond: (blocks,) variance that terms outside the fit add to an output; None for no variance.
    """
    orders, box, blocks = readings.orders, readings.box, readings.blocks
    outputs, parameters = blocks * (1 if readings.mixed else 2), 0
    rows, inputs = _sample(readings)
    sample, weight = basis(inputs, orders, box), readings.metric[rows]
    if readings.mixed:
        design = np.einsum("nrb,nt->nrbt", readings.multiplier[rows] * weight[:, None, None], sample)
        root = principal_root(found.side_covariance)
        joint = root @ principal(design.reshape(2 * len(rows), -1) @ root)
        joint = _with_constant(joint.reshape(blocks, len(orders), -1).transpose(1, 0, 2), orders, beyond)
        apart = np.zeros((len(orders), 0))
        joint_orders = orders
        parts = [joint[..., :0], joint]
    else:
        design, own = design_of(readings, rows, sample) * weight[:, None], readings.coefficients
        of_labels = _by_own_labels(readings, found)
        root = principal_root(found.alone[:own, :own] - of_labels @ of_labels.T)
        apart_root = root @ principal(design @ root)
        own_factors = apart_root.reshape(blocks, len(orders), apart_root.shape[1]).transpose(1, 0, 2)
        own_factors = _with_constant(own_factors, orders, beyond)
        apart = own_factors.reshape(len(orders), blocks * own_factors.shape[2])
        parameters = readings.parameters
        side = _by_side(readings, found)
        joint_orders = side.orders
        root = np.delete(lower_root(found.side_covariance), slice(parameters, found.mixed_mean.size), axis=1)
        joint = side.coefficients.reshape(len(joint_orders), outputs, -1) @ root
        sampled = Polynomial(joint_orders, box, joint.reshape(len(joint_orders), -1))(inputs)
        sampled = np.einsum("nb,nbok->nok", readings.multiplier[rows], sampled.reshape(len(rows), blocks, 2, -1))
        sampled = (sampled * weight[:, None, None]).reshape(2 * len(rows), -1)
        keep = principal(sampled[:, parameters:], float(np.sum((design @ apart_root) ** 2)) * 2.0)
        parts = [joint[..., :parameters], joint[..., parameters:] @ keep]
    sources: tuple[str, ...] = (ErrorSource.PRESCRIPTION,) * parameters
    if response is not None:
        parts.insert(1, _by_errors(readings, response, joint_orders))
        sources += response.sources
    joint = np.concatenate(parts, axis=-1)
    return Covariance(
        outputs,
        Polynomial(orders, box, apart),
        Polynomial(joint_orders, box, joint.reshape(len(joint_orders), -1)),
        sources,
    )


def label_response(readings: FitReadings, found: Posterior) -> Response:
    """Return the contribution of errors by label to a model, by source.

    It is the difference between the model's covariance and its covariance for known errors by label.
    """
    own, parameters = readings.coefficients, readings.parameters
    few = response = Response((), np.zeros((0, 2, own)), np.zeros((0, parameters)))
    of_axis, first = _by_own_labels(readings, found), 0
    for term in readings.axis_terms:
        factor, first = of_axis[:, first : first + len(term.offset)].T, first + len(term.offset)
        none = np.zeros_like(factor)
        both = np.concatenate([np.stack([factor, none], axis=1), np.stack([none, factor], axis=1)])
        if term.mean:
            constant = np.flatnonzero(readings.orders.sum(axis=1) == 0)[:1]
            size = term.mean * np.exp(found.hyper[term.name])
            means = np.zeros((2 * len(constant), 2, own))
            means[np.arange(len(means)), np.arange(len(means)), np.tile(constant, 2)] = size
            both = np.concatenate([both, means])
        response = Response((term.source,) * len(both), both, np.zeros((len(both), parameters))).beside(response)
    root, first = lower_root(found.side_covariance) if readings.shared_terms else np.zeros((0, 0)), parameters
    for term in readings.shared_terms:
        factor, first = root[:, first : first + len(term.offset)], first + len(term.offset)
        of_axes = np.stack([factor.T @ follow[:, :own] for follow in found.by_side], axis=1)
        response = Response((term.source,) * len(of_axes), of_axes, factor[:parameters].T).beside(response)
    rows, inputs = _sample(readings)
    design = (
        design_of(readings, rows, basis(inputs, readings.orders, readings.box)) if own else np.zeros((len(rows), 0))
    )
    shared, metric = readings.shared_columns(rows)[:, :, :parameters], readings.metric[rows, None, None]
    for source in dict.fromkeys(response.sources):
        these = np.array([each == source for each in response.sources])
        of_axes, mixed = response.coefficients[these], response.mixed[these]
        sampled = metric * ((of_axes @ design.T).transpose(2, 1, 0) + shared @ mixed.T)
        fewer = principal(sampled.reshape(-1, len(mixed)), most=_OF_LABEL).T
        names = (source,) * len(fewer)
        few = Response(names, np.tensordot(fewer, of_axes, axes=1), fewer @ mixed).beside(few)
    return few


def _by_own_labels(readings: FitReadings, found: Posterior) -> FloatArray:
    """Return factors (columns, k) of the covariance of an output's coefficients due to its own errors by label."""
    own = readings.coefficients
    if not readings.axis_terms:
        return np.zeros((own, 0))
    root = lower_root(found.alone[own:, own:])
    return np.asarray(scipy.linalg.solve_triangular(root, found.alone[own:, :own], lower=True).T)


def _sample(readings: FitReadings) -> tuple[IntArray, FloatArray]:
    """Return some of the readings and their inputs, half of them with places elsewhere in the box."""
    rng = np.random.default_rng(0)
    rows = rng.permutation(len(readings))[:_SAMPLES]
    inputs = readings.inputs[rows]
    elsewhere = rng.uniform(readings.box.low, readings.box.high, inputs.shape)
    return rows, np.where(readings.is_place & (np.arange(len(rows)) % 2 == 0)[:, None], elsewhere, inputs)


def _by_side(readings: FitReadings, found: Posterior) -> Polynomial:
    """Return the derivative (outputs * side) of a fitted polynomial by the side unknowns, trend parameters first."""
    orders, trend, outputs = readings.orders, readings.trend, 2 * readings.blocks
    follow = found.by_side[:, :, : readings.coefficients].transpose(0, 2, 1)  # (2, columns, side)
    unknowns = follow.shape[2]
    by_axis = follow.reshape(2, readings.blocks, len(orders), unknowns).transpose(2, 1, 0, 3)
    side = Polynomial(orders, readings.box, by_axis.reshape(len(orders), outputs * unknowns))
    if trend is None:
        return side
    by_parameter = trend.by_parameter.coefficients.reshape(len(trend.by_parameter.orders), outputs, -1)
    padded = np.zeros((*by_parameter.shape[:2], unknowns))
    padded[..., : trend.parameters] = by_parameter
    return side.plus(Polynomial(trend.by_parameter.orders, readings.box, padded.reshape(len(padded), -1)))


def _with_constant(factors: FloatArray, orders: IntArray, beyond: FloatArray | None) -> FloatArray:
    """Append factors of a constant variance (blocks,) to factors (terms, blocks, rank)."""
    if beyond is None or not beyond.any():
        return factors
    constant = (orders.sum(axis=1) == 0)[:, None, None]
    return np.concatenate([factors, constant * np.diag(np.sqrt(beyond))], axis=2)


def principal_root(covariance: FloatArray) -> FloatArray:
    """Return F with F F' = covariance, independent of the scales of the unknowns."""
    scale = np.sqrt(np.diag(covariance))
    scale = np.where(scale > 0, scale, 1.0)
    values, vectors = np.linalg.eigh(covariance / scale[:, None] / scale)
    return np.asarray(scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))


def _by_errors(readings: FitReadings, response: Response, orders: IntArray) -> FloatArray:
    """Return coefficients (terms, outputs, k), in terms of `orders`, of the change of a fitted polynomial by errors."""
    k, terms, blocks = len(response.sources), len(readings.orders), readings.blocks
    if readings.mixed:
        return response.mixed.reshape(k, blocks, terms).transpose(2, 1, 0)
    of_terms = response.coefficients.reshape(k, 2, blocks, terms).transpose(3, 2, 1, 0).reshape(terms, 2 * blocks * k)
    row_of = {tuple(order): row for row, order in enumerate(orders.tolist())}
    change = np.zeros((len(orders), of_terms.shape[1]))
    change[[row_of[tuple(order)] for order in readings.orders.tolist()]] = of_terms
    if readings.trend:
        by = readings.trend.by_parameter
        of_trend = by.coefficients.reshape(len(by.orders), 2 * blocks, -1) @ response.mixed.T
        change[[row_of[tuple(order)] for order in by.orders.tolist()]] += of_trend.reshape(len(by.orders), -1)
    return change.reshape(len(orders), 2 * blocks, k)


def lower_root(covariance: FloatArray, jitter: float = 1e-12) -> FloatArray:
    """Return lower triangular F with F F' = covariance, so that the first unknowns depend only on the first variables.

    A share `jitter` of each variance is added, for covariances that are singular to rounding.
    """
    scale = np.sqrt(np.diag(covariance))
    scale = np.where(scale > 0, scale, 1.0)
    correlation = covariance / scale[:, None] / scale + jitter * np.eye(len(covariance))
    return np.asarray(scale[:, None] * np.linalg.cholesky(correlation))


def principal(sampled: FloatArray, others: float = 0.0, most: int | None = None) -> FloatArray:
    """Return directions (k, rank) of standard normal variables that keep `_KEPT` of the variance of samples (n, k).

    The scale preserves the mean variance of the samples. The rank is 0 if the samples are negligible relative to
    `others`, the sum of squares of further samples. With `most`, the rank is `most` or k, whichever is less.
    """
    values, vectors = np.linalg.eigh(sampled.T @ sampled)
    values, vectors = np.maximum(values[::-1], 0.0), vectors[:, ::-1]
    total = float(values.sum())
    if most is not None:
        most = min(most, len(values))
        return np.asarray(vectors[:, :most] * np.sqrt(total / max(float(values[:most].sum()), 1e-300)))
    if total <= (1.0 - _KEPT) * 0.01 * others or total == 0.0:
        return np.zeros((sampled.shape[1], 0))
    running = np.cumsum(values)
    rank = int(np.searchsorted(running, _KEPT * total)) + 1
    return np.asarray(vectors[:, :rank] * np.sqrt(total / running[rank - 1]))

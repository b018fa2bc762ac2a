"""Sums over the readings of a fit and polynomials of their posterior: the link from `FitReadings` to `numerics`."""

from dataclasses import dataclass

import numpy as np

from wlr_render.calibration.readings import FitReadings, design_of
from wlr_render.errors import BadInputError
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.evidence import Sums, weight_values
from wlr_render.numerics.polynomial import Polynomial, basis
from wlr_render.numerics.posterior import Posterior


@dataclass(frozen=True)
class Response:
    """Response of a fit to errors that it does not estimate, as k independent standard normal variables.

    Attributes:
        sources: (k,) name of each error's source.
        coefficients: (k, 2, columns) change of each axis' coefficients. mixed: (k, columns) change of shared unknowns,
            i.e. the parameters of the trend, or the coefficients of mixed polynomials.
    """

    sources: tuple[str, ...]
    coefficients: FloatArray
    mixed: FloatArray

    def beside(self, other: "Response | None") -> "Response":
        """Return the response to the errors of `other`, followed by these."""
        if other is None:
            return self
        of_axes, mixed = (other.coefficients, self.coefficients), (other.mixed, self.mixed)
        return Response(other.sources + self.sources, np.concatenate(of_axes), np.concatenate(mixed))

    def between(self, before: tuple[str, ...], after: tuple[str, ...]) -> "Response":
        """Return the response to these errors between others, of named sources, to which the fit does not respond."""
        pad = (len(before), len(after))
        coefficients, mixed = np.pad(self.coefficients, (pad, (0, 0), (0, 0))), np.pad(self.mixed, (pad, (0, 0)))
        return Response(before + self.sources + after, coefficients, mixed)


class UndeterminedModelError(BadInputError):
    """Error for readings that do not determine an unknown without a prior."""


def free_part(readings: FitReadings) -> Polynomial:
    """Fit the few free terms by least squares, because sums over small residuals keep more digits.

    Raises:
        BadInputError: the readings do not determine the free terms.
    """
    orders = readings.orders[readings.free]
    outputs = readings.blocks * (1 if readings.mixed else 2)
    if len(orders) == 0:
        return Polynomial(orders, readings.box, np.zeros((0, outputs)))
    design = design_of(readings, slice(None), basis(readings.inputs, orders, readings.box))
    values = readings.observed[:, :, None] if readings.mixed else readings.observed
    weight = readings.weight.reshape(-1, *[1] * (design.ndim - 1))
    design, values = design * weight, values * weight
    columns = design.shape[-1]
    design, values = design.reshape(-1, columns), values.reshape(-1, values.shape[-1])
    scale = np.linalg.norm(design, axis=0)
    solution, _, rank, _ = np.linalg.lstsq(design / np.where(scale > 0, scale, 1.0), values, rcond=1e-7)
    if rank < columns:
        raise UndeterminedModelError(f"{rank} of {columns} unknowns that no prior holds are determined")
    solution = solution / scale[:, None]
    by_term = solution.reshape(readings.blocks, len(orders), -1).transpose(1, 0, 2)
    return Polynomial(orders, readings.box, np.ascontiguousarray(by_term.reshape(len(orders), -1)))


def sums_of(
    readings: FitReadings,
    start: Polynomial | None,
    motion: FloatArray | None,
    kept: FloatArray,
    captures: int | None = None,
    still: Sums | None = None,
) -> Sums:
    """Return sums over the readings minus their free part and trend.

    Args:
        readings: the readings.
        start: the free part; None for sums without values.
        motion: (n, 2, 6) columns of the motion of each reading's camera; None without motions.
        kept: (n,) weights of the readings.
        captures: number of camera positions; None to count the readings' positions.
        still: sums of the same readings and weights without motions, if available; they save most of the work.
    """
    own = 0 if motion is None else 6
    groups = (captures or int(readings.capture.max()) + 1) if own else 0
    trend = readings.trend
    columns = readings.coefficients + sum(len(each.offset) for each in readings.axis_terms)
    side = readings.parameters + sum(len(each.offset) for each in readings.shared_terms), groups, own
    sums = Sums(columns, 2, *side) if still is None else still.with_side(*side)
    observed = np.zeros_like(readings.observed)
    if start is not None and len(readings):
        observed = readings.observed - readings.values(start)
        observed = observed - (readings.values(trend.mean) if trend else 0.0)
    for rows, weight in readings.blocks_of_noise(kept):
        design = np.empty((len(rows), 0)) if readings.mixed else readings.design(rows)
        if still is None:
            sums.add(observed[rows], weight, design)
        grouped = None if motion is None else motion[rows]
        shared = readings.shared_columns(rows) if sums.mixed else None
        sums.add_side(observed[rows], weight, design, shared, grouped, readings.capture[rows])
    return sums


def response_of(
    readings: FitReadings,
    errors: FloatArray,
    sources: tuple[str, ...],
    kept: FloatArray,
    sums: Sums,
    found: Posterior,
) -> Response:
    """Return the response of a fit to errors of its readings.

    Args:
        readings: readings of a model that depends on the place.
        errors: (n, 2, k) change of `observed` minus the model by each error. sources: (k,) source of each error.
        kept: (n,) weights of the fit.
        sums: sums over the readings.
        found: posterior of the fit.
    """
    noise, width = found.noise, found.sizes[len(found.side_used) :] / found.noise
    columns, parameters, k = len(sums.gram), readings.parameters, errors.shape[2]
    moment, by_trend = np.zeros((2, columns, k)), np.zeros((parameters, k))
    for rows, weight in readings.blocks_of_noise(kept):
        design = readings.design(rows)
        weighted = weight_values(weight, weight_values(weight, errors[rows]), transposed=True)
        for axis in (0, 1):
            moment[axis] += design.T @ weighted[:, axis]
        if parameters:
            of_trend = readings.shared_columns(rows)[:, :, :parameters]
            by_trend += of_trend.reshape(-1, parameters).T @ weighted.reshape(-1, k)
    normal = width[:, None] * sums.gram * width + np.eye(columns)
    # Solve for each axis' coefficients first, then for the trend's parameters by the Schur complement.
    cross = [width[:, None] * each[:parameters].T for each in sums.side_cross]
    pull = [width[:, None] * each for each in moment]
    follow = [np.linalg.solve(normal, np.hstack(each)) for each in zip(pull, cross, strict=True)]
    of_parameters: FloatArray = np.zeros((parameters, k))
    if parameters:
        rest = sums.side_gram[:parameters, :parameters] + noise**2 * np.eye(parameters)
        rest = rest - sum(each.T @ solved[:, k:] for each, solved in zip(cross, follow, strict=True))
        aim = by_trend - sum(each.T @ solved[:, :k] for each, solved in zip(cross, follow, strict=True))
        of_parameters = np.asarray(np.linalg.solve(rest, aim), np.float64)
    of_axes = [width[:, None] * (solved[:, :k] - solved[:, k:] @ of_parameters) for solved in follow]
    coefficients = np.stack(of_axes).transpose(2, 0, 1)[:, :, : readings.coefficients]
    return Response(sources, coefficients, of_parameters.T)


def polynomial_of(readings: FitReadings, start: Polynomial, found: Posterior) -> Polynomial:
    """Return the polynomial of a posterior, with its free part `start` and its trend."""
    blocks, terms = readings.blocks, len(readings.orders)
    outputs = 1 if readings.mixed else 2
    of_model = found.mixed_mean[: readings.parameters]
    mean = of_model if readings.mixed else found.mean[:, : readings.coefficients]
    by_term = mean.reshape(outputs, blocks, terms).transpose(2, 1, 0).reshape(terms, blocks * outputs)
    coefficients = by_term.copy()
    coefficients[readings.free] += start.coefficients
    polynomial = Polynomial(readings.orders, readings.box, coefficients)
    if readings.trend is None:
        return polynomial
    mean_part, by_parameter = readings.trend.mean, readings.trend.by_parameter
    moved = by_parameter.coefficients.reshape(len(by_parameter.orders), -1, readings.parameters) @ of_model
    return polynomial.plus(mean_part).plus(Polynomial(by_parameter.orders, by_parameter.box, moved))


def label_values(readings: FitReadings, found: Posterior) -> FloatArray:
    """Return the posterior mean of the readings' errors by label (n, 2)."""
    own, changes = readings.coefficients, np.zeros_like(readings.observed)
    for term in readings.axis_terms:
        changes += term.columns @ found.mean[:, own : own + len(term.offset)].T
        own += len(term.offset)
    side = readings.parameters
    for term in readings.shared_terms:
        changes += term.columns @ found.mixed_mean[side : side + len(term.offset)]
        side += len(term.offset)
    return changes

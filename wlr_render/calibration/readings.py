"""Readings of captures as linear equations in the coefficients of polynomials, the input of every fit."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from wlr_render.calibration.label_terms import LabelTerm, StageLabels
from wlr_render.captures.correspondences import DisplayCaptures, SeeThroughCaptures
from wlr_render.captures.feature_captures import CaptureMotionPrior
from wlr_render.geometry.directions import ARCMIN, tangents_by_turn
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray
from wlr_render.numerics.evidence import Weights
from wlr_render.numerics.polynomial import Box, Polynomial, basis, limited_orders
from wlr_render.numerics.shared_noise import SharedNoise

_CHUNK = 4_096  # number of readings whose design is in memory at a time
_FLAT_M, _FLAT = 1e-6, 0.03
"""Largest negligible extent of places along an axis, in metres and relative to the widest axis."""
_THIN = 0.003  # largest scatter due to stage errors, relative to the extent along the best-fit line or plane
_UNKNOWN_EXTENT_M = 0.01  # assumed extent of places if all captures have the same one: an eye box
_BOX_MARGIN = 0.025  # margin per side, as a share of the box: half a cell of a grid of 20 samples across the panel


def angular_metric(tangents: FloatArray) -> FloatArray:
    """Return the arcminutes (n,) per unit of tangent at tangents (n, 2).

    With n^2 = 1 + tx^2 + ty^2, a small step of tangents is an angle of 1 / n^2 times the step radially, and of 1 / n
    times the step across; camera noise is the same in both directions. The result is the geometric mean (within 8 % of
    either at 30 degrees off axis), so that both outputs can share one design.
    """
    square = 1.0 + np.sum(tangents**2, axis=-1)
    return np.asarray(square**-0.75 / ARCMIN)


@dataclass(frozen=True)
class Limits:
    """Highest orders of a fit.

    Attributes:
        pixel: joint order of the pixel's or direction's variables. place: joint order of the place's variables. total:
            joint order of all variables; negative for no terms.
    """

    pixel: int
    place: int
    total: int

    def orders(self, pixels: int, places: int) -> IntArray:
        """Return the orders (terms, pixels + places) for these numbers of variables."""
        if self.total < 0:
            return np.zeros((0, pixels + places), np.int64)
        return limited_orders(pixels, self.pixel, places, self.place, self.total)

    def words(self, noun: str, places: bool) -> str:
        """Return the limits in words for a table, e.g. "pixel 8, place 5"."""
        if self.total < 0:
            return "of the prescription"
        if not places or self.pixel == self.place:
            return f"{noun} {self.pixel}" if not places else f"total {self.total}"
        return f"{noun} {self.pixel}, place {self.place}"


TREND_ALONE = Limits(-1, -1, -1)
"""Limits without terms, for the trend alone."""
Respond = Callable[[FloatArray, FloatArray, slice], FloatArray]
"""(slope of the modelled values (r, 2, variables), change of the view tangents (r, 2, k), the r rows) -> (r, 2, 3 + k),
change of `observed` minus the model with a shift of the camera, metres, and with this change of tangents."""


@dataclass(frozen=True)
class Trend:
    """Prior mean of a model with unknown parameters, e.g. a prescription with its assembly errors.

    Attributes:
        mean: inputs -> outputs, for parameters at their prior mean.
        by_parameter: inputs -> (outputs * parameters), change per prior standard deviation of each parameter.
    """

    mean: Polynomial
    by_parameter: Polynomial

    def about(self, mean: FloatArray, root: FloatArray) -> "Trend":
        """Return the trend in other parameters q with a standard normal prior, where parameters = mean + root @ q.

        Args:
            mean: (parameters,) prior mean of the parameters.
            root: (parameters, parameters) root of their prior covariance.
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
class Common:
    """Errors common to all captures, as k standard normal variables to which a fit responds without estimating them.

    As unknowns, they would get spurious estimates: from the prior, which finds optics slightly smoother from shifted
    viewpoints, or from the noise of the tangents in their columns (decision 9).

    Attributes:
        columns: (slope of the modelled values (n, 2, variables)) -> (n, 2, k), change of `observed` minus the model
            with each error.
        sources: (k,) name of each error's source.
    """

    columns: Callable[[FloatArray], FloatArray]
    sources: tuple[str, ...]


@dataclass(frozen=True)
class FitReadings:
    """observed = sum over blocks b of multiplier_b * polynomial_b(inputs), for n readings of two tangents.

    Attributes:
        inputs: (n, variables) inputs of the polynomials.
        is_place: (variables,) True for variables of the place, False for variables of the pixel or direction.
        observed: (n, 2) two tangents of each reading.
        multiplier: (n, blocks) for both tangents, or (n, 2, blocks) for polynomials of one output each.
        metric: (n,) arcminutes per unit of `observed`.
        sigma: (n,) standard deviation, arcminutes; all zero for exact data.
        capture: (n,) indices 0..captures - 1; the readings of a capture share a motion of the camera.
        motion: (slope of the modelled values (n, 2, variables)) -> (n, 2, 6), change of `observed` minus the model with
            a shift (metres) and a turn (radians) of the camera; None if no motion is modelled.
        orders: (terms, variables) orders of the fit's terms.
        trend: prior mean of the model with its unknown parameters; None for no trend.
        motion_prior: prior of the motions, by index of `capture`; None for the prior of an unknown stage.
        common: errors common to all captures; None if unknown.
        shared: noise that neighbouring readings of a capture share, estimated by a fit; None for white noise.
        axis_terms: errors by label with separate unknowns for each tangent.
        joint_terms: errors by label with unknowns common to both tangents. stage_terms: such errors of the stage; see
            `moving`.
        stage: labels of the stage; None if no motion is modelled.
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
    trend: Trend | None = None
    motion_prior: CaptureMotionPrior | None = None
    common: Common | None = None
    shared: SharedNoise | None = None
    axis_terms: tuple[LabelTerm, ...] = ()
    joint_terms: tuple[LabelTerm, ...] = ()
    stage_terms: tuple[LabelTerm, ...] = ()
    stage: StageLabels | None = None

    def __len__(self) -> int:
        return len(self.inputs)

    @property
    def limits(self) -> Limits:
        """Narrowest limits that include all orders."""
        parts = self.orders[:, ~self.is_place], self.orders[:, self.is_place], self.orders
        pixel, place, total = (int(part.sum(axis=1).max(initial=-1)) for part in parts)
        return Limits(pixel, place, total)

    @property
    def mixed(self) -> bool:
        """True if each polynomial has one output, which both tangents share."""
        return self.multiplier.ndim == 3

    @property
    def blocks(self) -> int:
        """Number of polynomials that share the inputs."""
        return int(self.multiplier.shape[-1])

    @cached_property
    def box(self) -> Box:
        """Box around the inputs plus a margin; with a trend, the trend's box."""
        if self.trend is not None:
            return self.trend.mean.box
        return fitted_box(self.inputs, self.is_place)

    @cached_property
    def weight(self) -> FloatArray:
        """Inverse sigma (n,), in units of `observed`, with a sigma of 1' for exact data."""
        sigma = self.sigma if np.any(self.sigma > 0) else np.ones(len(self))
        return np.asarray(self.metric / sigma)

    @cached_property
    def free(self) -> BoolArray:
        """Mask (terms,) of constant and slopes in pixel or direction, of prior size one; all False with a trend."""
        at_place = self.orders[:, self.is_place].any(axis=1)
        return np.asarray(~at_place & (self.orders.sum(axis=1) <= 1) & (self.trend is None))

    def select(self, rows: BoolArray | IntArray) -> "FitReadings":
        """Return some of the readings, with the box and the capture indices of the whole set."""
        per_row = ("inputs", "observed", "multiplier", "metric", "sigma", "capture")
        chosen = replace(self, **{name: getattr(self, name)[rows] for name in per_row}, motion=None, common=None)
        terms: dict[str, Any] = {
            name: tuple(each.select(rows) for each in getattr(self, name))
            for name in ("axis_terms", "joint_terms", "stage_terms")
        }
        chosen = replace(chosen, **terms, stage=self.stage and self.stage.select(rows))
        return chosen.within(self.box)

    def with_shared(self, shared: SharedNoise | None) -> "FitReadings":
        """Return the readings with other noise shared by neighbours."""
        return replace(self, shared=shared).within(self.box)

    @property
    def coefficients(self) -> int:
        """Number of polynomial coefficients separate for each output; errors by label come after them."""
        return 0 if self.mixed else self.blocks * len(self.orders)

    def design(self, rows: slice | IntArray) -> FloatArray:
        """Return the columns of an output's separate unknowns: coefficients (`design_of`), then errors by label."""
        design = design_of(self, rows, basis(self.inputs[rows], self.orders, self.box))
        if not self.axis_terms:
            return design
        return np.hstack([design, *(each.columns[rows] for each in self.axis_terms)])

    @property
    def parameters(self) -> int:
        """Number of model unknowns common to both outputs: trend parameters, or mixed polynomials' coefficients."""
        return self.blocks * len(self.orders) if self.mixed else self.trend.parameters if self.trend else 0

    @property
    def shared_terms(self) -> tuple[LabelTerm, ...]:
        """All errors by label common to both outputs; their unknowns come after `parameters`."""
        return self.joint_terms + self.stage_terms

    def shared_columns(self, rows: slice | IntArray) -> FloatArray:
        """Return columns (r, 2, k) of unknowns common to both outputs: parameters, then errors by label; no motions."""
        parts = [each.columns[rows] for each in self.shared_terms]
        if self.mixed:
            parts.insert(0, self.design(rows))
        elif self.trend is not None:
            by_parameter = self.trend.by_parameter(self.inputs[rows])
            by_parameter = by_parameter.reshape(len(by_parameter), self.blocks, 2, self.trend.parameters)
            parts.insert(0, np.einsum("nb,nbop->nop", self.multiplier[rows], by_parameter))
        return np.concatenate(parts, axis=2) if parts else np.zeros((len(self.inputs[rows]), 2, 0))

    def moving(self, columns: FloatArray) -> "FitReadings":
        """Return the readings with errors of the stage's labels, from the columns (n, 2, 6) of motions."""
        if self.stage is None:
            return self
        return replace(self, stage_terms=tuple(self.stage.terms(columns[:, :, :3]))).within(self.box)

    @property
    def image(self) -> FloatArray:
        """Positions (n, 2) in the image, pixels or directions, which determine neighbours."""
        return self.inputs[:, ~self.is_place]

    def blocks_of_noise(self, kept: FloatArray) -> Iterator[tuple[IntArray, Weights]]:
        """Yield groups of readings with independent noise between groups, with weights in the form for `Sums.add`.

        Args:
            kept: (n,) weights, from 1 down to 0 for outliers.
        """
        if self.shared is None:
            for first in range(0, len(self), _CHUNK):
                rows = np.arange(first, min(first + _CHUNK, len(self)))
                yield rows, (self.weight * kept)[rows]
            return
        image, blocks = self.image, [rows for rows in rows_by_capture(self.capture) if np.any(kept[rows] > 0)]
        chunk = np.cumsum([len(rows) for rows in blocks]) // _CHUNK
        for number in np.unique(chunk):
            some = [blocks[each] for each in np.flatnonzero(chunk == number)]
            roots = [self.shared.root(image[rows], kept[rows]) * self.weight[rows] for rows in some]
            yield np.concatenate(some), roots

    def within(self, box: Box) -> "FitReadings":
        """Return the readings in another box, for coefficients and priors comparable with readings in that box."""
        changed = replace(self)
        changed.__dict__["box"] = box
        return changed

    def values(self, polynomial: Polynomial) -> FloatArray:
        """Return the prediction (n, 2) of `observed` by a polynomial."""
        return self._combined(polynomial(self.inputs))[..., 0]

    def slopes(self, polynomial: Polynomial) -> FloatArray:
        """Return the derivative (n, 2, variables) of `values` by the inputs."""
        return self._combined(polynomial.with_jacobian(self.inputs)[1])

    def _combined(self, value: FloatArray) -> FloatArray:
        """Combine values (n, outputs of all blocks, ...) of the blocks to (n, 2, k)."""
        value = value.reshape(len(self), self.blocks, 1 if self.mixed else 2, -1)
        equation = "nrb,nbok->nrk" if self.mixed else "nb,nbok->nok"
        return np.asarray(np.einsum(equation, self.multiplier, value))


def flat_places(inputs: FloatArray, is_place: BoolArray) -> BoolArray:
    """Return the mask (variables,) of place variables along which inputs (n, variables) have negligible extent."""
    extent = np.ptp(inputs, axis=0)
    widest = float(extent[is_place].max(initial=0.0))
    return np.asarray(is_place & (extent <= max(_FLAT_M, _FLAT * widest)))


def without_thickness(place: FloatArray) -> FloatArray:
    """Return places (n, k) projected onto their best-fit line or plane if their scatter across it is negligible.

    Such scatter consists only of stage errors, which a fit would mistake for a dependence on the place.
    """
    centre = place.mean(axis=0)
    _, extent, axes = np.linalg.svd(place - centre, full_matrices=False)
    thin = (extent <= _THIN * extent[0]) & (extent > 0.0)
    return np.asarray(place - (place - centre) @ axes[thin].T @ axes[thin]) if thin.any() else place


def fitted_box(inputs: FloatArray, is_place: BoolArray) -> Box:
    """Return the box of a fit to inputs (n, variables); flat axes of the place get the extent of the widest axis."""
    box, flat = Box.around(inputs), flat_places(inputs, is_place)
    if flat.any():
        known = is_place & ~flat
        wide = float((box.high - box.low)[known].max()) if known.any() else _UNKNOWN_EXTENT_M
        centre = 0.5 * (box.low + box.high)
        box = Box(np.where(flat, centre - 0.5 * wide, box.low), np.where(flat, centre + 0.5 * wide, box.high))
    margin = _BOX_MARGIN * (box.high - box.low)
    return Box(box.low - margin, box.high + margin)


def design_of(readings: FitReadings, rows: slice | IntArray, phi: FloatArray) -> FloatArray:
    """Return the columns of all blocks, (rows, blocks * terms), or (rows, 2, blocks * terms) if mixed.

    `phi` (rows, terms) has the values of the terms.
    """
    multiplier = readings.multiplier[rows]
    design = multiplier[..., None] * (phi[:, None, None] if readings.mixed else phi[:, None])
    return np.asarray(design.reshape(*multiplier.shape[:-1], -1))


def motion_of(tangents: FloatArray, respond: Respond) -> Callable[[FloatArray], FloatArray]:
    """Return `FitReadings.motion` for readings with view tangents (n, 2)."""
    return lambda slope: respond(slope, tangents_by_turn(tangents), slice(None))


def common_of(
    captures: DisplayCaptures | SeeThroughCaptures,
    respond: Respond,
    by_point: Callable[[slice], FloatArray] | None = None,
) -> Common | None:
    """Return the common errors of captures for readings of a model that depends on the place; None without any.

    Args:
        captures: the measured captures.
        respond: see `Respond`.
        by_point: (rows) -> (r, 2, 3), change of `observed` minus the model by the real point; None for the panel.
    """
    common = captures.common
    if common is None:
        return None

    def columns(slope: FloatArray) -> FloatArray:
        result = np.empty((len(captures), 2, len(common.sources)))
        for first in range(0, len(captures), _CHUNK):
            rows = slice(first, first + _CHUNK)
            changes = common.changes(captures, rows)
            answer = respond(slope[rows], changes.tangents, rows)
            result[rows] = answer[:, :, :3] @ changes.viewpoint + answer[:, :, 3:]
            if by_point is not None and changes.point is not None:
                result[rows] += by_point(rows) @ changes.point
        return result

    return Common(columns, common.sources)


def motion_columns(readings: FitReadings, polynomial: Polynomial) -> FloatArray:
    """Return the columns (n, 2, 6) of a shift and turn of the camera, from the slopes of a polynomial."""
    assert readings.motion is not None
    return readings.motion(readings.slopes(polynomial))


def rows_by_capture(capture: IntArray) -> list[IntArray]:
    """Return the rows of each capture, from the capture index (n,) of each row."""
    order = np.argsort(capture, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(capture[order])) + 1)

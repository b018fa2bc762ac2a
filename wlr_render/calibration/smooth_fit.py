"""Fits of smooth polynomials to captures by maximum evidence: one mechanism for all model kinds.

A coefficient of orders a in the pixel (or direction) and b in the place has the prior size exp(p - lambda a - mu b): the
readings decide how smooth the optics are. What the readings of one capture share, a small shift and turn of the camera,
is unknown, too; its size is the repeatability of the stage. Orders are limits only, and no design is refused: where
camera positions are few, the posterior is wide.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from wlr_render.geometry.directions import ARCMIN
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray
from wlr_render.numerics.evidence import FREE, Posterior, Prior, Sums, maximise
from wlr_render.numerics.polynomial import Box, Polynomial, basis

_CHUNK = 4_096  # readings whose design is held at once
_BOX_MARGIN = 0.025  # of the box per side: half a cell of the coarsest usual grid, 20 samples across the panel
NOISE_FLOOR_ARCMIN = 1e-3
"""Least noise of a reading: exact data would send it to zero, where rounding decides."""
SHIFT, TURN = slice(0, 3), slice(3, 6)
"""Columns of a capture's motion: metres along x, y, z, and radians about them, device frame."""


@dataclass(frozen=True)
class Readings:
    """observed = sum over blocks b of multiplier_b * polynomial_b(inputs), for n readings of two tangents.

    Attributes:
        inputs: (n, variables).
        is_place: (variables,) whether a variable is of the place, else of the pixel or direction.
        observed: (n, 2).
        multiplier: (n, blocks) for both tangents, or (n, 2, blocks) for polynomials of one output each.
        metric: (n,) arcminutes per unit of `observed`.
        sigma: (n,) standard deviation in arcminutes, up to a common factor.
        capture: (n,) indices 0..captures - 1 of what shares a motion of the camera.
        motion: (slope of the modelled tangents (n, 2, variables)) -> (n, 2, 6), by how much `observed` less the model
            changes with a shift and turn of the camera; None where a motion is not modelled.
    """

    inputs: FloatArray
    is_place: BoolArray
    observed: FloatArray
    multiplier: FloatArray
    metric: FloatArray
    sigma: FloatArray
    capture: IntArray
    motion: Callable[[FloatArray], FloatArray] | None = None

    def __len__(self) -> int:
        return len(self.inputs)

    @property
    def mixed(self) -> bool:
        """Whether each polynomial has one output, which several tangents share."""
        return self.multiplier.ndim == 3


@dataclass(frozen=True)
class SmoothFit:
    """A fitted polynomial with its covariance.

    Attributes:
        polynomial: its outputs are those of block 0, then block 1, and so on.
        posterior: of coefficients, motions and hyperparameters.
        weight: (n,) of the readings, from 1 down to 0 for outliers.
        seconds: duration of the fit.
    """

    polynomial: Polynomial
    posterior: Posterior
    weight: FloatArray

    @property
    def noise_arcmin(self) -> float:
        return self.posterior.noise

    @property
    def shift_m(self) -> float:
        return float(np.exp(self.posterior.hyper.get("shift", -np.inf)))

    @property
    def turn_rad(self) -> float:
        return float(np.exp(self.posterior.hyper.get("turn", -np.inf)))


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
    tx, ty = tangents.T
    one = np.ones_like(tx)
    return np.stack(
        [
            np.stack([tx * ty, -(one + tx**2), -ty], axis=-1),
            np.stack([one + ty**2, -tx * ty, tx], axis=-1),
        ],
        axis=1,
    )


def fit(readings: Readings, orders: IntArray, rounds: int = 2, free_order: int = 1) -> SmoothFit:
    box = Box.around(readings.inputs)
    margin = _BOX_MARGIN * (box.high - box.low)
    box = Box(box.low - margin, box.high + margin)
    blocks = readings.multiplier.shape[-1]
    free = orders.sum(axis=1) <= free_order
    start = _free_part(readings, orders[free], box)
    rest = replace(readings, observed=readings.observed - _modelled(readings, start))
    prior = _prior(readings, orders, free, blocks, moving=False)
    found = maximise(_sums(rest, orders, box, None), prior, _starts(prior, blocks, readings))
    if readings.motion is not None:
        prior = _prior(readings, orders, free, blocks, moving=True)
        for round_ in range(rounds):
            polynomial = _polynomial(found, orders, free, start, readings)
            columns = _motion(readings, polynomial)
            sums = _sums(rest, orders, box, columns)
            starts = [dict(found.hyper)] if round_ else [
                dict(found.hyper) | {"shift": np.log(shift), "turn": np.log(turn)}
                for shift, turn in ((3e-6, 1e-5), (3e-5, 1e-4))
            ]
            found = maximise(sums, prior, starts)
    return SmoothFit(_polynomial(found, orders, free, start, readings), found, np.ones(len(readings)))


def _free_part(readings: Readings, orders: IntArray, box: Box) -> Polynomial:
    """Least squares by the terms that no prior holds, which are few: what is left is small, so that sums keep their digits."""
    blocks = readings.multiplier.shape[-1]
    phi = basis(readings.inputs, orders, box)
    weight = readings.metric / readings.sigma
    if readings.mixed:
        design = (readings.multiplier[:, :, :, None] * phi[:, None, None, :]).reshape(-1, blocks * len(orders))
        rows, values = np.repeat(weight, 2)[:, None], readings.observed.reshape(-1, 1)
    else:
        design = (readings.multiplier[:, :, None] * phi[:, None, :]).reshape(-1, blocks * len(orders))
        rows, values = weight[:, None], readings.observed
    solution = np.linalg.lstsq(design * rows, values * rows, rcond=1e-9)[0]
    return Polynomial(orders, box, solution.reshape(blocks, len(orders), -1).transpose(1, 0, 2).reshape(len(orders), -1))


def _modelled(readings: Readings, polynomial: Polynomial) -> FloatArray:
    value = polynomial(readings.inputs)
    if readings.mixed:
        return np.asarray(np.einsum("nrb,nb->nr", readings.multiplier, value))
    return np.asarray(np.einsum("nb,nbo->no", readings.multiplier, value.reshape(len(value), -1, 2)))


def _motion(readings: Readings, polynomial: Polynomial) -> FloatArray:
    _, slope = polynomial.with_jacobian(readings.inputs)
    n, _, variables = slope.shape
    if readings.mixed:
        by = np.einsum("nrb,nbv->nrv", readings.multiplier, slope)
    else:
        by = np.einsum("nb,nbov->nov", readings.multiplier, slope.reshape(n, -1, 2, variables))
    assert readings.motion is not None
    return readings.motion(by)


def _polynomial(found: Posterior, orders: IntArray, free: BoolArray, start: Polynomial, readings: Readings) -> Polynomial:
    blocks, terms = readings.multiplier.shape[-1], len(orders)
    outputs = 1 if readings.mixed else 2
    mean = found.mixed_mean if readings.mixed else found.mean
    coefficients = mean.reshape(outputs, blocks, terms).transpose(2, 1, 0).reshape(terms, -1).copy()
    coefficients[free] += start.coefficients
    return Polynomial(orders, start.box, coefficients)


def _prior(readings: Readings, orders: IntArray, free: BoolArray, blocks: int, moving: bool) -> Prior:
    sizes = [f"size {block}" for block in range(blocks)]
    names = (*sizes, "lambda", "mu", "noise", *(("shift", "turn") if moving else ()))
    place, rest = orders[:, readings.is_place].sum(axis=1), orders[:, ~readings.is_place].sum(axis=1)
    terms = len(orders)
    features = np.zeros((blocks, terms, len(names)))
    for block in range(blocks):
        features[block, ~free, block] = 1.0
    features[:, :, blocks], features[:, :, blocks + 1] = -rest, -place
    features, offset = features.reshape(-1, len(names)), np.tile(np.where(free, FREE, 0.0), blocks)
    none = np.zeros((0, len(names))), np.zeros(0)
    own, own_offset = none
    if moving:
        own, own_offset = np.zeros((6, len(names))), np.zeros(6)
        own[SHIFT, -2] = own[TURN, -1] = 1.0
    floor = np.log(NOISE_FLOOR_ARCMIN)
    bounds = [(-25.0, 8.0)] * blocks + [(0.0, 8.0)] * 2 + [(floor, 12.0)] + [(-20.0, -3.0)] * (2 if moving else 0)
    shared, mixed = (none, (features, offset)) if readings.mixed else ((features, offset), none)
    return Prior(names, np.array(bounds), *shared, *mixed, own, own_offset)


def _starts(prior: Prior, blocks: int, readings: Readings) -> list[dict[str, float]]:
    starts = []
    for size, slope, slope_place, noise in ((-1.0, 0.7, 0.7, 0.3), (-1.0, 1.2, 1.5, 0.03), (-4.0, 0.7, 0.7, 1.0)):
        start = {f"size {block}": size for block in range(blocks)}
        starts.append(start | {"lambda": slope, "mu": slope_place, "noise": float(np.log(noise))})
    return starts


def _sums(
    readings: Readings, orders: IntArray, box: Box, motion: FloatArray | None
) -> Sums:
    blocks, terms = readings.multiplier.shape[-1], len(orders)
    own = 0 if motion is None else 6
    groups = int(readings.capture.max()) + 1 if own else 0
    mixed = blocks * terms if readings.mixed else 0
    sums = Sums(0 if mixed else blocks * terms, 2, mixed, groups, own)
    weight = readings.metric / readings.sigma
    for first in range(0, len(readings), _CHUNK):
        rows = slice(first, first + _CHUNK)
        phi = basis(readings.inputs[rows], orders, box)
        count = len(phi)
        if mixed:
            design = (readings.multiplier[rows, :, :, None] * phi[:, None, None, :]).reshape(count, 2, -1)
            shared = np.empty((count, 0))
        else:
            design = None
            shared = (readings.multiplier[rows, :, None] * phi[:, None, :]).reshape(count, -1)
        sums.add(
            readings.observed[rows],
            weight[rows],
            shared,
            design,
            None if motion is None else motion[rows],
            readings.capture[rows],
        )
    return sums

"""A model of one eye from a wearer's few alignments of pixels with real points, similar to SPAAM.

At the wearer's eye e a pixel (u, v) covers the point P:

    (P_xy - e_xy) / (e_z - P_z) = a(u, v) + b + noise

a, a polynomial of order 5, is the direction of the pixel, e is within the eye box, and b is the constant error of the
hand. SPAAM (Tuceryan, Genc and Navab, Presence 11, 2002, 259-276) has eleven unknowns for a flat screen and an eye, and
fewer than six alignments do not determine them. Here priors of ordinary headsets constrain the unknowns, and the
covariance includes their uncertainty. Errors of successive alignments are correlated, because a head sways slowly.
The fit averages over the size and correlation of these errors and the size of the distortion, weighted by evidence.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import Any, cast

import numpy as np

from wlr_render.calibration.posterior_spread import principal_root
from wlr_render.captures.alignments_file import Alignments
from wlr_render.error_sources import ErrorSource
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import ARCMIN
from wlr_render.mappings import Eye, EyeBox
from wlr_render.models.fitted_model import FittedDisplay, FittedSeeThrough
from wlr_render.models.model_file import EyeModel
from wlr_render.models.model_place import NOWHERE
from wlr_render.models.point_per_pixel import PointPerPixelDisplay
from wlr_render.models.see_through_model import SeeThroughModel
from wlr_render.models.spread import Covariance
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.polynomial import Box, Polynomial, basis, total_degree

LEAST, MOST = 6, 1000
"""Least and largest number of alignments; six give enough numbers for SPAAM's unknowns."""
_ORDER = 5
_MIDDLE, _SCALE, _SPREAD, _TURN = 0.2, 0.4, 0.25, 0.06
"""Tangents: sigma of the panel's middle, usual half field and its sigma, and sigma of the terms due to roll."""
_BENT = {order: 0.02 * 0.5 ** (order - 2) for order in range(2, _ORDER + 1)}
"""Sigma of keystone and distortion terms by order, tangents at the panel's edge; it halves from order to order."""
_BENT_FACTORS = (0.3, 1.0, 3.0, 6.0)  # factors on `_BENT` over which the fit averages
_HAND_ARCMIN, _HAND_LOG = 6.0, 0.7  # usual error of a wearer's alignment per axis, and sigma of the logarithm
_HANDS_ARCMIN = tuple(np.geomspace(1.0, 40.0, 9))
_CONSTANT = 0.5  # ratio of the hand's constant error to its random error; alignments cannot show the constant error
_ALIKE = (0.0, 0.4, 0.8)  # correlations of successive alignments over which the fit averages
_INVERSE_DEPTH, _INVERSE_DEPTH_SIGMA = 0.7, 0.4  # distance of the virtual image, 1/m; one eye position does not show it
_ROUNDS = 4  # linearisations about the eye's position
_ON_A_LINE = 0.02  # least spread of pixels across their best-fit line, over the panel's height
_CONTRADICTION_ARCMIN = 90.0  # least residual that means wrong axes or frames; no wearer is so far off
_SUSPECTS = 3  # number of alignments with the largest residuals that are tested against the others
_OUTLIER = 4.0  # outlier threshold of a prediction from the other alignments, standard errors


@dataclass(frozen=True, eq=False)
class AlignmentFit:
    """The model of a wearer's alignments.

    Attributes:
        device: name of the headset.
        mappings: the fitted eye, with an eye box about the estimated position of the wearer's eye.
        eye_m, eye_sigma_m: (3,) this position and its sigma, device frame; optics that shift the image of the world,
            such as a plate, shift this position.
        hand_arcmin: estimated random error of an alignment per axis.
        residual_arcmin: (n,) length of each alignment's residual.
        doubtful: numbers, from 1, of alignments that the others do not predict.
    """

    device: str
    mappings: Eye
    eye_m: FloatArray
    eye_sigma_m: FloatArray
    hand_arcmin: float
    residual_arcmin: FloatArray
    doubtful: tuple[int, ...]

    @property
    def display(self) -> FittedDisplay:
        """Directions of the pixels at the wearer's eye."""
        display: Any = self.mappings.display  # a PointPerPixelDisplay, from `_eye`
        return cast(FittedDisplay, display)

    @property
    def see_through(self) -> FittedSeeThrough:
        """Straight rays, with the uncertainty of the eye's position."""
        see_through: Any = self.mappings.see_through
        return cast(FittedSeeThrough, see_through)

    def model(self) -> EyeModel:
        """Return the model in the form for `models.model_file.save_eye_models`."""
        report = {
            "alignments": len(self.residual_arcmin),
            "hand_arcmin": self.hand_arcmin,
            "eye_m": self.eye_m.tolist(),
            "eye_sigma_m": self.eye_sigma_m.tolist(),
        }
        return EyeModel(self.mappings, self.device, report)


@dataclass(frozen=True, eq=False)
class _Posterior:
    """Posterior of the unknowns: coefficients of a for x, then y, eye position, constant error; see `_prior`."""

    mean: FloatArray
    covariance: FloatArray
    hand: float


def fit_alignments(found: Alignments) -> AlignmentFit:
    """Fit a model to the alignments of one wearer.

    Raises:
        BadInputError: too few alignments, pixels on one line, or alignments that contradict each other.
    """
    _require_determined(found)
    orders, box = total_degree(2, _ORDER), Box(np.zeros(2), found.panel.size_px)
    terms = basis(found.pixel, orders, box)
    eye = found.eye_box.centre
    for _ in range(_ROUNDS):
        posterior = _posterior(found, terms, orders, eye)
        count = 2 * len(orders)
        eye = found.eye_box.centre + posterior.mean[count : count + 3]
    coefficients = posterior.mean[:count].reshape(2, -1).T
    left = (_straight(found, eye) - terms @ coefficients) / ARCMIN
    if (worst := float(np.median(np.linalg.norm(left, axis=1)))) > _CONTRADICTION_ARCMIN:
        raise BadInputError(
            f"{found.path}: the alignments contradict each other by {worst:.0f}'; give points in the device frame "
            "(metres, x right, y up, z backward) and pixels from the panel's outer top left corner."
        )
    return AlignmentFit(
        found.device,
        _eye(found, orders, box, posterior, eye),
        eye,
        np.sqrt(np.diag(posterior.covariance)[count : count + 3]),
        posterior.hand,
        np.linalg.norm(left, axis=1),
        _doubtful(found, terms, orders, eye, np.linalg.norm(left, axis=1)),
    )


def _require_determined(found: Alignments) -> None:
    count = len(found.pixel)
    if not LEAST <= count <= MOST:
        raise BadInputError(
            f"{found.path}: has {count} alignments; a model needs {LEAST} to {MOST}, at pixels all over the panel."
        )
    off = found.pixel - found.pixel.mean(axis=0)
    across = float(np.linalg.svd(off, compute_uv=False)[1]) / np.sqrt(count)
    if across < _ON_A_LINE * found.panel.height_px:
        raise BadInputError(
            f"{found.path}: the pixels of all {count} alignments lie on one line of the panel, within {across:.0f} "
            "pixels; align at pixels all over the panel."
        )


def _straight(found: Alignments, eye: FloatArray) -> FloatArray:
    """Return the tangents (n, 2) of the points from the eye."""
    return np.asarray((found.point[:, :2] - eye[:2]) / (eye[2] - found.point[:, 2])[:, None])


def _design(found: Alignments, terms: FloatArray, eye: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return values (2 n,), all x before y, and their derivatives (2 n, unknowns), linearised about an eye position."""
    depth, straight = eye[2] - found.point[:, 2], _straight(found, eye)
    count, k = terms.shape
    design = np.zeros((2, count, 2 * k + 5))
    for axis in (0, 1):
        design[axis, :, axis * k : (axis + 1) * k] = terms
        design[axis, :, 2 * k + axis] = 1.0 / depth
        design[axis, :, 2 * k + 2] = straight[:, axis] / depth
        design[axis, :, 2 * k + 3 + axis] = 1.0
    values = straight.T.ravel() + design[:, :, 2 * k : 2 * k + 3].reshape(2 * count, 3) @ (eye - found.eye_box.centre)
    return values, design.reshape(2 * count, -1)


def _prior(found: Alignments, orders: IntArray, bent: float, hand: float) -> tuple[FloatArray, FloatArray]:
    """Return mean and sigma (unknowns,) of coefficients, eye position from the eye box's centre, and hand's error."""
    total, k = orders.sum(axis=1), len(orders)
    mean, sigma = np.zeros((2, k)), np.zeros((2, k))
    sigma[:, total == 0] = _MIDDLE
    for axis, sign in ((0, 1.0), (1, -1.0)):  # panel rows run downwards
        own = (total == 1) & (orders[:, axis] == 1)
        mean[axis, own], sigma[axis, own] = sign * _SCALE, _SPREAD
        sigma[axis, (total == 1) & ~own] = _TURN
    for order, size in _BENT.items():
        sigma[:, total == order] = bent * size
    eye = found.eye_box.size / np.sqrt(12.0)
    constant = np.full(2, _CONSTANT * hand)
    return np.concatenate([mean.ravel(), np.zeros(5)]), np.concatenate([sigma.ravel(), eye, constant])


def _noise(found: Alignments, alike: float) -> FloatArray:
    """Return the correlation (n, n) of alignment errors along one axis, by order or times of the alignments."""
    place = np.arange(len(found.pixel), dtype=np.float64)
    if found.time_s is not None:
        place = found.time_s / np.median(np.diff(found.time_s))
    apart = np.abs(place[:, None] - place)
    return np.asarray(alike**apart if alike else np.eye(len(place)))


def _posterior(found: Alignments, terms: FloatArray, orders: IntArray, eye: FloatArray) -> _Posterior:
    """Return the average, weighted by evidence, over sizes of hand errors and distortion, and over correlations."""
    values, design = _design(found, terms, eye)
    fits = list(_fits(found, values, design, orders))
    weight = np.exp(np.array([each[0] for each in fits]) - max(each[0] for each in fits))
    weight /= weight.sum()
    mean = sum(w * each[1] for w, each in zip(weight, fits, strict=True))
    covariance = sum(
        w * (each[2] + np.outer(each[1] - mean, each[1] - mean)) for w, each in zip(weight, fits, strict=True)
    )
    hand = float(np.exp(np.sum(weight * np.log([each[3] for each in fits]))))
    return _Posterior(np.asarray(mean), np.asarray(covariance), hand / ARCMIN)


def _fits(
    found: Alignments, values: FloatArray, design: FloatArray, orders: IntArray
) -> Iterator[tuple[float, FloatArray, FloatArray, float]]:
    """Yield log evidence, mean, covariance, and size of the hand's error for each combination."""
    count = len(values) // 2
    for alike in _ALIKE:
        whiten = np.linalg.inv(np.linalg.cholesky(_noise(found, alike)))
        log_det = 2.0 * float(np.sum(np.log(np.diag(whiten))))  # log determinant for both axes together
        for hand_arcmin, bent in product(_HANDS_ARCMIN, _BENT_FACTORS):
            hand = float(hand_arcmin * ARCMIN)
            prior, sigma = _prior(found, orders, bent, hand)
            left = (whiten @ (values - design @ prior).reshape(2, count, 1) / hand).ravel()
            columns = (whiten @ design.reshape(2, count, -1) / hand).reshape(2 * count, -1) * sigma
            normal = np.eye(len(sigma)) + columns.T @ columns
            lower = np.linalg.cholesky(normal)
            unit = np.linalg.solve(normal, columns.T @ left)
            misfit = float(left @ left - unit @ (columns.T @ left))
            evidence = -0.5 * misfit - float(np.sum(np.log(np.diag(lower)))) + log_det - 2 * count * np.log(hand)
            evidence -= 0.5 * (np.log(hand_arcmin / _HAND_ARCMIN) / _HAND_LOG) ** 2
            covariance = np.linalg.inv(normal) * sigma[:, None] * sigma
            yield evidence, prior + sigma * unit, covariance, hand


def _doubtful(
    found: Alignments, terms: FloatArray, orders: IntArray, eye: FloatArray, left: FloatArray
) -> tuple[int, ...]:
    """Return the numbers, from 1, of alignments that a fit to the others does not predict.

    Among the few with the largest residuals (n,), the alignment that the others predict worst is left out before the
    next one is tested, because it biases the fit and makes good alignments look wrong.
    """
    doubtful: list[int] = []
    count = len(found.pixel)
    values, design = _design(found, terms, eye)
    while len(doubtful) < _SUSPECTS and count - len(doubtful) > LEAST:
        missed = {}
        for number in [each for each in map(int, np.argsort(-left)) if each not in doubtful][:_SUSPECTS]:
            rest = ~np.isin(np.arange(count), [*doubtful, number])
            others = _posterior(found.select(rest), terms[rest], orders, eye)
            own = [number, count + number]
            miss = values[own] - design[own] @ others.mean
            variance = design[own] @ others.covariance @ design[own].T + np.eye(2) * (others.hand * ARCMIN) ** 2
            missed[number] = float(miss @ np.linalg.solve(variance, miss)), others.mean
        worst = max(missed, key=lambda number: missed[number][0])
        square, mean = missed[worst]
        if square <= _OUTLIER**2:
            break
        doubtful.append(worst)
        left = np.linalg.norm((values - design @ mean).reshape(2, count), axis=0)
    return tuple(sorted(number + 1 for number in doubtful))


def _eye(found: Alignments, orders: IntArray, box: Box, posterior: _Posterior, eye: FloatArray) -> Eye:
    """Return the display's directions at the wearer's eye, and straight rays from the eye's uncertain position.

    Both share error variables, because their errors come from the same alignments; one more variable is the image's
    distance.
    """
    k = len(orders)
    root = principal_root(posterior.covariance)
    rank = root.shape[1] + 1
    point = np.zeros((k, 3))
    point[:, :2] = posterior.mean[: 2 * k].reshape(2, k).T
    point[0, 2] = _INVERSE_DEPTH
    joint = np.zeros((k, 3, rank))
    joint[:, :2, :-1] = root[: 2 * k].reshape(2, k, -1).transpose(1, 0, 2)
    joint[0, 2, -1] = _INVERSE_DEPTH_SIGMA
    sources = (ErrorSource.ALIGNMENTS,) * rank
    eye_box = EyeBox(eye, found.eye_box.size)
    none = Polynomial(orders, box, np.zeros((k, 0)))
    display = PointPerPixelDisplay(
        found.panel,
        eye_box,
        Polynomial(orders, box, point),
        Covariance(3, none, Polynomial(orders, box, joint.reshape(k, -1)), sources),
    )
    # With an eye position off by d, a point at depth Z is off by (d_xy + t d_z) / Z, which is the model's B.
    everywhere, linear = Box(np.full(2, -10.0), np.full(2, 10.0)), total_degree(2, 1)
    deviation = np.zeros((3, 4, rank))
    constant = int(np.flatnonzero(linear.sum(axis=1) == 0)[0])
    for axis in (0, 1):
        deviation[constant, 2 + axis, :-1] = root[2 * k + axis]
        deviation[int(np.flatnonzero(linear[:, axis] == 1)[0]), 2 + axis, :-1] = 10.0 * root[2 * k + 2]
    see_through = SeeThroughModel(
        eye_box,
        NOWHERE,
        Polynomial(linear, everywhere, np.zeros((3, 4))),
        Covariance(
            4,
            Polynomial(linear, everywhere, np.zeros((3, 0))),
            Polynomial(linear, everywhere, deviation.reshape(3, -1)),
            sources,
        ),
    )
    return Eye(f"{found.device} (alignments)", found.eye, display, see_through, eye_box)

"""Refits that test the stated errors of a fit, each against the fit's expected value.

Noise alone: the fit takes the place of the truth. Readings are drawn from it with all errors that the fit states, and
are fitted. The truth is first drawn from the posterior, because a fit to few readings follows its prior and would
otherwise have smaller errors than stated where the prior dominates.

Quarters and bands: some camera positions are left out. For a fit m to all readings with covariance P and a fit m_A
to some of them with P_A, the law is cov(m_A - m) = P_A - P, because m is the posterior mean of the quantity that m_A
estimates. It holds for any part, including the prior, if all errors are as stated; errors that positions share and the
model lacks increase the difference. Random quarters are a bootstrap without replacement (Politis and Romano, Annals of
Statistics 22, 1994, 2031-2050): copies of a position, as in the usual bootstrap, would count as new positions. Bands of
neighbouring positions are the cross-validation. Half of the positions would be too few to show how smooth the optics
are.

mrcal also tests its projection uncertainty by refits to sampled noise and by fits to separate pictures
(https://mrcal.secretsauce.net/tour-cross-validation.html).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy

from wlr_render.calibration.fit_eye import Calibration
from wlr_render.calibration.fit_report import ModelFit, bands
from wlr_render.calibration.reading_sums import label_values
from wlr_render.calibration.readings import FitReadings, rows_by_capture
from wlr_render.calibration.smooth_prior import motion_sizes
from wlr_render.captures.correspondences import Captures, select
from wlr_render.captures.feature_captures import CommonErrors
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import ARCMIN, dir_of_tangents, normalised, tangents_by_turn, tangents_of_dir
from wlr_render.models.fitted_model import DirectionErrors, FittedDisplay, FittedSeeThrough
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray
from wlr_render.numerics.posterior import Posterior

NOISE, QUARTERS, BANDS = "noise alone", "bootstrap over positions", "cross-validation"
METHODS = (NOISE, QUARTERS, BANDS)
"""Kinds of refits."""
LEVEL = 0.95
"""Confidence level of the intervals."""
LEAST_POSITIONS = 8
"""Fewest positions; three quarters of fewer positions are too few for a model."""
_REFITS = 12  # number of refits to noise alone, and of refits without a quarter; they give a mean ratio to 0.1 or 0.2
_PARTS = 4  # number of parts into which positions are randomly divided
_TESTED = 500  # number of tested pairs of viewpoint and pixel or point
_ROWS = 4_000  # number of readings whose changes are in memory at a time

_AnyFit = ModelFit[FittedDisplay] | ModelFit[FittedSeeThrough]
_Directions = Callable[[FloatArray, FloatArray], FloatArray]
"""(pixels or points (n, k), viewpoints (n, 3)) -> unit directions (n, 3), NaN where there is no direction."""


@dataclass(frozen=True, eq=False)
class _Tested:
    """Queries of one side over the eye box, with the answers of the fit to all readings and their stated errors.

    Attributes:
        subject, viewpoint, view_dir: as in `Expected`.
        own, common: squares (n,) of errors that the fit estimates, and change (n, 3, k) by common errors.
    """

    subject: FloatArray
    viewpoint: FloatArray
    view_dir: FloatArray
    own: FloatArray
    common: FloatArray


@dataclass(frozen=True, eq=False)
class Expected:
    """Expected directions for comparison with a refit of one side.

    Attributes:
        subject, viewpoint: pixels or points (n, 2 or 3), and viewpoints (n, 3) over the eye box.
        view_dir: (n, 3) unit directions of the fit, or of the truth from which the readings were drawn.
        square: stated mean square of the difference, square arcminutes.
    """

    subject: FloatArray
    viewpoint: FloatArray
    view_dir: FloatArray
    square: float

    def found(self, fit: _AnyFit) -> float:
        """Return the mean square of a refit's difference, square arcminutes; infinite for a refit without answers."""
        apart = (fit.mapping.view_dir(self.subject, self.viewpoint).value - self.view_dir) / ARCMIN
        square = np.sum(apart**2, axis=1)
        known = np.isfinite(square)
        return float(square[known].mean()) if known.any() else np.inf


@dataclass(frozen=True, eq=False)
class Refit:
    """A fit to be repeated with other captures.

    Attributes:
        method: one of `METHODS`. number: number of the refit within this method.
        captures: captures to fit.
        expected: expected directions by "display" and "see-through".
    """

    method: str
    number: int
    captures: Captures
    expected: Mapping[str, Expected]

    def outcome(self, fit: Calibration) -> "Outcome":
        """Return the outcome from the fit to these captures."""
        squares = {name: (each.found(fit.sides[name]), each.square) for name, each in self.expected.items()}
        return Outcome(self.method, self.number, squares)


@dataclass(frozen=True)
class Outcome:
    """Outcome of a refit.

    Attributes:
        method, number: see `Refit`.
        squares: observed and stated mean squares of the difference, square arcminutes, by side.
    """

    method: str
    number: int
    squares: Mapping[str, tuple[float, float]]


@dataclass(frozen=True)
class Ratio:
    """Ratio of observed to stated errors.

    Attributes:
        side: "display" or "see-through". method: one of `METHODS`.
        refits: number of refits.
        value: root of the ratio of summed squares, observed to stated.
        low, high: ends of the confidence interval of `LEVEL`, from the numbers of refits and positions.
        stated_arcmin: stated rms error over the eye box.
    """

    side: str
    method: str
    refits: int
    value: float
    low: float
    high: float
    stated_arcmin: float

    @property
    def found_arcmin(self) -> float:
        """Rms error over the eye box if all errors of the fit are larger by this ratio."""
        return self.value * self.stated_arcmin


def require_testable(captures: Captures) -> None:
    """Refuse, before a fit, captures for which refits cannot test the fit.

    Raises:
        BadInputError: there are fewer than `LEAST_POSITIONS` positions, or readings have no noise.
    """
    for name, part in (("display", captures.display), ("see-through", captures.see_through)):
        if part is not None:
            _require_testable(name, part.capture, part.sigma_arcmin)


def _require_testable(name: str, capture: IntArray, sigma_arcmin: FloatArray) -> None:
    if (count := len(np.unique(capture))) < LEAST_POSITIONS:
        raise BadInputError(
            f"--validate needs a model of {LEAST_POSITIONS} camera positions or more, and the {name} has {count}; "
            "add positions, or leave it out."
        )
    if not np.any(sigma_arcmin > 0):
        raise BadInputError("--validate tests errors, and these captures are stated to be exact; leave it out.")


def refits(fit: Calibration, seed: int = 1) -> list[Refit]:
    """Return the refits that test the errors of a fit, without readings that the fit does not use.

    Args:
        fit: the fit to test.
        seed: seed of the drawn errors and of the quarters.

    Raises:
        BadInputError: there are fewer than `LEAST_POSITIONS` positions, or readings have no noise.
    """
    for name, side in fit.sides.items():
        _require_testable(f"fit of the {name}", side.captures.capture[_sound(side)], side.captures.sigma_arcmin)
    rng = np.random.default_rng(seed)
    tested = {name: _tested(side, rng) for name, side in fit.sides.items()}
    found = [_noise_alone(number, fit, tested, np.random.default_rng([seed, number])) for number in range(_REFITS)]
    quarters = [kept for _ in range(_REFITS // _PARTS) for kept in _without_quarters(fit, rng)]
    for method, of_method in ((QUARTERS, quarters), (BANDS, _without_bands(fit))):
        found += [_of_some(method, number, fit, tested, kept) for number, kept in enumerate(of_method)]
    return found


def ratios(fit: Calibration, outcomes: Sequence[Outcome]) -> list[Ratio]:
    """Return the ratios of observed to stated errors, for each side and each method with two or more refits."""
    found = []
    for name, side in fit.sides.items():
        stated, positions = _predicted(side), len(np.unique(side.captures.capture))
        for method in METHODS:
            own = [each for each in outcomes if each.method == method and _counts(*each.squares[name])]
            squares = np.array([each.squares[name] for each in own])
            if len(squares) > 1:
                low, value, high = _interval(squares, np.inf if method == NOISE else positions)
                found.append(Ratio(name, method, len(own), value, low, high, stated))
    return found


def _counts(found: float, stated: float) -> bool:
    """Return whether a refit has answers and a nonzero expected difference."""
    return bool(np.isfinite(found)) and stated > 0


def _interval(squares: FloatArray, positions: float) -> tuple[float, float, float]:
    """Return the low end, value and high end of a ratio, from observed and stated squares (n, 2).

    Refits to parts of one session have the same position errors. These are also a sample, and its size limits the
    precision from any number of refits.
    """
    value = np.sqrt(squares[:, 0].sum() / squares[:, 1].sum())
    of_refits = np.var(0.5 * np.log(np.maximum(squares[:, 0], 1e-12) / squares[:, 1]), ddof=1) / len(squares)
    size = np.sqrt(of_refits + 0.25 / positions) * scipy.special.stdtrit(len(squares) - 1, 0.5 + 0.5 * LEVEL)
    return float(value * np.exp(-size)), float(value), float(value * np.exp(size))


def _predicted(side: Any) -> float:
    return float(side.predicted_arcmin(side.mapping))


def _sound(side: _AnyFit) -> BoolArray:
    """Return the mask (n,) of readings that the fit uses: no outliers, and none from positions that moved."""
    return np.asarray(side.smooth.kept > 0)


def _tested(side: Any, rng: np.random.Generator) -> _Tested:
    subject, viewpoint = side.tested(side.mapping)
    rows = rng.permutation(len(subject))[:_TESTED]
    subject, viewpoint = subject[rows], viewpoint[rows]
    view_dir = side.mapping.view_dir(subject, viewpoint).value
    known = np.isfinite(view_dir).all(axis=1)
    queries = subject[known], viewpoint[known], view_dir[known]
    return _Tested(*queries, *_stated(side, select(side.captures, _sound(side)), queries))


def _stated(
    side: Any, captures: Any, queries: tuple[FloatArray, FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Return `own` and `common` of `_Tested`, as the fit states them for a fit to other captures of the session."""
    return _split(side.with_design(captures, {}).direction_errors(*queries), side.captures.common)


def _captures(fit: Calibration, parts: Mapping[str, Any]) -> Captures:
    panel = None if fit.display is None else fit.display.mapping.panel
    return Captures(parts.get("display"), parts.get("see-through"), panel)


def _without_quarters(fit: Calibration, rng: np.random.Generator) -> list[dict[str, BoolArray]]:
    """Return the readings of each side without each part of its randomly divided positions."""
    found: list[dict[str, BoolArray]] = [{} for _ in range(_PARTS)]
    for name, side in fit.sides.items():
        sound, capture = _sound(side), side.captures.capture
        positions = rng.permutation(np.unique(capture[sound]))
        for number, kept in enumerate(found):
            kept[name] = sound & ~np.isin(capture, positions[number::_PARTS])
    return found


def _without_bands(fit: Calibration) -> list[dict[str, BoolArray]]:
    """Return the readings without each column and each row of positions."""
    found = []
    for axis in (0, 1):
        band = {
            name: bands(side.captures.viewpoint[:, axis], side.captures.capture) for name, side in fit.sides.items()
        }
        for number in range(min(int(each.max()) for each in band.values()) + 1):
            found.append({name: _sound(side) & (band[name] != number) for name, side in fit.sides.items()})
    return found


def _of_some(
    method: str, number: int, fit: Calibration, tested: Mapping[str, _Tested], kept: Mapping[str, BoolArray]
) -> Refit:
    """Return the refit to a mask (n,) of each side's readings, with the expected difference by the law."""
    parts, expected = {}, {}
    for name, any_side in fit.sides.items():
        side: Any = any_side
        parts[name] = select(side.captures, kept[name])
        whole = tested[name]
        queries = whole.subject, whole.viewpoint, whole.view_dir
        own, common = _stated(side, parts[name], queries)
        # No fit can estimate errors of the bench; both fits respond to them, and equal parts cancel.
        square = own - whole.own + np.sum((common - whole.common) ** 2, axis=(1, 2))
        expected[name] = Expected(*queries, float(square.mean()) / ARCMIN**2)
    return Refit(method, number, _captures(fit, parts), expected)


def _split(errors: DirectionErrors, common: CommonErrors | None) -> tuple[FloatArray, FloatArray]:
    """Return the squares (n,) of errors that a fit estimates, and the change (n, 3, k) by common errors."""
    is_common = np.isin(errors.sources, () if common is None else common.sources)
    own = np.trace(errors.unshared, axis1=1, axis2=2) + np.sum(errors.shared[..., ~is_common] ** 2, axis=(1, 2))
    return own, errors.shared[..., is_common]


def _noise_alone(number: int, fit: Calibration, tested: Mapping[str, _Tested], rng: np.random.Generator) -> Refit:
    """Draw a truth from the posterior, and readings from the truth with every error that the fit states."""
    parts, expected = {}, {}
    of_bench = [side.captures.common for side in fit.sides.values() if side.captures.common is not None]
    shared = rng.standard_normal(len(of_bench[0].sources) if of_bench else 0)
    for name, any_side in fit.sides.items():
        side: Any = any_side
        # Errors by label from the fit's residuals are in its covariance, but not in the readings drawn here.
        model = side.mapping.with_spread(replace(side.smooth, of_labels=None).spread)
        truth, subject, viewpoint = (
            _truth(model, int(rng.integers(2**63))),
            tested[name].subject,
            tested[name].viewpoint,
        )
        view_dir = truth(subject, viewpoint)
        errors = model.direction_errors(subject, viewpoint, view_dir)
        own, common = _split(errors, side.captures.common)
        square = own + np.sum(common**2, axis=(1, 2))
        parts[name] = _readings_of(truth, side, shared, rng)
        expected[name] = Expected(subject, viewpoint, view_dir, float(square.mean()) / ARCMIN**2)
    return Refit(NOISE, number, _captures(fit, parts), expected)


def _truth(model: Any, seed: int) -> _Directions:
    """Return the directions of a model changed by a draw from its covariance, without errors shared with the other."""

    def directions(subject: FloatArray, viewpoint: FloatArray) -> FloatArray:
        found = np.array(model.view_dir(subject, viewpoint).value)
        known = np.flatnonzero(np.isfinite(found).all(axis=1))
        for first in range(0, len(known), _ROWS):
            rows = known[first : first + _ROWS]
            changes = model.direction_changes(subject[rows], viewpoint[rows], found[rows])[..., model.spread.shared :]
            found[rows] += changes @ np.random.default_rng(seed).standard_normal(changes.shape[-1])
        return normalised(found)

    return directions


def _readings_of(truth: _Directions, side: Any, shared: FloatArray, rng: np.random.Generator) -> Any:
    """Draw readings from a truth, with motions of the camera, errors of the bench and by label, and noise."""
    sound, smooth = _sound(side), side.smooth
    captures, readings = select(side.captures, sound), smooth.readings.select(sound)
    subject, viewpoint = side.subject(captures), captures.viewpoint
    motion, turned = np.zeros((1, 6)), np.zeros((len(captures), 2))
    if smooth.columns is not None:
        size = motion_sizes(smooth.readings) * np.exp(smooth.prior.group_features @ smooth.hyper)
        motion = (size * rng.standard_normal(size.shape))[readings.capture]
        viewpoint = viewpoint + motion[:, :3]
    if captures.common is not None:  # changes of the stated values, which true values lack
        changes = captures.common.changes(captures, slice(None))
        viewpoint, turned = viewpoint - changes.viewpoint @ shared, turned + changes.tangents @ shared
        subject = subject if changes.point is None else subject - changes.point @ shared
    seen = truth(subject, viewpoint)
    known = np.asarray(np.isfinite(seen).all(axis=1))
    tangents = tangents_of_dir(np.where(known[:, None], seen, captures.view_dir))
    turned = turned + np.einsum(
        "nij,nj->ni", tangents_by_turn(tangents), np.broadcast_to(motion[:, 3:], (len(seen), 3))
    )
    tangents = tangents + turned + _of_labels(readings, smooth.posterior, rng)
    tangents = tangents + _noise(readings, rng) * (smooth.noise / readings.weight)[:, None]
    return select(replace(captures, view_dir=dir_of_tangents(tangents)), known)


def _of_labels(readings: FitReadings, found: Posterior, rng: np.random.Generator) -> FloatArray:
    """Draw errors by label (n, 2) with the sizes estimated by the fit."""
    own, mixed = found.sizes[len(found.side_used) :], found.mixed_mean.size
    drawn = own * rng.standard_normal(found.mean.shape), found.sizes[:mixed] * rng.standard_normal(mixed)
    return label_values(readings, replace(found, mean=drawn[0], mixed_mean=drawn[1]))


def _noise(readings: FitReadings, rng: np.random.Generator) -> FloatArray:
    """Draw noise (n, 2) of unit sigma, with the fit's correlation between neighbours in a photograph."""
    noise = rng.standard_normal((len(readings), 2))
    if readings.shared is None:
        return noise
    for rows in rows_by_capture(readings.capture):
        whitening = readings.shared.root(readings.image[rows], np.ones(len(rows)))
        noise[rows] = scipy.linalg.solve_triangular(whitening, noise[rows], lower=True)
    return noise

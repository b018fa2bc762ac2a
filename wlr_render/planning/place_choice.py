"""Choice of camera places from the posterior of a fit: each is where the variance of registration falls most.

Readings are linear in the unknown coefficients, so that the posterior covariance with further places follows without
photographs or fits. Places replace chosen ones as long as this lowers the mean variance over the eye box (exchange for
I-optimality: Fedorov 1972, Atkinson & Donev 1992).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from wlr_render.calibration.fit_report import ModelFit
from wlr_render.calibration.readings import design_of
from wlr_render.captures.correspondences import DisplayCaptures, SeeThroughCaptures
from wlr_render.captures.feature_captures import CaptureMotionPrior
from wlr_render.geometry import rays
from wlr_render.models.fitted_model import FittedDisplay, FittedSeeThrough
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.polynomial import basis
from wlr_render.planning.planned_errors import FAR_M, NEAR_M, PlannedFit

_READINGS = 110  # number of readings of a capture, with a smaller sigma for the same information
_DISTANCES_M = (0.3, 0.6, 1.5, 3.0)  # candidate distances of one more target
_APART = 0.1  # least difference of two distances, dioptres
_TESTS = 150
_LEAST_INFORMATION = 0.3  # smallest information of a combination of readings, relative to the prior
_WORTH = 1e-3  # smallest gain of an exchange, as a share of the error


class _Posterior:
    """Posterior of one side with the places chosen so far."""

    def __init__(self, offers: "_Offers") -> None:
        self._designs, tests = offers
        self._own = self._designs @ self._designs.transpose(0, 2, 1)  # (places, k, k)
        self._cross = self._designs @ tests.T  # (places, k, tests)
        self._halves = np.zeros((0, *self._designs.shape[:2]))
        self.variance = float(np.sum(tests**2)) / len(tests)  # mean over the tests, per axis

    def take(self, place: int) -> None:
        """Condition on the readings of a place."""
        lower = np.linalg.cholesky(np.eye(self._own.shape[1]) + self._own[place])
        known = np.tensordot(self._designs[place], self._designs, (1, 2))
        known -= np.tensordot(self._halves[:, place], self._halves, (0, 0))
        half = np.linalg.solve(lower, known.reshape(len(lower), -1)).reshape(known.shape)
        cross = np.linalg.solve(lower, self._cross[place])
        self._halves = np.concatenate([self._halves, half])
        by_place = half.transpose(1, 2, 0)  # (places, their k, k of this place)
        self._own = self._own - by_place @ by_place.transpose(0, 2, 1)
        self._cross = self._cross - by_place @ cross
        self.variance -= float(np.sum(cross**2)) / cross.shape[1]

    def changes(self, places: IntArray, sign: float) -> FloatArray:
        """Return the decrease (n,) of the variance with each place added (sign 1), or its increase if removed (-1)."""
        cross = self._cross[places]
        solved = np.linalg.solve(np.eye(cross.shape[1]) + sign * self._own[places], cross)
        return np.asarray(np.sum(cross * solved, axis=(1, 2)) / cross.shape[2])


@dataclass(frozen=True, eq=False)
class PlaceChoice:
    """Choice among offered camera places.

    Attributes:
        places: (n, 3) offered places, device frame, metres.
    """

    places: FloatArray
    _offers: "tuple[_Offers, _Offers]"

    @classmethod
    def of(cls, fit: PlannedFit, places: FloatArray, depths_m: Sequence[float], is_added: bool) -> "PlaceChoice":
        """Offer places for captures of the headset of a fit.

        Args:
            fit: fit that gives the smoothness of the optics, the noise, and the repeatability of the stage.
            places: (n, 3) offered places.
            depths_m: distances of the targets from the centre of the eye box.
            is_added: whether places are added to the captures of the fit; otherwise the captures are not used.
        """
        rng = np.random.default_rng(0)
        shown, seen = fit.display, fit.see_through
        viewpoint = seen.captures.eye_box.at(rng.uniform(-1.0, 1.0, (_TESTS, 3)))
        depth = 1.0 / rng.uniform(1.0 / FAR_M, 1.0 / NEAR_M, _TESTS)
        # Captures have more readings than a choice of places needs; fewer readings with less noise suffice.
        pixel = shown.captures.pixel[rng.integers(0, len(shown.captures), _READINGS)]  # type: ignore[union-attr]
        view_dir = seen.captures.view_dir[rng.integers(0, len(seen.captures), _READINGS)]
        test = rng.integers(0, _READINGS, _TESTS)
        targets = [np.full(len(places), each) for each in depths_m]
        display = _offers(
            shown,
            len(places),
            _shown(shown, places, pixel[None]),
            _shown(shown, viewpoint, pixel[test][:, None]),
            is_added,
        )
        see_through = _offers(
            seen,
            len(places),
            _seen(seen, places, view_dir[None], targets),
            _seen(seen, viewpoint, view_dir[test][:, None], [depth]),
            is_added,
        )
        return cls(places, (display, see_through))

    def one_by_one(self, count: int) -> tuple[list[int], list[float]]:
        """Choose the best next place repeatedly; return the indices and the rms error in arcminutes after each."""
        taken: list[int] = []
        errors: list[float] = []
        sides = self._with(taken)
        while len(taken) < count:
            taken.append(self._take_best(sides, taken))
            errors.append(_error(sides))
        return taken, errors

    def chosen(self, count: int, start: Sequence[int] = ()) -> IntArray:
        """Return indices (count,) of places, exchanged one by one for others as long as the error falls.

        Args:
            count: number of places.
            start: indices (count,) of another start design, in addition to the best places chosen one by one.
        """
        found = [self._exchanged(taken) for taken in (self.one_by_one(count)[0], [*start]) if len(taken) == count]
        return np.array(min(found, key=self.error), np.int64)

    def _exchanged(self, taken: list[int]) -> list[int]:
        sides = self._with(taken)
        for _ in taken:  # no more exchanges than places
            spare = int(np.argmin(sum(side.changes(np.array(taken), -1.0) for side in sides)))
            rest = [*taken[:spare], *taken[spare + 1 :]]
            others = self._with(rest)
            rest.append(self._take_best(others, rest))
            if _error(others) > (1.0 - _WORTH) * _error(sides):
                break
            taken, sides = rest, others
        return taken

    def error(self, taken: Sequence[int]) -> float:
        """Return the rms registration error over the eye box with places, given by their indices, arcminutes."""
        return _error(self._with(taken))

    def _with(self, taken: Sequence[int]) -> tuple[_Posterior, _Posterior]:
        sides = (_Posterior(self._offers[0]), _Posterior(self._offers[1]))
        for side in sides:
            for place in taken:
                side.take(place)
        return sides

    def _take_best(self, sides: tuple[_Posterior, _Posterior], taken: Sequence[int]) -> int:
        gain = np.sum([side.changes(np.arange(len(self.places)), 1.0) for side in sides], axis=0)
        gain[list(taken)] = -np.inf
        best = int(np.argmax(gain))
        for side in sides:
            side.take(best)
        return best


def _error(sides: tuple[_Posterior, _Posterior]) -> float:
    """Return the rms error of both sides; both axes have the same variance."""
    return float(np.sqrt(2.0 * sum(side.variance for side in sides)))


def further_distance(
    fit: PlannedFit, places: FloatArray, depths_m: Sequence[float], is_added: bool
) -> tuple[float, float]:
    """Return the distance of one more target, seen from places (m, 3), that lowers the registration error most.

    Returns:
        The distance in metres, and the ratio of the rms errors with and without it. See `PlaceChoice.of`.
    """

    def error(*further: float) -> float:
        return PlaceChoice.of(fit, places, (*depths_m, *further), is_added).error(range(len(places)))

    now = error()
    others = [depth for depth in _DISTANCES_M if all(abs(1 / depth - 1 / each) > _APART for each in depths_m)]
    tried = {depth: error(depth) / now for depth in others or _DISTANCES_M}
    best = min(tried, key=tried.__getitem__)
    return best, tried[best]


def _shown(fit: ModelFit[FittedDisplay], places: FloatArray, pixel: FloatArray) -> DisplayCaptures:
    """Predict, with the model, captures of pixels (n, k, 2) from places (n, 3)."""
    found = fit.mapping.view_dir_of_pixel(pixel, places[:, None])
    place, column = np.nonzero(np.isfinite(found.value).all(axis=-1) & (found.value[..., 2] < 0))
    captures = fit.captures
    assert isinstance(captures, DisplayCaptures)
    return DisplayCaptures(
        device=captures.device,
        eye=captures.eye,
        eye_box=captures.eye_box,
        panel=captures.panel,
        viewpoint=places[place],
        view_dir=found.value[place, column],
        pixel=np.broadcast_to(pixel, (len(places), *pixel.shape[1:]))[place, column],
        capture=place,
        sigma_arcmin=_sigma(captures, pixel.shape[1], len(place)),
        motion=_motion(captures.motion, len(places)),
    )


def _seen(
    fit: ModelFit[FittedSeeThrough], places: FloatArray, view_dir: FloatArray, depths_m: Sequence[FloatArray]
) -> SeeThroughCaptures:
    """Predict, with the model, captures of points in directions (n, k, 3) at depths (n,) of each target."""
    captures = fit.captures
    assert isinstance(captures, SeeThroughCaptures)
    ray = fit.mapping.real_ray_of_view_dir(view_dir, places[:, None]).value
    place, column = np.nonzero(np.isfinite(ray).all(axis=-1) & (ray[..., 5] < 0))
    points = [
        rays.split(rays.at_z(ray[place, column], captures.eye_box.centre[2] - depth[place]))[0] for depth in depths_m
    ]
    return SeeThroughCaptures(
        device=captures.device,
        eye=captures.eye,
        eye_box=captures.eye_box,
        viewpoint=np.tile(places[place], (len(points), 1)),
        view_dir=np.tile(
            np.broadcast_to(view_dir, (len(places), *view_dir.shape[1:]))[place, column], (len(points), 1)
        ),
        point=np.concatenate(points),
        capture=np.tile(place, len(points)),
        target_pose=np.repeat(np.arange(len(points)), len(place)),
        sigma_arcmin=_sigma(captures, view_dir.shape[1], len(points) * len(place)),
        motion=_motion(captures.motion, len(places)),
    )


def _sigma(captures: DisplayCaptures | SeeThroughCaptures, each: int, count: int) -> FloatArray:
    """Return the sigma (count,) at which `each` readings per capture have as much information as the given captures."""
    usual = len(captures) / len(captures.visits[0])
    return np.full(count, float(np.median(captures.sigma_arcmin)) * np.sqrt(each / usual))


def _motion(known: CaptureMotionPrior | None, count: int) -> CaptureMotionPrior | None:
    if known is None:
        return None
    size = np.sqrt(np.mean(known.size**2, axis=0))
    return CaptureMotionPrior(np.arange(count), np.tile(size, (count, 1)), known.log_sigma)


def _offers(
    fit: ModelFit[FittedDisplay] | ModelFit[FittedSeeThrough],
    places: int,
    offered: DisplayCaptures | SeeThroughCaptures,
    tests: DisplayCaptures | SeeThroughCaptures,
    is_added: bool,
) -> "_Offers":
    smooth = fit.smooth
    box = smooth.readings.box
    readings, tested = fit.readings_of(offered), fit.readings_of(tests)
    root = smooth.coefficient_root if is_added else np.diag(smooth.prior_size)
    size = np.linalg.norm(root, axis=1)
    short = []
    for design in smooth.whitened(readings, offered.capture, places):
        # Keep the combinations of readings with nearly all the information.
        extent, vectors = np.linalg.eigh((design * size) @ (design * size).T)
        short.append(vectors[:, extent > _LEAST_INFORMATION].T @ design)
    each = max(map(len, short))
    designs = np.stack([np.pad(rows, ((0, each - len(rows)), (0, 0))) for rows in short])
    of_tests = design_of(tested, slice(None), basis(tested.inputs, tested.orders, box)) * tested.metric[:, None]
    return designs @ root, of_tests @ root


_Offers = tuple[FloatArray, FloatArray]
"""Designs of the offered places for one side (places, k, unknowns), in units of the noise, and of the errors to be
lowered (tests, unknowns), arcminutes; by unknowns of variance 1."""

"""Readings of a session with the errors that a bench gives them: noise, shared noise, and motions of the camera.

Whitening transforms readings with correlated errors to readings with independent errors. The errors of a group of
readings have the covariance 1 + U U': white noise of unit variance, and the effect of a few random numbers of unit
variance on the whole group (a motion of the camera, noise that neighbours share). With U = Q S R' the readings are
multiplied by 1 - Q (1 - 1 / sqrt(1 + S^2)) Q', the inverse square root of that covariance.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from wlr_render.bench.bench import Bench
from wlr_render.diagnosis.noise import Noise
from wlr_render.diagnosis.observations import RUN_TIME, Observations
from wlr_render.diagnosis.prediction import Linearisation, Predictor
from wlr_render.diagnosis.residual_surfaces import image_basis, photographs
from wlr_render.geometry.transforms import rotations_of_vectors
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray, rows_by_label
from wlr_render.numerics.scatter import Scatter, ScatterSums

_NEGLIGIBLE = 1e-4  # variance, relative to white noise, below which a common error is dropped
_STEPS = np.repeat([1.0, np.radians(600.0)], 3)  # steps of the camera's shift and turn: 1 um, then 600 udeg in urad


@dataclass(frozen=True, eq=False)
class _Group:
    """Readings that have common errors.

    Attributes:
        rows: (m,) indices of the readings.
        axes: (m, q) error directions, if both image axes have independent errors of the same covariance; (2 m, q) for
            joint errors of both axes.
        taken: (q,) share of each axis to subtract.
    """

    rows: IntArray
    axes: FloatArray
    taken: FloatArray


@dataclass(frozen=True, eq=False)
class Whitening:
    """Linear map that makes errors independent and of unit size.

    Attributes:
        scale: (n,) factor of each reading.
        groups: readings with common errors, which are subtracted one after the other.
    """

    scale: FloatArray
    groups: tuple[_Group, ...] = ()

    def __call__(self, values: FloatArray) -> FloatArray:
        """Whiten values (n, 2) or (n, 2, p) in units of sigma."""
        white = values * self.scale.reshape(-1, *(1,) * (values.ndim - 1))
        for group in self.groups:
            mine = white[group.rows]
            flat = mine.reshape(len(group.axes), mine.size // len(group.axes))
            common = group.axes @ (group.taken[:, None] * (group.axes.T @ flat))
            white[group.rows] -= common.reshape(mine.shape)
        return white

    def then(self, rows: Iterable[IntArray], effects: Iterable[FloatArray]) -> "Whitening":
        """Return the whitening with further common errors of groups of readings.

        Args:
            rows: (m,) readings of each group.
            effects: (m, 2, q) effects, on the white readings, of each group's random numbers of unit variance.
        """
        groups = [_group(mine, effect.reshape(2 * len(mine), -1)) for mine, effect in zip(rows, effects, strict=True)]
        return Whitening(self.scale, (*self.groups, *(each for each in groups if each is not None)))


def _group(rows: IntArray, effects: FloatArray) -> _Group | None:
    squares, turn = np.linalg.eigh(effects.T @ effects)
    kept = squares > _NEGLIGIBLE
    if not kept.any():
        return None
    axes = effects @ (turn[:, kept] / np.sqrt(squares[kept]))
    return _Group(rows, axes, 1.0 - 1.0 / np.sqrt(1.0 + squares[kept]))


def shared_noise_whitening(observations: Observations, noise: Noise) -> Whitening:
    """Return the whitening of the slowly varying part of the noise that neighbouring readings share.

    Noise that varies faster than the polynomials of a smooth surface counts as white.
    """
    scale, groups = np.ones(len(observations)), []
    share = {part: noise.floor(part).shared for part in np.unique(observations.part)}
    for rows in photographs(observations) if any(share.values()) else ():
        part = observations.part[rows[0]]
        design = image_basis(observations, rows) if share[part] else None
        if design is None:
            continue
        place, axes = observations.image_place[rows], np.linalg.qr(design)[0]
        slow = axes.T @ noise.floor(part).shared_correlation(place) @ axes
        size, turn = np.linalg.eigh(share[part] * slow)
        effects = axes @ turn * np.sqrt(size.clip(0.0))
        white = (1.0 - np.sum(effects**2, axis=1)).clip(0.05)
        scale[rows] = 1.0 / np.sqrt(white)
        group = _group(rows, effects * scale[rows][:, None])
        if group is not None:
            groups.append(group)
    return Whitening(scale, tuple(groups))


@dataclass(frozen=True, eq=False)
class WeighedReadings:
    """Readings with the errors that a bench gives them.

    Attributes:
        predictor: predictor of the readings, without outliers; their sigma is the noise.
        noise: noise of the session.
        shared: whitening of the noise that neighbours share.
        camera_motions: (n, 2, 6) change of the readings, in sigma, by a shift (micrometres) and a turn (microradians)
            of the camera in the reading's capture; zero at run time.
        motions: (n, 2, 6) the same for the white readings.
        effects: (n, 2, k) change of the readings, in sigma, by each function of the located effects.
        effect_sizes: (k,) standard deviations of their coefficients, which are random and common to all readings.
    """

    predictor: Predictor
    noise: Noise
    shared: Whitening
    camera_motions: FloatArray
    motions: FloatArray
    effects: FloatArray
    effect_sizes: FloatArray

    @classmethod
    def of(cls, predictor: Predictor, noise: Noise) -> "WeighedReadings":
        """Return the readings of a predictor whose sigma is the noise."""
        observations = predictor.observations
        shared = shared_noise_whitening(observations, noise)
        motions = camera_motions(predictor)
        none = np.zeros((len(observations), 2, 0))
        return cls(predictor, noise, shared, motions, shared(motions), none, np.zeros(0))

    @property
    def observations(self) -> Observations:
        """The readings."""
        return self.predictor.observations

    def of_rows(self, keep: BoolArray) -> "WeighedReadings":
        """Return the readings that a mask (n,) selects."""
        return self if keep.all() else WeighedReadings.of(self.predictor.of_rows(keep), self.noise)

    def whitening(self, scatter: Scatter) -> Whitening:
        """Return the whitening for given sizes of noise and motions."""
        group, part = self.observations.group, self.observations.part
        names, rows = rows_by_label(group)
        sizes = scatter.sizes(self.observations.part_of_capture)[names]
        white = self.shared.then(rows, (self.motions[mine] * size for mine, size in zip(rows, sizes, strict=True)))
        white = replace(white, scale=white.scale / scatter.noise[part])
        if not self.effect_sizes.size:
            return white
        return white.then([np.arange(len(part))], [white(self.effects) * self.effect_sizes])

    def excess(self, scatter: Scatter, part: int, captures: BoolArray) -> float:
        """Return the excess variance of a part's white readings over the noise, from motions and remaining noise.

        Args:
            scatter: sizes of noise and motions.
            part: index of the part.
            captures: (captures,) mask of the captures to include.
        """
        group = self.observations.group
        rows = (self.observations.part == part) & captures[group]
        size = scatter.noise[part] * scatter.sizes(self.observations.part_of_capture)[group[rows]]
        moved = np.sum((self.motions[rows] * size[:, None, :]) ** 2, axis=(1, 2))
        return float(scatter.noise[part] ** 2 - 1.0) + 0.5 * float(np.mean(moved) if rows.any() else 0.0)

    def sums_at(self, at: Linearisation, fixed: ScatterSums | None = None) -> ScatterSums:
        """Return the sums of a linearisation, with the priors of its free parameters, appended to `fixed` sums."""
        sums = self.sums(at.residual, at.jacobian, -at.off_prior)
        return sums if fixed is None else fixed.joined(sums)

    def sums(
        self, residual: FloatArray, columns: FloatArray, mean: FloatArray | float = 0.0, sigma: FloatArray | float = 1.0
    ) -> ScatterSums:
        """Return the sums of a residual (n, 2) and columns (n, 2, m) in sigma, with priors of the coefficients."""
        sums, last = self._sums(residual, columns, mean, sigma), len(self.effect_sizes)
        if not last:
            return sums
        both = self._sums_of_effects.joined(sums)
        return replace(both.of_columns(np.r_[last : len(both.mean), :last]), carried=last)

    @cached_property
    def _sums_of_effects(self) -> ScatterSums:
        return self.fixed(self.effects, self.effect_sizes)

    def fixed(self, columns: FloatArray, sigma: FloatArray | float = 1.0) -> ScatterSums:
        """Return the sums over columns (n, 2, m) alone, to be joined by sums of a residual and other columns."""
        return self._sums(np.zeros(columns.shape[:2]), columns, 0.0, sigma)

    def _sums(
        self, residual: FloatArray, columns: FloatArray, mean: FloatArray | float, sigma: FloatArray | float
    ) -> ScatterSums:
        y, x, observed = self.shared(residual), self.shared(columns), self.observations
        captures = len(observed.captures)
        return ScatterSums.over(y, self.motions, x, observed.group, observed.part, captures, mean, sigma)


def camera_motions(predictor: Predictor) -> FloatArray:
    """Return the change (n, 2, 6) of the readings, in sigma, by a micrometre or microradian of camera motion.

    It is zero at run time. Where a photograph without the headset places the dots, the motion is between the two
    photographs.
    """
    motions = _of_placed_dots(predictor).lever(_camera_moved, _STEPS)
    motions[predictor.observations.part == RUN_TIME] = 0.0
    return motions


def _camera_moved(bench: Bench, motion: FloatArray) -> Bench:
    """Return the bench with its camera shifted (3 micrometres) and turned (3 microradians) about its pupil."""
    shift, turn = 1e-6 * motion[:3], rotations_of_vectors(1e-6 * motion[3:])
    old = bench.camera
    camera = replace(old, pupil_offset=old.pupil_offset + shift, device_from_camera=turn @ old.device_from_camera)
    return replace(bench, camera=camera)


def _of_placed_dots(predictor: Predictor) -> Predictor:
    """Return a predictor of the same readings with dots placed by the stated poses of the target."""
    observations = predictor.observations
    session, plan = observations.session, observations.session.plan.see_through
    if plan is None or plan.bare_pixel is None:
        return predictor
    placed = replace(session.plan, see_through=replace(plan, bare_pixel=None))
    return Predictor(replace(observations, session=replace(session, plan=placed)))

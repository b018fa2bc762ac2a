"""Readings of a session with the errors that a bench gives them: noise, shared noise, and motions of the camera."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from wlr_render.diagnosis.causes import CAUSES
from wlr_render.diagnosis.noise import Noise
from wlr_render.diagnosis.observations import RUN_TIME, Observations
from wlr_render.diagnosis.prediction import Explanation, Hypothesis, Predictor
from wlr_render.diagnosis.whitening import Whitening, shared_noise_whitening
from wlr_render.numerics.arrays import BoolArray, FloatArray, rows_by_label
from wlr_render.numerics.scatter import Scatter, ScatterSums

_POSE = ("camera_pupil_offset", "camera_rotation")
_MICRO = {"mm": 1e3, "deg": float(np.radians(1e6))}


@dataclass(frozen=True, eq=False)
class WeighedReadings:
    """Readings with the errors that a bench gives them.

    Attributes:
        predictor: of the readings, none of which is an outlier; their sigma is that of their noise.
        noise: of the session.
        shared: whitening of the noise that neighbours share.
        camera_motions: (n, 2, 6) change of the readings, in sigma, by a shift (micrometres) and a turn (microradians)
            of the camera in the reading's capture; zero at run time.
        motions: (n, 2, 6) the same of the white readings.
        effects: (n, 2, k) change of the readings, in sigma, by each function of the effects that are located, and
        effect_sizes: (k,) sizes of their coefficients: one more thing that is random, common to all readings.
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
        """Of a predictor whose sigma is that of the noise."""
        observations = predictor.observations
        shared = shared_noise_whitening(observations, noise)
        motions = camera_motions(predictor)
        none = np.zeros((len(observations), 2, 0))
        return cls(predictor, noise, shared, motions, shared(motions), none, np.zeros(0))

    def with_effects(self, effects: FloatArray, sizes: FloatArray) -> "WeighedReadings":
        """Return the readings with the functions (n, 2, k) of effects, of sizes (k,) of their coefficients, at work."""
        return replace(self, effects=effects, effect_sizes=sizes)

    @property
    def observations(self) -> Observations:
        """What was read."""
        return self.predictor.observations

    def of_rows(self, keep: BoolArray) -> "WeighedReadings":
        """Return the readings that a mask (n,) selects."""
        return self if keep.all() else WeighedReadings.of(self.predictor.of_rows(keep), self.noise)

    def whitening(self, scatter: Scatter) -> Whitening:
        """Return the map that makes errors independent and of unit size, given the sizes of what is random."""
        group, part = self.observations.group, self.observations.part
        names, rows = rows_by_label(group)
        part_of = np.zeros(len(self.observations.captures), dtype=np.int64)
        part_of[names] = [part[mine[0]] for mine in rows]
        sizes = scatter.sizes(part_of)[names]
        white = self.shared.then(rows, (self.motions[mine] * size for mine, size in zip(rows, sizes, strict=True)))
        white = Whitening(white.scale / scatter.noise[part], white.by_axis, white.by_reading)
        if not self.effect_sizes.size:
            return white
        return white.then([np.arange(len(part))], [white(self.effects) * self.effect_sizes])

    def excess(self, scatter: Scatter, part: int, captures: BoolArray) -> float:
        """Variance of a part's white readings above that of noise, by motions and by what is left as noise.

        Args:
            scatter: sizes of what is random.
            part: of the session.
            captures: (captures,) whose motions count.
        """
        group = self.observations.group
        rows = (self.observations.part == part) & captures[group]
        part_of = np.array([name.part for name in self.observations.captures])
        size = scatter.noise[part] * scatter.sizes(part_of)[group[rows]]
        moved = np.sum((self.motions[rows] * size[:, None, :]) ** 2, axis=(1, 2))
        return float(scatter.noise[part] ** 2 - 1.0) + 0.5 * float(np.mean(moved) if rows.any() else 0.0)

    def sums(self, residual: FloatArray, columns: FloatArray, fixed: "FixedColumns | None" = None) -> ScatterSums:
        """Of a residual (n, 2) and columns (n, 2, m) in units of sigma, after those that are fixed."""
        observed, count = self.observations, columns.shape[2]
        y, x = self.shared(residual), self.shared(columns)
        sums = ScatterSums.over(y, self.motions, x, observed.group, observed.part, len(observed.captures))
        if self.effect_sizes.size:
            effects = self._fixed_effects
            both = effects.sums.joined(sums, effects.white, y, x, observed.part)
            last = np.r_[effects.count : effects.count + count, : effects.count]
            sums = replace(both.of_columns(last), carried=self.effect_sizes)
            x = np.concatenate([x, effects.white], axis=2)
        return sums if fixed is None else fixed.sums.joined(sums, fixed.white, y, x, observed.part)

    @cached_property
    def _fixed_effects(self) -> "FixedColumns":
        return self.fixed(self.effects)

    def fixed(self, columns: FloatArray) -> "FixedColumns":
        """Return columns (n, 2, m), in units of sigma, of which sums are asked for again and again."""
        observed, white = self.observations, self.shared(columns)
        zero, captures = np.zeros(white.shape[:2]), len(observed.captures)
        return FixedColumns(white, ScatterSums.over(zero, self.motions, white, observed.group, observed.part, captures))


@dataclass(frozen=True, eq=False)
class FixedColumns:
    """Columns of which sums are asked for again and again.

    Attributes:
        white: (n, 2, m) columns whose errors do not go together.
        sums: of them, with no residual.
    """

    white: FloatArray
    sums: ScatterSums

    @property
    def count(self) -> int:
        """How many."""
        return int(self.white.shape[2])


def camera_motions(predictor: Predictor) -> FloatArray:
    """Change of the readings (n, 2, 6) in sigma by a micrometre or a microradian of the camera; zero at run time.

    Where dots are placed by a photograph without the headset, it is a motion between the two photographs.
    """
    predictor = _of_placed_dots(predictor)
    nothing = Explanation()
    state, columns = predictor.state(nothing), []
    for name in _POSE:
        hypothesis = Hypothesis(CAUSES[name], next(iter(CAUSES[name].variants)))
        at = predictor.added(state, nothing.plus(hypothesis))
        full = np.zeros((*at.residual.shape, 3))
        full[:, :, at.free] = at.jacobian
        columns.append(full / [each.prior_sigma * _MICRO[each.unit] for each in hypothesis.cause.parameters])
    motions = np.concatenate(columns, axis=-1)
    motions[predictor.observations.part == RUN_TIME] = 0.0
    return np.asarray(motions)


def _of_placed_dots(predictor: Predictor) -> Predictor:
    """Return a predictor of the same readings whose dots are where the stated poses of the target place them."""
    observations = predictor.observations
    session, plan = observations.session, observations.session.plan.see_through
    if plan is None or plan.bare_pixel is None:
        return predictor
    placed = replace(session.plan, see_through=replace(plan, bare_pixel=None))
    return Predictor(replace(observations, session=replace(session, plan=placed)))

"""Predicted readings of a bench with causes at work, and their derivatives by the causes' values."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from wlr_render.bench.bench import Bench
from wlr_render.bench.simulate_session import Views, simulate, simulate_to_first_order
from wlr_render.captures.session import Readings, Session, SessionPlan
from wlr_render.diagnosis.cause import Cause, Parameter, Perturb, Role
from wlr_render.diagnosis.observations import (
    DISPLAY,
    PART_NAMES,
    RUN_TIME,
    SEE_THROUGH,
    Observations,
    observed,
    readings_of_rows,
)
from wlr_render.errors import BadInputError
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray
from wlr_render.optics.device import EyeOptics

_STEP = 2e-3  # finite-difference step, in prior sigmas of a parameter
_NOTHING = 1e-4  # sigma per prior sigma: solves from different starts differ by 1e-5
_READ_BY: dict[str, tuple[int, ...]] = {
    **dict.fromkeys(("stage", "mount"), (DISPLAY, SEE_THROUGH)),
    **dict.fromkeys(("readout", "wavelengths_um"), (DISPLAY,)),
    **dict.fromkeys(("target", "tracking"), (SEE_THROUGH,)),
    "target_wavelength_um": (SEE_THROUGH, RUN_TIME),
    **dict.fromkeys(("eye_tracking", "clock"), (RUN_TIME,)),
    "priors": (),
    **dict.fromkeys(("panel", "display"), (DISPLAY, RUN_TIME)),
    "see_through": (SEE_THROUGH, RUN_TIME),
}
"""Parts of a session that depend on an attribute of a bench or of its optics; on any other one, all parts do."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A cause acting in one of its ways."""

    cause: Cause
    variant: str


@dataclass(frozen=True, eq=False)
class Explanation:
    """Causes at work, in order: with them the nominal bench becomes the corrected one.

    Attributes:
        hypotheses: which.
        values: one array of parameter values for each, in the parameters' units.
    """

    hypotheses: tuple[Hypothesis, ...] = ()
    values: tuple[FloatArray, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the causes."""
        return tuple(hypothesis.cause.name for hypothesis in self.hypotheses)

    def bench(self, nominal: Bench) -> Bench:
        """Return the corrected bench: the nominal one with the causes at work."""
        for hypothesis, values in zip(self.hypotheses, self.values, strict=True):
            nominal = hypothesis.cause.perturb(nominal, values, hypothesis.variant)
        return nominal

    def plus(self, hypothesis: Hypothesis, values: FloatArray | None = None) -> "Explanation":
        """Return the explanation with one more cause, at its null values unless others are given."""
        added = hypothesis.cause.null() if values is None else values
        return Explanation((*self.hypotheses, hypothesis), (*self.values, added))

    def without(self, number: int) -> "Explanation":
        """Return the explanation without one of its causes."""
        kept = [i for i in range(len(self.hypotheses)) if i != number]
        return Explanation(tuple(self.hypotheses[i] for i in kept), tuple(self.values[i] for i in kept))

    def parameters(self) -> list[Parameter]:
        """All parameters, in order."""
        return [parameter for hypothesis in self.hypotheses for parameter in hypothesis.cause.parameters]

    @property
    def prior_sigma(self) -> FloatArray:
        """Standard deviations (p,) of all priors, in the parameters' units."""
        return np.array([parameter.prior_sigma for parameter in self.parameters()])

    @property
    def off_prior(self) -> FloatArray:
        """Distance (p,) of all values from the means of their priors, in prior sigmas; 0 for times."""
        parameters = self.parameters()
        mean = np.array([p.starts[0] if p.role is Role.SHAPE else p.prior_mean for p in parameters])
        off = (self.vector() - mean) / self.prior_sigma
        off[[p.role is Role.TIME for p in parameters]] = 0.0
        return np.asarray(off)

    def vector(self) -> FloatArray:
        """All values one after the other."""
        return np.concatenate([np.zeros(0), *self.values])

    def at(self, vector: FloatArray) -> "Explanation":
        """Return the same causes at other values."""
        ends = np.cumsum([len(values) for values in self.values])
        return replace(self, values=tuple(np.split(vector, ends[:-1])) if self.values else ())


@dataclass(frozen=True, eq=False)
class State:
    """A bench and its readings.

    Attributes:
        bench: the bench.
        readings: predicted.
        views: of its dots, for neighbouring benches to start from.
    """

    bench: Bench
    readings: Readings
    views: Views


@dataclass(frozen=True, eq=False)
class Linearisation:
    """Readings near one explanation.

    Attributes:
        explanation: where.
        state: its bench and readings.
        residual: (n, 2) measured minus predicted there, in units of sigma.
        jacobian: (n, 2, p) of the predicted readings by the free parameters, in units of sigma per prior sigma.
        free: (p,) indices into the explanation's parameters; times, and shapes of an effect of no size, are not free.
    """

    explanation: Explanation
    state: State
    residual: FloatArray
    jacobian: FloatArray
    free: IntArray

    @property
    def off_prior(self) -> FloatArray:
        """Distance (p,) of the free values from the means of their priors, in prior sigmas."""
        return self.explanation.off_prior[self.free]


class Predictor:
    """Predicts the readings of one set of observations by explanations of its nominal bench.

    A state near another one costs little: the part of a session that their difference cannot touch is not done again,
    and the rest starts from the other's solution.
    """

    def __init__(self, observations: Observations, nominal: State | None = None) -> None:
        """`nominal` is the state of the nominal bench where it is known; else the session is simulated."""
        self.observations = observations
        self._nominal = nominal or _nominal_state(observations.nominal, observations.session.plan)

    @classmethod
    def of_session(cls, nominal: Bench, session: Session) -> "Predictor":
        """Return the predictor of all readings that the nominal bench can predict.

        Raises:
            BadInputError: the bench predicts no reading.
        """
        every = cls(observed(nominal, session))
        predictable = np.asarray(np.isfinite(every.residual(Explanation())).all(axis=1))
        if not predictable.any():
            raise BadInputError(
                f"{session.name}: the bench as described sees none of its {len(predictable)} readings; check the "
                "device, the stage's origin and the target's poses."
            )
        return every.of_rows(predictable)

    def with_sigma(self, sigma_px: FloatArray) -> "Predictor":
        """Return the predictor of the same readings with another noise."""
        return Predictor(self.observations.with_sigma(sigma_px), self._nominal)

    def of_rows(self, keep: BoolArray) -> "Predictor":
        """Return the predictor of the readings in a mask (n,)."""
        observations, masks = self.observations.of_rows(keep), self.observations.masks(keep)
        return Predictor(observations, _state_of_rows(self._nominal, observations.session.plan, masks))

    def residual(self, explanation: Explanation) -> FloatArray:
        """Measured minus predicted, (n, 2), in units of sigma."""
        return self.residual_of(self.state(explanation))

    def residual_of_bench(self, bench: Bench) -> FloatArray:
        """Likewise, of any bench of the same headset."""
        near, todo = self._nominal, self._touched(bench, self._nominal)
        views = Views.of(bench, todo, near.views)
        return self.observations.residual(_merged(simulate(bench, todo, views), near.readings))

    def residual_of(self, state: State) -> FloatArray:
        """Likewise, of a state."""
        return self.observations.residual(state.readings)

    def state(self, explanation: Explanation, near: State | None = None) -> State:
        """Return an explanation's bench and its readings, starting from the nominal or a nearer state.

        All readings are NaN if such a bench cannot exist, e.g. if a displaced panel is invisible from everywhere.
        """
        near = near or self._nominal
        try:
            bench = explanation.bench(self.observations.nominal)
            todo = self._touched(bench, near)
            views = Views.of(bench, todo, near.views)
            return State(bench, _merged(simulate(bench, todo, views), near.readings), views)
        except BadInputError:
            return replace(near, readings=_lost(near.readings))

    def linearised(self, explanation: Explanation, state: State | None = None) -> Linearisation:
        """Residual and Jacobian at an explanation, whose state may be known, by forward differences."""
        return self._differences(explanation, 0, state or self.state(explanation))

    def added(self, state: State, explanation: Explanation) -> Linearisation:
        """Linearisation by the parameters of an explanation's last cause only.

        Args:
            state: of the explanation; while its last cause has no effect, of the others.
            explanation: the explanation.
        """
        return self._differences(explanation, len(explanation.vector()) - len(explanation.values[-1]), state)

    def signature(self, hypothesis: Hypothesis, values: FloatArray | None = None) -> Linearisation:
        """Return the linearisation by the parameters of one cause alone, at its null values unless others are given."""
        explanation = Explanation().plus(hypothesis, values)
        return self.added(self.state(Explanation()), explanation)

    def lever(self, change: Perturb, steps: FloatArray) -> FloatArray:
        """Return the change (n, 2, k) of the readings, in sigma, by each value (k,) of a change of the nominal bench.

        Args:
            change: the change; zeros leave the bench as it is.
            steps: (k,) steps of the forward differences, in the units of the values.
        """
        base = self._nominal
        residual, columns = self.residual_of(base), []
        for values in np.diag(steps):
            by_step = self._by_step(base, residual, change, values)
            columns.append(by_step / values.sum() if _acts(by_step) else np.zeros_like(residual))
        return np.stack(columns, axis=-1)

    def extended(self, old: Linearisation, state: State, explanation: Explanation) -> Linearisation:
        """Return the linearisation by all parameters; derivatives of all causes but the last come from `old`.

        Args:
            old: a linearisation, with or without the last cause.
            state, explanation: as in `added`.
        """
        last = self.added(state, explanation)
        same = old.free < len(explanation.vector()) - len(explanation.values[-1])
        jacobian = np.concatenate([old.jacobian[:, :, same], last.jacobian], axis=2)
        return replace(last, jacobian=jacobian, free=np.concatenate([old.free[same], last.free]))

    def _differences(self, explanation: Explanation, first: int, base: State) -> Linearisation:
        residual, vector, columns, free = self.residual_of(base), explanation.vector(), [], []
        for number, parameter in list(enumerate(explanation.parameters()))[first:]:
            if parameter.role is Role.TIME:
                continue
            moved = vector.copy()
            moved[number] += _STEP * parameter.prior_sigma
            by_step = self._by_step(base, residual, lambda bench, vector: explanation.at(vector).bench(bench), moved)
            if _acts(by_step):
                columns.append(by_step / _STEP)
                free.append(number)
        jacobian = np.stack(columns, axis=-1) if columns else np.zeros((*residual.shape, 0))
        return Linearisation(explanation, base, residual, jacobian, np.array(free, dtype=np.int64))

    def _by_step(self, base: State, residual: FloatArray, change: Perturb, values: FloatArray) -> FloatArray:
        """Return the change (n, 2) of the readings from a state to a changed nominal bench, to first order, in sigma.

        A reading that the step loses, or a step to a bench that cannot exist, changes nothing.
        """
        try:
            bench = change(self.observations.nominal, values)
            found = simulate_to_first_order(bench, self._touched(bench, base), base.views)
        except BadInputError:
            return np.zeros_like(residual)
        return np.nan_to_num(residual - self.observations.residual(_merged(found, base.readings)))

    def _touched(self, bench: Bench, near: State) -> SessionPlan:
        """Return the parts of the session whose readings may differ between a bench and a state."""
        every = range(len(PART_NAMES))
        touched = {part for name in _changes(bench, near.bench) for part in _READ_BY.get(name, every)}
        plan = self.observations.session.plan
        return SessionPlan(
            plan.display if DISPLAY in touched else None,
            plan.see_through if SEE_THROUGH in touched else None,
            plan.run_time if RUN_TIME in touched else None,
        )


def _changes(bench: Bench, old: Bench) -> Iterator[str]:
    """Attributes that differ between two benches, and between the optics of their eyes."""
    for kind, new, was in ((Bench, bench, old), (EyeOptics, bench.optics, old.optics)):
        names = (each.name for each in fields(kind) if each.name not in ("device", "eye"))  # known by their optics
        yield from (name for name in names if getattr(new, name) is not getattr(was, name))


def _lost(readings: Readings) -> Readings:
    """Return readings of which none is predicted."""
    return Readings(*(None if part is None else np.full_like(part, np.nan) for part in readings.parts))


def _acts(by_step: FloatArray) -> bool:
    """Return whether a step of `_STEP` prior sigmas changes readings by more than solves from other starts differ."""
    return bool(np.max(np.abs(by_step), initial=0.0) > _NOTHING * _STEP)


def _nominal_state(nominal: Bench, plan: SessionPlan) -> State:
    views = Views.of(nominal, plan)
    return State(nominal, simulate(nominal, plan, views), views)


def _state_of_rows(state: State, plan: SessionPlan, masks: Sequence[BoolArray]) -> State:
    """Return the state of the rows that a mask of each part keeps; `plan` has these rows."""
    dots, run_time = state.views.dots, state.views.run_time
    some = Views(
        None if plan.see_through is None or dots is None else dots.of_rows(plan.see_through, masks[SEE_THROUGH]),
        None if plan.run_time is None or run_time is None else run_time.of_rows(plan.run_time, masks[RUN_TIME]),
    )
    return State(state.bench, readings_of_rows(state.readings, masks), some)


def _merged(found: Readings, old: Readings) -> Readings:
    """Return the new readings, with the old ones of the parts that were not simulated again."""
    return Readings(*(was if new is None else new for new, was in zip(found.parts, old.parts, strict=True)))

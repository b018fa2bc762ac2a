"""Predicted readings of a bench with causes applied, and their derivatives with respect to the causes' values."""

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

import numpy as np

from wlr_render.bench.bench import Bench
from wlr_render.bench.simulate_session import Views, simulate
from wlr_render.captures.session import Readings, Session, SessionPlan
from wlr_render.diagnosis.cause import Cause, Parameter, Perturb, Role
from wlr_render.diagnosis.observations import (
    DISPLAY,
    PART_NAMES,
    RUN_TIME,
    SEE_THROUGH,
    Observations,
    observed,
)
from wlr_render.errors import BadInputError
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray
from wlr_render.optics.device import EyeOptics

_STEP = 2e-3  # finite-difference step, in prior sigmas of a parameter
_NOTHING = 1e-4  # derivative, in sigma per prior sigma, that counts as zero; the start of a solve changes it by 1e-5
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
"""Parts of a session that depend on an attribute of a bench or of its optics; all parts depend on other attributes."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A cause in one of its variants."""

    cause: Cause
    variant: str


@dataclass(frozen=True, eq=False)
class Explanation:
    """Causes with values, in the order in which they turn the nominal bench into the corrected one.

    Attributes:
        hypotheses: the causes in their variants.
        values: one array of parameter values for each cause, in the parameters' units.
    """

    hypotheses: tuple[Hypothesis, ...] = ()
    values: tuple[FloatArray, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the causes."""
        return tuple(hypothesis.cause.name for hypothesis in self.hypotheses)

    def bench(self, nominal: Bench) -> Bench:
        """Return the corrected bench: the nominal one with the causes applied."""
        for hypothesis, values in zip(self.hypotheses, self.values, strict=True):
            nominal = hypothesis.cause.perturb(nominal, values, hypothesis.variant)
        return nominal

    def plus(self, hypothesis: Hypothesis, values: FloatArray | None = None) -> "Explanation":
        """Return the explanation with one more cause, by default at its null values."""
        added = hypothesis.cause.null() if values is None else values
        return Explanation((*self.hypotheses, hypothesis), (*self.values, added))

    def without(self, number: int) -> "Explanation":
        """Return the explanation without one of its causes."""
        kept = [i for i in range(len(self.hypotheses)) if i != number]
        return Explanation(tuple(self.hypotheses[i] for i in kept), tuple(self.values[i] for i in kept))

    def parameters(self) -> list[Parameter]:
        """Return all parameters, in order."""
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
        """Return all values as one vector."""
        return np.concatenate([np.zeros(0), *self.values])

    def at(self, vector: FloatArray) -> "Explanation":
        """Return the same causes with other values."""
        ends = np.cumsum([len(values) for values in self.values])
        return replace(self, values=tuple(np.split(vector, ends[:-1])) if self.values else ())


@dataclass(frozen=True, eq=False)
class State:
    """A bench and its readings.

    Attributes:
        bench: the bench.
        readings: its predicted readings.
        views: views of its dots, as start values for similar benches.
    """

    bench: Bench
    readings: Readings
    views: Views


@dataclass(frozen=True, eq=False)
class Linearisation:
    """Predicted readings linearised about one explanation.

    Attributes:
        explanation: the explanation.
        state: its bench and readings.
        residual: (n, 2) measured minus predicted, in units of sigma.
        jacobian: (n, 2, p) derivative of the predicted readings by the free parameters, in sigma per prior sigma.
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
    """Prediction of one set of observations by explanations of their nominal bench.

    A state near a known one is cheap: parts of the session that do not depend on the difference are not simulated
    again, and the other parts start from the known solution.
    """

    def __init__(self, observations: Observations) -> None:
        """Simulate the session with the nominal bench."""
        nominal, plan = observations.nominal, observations.session.plan
        views = Views.of(nominal, plan)
        self.observations, self._nominal = observations, State(nominal, simulate(nominal, plan, views), views)

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
        return Predictor(self.observations.with_sigma(sigma_px))

    def of_rows(self, keep: BoolArray) -> "Predictor":
        """Return the predictor of the readings in a mask (n,)."""
        return Predictor(self.observations.of_rows(keep))

    def residual(self, explanation: Explanation) -> FloatArray:
        """Return measured minus predicted (n, 2), in units of sigma."""
        return self.residual_of(self.state(explanation))

    def residual_of_bench(self, bench: Bench) -> FloatArray:
        """Return measured minus predicted (n, 2), in units of sigma, for any bench of the same headset."""
        return self.residual_of(self._simulated(bench, self._nominal))

    def residual_of(self, state: State) -> FloatArray:
        """Return measured minus predicted (n, 2), in units of sigma, for a state."""
        return self.observations.residual(state.readings)

    def state(self, explanation: Explanation, near: State | None = None) -> State:
        """Return an explanation's bench and its readings, starting from `near` or the nominal state.

        All readings are NaN if such a bench cannot exist, e.g. if a displaced panel is visible from nowhere.
        """
        near = near or self._nominal
        try:
            return self._simulated(explanation.bench(self.observations.nominal), near)
        except BadInputError:
            return replace(near, readings=_lost(near.readings))

    def linearised(self, explanation: Explanation, state: State | None = None) -> Linearisation:
        """Return residual and Jacobian at an explanation, by forward differences.

        Args:
            explanation: the explanation.
            state: its state, if known; that without its last cause will do while that cause has no effect.
        """
        base = state or self.state(explanation)
        residual, vector, columns, free = self.residual_of(base), explanation.vector(), [], []
        for number, parameter in enumerate(explanation.parameters()):
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

    def signature(self, hypothesis: Hypothesis, values: FloatArray | None = None) -> Linearisation:
        """Return the linearisation by the parameters of one cause alone, by default at its null values."""
        return self.linearised(Explanation().plus(hypothesis, values), self._nominal)

    def lever(self, change: Perturb, steps: FloatArray) -> FloatArray:
        """Return the derivative (n, 2, k) of the readings, in sigma, by each value (k,) of a change of the bench.

        Args:
            change: the change; zeros leave the bench unchanged.
            steps: (k,) steps of the forward differences, in the units of the values.
        """
        base = self._nominal
        residual, columns = self.residual_of(base), []
        for values in np.diag(steps):
            by_step = self._by_step(base, residual, change, values)
            columns.append(by_step / values.sum() if _acts(by_step) else np.zeros_like(residual))
        return np.stack(columns, axis=-1)

    def _by_step(self, base: State, residual: FloatArray, change: Perturb, values: FloatArray) -> FloatArray:
        """Return the change (n, 2) of the readings from a state to a changed nominal bench, in sigma.

        The change is zero for a reading that the step loses, and for a bench that cannot exist.
        """
        try:
            moved = self._simulated(change(self.observations.nominal, values), base)
        except BadInputError:
            return np.zeros_like(residual)
        return np.nan_to_num(residual - self.residual_of(moved))

    def _simulated(self, bench: Bench, near: State) -> State:
        """Return the state of a bench, starting from a known state."""
        todo = self._touched(bench, near)
        views = Views.of(bench, todo, near.views)
        return State(bench, _merged(simulate(bench, todo, views), near.readings), views)

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
    """Yield the attributes that differ between two benches, and between the optics of their eyes."""
    for kind, new, was in ((Bench, bench, old), (EyeOptics, bench.optics, old.optics)):
        names = (each.name for each in fields(kind) if each.name not in ("device", "eye"))  # compared by their optics
        yield from (name for name in names if getattr(new, name) is not getattr(was, name))


def _lost(readings: Readings) -> Readings:
    """Return the readings with every prediction NaN."""
    return Readings(*(None if part is None else np.full_like(part, np.nan) for part in readings.parts))


def _acts(by_step: FloatArray) -> bool:
    """Return whether a step of `_STEP` prior sigmas changes readings by more than the error of the solver."""
    return bool(np.max(np.abs(by_step), initial=0.0) > _NOTHING * _STEP)


def _merged(found: Readings, old: Readings) -> Readings:
    """Return the new readings, and the old ones for parts that were not simulated again."""
    return Readings(*(was if new is None else new for new, was in zip(found.parts, old.parts, strict=True)))

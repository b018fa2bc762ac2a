"""An extended bench: the nominal one with causes at work; its readings, and their change with the causes' values."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.session import Readings, SessionPlan
from wlr_render.diagnosis.cause import Cause, Parameter, Role
from wlr_render.diagnosis.observations import Observations
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.bench import Bench
from wlr_render.simulation.simulate_session import DotViews, simulate, simulate_to_first_order

_STEP = 2e-3  # of a parameter's plausible size, for the differences
_NOTHING = 1e-6  # sigma per plausible size: the rounding of predictions that do not change


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A cause acting in one of its ways."""

    cause: Cause
    variant: str

    def __str__(self) -> str:
        return f"{self.cause.name} ({self.variant})"


@dataclass(frozen=True, eq=False)
class Extension:
    """Causes at work, in order.

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
        """The extended bench."""
        for hypothesis, values in zip(self.hypotheses, self.values, strict=True):
            nominal = hypothesis.cause.perturb(nominal, values, hypothesis.variant)
        return nominal

    def plus(self, hypothesis: Hypothesis, values: FloatArray | None = None) -> "Extension":
        """With one more cause, at its null values unless others are given."""
        added = hypothesis.cause.null() if values is None else values
        return Extension((*self.hypotheses, hypothesis), (*self.values, added))

    def without(self, number: int) -> "Extension":
        """Without one of its causes."""
        kept = [i for i in range(len(self.hypotheses)) if i != number]
        return Extension(tuple(self.hypotheses[i] for i in kept), tuple(self.values[i] for i in kept))

    def parameters(self) -> list[Parameter]:
        """All parameters, in order."""
        return [parameter for hypothesis in self.hypotheses for parameter in hypothesis.cause.parameters]

    def vector(self) -> FloatArray:
        """All values one after the other."""
        return np.concatenate([np.zeros(0), *self.values])

    def at(self, vector: FloatArray) -> "Extension":
        """The same causes at other values."""
        ends = np.cumsum([len(values) for values in self.values])
        return replace(self, values=tuple(np.split(vector, ends[:-1])) if self.values else ())


@dataclass(frozen=True, eq=False)
class State:
    """A bench and its readings.

    Attributes:
        bench: the bench.
        readings: predicted.
        dot_views: of the targets' dots, for neighbouring benches to start from; None where there is no target.
    """

    bench: Bench
    readings: Readings
    dot_views: DotViews | None


@dataclass(frozen=True, eq=False)
class Linearisation:
    """Readings near one extension.

    Attributes:
        extension: where.
        state: its bench and readings.
        residual: (n, 2) measured minus predicted there, in units of sigma.
        jacobian: (n, 2, p) of the predicted readings by the free parameters, in units of sigma per plausible size.
        free: (p,) indices into the extension's parameters; moments and forms without a size are not free.
    """

    extension: Extension
    state: State
    residual: FloatArray
    jacobian: FloatArray
    free: NDArray[np.int64]


class Predictor:
    """Predicts the readings of one set of observations by extensions of its nominal bench.

    A state near another one costs little: the part of a session that their difference cannot touch is not done again,
    and the rest starts from the other's solution.
    """

    def __init__(self, observations: Observations) -> None:
        self.observations = observations
        nominal, plan = observations.nominal, observations.session.plan
        dot_views = None if plan.see_through is None else DotViews(nominal, plan.see_through)
        self._nominal = State(nominal, simulate(nominal, plan, dot_views), dot_views)

    def residual(self, extension: Extension) -> FloatArray:
        """Measured minus predicted, (n, 2), in units of sigma."""
        return self.residual_of(self.state(extension))

    def residual_of(self, state: State) -> FloatArray:
        """Likewise, of a state."""
        return self.observations.residual(state.readings)

    def state(self, extension: Extension, near: State | None = None) -> State:
        """An extension's bench and its readings, starting from the nominal or a nearer state."""
        near, bench = near or self._nominal, extension.bench(self.observations.nominal)
        todo = self._touched(bench, near)
        dot_views = near.dot_views
        if todo.see_through is not None:
            dot_views = DotViews(bench, todo.see_through, near.dot_views)
        return State(bench, _merged(simulate(bench, todo, dot_views), near.readings), dot_views)

    def linearised(self, extension: Extension, state: State | None = None) -> Linearisation:
        """Residual and Jacobian at an extension, whose state may be known, by forward differences."""
        return self._differences(extension, 0, state or self.state(extension))

    def added(self, current: State, extension: Extension) -> Linearisation:
        """Linearisation by the parameters of an extension's last cause only, at values where it has no effect yet.

        Args:
            current: of the extension without its last cause.
            extension: with it.
        """
        return self._differences(extension, len(extension.vector()) - len(extension.values[-1]), current)

    def _differences(self, extension: Extension, first: int, base: State) -> Linearisation:
        residual, nominal = self.residual_of(base), self.observations.nominal
        vector, columns, free = extension.vector(), [], []
        for number, parameter in list(enumerate(extension.parameters()))[first:]:
            if parameter.role is Role.MOMENT:
                continue
            moved = vector.copy()
            moved[number] += _STEP * parameter.plausible
            bench = extension.at(moved).bench(nominal)
            readings = _merged(
                simulate_to_first_order(bench, self._touched(bench, base), base.dot_views), base.readings
            )
            column = (residual - self.observations.residual(readings)) / _STEP
            if np.nanmax(np.abs(column), initial=0.0) > _NOTHING:
                columns.append(column)
                free.append(number)
        jacobian = np.stack(columns, axis=-1) if columns else np.zeros((*residual.shape, 0))
        return Linearisation(extension, base, residual, jacobian, np.array(free, dtype=np.int64))

    def _touched(self, bench: Bench, near: State) -> SessionPlan:
        """The parts of the session whose readings may differ between a bench and a state."""
        plan, old = self.observations.session.plan, near.bench
        common = all(getattr(bench, name) is getattr(old, name) for name in ("camera", "stage", "mount"))
        paths, was = bench.optics, old.optics
        same_display = common and bench.readout is old.readout and paths.panel is was.panel
        same_display = same_display and paths.display is was.display
        same_world = common and bench.target is old.target and bench.tracking is old.tracking
        same_world = same_world and paths.see_through is was.see_through
        same_run = paths is was and bench.eye_tracking is old.eye_tracking and bench.clock is old.clock
        return SessionPlan(
            None if same_display else plan.display,
            None if same_world else plan.see_through,
            None if same_run else plan.run_time,
        )


def _merged(found: Readings, old: Readings) -> Readings:
    """Readings that were found, and the old ones of the parts that were not done again."""
    return Readings(
        old.panel_pixel if found.panel_pixel is None else found.panel_pixel,
        old.dot_pixel if found.dot_pixel is None else found.dot_pixel,
        old.seen if found.seen is None else found.seen,
    )

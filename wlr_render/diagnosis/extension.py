"""An extended bench: the nominal one with causes at work; its readings, and their change with the causes' values."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.session import Readings
from wlr_render.diagnosis.cause import Cause, Parameter, Role
from wlr_render.diagnosis.observations import Observations
from wlr_render.simulation.bench import Bench
from wlr_render.simulation.simulate_session import simulate

FloatArray = NDArray[np.float64]

_STEP = 2e-3  # of a parameter's plausible size, for the differences


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
class Linearisation:
    """Readings near one extension.

    Attributes:
        extension: where.
        residual: (n, 2) measured minus predicted there, in units of sigma.
        jacobian: (n, 2, p) of the predicted readings by the free parameters, in units of sigma per plausible size.
        free: (p,) indices into the extension's parameters; moments and forms without a size are not free.
    """

    extension: Extension
    residual: FloatArray
    jacobian: FloatArray
    free: NDArray[np.int64]


class Predictor:
    """Predicts the readings of one set of observations by extensions of its nominal bench.

    It keeps the nominal prediction, and does again only the part of a session that a change can touch.
    """

    def __init__(self, observations: Observations) -> None:
        self.observations = observations
        self._start = observations.start
        readings = simulate(observations.nominal, observations.session.plan, self._start)
        self._nominal = State(observations.nominal, readings)

    def residual(self, extension: Extension) -> FloatArray:
        """Measured minus predicted, (n, 2), in units of sigma."""
        return self._residual(extension.bench(self.observations.nominal), self._nominal)

    def state(self, extension: Extension) -> "State":
        """An extension's bench and its readings."""
        bench = extension.bench(self.observations.nominal)
        return State(bench, self._predicted(bench, self._nominal))

    def linearised(self, extension: Extension) -> Linearisation:
        """Residual and Jacobian at an extension, by forward differences."""
        return self._differences(extension, 0, self.state(extension))

    def added(self, current: "State", extension: Extension) -> Linearisation:
        """Linearisation by the parameters of an extension's last cause only, at values where it has no effect yet.

        Args:
            current: of the extension without its last cause.
            extension: with it.
        """
        return self._differences(extension, len(extension.vector()) - len(extension.values[-1]), current)

    def _differences(self, extension: Extension, first: int, base: "State") -> Linearisation:
        residual = self.observations.residual(base.readings)
        vector, columns, free = extension.vector(), [], []
        for number, parameter in list(enumerate(extension.parameters()))[first:]:
            if parameter.role is Role.MOMENT:
                continue
            moved = vector.copy()
            moved[number] += _STEP * parameter.plausible
            column = (residual - self._residual(extension.at(moved).bench(self.observations.nominal), base)) / _STEP
            if np.nanmax(np.abs(column), initial=0.0) > 0.0:
                columns.append(column)
                free.append(number)
        jacobian = np.stack(columns, axis=-1) if columns else np.zeros((*residual.shape, 0))
        return Linearisation(extension, residual, jacobian, np.array(free, dtype=np.int64))

    def _residual(self, bench: Bench, near: "State") -> FloatArray:
        return self.observations.residual(self._predicted(bench, near))

    def _predicted(self, bench: Bench, near: "State") -> Readings:
        """Readings of a bench; those of `near` where the two benches share all that decides them."""
        plan, old = self.observations.session.plan, near.bench
        common = all(getattr(bench, name) is getattr(old, name) for name in ("camera", "stage", "mount"))
        paths, was = bench.optics, old.optics
        same_display = common and bench.readout is old.readout and paths.panel is was.panel
        same_display = same_display and paths.display is was.display
        same_world = common and bench.target is old.target and bench.tracking is old.tracking
        same_world = same_world and paths.see_through is was.see_through
        todo = replace(
            plan,
            display=None if same_display else plan.display,
            see_through=None if same_world else plan.see_through,
        )
        found = simulate(bench, todo, self._start)
        return Readings(
            near.readings.panel_pixel if same_display else found.panel_pixel,
            near.readings.dot_pixel if same_world else found.dot_pixel,
            found.seen,
        )


@dataclass(frozen=True, eq=False)
class State:
    """A bench and its readings."""

    bench: Bench
    readings: Readings

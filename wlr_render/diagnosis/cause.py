"""A cause: a named change of the bench model with parameters.

To add a cause, add an entry to the tuple in its subject's file in `causes/`; users can add their own
(`causes.user_causes`). Everything else (Jacobian, fit, ranking, report) follows from `perturb`.
"""

import difflib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

import numpy as np

from wlr_render.bench.bench import Bench
from wlr_render.errors import BadInputError
from wlr_render.geometry.transforms import rotations_of_vectors
from wlr_render.numerics.arrays import FloatArray

Perturb = Callable[[Bench, FloatArray], Bench]
"""(bench, values of all parameters in their units) -> bench; the null values give the same bench back."""


def turn(degrees: FloatArray) -> FloatArray:
    """Return the rotation (3, 3) of a rotation vector (3,) in degrees."""
    return rotations_of_vectors(np.deg2rad(degrees))


def changed(part: str, field: str, change: Callable[[Any, FloatArray], Any]) -> Perturb:
    """Return a `Perturb` of one field of a part: `change` maps the field's value and the parameters to a new value."""

    def perturb(bench: Bench, values: FloatArray) -> Bench:
        old = getattr(bench, part)
        new = replace(old, **{field: change(getattr(old, field), values)})
        return replace(bench, **{part: new})

    return perturb


class Role(Enum):
    """Role of a parameter in a cause."""

    SIZE = "size"  # size of the effect: at 0, its null value, the cause has no effect
    SHAPE = "shape"  # shape of an effect of nonzero size; fitted from each of its starts
    TIME = "time"  # time between two captures; found by a search


@dataclass(frozen=True)
class Parameter:
    """One number of a cause.

    Attributes:
        name: name within the cause.
        unit: unit of its values.
        prior_sigma: standard deviation of the values met in practice, in that unit.
        role: role in the cause.
        starts: start values of a SHAPE parameter; the first one is its null value and its expected value.
        minimum: smallest physical value.
        prior_mean: expected value of a SIZE parameter; 0 still means no effect.
        in_bench: total value of the quantity in a bench, in the unit, where a bench file may already state a part of
            it; `minimum` then applies to this total. None where the parameter is the total.
    """

    name: str
    unit: str
    prior_sigma: float
    role: Role = Role.SIZE
    starts: tuple[float, ...] = (0.0,)
    minimum: float = -np.inf
    prior_mean: float = 0.0
    in_bench: Callable[[Bench], float] | None = None


_STATIONS = {
    "device": "combiner",
    "camera": "camera",
    "stage": "stage",
    "target": "target",
    "tracking": "target",
    "mount": "time",
    "eye tracking": "eye tracking",
    "clock": "panel",
}
"""Default station of the causes of a part."""

PARTS = tuple(_STATIONS)
"""Parts of the bench that causes act on."""


@dataclass(frozen=True)
class Cause:
    """A physical cause of a difference between measurement and simulation.

    Attributes:
        name: key in reports.
        title: physical name.
        part: part of the bench on which it acts, one of `PARTS`.
        parameters: its parameters.
        source: source of the prior sigmas.
        separated_by: the extra measurement that separates it from degenerate causes.
        variants: ways in which it may act, by name; the first is the usual one.
        remedy: its remedy; empty if the usual remedy of its part is enough.
        whole_steps: step of its values, in the parameters' unit: only multiples are possible. None for any value.
        own_station: station at which it acts, if not that of its part.
    """

    name: str
    title: str
    part: str
    parameters: tuple[Parameter, ...]
    source: str
    separated_by: str
    variants: Mapping[str, Perturb]
    remedy: str = ""
    whole_steps: float | None = None
    own_station: str = ""

    @property
    def station(self) -> str:
        """Station at which the cause acts; the fields of that station are its rivals."""
        return self.own_station or _STATIONS[self.part]

    @property
    def is_shaped(self) -> bool:
        """True if some value changes the shape of the effect, not only its size."""
        return any(parameter.role is not Role.SIZE for parameter in self.parameters)

    def perturb(self, bench: Bench, values: FloatArray, variant: str | None = None) -> Bench:
        """Return the bench with this cause applied; `values` (parameters,) are in their units."""
        return self.variants[variant or next(iter(self.variants))](bench, values)

    def null(self) -> FloatArray:
        """Return the values (parameters,) that leave the bench unchanged."""
        return np.array([parameter.starts[0] for parameter in self.parameters])


def with_priors(
    causes: Mapping[str, Cause], priors: Mapping[str, Mapping[str, tuple[float, float]]]
) -> dict[str, Cause]:
    """Return the causes with stated priors for some of their parameters.

    Args:
        causes: causes by name.
        priors: (mean, sigma) by name of the cause and of the parameter, in the parameter's unit. The mean of a SHAPE
            parameter replaces its starts.

    Raises:
        BadInputError: an unknown cause or parameter, a prior for a time, or a mean below the parameter's minimum.
    """
    changed = dict(causes)
    for name, stated in priors.items():
        if name not in causes:
            raise BadInputError(
                f"[prior.{name}]: {unknown_cause(name, causes)} Load a cause of your own with --add-causes FILE.py."
            )
        cause, known = causes[name], [parameter.name for parameter in causes[name].parameters]
        for unknown in stated.keys() - set(known):
            raise BadInputError(f"[prior.{name}]: there is no parameter '{unknown}'; choose from {', '.join(known)}.")
        parameters = (_with_prior(name, each, stated.get(each.name)) for each in cause.parameters)
        changed[name] = replace(cause, parameters=tuple(parameters))
    return changed


def _with_prior(name: str, parameter: Parameter, prior: tuple[float, float] | None) -> Parameter:
    if prior is None:
        return parameter
    mean, sigma = prior
    if parameter.role is Role.TIME:
        raise BadInputError(f"[prior.{name}]: '{parameter.name}' is searched for between captures; leave it out.")
    if parameter.in_bench is None and mean < parameter.minimum:
        raise BadInputError(
            f"[prior.{name}]: the mean of '{parameter.name}' is {mean:g}; the least is {parameter.minimum:g}."
        )
    if parameter.role is Role.SHAPE:
        return replace(parameter, prior_sigma=sigma, starts=(mean,))
    return replace(parameter, prior_sigma=sigma, prior_mean=mean)


def unknown_cause(name: str, causes: Mapping[str, Cause]) -> str:
    """Return the message for an unknown cause name; it suggests close names, or lists all names if none is close."""
    near = difflib.get_close_matches(name, causes, 3)
    return f"There is no cause '{name}'; " + (
        f"did you mean {' or '.join(near)}?" if near else f"choose from {', '.join(causes)}."
    )

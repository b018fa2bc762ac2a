"""A cause: a named change of the bench model with parameters.

A new cause is an entry in the tuple of its subject's file in `causes/`. Everything else (Jacobian, fit, ranking,
report) follows from `perturb`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

import numpy as np

from wlr_render.geometry.transforms import rotations_of_vectors
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.bench import Bench

Perturb = Callable[[Bench, FloatArray], Bench]
"""(bench, values of all parameters in their units) -> bench; the null values give the same bench back."""


def turn(degrees: FloatArray) -> FloatArray:
    """Rotation (3, 3) by angles (3,) in degrees about x, y and z, a rotation vector."""
    return rotations_of_vectors(np.deg2rad(degrees))


def changed(part: str, field: str, change: Callable[[Any, FloatArray], Any]) -> Perturb:
    """A change of one field of one part of the bench: `change` maps its value and the parameters to the new value."""

    def perturb(bench: Bench, values: FloatArray) -> Bench:
        old = getattr(bench, part)
        new = replace(old, **{field: change(getattr(old, field), values)})
        return replace(bench, **{part: new})

    return perturb


class Role(Enum):
    """What a parameter does."""

    SIZE = "size"  # null value 0: without it there is no effect
    SHAPE = "shape"  # shapes an effect whose size is not 0, and is fitted from each of its starts
    TIME = "time"  # a time between two captures, searched for


@dataclass(frozen=True)
class Parameter:
    """One number of a cause.

    Attributes:
        name: within the cause.
        unit: of its values.
        prior_sigma: standard deviation of what is met in practice, in that unit.
        role: see `Role`.
        starts: first values of a SHAPE parameter; the first one is its null value.
        minimum: values below are not physical.
    """

    name: str
    unit: str
    prior_sigma: float
    role: Role = Role.SIZE
    starts: tuple[float, ...] = (0.0,)
    minimum: float = -np.inf


@dataclass(frozen=True)
class Cause:
    """A physical cause of a difference between measurement and simulation.

    Attributes:
        name: the key in reports.
        title: physical name.
        part: of the bench: "device", "camera", "stage", "target", "tracking", "mount", "eye tracking" or "clock".
        parameters: its numbers.
        source: where the prior sigmas come from.
        separated_by: the extra measurement that separates it from degenerate causes.
        variants: ways in which it may act, by name; the first is the usual one.
        remedy: what to do about it, where that is more than for any cause of its part; empty otherwise.
        whole_steps: its values are multiples of this in the parameters' unit, or it is something else; None for any.
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

    def perturb(self, bench: Bench, values: FloatArray, variant: str | None = None) -> Bench:
        """The bench with this cause at work; `values` (parameters,) in their units."""
        return self.variants[variant or next(iter(self.variants))](bench, values)

    def null(self) -> FloatArray:
        """Values (parameters,) that leave the bench unchanged."""
        return np.array([parameter.starts[0] for parameter in self.parameters])

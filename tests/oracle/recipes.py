"""How an effect is described: what its sizes are drawn from and what they do to a bench."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from oracle.own_tracer import FloatArray, turn
from oracle.world import World

Amount = Mapping[str, float]
"""Size of an effect, by keys that end in their unit."""


@dataclass(frozen=True)
class Draw:
    """From what one quantity is drawn.

    Attributes:
        keys: its components; keys end in their unit.
        low: smallest typical size.
        high: largest typical size.
        kind: "signed": length log-uniform, direction random; "positive": log-uniform; "setting": uniform, no size at
            all, so that an effect's strength does not touch it.
    """

    keys: tuple[str, ...]
    low: float
    high: float
    kind: Literal["signed", "positive", "setting"] = "signed"

    def values(self, rng: np.random.Generator, strength: float) -> dict[str, float]:
        """One draw; `strength` multiplies sizes."""
        if self.kind == "setting":
            return {key: float(rng.uniform(self.low, self.high)) for key in self.keys}
        length = strength * np.exp(rng.uniform(np.log(self.low), np.log(self.high)))
        direction = rng.normal(size=len(self.keys)) if self.kind == "signed" else np.ones(len(self.keys))
        return dict(zip(self.keys, (length * direction / np.linalg.norm(direction)).tolist(), strict=True))


@dataclass(frozen=True)
class Recipe:
    """An effect before its size is known.

    Attributes:
        description: one line; it fixes the signs.
        draws: its quantities.
        apply: puts the effect into a bench.
    """

    description: str
    draws: tuple[Draw, ...]
    apply: Callable[[World, Amount], World]


def xyz(unit: str) -> tuple[str, str, str]:
    """Keys of three components."""
    return (f"x_{unit}", f"y_{unit}", f"z_{unit}")


def vector(amount: Amount, keys: Sequence[str]) -> FloatArray:
    """Components as an array, (k,)."""
    return np.array([amount[key] for key in keys])


def rotation(amount: Amount) -> FloatArray:
    """Rotation matrix of the rotation vector x_deg, y_deg, z_deg."""
    return turn(np.radians(vector(amount, xyz("deg"))))

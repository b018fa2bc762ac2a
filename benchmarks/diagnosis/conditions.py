"""Conditions of ordinary benches under which a diagnosis is judged."""

from collections.abc import Callable
from enum import StrEnum

import numpy as np
from oracle.nature import BenchNature

_REPEATABILITY_MM = (0.005, 0.03)
_TURNS_RAD = (1e-5, 6e-5)
_NOISE_FACTORS = (0.9, 1.1)


class Condition(StrEnum):
    """Departures of a bench from white noise of the stated size."""

    WHITE = "white"
    REPEATABILITY = "repeatability"
    SIGMA_MISSTATED = "sigma_misstated"
    RIM = "rim"
    NOISY_CAPTURES = "noisy_captures"
    SHARED = "shared"
    ALL = "all_of_them"


def nature_of(condition: Condition, rng: np.random.Generator) -> BenchNature:
    """Return a bench in this condition; sizes that vary from bench to bench are drawn."""
    drawn = {name: draw(rng) for name, draw in _DRAWS.items()}
    chosen = drawn.values() if condition is Condition.ALL else [drawn.get(condition, {})]
    return BenchNature(**{key: value for sizes in chosen for key, value in sizes.items()})


def _positions(rng: np.random.Generator) -> dict[str, float]:
    mm, rad = (float(np.exp(rng.uniform(*np.log(limits)))) for limits in (_REPEATABILITY_MM, _TURNS_RAD))
    return {"repeatability_mm": mm, "turns_rad": rad}


_DRAWS: dict[Condition, Callable[[np.random.Generator], dict[str, float]]] = {
    Condition.REPEATABILITY: _positions,
    Condition.SIGMA_MISSTATED: lambda rng: {"noise_factor": float(rng.choice(_NOISE_FACTORS))},
    Condition.RIM: lambda rng: {"rim_factor": 2.0},
    Condition.NOISY_CAPTURES: lambda rng: {"noisy_share": 1.0 / 3.0, "noisy_factor": 2.5},
    Condition.SHARED: lambda rng: {"shared": 0.5},
}

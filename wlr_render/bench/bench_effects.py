"""Effects at the stations of a bench that no key of its parts states: smooth displacements that a diagnosis locates.

An effect is a polynomial of the station's coordinates. Coordinates and displacements are in the units of the bench
file; `displacement` converts them from and to metres and radians.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np

from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.polynomial import Polynomial
from wlr_render.optics.combiner_form import SURFACES, SmoothSag, surfaces_raised
from wlr_render.optics.device import EyeOptics

_ROUNDS = 6  # of the fixed-point iterations: effects change little from one coordinate to the next

_UM, _URAD, _MM = 1e-6, 1e-6, 1e-3
_POSE = (_UM, _UM, _UM, _URAD, _URAD, _URAD)


@dataclass(frozen=True)
class EffectKind:
    """What an effect displaces at a station.

    Attributes:
        coordinates: their names, with the unit of the file.
        per_coordinate: metres, seconds or pixels in that unit.
        displacement: names of its components, with the unit of the file.
        per_displacement: metres, radians or pixels in that unit, of each component.
    """

    coordinates: str
    per_coordinate: tuple[float, ...]
    displacement: str
    per_displacement: tuple[float, ...]


KINDS = {
    ("panel", "shift"): EffectKind("panel pixel u, v", (1.0, 1.0), "decoded position u, v, panel px", (1.0, 1.0)),
    ("camera", "shift"): EffectKind("camera pixel u, v", (1.0, 1.0), "image u, v, camera px", (1.0, 1.0)),
    ("target", "shift"): EffectKind(
        "place on the target x, y, in pitches", (1.0, 1.0), "dot x, y, z in the target's axes, mm", (_MM, _MM, _MM)
    ),
    ("stage", "pose"): EffectKind(
        "stage reading x, y, z, mm", (_MM, _MM, _MM), "camera's shift x, y, z, um, and turn x, y, z, urad", _POSE
    ),
    ("time", "pose"): EffectKind("time, s", (1.0,), "camera's shift x, y, z, um, and turn x, y, z, urad", _POSE),
    ("time", "shift"): EffectKind("time, s", (1.0,), "decoded position u, v, panel px", (1.0, 1.0)),
    **{
        ("combiner", surfaces): EffectKind(
            "place right of and above the line of sight straight ahead, mm",
            (_MM, _MM),
            "height away from the eye, um",
            (_UM,),
        )
        for surfaces in SURFACES
    },
}
"""Kinds by station and by what is displaced."""


@dataclass(frozen=True, eq=False)
class BenchEffect:
    """A smooth displacement at a station.

    Attributes:
        station, displaces: the kind, a key of `KINDS`.
        polynomial: displacement by the station's coordinates, in the units of the file; OpenXR axes.
        target_pose: pose of the target that it is for; -1 for all.
    """

    station: str
    displaces: str
    polynomial: Polynomial
    target_pose: int = -1


def displacement(
    effects: Sequence[BenchEffect],
    station: str,
    displaces: str,
    coordinates: FloatArray,
    target_pose: IntArray | None = None,
) -> FloatArray | None:
    """Return the sum of the effects of one kind, (n, components) in metres, radians or pixels; None without any.

    Args:
        effects: of the bench.
        station, displaces: the kind.
        coordinates: (n, v) in metres, seconds or pixels.
        target_pose: (n,) of each row, where the station is the target.
    """
    own = [each for each in effects if (each.station, each.displaces) == (station, displaces)]
    if not own:
        return None
    kind = KINDS[station, displaces]
    total = np.zeros((len(coordinates), len(kind.per_displacement)))
    for effect in own:
        value = effect.polynomial(coordinates / np.array(kind.per_coordinate))
        if effect.target_pose >= 0 and target_pose is not None:
            value = np.where((target_pose == effect.target_pose)[:, None], value, 0.0)
        total += value
    return np.asarray(total * kind.per_displacement)


@lru_cache(maxsize=16)
def optics_with_effects(optics: EyeOptics, effects: tuple[BenchEffect, ...]) -> EyeOptics:
    """Return an eye's optics with the heights that effects add to its combiner."""
    for effect in effects:
        if effect.station == "combiner":
            error = partial(SmoothSag, effect.polynomial)
            optics = surfaces_raised(optics, SURFACES[effect.displaces](optics), error)
    return optics


def before_shift(after: FloatArray, shift: Callable[[FloatArray], FloatArray | None]) -> FloatArray:
    """Return the places (n, k) from which a shift, a function of the place, leads to places `after`."""
    place = after
    for _ in range(_ROUNDS):
        moved = shift(place)
        if moved is None:
            return after
        place = after - moved
    return place

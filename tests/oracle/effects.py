"""The effects that can be hidden, by name, and how one is drawn."""

from dataclasses import dataclass, replace

import numpy as np

from oracle.bench_effects import BENCH_EFFECTS, adding_place, adding_turn
from oracle.captures import DISPLAY, Captures, Plan, display_captures, see_through_captures
from oracle.device_effects import DEVICE_EFFECTS
from oracle.form_effects import FORM_EFFECTS
from oracle.own_tracer import FloatArray, turn
from oracle.recipes import Amount, Draw, Recipe, vector, xyz
from oracle.run_time_effects import RUN_TIME_EFFECTS
from oracle.unlisted_effects import STATIONS, UNLISTED_EFFECTS
from oracle.unlisted_run_time_effects import STATIONS_AT_RUN_TIME, UNLISTED_AT_RUN_TIME_EFFECTS
from oracle.world import World
from wlr_render.errors import BadInputError

LISTED = tuple({**DEVICE_EFFECTS, **FORM_EFFECTS, **BENCH_EFFECTS})
"""Names that a diagnosis of a bench session is expected to find."""

LISTED_AT_RUN_TIME = tuple(RUN_TIME_EFFECTS)
"""Names that a diagnosis of a run-time session is expected to find."""

UNLISTED = tuple(UNLISTED_EFFECTS)
"""Names of effects of a bench session that no list of causes holds."""

UNLISTED_AT_RUN_TIME = tuple(UNLISTED_AT_RUN_TIME_EFFECTS)
"""Names of effects of a run-time session that no list of causes holds."""

STATION_OF = {**STATIONS, **STATIONS_AT_RUN_TIME}
"""Station of each unlisted effect."""

OUTLIER = "outlier"
"""Name of the effect that is one capture that moved."""


def _same_capture(captures: Captures, amount: Amount) -> FloatArray:
    return np.asarray((captures.target_pose == amount["target_pose"]) & (captures.number == amount["capture"]))


def _outlier(world: World, amount: Amount) -> World:
    shift, angles = vector(amount, xyz("mm")), np.radians(vector(amount, xyz("deg")))
    moved = adding_place(world, lambda position, c: position + np.outer(_same_capture(c, amount), shift))
    return adding_turn(moved, lambda c: turn(np.outer(_same_capture(c, amount), angles)))


_OUTLIER_DRAWS = (Draw(xyz("mm"), 0.3, 1.0), Draw(xyz("deg"), 0.1, 0.3))
_RECIPES = {
    **DEVICE_EFFECTS,
    **FORM_EFFECTS,
    **BENCH_EFFECTS,
    **RUN_TIME_EFFECTS,
    **UNLISTED_EFFECTS,
    **UNLISTED_AT_RUN_TIME_EFFECTS,
    OUTLIER: Recipe("the camera moved in one capture and was turned", _OUTLIER_DRAWS, _outlier),
}


@dataclass(frozen=True)
class Effect:
    """An effect and its size.

    Attributes:
        name: one of `LISTED`, `LISTED_AT_RUN_TIME`, `UNLISTED`, `UNLISTED_AT_RUN_TIME`, or `OUTLIER`.
        amount: by keys that end in their unit; the description fixes the signs.
    """

    name: str
    amount: Amount

    @property
    def description(self) -> str:
        """What the effect is, in one line."""
        return _recipe(self.name).description

    def applied(self, world: World) -> World:
        """The bench with this effect in it; effects compose in the order in which they are applied."""
        return _recipe(self.name).apply(world, self.amount)

    def scaled(self, factor: float) -> "Effect":
        """The same effect, its sizes multiplied; settings (a time constant, a place) stay."""
        sizes = {key for draw in _recipe(self.name).draws if draw.kind != "setting" for key in draw.keys}
        return replace(self, amount={k: v * factor if k in sizes else v for k, v in self.amount.items()})


def draw_effect(name: str, rng: np.random.Generator, strength: float = 1.0) -> Effect:
    """An effect of random size, sign and direction; `strength` multiplies its typical sizes.

    Raises:
        BadInputError: the name is not listed above.
    """
    if name == OUTLIER:
        raise BadInputError("An outlier belongs to a plan: draw it with draw_outlier.")
    return Effect(name, _amount(name, rng, strength))


def draw_outlier(plan: Plan, rng: np.random.Generator, strength: float = 1.0) -> Effect:
    """One capture of the plan that moved; `amount` names it by `target_pose` (-1: of the display) and `capture`."""
    captures = (display_captures(plan, np.zeros(3), rng), see_through_captures(plan, np.zeros(3)))
    names = [(int(pose), int(n)) for c in captures for pose, n in zip(c.target_pose, c.number, strict=True)]
    pose, number = names[rng.integers(len(names))]
    return Effect(OUTLIER, {"target_pose": pose, "capture": number, **_amount(OUTLIER, rng, strength)})


def draw_outliers(plan: Plan, rng: np.random.Generator, count: int, strength: float = 1.0) -> tuple[Effect, ...]:
    """So many captures of the display that moved, each by itself; as `draw_outlier` otherwise.

    Raises:
        BadInputError: the plan has not so many.
    """
    numbers = display_captures(plan, np.zeros(3), np.random.default_rng(0)).number
    if count > len(numbers):
        raise BadInputError(f"Of {len(numbers)} captures {count} cannot have moved.")
    return tuple(
        Effect(OUTLIER, {"target_pose": DISPLAY, "capture": int(number), **_amount(OUTLIER, rng, strength)})
        for number in np.sort(rng.permutation(numbers)[:count])
    )


def draw_late_slip(plan: Plan, rng: np.random.Generator, last: int, of_session: bool, strength: float = 1.0) -> Effect:
    """A headset that slips before the last captures.

    Args:
        plan: of the session.
        rng: draws the size, and the moment between two captures.
        last: captures after the slip.
        of_session: counts these from the end of the session; else from the end of the display's captures, so that the
            whole see-through part is measured after the slip.
        strength: multiplies the size.
    """
    captures = see_through_captures(plan, np.zeros(3)) if of_session else display_captures(plan, np.zeros(3), rng)
    time_s = np.sort(captures.time_s)
    start_s = float(rng.uniform(time_s[-last - 1], time_s[-last]))
    return Effect("headset_slip", {**_amount("headset_slip", rng, strength), "start_s": start_s})


def _amount(name: str, rng: np.random.Generator, strength: float) -> dict[str, float]:
    return {key: value for draw in _recipe(name).draws for key, value in draw.values(rng, strength).items()}


def _recipe(name: str) -> Recipe:
    if name not in _RECIPES:
        raise BadInputError(
            f"There is no effect '{name}' to hide; choose {', '.join(name for name in _RECIPES if name != OUTLIER)}."
        )
    return _RECIPES[name]

"""Effects in the shape of the headset's parts: a bowed panel, an astigmatic and a dented combiner."""

from dataclasses import replace

import numpy as np

from oracle.own_tracer import Bump, FloatArray
from oracle.recipes import Amount, Draw, Recipe
from oracle.world import World

_COMBINER_REACH_MM = 20.0


def _panel_bow(world: World, amount: Amount) -> World:
    device = world.device
    half = 0.5 * device.panel.size_mm
    panel = replace(device.panel, bow_per_mm=2.0 * amount["corner_mm"] / float(half @ half))
    return replace(world, device=replace(device, panel=panel))


def with_bump(world: World, bump: Bump) -> World:
    """The bench with a bump added to every surface of its combiner."""
    device = world.device.with_surfaces(lambda surface: replace(surface, bumps=(*surface.bumps, bump)))
    return replace(world, device=device)


def _combiner_form(world: World, amount: Amount) -> World:
    pivot, strength = world.device.pivot, amount["sag_mm"] / _COMBINER_REACH_MM**2

    def bump(point: FloatArray) -> tuple[FloatArray, FloatArray]:
        x, y, _ = (point - pivot).T
        return strength * (x**2 - y**2), 2.0 * strength * np.stack([x, -y, np.zeros_like(x)], axis=-1)

    return with_bump(world, bump)


def _combiner_dent(world: World, amount: Amount) -> World:
    centre = world.device.pivot + np.array([amount["x_mm"], amount["y_mm"], 0.0])

    def bump(point: FloatArray) -> tuple[FloatArray, FloatArray]:
        across = (point - centre) * [1.0, 1.0, 0.0] / amount["width_mm"]
        raised = amount["depth_mm"] * np.exp(-0.5 * np.sum(across**2, axis=-1))
        return raised, -raised[:, None] * across / amount["width_mm"]

    return with_bump(world, bump)


FORM_EFFECTS = {
    "panel_bow": Recipe(
        "the panel is a bowl, raised along its normal at the corners", (Draw(("corner_mm",), 0.2, 1.0),), _panel_bow
    ),
    "combiner_form": Recipe(
        "all surfaces are raised by x^2 - y^2 about the pivot, by so much at 20 mm",
        (Draw(("sag_mm",), 0.005, 0.02),),
        _combiner_form,
    ),
    "combiner_dent": Recipe(
        "a Gaussian dent in all surfaces, off the pivot",
        (
            Draw(("depth_mm",), 0.003, 0.02),
            Draw(("x_mm", "y_mm"), -8.0, 8.0, "setting"),
            Draw(("width_mm",), 3.0, 6.0, "setting"),
        ),
        _combiner_dent,
    ),
}

"""Effects in the headset: combiner, panel, substrate, and what is put before it."""

from dataclasses import replace

import numpy as np

from oracle.devices import Panel
from oracle.own_tracer import FloatArray, Surface, dot, turn
from oracle.recipes import Amount, Draw, Recipe, rotation, vector, xyz
from oracle.world import World

_PLATE_INDEX = 1.49
_XY_MM = ("x_mm", "y_mm")


def _combiner_tilt(world: World, amount: Amount) -> World:
    turned, pivot = rotation(amount), world.device.pivot

    def tilted(surface: Surface) -> Surface:
        return replace(surface, axes=turned @ surface.axes, origin=pivot + turned @ (surface.origin - pivot))

    return replace(world, device=world.device.with_surfaces(tilted))


def _combiner_shift(world: World, amount: Amount) -> World:
    shift = vector(amount, xyz("mm"))
    return replace(world, device=world.device.with_surfaces(lambda s: replace(s, origin=s.origin + shift)))


def _frame_bend(world: World, amount: Amount) -> World:
    """The optics of the right eye turn about the middle between the eyes; y of the oracle points down."""
    turned = turn(np.radians([amount["twist_deg"], -amount["toe_in_deg"], 0.0]))
    pivot, panel = world.device.eye * [0.0, 1.0, 1.0], world.device.panel

    def moved(place: FloatArray) -> FloatArray:
        return np.asarray(pivot + turned @ (place - pivot))

    bent = world.device.with_surfaces(lambda s: replace(s, axes=turned @ s.axes, origin=moved(s.origin)))
    whole = replace(panel, axes=turned @ panel.axes, centre=moved(panel.centre))
    return replace(world, device=replace(bent, panel=whole))


def _with_panel(world: World, panel: Panel) -> World:
    return replace(world, device=replace(world.device, panel=panel))


def _panel_shift(world: World, amount: Amount) -> World:
    panel = world.device.panel
    return _with_panel(world, replace(panel, centre=panel.centre + panel.axes[:, :2] @ vector(amount, _XY_MM)))


def _panel_axial_shift(world: World, amount: Amount) -> World:
    panel = world.device.panel
    return _with_panel(world, replace(panel, centre=panel.centre + panel.axes[:, 2] * amount["shift_mm"]))


def _panel_rotation(world: World, amount: Amount) -> World:
    panel = world.device.panel
    return _with_panel(world, replace(panel, axes=panel.axes @ turn(np.radians([0.0, 0.0, amount["angle_deg"]]))))


def _panel_scale(world: World, amount: Amount) -> World:
    panel = world.device.panel
    return _with_panel(world, replace(panel, size_mm=panel.size_mm * (1.0 + amount["scale_percent"] / 100.0)))


def _substrate_index(world: World, amount: Amount) -> World:
    return replace(world, device=replace(world.device, index_shift=amount["index"]))


def _substrate_thickness(world: World, amount: Amount) -> World:
    device = world.device
    outer = device.surfaces[device.outer]
    thicker = replace(outer, shape=outer.shape.pushed_out(amount["thickness_mm"]))
    return replace(world, device=replace(device, surfaces={**device.surfaces, device.outer: thicker}))


def _see_through_plate(world: World, amount: Amount) -> World:
    normal = turn(np.radians([amount["tilt_x_deg"], amount["tilt_y_deg"], 0.0]))[:, 2]

    def beyond(origin: FloatArray, direction: FloatArray) -> FloatArray:
        cosine = dot(direction, np.broadcast_to(normal, direction.shape))[:, None]
        tangential = direction - cosine * normal
        inside = np.sqrt(_PLATE_INDEX**2 - 1.0 + cosine**2)
        return np.asarray(origin + amount["thickness_mm"] * tangential * (1.0 / inside - 1.0 / cosine))

    return replace(world, beyond=(*world.beyond, beyond))


def _thermal_drift(world: World, amount: Amount) -> World:
    panel = world.device.panel
    creep_px = vector(amount, _XY_MM) / panel.size_mm * panel.pixels

    def decode(pixel: FloatArray, time_s: FloatArray, channel: FloatArray) -> FloatArray:
        return pixel - creep_px * -np.expm1(-time_s / amount["tau_s"])[:, None]

    return replace(world, decode=(*world.decode, decode))


def _lateral_colour(world: World, amount: Amount) -> World:
    middle = 0.5 * world.device.panel.pixels

    def decode(pixel: FloatArray, time_s: FloatArray, channel: FloatArray) -> FloatArray:
        return pixel + (pixel - middle) * ((1.0 - channel) * amount["scale_percent"] / 100.0)[:, None]

    return replace(world, decode=(*world.decode, decode))


def _pixel_origin(world: World, amount: Amount) -> World:
    def decode(pixel: FloatArray, time_s: FloatArray, channel: FloatArray) -> FloatArray:
        return pixel + amount["offset_px"]

    return replace(world, decode=(*world.decode, decode))


DEVICE_EFFECTS = {
    "combiner_tilt": Recipe(
        "all surfaces turn by a rotation vector about where the central line of sight meets the first",
        (Draw(xyz("deg"), 0.05, 1.0),),
        _combiner_tilt,
    ),
    "combiner_shift": Recipe("all surfaces move", (Draw(xyz("mm"), 0.05, 1.0),), _combiner_shift),
    "frame_bend": Recipe(
        "optics and panel turn as a whole about the middle between the eyes: to the nose, and up",
        (Draw(("toe_in_deg", "twist_deg"), 0.05, 0.3),),
        _frame_bend,
    ),
    "panel_shift": Recipe("the panel moves along its u and v axes", (Draw(_XY_MM, 0.05, 0.5),), _panel_shift),
    "panel_axial_shift": Recipe(
        "the panel moves along u x v, its normal", (Draw(("shift_mm",), 0.05, 0.5),), _panel_axial_shift
    ),
    "panel_rotation": Recipe(
        "the panel turns about u x v, u towards v", (Draw(("angle_deg",), 0.05, 1.0),), _panel_rotation
    ),
    "panel_scale": Recipe(
        "the panel is larger than stated, about its middle", (Draw(("scale_percent",), 0.05, 0.5),), _panel_scale
    ),
    "substrate_index": Recipe(
        "the index of all glass is higher, at every wavelength", (Draw(("index",), 0.002, 0.02),), _substrate_index
    ),
    "substrate_thickness": Recipe(
        "the outer face lies farther out", (Draw(("thickness_mm",), 0.02, 0.2),), _substrate_thickness
    ),
    "see_through_plate": Recipe(
        "a plane plate of index 1.49 stands outside the optics, across z but for its tilt",
        (Draw(("thickness_mm",), 0.5, 5.0, "positive"), Draw(("tilt_x_deg", "tilt_y_deg"), -5.0, 5.0, "setting")),
        _see_through_plate,
    ),
    "thermal_drift": Recipe(
        "the panel creeps along u and v by an amplitude times 1 - exp(-t / tau)",
        (Draw(_XY_MM, 0.02, 0.1), Draw(("tau_s",), 600.0, 1500.0, "setting")),
        _thermal_drift,
    ),
    "lateral_colour": Recipe(
        "red pixels lie farther from the panel's middle, blue ones as much nearer",
        (Draw(("scale_percent",), 0.05, 0.3),),
        _lateral_colour,
    ),
    "pixel_origin": Recipe(
        "decoded pixels are half a pixel too large in u and v, or too small",
        (Draw(("offset_px",), 0.5, 0.5),),
        _pixel_origin,
    ),
}

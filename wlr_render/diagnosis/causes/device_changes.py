"""Changes of one eye of a headset that several causes share. Device frame, metres, radians unless said."""

from dataclasses import replace
from typing import Literal

import numpy as np

from wlr_render.geometry.transforms import rigid, rotation_about, rotations_of_vectors
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device import (
    ClearAperture,
    EyeOptics,
    Interaction,
    Path,
    PlacedPanel,
    PlacedSurface,
    Step,
)
from wlr_render.optics.media import AIR, FORMULAS, Medium
from wlr_render.optics.surfaces import Conic, Offset
from wlr_render.optics.tracer import trace
from wlr_render.simulation.bench import Bench

_PLATE_AHEAD = 0.15  # metres before the eye: beyond all optics; where else a plane plate stands does not matter
_PLATE_APART = 0.05  # metres from one added plate to the next
_PLATE_HALF_SIZE = 0.2  # metres
_FORWARD = np.array([0.0, 0.0, -1.0])


def with_optics(bench: Bench, optics: EyeOptics) -> Bench:
    """The bench with other optics before its eye."""
    device = replace(bench.device, eyes={**bench.device.eyes, bench.eye: optics})
    return replace(bench, device=device)


def combiner_middle(bench: Bench) -> FloatArray:
    """Where the line of sight from the middle of the eye box meets the first surface, else its origin; (3,)."""
    optics = bench.optics
    if not optics.display.steps:
        return optics.eye_box.centre
    seen = trace(Path(optics.display.steps[:1]), optics.eye_box.centre, _FORWARD, bench.target_wavelength_um)
    origin = optics.display.steps[0].surface.device_from_surface[:3, 3]
    return np.where(np.isfinite(seen.origin), seen.origin, origin)


def combiner_turned(bench: Bench, turn_deg: FloatArray, pivot: FloatArray) -> Bench:
    """All surfaces turned together about `pivot` by angles (3,) in degrees about x, y and z."""
    turn = rotations_of_vectors(np.deg2rad(turn_deg))
    return _surfaces_moved(bench, rigid(turn, pivot - turn @ pivot))


def combiner_shifted(bench: Bench, shift: FloatArray) -> Bench:
    """All surfaces displaced together."""
    return _surfaces_moved(bench, rigid(np.eye(3), shift))


def _surfaces_moved(bench: Bench, moved_from_device: FloatArray) -> Bench:
    def moved(surface: PlacedSurface) -> PlacedSurface:
        return replace(surface, device_from_surface=moved_from_device @ surface.device_from_surface)

    return with_optics(bench, bench.optics.with_surfaces(moved))


def panel_moved(bench: Bench, shift: FloatArray | None = None, turn: FloatArray | None = None) -> Bench:
    """The panel displaced by `shift` (3,) and turned about its centre by `turn` (3,), both along its own axes."""
    move = rigid(np.eye(3) if turn is None else rotations_of_vectors(turn), np.zeros(3) if shift is None else shift)
    panel = bench.optics.panel
    return _with_panel(bench, replace(panel, device_from_panel=panel.device_from_panel @ move))


def panel_scaled(bench: Bench, factor: float) -> Bench:
    """The lit area larger by `factor`."""
    return _with_panel(bench, replace(bench.optics.panel, size=bench.optics.panel.size * factor))


def _with_panel(bench: Bench, panel: PlacedPanel) -> Bench:
    return with_optics(bench, replace(bench.optics, panel=panel))


def index_shifted(bench: Bench, delta: float) -> Bench:
    """All media but air with their index larger by `delta`."""
    return with_optics(bench, bench.optics.with_media(lambda medium: medium.shifted(delta)))


def combiner_thickened(bench: Bench, by: float, face: Literal["inner", "outer"], along_axis: bool = False) -> Bench:
    """The first or last surface that the world is seen through moved so that what lies between is thicker.

    It moves along its normals, or as a whole along the axis of its own frame, as the halves of a mould do.
    """
    steps = bench.optics.see_through.steps
    if len(steps) < 2:
        return bench
    chosen = steps[0 if face == "inner" else -1].surface
    offset = _outward(bench, chosen, along_axis) * (-by if face == "inner" else by)

    def thickened(surface: PlacedSurface) -> PlacedSurface:
        if surface.name != chosen.name or offset == 0.0:
            return surface
        if along_axis:
            along = rigid(np.eye(3), np.array([0.0, 0.0, offset]))
            return replace(surface, device_from_surface=surface.device_from_surface @ along)
        shape = surface.shape
        if isinstance(shape, Offset):
            return replace(surface, shape=replace(shape, distance=shape.distance + offset))
        return replace(surface, shape=Offset(shape, offset))

    return with_optics(bench, bench.optics.with_surfaces(thickened))


def _outward(bench: Bench, surface: PlacedSurface, along_axis: bool) -> float:
    """+1 if the surface's normal, or its axis, leads into the world where the eye looks through it, else -1."""
    middle = combiner_middle(bench)
    pose = surface.surface_from_device
    local = (pose[:3, :3] @ middle + pose[:3, 3])[:, None]
    normal = surface.shape.normal(local)[:, 0]
    ahead = surface.device_from_surface[:3, :3] @ normal @ _FORWARD
    return float(np.sign(ahead * normal[2] if along_axis else ahead)) or 1.0


def plate_added(
    bench: Bench, thickness: float, tilt_deg: FloatArray | None = None, wedge_deg: FloatArray | None = None
) -> Bench:
    """A plate of PMMA between the optics and the world, both its faces tilted about x and y, or the far one only.

    A negative thickness stands for the opposite offset of rays, so that a fit may pass through zero.
    """
    if thickness == 0.0:
        return bench
    pmma = Medium("added_plate", FORMULAS["pmma_sultanova_2009"])
    index = pmma.index(bench.target_wavelength_um)
    medium = pmma if thickness > 0.0 else Medium.constant("added_plate", 1.0 / (2.0 - 1.0 / index))
    near = _tilt(np.zeros(2) if tilt_deg is None else tilt_deg)
    far = near @ _tilt(np.zeros(2) if wedge_deg is None else wedge_deg)
    standing = sum(surface.name.startswith("added_plate") for surface in bench.optics.surfaces()) // 2
    centre = bench.optics.eye_box.centre + (_PLATE_AHEAD + standing * _PLATE_APART) * _FORWARD
    reach = _PLATE_HALF_SIZE * np.array([1.0, 1.0, np.inf])
    aperture = ClearAperture(-reach, reach)
    steps = []
    number = len(bench.optics.surfaces())  # no name may be there twice
    for side, turn, along, into in (("near", near, 0.0, medium), ("far", far, abs(thickness), AIR)):
        face = PlacedSurface(
            f"added_plate_{number}_{side}", Conic(0.0), rigid(turn, centre + along * near @ _FORWARD), aperture
        )
        steps.append(Step(face, Interaction.REFRACT, into))
    path = Path(bench.optics.see_through.steps + tuple(steps))
    return with_optics(bench, replace(bench.optics, see_through=path))


def _tilt(tilt_deg: FloatArray) -> FloatArray:
    return rotation_about("x", np.deg2rad(tilt_deg[0])) @ rotation_about("y", np.deg2rad(tilt_deg[1]))

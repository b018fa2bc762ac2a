"""Losses of rays along the display path, surface by surface, and single changes that would let them arrive."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from wlr_render.mappings import Status, StatusArray
from wlr_render.numerics.arrays import BoolArray, FloatArray
from wlr_render.optics.device import EyeOptics, Interaction, Path, PlacedSurface, Step
from wlr_render.optics.media import GREEN_UM
from wlr_render.optics.sag_surfaces import AnamorphicAsphere, SumOfProfiles, Toroid
from wlr_render.optics.surfaces import Conic, Shape
from wlr_render.optics.traced_mappings import TracedDisplay
from wlr_render.optics.tracer import Trace, trace

_COLUMNS, _ROWS = 25, 21
_CONE_TANGENT = 0.4  # tangent of the cone of test rays if no nominal field is stated
_TURNED = np.diag([1.0, 1.0, -1.0, 1.0])
_MANY = 0.5  # smallest share of rays on the panel for an accepted change
_BETTER = 2.0  # smallest factor by which an accepted change increases the rays on the panel
_TILTED = 1e-6  # smallest component of a tilted mirror's normal across the line of sight
_AS_GOOD = 0.9  # smallest share of the best change's rays for an equally good change


@dataclass(frozen=True)
class SurfaceLosses:
    """Fate of the rays that reach a surface, or the panel.

    Attributes:
        name: name of the surface.
        interaction: interaction in the device file; "panel" for the panel.
        reached: number of rays that were not lost before.
        passed: number of rays that go on, or that end on the panel.
        reasons: number of lost rays by reason, worded to follow "rays".
    """

    name: str
    interaction: str
    reached: int
    passed: int
    reasons: dict[str, int]

    @property
    def lost(self) -> int:
        """Number of rays that end here without having reached the panel."""
        return self.reached - self.passed

    def sentence(self) -> str:
        """Return the reasons for losses here, as a part of a sentence."""
        return ", ".join(f"{count} {reason}" for reason, count in self.reasons.items() if count)


def judged_directions(optics: EyeOptics) -> FloatArray:
    """Return the directions (n, 3) over the nominal field, or within 22 degrees of straight ahead if none is stated."""
    if optics.field is not None:
        return np.asarray(optics.field.directions(_COLUMNS, _ROWS)).reshape(-1, 3)
    side = np.linspace(-_CONE_TANGENT, _CONE_TANGENT, _COLUMNS)
    tangents = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    direction = np.concatenate([tangents, np.full((len(tangents), 1), -1.0)], axis=-1)
    return np.asarray(direction / np.linalg.norm(direction, axis=-1, keepdims=True))


def display_losses(optics: EyeOptics, wavelength_um: float) -> tuple[SurfaceLosses, ...]:
    """Follow rays from the nominal viewpoint along the display path; return an entry for each step, and the panel's."""
    start, view_dir = optics.eye_box.centre, judged_directions(optics)
    alive = np.ones(len(view_dir), dtype=bool)
    entries = []
    steps = optics.display.steps
    traced = trace(Path(), start, view_dir, wavelength_um)
    for count, step in enumerate(steps):
        arriving, traced = traced, trace(Path(steps[: count + 1]), start, view_dir, wavelength_um)
        passed = alive & (traced.status == Status.OK)
        # A total reflection that fails counts as clipped; as a plain mirror, only the aperture clips.
        mirror = replace(step, interaction=Interaction.REFLECT)
        mirrored = trace(Path((*steps[:count], mirror)), start, view_dir, wavelength_um)
        reasons = _reasons(mirror, arriving, traced.status, mirrored.status, alive & ~passed)
        name, kind = step.surface.name, str(step.interaction)
        entries.append(SurfaceLosses(name, kind, int(alive.sum()), int(passed.sum()), reasons))
        alive = passed
    pixel = optics.panel.pixel_of_ray(traced.origin, traced.direction)
    ahead = np.isfinite(pixel).all(axis=-1)
    behind = np.isfinite(optics.panel.pixel_of_ray(traced.origin, -traced.direction)).all(axis=-1)
    met = alive & on_panel(optics, pixel)
    reasons = {
        "miss its plane": int((alive & ~ahead & ~behind).sum()),
        "run away from it, for it lies behind them": int((alive & ~ahead & behind).sum()),
        "pass beside its lit area": int((alive & ahead & ~met).sum()),
    }
    entries.append(SurfaceLosses("panel", "panel", int(alive.sum()), int(met.sum()), reasons))
    return tuple(entries)


def on_panel(optics: EyeOptics, pixel: FloatArray) -> BoolArray:
    """Return which pixels (..., 2) lie on the panel's lit area; False for NaN."""
    return np.asarray(np.all((pixel >= 0.0) & (pixel <= optics.panel.pixels.size_px), axis=-1))


def _reasons(
    mirror: Step, arriving: Trace, status: StatusArray, as_mirror: StatusArray, lost: BoolArray
) -> dict[str, int]:
    """Count lost rays at a step by reason; `as_mirror` is the rays' status with a plain mirror in its place."""
    back = trace(Path((mirror,)), arriving.origin, -arriving.direction, GREEN_UM)
    missed, clipped = lost & (status == Status.MISS), lost & (status == Status.CLIPPED)
    is_behind, is_outside = back.status != Status.MISS, as_mirror == Status.CLIPPED
    return {
        "miss it": int((missed & ~is_behind).sum()),
        "run away from it, for it lies behind them": int((missed & is_behind).sum()),
        "fall outside its aperture": int((clipped & is_outside).sum()),
        "leave through it below the critical angle": int((clipped & ~is_outside).sum()),
        "are totally reflected": int((lost & (status == Status.TOTAL_REFLECTION)).sum()),
        "do not settle on it": int((lost & (status == Status.NOT_CONVERGED)).sum()),
    }


def reach_panel(optics: EyeOptics, wavelength_um: float) -> int:
    """Return the number of judged rays that end on the panel."""
    display = TracedDisplay(optics, wavelength_um)
    pixel, status = display.plane_pixel(judged_directions(optics), optics.eye_box.centre)
    return int(np.sum((status == Status.OK) & on_panel(optics, pixel)))


def turned_round(surface: PlacedSurface) -> PlacedSurface:
    """Return the surface with reversed curvature: as if the sign of its radius and of all terms were changed."""
    aperture = surface.aperture
    low, high = aperture.low.copy(), aperture.high.copy()
    low[2], high[2] = -aperture.high[2], -aperture.low[2]
    return replace(
        surface,
        device_from_surface=surface.device_from_surface @ _TURNED,
        aperture=replace(aperture, low=low, high=high),
    )


@dataclass(frozen=True, eq=False)
class TriedChange:
    """An eye with one likely mistake in its description corrected.

    Attributes:
        condition: the change, as the beginning of a sentence: "With ...".
        check: advice on the device file if the change helps.
        optics: the changed eye.
    """

    condition: str
    check: str
    optics: EyeOptics


def curvature_changes(optics: EyeOptics) -> Iterator[TriedChange]:
    """Yield the eye with each curved surface of the display path reversed, and with each of two radii reversed."""
    for surface in _surfaces_of_display(optics):
        if surface.shape == Conic(0.0):
            continue
        yield TriedChange(
            f"With '{surface.name}' bent to the other side",
            "check the sign of its radius_mm, or of all its terms",
            _with_surface(optics, turned_round(surface)),
        )
        for axis, shape in _one_radius_reversed(surface.shape):
            yield TriedChange(
                f"With radius_{axis}_mm of '{surface.name}' of the other sign",
                f"check the sign of radius_{axis}_mm",
                _with_surface(optics, replace(surface, shape=shape)),
            )


def path_changes(optics: EyeOptics) -> Iterator[TriedChange]:
    """Yield the eye with each pair of adjacent display steps exchanged, and each plane mirror turned the other way."""
    steps = optics.display.steps
    for place, (first, second) in enumerate(pairwise(steps)):
        if first.surface.name != second.surface.name:
            exchanged = Path((*steps[:place], second, first, *steps[place + 2 :]))
            condition = f"With '{second.surface.name}' before '{first.surface.name}'"
            yield TriedChange(condition, "check the order of display_path", replace(optics, display=exchanged))
    mirrors = {step.surface.name for step in steps if step.interaction is not Interaction.REFRACT}
    for surface in _surfaces_of_display(optics):
        if surface.name not in mirrors or surface.shape != Conic(0.0):
            continue
        for axis in range(2):
            pose = surface.device_from_surface.copy()
            if abs(pose[axis, 2]) < _TILTED:
                continue
            pose[axis, :3] *= -1.0  # the mirror image of the surface in a plane through its own origin
            yield TriedChange(
                f"With '{surface.name}' turned the other way",
                "check the sign of its rotate_x_deg, or of its z_axis, and on which side the panel stands",
                _with_surface(optics, replace(surface, device_from_surface=pose)),
            )


def _surfaces_of_display(optics: EyeOptics) -> list[PlacedSurface]:
    """Return the surfaces of the display path, each once."""
    return list({step.surface.name: step.surface for step in optics.display.steps}.values())


def _with_surface(optics: EyeOptics, changed: PlacedSurface) -> EyeOptics:
    return optics.with_surfaces(lambda each: changed if each.name == changed.name else each)


def _one_radius_reversed(shape: Shape) -> Iterator[tuple[str, Shape]]:
    """Yield each axis of a shape of two radii, and the shape with that radius reversed."""
    if isinstance(shape, Toroid):
        yield "x", replace(shape, radius_x=-shape.radius_x)
        yield "y", replace(shape, radius_y=-shape.radius_y)
    elif isinstance(shape, AnamorphicAsphere | SumOfProfiles):
        x, y = shape.curvature
        if x:
            yield "x", replace(shape, curvature=(-x, y))
        if y:
            yield "y", replace(shape, curvature=(x, -y))


def helpful_changes(optics: EyeOptics, wavelength_um: float) -> list[tuple[TriedChange, int]]:
    """Return the changes with which most rays would reach the panel, each with its number of rays, best first."""
    total, now = len(judged_directions(optics)), reach_panel(optics, wavelength_um)
    changes = [*curvature_changes(optics), *path_changes(optics)]
    counted = [(change, reach_panel(change.optics, wavelength_um)) for change in changes]
    enough = max(_MANY * total, _BETTER * now, _AS_GOOD * max((count for _, count in counted), default=0), 1)
    return sorted((each for each in counted if each[1] >= enough), key=lambda each: -each[1])

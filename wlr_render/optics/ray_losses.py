"""Where the rays of the display path are lost, surface by surface, and whether a surface bends them the wrong way."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from wlr_render.mappings import Status
from wlr_render.numerics.arrays import BoolArray, FloatArray
from wlr_render.optics.device import EyeOptics, Interaction, Path, PlacedSurface, Step
from wlr_render.optics.surfaces import Conic
from wlr_render.optics.tracer import Trace, trace

_COLUMNS, _ROWS = 25, 21
_CONE_TANGENT = 0.4  # of the rays that are tried where no nominal field is stated
_TURNED = np.diag([1.0, 1.0, -1.0, 1.0])
_MANY = 0.5  # of the rays; fewer are called lost
_BETTER = 2.0  # times as many rays, and most of them, say that a surface is the wrong way round


@dataclass(frozen=True)
class SurfaceLosses:
    """What becomes of the rays that reach a surface, or the panel.

    Attributes:
        name: of the surface.
        interaction: as the device file has it; "panel" for the panel.
        reached: rays that were not lost before.
        passed: rays that go on, or that end on the panel.
        reasons: how many are lost, by reason, in words that follow "rays".
    """

    name: str
    interaction: str
    reached: int
    passed: int
    reasons: dict[str, int]

    @property
    def lost(self) -> int:
        """Rays that end here without having reached the panel."""
        return self.reached - self.passed

    def sentence(self) -> str:
        """Why rays are lost here, as a part of a sentence."""
        return ", ".join(f"{count} {reason}" for reason, count in self.reasons.items() if count)


def judged_directions(optics: EyeOptics) -> FloatArray:
    """Directions (n, 3) over the nominal field, or within 22 degrees of straight ahead if none is stated."""
    if optics.field is not None:
        return np.asarray(optics.field.directions(_COLUMNS, _ROWS)).reshape(-1, 3)
    side = np.linspace(-_CONE_TANGENT, _CONE_TANGENT, _COLUMNS)
    tangents = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    direction = np.concatenate([tangents, np.full((len(tangents), 1), -1.0)], axis=-1)
    return np.asarray(direction / np.linalg.norm(direction, axis=-1, keepdims=True))


def display_losses(optics: EyeOptics, wavelength_um: float) -> tuple[SurfaceLosses, ...]:
    """Follow rays from the nominal viewpoint along the display path: one entry for each step, and the panel's."""
    start, view_dir = optics.eye_box.centre, judged_directions(optics)
    alive = np.ones(len(view_dir), dtype=bool)
    entries = []
    steps = optics.display.steps
    for count, step in enumerate(steps, 1):
        traced = trace(Path(steps[:count]), start, view_dir, wavelength_um)
        passed = alive & (traced.status == Status.OK)
        reasons = _reasons(Path(steps[:count]), start, view_dir, wavelength_um, alive & ~passed)
        name, kind = step.surface.name, str(step.interaction)
        entries.append(SurfaceLosses(name, kind, int(alive.sum()), int(passed.sum()), reasons))
        alive = passed
    traced = trace(optics.display, start, view_dir, wavelength_um)
    pixel = optics.panel.pixel_of_ray(traced.origin, traced.direction)
    ahead = np.isfinite(pixel).all(axis=-1)
    on_panel = alive & _on_panel(optics, pixel)
    reasons = {
        "miss its plane, or run away from it": int((alive & ~ahead).sum()),
        "pass beside its lit area": int((alive & ahead & ~on_panel).sum()),
    }
    entries.append(SurfaceLosses("panel", "panel", int(alive.sum()), int(on_panel.sum()), reasons))
    return tuple(entries)


def _on_panel(optics: EyeOptics, pixel: FloatArray) -> BoolArray:
    return np.asarray(np.all((pixel >= 0.0) & (pixel <= optics.panel.pixels.size_px), axis=-1))


def _reasons(
    path: Path, start: FloatArray, view_dir: FloatArray, wavelength_um: float, lost: BoolArray
) -> dict[str, int]:
    """Why rays are lost at the last step of a path."""
    *before, last = path.steps
    status = trace(path, start, view_dir, wavelength_um).status
    # A total reflection that fails counts as clipped; as a plain mirror, only the aperture clips.
    mirrored = Path((*before, replace(last, interaction=Interaction.REFLECT)))
    outside = trace(mirrored, start, view_dir, wavelength_um).status == Status.CLIPPED
    missed = lost & (status == Status.MISS)
    behind = _lies_behind(last, trace(Path(tuple(before)), start, view_dir, wavelength_um))
    return {
        "miss it": int((missed & ~behind).sum()),
        "run away from it, for it lies behind them": int((missed & behind).sum()),
        "fall outside its aperture": int((lost & (status == Status.CLIPPED) & outside).sum()),
        "leave through it below the critical angle": int((lost & (status == Status.CLIPPED) & ~outside).sum()),
        "are totally reflected": int((lost & (status == Status.TOTAL_REFLECTION)).sum()),
        "do not settle on it": int((lost & (status == Status.NOT_CONVERGED)).sum()),
    }


def _lies_behind(step: Step, arriving: Trace) -> BoolArray:
    """Which rays would meet a surface if they ran backwards, (n,)."""
    back = trace(Path((replace(step, interaction=Interaction.REFLECT),)), arriving.origin, -arriving.direction, 0.55)
    return np.asarray(back.status != Status.MISS)


def reach_panel(optics: EyeOptics, wavelength_um: float) -> int:
    """How many of the judged rays end on the panel."""
    traced = trace(optics.display, optics.eye_box.centre, judged_directions(optics), wavelength_um)
    pixel = optics.panel.pixel_of_ray(traced.origin, traced.direction)
    return int(np.sum((traced.status == Status.OK) & _on_panel(optics, pixel)))


def turned_round(surface: PlacedSurface) -> PlacedSurface:
    """The surface bent to the other side: as if the sign of its radius and of all terms were changed."""
    aperture = surface.aperture
    low, high = aperture.low.copy(), aperture.high.copy()
    low[2], high[2] = -aperture.high[2], -aperture.low[2]
    return replace(
        surface,
        device_from_surface=surface.device_from_surface @ _TURNED,
        aperture=replace(aperture, low=low, high=high),
    )


def each_turned_round(optics: EyeOptics) -> Iterator[tuple[str, EyeOptics]]:
    """For each curved surface of the display path, its name and the eye with it bent to the other side."""
    for surface in {step.surface.name: step.surface for step in optics.display.steps}.values():
        if surface.shape == Conic(0.0):
            continue

        def change(each: PlacedSurface, name: str = surface.name) -> PlacedSurface:
            return turned_round(each) if each.name == name else each

        yield surface.name, optics.with_surfaces(change)


def better_turned_round(optics: EyeOptics, wavelength_um: float) -> list[tuple[str, int]]:
    """Surfaces with which most rays would reach the panel if they were bent to the other side, and how many."""
    total, now = len(judged_directions(optics)), reach_panel(optics, wavelength_um)
    counts = [(name, reach_panel(changed, wavelength_um)) for name, changed in each_turned_round(optics)]
    return [(name, count) for name, count in counts if count >= max(_MANY * total, _BETTER * now, 1)]

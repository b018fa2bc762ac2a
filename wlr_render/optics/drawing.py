"""Draw one eye of a device: side view and top view, with surfaces, panel, eye box and rays."""

import itertools
from dataclasses import dataclass
from pathlib import Path as FilePath
from typing import TYPE_CHECKING

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.files import write_figure
from wlr_render.mappings import Status
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device import Device, EyeOptics, Interaction, Path, PlacedSurface, Step
from wlr_render.optics.media import AIR
from wlr_render.optics.traced_mappings import TracedDisplay
from wlr_render.optics.tracer import trace

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_WAVELENGTH_UM = 0.55
_RAYS = 5  # of each kind and view
_BEYOND = 1.3  # see-through rays are drawn to so many times the distance of what lies farthest
_FAN = np.deg2rad(np.arange(-180.0, 180.0, 0.1))
_EDGES = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]])
_SURFACE_COLOURS = ("tab:purple", "tab:brown", "tab:olive", "tab:pink", "tab:cyan", "tab:gray")


@dataclass(frozen=True)
class DrawingView:
    """A projection along one device axis: -z to the right, and `up` (1: y, 0: x) upwards."""

    title: str
    up: int
    label: str

    def in_mm(self, point: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Forward and upward coordinates in millimetres, (...) each, of points (..., 3) in metres."""
        return -1e3 * point[..., 2], 1e3 * point[..., self.up]

    def directions(self, angle: FloatArray) -> FloatArray:
        """Unit directions in the plane of the view, measured from straight ahead, (n, 3)."""
        result = np.zeros((len(angle), 3))
        result[:, self.up], result[:, 2] = np.sin(angle), -np.cos(angle)
        return result


VIEWS = (
    DrawingView("from the side", 1, "up, y (mm)"),
    DrawingView("from above", 0, "right, x (mm)"),
)


def draw_device(device: Device, eye: str, path: str | FilePath) -> None:
    """Write a drawing of one eye as a picture of the format that the path's suffix names (.png, .pdf, .svg).

    Surfaces are cut by the plane of the view through the nominal viewpoint, as far as their clear apertures go; the
    panel, the eye box and the rays, which start in that plane, are projected onto it.

    Raises:
        BadInputError: the device has no such eye, or the path cannot be written.
    """
    from matplotlib.figure import Figure

    if eye not in device.eyes:
        raise BadInputError(f"Device '{device.name}' has no {eye} eye; choose {' or '.join(device.eyes)}.")
    optics = device.eyes[eye]
    figure = Figure(figsize=(12, 6.5), layout="constrained")
    figure.suptitle(f"{device.name}, {eye} eye")
    for axes, view in zip(figure.subplots(1, 2), VIEWS, strict=True):
        _draw_view(axes, optics, view)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=5, frameon=False)
    write_figure(path, figure, 150)


def _draw_view(axes: "Axes", optics: EyeOptics, view: DrawingView) -> None:
    axes.set_title(view.title)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("forward, -z (mm)")
    axes.set_ylabel(view.label)
    axes.grid(alpha=0.25)
    _draw_rays(axes, optics, view)
    along, up = view.in_mm(optics.panel.point_of_pixel(_EDGES * optics.panel.pixels.size_px))
    axes.fill(along, up, facecolor="0.85", edgecolor="k", alpha=0.8, lw=2, zorder=1, label="panel")
    _draw_eye_box(axes, optics, view)
    low, high = axes.dataLim.get_points().copy()
    for surface, colour in zip(optics.surfaces(), itertools.cycle(_SURFACE_COLOURS), strict=False):
        cut = cut_surface(surface, optics.eye_box.centre, view)
        # A surface without an aperture has no end; the drawing shows it as far as the panel and the rays reach, twice.
        line = np.stack(view.in_mm(cut), axis=-1)
        line[np.any(np.abs(line - (low + high) / 2) > high - low, axis=-1)] = np.nan
        axes.plot(*line.T, lw=2.5, color=colour, label=surface.name.replace("_", " "))
    if view.up == 0:
        axes.invert_yaxis()  # seen from above and looking to the right, the right-hand side is below


def _draw_eye_box(axes: "Axes", optics: EyeOptics, view: DrawingView) -> None:
    unit = np.zeros((len(_EDGES), 3))
    unit[:, [2, view.up]] = 2.0 * _EDGES - 1.0
    axes.plot(*view.in_mm(optics.eye_box.at(unit)), color="tab:green", ls="--", label="eye box")
    axes.plot(*view.in_mm(optics.eye_box.centre), "o", ms=4, color="tab:green", label="nominal viewpoint")


def cut_surface(surface: PlacedSurface, centre: FloatArray, view: DrawingView) -> FloatArray:
    """Points of a surface in the plane of the view through `centre`, (n, 3); NaN separates pieces.

    They are found by a fan of straight rays, whatever the shape.
    """
    alone = Path((Step(surface, Interaction.REFLECT, AIR),))
    met = trace(alone, centre, view.directions(_FAN), _WAVELENGTH_UM)
    return np.where((met.status == Status.OK)[:, None], met.origin, np.nan)


def _draw_rays(axes: "Axes", optics: EyeOptics, view: DrawingView) -> None:
    """Rays to the panel, evenly over the angles at which it is seen in this plane, and the world's rays there."""
    centre = optics.eye_box.centre
    ahead = _FAN[np.abs(_FAN) < 0.5 * np.pi]
    mapping = TracedDisplay(optics, _WAVELENGTH_UM)
    seen = mapping.pixel_of_view_dir(view.directions(ahead), centre)
    if not seen.ok.any():
        return
    angle = np.linspace(ahead[seen.ok].min(), ahead[seen.ok].max(), _RAYS)
    view_dir = view.directions(angle)
    panel_end = optics.panel.point_of_pixel(mapping.pixel_of_view_dir(view_dir, centre).value)
    world = trace(optics.see_through, centre, view_dir, _WAVELENGTH_UM)
    gone = np.linalg.norm(world.origin - centre, axis=-1)
    reach = _BEYOND * max(gone.max(), np.linalg.norm(panel_end - centre, axis=-1).max())
    world_end = world.origin + (reach - gone)[:, None] * world.direction
    _draw_lines(axes, view, [centre, world.points, world_end], "tab:orange", "see-through rays")
    display = trace(optics.display, centre, view_dir, _WAVELENGTH_UM)
    _draw_lines(axes, view, [centre, display.points, panel_end], "tab:blue", "display rays")


def _draw_lines(axes: "Axes", view: DrawingView, parts: list[FloatArray], colour: str, label: str) -> None:
    """One line per ray through its start (3,), the points between (n, steps, 3) and its end (n, 3)."""
    start, between, end = parts
    line = np.concatenate([np.broadcast_to(start, (len(end), 1, 3)), between, end[:, None]], axis=1)
    along, up = view.in_mm(line)
    lines = axes.plot(along.T, up.T, lw=0.9, color=colour, label=label)
    for extra in lines[1:]:
        extra.set_label(None)

"""Draw one eye of a device: side view and top view, with surfaces, panel, eye box and rays."""

import itertools
from dataclasses import dataclass
from pathlib import Path as FilePath
from typing import TYPE_CHECKING

import numpy as np

from wlr_render.io.atomic_files import write_figure
from wlr_render.mappings import Status
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device import Device, EyeOptics, Interaction, Path, PlacedSurface, Step
from wlr_render.optics.media import AIR, GREEN_UM
from wlr_render.optics.ray_losses import judged_directions
from wlr_render.optics.traced_mappings import TracedDisplay
from wlr_render.optics.tracer import trace

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

_RAYS = 5  # number of rays of each kind and view
_BEYOND = 1.3  # length of see-through rays over the distance of the farthest part
_CUT_TO = 1.2  # extent of drawn surfaces over the distance of the farthest part
_LOST_ANGLE = np.deg2rad(15.0)  # half angle of the fan of rays drawn if none reaches the panel
_LOST_LENGTH = 0.3  # length of a lost ray beyond the last surface that it meets, over the size of the device
_ARROW = 0.6  # length of the arrows along u and v over the length of the panel's edge
_END_ON = 0.05  # shortest drawn arrow over the length of the panel's longer edge
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
        """Return the forward and upward coordinates in millimetres, (...) each, of points (..., 3) in metres."""
        return -1e3 * point[..., 2], 1e3 * point[..., self.up]

    def directions(self, angle: FloatArray) -> FloatArray:
        """Return the unit directions in the plane of the view, measured from straight ahead, (n, 3)."""
        result = np.zeros((len(angle), 3))
        result[:, self.up], result[:, 2] = np.sin(angle), -np.cos(angle)
        return result


VIEWS = (
    DrawingView("from the side", 1, "up, y (mm)"),
    DrawingView("from above", 0, "right, x (mm)"),
)


def draw_device(device: Device, eye: str, path: str | FilePath) -> None:
    """Write a drawing of one eye as a picture of the format that the path's suffix names (.png, .pdf, .svg).

    Surfaces are cut by the plane of the view through the nominal viewpoint, up to their clear apertures; the panel, the
    eye box and the rays, which start in that plane, are projected onto it. Arrows on the panel show the directions of u
    and v.

    Raises:
        BadInputError: the device has no such eye, or the path cannot be written.
    """
    from matplotlib.figure import Figure

    optics = device.optics(eye)
    figure = Figure(figsize=(12, 6.5), layout="constrained")
    figure.suptitle(f"{device.name}, {eye} eye")
    for axes, view in zip(figure.subplots(1, 2), VIEWS, strict=True):
        _draw_view(axes, optics, view)
    handles: dict[str, Artist] = {}
    for axes in figure.axes:  # the legend includes parts that only one view shows
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=5, frameon=False)
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
    _draw_panel_axes(axes, optics, view)
    _draw_eye_box(axes, optics, view)
    centre = optics.eye_box.centre
    for surface, colour in zip(optics.surfaces(), itertools.cycle(_SURFACE_COLOURS), strict=False):
        cut = cut_surface(surface, centre, view)
        # A surface without an aperture is unlimited; the drawing shows the region near the other parts.
        cut[np.linalg.norm(cut - centre, axis=-1) > _CUT_TO * _size(optics)] = np.nan
        axes.plot(*view.in_mm(cut), lw=2.5, color=colour, label=surface.name.replace("_", " "))
    if view.up == 0:
        axes.invert_yaxis()  # top view: with the eye looking to the right, the wearer's right is below


def _draw_panel_axes(axes: "Axes", optics: EyeOptics, view: DrawingView) -> None:
    """Draw arrows along u and v from the panel's first pixel, unless they are seen end on."""
    ends = optics.panel.point_of_pixel(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]) * optics.panel.pixels.size_px)
    along, up = view.in_mm(ends)
    longest = 1e3 * float(optics.panel.size.max())
    for name, end in (("u", 1), ("v", 2)):
        run, rise = along[end] - along[0], up[end] - up[0]
        if np.hypot(run, rise) < _END_ON * longest:
            continue
        tip = along[0] + _ARROW * run, up[0] + _ARROW * rise
        arrow = {"arrowstyle": "-|>", "color": "tab:red", "lw": 1.5, "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", tip, (along[0], up[0]), arrowprops=arrow, zorder=6)
        axes.annotate(name, tip, (4, 4), textcoords="offset points", color="tab:red", weight="bold", zorder=6)


def _draw_eye_box(axes: "Axes", optics: EyeOptics, view: DrawingView) -> None:
    unit = np.zeros((len(_EDGES), 3))
    unit[:, [2, view.up]] = 2.0 * _EDGES - 1.0
    axes.plot(*view.in_mm(optics.eye_box.at(unit)), color="tab:green", ls="--", label="eye box")
    axes.plot(*view.in_mm(optics.eye_box.centre), "o", ms=4, color="tab:green", label="nominal viewpoint")


def cut_surface(surface: PlacedSurface, centre: FloatArray, view: DrawingView) -> FloatArray:
    """Return the points of a surface in the plane of the view through `centre`, (n, 3); NaN separates pieces.

    A fan of straight rays finds them for any shape.
    """
    alone = Path((Step(surface, Interaction.REFLECT, AIR),))
    met = trace(alone, centre, view.directions(_FAN), GREEN_UM)
    return np.where((met.status == Status.OK)[:, None], met.origin, np.nan)


def _size(optics: EyeOptics) -> float:
    """Return the distance in metres from the eye to the farthest panel corner or surface on the way.

    The position of a surface is its origin or the point where the ray to the middle of the field meets it, whichever is
    nearer: the vertex of a conic may be far from its used part.
    """
    centre = optics.eye_box.centre
    corners = optics.panel.point_of_pixel(_EDGES * optics.panel.pixels.size_px)
    size = float(np.linalg.norm(corners - centre, axis=-1).max())
    directions = judged_directions(optics)
    for path in (optics.display, optics.see_through):
        points = trace(path, centre, directions, GREEN_UM).points
        for number, step in enumerate(path.steps):
            away = np.linalg.norm(points[:, number] - centre, axis=-1)
            met = float(np.median(away[np.isfinite(away)])) if np.isfinite(away).any() else np.inf
            vertex = float(np.linalg.norm(step.surface.device_from_surface[:3, 3] - centre))
            size = max(size, min(met, vertex))
    return size


def _draw_rays(axes: "Axes", optics: EyeOptics, view: DrawingView) -> None:
    """Draw rays to the panel, evenly spread over its angles in this plane, and see-through rays in the same directions.

    If the panel is not visible, rays within 15 degrees of straight ahead show where they are lost.
    """
    centre, size = optics.eye_box.centre, _size(optics)
    ahead = _FAN[np.abs(_FAN) < 0.5 * np.pi]
    mapping = TracedDisplay(optics, GREEN_UM)
    visible = mapping.pixel_of_view_dir(view.directions(ahead), centre).ok
    ends = (ahead[visible].min(), ahead[visible].max()) if visible.any() else (-_LOST_ANGLE, _LOST_ANGLE)
    view_dir = view.directions(np.linspace(*ends, _RAYS))
    world = trace(optics.see_through, centre, view_dir, GREEN_UM)
    gone = np.linalg.norm(world.origin - centre, axis=-1)
    shown = (world.status == Status.OK) & (gone < _BEYOND * size)
    world_end = world.origin + (_BEYOND * size - gone)[:, None] * world.direction
    _draw_lines(axes, view, [centre, world.points[shown], world_end[shown]], "tab:orange", "see-through rays")
    panel_end = optics.panel.point_of_pixel(mapping.pixel_of_view_dir(view_dir, centre).value)
    arrives = np.isfinite(panel_end).all(axis=-1)
    display = trace(optics.display, centre, view_dir, GREEN_UM)
    _draw_lines(axes, view, [centre, display.points[arrives], panel_end[arrives]], "tab:blue", "display rays")
    _draw_lost(axes, optics, view, view_dir[~arrives], size)


def _draw_lost(axes: "Axes", optics: EyeOptics, view: DrawingView, view_dir: FloatArray, size: float) -> None:
    """Draw rays that do not reach the panel up to the last surface they meet and a little farther."""
    steps, label = optics.display.steps, "display rays that are lost"
    for direction in view_dir:
        points, heading = [optics.eye_box.centre], direction
        for count in range(1, len(steps) + 1):
            traced = trace(Path(steps[:count]), optics.eye_box.centre, direction, GREEN_UM)
            if traced.status != Status.OK or np.linalg.norm(traced.origin - points[0]) > _BEYOND * size:
                break
            points.append(traced.origin)
            heading = traced.direction
        points.append(points[-1] + _LOST_LENGTH * size * heading)
        axes.plot(*view.in_mm(np.array(points)), lw=0.9, ls=":", color="tab:red", label=label)
        label = ""


def _draw_lines(axes: "Axes", view: DrawingView, parts: list[FloatArray], colour: str, label: str) -> None:
    """Draw one line per ray through its start (3,), the points between (n, steps, 3) and its end (n, 3)."""
    start, between, end = parts
    if len(end) == 0:
        return
    line = np.concatenate([np.broadcast_to(start, (len(end), 1, 3)), between, end[:, None]], axis=1)
    along, up = view.in_mm(line)
    lines = axes.plot(along.T, up.T, lw=0.9, color=colour, label=label)
    for extra in lines[1:]:
        extra.set_label(None)

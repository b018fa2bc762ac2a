"""Drawings of rays through a device as Plotly figures: points and lines of the device frame in one or more views."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from benchmarks.trials import EvaluatedEye
from wlr_render.mappings import Status
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device import EyeOptics
from wlr_render.optics.device_file import load_device
from wlr_render.optics.drawing import VIEWS, DrawingView, cut_surface
from wlr_render.optics.tracer import trace
from wlr_render.report.blocks import Plot
from wlr_render.report.plots import axis

SIDE, ABOVE = VIEWS
WAVELENGTH_UM = 0.55
RED, BLUE, GREEN, GREY = "#d62728", "#1f77b4", "#2ca02c", "#888888"
ORANGE, PURPLE, BROWN = "#ff7f0e", "#9467bd", "#8c564b"
"""Colours that are legible on light and dark pages."""
_PANEL_EDGES = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]])
_EVERY = 5  # step between the points of a cut; half a degree is enough for a page
_HEADSET_M = 0.16  # largest distance from the nominal viewpoint at which surfaces are drawn
_GAP = 0.08, 0.22  # gap between diagrams across and down, as shares of the whole


def optics_of(eye: EvaluatedEye) -> EyeOptics:
    """Return the prescription of an eye."""
    return load_device(eye.device).eyes[eye.eye]


def display_path(optics: EyeOptics, viewpoint: FloatArray, view_dir: FloatArray) -> FloatArray:
    """Return points (n, k, 3) of rays from the panel to viewpoints (n, 3) that see it in directions (n, 3)."""
    traced = trace(optics.display, viewpoint, view_dir, WAVELENGTH_UM)
    pixel = optics.panel.pixel_of_ray(traced.origin, traced.direction)
    panel = optics.panel.point_of_pixel(pixel)
    line = np.concatenate([panel[:, None], traced.points[:, ::-1], viewpoint[:, None]], axis=1)
    return np.where((traced.status == Status.OK)[:, None, None], line, np.nan)


def see_through_path(
    optics: EyeOptics, viewpoint: FloatArray, view_dir: FloatArray, target: tuple[FloatArray, FloatArray]
) -> FloatArray:
    """Return points (n, k, 3) of rays from viewpoints (n, 3) in directions (n, 3) to a plane (point, normal)."""
    traced = trace(optics.see_through, viewpoint, view_dir, WAVELENGTH_UM)
    point, normal = target
    along = ((point - traced.origin) @ normal) / (traced.direction @ normal)
    end = traced.origin + along[:, None] * traced.direction
    line = np.concatenate([viewpoint[:, None], traced.points, end[:, None]], axis=1)
    return np.where((traced.status == Status.OK)[:, None, None], line, np.nan)


@dataclass
class Diagram:
    """One diagram of a drawing; its parts are projected along an axis of the device.

    Attributes:
        view: the projection.
        title: text above the diagram.
        traces: Plotly traces.
    """

    view: DrawingView
    title: str
    traces: list[dict[str, Any]] = field(default_factory=list)

    def lines(self, name: str, points: FloatArray, colour: str, **line: object) -> "Diagram":
        """Add polylines (n, k, 3)."""
        gaps = np.full((len(points), 1, 3), np.nan)
        joined = np.concatenate([points, gaps], axis=1).reshape(-1, 3)
        return self._add(name, joined, "lines", line={"color": colour, "width": 1.5, **line})

    def points(self, name: str, points: FloatArray, colour: str, **marker: object) -> "Diagram":
        """Add markers at points (n, 3)."""
        return self._add(name, points.reshape(-1, 3), "markers", marker={"color": colour, "size": 7, **marker})

    def optics(self, optics: EyeOptics, *, panel: bool = True) -> "Diagram":
        """Add the panel and the surfaces within their apertures, cut through the nominal viewpoint."""
        for surface in optics.surfaces():
            cut = cut_surface(surface, optics.eye_box.centre, self.view)[::_EVERY]
            # A surface without an aperture is unlimited: only its part near the headset is shown.
            far = np.linalg.norm(cut - optics.eye_box.centre, axis=-1) > _HEADSET_M
            cut = np.where(far[:, None], np.nan, cut)
            self.lines(surface.name.replace("_", " "), cut[None], PURPLE, width=3)
        if panel:
            edges = optics.panel.point_of_pixel(_PANEL_EDGES * optics.panel.pixels.size_px)
            self.lines("panel", edges[None], BROWN, width=4)
        return self

    def eye_box(self, optics: EyeOptics, size_mm: Sequence[float]) -> "Diagram":
        """Add the outline of the eye box and the base plane through its centre."""
        half = 0.5e-3 * np.array(size_mm)
        unit = np.zeros((5, 3))
        unit[:, [2, self.view.up]] = 2.0 * _PANEL_EDGES - 1.0
        self.lines("eye box", (optics.eye_box.centre + unit * half)[None], GREEN, dash="dash")
        ends = np.zeros((2, 3))
        ends[:, self.view.up] = [-2.0 * half[self.view.up], 2.0 * half[self.view.up]]
        return self.lines("base plane", (optics.eye_box.centre + ends)[None], GREEN, width=2.5)

    def _add(self, name: str, points: FloatArray, mode: str, **style: object) -> "Diagram":
        along, up = (_rounded(each) for each in self.view.in_mm(points))
        self.traces.append({"type": "scatter", "mode": mode, "name": name, "x": along, "y": up, **style})
        return self


def drawing(title: str, diagrams: Sequence[Diagram], caption: str, *, columns: int = 2, height_px: int = 520) -> Plot:
    """Return diagrams side by side, each with equal scales along both axes, and one legend for all."""
    data: list[dict[str, Any]] = []
    layout: dict[str, Any] = {"hovermode": "closest", "legend": {"orientation": "h", "y": -0.12}}
    rows = -(-len(diagrams) // columns)
    layout["annotations"] = []
    named: set[str] = set()
    for number, diagram in enumerate(diagrams):
        row, column = divmod(number, columns)
        across, down = _span(column, columns, _GAP[0]), _span(rows - 1 - row, rows, _GAP[1])
        key = "" if number == 0 else str(number + 1)
        reverse = {"autorange": "reversed"} if diagram.view.up == 0 else {}
        layout[f"xaxis{key}"] = axis("forward, -z (mm)") | {"domain": across, "anchor": f"y{key}"}
        layout[f"yaxis{key}"] = (
            axis(diagram.view.label) | {"domain": down, "anchor": f"x{key}", "scaleanchor": f"x{key}"} | reverse
        )
        layout["annotations"].append(
            {"text": diagram.title, "x": across[0], "y": down[1], "xref": "paper", "yref": "paper"}
            | {"xanchor": "left", "yanchor": "bottom", "showarrow": False}
        )
        for each in diagram.traces:
            shown = {"legendgroup": each["name"], "showlegend": each["name"] not in named}
            data.append({**each, **shown, "xaxis": f"x{key}", "yaxis": f"y{key}"})
            named.add(each["name"])
    return Plot(title, data, layout, caption, height_px)


def _span(number: int, count: int, gap: float) -> list[float]:
    width = (1.0 - gap * (count - 1)) / count
    return [number * (width + gap), number * (width + gap) + width]


def _rounded(values: FloatArray) -> list[float | None]:
    return [round(float(value), 4) if np.isfinite(value) else None for value in values.ravel()]

"""Builders of interactive plots: curves, bars, heat maps and arrow maps as Plotly traces."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from wlr_render.numerics.arrays import FloatArray
from wlr_render.report.blocks import Plot

MAX_ARROWS = 200
"""Largest number of arrows in one group of a map; more arrows overlap."""
_ALL_ARROWS = 5000  # most arrows in all groups together, for the sake of browsers; each group has at least 40
_ARROW_SHARE = 0.05
"""Length of the reference arrow, as a share of the map's width."""
_MARGIN = 0.06  # margin left and right of panels side by side, as a share of the map's width

_ACROSS = 3  # maps in a row
_DECADES = 3.0  # decades of the logarithmic scale that maps share; smaller values have the first colour

_STANDOFF_PX = 8  # gap between the numbers of an axis and its title; Plotly's own place may lie on the numbers
_COLOURS = ("#1f77b4", "#ff7f0e", "#2ca02c", "#d62728", "#9467bd", "#8c564b", "#e377c2", "#17becf")
_DASHES = ("solid", "dash", "dot", "dashdot", "longdash", "longdashdot")


def axis(title: str, log: bool = False) -> dict[str, Any]:
    """Return the layout of an axis: its scale, and its title with unit at a fixed distance from the numbers."""
    return {
        "title": {"text": title, "font": {"size": 12}, "standoff": _STANDOFF_PX},
        **({"type": "log"} if log else {}),
    }


def curves(
    title: str,
    lines: Mapping[str, tuple[ArrayLike, ArrayLike]],
    axes: tuple[str, str],
    *,
    log_x: bool = False,
    log_y: bool = False,
    grouped: bool = False,
    caption: str = "",
) -> Plot:
    """Plot named curves (x, y) in one diagram.

    Args:
        title: one line.
        lines: x and y of each curve, by name.
        axes: titles of x and y, units included.
        log_x, log_y: logarithmic axes.
        grouped: names are "GROUP, KIND", e.g. a device and its model; each group has a colour, each kind a dash
            pattern, and the points are marked.
        caption: one sentence about the content.
    """
    data: list[dict[str, Any]] = [
        {"type": "scatter", "mode": "lines", "name": name, "x": _rounded(x), "y": _rounded(y)}
        for name, (x, y) in lines.items()
    ]
    if grouped:
        groups, kinds = ({name.partition(", ")[part]: None for name in lines} for part in (0, 2))
        for trace in data:
            group, _, kind = trace["name"].partition(", ")
            colour, dash = list(groups).index(group), list(kinds).index(kind)
            line = {"color": _COLOURS[colour % len(_COLOURS)], "dash": _DASHES[dash % len(_DASHES)]}
            trace |= {"mode": "lines+markers", "line": line}
    layout = {"xaxis": axis(axes[0], log_x), "yaxis": axis(axes[1], log_y), "hovermode": "closest"}
    return Plot(title, data, layout, caption)


def heat_map(
    title: str,
    values: FloatArray,
    unit: str,
    *,
    limits: tuple[float, float] | None = None,
    cell: float = 1.0,
    caption: str = "",
) -> Plot:
    """Plot the values of an image (height, width) as coloured cells, with row 0 at the top.

    Args:
        title: one line.
        values: one value per pixel; NaN leaves a cell empty.
        unit: unit of the values.
        limits: values of the first and the last colour; None for the range of the values.
        cell: side of an image pixel, in panel pixels.
        caption: one sentence about the content.
    """
    colours: dict[str, Any] = {"colorscale": "Viridis", "colorbar": {"title": {"text": unit}}}
    if limits is not None:
        colours |= {"zmin": limits[0], "zmax": limits[1]}
    trace = _cells(values, values, cell, unit) | colours
    layout = {
        "xaxis": axis("u (px)") | {"constrain": "domain"},
        "yaxis": axis("v (px)") | {"autorange": "reversed", "scaleanchor": "x", "constrain": "domain"},
    }
    return Plot(title, [trace], layout, caption, height_px=560)


def small_heat_maps(
    title: str, maps: Mapping[str, FloatArray], unit: str, *, cell: float = 1.0, caption: str = ""
) -> Plot:
    """Plot named maps (height, width) of equal size side by side on one logarithmic colour scale, row 0 at the top.

    Args:
        title: one line.
        maps: positive values; NaN leaves a cell empty, zero has the first colour.
        unit: unit of the values.
        cell: side of a cell in the unit of the axes, pixels.
        caption: one sentence about the content.
    """
    every = np.concatenate([values[values > 0] for values in maps.values()])
    high = np.log10(every.max(initial=1e-6))
    low = max(np.log10(every.min(initial=10.0**high)), high - _DECADES)
    rows = -(-len(maps) // _ACROSS)
    ticks = [n * 10.0**d for d in range(int(np.floor(low)), int(np.ceil(high)) + 1) for n in (1, 2, 5)]
    ticks = [tick for tick in ticks if low <= np.log10(tick) <= high]
    bar = {"title": {"text": unit}, "tickvals": np.log10(ticks), "ticktext": [f"{tick:g}" for tick in ticks]}
    layout: dict[str, Any] = {
        "coloraxis": {"colorscale": "Viridis", "cmin": float(low), "cmax": float(high), "colorbar": bar},
        "annotations": [],
    }
    data = []
    for number, (name, values) in enumerate(maps.items()):
        row, column = divmod(number, _ACROSS)
        left, top = column / _ACROSS, 1.0 - row / rows
        suffix = str(number + 1) if number else ""
        across, down = [left, left + 0.95 / _ACROSS], [top - 0.95 / rows, top - 0.12 / rows]
        plain = {"showgrid": False, "zeroline": False, "showticklabels": False, "ticks": "", "constrain": "domain"}
        layout[f"xaxis{suffix}"] = plain | {"domain": across, "anchor": f"y{suffix}"}
        layout[f"yaxis{suffix}"] = plain | {
            "domain": down,
            "anchor": f"x{suffix}",
            "autorange": "reversed",
            "scaleanchor": f"x{suffix}",
        }
        at = {"x": sum(across) / 2, "y": top - 0.12 / rows, "xref": "paper", "yref": "paper"}
        layout["annotations"].append(at | {"xanchor": "center", "yanchor": "bottom", "text": name, "showarrow": False})
        trace = _cells(values, np.log10(np.maximum(values, 10.0**low)), cell, unit, name)
        data.append(trace | {"coloraxis": "coloraxis", "xaxis": f"x{suffix}", "yaxis": f"y{suffix}"})
    return Plot(title, data, layout, caption, height_px=60 + 230 * rows)


def _cells(values: FloatArray, shown: FloatArray, cell: float, unit: str, name: str = "") -> dict[str, Any]:
    """Return a trace of coloured cells (height, width), coloured by `shown`."""
    return {
        "type": "heatmap",
        "x": cell * (np.arange(values.shape[1]) + 0.5),
        "y": cell * (np.arange(values.shape[0]) + 0.5),
        "z": _rounded(shown),
        "customdata": _rounded(values),
        "hovertemplate": f"%{{x:.0f}}, %{{y:.0f}}: %{{customdata:.3g}} {unit}<extra>{name}</extra>",
        "hoverongaps": False,
    }


def bars(title: str, names: Sequence[str], series: Mapping[str, ArrayLike], y_title: str, *, caption: str = "") -> Plot:
    """Plot named values as bars side by side, one colour per series; NaN leaves a gap."""
    data = [
        {"type": "bar", "name": name, "x": list(names), "y": _rounded(values), "showlegend": len(series) > 1}
        for name, values in series.items()
    ]
    layout = {"barmode": "group", "xaxis": {"type": "category"}, "yaxis": axis(y_title)}
    return Plot(title, data, layout, caption)


def arrow_map(
    title: str,
    groups: Mapping[str, tuple[FloatArray, ...]],
    unit: str,
    axes: tuple[str, str],
    *,
    panels: Sequence[str] = ("",),
    y_down: bool = False,
    caption: str = "",
) -> Plot:
    """Plot arrows at positions; a menu selects one group, and all groups share a scale and a reference arrow.

    Args:
        title: one line.
        groups: positions (n, 2) by name, and arrows (n, 2) for each panel; arrows point right and up. NaN arrows are
            omitted.
        unit: unit of the arrows.
        axes: titles of x and y, units included.
        panels: titles of the panels, side by side, e.g. before and after.
        y_down: the y axis points down.
        caption: one sentence about the content.
    """
    every = np.concatenate([place for place, *_ in groups.values()])
    low, high = every.min(axis=0), every.max(axis=0)
    sizes = np.concatenate([np.linalg.norm(arrow, axis=1) for _, *arrows in groups.values() for arrow in arrows])
    reference = float(f"{max(float(np.nanquantile(sizes, 0.9)), 1e-3):.2g}")
    scale = _ARROW_SHARE * float(high[0] - low[0] or 1.0) / reference * np.array([1.0, -1.0 if y_down else 1.0])
    most = min(MAX_ARROWS, max(40, _ALL_ARROWS // len(groups)))
    data: list[dict[str, Any]] = []
    for number, (place, *arrows) in enumerate(groups.values()):
        for panel, arrow in enumerate(arrows):
            finite = np.flatnonzero(np.isfinite(arrow).all(axis=1))
            rows = finite[:: max(1, len(finite) // most)]
            shown = {"visible": number == 0, "showlegend": False, "xaxis": f"x{panel + 1 if panel else ''}"}
            data += _arrows(place[rows], arrow[rows], scale, reference, unit, shown, has_scale=panel == 0)
    below = 0.06 * (high - low)[1]
    corner = np.array([low[0], high[1] + below if y_down else low[1] - below])
    data.append(
        _trace(
            np.stack([corner, corner + [abs(scale[0]) * reference, 0.0]]),
            "lines+text",
            line={"width": 3, "color": "#d62728"},
            text=["", f"  {reference:g} {unit}"],
            textposition="middle right",
            showlegend=False,
            hoverinfo="skip",
        )
    )
    layout = _arrow_layout(axes, panels, y_down)
    if len(panels) > 1:  # one range for both panels: Plotly would fit each to its arrows
        margin = _MARGIN * float(high[0] - low[0])
        layout["xaxis"]["range"] = [float(low[0]) - margin, float(high[0]) + margin]
    if len(groups) > 1:
        layout["updatemenus"] = [_group_menu(list(groups), 2 * len(panels))]
    return Plot(title, data, layout, caption, height_px=560)


def _arrows(
    place: FloatArray,
    arrow: FloatArray,
    scale: FloatArray,
    most: float,
    unit: str,
    shown: Mapping[str, Any],
    *,
    has_scale: bool,
) -> list[dict[str, Any]]:
    """Return the traces of arrows (n, 2) at positions (n, 2): grey shafts, and tips coloured by size up to `most`."""
    tip, size = place + scale * arrow, np.linalg.norm(arrow, axis=1)
    shaft = np.stack([place, tip, np.full_like(tip, np.nan)], axis=1).reshape(-1, 2)
    colours = {"colorscale": "Viridis", "cmin": 0.0, "cmax": most, "showscale": has_scale}
    return [
        _trace(shaft, "lines", line={"width": 1, "color": "#888888"}, hoverinfo="skip", **shown),
        _trace(
            tip,
            "markers",
            marker={"size": 5, "color": _rounded(size), "colorbar": {"title": {"text": unit}}, **colours},
            text=[f"{one:.3g} {unit}" for one in size],
            hoverinfo="text",
            **shown,
        ),
    ]


def _arrow_layout(axes: tuple[str, str], panels: Sequence[str], y_down: bool) -> dict[str, Any]:
    """Return the layout of an arrow map, whose panels share the y axis and the range of x."""
    layout: dict[str, Any] = {
        "yaxis": axis(axes[1])
        | {"scaleanchor": "x", "constrain": "domain"}
        | ({"autorange": "reversed"} if y_down else {}),
        "hovermode": "closest",
        "annotations": [],
    }
    for number, name in enumerate(panels):
        left, right = number / len(panels), (number + 0.97) / len(panels)
        across: dict[str, Any] = {"domain": [left, right]} if len(panels) > 1 else {}
        layout[f"xaxis{number + 1 if number else ''}"] = (
            axis(axes[0]) | {"constrain": "domain"} | across | ({"matches": "x"} if number else {})
        )
        # Panel titles are inside the panels: the menu of groups is above them.
        at = {"x": right, "xanchor": "right", "y": 1.0, "yanchor": "top", "xref": "paper", "yref": "paper"}
        layout["annotations"] += [at | {"text": name, "showarrow": False}] if name else []
    return layout


def _group_menu(names: Sequence[str], traces: int) -> dict[str, Any]:
    """Return a menu that shows the `traces` traces of one group at a time, and always the last trace."""
    shown = [[each // traces == number for each in range(traces * len(names))] + [True] for number in range(len(names))]
    buttons = [
        {"label": name, "method": "update", "args": [{"visible": visible}]}
        for name, visible in zip(names, shown, strict=True)
    ]
    place = {"x": 0.0, "xanchor": "left", "y": 1.0, "yanchor": "bottom"}
    return {"buttons": buttons, "bgcolor": "#cccccc", "font": {"color": "#111111"}, **place}


def _trace(points: FloatArray, mode: str, **more: object) -> dict[str, Any]:
    return {"type": "scatter", "mode": mode, "x": _rounded(points[:, 0]), "y": _rounded(points[:, 1]), **more}


def _rounded(values: ArrayLike) -> list[Any]:
    """Round to four significant digits: enough for a plot, in a third of the bytes."""
    array = np.asarray(values, dtype=np.float64)
    return [_rounded(row) if array.ndim > 1 else float(f"{row:.4g}") for row in array]

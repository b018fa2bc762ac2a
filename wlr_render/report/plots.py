"""Builders of interactive plots: curves and heat maps as Plotly traces."""

import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from wlr_render.numerics.arrays import FloatArray
from wlr_render.report.blocks import Plot

MAX_CELLS = 200
"""Cells of a heat map, across and down: more cannot be told apart in a page and would only make it slow."""

_COLOURS = ("#1f77b4", "#ff7f0e", "#2ca02c", "#d62728", "#9467bd", "#8c564b", "#e377c2", "#17becf")
_DASHES = ("solid", "dash", "dot", "dashdot", "longdash", "longdashdot")


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
    """Named curves (x, y) in one diagram; `axes` are the titles of x and y, units included.

    If `grouped`, names are "GROUP, KIND", e.g. a device and its model: each group has a colour, each kind a dash
    pattern, and the points are marked.
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
    layout = {"xaxis": _axis(axes[0], log_x), "yaxis": _axis(axes[1], log_y), "hovermode": "closest"}
    return Plot(title, data, layout, caption)


def heat_map(
    title: str,
    values: FloatArray,
    unit: str,
    *,
    limits: tuple[float, float] | None = None,
    log: bool = False,
    axes: tuple[str, str] = ("u (px)", "v (px)"),
    caption: str = "",
) -> Plot:
    """Values of an image (height, width), NaN where there are none, as coloured cells; row 0 is at the top.

    Args:
        title: one line.
        values: one per pixel; large images are reduced to the maxima of blocks, which the caption then says.
        unit: of the values.
        limits: values of the first and the last colour; None for the range of the values.
        log: logarithmic colours.
        axes: titles of columns and rows.
        caption: what it shows.
    """
    height, width = values.shape
    block = max(1, -(-max(height, width) // MAX_CELLS))
    cells = block_maxima(values, block)
    shown = np.log10(np.maximum(cells, 1e-12)) if log else cells
    colours: dict[str, Any] = {"colorscale": "Viridis", "colorbar": {"title": {"text": unit}}}
    if limits is not None:
        low, high = np.log10(limits) if log else limits
        colours |= {"zmin": float(low), "zmax": float(high)}
        if log:
            decades = np.arange(np.ceil(low), np.floor(high) + 1)
            colours["colorbar"] |= {"tickvals": decades, "ticktext": [f"{10.0**decade:g}" for decade in decades]}
    trace = {
        "type": "heatmap",
        "x": block * (np.arange(cells.shape[1]) + 0.5),
        "y": block * (np.arange(cells.shape[0]) + 0.5),
        "z": _rounded(shown),
        "customdata": _rounded(cells),
        "hovertemplate": f"%{{x:.0f}}, %{{y:.0f}}: %{{customdata:.3g}} {unit}<extra></extra>",
        "hoverongaps": False,
        **colours,
    }
    layout = {
        "xaxis": _axis(axes[0]) | {"constrain": "domain"},
        "yaxis": _axis(axes[1]) | {"autorange": "reversed", "scaleanchor": "x", "constrain": "domain"},
    }
    reduced = f" Each cell shows the maximum of {block} x {block} pixels." if block > 1 else ""
    return Plot(title, [trace], layout, (caption + reduced).strip(), height_px=560)


def block_maxima(values: FloatArray, block: int) -> FloatArray:
    """Maxima of the square blocks of an image, without NaN where a block has any number."""
    rows, columns = (-(-size // block) * block for size in values.shape)
    padded = np.full((rows, columns), np.nan)
    padded[: values.shape[0], : values.shape[1]] = values
    blocks = padded.reshape(rows // block, block, columns // block, block)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "All-NaN slice", RuntimeWarning)
        return np.asarray(np.nanmax(blocks, axis=(1, 3)))


def _axis(title: str, log: bool = False) -> dict[str, Any]:
    return {"title": {"text": title}, **({"type": "log"} if log else {})}


def _rounded(values: ArrayLike) -> list[Any]:
    """Four significant digits: what can be read from a plot, in a third of the bytes."""
    array = np.asarray(values, dtype=np.float64)
    return [_rounded(row) if array.ndim > 1 else float(f"{row:.4g}") for row in array]

"""Interactive plots of a diagnosis: residual maps, curves, normality, captures, correlations."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri

from wlr_render.diagnosis.diagnosis import Diagnosis, StationEffect
from wlr_render.diagnosis.residual_views import PartView, Variable
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray
from wlr_render.report.blocks import Plot
from wlr_render.report.plots import axis

_BEFORE, _AFTER, _GREY = "#c4651a", "#2f7fc1", "#8c8c8c"
_CELLS = (14, 11)  # arrows across and down
_BINS = 12
_COLUMNS = 3
_BAND = 2.0  # standard errors that count as noise
_HISTOGRAM = np.linspace(-6.0, 6.0, 61)
_QUANTILES = 99
_FARTHEST = 4.0  # quantile that is shown
_TICKS = [step * power for power in (0.1, 1, 10, 100, 1000) for step in (1, 2, 5)]  # of a logarithmic axis


def residual_maps(part: PartView) -> Plot:
    """Arrows over the field of view, one map for each bench, with one scale of arrows and a slider over captures."""
    pitch = float(np.min(np.ptp(part.place, axis=0) / _CELLS))
    cells = [[_cells(part, field.rows, state.on_map) for state in part.states] for field in part.maps]
    lengths = np.concatenate([np.linalg.norm(arrow, axis=1) for row in cells for _, arrow in row])
    unit = _round_number(float(np.percentile(lengths, 95)))
    scale = 1.6 * pitch / unit
    low, high = part.place.min(axis=0) - pitch, part.place.max(axis=0) + pitch
    largest = int(np.argmax([np.sqrt(np.mean(row[0][1] ** 2)) for row in cells]))
    data: list[dict[str, Any]] = []
    for number, row in enumerate(cells):
        for place, (state, (at, arrow)) in enumerate(zip(part.states, row, strict=True)):
            style = {"color": (_BEFORE, _AFTER)[place], "width": 1.5}
            lines = _arrows(np.append(at, [[low[0], low[1]]], axis=0), np.append(arrow, [[unit, 0.0]], axis=0), scale)
            data.append(
                {"type": "scatter", "mode": "lines", "name": state.name, "line": style, "hoverinfo": "skip"}
                | {"visible": number == largest, "showlegend": False}
                | {"x": lines[0], "y": lines[1], "xaxis": f"x{place + 1 if place else ''}", "yaxis": "y"}
            )
    count = len(part.states)
    steps = [
        {
            "label": field.title.partition("\n")[0],
            "method": "update",
            "args": [
                {"visible": [row // count == number for row in range(len(data))]},
                {f"annotations[{count}].text": field.title.replace("\n", " ")},
            ],
        }
        for number, field in enumerate(part.maps)
    ]
    slider = {"steps": steps, "active": largest, "pad": {"t": 50}, "x": 0.06, "len": 0.88}
    layout: dict[str, Any] = {"sliders": [slider | {"currentvalue": {"visible": False}}], "annotations": []}
    layout["yaxis"] = {"range": [high[1], low[1] - pitch]} | axis(part.place_label[1])
    for place, state in enumerate(part.states):
        domain = [place / count + 0.02, (place + 1) / count - 0.02]
        layout[f"xaxis{place + 1 if place else ''}"] = {
            "range": [low[0], high[0]],
            "domain": domain,
        } | axis(part.place_label[0])
        layout["annotations"].append(
            {"text": state.name, "xref": "paper", "yref": "paper", "x": domain[0], "y": 1.08, "showarrow": False}
        )
    layout["annotations"].append(
        {"text": part.maps[largest].title.replace("\n", " "), "xref": "paper", "yref": "paper", "showarrow": False}
        | {"x": 0.0, "xanchor": "left", "y": 1.16, "font": {"size": 14}}
    )
    layout["margin"] = {"t": 70, "r": 20, "b": 50}
    caption = (
        "Each arrow is the mean residual (measured minus simulated) of the readings around it; all maps have one scale."
        f" The arrow at the top left is {unit:g} {part.map_unit}. The slider starts with {_slider_order(part)}. "
        "It opens at the map with the largest residual. Arrows in all directions at once are noise. Arrows in one "
        "direction, which is another one in each capture, are the stage's repeatability."
    )
    return Plot(f"Residual over the field of view: {part.name}", data, layout, caption, 520)


_DOWNWARDS = "v (px)"
_LABELS = {
    "panel pixels": ("panel u (px)", f"panel {_DOWNWARDS}"),
    "panel pixels and viewpoint": ("panel u (px)", f"panel {_DOWNWARDS}"),
    "panel pixels and colour": ("panel u (px)", f"panel {_DOWNWARDS}"),
    "camera pixels": ("camera u (px)", f"camera {_DOWNWARDS}"),
    "place on the combiner": ("right of the line of sight (mm)", "above it (mm)"),
    "place on the target": ("x on the target", "y on the target"),
}
"""Names of the two axes of a map, by the coordinates of a station."""


def effect_map(effect: StationEffect) -> Plot:
    """Displacement of a located effect over its station: a map where the station has two coordinates, else curves."""
    shape = effect.map
    varies = np.ptp(shape.place, axis=0) > 0.0
    place, moved = shape.place[:, varies][:, :2], shape.displacement
    if place.shape[1] < 2:
        order = np.argsort(place[:, 0]) if place.shape[1] else np.arange(len(moved))
        along = place[order, 0] if place.shape[1] else order
        data: list[dict[str, Any]] = [
            {
                "type": "scatter",
                "mode": "lines",
                "name": f"component {number + 1}",
                "x": along,
                "y": moved[order, number],
            }
            for number in range(moved.shape[1])
        ]
        layout: dict[str, Any] = {"xaxis": axis(shape.coordinates), "yaxis": axis(shape.unit)}
    else:
        signed = moved[:, 0] if moved.shape[1] == 1 else np.linalg.norm(moved[:, :3], axis=1)
        reach = float(np.max(np.abs(signed), initial=1e-12))
        colours = {"colorscale": "RdBu", "cmid": 0.0} if moved.shape[1] == 1 else {"colorscale": "Viridis", "cmin": 0.0}
        marker = {"color": signed, "size": 6, "cmax": reach, "showscale": True, "colorbar": {"title": shape.unit}}
        data = [
            {"type": "scattergl", "mode": "markers", "name": effect.station, "marker": marker | colours}
            | {"x": place[:, 0], "y": place[:, 1]}
        ]
        across, down = _LABELS.get(shape.coordinates, (f"{shape.coordinates}, first", f"{shape.coordinates}, second"))
        layout = {"xaxis": axis(across), "yaxis": axis(down) | {"scaleanchor": "x"}}
        if down.endswith(_DOWNWARDS):
            layout["yaxis"]["autorange"] = "reversed"
    caption = f"{effect.displaced} ({shape.unit}) over {shape.coordinates}: {effect.form}, as the readings show it."
    return Plot(f"Effect on the {effect.station}: {effect.displaced}", data, layout, caption, 460)


def _slider_order(part: PartView) -> str:
    """Return the order of the maps of a part, as a caption states it."""
    return {
        "display": "the capture in the middle of all; each further one is the farthest from those before it",
        "see-through": "the nearest target pose and ends with the farthest",
    }.get(part.name, "the first recording and ends with the last")


def residual_curves(part: PartView) -> Plot:
    """Mean residual in bins of each variable, with one scale for all variables and both benches."""
    data: list[dict[str, Any]] = []
    layout: dict[str, Any] = {"annotations": []}
    rows = -(-len(part.variables) // _COLUMNS)
    for number, variable in enumerate(part.variables):
        row, column = divmod(number, _COLUMNS)
        suffix = str(number + 1) if number else ""
        axes = {"xaxis": f"x{suffix}", "yaxis": f"y{suffix}"}
        data += [trace | axes for trace in _curves(part, variable, number == 0)]
        across, down = [(column + 0.09) / _COLUMNS, (column + 0.96) / _COLUMNS], [row / rows, (row + 0.7) / rows]
        radial = " (outwards, around)" if variable.outwards is not None else ""
        layout[f"xaxis{suffix}"] = {"domain": across, "anchor": f"y{suffix}"} | axis(variable.name + radial)
        layout[f"yaxis{suffix}"] = {"domain": [1 - down[1], 1 - down[0]], "anchor": f"x{suffix}"}
        layout[f"yaxis{suffix}"] |= {"matches": "y"} if number else {}
        layout[f"yaxis{suffix}"] |= axis("arcmin") if column == 0 else {}
    layout["legend"] = {"orientation": "h", "y": 1.08, "yanchor": "bottom"}
    caption = (
        "Mean residual in bins of each variable: right (solid) and down (dotted) in the camera's image; where so "
        "marked, outwards (solid) and around (dotted). Band: two standard errors of a mean by the noise and the "
        "stage's repeatability. Click on 'rms beyond the band' in the legend to show the rms that noise and "
        "repeatability do not give: a pattern that cancels in the mean."
    )
    return Plot(f"Residual against each variable: {part.name}", data, layout, caption, 120 + 230 * rows)


def _curves(part: PartView, variable: Variable, in_legend: bool) -> list[dict[str, Any]]:
    data: list[dict[str, Any]] = []
    for place, state in enumerate(part.states):
        curve = binned(variable, state.seen, part)
        colour = (_BEFORE, _AFTER)[place]
        if place == 0:
            band = {"x": [*curve.middle, *curve.middle[::-1]], "y": [*curve.band, *-curve.band[::-1]]}
            data.append(
                {"type": "scatter", "mode": "lines", "fill": "toself", "fillcolor": "rgba(140,140,140,0.3)"}
                | {"line": {"width": 0}, "hoverinfo": "skip", "showlegend": False}
                | band
            )
        for number, mean in enumerate(curve.means):
            line = {"color": colour, "dash": ("solid", "dot")[number]}
            data.append(
                {"type": "scatter", "mode": "lines+markers", "name": state.name, "legendgroup": state.name}
                | {"line": line, "marker": {"size": 4}, "showlegend": in_legend and number == 0}
                | {"x": curve.middle, "y": mean}
            )
        name = f"{state.name}: rms beyond the band"
        data.append(
            {"type": "scatter", "mode": "lines", "name": name, "legendgroup": name, "visible": "legendonly"}
            | {"line": {"color": _GREY}, "x": curve.middle, "y": curve.excess, "showlegend": in_legend}
        )
    return data


@dataclass(frozen=True, eq=False)
class BinnedResidual:
    """Residuals in bins of a variable.

    Attributes:
        middle: (k,) of the bins, by the variable.
        means: (2, k) of both components.
        band: (k,) how far noise and the usual motion of captures would move a mean.
        excess: (k,) rms of the readings beyond what these would give.
    """

    middle: FloatArray
    means: FloatArray
    band: FloatArray
    excess: FloatArray


def binned(variable: Variable, residual: FloatArray, part: PartView) -> BinnedResidual:
    """Mean and excess of a residual (n, 2) of a part in bins of a variable."""
    good = np.isfinite(residual).all(axis=1)
    both = np.concatenate([residual[good][:, :, None], part.motion[good]], axis=2)
    if variable.outwards is not None:
        both = np.stack([_radial(each, variable.outwards[good]) for each in np.moveaxis(both, 2, 0)], axis=2)
    along, motion = both[:, :, 0], both[:, :, 1:]
    index, counts = _bins(variable.values[good])
    # Readings of one capture move together; both axes have one band.
    capture = np.unique(np.stack([index, part.group[good]]), axis=1, return_inverse=True)
    bin_of, together = capture[0][0], capture[1].ravel()
    sums = [np.bincount(together, each, len(bin_of)) for each in motion.reshape(len(motion), -1).T]
    of_mean = np.bincount(bin_of, np.sum(np.square(sums), axis=0) / 2.0, len(counts)) / counts**2
    of_reading = part.sigma_arcmin**2 + np.bincount(index, np.sum(motion**2, axis=(1, 2)) / 2.0) / counts
    square = np.bincount(index, np.mean(along**2, axis=1)) / counts
    return BinnedResidual(
        middle=np.bincount(index, variable.values[good]) / counts,
        means=np.stack([np.bincount(index, component) / counts for component in along.T]),
        band=_BAND * np.sqrt(part.sigma_arcmin**2 / counts + of_mean),
        # The mean square of n readings of two components scatters by sigma^2 / sqrt(n).
        excess=np.sqrt(np.clip(square - of_reading * (1.0 + _BAND / np.sqrt(counts)), 0.0, None)),
    )


def normality_plot(diagnosis: Diagnosis) -> Plot:
    """Histogram of the whitened residual, and its quantiles against those of the standard normal distribution."""
    values = diagnosis.fit.residual.ravel()
    counts, _ = np.histogram(values, _HISTOGRAM)
    middle, width = 0.5 * (_HISTOGRAM[1:] + _HISTOGRAM[:-1]), float(_HISTOGRAM[1] - _HISTOGRAM[0])
    normal = np.exp(-0.5 * middle**2) / np.sqrt(2 * np.pi)
    # Evenly spaced quantiles show the tails; beyond the farthest there are fewer than five values.
    farthest = min(_FARTHEST, -float(ndtri(min(0.4, 5.0 / len(values)))))
    expected = np.linspace(-farthest, farthest, _QUANTILES)
    data = [
        {
            "type": "bar",
            "x": middle,
            "y": counts / len(values) / width,
            "name": "residual",
            "marker": {"color": _AFTER},
        },
        {"type": "scatter", "x": middle, "y": normal, "name": "normal distribution", "line": {"color": _GREY}},
        {
            "type": "scatter",
            "mode": "markers",
            "x": expected,
            "y": np.quantile(values, ndtr(expected)),
            "name": "quantiles",
        }
        | {"marker": {"color": _BEFORE, "size": 5}, "xaxis": "x2", "yaxis": "y2"},
        {
            "type": "scatter",
            "mode": "lines",
            "x": [-farthest, farthest],
            "y": [-farthest, farthest],
            "showlegend": False,
        }
        | {"line": {"color": _GREY}, "xaxis": "x2", "yaxis": "y2"},
    ]
    layout = {
        "xaxis": {"domain": [0, 0.46]} | axis("whitened residual"),
        "yaxis": axis("density"),
        "xaxis2": {"domain": [0.56, 1]} | axis("normal quantile"),
        "yaxis2": {"anchor": "x2"} | axis("residual quantile"),
        "bargap": 0,
    }
    caption = (
        "Residual of the readings that were fitted, divided by all errors that the bench has: noise, what neighbouring "
        "points share, and the motion of each capture. Right: points on the line are standard normal; a steeper line "
        "is more noise than was found, bent ends are heavy tails."
    )
    return Plot("Whitened residual", data, layout, caption, 380)


def captures_plot(diagnosis: Diagnosis) -> Plot:
    """Rms residual of each capture over its noise, before and after."""
    names = [each.capture for each in diagnosis.captures]
    shown = [("bench as described", _BEFORE, [each.rms_before for each in diagnosis.captures])]
    if diagnosis.is_corrected:
        shown.append(("corrected bench", _AFTER, [each.rms_after for each in diagnosis.captures]))
    marks = ["x" if each.excluded else "circle" for each in diagnosis.captures]
    data: Sequence[dict[str, Any]] = [
        {"type": "scatter", "mode": "markers", "name": name, "x": names, "y": values}
        | {"marker": {"color": colour, "symbol": marks}}
        for name, colour, values in shown
    ]
    layout = {"yaxis": axis("rms residual (sigma)", log=True) | {"tickvals": _TICKS}}
    layout["xaxis"] = {"showticklabels": False, "showgrid": False} | axis("captures, in the order of the table")
    return Plot(
        "Residual of each capture",
        data,
        layout,
        "1 is noise; the motion of each capture adds to it. Crosses: excluded captures.",
        340,
    )


def correlations_plot(diagnosis: Diagnosis) -> Plot:
    """Correlations between the fitted values."""
    found = diagnosis.correlations
    data = [
        {"type": "heatmap", "x": found.names, "y": found.names, "z": found.matrix}
        | {"zmin": -1, "zmax": 1, "colorscale": "RdBu", "reversescale": True, "texttemplate": "%{z:.2f}"}
    ]
    layout = {"yaxis": {"autorange": "reversed"}}
    return Plot("Correlations between the values found", data, layout, "", 160 + 28 * len(found.names))


def _cells(part: PartView, rows: BoolArray, residual: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean place (k, 2) and residual (k, 2) of the readings in each cell of a grid over the field."""
    rows = rows & np.isfinite(residual).all(axis=1)
    place, own = part.place[rows], residual[rows]
    low, high = part.place.min(axis=0), part.place.max(axis=0)
    cell = np.minimum((place - low) / (high - low).clip(1e-12) * _CELLS, np.array(_CELLS) - 1).astype(int)
    _, index, counts = np.unique(cell[:, 0] * _CELLS[1] + cell[:, 1], return_inverse=True, return_counts=True)
    means = [np.bincount(index, values) / counts for values in (*place.T, *own.T)]
    return np.stack(means[:2], axis=1), np.stack(means[2:], axis=1)


def _arrows(at: FloatArray, arrow: FloatArray, scale: float) -> tuple[list[float | None], list[float | None]]:
    """Coordinates of arrows (k, 2) as broken lines: shaft and two barbs, with None between arrows."""
    tip = at + scale * arrow
    back = 0.25 * scale * arrow
    across = np.stack([-back[:, 1], back[:, 0]], axis=1)
    points = np.stack([at, tip, tip - back + 0.6 * across, tip, tip - back - 0.6 * across], axis=1)
    points = np.concatenate([points, np.full((len(at), 1, 2), np.nan)], axis=1).reshape(-1, 2)
    x, y = ([None if np.isnan(value) else round(float(value), 3) for value in column] for column in points.T)
    return x, y


def _round_number(value: float) -> float:
    """Return the largest of 1, 2 and 5 times a power of ten that does not exceed a value."""
    power = 10.0 ** np.floor(np.log10(max(value, 1e-9)))
    return float(power * max(step for step in (1, 2, 5) if step * power <= max(value, 1e-9) * (1 + 1e-9)))


def _radial(residual: FloatArray, outwards: FloatArray) -> FloatArray:
    """Components (n, 2) along a direction and across it, clockwise in the image."""
    across = np.stack([-outwards[:, 1], outwards[:, 0]], axis=1)
    return np.stack([np.sum(residual * outwards, axis=1), np.sum(residual * across, axis=1)], axis=1)


def _bins(values: FloatArray) -> tuple[IntArray, IntArray]:
    """Bin of each value (n,), few distinct values each their own, and how many each bin has."""
    distinct = np.unique(np.round(values, 9))
    if len(distinct) <= _BINS:
        edges = 0.5 * (distinct[1:] + distinct[:-1])
    else:
        edges = np.quantile(values, np.linspace(0, 1, _BINS + 1)[1:-1])
    _, index, counts = np.unique(np.searchsorted(edges, values), return_inverse=True, return_counts=True)
    return index.astype(np.int64), counts.astype(np.int64)

"""Interactive plots of a diagnosis: residual maps, curves, normality, captures, correlations."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike

from wlr_render.diagnosis.diagnosis import DiagnosisRecord, StationEffect
from wlr_render.diagnosis.effect_findings import STATIONS
from wlr_render.diagnosis.residual_views import PartView, Variable
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.report.blocks import Plot
from wlr_render.report.plots import arrow_map, axis, curves

_BEFORE, _AFTER, _GREY = "#c4651a", "#2f7fc1", "#8c8c8c"
_CELLS = (14, 11)  # arrows across and down
_BINS = 12  # bins per variable
_COLUMNS = 3  # plots in a row
_BAND = 2.0  # half width of the noise band, in standard errors
_HISTOGRAM = np.linspace(-6.0, 6.0, 61)
_QUANTILES = 99
_FARTHEST = 4.0  # largest normal quantile shown
_TICKS = [step * power for power in (0.1, 1, 10, 100, 1000) for step in (1, 2, 5)]  # ticks of a logarithmic axis


def residual_maps(part: PartView) -> Plot:
    """Plot the residual over the field of view, a panel for each bench, with a menu of captures."""
    return field_maps(
        part,
        f"Residual over the field of view: {part.name}",
        "Each arrow is the mean residual (measured minus simulated) of the readings around it; all maps share one "
        "scale. The menu lists captures from distant positions, the one with the largest residual first. Arrows in "
        "random directions are noise. Arrows in one direction that differs from capture to capture are the stage's "
        "repeatability.",
    )


def field_maps(part: PartView, title: str, caption: str) -> Plot:
    """Plot arrows over the field of view, a panel for each state of a part, with a menu of captures."""
    up = np.concatenate([each * [1.0, -1.0] for each in part.on_map.values()], axis=1)
    known = np.isfinite(up).all(axis=1)
    rows = {name: shown & known for name, shown in part.maps.items() if np.any(shown & known)}
    largest_first = sorted(rows, key=lambda name: -float(np.mean(up[rows[name], :2] ** 2)))
    return arrow_map(
        title,
        {name: _cell_means(part.place[rows[name]], up[rows[name]]) for name in largest_first},
        part.map_unit,
        part.place_label,
        panels=list(part.on_map),
        y_down=True,
        caption=caption,
    )


def _cell_means(place: FloatArray, vectors: FloatArray) -> tuple[FloatArray, ...]:
    """Return the mean places (k, 2) and the means (k, 2) of each pair of columns in the cells of a grid.

    Args:
        place: (m, 2) positions.
        vectors: (m, 2 p) vectors there.
    """
    low, high = place.min(axis=0), place.max(axis=0)
    cell = np.minimum((place - low) / (high - low).clip(1e-12) * _CELLS, np.array(_CELLS) - 1).astype(int)
    _, index, counts = np.unique(cell[:, 0] * _CELLS[1] + cell[:, 1], return_inverse=True, return_counts=True)
    columns = np.concatenate([place, vectors], axis=1).T
    means = np.stack([np.bincount(index, column) / counts for column in columns], axis=1)
    return tuple(np.split(means, len(columns) // 2, axis=1))


_LABELS = {
    "panel pixels": ("panel u (px)", "panel v (px)"),
    "panel pixels and viewpoint": ("panel u (px)", "panel v (px)"),
    "panel pixels and colour": ("panel u (px)", "panel v (px)"),
    "camera pixels": ("camera u (px)", "camera v (px)"),
    "place on the combiner": ("right of the line of sight (mm)", "above the line of sight (mm)"),
    "place on the target": ("x on the target", "y on the target"),
}
"""Names of the two axes of a map, by the coordinates of a station."""


def effect_map(effect: StationEffect) -> Plot:
    """Plot the displacement of a located effect at its station: arrows or colours over two coordinates, else curves."""
    title, unit = f"Effect {STATIONS[effect.station][0]}: {effect.displaced}", effect.map_unit
    caption = f"{effect.displaced} ({unit}) over {effect.coordinates}: {effect.form}, as the readings show it."
    place, moved = effect.map_place[:, np.ptp(effect.map_place, axis=0) > 0.0][:, :2], effect.map_displacement
    if place.shape[1] < 2:
        along = place[:, 0] if place.shape[1] else np.arange(len(moved), dtype=float)
        order = np.argsort(along)
        lines = {f"component {number + 1}": (along[order], each[order]) for number, each in enumerate(moved.T)}
        return curves(title, lines, (effect.coordinates, unit), caption=caption)
    axes = _LABELS.get(effect.coordinates, (f"{effect.coordinates}, first", f"{effect.coordinates}, second"))
    if moved.shape[1] == 2 and effect.coordinates in ("panel pixels", "camera pixels"):
        groups = {effect.station: _cell_means(place, moved * [1.0, -1.0])}
        return arrow_map(title, groups, unit, axes, y_down=True, caption=caption)
    size = moved[:, 0] if moved.shape[1] == 1 else np.linalg.norm(moved[:, :3], axis=1)
    colours = {"colorscale": "RdBu", "cmid": 0.0} if moved.shape[1] == 1 else {"colorscale": "Viridis", "cmin": 0.0}
    marker = {"color": size, "size": 6, "showscale": True, "colorbar": {"title": {"text": unit}}, **colours}
    data = [{"type": "scattergl", "mode": "markers", "marker": marker, "x": place[:, 0], "y": place[:, 1]}]
    down = {"scaleanchor": "x"} | ({"autorange": "reversed"} if axes[1].endswith("v (px)") else {})
    return Plot(title, data, {"xaxis": axis(axes[0]), "yaxis": axis(axes[1]) | down}, caption, 460)


def residual_curves(part: PartView) -> Plot:
    """Plot the mean residual in bins of each variable, with one scale for all variables and both benches."""
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
        "Mean residual in bins of each variable: right (solid) and down (dotted) in the camera's image; where "
        "marked, outwards (solid) and around (dotted). Band: two standard errors of the mean, from noise and the "
        "stage's repeatability."
    )
    return Plot(f"Residual against each variable: {part.name}", data, layout, caption, 120 + 230 * rows)


def _curves(part: PartView, variable: Variable, in_legend: bool) -> list[dict[str, Any]]:
    data: list[dict[str, Any]] = []
    for (bench, seen), colour in zip(part.seen.items(), (_BEFORE, _AFTER), strict=False):
        curve = binned(variable, seen, part)
        if not data:
            x, y = [*curve.middle, *curve.middle[::-1]], [*curve.band, *-curve.band[::-1]]
            grey = {"fill": "toself", "fillcolor": "rgba(140,140,140,0.3)", "line": {"width": 0}}
            data.append(_scatter(x, y, "lines", **grey, hoverinfo="skip", showlegend=False))
        for mean, dash in zip(curve.means, ("solid", "dot"), strict=True):
            line = {"line": {"color": colour, "dash": dash}, "marker": {"size": 4}, "legendgroup": bench}
            shown = in_legend and dash == "solid"
            data.append(_scatter(curve.middle, mean, "lines+markers", **line, name=bench, showlegend=shown))
    return data


def _scatter(x: ArrayLike, y: ArrayLike, mode: str, **more: object) -> dict[str, Any]:
    return {"type": "scatter", "mode": mode, "x": x, "y": y, **more}


@dataclass(frozen=True, eq=False)
class BinnedResidual:
    """Residuals in bins of a variable.

    Attributes:
        middle: (k,) mean of the variable in each bin.
        means: (2, k) mean of both components of the residual.
        band: (k,) limit of a mean that noise and the usual motion of captures can explain.
    """

    middle: FloatArray
    means: FloatArray
    band: FloatArray


def binned(variable: Variable, residual: FloatArray, part: PartView) -> BinnedResidual:
    """Return the means of a part's residual (n, 2), in arcminutes, in bins of a variable."""
    good = np.isfinite(residual).all(axis=1)
    both = np.concatenate([residual[good][:, :, None], part.motion[good]], axis=2)
    if variable.outwards is not None:
        both = np.stack([_radial(each, variable.outwards[good]) for each in np.moveaxis(both, 2, 0)], axis=2)
    along, motion = both[:, :, 0], both[:, :, 1:]
    index, counts = _bins(variable.values[good])
    # Readings of one capture move together; both axes share one band.
    capture = np.unique(np.stack([index, part.group[good]]), axis=1, return_inverse=True)
    bin_of, together = capture[0][0], capture[1].ravel()
    sums = [np.bincount(together, each, len(bin_of)) for each in motion.reshape(len(motion), -1).T]
    of_mean = np.bincount(bin_of, np.sum(np.square(sums), axis=0) / 2.0, len(counts)) / counts**2
    return BinnedResidual(
        middle=np.bincount(index, variable.values[good]) / counts,
        means=np.stack([np.bincount(index, component) / counts for component in along.T]),
        band=_BAND * np.sqrt(part.sigma_arcmin**2 / counts + of_mean),
    )


def normality_plot(diagnosis: DiagnosisRecord) -> Plot:
    """Plot a histogram of the whitened residual, and a Q-Q plot against the normal distribution."""
    values = diagnosis.fit.residual.ravel()
    counts, _ = np.histogram(values, _HISTOGRAM)
    density = counts / len(values) / float(_HISTOGRAM[1] - _HISTOGRAM[0])
    middle = 0.5 * (_HISTOGRAM[1:] + _HISTOGRAM[:-1])
    normal = np.exp(-0.5 * middle**2) / np.sqrt(2 * np.pi)
    # Evenly spaced quantiles show the tails; fewer than five values lie beyond the farthest one.
    farthest = min(_FARTHEST, -float(scipy.special.ndtri(min(0.4, 5.0 / len(values)))))
    expected = np.linspace(-farthest, farthest, _QUANTILES)
    right, ends = {"xaxis": "x2", "yaxis": "y2"}, [-farthest, farthest]
    grey, points = {"line": {"color": _GREY}}, {"marker": {"color": _BEFORE, "size": 5}}
    data = [
        {"type": "bar", "name": "residual", "marker": {"color": _AFTER}, "x": middle, "y": density},
        {"type": "scatter", "name": "normal distribution", "x": middle, "y": normal, **grey},
        _scatter(
            expected, np.quantile(values, scipy.special.ndtr(expected)), "markers", name="quantiles", **points, **right
        ),
        _scatter(ends, ends, "lines", showlegend=False, **grey, **right),
    ]
    layout = {
        "xaxis": {"domain": [0, 0.46]} | axis("whitened residual"),
        "yaxis": axis("density"),
        "xaxis2": {"domain": [0.56, 1]} | axis("normal quantile"),
        "yaxis2": {"anchor": "x2"} | axis("residual quantile"),
        "bargap": 0,
    }
    caption = (
        "Residual of the fitted readings over all errors of the bench: noise, also that which neighbouring points "
        "share, and the motion of each capture. Right: points on the line are standard normal; a steeper line means "
        "more noise than estimated, bent ends mean heavy tails."
    )
    return Plot("Whitened residual", data, layout, caption, 380)


def captures_plot(
    captures: Sequence[str], rms: Mapping[str, Sequence[float]], caption: str, excluded: Sequence[bool] = ()
) -> Plot:
    """Plot the rms residual of each capture over its noise.

    Args:
        captures: names of the captures.
        rms: rms residual of each capture in units of sigma, by name of the bench.
        caption: one or two sentences.
        excluded: whether each capture was excluded; none was if empty.
    """
    marks = ["x" if each else "circle" for each in excluded] or "circle"
    data = [
        _scatter(list(captures), list(values), "markers", name=name, marker={"color": colour, "symbol": marks})
        for (name, values), colour in zip(rms.items(), (_BEFORE, _AFTER), strict=False)
    ]
    layout = {"yaxis": axis("rms residual (sigma)", log=True) | {"tickvals": _TICKS}}
    layout["xaxis"] = {"showticklabels": False, "showgrid": False} | axis("captures, in the order of the table")
    return Plot("Residual of each capture", data, layout, caption, 340)


def correlations_plot(diagnosis: DiagnosisRecord) -> Plot:
    """Plot the correlations between the fitted values."""
    found = diagnosis.correlations
    data = [
        {"type": "heatmap", "x": found.names, "y": found.names, "z": found.matrix}
        | {"zmin": -1, "zmax": 1, "colorscale": "RdBu", "reversescale": True, "texttemplate": "%{z:.2f}"}
    ]
    layout = {"yaxis": {"autorange": "reversed"}}
    caption = "Correlation coefficients. Near 1 or -1, the readings determine a combination of both values only."
    return Plot("Correlations between the values found", data, layout, caption, 160 + 28 * len(found.names))


def _radial(residual: FloatArray, outwards: FloatArray) -> FloatArray:
    """Return the components (n, 2) of a residual along a direction and across it, clockwise in the image."""
    across = np.stack([-outwards[:, 1], outwards[:, 0]], axis=1)
    return np.stack([np.sum(residual * outwards, axis=1), np.sum(residual * across, axis=1)], axis=1)


def _bins(values: FloatArray) -> tuple[IntArray, IntArray]:
    """Return the bin of each value (n,), and the number of values per bin; a few distinct values get a bin each."""
    distinct = np.unique(np.round(values, 9))
    if len(distinct) <= _BINS:
        edges = 0.5 * (distinct[1:] + distinct[:-1])
    else:
        edges = np.quantile(values, np.linspace(0, 1, _BINS + 1)[1:-1])
    _, index, counts = np.unique(np.searchsorted(edges, values), return_inverse=True, return_counts=True)
    return index.astype(np.int64), counts.astype(np.int64)

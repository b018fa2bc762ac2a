"""Pictures of a diagnosis: residuals over the field, and against each variable, before and after."""

import io
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from wlr_render.diagnosis.field_maps import FieldMap
from wlr_render.diagnosis.report_parts import ReportPart, Variable
from wlr_render.numerics.arrays import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_COLOURS = ("#9ab7d3", "#1f4e79", "#b2182b")  # of small to large arrows
_FIRST, _SECOND, _GREY = "#1f4e79", "#c4651a", "#8c8c8c"
_CELLS = (14, 11)  # arrows across and down
_BINS = 12
_COLUMNS = 4
_BAND = 2.0  # standard errors that count as noise


def png(figure: "Figure") -> bytes:
    """A figure as a PNG file."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    FigureCanvasAgg(figure)
    file = io.BytesIO()
    figure.savefig(file, dpi=100)
    return file.getvalue()


def residual_maps(part: ReportPart) -> "Figure":
    """Arrows over the field, a row of maps for each bench.

    The length of arrows is drawn to each row's own scale; their colour is the same in both.
    """
    from matplotlib.colors import LinearSegmentedColormap, Normalize
    from matplotlib.figure import Figure

    width, height = np.ptp(part.place, axis=0)
    size = (2.7 * len(part.maps) + 1.4, len(part.states) * (2.5 * height / width + 0.6) + 0.4)
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(len(part.states), len(part.maps), squeeze=False, sharex=True, sharey=True)
    rows = [[_cells(part, each, state.on_map) for each in part.maps] for state in part.states]
    sizes = np.concatenate([np.linalg.norm(arrow, axis=1) for row in rows for _, arrow in row])
    norm = Normalize(0.0, float(np.percentile(sizes, 98)), clip=True)
    colours = LinearSegmentedColormap.from_list("size", _COLOURS)
    for state, row, places in zip(part.states, rows, axes, strict=True):
        _arrows(places, row, part.place, {"cmap": colours, "norm": norm})
        places[0].set_ylabel(f"{state.name}\n{part.place_label[1]}", fontsize=8)
        for field, axis in zip(part.maps, places, strict=True):
            rms = float(np.sqrt(np.nanmean(state.on_map[field.rows] ** 2)))
            axis.set_title(f"{field.title}\nrms {rms:.3g} {part.map_unit} per axis", fontsize=8)
            axis.tick_params(labelsize=7)
    axes[0, 0].invert_yaxis()
    axes[0, 0].margins(0.1)
    for axis in axes[-1]:
        axis.set_xlabel(part.place_label[0], fontsize=8)
    drawn = axes[0, 0].collections[0]
    figure.colorbar(drawn, ax=axes, label=f"residual ({part.map_unit})", shrink=0.7, pad=0.01)
    return figure


def residual_curves(part: ReportPart) -> "Figure":
    """Mean residual in bins of each variable, and what its rms has beyond the noise; a row for each bench."""
    from matplotlib.figure import Figure

    blocks, states = -(-len(part.variables) // _COLUMNS), len(part.states)
    figure = Figure(figsize=(11.5, (1.7 * states + 0.2) * blocks + 0.3), layout="constrained")
    axes = figure.subplots(states * blocks, _COLUMNS, squeeze=False)
    # Places (states, variables): each block of rows has one row for each state.
    places = axes.reshape(blocks, states, _COLUMNS).swapaxes(0, 1).reshape(states, blocks * _COLUMNS)
    for state, row in zip(part.states, places, strict=True):
        curves = [_curve(variable, state.seen, part.sigma_arcmin) for variable in part.variables]
        top = 1.1 * max((curve.top for curve in curves), default=1.0)
        for variable, curve, axis in zip(part.variables, curves, row, strict=False):
            _draw_curve(axis, curve)
            if variable.outwards is not None:
                axis.set_title("outwards / around", fontsize=7, loc="right", pad=2, color=_GREY)
            axis.set_ylim(-top, top)
            axis.set_title(state.name, fontsize=7, loc="left", pad=2, color=_GREY)
            axis.tick_params(labelsize=7, labelbottom=state is part.states[-1])
        for axis in row[::_COLUMNS]:
            axis.set_ylabel("arcmin", fontsize=8)
        for axis in row[len(part.variables) :]:
            axis.set_axis_off()
    for variable, axis in zip(part.variables, places[-1], strict=False):
        axis.set_xlabel(variable.name, fontsize=8)
    handles = axes[0, 0].get_legend_handles_labels()
    figure.legend(*handles, loc="outside upper center", ncols=4, fontsize=8, frameon=False)
    return figure


def _arrows(
    axes: Iterable["Axes"], cells: Iterable[tuple[FloatArray, FloatArray]], place: FloatArray, style: dict[str, Any]
) -> None:
    """One row of maps: the longest arrows span somewhat more than a cell."""
    cells = list(cells)
    pitch = float(np.min(np.ptp(place, axis=0) / _CELLS))
    longest = float(np.percentile(np.concatenate([np.linalg.norm(arrow, axis=1) for _, arrow in cells]), 95))
    for axis, (at, arrow) in zip(axes, cells, strict=True):
        length = np.linalg.norm(arrow, axis=1)
        scale = max(longest, 1e-9) / (1.6 * pitch)
        axis.quiver(*at.T, *arrow.T, length, angles="xy", scale_units="xy", scale=scale, width=0.006, **style)
        axis.set_aspect("equal")


def _cells(part: ReportPart, field: FieldMap, residual: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean place (k, 2) and residual (k, 2) of the readings in each cell of a grid over the field."""
    rows = field.rows & np.isfinite(residual).all(axis=1)
    place, own = part.place[rows], residual[rows]
    low, high = part.place.min(axis=0), part.place.max(axis=0)
    cell = np.minimum((place - low) / (high - low).clip(1e-12) * _CELLS, np.array(_CELLS) - 1).astype(int)
    _, index, counts = np.unique(cell[:, 0] * _CELLS[1] + cell[:, 1], return_inverse=True, return_counts=True)
    means = [np.bincount(index, values) / counts for values in (*place.T, *own.T)]
    return np.stack(means[:2], axis=1), np.stack(means[2:], axis=1)


@dataclass(frozen=True, eq=False)
class _Curve:
    """Residuals in bins of a variable.

    Attributes:
        middle: (k,) of the bins, by the variable.
        means: (2, k) of both components.
        band: (k,) how far noise alone would move a mean.
        excess: (k,) rms of the readings beyond what noise alone would give.
    """

    middle: FloatArray
    means: FloatArray
    band: FloatArray
    excess: FloatArray

    @property
    def top(self) -> float:
        """What an axis must hold."""
        return float(max(np.max(np.abs(self.means)), np.max(self.excess), 1.5 * np.max(self.band)))


def _curve(variable: Variable, residual: FloatArray, sigma: float) -> _Curve:
    good = np.isfinite(residual).all(axis=1)
    along = residual[good] if variable.outwards is None else _radial(residual[good], variable.outwards[good])
    index, counts = _bins(variable.values[good])
    square = np.bincount(index, np.mean(along**2, axis=1)) / counts
    return _Curve(
        middle=np.bincount(index, variable.values[good]) / counts,
        means=np.stack([np.bincount(index, component) / counts for component in along.T]),
        band=_BAND * sigma / np.sqrt(counts),
        # The mean square of n readings of two components scatters by sigma^2 / sqrt(n).
        excess=np.sqrt(np.clip(square - sigma**2 * (1.0 + _BAND / np.sqrt(counts)), 0.0, None)),
    )


def _draw_curve(axis: "Axes", curve: _Curve) -> None:
    axis.fill_between(curve.middle, -curve.band, curve.band, color="0.85", label="noise of a mean", linewidth=0)
    axis.plot(curve.middle, curve.excess, color=_GREY, linewidth=1.0, label="rms beyond the noise")
    for mean, colour, label in zip(
        curve.means, (_FIRST, _SECOND), ("mean, right or outwards", "mean, down or around"), strict=True
    ):
        axis.plot(curve.middle, mean, color=colour, marker="o", markersize=2.5, linewidth=1.0, label=label)


def _radial(residual: FloatArray, outwards: FloatArray) -> FloatArray:
    """Components (n, 2) along a direction and across it, clockwise in the image."""
    across = np.stack([-outwards[:, 1], outwards[:, 0]], axis=1)
    return np.stack([np.sum(residual * outwards, axis=1), np.sum(residual * across, axis=1)], axis=1)


def _bins(values: FloatArray) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Bin of each value (n,), few distinct values each their own, and how many each bin has."""
    distinct = np.unique(np.round(values, 9))
    if len(distinct) <= _BINS:
        edges = 0.5 * (distinct[1:] + distinct[:-1])
    else:
        edges = np.quantile(values, np.linspace(0, 1, _BINS + 1)[1:-1])
    _, index, counts = np.unique(np.searchsorted(edges, values), return_inverse=True, return_counts=True)
    return index.astype(np.int64), counts.astype(np.int64)

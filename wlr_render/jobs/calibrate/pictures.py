"""A calibration from photographs in pictures."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.correspondences import DisplayCaptures, SeeThroughCaptures
from wlr_render.captures.decoded import Rejection
from wlr_render.files import write_figure
from wlr_render.geometry.directions import arcmin_between, tangents_of_dir
from wlr_render.jobs.calibrate.photos import SessionCalibration
from wlr_render.jobs.decode.pictures import fate_colours
from wlr_render.numerics.arrays import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_ACROSS = 6  # small pictures side by side
_ARROWS = 350  # of a small picture
_SEEN_PX = 0.05  # of a small picture's width: how long the usual arrow is drawn


def draw_coverage(path: Path, found: SessionCalibration) -> Path:
    """Camera places with the eye box, the panel as it was decoded, and the directions in which targets were seen."""
    figure, (places, panel, world) = _figure(1, 3, (13.5, 4.2))
    box, display, see_through = found.session.eye_box, found.captures.display, found.captures.see_through
    assert see_through is not None
    x, y = 1e3 * np.unique(display.viewpoint, axis=0)[:, :2].T
    places.plot(x, y, "o", label="panel")
    x, y = 1e3 * np.unique(see_through.viewpoint, axis=0)[:, :2].T
    places.plot(x, y, "+", markersize=10, label="through the optics")
    (left, bottom), (width, height) = 1e3 * (box.centre - box.size / 2)[:2], 1e3 * box.size[:2]
    places.plot(
        left + width * np.array([0, 1, 1, 0, 0]), bottom + height * np.array([0, 0, 1, 1, 0]), "k-", label="eye box"
    )
    places.set(xlabel="x (mm)", ylabel="y (mm)", title="camera places", aspect="equal")
    places.legend(fontsize=7, loc="upper center", bbox_to_anchor=(0.5, -0.18), ncols=3)
    size = found.session.pattern.panel.size_px
    u, v = display.pixel.T
    counts, _, _ = np.histogram2d(u, v, bins=(48, 27), range=[(0.0, float(size[0])), (0.0, float(size[1]))])
    drawn = panel.imshow(counts.T, extent=(0, size[0], size[1], 0), cmap="viridis")
    figure.colorbar(drawn, ax=panel, shrink=0.7, label="samples")
    panel.set(xlabel="u (px)", ylabel="v (px)", title="panel positions decoded, all places together")
    for pose in np.unique(see_through.target_pose):
        tangents = see_through.tangents[see_through.target_pose == pose]
        world.plot(*np.rad2deg(np.arctan(tangents)).T, ".", markersize=1, label=f"target pose {pose}")
    seen = np.rad2deg(np.arctan(display.tangents))
    low, high = seen.min(axis=0), seen.max(axis=0)
    world.plot(
        [low[0], high[0], high[0], low[0], low[0]], [low[1], low[1], high[1], high[1], low[1]], "k-", label="panel"
    )
    world.set(xlabel="to the right (degrees)", ylabel="up (degrees)", title="where dots were seen", aspect="equal")
    world.legend(fontsize=7, markerscale=8, loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=3)
    return write_figure(path, figure, 110)


def draw_fates(path: Path, found: SessionCalibration) -> Path:
    """Of every set of code photographs, what became of each camera pixel."""
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch

    colours = fate_colours()
    colour_map = ListedColormap(colours)
    sets = found.reading.decoded(found.session.display)
    figure, axes = _grid(len(sets))
    for drawn, (each, panel) in zip(axes, sets, strict=False):
        drawn.imshow(panel.fates, cmap=colour_map, vmin=-0.5, vmax=len(colours) - 0.5, interpolation="nearest")
        drawn.set_title(found.session.name_of(each.folder), fontsize=7)
    present = sorted({int(fate) for _, panel in sets for fate in np.unique(panel.fates)})
    names = [Rejection(fate).name.lower().replace("_", " ") for fate in present]
    patches = [Patch(color=colours[fate], label=name) for fate, name in zip(present, names, strict=True)]
    figure.legend(handles=patches, loc="outside lower center", ncols=len(patches), fontsize=8)
    return write_figure(path, figure, 110)


def draw_display_residuals(path: Path, found: SessionCalibration) -> Path:
    """Of each camera place, by how much the fitted display model misses what was decoded, over the panel."""
    captures = found.captures.display
    seen = found.fit.mappings.display.view_dir_of_pixel(captures.pixel, captures.viewpoint)
    title = "Display: direction measured minus modelled, over the panel, one picture a camera place"
    label = np.array([f"place {capture:02d}" for capture in captures.capture])
    return _residuals(path, captures, captures.pixel, seen.value, label, title, down=True)


def draw_see_through_residuals(path: Path, found: SessionCalibration) -> Path:
    """Of each camera place and target pose, by how much the fitted see-through model misses the dots."""
    captures = found.captures.see_through
    assert captures is not None
    seen = found.fit.mappings.see_through.view_dir_of_real_point(captures.point, captures.viewpoint)
    place = np.rad2deg(np.arctan(captures.tangents))
    rows = zip(captures.target_pose, captures.capture, strict=True)
    label = np.array([f"target {pose}, place {capture:02d}" for pose, capture in rows])
    title = "See-through: direction measured minus modelled, over the field in degrees, one picture a place and target"
    return _residuals(path, captures, place, seen.value, label, title, down=False)


def draw_degrees(path: Path, found: SessionCalibration) -> Path:
    """Error at held-out camera positions by degree, with the degree in use."""
    figure, axes = _figure(1, 2, (9.0, 3.6))
    for drawn, name, report in (
        (axes[0], "display", found.fit.display),
        (axes[1], "see-through", found.fit.see_through),
    ):
        tried = report.held_out_arcmin
        degrees = [entry.degree for entry in tried]
        drawn.errorbar(degrees, [entry.rms for entry in tried], [entry.standard_error for entry in tried], fmt="o-")
        drawn.xaxis.get_major_locator().set_params(integer=True)
        drawn.axvline(report.degree, color="0.6", linestyle="--", label=f"in use: N={report.degree}")
        drawn.set(xlabel="degree N", ylabel="held-out rms (arcmin)", title=name)
        if tried:
            drawn.set_yscale("log")
        drawn.legend(fontsize=8)
    return write_figure(path, figure, 110)


def _residuals(
    path: Path,
    captures: DisplayCaptures | SeeThroughCaptures,
    place: FloatArray,
    modelled: FloatArray,
    label: NDArray[np.str_],
    title: str,
    down: bool,
) -> Path:
    """Arrows of residuals at places (n, 2), one small picture for each label (n,); all have one scale."""
    apart = captures.tangents - tangents_of_dir(modelled)
    size = arcmin_between(captures.view_dir, modelled)
    # As long as the angle, whatever a tangent is worth so far off the axis.
    residual = apart * (size / np.maximum(np.linalg.norm(apart, axis=1), 1e-12))[:, None]
    usual = max(float(np.nanquantile(size, 0.9)), 1e-3)
    labels = np.unique(label)
    figure, axes = _grid(len(labels))
    low, high = place.min(axis=0), place.max(axis=0)
    for drawn, one in zip(axes, labels, strict=False):
        rms = float(np.sqrt(np.nanmean(size[label == one] ** 2)))
        rows = np.flatnonzero(label == one)
        rows = rows[:: max(1, len(rows) // _ARROWS)]
        arrow = residual[rows] * [1.0, -1.0 if down else 1.0]
        scale = usual / (_SEEN_PX * float(high[0] - low[0]))
        drawn.quiver(
            *place[rows].T,
            *arrow.T,
            size[rows],
            angles="xy",
            scale_units="xy",
            scale=scale,
            cmap="viridis",
            width=0.004,
        ).set_clim(0, usual)
        drawn.set(xlim=(low[0], high[0]), ylim=(high[1], low[1]) if down else (low[1], high[1]), aspect="equal")
        drawn.set_title(f"{one}: {rms:.2f}' rms", fontsize=7)
    figure.suptitle(f"{title}; yellow is {usual:.2g}' and more", fontsize=9)
    return write_figure(path, figure, 110)


def _grid(count: int) -> "tuple[Figure, list[Axes]]":
    rows = -(-count // _ACROSS)
    figure, axes = _figure(rows, _ACROSS, (13.5, 1.9 * rows + 0.8))
    for drawn in axes:
        drawn.set_xticks([])
        drawn.set_yticks([])
    for unused in axes[count:]:
        unused.set_axis_off()
    return figure, axes


def _figure(rows: int, columns: int, size: tuple[float, float]) -> "tuple[Figure, list[Any]]":
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    return figure, list(figure.subplots(rows, columns, squeeze=False).ravel())

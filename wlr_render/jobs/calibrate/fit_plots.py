"""Figures of a fit: maps of the predicted error, and plots of the residuals by camera position."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from wlr_render.calibration.fit_eye import Calibration
from wlr_render.captures.correspondences import Captures, DisplayCaptures, SeeThroughCaptures
from wlr_render.geometry.directions import arcmin_between, tangents_of_dir
from wlr_render.mappings import Status
from wlr_render.models.fitted_model import FittedDisplay
from wlr_render.numerics.arrays import FloatArray
from wlr_render.report.blocks import Plot
from wlr_render.report.plots import arrow_map, bars, heat_map

_CELLS = 48  # number of cells of a map across the panel
_CORNERS = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)


def predicted_maps(display: FittedDisplay) -> list[Plot]:
    """Return maps of the predicted error over the panel, from the eye box's centre and from its worst corner."""
    width, height = display.panel.size_px
    cell = width / _CELLS
    u, v = ((np.arange(int(np.ceil(size / cell - 1e-9))) + 0.5) * cell for size in (width, height))
    pixel = np.stack(np.meshgrid(np.minimum(u, width), np.minimum(v, height)), axis=-1)
    centre = _predicted(display, pixel, display.eye_box.centre)
    corner = max(
        (_predicted(display, pixel, viewpoint) for viewpoint in display.eye_box.at(_CORNERS)),
        key=lambda sigma: float(np.nansum(sigma**2)),
    )
    known = np.concatenate([centre, corner])
    known = known[np.isfinite(known)]
    limits = (0.0, float(np.quantile(known, 0.98))) if known.size else None
    caption = "Standard error of a pixel's direction according to the fit; blank outside the fit."
    return [
        heat_map(
            f"Predicted error of the display at the eye box's {place}",
            sigma,
            "arcmin",
            limits=limits,
            cell=cell,
            caption=caption,
        )
        for place, sigma in (("centre", centre), ("worst corner", corner))
    ]


def _predicted(display: FittedDisplay, pixel: FloatArray, viewpoint: FloatArray) -> FloatArray:
    status = display.view_dir_of_pixel(pixel, viewpoint).status
    return np.where(status == Status.OK, display.sigma(pixel, viewpoint), np.nan)


def residual_plots(fit: Calibration, captures: Captures, display_names: Sequence[str]) -> list[Plot]:
    """Return bars of the residual by camera position (and target pose), and maps of the residuals.

    Args:
        fit: the models.
        captures: the fitted captures.
        display_names: names of the display's camera positions; empty to number them.
    """
    parts = {"display": captures.display, "see-through": captures.see_through}
    caption = (
        "A residual far above the others means that the camera or the headset moved, that an entry is wrong, or that "
        "the model cannot represent the optics there."
    )
    plots, maps = [], []
    for name, side in fit.sides.items():
        part = parts[name]
        assert part is not None
        residual, names = _residuals(part, side.seen(part).value), position_names(part, display_names)
        on_panel = isinstance(part, DisplayCaptures)
        place = part.pixel if isinstance(part, DisplayCaptures) else np.rad2deg(np.arctan(part.tangents))
        groups = {each: (place[names == each], residual[names == each]) for each in np.unique(names)}
        rms = [float(np.sqrt(np.nanmean(np.sum(arrow**2, axis=1)))) for _, arrow in groups.values()]
        title = f"Residual of the {name}, by camera position"
        plots.append(bars(title, list(groups), {name: rms}, "rms (arcmin)", caption=caption))
        maps.append(
            arrow_map(
                f"Residual map of the {name}",
                groups,
                "arcmin",
                ("u (px)", "v (px)") if on_panel else ("to the right (degrees)", "up (degrees)"),
                y_down=on_panel,
                caption=f"Direction measured minus modelled, over the {'panel' if on_panel else 'field of view'}.",
            )
        )
    return plots + maps


def _residuals(captures: DisplayCaptures | SeeThroughCaptures, modelled: FloatArray) -> FloatArray:
    """Return residuals (n, 2), right and up in arcminutes; the length is the angle between the directions."""
    apart = captures.tangents - tangents_of_dir(modelled)
    size = arcmin_between(captures.view_dir, modelled)
    return np.asarray(apart * (size / np.maximum(np.linalg.norm(apart, axis=1), 1e-12))[:, None])


def position_names(captures: DisplayCaptures | SeeThroughCaptures, display_names: Sequence[str]) -> NDArray[np.str_]:
    """Return the name (n,) of each reading's camera position, with its target pose if any."""
    if isinstance(captures, DisplayCaptures):
        return np.array([display_names[each] if display_names else f"position {each:02d}" for each in captures.capture])
    visits = zip(captures.target_pose, captures.capture, strict=True)
    return np.array([f"target {pose}, position {capture:02d}" for pose, capture in visits])

"""The error budget of one eye over its panel and eye box, and the disparity error of both eyes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from wlr_render.budget.error_sizes import ErrorSizes
from wlr_render.budget.registration_budget import disparity_covariance, registration_covariance
from wlr_render.budget.statement import REGIONS, SourceShare, by_owner, radius_within, region_of, shares, variance
from wlr_render.errors import BadInputError
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.viewpoints import volumetric

PANEL_CELLS = 24
"""Cells across the panel of the maps of a budget."""
_VIEWPOINTS = 16


@dataclass(frozen=True, eq=False)
class EyeBudget:
    """Error budget of one eye.

    Attributes:
        eye: "left" or "right".
        region: region of the budget, in words.
        radius_arcmin: radius that contains 95 % of the errors.
        rms_arcmin, worst_arcmin: rms length over all errors, and largest rms length.
        owners, sources: contributions, largest first.
        regions: radius by region of the panel.
        sizes: sizes of the errors, except model errors.
        left_out: share of the field's pixels and viewpoints that need extrapolation or have no answer.
        radius_map: (rows, columns) radius by panel cell.
        rms_maps: rms of each source by panel cell.
    """

    eye: str
    region: str
    radius_arcmin: float
    rms_arcmin: float
    worst_arcmin: float
    owners: list[SourceShare]
    sources: list[SourceShare]
    regions: dict[str, float]
    sizes: ErrorSizes
    left_out: float
    radius_map: FloatArray
    rms_maps: dict[str, FloatArray]


def eye_budget(eye: Eye, depth_m: float, sizes: ErrorSizes, in_camera_frame: bool = False) -> EyeBudget:
    """Compute the budget of an eye over its eye box and nominal field, or its panel if it states no field.

    Args:
        eye: display and see-through mappings.
        depth_m: depth of the real points.
        sizes: sizes of the errors, except model errors.
        in_camera_frame: see `RegistrationCovariance.in_camera_frame`.

    Raises:
        BadInputError: a model without covariance, or an eye that sees no pixel.
    """
    panel = eye.display.panel
    pixel = panel.grid(PANEL_CELLS, max(4, round(PANEL_CELLS * panel.height_px / panel.width_px)))
    viewpoint = volumetric(eye.eye_box, _VIEWPOINTS)[:, None, None]
    found = registration_covariance(eye, pixel, viewpoint, depth_m, sizes)
    found = found.in_camera_frame() if in_camera_frame else found
    known = found.is_inside & np.isfinite(found.total).all(axis=(-2, -1))
    wanted = np.ones(known.shape, bool) if eye.field is None else eye.field.contains(found.view_dir)
    known &= wanted
    if not known.any():
        raise BadInputError(f"{eye.name}: no pixel is seen at {depth_m:g} m from the eye box; check depth and model.")
    total = np.where(known[..., None, None], found.total, np.nan)
    of_pixels = np.moveaxis(total, 0, 2)  # a population is all viewpoints
    seen = known.any(axis=0)
    radius = np.full(seen.shape, np.nan)
    radius[seen] = radius_within(of_pixels[seen])
    maps = {}
    for name, each in found.by_source.items():
        squared = np.where(known, variance(each), 0.0).sum(axis=0)
        maps[name] = np.where(seen, np.sqrt(squared / np.maximum(known.sum(axis=0), 1)), np.nan)
    by_source = {name: each[known] for name, each in found.by_source.items()}
    region = np.broadcast_to(region_of(panel, pixel), known.shape)
    regions = {
        name: float(radius_within(total[known & (region == number)]))
        for number, name in enumerate(REGIONS)
        if np.any(known & (region == number))
    }
    own_field = None if eye.field is None else f"the nominal field of view ({eye.field})"
    return EyeBudget(
        eye.eye,
        f"{own_field or 'the whole panel'} and an eye box of {_millimetres(eye.eye_box.size)}",
        float(radius_within(total[known])),
        float(np.sqrt(variance(total[known]).mean())),
        float(np.sqrt(variance(total[known]).max())),
        shares(by_owner(by_source)),
        shares(by_source),
        regions,
        sizes,
        1.0 - float(known.sum() / wanted.sum()),
        radius,
        maps,
    )


@dataclass(frozen=True)
class DisparityShare:
    """Rms horizontal and vertical disparity error from one source, arcminutes."""

    source: str
    horizontal_arcmin: float
    vertical_arcmin: float


def disparity_shares(eyes: Sequence[Eye], sizes: Sequence[ErrorSizes], depth_m: float) -> list[DisparityShare]:
    """Return the disparity error by source, averaged over the first eye's panel and both eye boxes."""
    viewpoints = [volumetric(eye.eye_box, _VIEWPOINTS)[:, None] for eye in eyes]
    first = registration_covariance(
        eyes[0], eyes[0].display.panel.grid(12, 8).reshape(-1, 2), eyes[0].eye_box.centre, depth_m, ErrorSizes()
    )
    by_source = disparity_covariance(eyes, first.point[first.is_inside], viewpoints, sizes)
    found = [(name, np.nanmean(each, axis=(0, 1))) for name, each in by_source.items()]
    found.append(("all", np.asarray(sum(each for _, each in found))))
    return [DisparityShare(name, float(each[0, 0]) ** 0.5, float(each[1, 1]) ** 0.5) for name, each in found]


def _millimetres(size_m: FloatArray) -> str:
    return " x ".join(f"{1e3 * each:g}" for each in size_m) + " mm"

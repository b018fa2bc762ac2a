"""Coarse maps of the predicted registration error of a frame, interpolated between covariances over the eye box.

The covariance of a pixel is smooth in the viewpoint and, where parallax is linear in inverse depth, quadratic in
inverse depth. It is computed once, at Chebyshev nodes of both; a map is then one product with a small table.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from wlr_render.budget.error_sizes import ErrorSizes
from wlr_render.budget.registration_budget import MODEL, registration_covariance
from wlr_render.budget.statement import SourceShare, radius_within, shares, variance
from wlr_render.draw.sampling import bilinear_at
from wlr_render.geometry.directions import dir_of_tangents, tangents_of_dir
from wlr_render.mappings import Eye, Panel
from wlr_render.numerics import chebyshev
from wlr_render.numerics.arrays import BoolArray, Float32Array, FloatArray

_COLUMNS, _ROWS = 18, 16  # cells of a map
_VIEWPOINTS = 3  # Chebyshev nodes along each axis of the eye box
_DEPTHS = 3  # Chebyshev nodes in inverse depth; three determine a quadratic
_FAR_M = 1e6  # depth used for infinity: a centimetre at this depth is far below any error
_NEAREST_PER_M = 5.0  # inverse of 0.2 m; nearer points follow the same quadratic


@dataclass(frozen=True, eq=False)
class PredictedError:
    """Predicted registration error of one eye's frame.

    Attributes:
        panel: the panel of the eye.
        covariance: (rows, columns, 2, 2) square arcminutes at the pixels `ErrorMap.pixel`, along the axes right and up
            perpendicular to the view direction; NaN where the eye does not see the pixel or the point.
        in_field: (rows, columns) True where the pixel lies in the nominal field of view; True everywhere if the headset
            states no field of view.
        by_source: () -> the covariances whose sum is `covariance`, by the names of `RegistrationCovariance.by_source`.
    """

    panel: Panel
    covariance: FloatArray
    in_field: BoolArray
    by_source: Callable[[], Mapping[str, FloatArray]]

    @cached_property
    def rms_map_arcmin(self) -> Float32Array:
        """Rms length of the error, (rows, columns) arcminutes."""
        return np.sqrt(np.maximum(variance(self.covariance), 0.0)).astype(np.float32)

    @property
    def map_arcmin(self) -> Float32Array:
        """Rms of the horizontal and vertical components and of the length, (rows, columns, 3) arcminutes."""
        along = np.sqrt(np.maximum(np.diagonal(self.covariance, axis1=-2, axis2=-1), 0.0))
        return np.concatenate([along.astype(np.float32), self.rms_map_arcmin[..., None]], axis=-1)

    @property
    def rms_arcmin(self) -> float:
        """Rms length of the error over the field of view; NaN if no pixel has an error."""
        of_field = self.covariance[self._counted]
        return float(np.sqrt(variance(of_field).mean())) if len(of_field) else np.nan

    @property
    def radius_arcmin(self) -> float:
        """Radius that contains 95 % of the errors over the field of view; NaN if no pixel has an error."""
        of_field = self.covariance[self._counted]
        return float(radius_within(of_field)) if len(of_field) else np.nan

    @cached_property
    def sources(self) -> list[SourceShare]:
        """Contribution of each source over the field of view, largest first; empty if no pixel has an error.

        Sources of zero are left out, except those of the model.
        """
        if not self._counted.any():
            return []
        found = shares({name: each[self._counted] for name, each in self.by_source().items()})
        return [each for each in found if each.rms_arcmin > 0 or each.name.startswith(MODEL)]

    @property
    def record(self) -> dict[str, Any]:
        """Rms and radius over the field of view, None if no pixel has an error, and rms of each source; plain JSON."""
        values = {"rms_arcmin": self.rms_arcmin, "radius_arcmin": self.radius_arcmin}
        sources = [{"name": each.name, "rms_arcmin": each.rms_arcmin} for each in self.sources]
        return {name: value if np.isfinite(value) else None for name, value in values.items()} | {"sources": sources}

    @property
    def _counted(self) -> BoolArray:
        return np.asarray(self.in_field & np.isfinite(self.covariance).all(axis=(-2, -1)))

    def at_pixel(self, pixel: FloatArray) -> FloatArray:
        """Return the rms length of the error (n,) in arcminutes at pixels (n, 2), by bilinear interpolation."""
        rows, columns = self.rms_map_arcmin.shape
        u, v = (np.asarray(pixel) * [columns, rows] / self.panel.size_px).astype(np.float32).T
        return bilinear_at(self.rms_map_arcmin, u, v).astype(np.float64)


def predicted_error(eye: Eye, sizes: ErrorSizes, viewpoint: FloatArray, depth_m: float) -> PredictedError:
    """Predict the registration error for one viewpoint and depth, without interpolation; see `ErrorMap`.

    Pixels outside the fitted range of the models do not count as in the field. An infinite depth is allowed.

    Raises:
        BadInputError: a fitted model has no covariance.
    """
    panel = eye.display.panel
    found = registration_covariance(eye, panel.grid(_COLUMNS, _ROWS), viewpoint, min(depth_m, _FAR_M), sizes)
    in_field = found.is_inside if eye.field is None else found.is_inside & eye.field.contains(found.view_dir)
    return PredictedError(panel, found.total, in_field, lambda: found.by_source)


class ErrorMap:
    """Predictor of the registration error of an eye's frames; the constructor takes a few seconds, `at` 0.1 ms.

    The model's covariance rises at the borders of the panel and the eye box, where interpolation is least accurate.
    docs/budget.md states the interpolation errors relative to `registration_covariance`.

    Attributes:
        pixel: (rows, columns, 2) panel pixels of the maps: centres of equal cells.
    """

    def __init__(self, eye: Eye, sizes: ErrorSizes, columns: int = _COLUMNS, rows: int = _ROWS) -> None:
        """Compute the covariances over eye box, panel and depth.

        Args:
            eye: display and see-through mappings; the model error of exact mappings is zero.
            sizes: sizes of the errors, except model errors.
            columns, rows: size of the maps.

        Raises:
            BadInputError: a fitted model has no covariance.
        """
        self._panel, self._box, self._field = eye.display.panel, eye.eye_box, eye.field
        self.pixel = self._panel.grid(columns, rows)
        unit = chebyshev.nodes(_VIEWPOINTS, -1.0, 1.0)
        viewpoint = self._box.at(np.stack(np.meshgrid(unit, unit, unit, indexing="ij"), axis=-1).reshape(-1, 3))
        depth_m = 1.0 / chebyshev.nodes(_DEPTHS, 0.0, _NEAREST_PER_M)
        budget = registration_covariance(
            eye, self.pixel[:, :, None], viewpoint[:, None, None, None], depth_m, sizes
        )  # (viewpoints, rows, columns, depths)
        self._covariance = budget.total.reshape(len(viewpoint), -1)
        self._by_source = {name: each.reshape(len(viewpoint), -1) for name, each in budget.by_source.items()}
        self._tangents = tangents_of_dir(budget.view_dir[..., 0, :]).reshape(len(viewpoint), -1)

    def at(self, viewpoint: FloatArray, depth_m: float | FloatArray) -> PredictedError:
        """Predict the registration error of a frame.

        Args:
            viewpoint: (3,) viewpoint that the frame was drawn for, device frame, metres. A viewpoint outside the eye
                box is replaced by the nearest one inside.
            depth_m: depth of the real points in front of the viewpoint, along the device's z axis: one value, or
                (rows, columns) at `pixel`. Infinite and NaN values are allowed.
        """
        unit = np.clip((viewpoint - self._box.centre) / (0.5 * self._box.size), -1.0, 1.0)
        x, y, z = chebyshev.interpolation_matrix(_VIEWPOINTS, -1.0, 1.0, unit)
        weight = np.einsum("i,j,k->ijk", x, y, z).reshape(-1)
        shape = self.pixel.shape[:2]
        per_m = np.broadcast_to(1.0 / np.asarray(depth_m, np.float64), shape)
        by_depth = chebyshev.interpolation_matrix(_DEPTHS, 0.0, _NEAREST_PER_M, per_m.reshape(-1))

        def interpolated(covariance: FloatArray) -> FloatArray:
            nodes = (weight @ covariance).reshape(-1, _DEPTHS, 4)
            return np.asarray(np.einsum("nd,ndk->nk", by_depth, nodes).reshape(*shape, 2, 2))

        in_field = np.ones(shape, bool)
        if self._field is not None:
            in_field = self._field.contains(dir_of_tangents((weight @ self._tangents).reshape(*shape, 2)))
        return PredictedError(
            self._panel,
            interpolated(self._covariance),
            in_field,
            lambda: {name: interpolated(each) for name, each in self._by_source.items()},
        )

"""Predicted registration error beside each frame: coarse maps, interpolated from covariances over the eye box.

The covariance of a pixel is smooth in the viewpoint, and quadratic in the inverse depth as far as parallax is linear in
it. It is computed once, at Chebyshev nodes of both; a map is then one product with a small table.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from wlr_render.budget.error_sizes import ErrorSizes
from wlr_render.budget.registration_budget import registration_covariance
from wlr_render.budget.statement import radius_within, variance
from wlr_render.geometry.directions import dir_of_tangents, tangents_of_dir
from wlr_render.mappings import Eye, Panel
from wlr_render.numerics import chebyshev
from wlr_render.numerics.arrays import BoolArray, Float32Array, FloatArray
from wlr_render.rendering.sampling import bilinear_at

_VIEWPOINTS = 3  # along each axis of the eye box
_DEPTHS = 3  # inverse ones, of which the covariance is a quadratic
_NEAREST_PER_M = 5.0  # 0.2 m; nearer points follow the same quadratic


@dataclass(frozen=True, eq=False)
class PredictedError:
    """Predicted registration error of one eye's frame.

    Attributes:
        panel: of the eye.
        covariance: (rows, columns, 2, 2) square arcminutes, along the axes right and up, perpendicular to the view
            direction, of the pixels `ErrorMap.pixel`; NaN where the eye does not see pixel or point.
        in_field: (rows, columns) whether the pixel lies in the nominal field of view, everywhere if there is none.
    """

    panel: Panel
    covariance: FloatArray
    in_field: BoolArray

    @cached_property
    def rms_map_arcmin(self) -> Float32Array:
        """(rows, columns), rms length of the error."""
        return np.sqrt(np.maximum(variance(self.covariance), 0.0)).astype(np.float32)

    @property
    def map_arcmin(self) -> Float32Array:
        """(rows, columns, 3): rms to the right, upwards and of the length."""
        along = np.sqrt(np.maximum(np.diagonal(self.covariance, axis1=-2, axis2=-1), 0.0))
        return np.concatenate([along.astype(np.float32), self.rms_map_arcmin[..., None]], axis=-1)

    @property
    def rms_arcmin(self) -> float:
        """Rms length of the error over the field of view; NaN if no pixel has one."""
        return float(np.sqrt(variance(self._of_field).mean())) if len(self._of_field) else np.nan

    @property
    def radius_arcmin(self) -> float:
        """Radius within which 95 % of the errors lie over the field of view; NaN if no pixel has one."""
        return float(radius_within(self._of_field)) if len(self._of_field) else np.nan

    @property
    def _of_field(self) -> FloatArray:
        return self.covariance[self.in_field & np.isfinite(self.covariance).all(axis=(-2, -1))]

    def at_pixel(self, pixel: FloatArray) -> FloatArray:
        """Rms length of the error (n,) at pixels (n, 2), bilinear in the map; arcminutes."""
        rows, columns = self.rms_map_arcmin.shape
        u, v = (np.asarray(pixel) * [columns, rows] / self.panel.size_px).astype(np.float32).T
        return bilinear_at(self.rms_map_arcmin, u, v).astype(np.float64)


class ErrorMap:
    """Predicted registration error of an eye's frames; `at` takes 0.1 ms, the constructor some seconds.

    The errors of interpolation, against `registration_covariance`, are those of the model's covariance, which rises
    at the borders of panel and eye box; docs/budget.md states them.

    Attributes:
        pixel: (rows, columns, 2) panel pixels of the maps: centres of equal cells.
    """

    def __init__(self, eye: Eye, sizes: ErrorSizes, columns: int = 18, rows: int = 16) -> None:
        """Compute covariances over eye box, panel and depth.

        Args:
            eye: both mappings; exact ones have no errors of their own.
            sizes: of all errors but those of the models.
            columns, rows: of the maps.

        Raises:
            BadInputError: a fitted model without covariance.
        """
        self._panel, self._box, self._field = eye.display.panel, eye.eye_box, eye.field
        self.pixel = self._panel.grid(columns, rows)
        unit = chebyshev.nodes(_VIEWPOINTS, -1.0, 1.0)
        viewpoint = self._box.at(np.stack(np.meshgrid(unit, unit, unit, indexing="ij"), axis=-1).reshape(-1, 3))
        depth_m = 1.0 / chebyshev.nodes(_DEPTHS, 0.0, _NEAREST_PER_M)
        found = registration_covariance(
            eye, self.pixel[:, :, None], viewpoint[:, None, None, None], depth_m, sizes
        )  # (viewpoints, rows, columns, depths)
        self._covariance = found.total.reshape(len(viewpoint), -1)
        self._tangents = tangents_of_dir(found.view_dir[..., 0, :]).reshape(len(viewpoint), -1)

    def at(self, viewpoint: FloatArray, depth_m: float | FloatArray) -> PredictedError:
        """Predicted error of a frame.

        Args:
            viewpoint: (3,) that the frame was drawn for, device frame, metres. Outside the eye box the nearest one
                inside counts.
            depth_m: of the real points in front of the viewpoint, along the device's z axis: one, or (rows, columns) of
                `pixel`; infinite and NaN ones may be among them.
        """
        unit = np.clip((viewpoint - self._box.centre) / (0.5 * self._box.size), -1.0, 1.0)
        x, y, z = chebyshev.interpolation_matrix(_VIEWPOINTS, -1.0, 1.0, unit)
        weight = np.einsum("i,j,k->ijk", x, y, z).reshape(-1)
        shape = self.pixel.shape[:2]
        per_m = np.broadcast_to(1.0 / np.asarray(depth_m, np.float64), shape)
        by_depth = chebyshev.interpolation_matrix(_DEPTHS, 0.0, _NEAREST_PER_M, per_m.reshape(-1))
        nodes = (weight @ self._covariance).reshape(-1, _DEPTHS, 4)
        covariance = np.einsum("nd,ndk->nk", by_depth, nodes).reshape(*shape, 2, 2)
        in_field = np.ones(shape, bool)
        if self._field is not None:
            in_field = self._field.contains(dir_of_tangents((weight @ self._tangents).reshape(*shape, 2)))
        return PredictedError(self._panel, covariance, in_field)

"""A lens described by a spline: mrcal's model LENSMODEL_SPLINED_STEREOGRAPHIC."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from wlr_render.errors import BadInputError
from wlr_render.lenses.lens import GNOMONIC, STEREOGRAPHIC, Projection, undistorted
from wlr_render.numerics.arrays import FloatArray, IntArray

_STARTS_PER_KNOT = 4  # first guesses of Newton's method per knot: it converges from the nearest one
_OUTSIDE = -1.0  # index of control points at which the spline is undefined


@dataclass(frozen=True, eq=False)
class SplinedLens:
    """A camera whose distortion is a uniform B-spline surface over the stereographic projection.

    pixel = focal_px * (u + shift(u)) + centre_px, with u the stereographic projection of the direction. See "splined
    models" in mrcal's documentation. The model is imported and has no values that a fit could estimate. mrcal
    extrapolates beyond the knots; here points beyond them are NaN, as are points where the surface folds.

    Attributes:
        size_px: width and height.
        focal_px: (2,) pixels per unit of the stereographic projection.
        centre_px: (2,) principal point.
        control: (Ny, Nx, 2) control points of the shift in u and v, row by row from the top left.
        order: degree of the spline, 2 or 3.
        fov_x_deg: horizontal field of view in degrees that the knots span.

    Raises:
        BadInputError: the order is neither 2 nor 3, or has too few control points.
    """

    size_px: tuple[int, int]
    focal_px: FloatArray
    centre_px: FloatArray
    control: FloatArray
    order: int
    fov_x_deg: float

    def __post_init__(self) -> None:
        if self.order not in (2, 3):
            raise BadInputError(f"a splined lens has order 2 or 3, not {self.order}.")
        if self.control.ndim != 3 or min(self.control.shape[:2]) <= self.order or self.control.shape[2] != 2:
            raise BadInputError(
                f"a splined lens of order {self.order} has at least {self.order + 1} x {self.order + 1} control points "
                f"of 2 numbers, not an array of {self.control.shape}."
            )
        if not 0 < self.fov_x_deg < 360:
            raise BadInputError(f"the field of view of a splined lens is {self.fov_x_deg} degrees; give 1 to 359.")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters: none, because an imported lens is not fitted."""
        return ()

    @property
    def values(self) -> FloatArray:
        """Values of the parameters: an empty array (0,)."""
        return np.zeros(0)

    def with_values(self, values: FloatArray) -> "SplinedLens":
        """Return this lens: it has no values."""
        return self

    def project(self, point_in_camera: FloatArray) -> Projection:
        """Project points (n, 3), with derivatives by the points."""
        image, slope = self._image_and_slope(STEREOGRAPHIC.position(point_in_camera))
        by_point = np.where(np.isfinite(image)[:, :, None], slope @ STEREOGRAPHIC.by_point(point_in_camera), np.nan)
        pixel = image * self.focal_px + self.centre_px
        return Projection(pixel, by_point * self.focal_px[:, None], np.zeros((len(image), 2, 0)))

    def pixel_of_point(self, point_in_camera: FloatArray) -> FloatArray:
        """Project points (..., 3) to pixels (..., 2); NaN for points that the model cannot see."""
        point = np.asarray(point_in_camera, dtype=np.float64)
        image, _ = self._image_and_slope(STEREOGRAPHIC.position(point.reshape(-1, 3)))
        return np.asarray(image.reshape(*point.shape[:-1], 2) * self.focal_px + self.centre_px)

    def pixel_of_tangents(self, tangents: FloatArray) -> FloatArray:
        """Project tangents (..., 2), (x / z, y / z) in the camera frame, to pixels (..., 2)."""
        tangents = np.asarray(tangents, dtype=np.float64)
        return self.pixel_of_point(np.concatenate([tangents, np.ones((*tangents.shape[:-1], 1))], axis=-1))

    def dir_of_pixel(self, pixel: FloatArray) -> FloatArray:
        """Return the unit directions (..., 3) of pixels (..., 2) in the camera frame; NaN where the model has none."""
        distorted = (np.asarray(pixel, dtype=np.float64) - self.centre_px) / self.focal_px
        flat = distorted.reshape(-1, 2)
        finite = np.isfinite(flat).all(axis=1)
        starts, tree = self._starts
        position = np.full(flat.shape, np.nan)
        nearest = tree.query(flat[finite])[1]
        position[finite] = undistorted(flat[finite], starts[nearest], self._image_and_slope)
        return STEREOGRAPHIC.direction(position.reshape(distorted.shape))

    def tangents_of_pixel(self, pixel: FloatArray) -> FloatArray:
        """Return the tangents (..., 2) of pixels (..., 2); NaN without tangents, as at 90 degrees or more."""
        direction = self.dir_of_pixel(pixel)
        return GNOMONIC.position(direction.reshape(-1, 3)).reshape(*direction.shape[:-1], 2)

    @cached_property
    def _shift(self) -> "scipy.interpolate.NdBSpline":
        """Shift as a function of the index (x, y) of the control points."""
        knots = (np.arange(count + self.order + 1) - 0.5 * (self.order + 1) for count in self._counts)
        return scipy.interpolate.NdBSpline(tuple(knots), self.control.transpose(1, 0, 2), self.order, extrapolate=False)

    @property
    def _counts(self) -> IntArray:
        """Numbers of control points in x and y."""
        return np.array(self.control.shape[1::-1])

    @property
    def _knots_per_unit(self) -> float:
        """Control points per unit of the stereographic projection, the same in x and y.

        The horizontal field of view is the range in which all `order` + 1 control points of the spline exist.
        """
        width = 4.0 * np.tan(np.radians(self.fov_x_deg) / 4.0)
        return float((self._counts[0] - self.order) / width)

    @cached_property
    def _starts(self) -> "tuple[FloatArray, scipy.spatial.cKDTree]":
        """Positions that the model sees, and a k-d tree of their images."""
        first = 0.5 * (self.order - 1)
        x, y = (np.linspace(first, n - 1 - first, int(_STARTS_PER_KNOT * (n - self.order)) + 1) for n in self._counts)
        index = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        position = (index - 0.5 * (self._counts - 1)) / self._knots_per_unit
        image, _ = self._image_and_slope(position)
        valid = np.asarray(np.isfinite(image).all(axis=1))
        if not valid.any():
            raise BadInputError("the spline of the lens folds everywhere; check the order of its control points.")
        return position[valid], scipy.spatial.cKDTree(image[valid])

    def _image_and_slope(self, position: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the distorted positions (n, 2) of positions (n, 2) and the Jacobian (n, 2, 2); NaN where undefined."""
        finite = np.asarray(np.isfinite(position).all(axis=1))
        index = np.where(finite[:, None], position * self._knots_per_unit + 0.5 * (self._counts - 1), _OUTSIDE)
        by_index = np.stack([self._shift(index, nu=nu) for nu in ((1, 0), (0, 1))], axis=-1)
        slope = np.eye(2) + by_index * self._knots_per_unit
        # A symmetric part that is positive definite excludes folds.
        across = slope[:, 0, 1] + slope[:, 1, 0]
        first, second = slope[:, 0, 0], slope[:, 1, 1]
        one_to_one = np.asarray((first > 0) & (4 * first * second > across**2))
        return np.where(one_to_one[:, None], position + self._shift(index), np.nan), slope

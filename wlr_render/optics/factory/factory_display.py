"""The display of a factory calibration: tangents of panel pixels from one pupil position, by formula or grid."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from wlr_render.geometry import transforms
from wlr_render.geometry.directions import normalised
from wlr_render.geometry.transforms import OPENXR_FROM_OPENCV
from wlr_render.mappings import Panel, QueryResult, Status
from wlr_render.numerics import newton
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.polynomial import Box, Polynomial, basis, total_degree

IMAGE_M = 2.0
"""Distance of the virtual image from the calibrated pupil, along the axis of the display.

No format states this distance. It determines how directions change with the pupil: 1 mm of pupil moves the image by
1.7' relative to a display at infinity."""

_GUESS_DEGREE, _GUESS_GRID = 5, 25
_STEP_PX = 1e-3  # step of the finite differences by pixel
_TOLERANCE = 1e-13  # tolerance of the solved tangents

PixelTangents = Callable[[FloatArray], FloatArray]
"""Pixels (..., 2) -> tangents (..., 2), x right and y down, in the axes of the display."""


@dataclass(frozen=True, eq=False)
class RadialTangents:
    """Tangents by a radial distortion in the plane of the panel.

    With q = (pixel - origin) / unit and r the distance of q from `centre`, the undistorted position is
    centre + (q - centre) d, and d is 1 + k1 r^2 + k2 r^4 + k3 r^6, or the inverse of that plus k4.

    Attributes:
        origin, unit: (2,) pixels.
        centre: (2,) in these units.
        k: (4,) coefficients.
        is_inverse: whether d is the inverse of the polynomial.
        tangents_of_plane: (3, 3) homogeneous map of undistorted positions to tangents.
    """

    origin: FloatArray
    unit: FloatArray
    centre: FloatArray
    k: FloatArray
    is_inverse: bool
    tangents_of_plane: FloatArray

    def __call__(self, pixel: FloatArray) -> FloatArray:
        """Return the tangents (..., 2) of pixels (..., 2)."""
        offset = (pixel - self.origin) / self.unit - self.centre
        r2 = np.sum(offset**2, axis=-1, keepdims=True)
        k1, k2, k3, k4 = self.k
        factor = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        factor = 1.0 / factor + k4 if self.is_inverse else factor
        return _homogeneous(self.tangents_of_plane, self.centre + offset * factor)


@dataclass(frozen=True, eq=False)
class GridTangents:
    """Tangents by a cubic spline through the points of a grid.

    Attributes:
        u, v: (columns,), (rows,) pixels of the grid, ascending.
        point: (rows, columns, 2) undistorted position at each point.
        tangents_of_plane: (3, 3) homogeneous map of undistorted positions to tangents.
    """

    u: FloatArray
    v: FloatArray
    point: FloatArray
    tangents_of_plane: FloatArray

    def __call__(self, pixel: FloatArray) -> FloatArray:
        """Return the tangents (..., 2) of pixels (..., 2); the distortion at the border continues beyond it."""
        u, v = np.moveaxis(pixel, -1, 0)
        plane, splines = self._affine_and_splines
        distortion = np.stack([spline.ev(v, u) for spline in splines], axis=-1)
        return _homogeneous(self.tangents_of_plane, pixel @ plane[:2] + plane[2] + distortion)

    @cached_property
    def _affine_and_splines(self) -> "tuple[FloatArray, list[scipy.interpolate.RectBivariateSpline]]":
        """The affine map (3, 2) closest to the grid, and splines of the grid's deviations from it."""
        u, v = np.meshgrid(self.u, self.v)
        design = np.stack([u, v, np.ones_like(u)], axis=-1)
        affine = np.linalg.lstsq(design.reshape(-1, 3), self.point.reshape(-1, 2), rcond=None)[0].astype(np.float64)
        distortion = self.point - design @ affine
        degrees = {"kx": min(3, len(self.v) - 1), "ky": min(3, len(self.u) - 1)}
        return affine, [
            scipy.interpolate.RectBivariateSpline(self.v, self.u, distortion[..., axis], **degrees) for axis in range(2)
        ]


def _homogeneous(matrix: FloatArray, position: FloatArray) -> FloatArray:
    mapped = position @ matrix[:, :2].T + matrix[:, 2]
    return np.asarray(mapped[..., :2] / mapped[..., 2:])


@dataclass(frozen=True, eq=False)
class FactoryDisplay:
    """A `mappings.DisplayMapping`: a flat virtual image, `IMAGE_M` from the pupil at which it was calibrated.

    Attributes:
        panel: the panel.
        tangents: tangents of its pixels.
        device_from_display: (4, 4) pose of the display; its origin is the calibrated pupil, its axes are OpenCV's.
    """

    panel: Panel
    tangents: PixelTangents
    device_from_display: FloatArray

    def view_dir_of_pixel(
        self, pixel: FloatArray, viewpoint: FloatArray, warm_start: FloatArray | None = None
    ) -> QueryResult:
        """Answer the forward query; CLIPPED for pixels outside the panel."""
        tangents = self.tangents(np.asarray(pixel, np.float64))
        image = IMAGE_M * np.concatenate([tangents, np.ones_like(tangents[..., :1])], axis=-1)
        view_dir = normalised(transforms.apply(self.device_from_display, image) - viewpoint)
        on_panel = np.broadcast_to(self.panel.contains(np.asarray(pixel)), view_dir.shape[:-1])
        return _answer(view_dir, np.where(on_panel, Status.OK, Status.CLIPPED))

    def pixel_of_view_dir(
        self, view_dir: FloatArray, viewpoint: FloatArray, warm_start: FloatArray | None = None
    ) -> QueryResult:
        """Answer the backward query, solved to 1e-13 tangents; MISS for directions away from the image."""
        display_from_device = transforms.inverse(self.device_from_display)
        eye, along = np.broadcast_arrays(
            transforms.apply(display_from_device, viewpoint), transforms.rotate(display_from_device, view_dir)
        )
        ahead = along[..., 2] > 0.0
        depth = (IMAGE_M - eye[..., 2:]) / np.where(ahead, along[..., 2], np.nan)[..., None]
        wanted = ((eye + depth * along)[..., :2] / IMAGE_M).reshape(-1, 2)
        guess = self._guess
        start = guess(np.clip(wanted, guess.box.low, guess.box.high))

        def residual(pixel: FloatArray, index: IntArray) -> tuple[FloatArray, FloatArray]:
            here = self.tangents(pixel)
            steps = [(self.tangents(pixel + step) - here) / _STEP_PX for step in _STEP_PX * np.eye(2)]
            return here - wanted[index], np.stack(steps, axis=-1)

        root = newton.solve_2x2(residual, start, _TOLERANCE)
        solved, on_panel = (each.reshape(ahead.shape) for each in (root.converged, self.panel.contains(root.unknown)))
        status = np.where(solved, np.where(on_panel, Status.OK, Status.CLIPPED), Status.NOT_CONVERGED)
        inside = np.all((wanted > guess.box.low) & (wanted < guess.box.high), axis=-1).reshape(ahead.shape)
        status = np.where(inside, status, Status.CLIPPED)
        return _answer(root.unknown.reshape(*ahead.shape, 2), np.where(ahead, status, Status.MISS))

    @cached_property
    def _guess(self) -> Polynomial:
        """First guess of pixels as a polynomial of tangents."""
        axes = [np.linspace(0.0, size, _GUESS_GRID) for size in self.panel.size_px]
        pixel = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
        tangents = self.tangents(pixel)
        margin = 1e-3 * np.ptp(tangents, axis=0)
        box = Box(tangents.min(axis=0) - margin, tangents.max(axis=0) + margin)
        orders = total_degree(2, _GUESS_DEGREE)
        return Polynomial(orders, box, np.linalg.lstsq(basis(tangents, orders, box), pixel, rcond=None)[0])


def _answer(value: FloatArray, status: FloatArray) -> QueryResult:
    return QueryResult(np.where((status == Status.OK)[..., None], value, np.nan), status.astype(np.uint8))


def display_pose(device_from_display: FloatArray, position: FloatArray) -> FloatArray:
    """Return the pose (4, 4) of a display in the device.

    Args:
        device_from_display: (3, 3) rotation; both frames have OpenCV's axes.
        position: (3,) the calibrated pupil, in metres and OpenCV's axes.
    """
    return transforms.rigid(OPENXR_FROM_OPENCV @ device_from_display, OPENXR_FROM_OPENCV @ position)

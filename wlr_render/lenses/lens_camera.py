"""A camera with lens distortion: OpenCV's axes (x right, y down, z forward) and OpenCV's distortion terms.

Pixels have (0, 0) at the outer corner of the top-left pixel. OpenCV counts from that pixel's centre;
`opencv_matrix` and `OPENCV_PIXEL_SHIFT` convert.
"""

from dataclasses import dataclass, field
from functools import cached_property, lru_cache, partial

import numpy as np
from numpy.polynomial import Polynomial

from wlr_render.errors import BadInputError
from wlr_render.lenses.lens import EQUIDISTANT, GNOMONIC, Azimuthal, Projection, undistorted
from wlr_render.numerics.arrays import BoolArray, FloatArray

OPENCV_PIXEL_SHIFT = -0.5
"""OpenCV's pixel position minus ours."""

DISTORTION_TERMS = ("k1", "k2", "p1", "p2", "k3")
"""Distortion coefficients of Brown's model, in OpenCV's order."""

_RATIONAL_TERMS = (*DISTORTION_TERMS, "k4", "k5", "k6")
LENS_KINDS = {
    "brown": DISTORTION_TERMS,
    "rational": _RATIONAL_TERMS,
    "thin-prism": (*_RATIONAL_TERMS, "s1", "s2", "s3", "s4"),
    "fisheye": ("k1", "k2", "k3", "k4"),
}
"""Names of each kind's distortion terms, in OpenCV's order. OpenCV's fisheye model is due to J. Kannala and
S. S. Brandt, IEEE Transactions on Pattern Analysis and Machine Intelligence 28 (2006) 1335."""

# Indices of each kind's terms in `_Distortion.terms`
_PLACES = {kind: list(range(len(terms))) for kind, terms in LENS_KINDS.items()} | {"fisheye": [0, 1, 4, 12]}

_START_RADII = 2000  # radii in the table of first guesses: two or three steps of Newton's method then suffice
_WIDEST_START_DEG = 89.9  # largest angle of the table, where the model has no other limit
_NEGLIGIBLE = 1e-30  # leading coefficient of a polynomial of degree 17 that has no effect below 89 degrees


@dataclass(frozen=True, eq=False)
class LensCamera:
    """A camera with lens distortion.

    Points that the model cannot see become NaN: points behind a perspective camera, and points at `angle_limit` or
    more from the axis. A point far outside the picture is therefore never projected into it.

    Attributes:
        size_px: width and height.
        focal_px: (2,) pixels per unit tangent in u and v; for a fisheye lens, pixels per radian.
        centre_px: (2,) principal point.
        distortion: the terms that `LENS_KINDS` names. The perspective kinds give distorted tangents as a function of
            true tangents (D. C. Brown, "Close-range camera calibration", Photogrammetric Engineering 37 (1971) 855, and
            OpenCV's extensions); "fisheye" gives the distance from the centre as a function of the angle from the axis.
        kind: a key of `LENS_KINDS`.

    Raises:
        BadInputError: the kind is unknown, or the number of distortion terms does not fit it.
    """

    size_px: tuple[int, int]
    focal_px: FloatArray
    centre_px: FloatArray
    distortion: FloatArray = field(default_factory=partial(np.zeros, len(DISTORTION_TERMS)))
    kind: str = "brown"

    def __post_init__(self) -> None:
        if self.kind not in LENS_KINDS:
            raise BadInputError(f"unknown kind of lens '{self.kind}'; choose one of {', '.join(LENS_KINDS)}.")
        terms = LENS_KINDS[self.kind]
        if np.shape(self.distortion) != (len(terms),):
            raise BadInputError(
                f"a lens of kind '{self.kind}' has {len(terms)} distortion terms ({', '.join(terms)}), "
                f"not {np.size(self.distortion)}; give as many, with 0 for unused ones."
            )

    @property
    def opencv_matrix(self) -> FloatArray:
        """Camera matrix (3, 3) for OpenCV's pixel positions."""
        (fx, fy), (cx, cy) = self.focal_px, self.centre_px + OPENCV_PIXEL_SHIFT
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the P parameters: focal lengths, principal point and distortion terms."""
        return ("fx", "fy", "cx", "cy", *LENS_KINDS[self.kind])

    @property
    def values(self) -> FloatArray:
        """Values (P,) of the parameters."""
        return np.concatenate([self.focal_px, self.centre_px, self.distortion])

    def with_values(self, values: FloatArray) -> "LensCamera":
        """Return a copy of this camera with other values (P,) of its parameters."""
        return LensCamera(self.size_px, values[:2], values[2:4], values[4:], self.kind)

    def as_kind(self, kind: str) -> "LensCamera":
        """Convert this camera to a kind that extends its list of terms; the added terms are 0."""
        more = len(LENS_KINDS[kind]) - len(self.distortion)
        return LensCamera(self.size_px, self.focal_px, self.centre_px, np.pad(self.distortion, (0, more)), kind)

    @property
    def angle_limit(self) -> float:
        """Angle from the optical axis in radians below which the model maps directions to pixels one to one."""
        return self._plane.angle(self._distortion.limit)

    def project(self, point_in_camera: FloatArray) -> Projection:
        """Project points (n, 3), with derivatives by the points and by `values`."""
        position = self._plane.position(point_in_camera)
        image, by_position = self._distortion.image_and_slope(position)
        visible = np.isfinite(image[:, 0])
        position, image = position[visible], image[visible]

        by_point = by_position[visible] @ self._plane.by_point(point_in_camera[visible])
        by_values = np.zeros((*image.shape, len(self.names)))
        by_values[:, [0, 1], [0, 1]] = image
        by_values[:, [0, 1], [2, 3]] = 1.0
        by_terms = self._distortion.by_terms(position)[:, :, _PLACES[self.kind]]
        by_values[:, :, 4:] = by_terms * self.focal_px[:, None]
        pixel = image * self.focal_px + self.centre_px
        return Projection(*(_filled(part, visible) for part in (pixel, by_point * self.focal_px[:, None], by_values)))

    def pixel_of_point(self, point_in_camera: FloatArray) -> FloatArray:
        """Project points (..., 3) to pixels (..., 2); NaN for points that the model cannot see."""
        point = np.asarray(point_in_camera, dtype=np.float64)
        image = self._distortion.image(self._plane.position(point.reshape(-1, 3)))
        return np.asarray(image.reshape(*point.shape[:-1], 2) * self.focal_px + self.centre_px)

    def pixel_of_tangents(self, tangents: FloatArray) -> FloatArray:
        """Project tangents (..., 2), (x / z, y / z) in the camera frame, to pixels (..., 2)."""
        tangents = np.asarray(tangents, dtype=np.float64)
        return self.pixel_of_point(np.concatenate([tangents, np.ones((*tangents.shape[:-1], 1))], axis=-1))

    def dir_of_pixel(self, pixel: FloatArray) -> FloatArray:
        """Return the unit directions (..., 3) of pixels (..., 2), camera frame; NaN where distortion has no inverse."""
        return self._plane.direction(self._position_of_pixel(pixel))

    def tangents_of_pixel(self, pixel: FloatArray) -> FloatArray:
        """Return the undistorted tangents (..., 2) of pixels (..., 2); NaN where the distortion has no inverse.

        Also NaN for directions at 90 degrees or more from the optical axis.
        """
        if self._plane is GNOMONIC:
            return self._position_of_pixel(pixel)
        direction = self.dir_of_pixel(pixel)
        return GNOMONIC.position(direction.reshape(-1, 3)).reshape(*direction.shape[:-1], 2)

    def _position_of_pixel(self, pixel: FloatArray) -> FloatArray:
        """Return the undistorted positions (..., 2) in the plane of the projection."""
        distorted = (np.asarray(pixel, dtype=np.float64) - self.centre_px) / self.focal_px
        if not np.any(self.distortion):
            inside = np.linalg.norm(distorted, axis=-1, keepdims=True) < self._distortion.limit
            return np.where(inside, distorted, np.nan)
        flat = distorted.reshape(-1, 2)
        radius = np.linalg.norm(flat, axis=1)
        start = np.interp(radius, *self._start_table) / np.where(radius > 0, radius, 1.0)
        return undistorted(flat, flat * start[:, None], self._distortion.image_and_slope).reshape(distorted.shape)

    @property
    def _plane(self) -> Azimuthal:
        return EQUIDISTANT if self.kind == "fisheye" else GNOMONIC

    @cached_property
    def _distortion(self) -> "_Distortion":
        terms = np.zeros(13)
        terms[_PLACES[self.kind]] = self.distortion
        return _distortion_of(tuple(map(float, terms)), self._plane.largest_radius)

    @cached_property
    def _start_table(self) -> tuple[FloatArray, FloatArray]:
        """Distorted and undistorted distances from the centre, both increasing, without tangential and prism terms."""
        widest = (
            self.angle_limit if self._plane is EQUIDISTANT else min(self.angle_limit, np.radians(_WIDEST_START_DEG))
        )
        angles = np.linspace(0.0, widest, _START_RADII, endpoint=False)
        points = np.stack([np.sin(angles), np.zeros_like(angles), np.cos(angles)], axis=1)
        radii = self._plane.position(points)[:, 0]
        return radii * self._distortion.radial(radii**2)[0], radii


def _filled(rows: FloatArray, chosen: BoolArray) -> FloatArray:
    """Return an array with `rows` where `chosen` is True and NaN elsewhere."""
    result = np.full((len(chosen), *rows.shape[1:]), np.nan)
    result[chosen] = rows
    return result


@dataclass(frozen=True, eq=False)
class _Distortion:
    """Distortion of the positions in a plane, by OpenCV's terms.

    Attributes:
        terms: (13,) the terms of "thin-prism", then the coefficient of the radius' ninth power, which only "fisheye"
            has.
        largest_radius: largest radius of the projection to the plane.
    """

    terms: FloatArray
    largest_radius: float

    @cached_property
    def limit(self) -> float:
        """Radius of the largest disc of positions in which the distortion is certain to be one to one.

        A map of a convex region is one to one where the symmetric part of its Jacobian is positive definite. The
        radial part has the eigenvalues f'(r) and f(r) / r with f = r * above / below; tangential and prism terms change
        them by `sideways` at most.
        """
        k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, ninth = self.terms
        r = Polynomial([0.0, 1.0])
        above = Polynomial([1.0, 0.0, k1, 0.0, k2, 0.0, k3, 0.0, ninth])
        below = Polynomial([1.0, 0.0, k4, 0.0, k5, 0.0, k6])
        sideways = (6 * np.hypot(p1, p2) + 2 * np.hypot(s1, s3)) * r + 4 * np.hypot(s2, s4) * r**3
        growth = (r * above).deriv() * below - r * above * below.deriv()
        bounds = (below, growth - sideways * below**2, above - sideways * below)
        roots = np.concatenate([bound.trim(_NEGLIGIBLE).roots() for bound in bounds])
        return float(min([self.largest_radius, *roots.real[(roots.imag == 0) & (roots.real > 0)]]))

    def radial(self, r2: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the factor (n,) of positions at squared radii (n,), and its denominator."""
        k1, k2, _, _, k3, k4, k5, k6 = self.terms[:8]
        below = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6))
        return (1.0 + r2 * (k1 + r2 * (k2 + r2 * (k3 + r2 * self.terms[12])))) / below, below

    def image(self, position: FloatArray) -> FloatArray:
        """Return the distorted positions (n, 2) of positions (n, 2); NaN at radii from `limit` on."""
        _, _, p1, p2 = self.terms[:4]
        s1, s2, s3, s4 = self.terms[8:12]
        x, y = position.T
        r2 = self._squared(position)
        factor = self.radial(r2)[0] + 2 * (p2 * x + p1 * y)
        return np.stack([x * factor + r2 * (p2 + s1 + r2 * s2), y * factor + r2 * (p1 + s3 + r2 * s4)], axis=1)

    def image_and_slope(self, position: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the result of `image` and its Jacobian (n, 2, 2)."""
        k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, ninth = self.terms
        x, y = position.T
        r2 = self._squared(position)
        radial, below = self.radial(r2)
        growth = k1 + r2 * (2 * k2 + r2 * (3 * k3 + r2 * 4 * ninth)) - radial * (k4 + r2 * (2 * k5 + r2 * 3 * k6))
        growth *= 2 / below
        factor = radial + 2 * (p2 * x + p1 * y)
        # The distorted position is position * factor + r2 * (tangential_x, tangential_y).
        aside_x, aside_y = p2 + s1 + r2 * s2, p1 + s3 + r2 * s4
        image = np.stack([x * factor + r2 * aside_x, y * factor + r2 * aside_y], axis=1)
        factor_by_x, factor_by_y = growth * x + 2 * p2, growth * y + 2 * p1
        aside_x, aside_y = 2 * (aside_x + r2 * s2), 2 * (aside_y + r2 * s4)
        slope = np.empty((len(position), 2, 2))
        slope[:, 0, 0] = factor + x * (factor_by_x + aside_x)
        slope[:, 0, 1] = x * factor_by_y + aside_x * y
        slope[:, 1, 0] = y * factor_by_x + aside_y * x
        slope[:, 1, 1] = factor + y * (factor_by_y + aside_y)
        return image, slope

    def _squared(self, position: FloatArray) -> FloatArray:
        """Return the squared radii (n,); NaN from `limit` on."""
        r2 = position[:, 0] ** 2 + position[:, 1] ** 2
        return np.where(r2 < self.limit**2, r2, np.nan)

    def by_terms(self, position: FloatArray) -> FloatArray:
        """Return the derivative (n, 2, 13) of `image` by `terms`."""
        x, y = position.T
        r2 = self._squared(position)
        radial, below = self.radial(r2)
        result = np.zeros((*position.shape, len(self.terms)))
        for place, power in ((0, 1), (1, 2), (4, 3), (12, 4)):
            result[:, :, place] = position * (r2**power / below)[:, None]
        result[:, :, 5:8] = -radial[:, None, None] * result[:, :, [0, 1, 4]]
        result[:, 0, 2] = result[:, 1, 3] = 2 * x * y
        result[:, 1, 2], result[:, 0, 3] = r2 + 2 * y * y, r2 + 2 * x * x
        result[:, 0, 8] = result[:, 1, 10] = r2
        result[:, 0, 9] = result[:, 1, 11] = r2 * r2
        return result


@lru_cache(maxsize=64)
def _distortion_of(terms: tuple[float, ...], largest_radius: float) -> _Distortion:
    """Return the distortion, cached: its limit is slow to compute and independent of focal length and centre."""
    return _Distortion(np.array(terms), largest_radius)

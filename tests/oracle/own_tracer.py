"""A second ray tracer, for benches with a hidden effect: it shares no code with `wlr_render.optics`.

Here a surface is the zero of a function of the point, usually its distance from the surface, and a ray meets it by
Newton's method on that function; shapes can therefore carry bumps. Millimetres; x right, y down, z forward. Points and
directions are rows, (n, 3); a ray that goes nowhere is a row of NaN.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

Bump = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""Points (n, 3), device frame -> how far the surface is raised there (n,), and the gradient of that (n, 3)."""

_NEWTON_STEPS = 20
_CLOSE_MM = 1e-11
_FOOT_STEPS = 5


def turn(vector_rad: FloatArray) -> FloatArray:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3), by Rodrigues' formula."""
    vector = np.asarray(vector_rad, dtype=np.float64)
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    x, y, z = np.moveaxis(vector, -1, 0)
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*x.shape, 3, 3)
    first, second = np.sinc(angle / np.pi), 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2
    return np.asarray(np.eye(3) + first * cross + second * cross @ cross)


def unit(vector: FloatArray) -> FloatArray:
    """Rows (..., 3) scaled to length 1."""
    return np.asarray(vector / np.linalg.norm(vector, axis=-1, keepdims=True))


def dot(first: FloatArray, second: FloatArray) -> FloatArray:
    """Scalar products of rows, (n,)."""
    return np.asarray(np.einsum("ij,ij->i", first, second))


class Shape(Protocol):
    """A surface in its own frame, as the zero of a function that grows away from the eye."""

    def start(self, origin: FloatArray, direction: FloatArray) -> FloatArray:
        """Distance along rays (n, 3), (n, 3) from which Newton's method is to start, (n,)."""

    def height(self, point: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The function at points (n, 3), (n,), and its gradient, (n, 3)."""

    def clear(self, point: FloatArray) -> NDArray[np.bool_]:
        """Whether points (n, 3) lie on the used part, (n,)."""

    def pushed_out(self, distance_mm: float) -> "Shape":
        """The same surface, moved outwards."""


@dataclass(frozen=True)
class Spheroid:
    """The parallel surface of an ellipsoid of revolution about z, seen from inside.

    The nearest point of the ellipsoid is found by Newton's method on the Lagrange multiplier L of its equation: it
    lies at (a^2 r / (a^2 + L), b^2 z / (b^2 + L)).

    Attributes:
        across_mm: semi-axis a, across z.
        along_mm: semi-axis b, along z.
        outward_mm: how far outside the ellipsoid the surface lies; negative inside.
    """

    across_mm: float
    along_mm: float
    outward_mm: float = 0.0

    def start(self, origin: FloatArray, direction: FloatArray) -> FloatArray:
        """See `Shape`: the far root of the ellipsoid with semi-axes as much longer."""
        squeeze = 1.0 / (np.array([self.across_mm, self.across_mm, self.along_mm]) + self.outward_mm)
        o, d = origin * squeeze, direction * squeeze
        a, b, c = dot(d, d), dot(o, d), dot(o, o) - 1.0
        return np.asarray((np.sqrt(b * b - a * c) - b) / a)

    def height(self, point: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See `Shape`: the exact distance, and the unit normal."""
        axes = np.array([self.across_mm, self.across_mm, self.along_mm])
        multiplier = np.zeros((len(point), 1))
        for _ in range(_FOOT_STEPS):
            grown = axes**2 + multiplier
            square = (axes * point / grown) ** 2
            excess = square.sum(axis=-1, keepdims=True) - 1.0
            multiplier = multiplier + 0.5 * excess / (square / grown).sum(axis=-1, keepdims=True)
        normal = point / (axes**2 + multiplier)
        length = np.linalg.norm(normal, axis=-1)
        return multiplier[:, 0] * length - self.outward_mm, normal / length[:, None]

    def clear(self, point: FloatArray) -> NDArray[np.bool_]:
        """See `Shape`: it has no edge."""
        return np.ones(len(point), dtype=np.bool_)

    def pushed_out(self, distance_mm: float) -> "Spheroid":
        """See `Shape`."""
        return replace(self, outward_mm=self.outward_mm + distance_mm)


@dataclass(frozen=True, eq=False)
class Sheet:
    """z = rise + sum of coefficients[m, n] x^m y^n.

    Attributes:
        coefficients: (M, N) in millimetres per power of a millimetre.
        rise_mm: how far the sheet is lifted along z.
        clear_mm: x low, x high, y low, y high of the used part; beyond it the polynomial means nothing.
    """

    coefficients: FloatArray
    rise_mm: float
    clear_mm: tuple[float, float, float, float]

    def start(self, origin: FloatArray, direction: FloatArray) -> FloatArray:
        """See `Shape`: where the ray meets the plane z = rise."""
        return np.asarray((self.rise_mm - origin[:, 2]) / direction[:, 2])

    def height(self, point: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See `Shape`: the height above the sheet along z."""
        x, y, z = point.T
        sag = [
            polynomial.polyval2d(x, y, c)
            for c in (self.coefficients, *(polynomial.polyder(self.coefficients, axis=axis) for axis in (0, 1)))
        ]
        return np.asarray(z - self.rise_mm - sag[0]), np.stack([-sag[1], -sag[2], np.ones_like(x)], axis=-1)

    def clear(self, point: FloatArray) -> NDArray[np.bool_]:
        """See `Shape`."""
        x, y, _ = point.T
        left, right, top, bottom = self.clear_mm
        return np.asarray((x >= left) & (x <= right) & (y >= top) & (y <= bottom))

    def pushed_out(self, distance_mm: float) -> "Sheet":
        """See `Shape`."""
        return replace(self, rise_mm=self.rise_mm + distance_mm)


@dataclass(frozen=True, eq=False)
class Surface:
    """A shape at its place in the device.

    Attributes:
        shape: in its own frame.
        axes: (3, 3) the shape's axes in columns, device frame.
        origin: (3,) millimetres, device frame.
        bumps: what is added to the shape.
    """

    shape: Shape
    axes: FloatArray
    origin: FloatArray
    bumps: tuple[Bump, ...] = ()

    def height(self, point: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The surface's function at points (n, 3), (n,), and its gradient (n, 3), device frame."""
        value, gradient = self.shape.height((point - self.origin) @ self.axes)
        gradient = gradient @ self.axes.T
        for bump in self.bumps:
            raised, slope = bump(point)
            value, gradient = value - raised, gradient - slope
        return value, gradient

    @np.errstate(invalid="ignore", divide="ignore")  # a ray that misses becomes NaN
    def meet(self, origin: FloatArray, direction: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Where rays ahead meet the surface, (n, 3), and the unit normals there, (n, 3)."""
        along = self.shape.start((origin - self.origin) @ self.axes, direction @ self.axes)
        for _ in range(_NEWTON_STEPS):
            value, gradient = self.height(origin + along[:, None] * direction)
            step = value / dot(gradient, direction)
            along = along - step
            if not np.any(np.abs(step) > _CLOSE_MM):
                break
        point = origin + along[:, None] * direction
        met = (np.abs(step) <= _CLOSE_MM) & (along > 0.0) & self.shape.clear((point - self.origin) @ self.axes)
        point = np.where(met[:, None], point, np.nan)
        return point, unit(self.height(point)[1])


def reflected(direction: FloatArray, normal: FloatArray) -> FloatArray:
    """Directions (n, 3) after a mirror with unit normals (n, 3)."""
    return np.asarray(direction - 2.0 * dot(direction, normal)[:, None] * normal)


@np.errstate(invalid="ignore")  # total reflection becomes NaN
def refracted(direction: FloatArray, normal: FloatArray, ratio: float) -> FloatArray:
    """Directions (n, 3) after a refraction; `ratio` is the index before divided by the index behind."""
    cosine = dot(direction, normal)
    inside = np.copysign(np.sqrt(1.0 - ratio**2 * (1.0 - cosine**2)), cosine)
    return np.asarray(ratio * direction + (inside - ratio * cosine)[:, None] * normal)

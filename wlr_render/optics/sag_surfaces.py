"""Surfaces z = sag(x, y): aspheres, toroid, biconic, XY polynomial, bump.

Same frame, units and column layout as `surfaces`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Annotated

import numpy as np

from wlr_render.io.file_records import LENGTH, MM, Key, Keys, Records, Rule
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device_keys import R_TERMS, XY_TERMS, curvature_key, radius_key
from wlr_render.optics.surfaces import Gradient, Shape

_pair = partial(Keys, join=lambda x, y: (x, y), split=tuple, absent=0.0)
_CURVATURES = _pair((curvature_key("radius_x_mm"), curvature_key("radius_y_mm")))
_CONICS = _pair((Key("conic_x"), Key("conic_y")))


class SagSurface(Shape):
    """A shape by its height over x and y, with normals that point to +z at the vertex."""

    def sag_and_slopes(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the height z (n,) and its derivatives by x and y, in metres; NaN beyond the edge of the shape."""
        raise NotImplementedError

    def level(self, point: FloatArray) -> tuple[FloatArray, Gradient]:
        """Return the height of the shape above points, and its gradient."""
        sag, slope_x, slope_y = self.sag_and_slopes(point[0], point[1])
        return np.asarray(sag - point[2]), (slope_x, slope_y, -1.0)


@dataclass(frozen=True)
class Toroid(SagSurface):
    """A circle in the y-z plane, turned about an axis parallel to y.

    Attributes:
        radius_x: metres from the vertex to the axis of rotation, positive towards +z.
        radius_y: metres, radius of the circle, positive with its centre at +z.
    """

    radius_x: Annotated[float, radius_key("radius_x_mm")]
    radius_y: Annotated[float, radius_key("radius_y_mm")]

    def sag_and_slopes(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the sag and slopes; see `SagSurface`."""
        curvature = 1.0 / self.radius_y
        root = np.sqrt(1.0 - curvature * curvature * y * y)
        profile = curvature * y * y / (1.0 + root)
        arm = self.radius_x - profile
        height = np.copysign(np.sqrt(arm * arm - x * x), self.radius_x)
        return profile + x * x / (arm + height), x / height, arm / height * curvature * y / root


def _conicoid(
    x: FloatArray, y: FloatArray, curvature: tuple[float, float], conic: tuple[float, float]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the sag (cx x^2 + cy y^2) / (1 + sqrt(1 - (1 + kx) cx^2 x^2 - (1 + ky) cy^2 y^2)) and its slopes."""
    (cx, cy), (kx, ky) = curvature, conic
    px, py = (1.0 + kx) * cx * cx, (1.0 + ky) * cy * cy
    root = np.sqrt(1.0 - px * x * x - py * y * y)
    below = 1.0 / (1.0 + root)
    sag = (cx * x * x + cy * y * y) * below
    bend = sag * below / root
    return sag, x * (2.0 * cx * below + px * bend), y * (2.0 * cy * below + py * bend)


@dataclass(frozen=True)
class Asphere(SagSurface):
    """A conicoid of revolution with terms in powers of the distance r from its axis.

    Attributes:
        coefficients: coefficients by power of r from r^2 on; the coefficient of r^k in metres^(1 - k).
        curvature: curvature of the conic base in 1/m; 0 for a plane base.
        conic: k of the conic base.
    """

    coefficients: Annotated[tuple[float, ...], R_TERMS]
    curvature: Annotated[float, curvature_key("radius_mm")] = 0.0
    conic: float = 0.0

    def sag_and_slopes(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the sag and slopes by Horner's scheme in r, after r^2 is factored out."""
        sag, slope_x, slope_y = _conicoid(x, y, (self.curvature, self.curvature), (self.conic, self.conic))
        r_squared = x * x + y * y
        if not any(self.coefficients[1::2]):
            value, slope = _horner(self.coefficients[::2], r_squared)
            rest = 2.0 * (value + r_squared * slope)
        else:
            r = np.sqrt(r_squared)
            value, slope = _horner(self.coefficients, r)
            rest = 2.0 * value + r * slope
        return sag + r_squared * value, slope_x + rest * x, slope_y + rest * y


@dataclass(frozen=True)
class SumOfProfiles(SagSurface):
    """A conic profile of x plus a conic profile of y, each with a separate root.

    Attributes:
        curvature: (cx, cy) in 1/m.
        conic: (kx, ky).
    """

    curvature: Annotated[tuple[float, float], _CURVATURES]
    conic: Annotated[tuple[float, float], _CONICS] = (0.0, 0.0)

    def sag_and_slopes(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the sag and slopes; see `SagSurface`."""
        (cx, cy), (kx, ky) = self.curvature, self.conic
        sag_x, slope_x, _ = _conicoid(x, np.zeros_like(x), (cx, 0.0), (kx, 0.0))
        sag_y, _, slope_y = _conicoid(np.zeros_like(y), y, (0.0, cy), (0.0, ky))
        return sag_x + sag_y, slope_x, slope_y


@dataclass(frozen=True, eq=False)
class XYPolynomial(SagSurface):
    """Sum of C[m, n] x^m y^n, on a conic base.

    Attributes:
        coefficients: (M + 1, N + 1); C[m, n] in metres^(1 - m - n).
        curvature: curvature of the conic base in 1/m; 0 for a plane base.
        conic: k of the conic base.
    """

    coefficients: Annotated[FloatArray, XY_TERMS]
    curvature: Annotated[float, curvature_key("radius_mm")] = 0.0
    conic: float = 0.0

    @cached_property
    def _columns(self) -> list[list[float]]:
        """Coefficients by power of x without trailing zeros, for each power of y."""
        return [np.trim_zeros(column, "b").tolist() for column in self.coefficients.T]

    def sag_and_slopes(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the sag and slopes by nested Horner schemes, in x within powers of y."""
        sag, slope_x, slope_y = np.zeros_like(x), np.zeros_like(x), np.zeros_like(x)
        for column in reversed(self._columns):
            value, slope = _horner(column, x)
            slope_y = slope_y * y + sag
            sag = sag * y + value
            slope_x = slope_x * y + slope
        if self.curvature == 0.0:
            return sag, slope_x, slope_y
        base = _conicoid(x, y, (self.curvature, self.curvature), (self.conic, self.conic))
        return sag + base[0], slope_x + base[1], slope_y + base[2]


def _horner(coefficients: Sequence[float], x: FloatArray) -> tuple[FloatArray | float, FloatArray | float]:
    """Return the value and derivative of a polynomial, lowest power first; plain numbers for a constant."""
    if not coefficients:
        return 0.0, 0.0
    value: FloatArray | float = coefficients[-1]
    slope: FloatArray | float = 0.0
    for coefficient in reversed(coefficients[:-1]):
        slope = slope * x + value
        value = value * x + coefficient
    return value, slope


@dataclass(frozen=True)
class AnamorphicTerm:
    """The term A ((1 - P) x^2 + (1 + P) y^2)^(order / 2) in millimetres.

    Attributes:
        order: 4, 6, 8 or 10.
        sag_mm: A.
        asymmetry: P.
    """

    order: Annotated[int, Key(rule=Rule("4, 6, 8 or 10", lambda order: order in (4, 6, 8, 10)))]
    sag_mm: float
    asymmetry: float = 0.0


@dataclass(frozen=True)
class AnamorphicAsphere(SagSurface):
    """A biconic with terms of unequal strength in x and y (as in US patent 5,701,202).

    Attributes:
        curvature: (cx, cy) in 1/m.
        conic: (kx, ky).
        terms: terms that are added to the biconic sag.
    """

    curvature: Annotated[tuple[float, float], _CURVATURES]
    conic: Annotated[tuple[float, float], _CONICS] = (0.0, 0.0)
    terms: Annotated[tuple[AnamorphicTerm, ...], Records("term", record=AnamorphicTerm)] = ()

    def sag_and_slopes(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the sag and slopes; see `SagSurface`."""
        sag, slope_x, slope_y = _conicoid(x, y, self.curvature, self.conic)
        for term in self.terms:
            ax, ay = (1.0 - term.asymmetry) / MM**2, (1.0 + term.asymmetry) / MM**2
            inner = ax * x * x + ay * y * y
            rest = MM * term.sag_mm * inner ** (term.order // 2 - 1)
            sag = sag + rest * inner
            slope_x = slope_x + term.order * ax * rest * x
            slope_y = slope_y + term.order * ay * rest * y
        return sag, slope_x, slope_y


@dataclass(frozen=True)
class GaussianBump(SagSurface):
    """A plane with a local bump, or dent: height exp(-(x^2 + y^2) / (2 width^2)).

    Attributes:
        height: metres, at the origin.
        width: metres, standard deviation.
    """

    height: Annotated[float, Key("height_mm", LENGTH)]
    width: Annotated[float, Key("width_mm", LENGTH, above=0)]

    def sag_and_slopes(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the sag and slopes; see `SagSurface`."""
        square = self.width * self.width
        sag = self.height * np.exp(-0.5 * (x * x + y * y) / square)
        return sag, -sag * x / square, -sag * y / square

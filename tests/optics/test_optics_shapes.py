"""Every shape against its own equation written down a second time, and against what is known in closed form."""

from collections.abc import Callable

import numpy as np
import pytest
from present import narrowed

from wlr_render.geometry.transforms import rigid, rotations_of_vectors
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.raised import FormError, Offset, raised
from wlr_render.optics.sag_surfaces import (
    AnamorphicAsphere,
    AnamorphicTerm,
    Asphere,
    GaussianBump,
    SagSurface,
    SumOfProfiles,
    Toroid,
    XYPolynomial,
)
from wlr_render.optics.surfaces import Conic, Ellipsoid, Shape

COEFFICIENTS = np.array([[0.0, 0.02, -1.5, 30.0], [-0.01, 0.3, -8.0, 0.0], [-2.0, 10.0, 0.0, 0.0]])


def conic_sag(x: FloatArray | float, y: FloatArray | float, c: float, k: float) -> FloatArray:
    r2 = x * x + y * y
    return np.asarray(c * r2 / (1 + np.sqrt(1 - (1 + k) * c * c * r2)))


def toroid_level(p: FloatArray, rx: float = -0.08, ry: float = 0.06) -> FloatArray:
    profile = rx + np.hypot(p[0], rx - p[2])  # sag of the circle at this distance from the axis
    return np.asarray(np.hypot(profile - ry, p[1]) - abs(ry))


def polynomial_level(p: FloatArray) -> FloatArray:
    terms = (COEFFICIENTS[m, n] * p[0] ** m * p[1] ** n for m in range(3) for n in range(4))
    return np.asarray(p[2] - sum(terms) - conic_sag(p[0], p[1], -5.0, 0.4))


def anamorphic_level(p: FloatArray) -> FloatArray:
    x, y, z = p
    root = np.sqrt(1 - 0.9 * (x / 0.06) ** 2 - 0.8 * (y / 0.09) ** 2)
    base = (-(x**2) / 0.06 - y**2 / 0.09) / (1 + root)
    return np.asarray(z - base - 500.0 * (1.1 * x**2 + 0.9 * y**2) ** 2 + 9e4 * (0.5 * x**2 + 1.5 * y**2) ** 3)


def even_asphere_level(p: FloatArray) -> FloatArray:
    r2 = p[0] ** 2 + p[1] ** 2
    return np.asarray(p[2] - conic_sag(p[0], p[1], -7.0, -1.4) - 0.5 * r2 + 300.0 * r2**2 - 2e5 * r2**3)


def odd_asphere_level(p: FloatArray) -> FloatArray:
    r = np.hypot(p[0], p[1])
    return np.asarray(p[2] - 1.5 * r**2 + 20.0 * r**3 - 900.0 * r**5)


def sum_of_profiles_level(p: FloatArray) -> FloatArray:
    return np.asarray(p[2] - conic_sag(p[0], 0.0, -9.0, 0.5) - conic_sag(0.0, p[1], 6.0, -2.0))


# Form errors far larger than real ones, about an axis 20 degrees off the surface's own: a saddle, and a bump beside it.
SADDLE = np.array([[0.0, 0.0, -0.6], [0.0, 0.3, 0.0], [0.9, 0.0, 0.0]])
ASKEW = rigid(rotations_of_vectors(np.array([0.2, -0.3, 0.1])), np.array([0.003, -0.002, 0.001]))
BESIDE = rigid(np.eye(3), np.array([0.004, 0.003, 0.0]))


def raise_height(p: FloatArray) -> FloatArray:
    x, y, _ = ASKEW[:3, :3].T @ (p.T - ASKEW[:3, 3]).T
    r2 = (p[0] - 0.004) ** 2 + (p[1] - 0.003) ** 2
    return np.asarray(0.9 * x**2 + 0.3 * x * y - 0.6 * y**2 - 2e-4 * np.exp(-r2 / (2 * 0.006**2)))


def with_errors(shape: Shape) -> Shape:
    return raised(raised(shape, FormError(XYPolynomial(SADDLE), ASKEW)), FormError(GaussianBump(-2e-4, 0.006), BESIDE))


# Each shape with a function that vanishes on it, written without its code.
SHAPES: dict[str, tuple[Shape, Callable[[FloatArray], FloatArray]]] = {
    "plane": (Conic(0.0), lambda p: p[2]),
    "sphere": (Conic(1 / 0.07), lambda p: p[2] - conic_sag(p[0], p[1], 1 / 0.07, 0.0)),
    "hyperboloid": (Conic(-12.0, -2.5), lambda p: p[2] - conic_sag(p[0], p[1], -12.0, -2.5)),
    "paraboloid": (Conic(8.0, -1.0), lambda p: p[2] - conic_sag(p[0], p[1], 8.0, -1.0)),
    "oblate": (Conic(9.0, 0.8), lambda p: p[2] - conic_sag(p[0], p[1], 9.0, 0.8)),
    "ellipsoid": (
        Ellipsoid(np.array([0.12, 0.1, 0.16])),
        lambda p: (p[0] / 0.12) ** 2 + (p[1] / 0.1) ** 2 + (p[2] / 0.16) ** 2 - 1,
    ),
    "offset sphere": (Offset(Conic(1 / 0.07), -0.004), lambda p: np.linalg.norm(p.T - [0, 0, 0.07], axis=1) - 0.074),
    "toroid": (Toroid(-0.08, 0.06), toroid_level),
    "even asphere": (Asphere((0.5, 0.0, -300.0, 0.0, 2e5), -7.0, -1.4), even_asphere_level),
    "odd asphere": (Asphere((1.5, -20.0, 0.0, 900.0)), odd_asphere_level),
    "sum of profiles": (SumOfProfiles((-9.0, 6.0), (0.5, -2.0)), sum_of_profiles_level),
    "xy polynomial": (XYPolynomial(COEFFICIENTS, -5.0, 0.4), polynomial_level),
    "anamorphic": (
        AnamorphicAsphere(
            (-1 / 0.06, -1 / 0.09), (-0.1, -0.2), (AnamorphicTerm(4, 5e-7, -0.1), AnamorphicTerm(6, -9e-11, 0.5))
        ),
        anamorphic_level,
    ),
    "bump": (GaussianBump(3e-3, 0.01), lambda p: p[2] - 3e-3 * np.exp(-(p[0] ** 2 + p[1] ** 2) / 2e-4)),
    "raised sphere": (
        with_errors(Conic(1 / 0.07)),
        lambda p: 0.07 - np.linalg.norm(p.T - [0, 0, 0.07], axis=1) - raise_height(p),
    ),
    "raised offset sphere": (
        with_errors(Offset(Conic(1 / 0.07), -0.004)),
        lambda p: 0.074 - np.linalg.norm(p.T - [0, 0, 0.07], axis=1) - raise_height(p),
    ),
    "offset of a raised plane": (
        Offset(raised(Conic(0.0), FormError(XYPolynomial(np.array([[1e-4], [0.1]])), np.eye(4))), 0.003),
        lambda p: (p[2] - 0.1 * p[0] - 1e-4) / np.hypot(1.0, 0.1) - 0.003,
    ),
    "raised xy polynomial": (
        with_errors(XYPolynomial(COEFFICIENTS, -5.0, 0.4)),
        lambda p: polynomial_level(p) - raise_height(p),
    ),
}


@pytest.mark.parametrize("name", ["even asphere", "odd asphere", "sum of profiles"])
def test_slopes_are_the_derivatives_of_the_sag(name: str) -> None:
    """By central differences; also on the axis, where r itself has no derivative."""
    shape, rng = narrowed(SHAPES[name][0], SagSurface), np.random.default_rng(8)
    x, y = np.append(rng.uniform(-0.02, 0.02, (2, 50)), [[0.0, 0.0, 0.01], [0.0, 0.01, 0.0]], axis=1)
    sag, slope_x, slope_y = shape.sag_and_slopes(x, y)
    step = 1e-7
    ahead, behind = (shape.sag_and_slopes(x + sign * step, y)[0] for sign in (1, -1))
    np.testing.assert_allclose(slope_x, (ahead - behind) / (2 * step), atol=2e-9)
    above, below = (shape.sag_and_slopes(x, y + sign * step)[0] for sign in (1, -1))
    np.testing.assert_allclose(slope_y, (above - below) / (2 * step), atol=2e-9)
    assert np.isfinite(sag).all()
    assert slope_x[50] == slope_y[50] == 0.0


def random_rays(rng: np.random.Generator, count: int) -> tuple[FloatArray, FloatArray]:
    """Rays from before the vertex through a patch around it, up to 35 degrees off the axis."""
    target = np.stack([*rng.uniform(-0.02, 0.02, (2, count)), np.zeros(count)])
    origin = np.stack([*rng.uniform(-0.03, 0.03, (2, count)), np.full(count, -0.1)])
    direction = target - origin
    return origin, direction / np.linalg.norm(direction, axis=0)


@pytest.mark.parametrize("name", SHAPES)
def test_rays_end_on_the_surface(name: str) -> None:
    shape, level = SHAPES[name]
    origin, direction = random_rays(np.random.default_rng(1), 10_000)
    hits = shape.meet(origin, direction)
    assert hits.converged.all()
    for distance in hits.distance:
        met = np.abs(distance) < 1.0  # a paraboloid's other root may be kilometres away
        point = origin[:, met] + distance[met] * direction[:, met]
        np.testing.assert_allclose(level(point), 0.0, atol=3e-14)
    assert (np.abs(hits.distance) < 1.0).any(axis=0).all()


@pytest.mark.parametrize("name", SHAPES)
def test_normal_is_the_gradient_of_the_surfaces_equation(name: str) -> None:
    shape, level = SHAPES[name]
    origin, direction = random_rays(np.random.default_rng(2), 200)
    point = origin + np.fmin.reduce(np.abs(shape.meet(origin, direction).distance)) * direction
    step = 1e-6 * np.eye(3)
    gradient = np.stack([level(point + h[:, None]) - level(point - h[:, None]) for h in step])
    gradient /= np.linalg.norm(gradient, axis=0)
    normal = shape.normal(point)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=0), 1.0, atol=1e-15)
    np.testing.assert_allclose(np.cross(normal.T, gradient.T), 0.0, atol=2e-8)


def test_both_roots_are_found_in_order() -> None:
    shape, _ = SHAPES["ellipsoid"]
    origin, direction = random_rays(np.random.default_rng(3), 1000)
    inside = shape.meet(origin + 0.05 * direction, direction).distance
    outside = shape.meet(origin, direction).distance
    np.testing.assert_allclose(outside, inside + 0.05, atol=1e-14)
    assert np.all(outside[0] <= outside[1])


def test_half_spheres_and_sheets_that_are_not_the_surface_are_no_roots() -> None:
    axis = np.array([[0.0], [0.0], [-0.2]]), np.array([[0.0], [0.0], [1.0]])
    sphere = Conic(1 / 0.07).meet(*axis).distance
    np.testing.assert_allclose(sphere[np.isfinite(sphere)], 0.2, atol=1e-15)
    hyperboloid = Conic(-12.0, -2.5).meet(*axis).distance
    np.testing.assert_allclose(hyperboloid[np.isfinite(hyperboloid)], 0.2, atol=1e-15)


def test_ray_past_a_sphere_has_no_root_and_no_warning_of_convergence() -> None:
    hits = Ellipsoid(np.full(3, 0.1)).meet(np.array([[0.2], [0.0], [-1.0]]), np.array([[0.0], [0.0], [1.0]]))
    assert np.isnan(hits.distance).all()
    assert hits.converged.all()


def test_newton_reports_when_it_does_not_converge() -> None:
    """A ray across a trough, above it: there is nothing to find, and the slope changes sign."""
    trough = XYPolynomial(np.array([[0.0], [0.0], [-30.0]]))
    slope = 1e-3
    direction = np.array([[1.0], [0.0], [slope]]) / np.hypot(1.0, slope)
    hits = trough.meet(np.array([[-0.05], [0.0], [0.002]]), direction)
    assert not hits.converged[0] or np.isnan(hits.distance).all()


def test_offset_points_lie_at_exactly_the_distance() -> None:
    """Base points moved along the analytic normal must be found by any ray through them."""
    rng = np.random.default_rng(4)
    axes = np.array([0.124975, 0.124975, 0.1575])
    on_sphere = rng.normal(size=(3, 2000))
    base_point = axes[:, None] * on_sphere / np.linalg.norm(on_sphere, axis=0)
    normal = base_point / (axes**2)[:, None]
    normal /= np.linalg.norm(normal, axis=0)
    point = base_point - 0.0025 * normal
    origin = rng.uniform(-0.05, 0.05, (3, 2000))
    length = np.linalg.norm(point - origin, axis=0)
    offset = Offset(Ellipsoid(axes), -0.0025)
    direction = (point - origin) / length
    hits = offset.meet(origin, direction)
    assert hits.converged.all()
    np.testing.assert_allclose(hits.distance[1], length, atol=1e-15)
    np.testing.assert_allclose(offset.normal(point), normal, atol=1e-14)

"""The projection: closed form and solves against slow plain ones, and the structure that it guarantees."""

import dataclasses
from collections.abc import Callable
from functools import partial

import numpy as np
import scipy.optimize
from models.toy_models import (
    EYE_BOX,
    IN_PLANE,
    PANEL,
    PIXELS,
    PLANE,
    TANGENTS,
    Fitted,
    bend,
    box,
    bundle_display,
    bundle_see_through,
    changed,
    polynomial,
    seen,
    volumetric_display,
)
from present import present

from wlr_render.geometry.directions import arcmin_between, dir_of_tangents
from wlr_render.geometry.planes import BasePlane
from wlr_render.geometry.rays import at_z, distance_to_point, split
from wlr_render.mappings import Status
from wlr_render.models.display_model import DisplayModel
from wlr_render.models.inverse import TOLERANCE, backward_start_of
from wlr_render.models.see_through_model import SeeThroughModel
from wlr_render.numerics.arrays import FloatArray

RNG = np.random.default_rng(3)
PIXEL = RNG.uniform([100, 100], [900, 700], (25, 2))
VIEWPOINT = EYE_BOX.at(RNG.uniform(-1, 1, (25, 3)))
POINT = np.column_stack([VIEWPOINT[:, :2] + RNG.uniform(-0.1, 0.1, (25, 2)), RNG.uniform(-3, -0.3, 25)])


def test_display_solve_equals_a_general_root_finder() -> None:
    display = bundle_display()
    root = display.solve_place(PLANE, PIXEL, VIEWPOINT, None)
    assert root.converged.all()
    for pixel, viewpoint, found in zip(PIXEL, VIEWPOINT, root.unknown, strict=True):

        def miss(point: FloatArray, pixel: FloatArray = pixel, viewpoint: FloatArray = viewpoint) -> FloatArray:
            tangents = seen(np.concatenate([pixel, point])[None])[0]
            return np.asarray(point - viewpoint[:2] - (viewpoint[2] - PLANE.z) * tangents)

        slow = scipy.optimize.fsolve(miss, viewpoint[:2], xtol=1e-13)
        np.testing.assert_allclose(found, slow, atol=1e-12)


def test_see_through_solve_equals_a_general_root_finder() -> None:
    root = bundle_see_through().solve_tangents(POINT, VIEWPOINT, None)
    assert root.converged.all()
    for point, viewpoint, found in zip(POINT, VIEWPOINT, root.unknown, strict=True):

        def miss(tangents: FloatArray, point: FloatArray = point, viewpoint: FloatArray = viewpoint) -> FloatArray:
            in_plane = viewpoint[:2] + (viewpoint[2] - PLANE.z) * tangents
            bent = bend(np.concatenate([in_plane, tangents])[None])[0]
            return np.asarray(in_plane + bent[2:] + (PLANE.z - point[2]) * (tangents + bent[:2]) - point[:2])

        slow = scipy.optimize.fsolve(miss, (point[:2] - viewpoint[:2]) / (viewpoint[2] - point[2]), xtol=1e-13)
        np.testing.assert_allclose(found, slow, atol=1e-11)


def strong(model: Fitted, name: str, factor: float) -> Fitted:
    """The same model with all its tangents or bends enlarged: a projection that takes work."""
    polynomial = getattr(model, name)
    enlarged = dataclasses.replace(polynomial, coefficients=factor * polynomial.coefficients)
    return changed(model, **{name: enlarged})


def test_cold_solves_take_a_handful_of_steps_and_warm_ones_fewer_to_the_same_answer() -> None:
    far = VIEWPOINT + [0.0, 0.0, 0.02]
    for solve, subject in (
        (partial(strong(bundle_display(), "forward", 3.0).solve_place, PLANE), PIXEL),
        (strong(bundle_see_through(), "deviation", 9.0).solve_tangents, POINT),
    ):
        earlier = solve(subject, far - 1e-7, None)
        cold = solve(subject, far, None)
        warm = solve(subject, far, earlier.unknown)
        assert warm.iterations < cold.iterations <= 6
        np.testing.assert_allclose(warm.unknown, cold.unknown, atol=10 * TOLERANCE)


def test_a_useless_warm_start_costs_nothing_but_time() -> None:
    display = bundle_display()
    cold = display.view_dir_of_pixel(PIXEL, VIEWPOINT)
    start = present(cold.warm_start).copy()
    start[::3], start[1::3] = np.nan, 1e6
    warm = display.view_dir_of_pixel(PIXEL, VIEWPOINT, start)
    assert warm.ok.all()
    np.testing.assert_allclose(warm.value, cold.value, atol=1e-10)


def along_one_ray(display: DisplayModel) -> tuple[FloatArray, FloatArray]:
    """Directions in which two viewpoints on the ray of a pixel see that pixel."""
    view_dir = display.view_dir_of_pixel(PIXEL, EYE_BOX.at(np.array([0.2, -0.3, -0.8]))).value
    behind = EYE_BOX.at(np.array([0.2, -0.3, -0.8])) - 0.004 * view_dir
    return view_dir, display.view_dir_of_pixel(PIXEL, behind).value


def test_viewpoints_along_one_ray_agree_by_construction_and_not_without() -> None:
    assert arcmin_between(*along_one_ray(bundle_display())).max() < 1e-7
    assert arcmin_between(*along_one_ray(volumetric_display())).max() > 1.0


def test_see_through_deviation_is_the_papers_two_points_on_two_planes() -> None:
    """p_real+ and p_real- as sums of straight ray and deviation, on planes at two depths before the base plane."""
    tangents = RNG.uniform(-0.4, 0.4, (25, 2))
    ray = bundle_see_through().real_ray_of_view_dir(dir_of_tangents(tangents), VIEWPOINT).value
    in_plane = PLANE.carry(VIEWPOINT, tangents)
    bent = bend(np.hstack([in_plane, tangents]))
    for depth in (0.4, 3.0):
        expected = in_plane + depth * tangents + (bent[:, 2:] + depth * bent[:, :2])
        np.testing.assert_allclose(split(at_z(ray, PLANE.z - depth))[0][:, :2], expected, atol=1e-12)


TILTED = BasePlane(0.02 - 0.3 * 0.03, (0.3, -0.2))  # through the centre of the eye box


def seen_from(plane: BasePlane) -> Callable[[FloatArray], FloatArray]:
    """Tangents of a virtual image 0.2 m in front of the plane z = 0.02, at places on a plane: (u, v, x, y) -> t."""

    def tangents(inputs: FloatArray) -> FloatArray:
        place = plane.lift(inputs[:, 2:])
        image = EYE_BOX.centre[:2] + (inputs[:, :2] - [500, 400]) * [1.2e-4, -1.4e-4]
        return (image - place[:, :2]) / (0.2 + place[:, 2:] - 0.02)

    return tangents


def bent_from(plane: BasePlane) -> Callable[[FloatArray], FloatArray]:
    """A and B of a thin lens of -2 m, 0.05 m in front of the plane z = 0.02: exact at degree 3 on any plane."""

    def deviation(inputs: FloatArray) -> FloatArray:
        behind_lens = 0.05 + plane.z_at(inputs[:, :2])[:, None] - 0.02
        bent = (inputs[:, :2] + behind_lens * inputs[:, 2:] - EYE_BOX.centre[:2]) / 2.0
        return np.hstack([bent, -behind_lens * bent])

    return deviation


def display_on(plane: BasePlane) -> DisplayModel:
    forward = polynomial(seen_from(plane), box(PIXELS, IN_PLANE), 6)
    return DisplayModel(PANEL, EYE_BOX, plane, forward, backward_start_of(forward))


def test_a_display_on_a_tilted_base_plane_answers_like_one_on_an_untilted_plane() -> None:
    upright, tilted = display_on(PLANE), display_on(TILTED)
    expected = upright.view_dir_of_pixel(PIXEL, VIEWPOINT)
    found = tilted.view_dir_of_pixel(PIXEL, VIEWPOINT)
    assert found.ok.all()
    # The tangents are rational in the place on the tilted plane; degree 6 leaves 2e-9 of them.
    np.testing.assert_allclose(found.value, expected.value, atol=1e-8)
    back = tilted.pixel_of_view_dir(found.value, VIEWPOINT)
    assert back.ok.all()
    np.testing.assert_allclose(back.value, PIXEL, atol=1e-7)
    # The place in the other plane is not the same one.
    assert np.abs(present(found.warm_start) - present(expected.warm_start)).max() > 1e-4


def test_a_see_through_on_a_tilted_base_plane_answers_like_one_on_an_untilted_plane() -> None:
    upright, tilted = (
        SeeThroughModel(EYE_BOX, plane, polynomial(bent_from(plane), box(IN_PLANE, TANGENTS), 3))
        for plane in (PLANE, TILTED)
    )
    expected, found = (each.view_dir_of_real_point(POINT, VIEWPOINT) for each in (upright, tilted))
    assert found.ok.all()
    np.testing.assert_allclose(found.value, expected.value, atol=1e-11)
    straight = POINT - VIEWPOINT
    assert arcmin_between(found.value, straight / np.linalg.norm(straight, axis=1, keepdims=True)).max() > 10
    for each in upright, tilted:
        ray = each.real_ray_of_view_dir(found.value, VIEWPOINT)
        assert ray.ok.all()
        assert distance_to_point(ray.value, POINT).max() < 1e-11


def test_zero_coefficients_are_no_optics() -> None:
    model = bundle_see_through()
    none = dataclasses.replace(
        model, deviation=dataclasses.replace(model.deviation, coefficients=0.0 * model.deviation.coefficients)
    )
    view_dir = none.view_dir_of_real_point(POINT, VIEWPOINT).value
    straight = POINT - VIEWPOINT
    np.testing.assert_allclose(view_dir, straight / np.linalg.norm(straight, axis=1, keepdims=True), atol=1e-15)
    assert distance_to_point(none.real_ray_of_view_dir(view_dir, VIEWPOINT).value, VIEWPOINT).max() < 1e-15


def test_a_projection_without_a_solution_is_nan_and_not_converged() -> None:
    """t = (x - 0.03)^2 / 1e-6 + 200: 4 mm behind the plane no real p~ satisfies the projection."""

    def wild(inputs: FloatArray) -> FloatArray:
        x = 1e3 * (inputs[:, 2] - 0.03)
        return np.stack([200.0 + x**2, 0.0 * x], axis=-1)

    display = dataclasses.replace(bundle_display(), forward=polynomial(wild, box(PIXELS, IN_PLANE), 2))
    answer = display.view_dir_of_pixel(PIXEL, EYE_BOX.centre + [0.0, 0.0, 0.003])
    assert (answer.status == Status.NOT_CONVERGED).all()
    assert np.isnan(answer.value).all()
    assert np.isnan(present(answer.warm_start)).all()

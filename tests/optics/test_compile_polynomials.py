"""Polynomials in place of traced optics, against queries of the traced optics themselves."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from wlr_render.errors import BadInputError
from wlr_render.geometry import rays
from wlr_render.geometry.directions import ARCMIN, arcmin_between, dir_of_tangents, tangents_of_dir
from wlr_render.geometry.planes import BasePlane
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import Box
from wlr_render.optics.assembly import ASSEMBLY_SIZES, assembled
from wlr_render.optics.compile_polynomials import GOAL_ARCMIN, CompiledMap, compile_display, compile_see_through
from wlr_render.optics.device import ClearAperture, EyeOptics, PlacedSurface
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import TracedDisplay, TracedSeeThrough

PLACE = 0.004  # metres to each side of the middle of the eye box
ERRORS = 0.3 * ASSEMBLY_SIZES * np.where(np.arange(12) % 2, -1.0, 1.0)


def eye(name: str) -> tuple[EyeOptics, BasePlane]:
    optics = load_device(name).eyes["right"]
    return optics, BasePlane(float(optics.eye_box.centre[2]) - 0.001, (0.1, -0.2))


def display_box(optics: EyeOptics, place_m: float = PLACE) -> Box:
    """The panel without a tenth on each side."""
    size, middle = optics.panel.pixels.size_px, optics.eye_box.centre[:2]
    return Box(np.append(0.1 * size, middle - place_m), np.append(0.9 * size, middle + place_m))


def see_through_box(optics: EyeOptics) -> Box:
    middle = optics.eye_box.centre[:2]
    assert optics.field is not None
    return Box(np.append(middle - PLACE, optics.field.low), np.append(middle + PLACE, optics.field.high))


def random_inputs(box: Box, count: int = 300) -> FloatArray:
    return np.random.default_rng(5).uniform(box.low, box.high, (count, 4))


def rms(angle: FloatArray) -> float:
    return float(np.sqrt(np.nanmean(angle**2)))


def display_errors(compiled: CompiledMap, optics: EyeOptics, plane: BasePlane) -> FloatArray:
    """Angles (n,) between compiled and exact directions of random pixels from random places; NaN if not seen."""
    inputs = random_inputs(compiled.polynomial.box)
    exact = TracedDisplay(optics, 0.55).view_dir_of_pixel(inputs[:, :2], plane.lift(inputs[:, 2:]))
    return arcmin_between(dir_of_tangents(compiled.polynomial(inputs)), exact.value)


@pytest.mark.parametrize("name", ["northstar", "birdbath28"])
def test_the_compiled_display_is_the_traced_one_with_its_assembly_errors(name: str) -> None:
    optics, plane = eye(name)
    compiled = compile_display(optics, ERRORS, plane, display_box(optics))
    errors = display_errors(compiled, assembled(optics, ERRORS), plane)
    assert np.isfinite(errors).mean() > 0.95
    assert rms(errors) < 2.0 * GOAL_ARCMIN
    assert rms(errors) == pytest.approx(compiled.rms_arcmin, rel=0.5), "the stated error is the true one"


def test_the_compiled_see_through_is_the_traced_one_with_its_assembly_errors() -> None:
    optics, plane = eye("northstar")
    compiled = compile_see_through(optics, ERRORS, plane, see_through_box(optics))
    inputs = random_inputs(compiled.polynomial.box)
    start, tangents = plane.lift(inputs[:, :2]), inputs[:, 2:]
    exact = TracedSeeThrough(assembled(optics, ERRORS), 0.55).real_ray_of_view_dir(dir_of_tangents(tangents), start)
    deviation = compiled.polynomial(inputs)
    for depth in (0.3, 3.0):
        z = start[:, 2] - depth
        point = rays.split(rays.at_z(exact.value, z))[0]
        found = start[:, :2] + deviation[:, 2:] + depth * (tangents + deviation[:, :2])
        assert rms((found - point[:, :2]) / depth / ARCMIN) < GOAL_ARCMIN


def test_a_device_without_optics_compiles_to_no_deviation() -> None:
    optics = load_device("no_optics").eyes["right"]
    middle = optics.eye_box.centre[:2]
    box = Box(np.append(middle - PLACE, [-0.3, -0.2]), np.append(middle + PLACE, [0.3, 0.2]))
    compiled = compile_see_through(optics, np.zeros(12), BasePlane(0.0), box)
    np.testing.assert_allclose(compiled.polynomial.coefficients, 0.0, atol=1e-12)


def test_orders_grow_only_as_far_as_the_optics_need() -> None:
    optics, plane = eye("birdbath28")
    wide = display_box(optics, 0.008)
    low, high = (0.7 * edge + 0.3 * 0.5 * (wide.low + wide.high) for edge in (wide.low, wide.high))
    small, large = (compile_display(optics, np.zeros(12), plane, box) for box in (Box(low, high), wide))
    assert small.rms_arcmin < GOAL_ARCMIN
    assert len(small.polynomial.orders) < len(large.polynomial.orders)


@pytest.mark.parametrize("compile_map", [compile_display, compile_see_through])
def test_the_derivatives_predict_what_other_assembly_errors_change(compile_map: Callable[..., Any]) -> None:
    optics, plane = eye("birdbath28")
    box = display_box(optics) if compile_map is compile_display else see_through_box(optics)
    at_rest = compile_map(optics, ERRORS, plane, box)
    inputs = random_inputs(box)
    for number in range(0, 12, 1 if compile_map is compile_see_through else 3):
        step = 0.01 * ASSEMBLY_SIZES * (np.arange(12) == number)
        moved = compile_map(optics, ERRORS + step, plane, box)
        change = moved.polynomial(inputs) - at_rest.polynomial(inputs)
        by_value = replace(at_rest.polynomial, coefficients=at_rest.by_assembly_error @ step)
        size = np.abs(change).max(axis=0)
        tolerance = 0.02 * size + 1e-3 * ARCMIN
        assert (np.abs(by_value(inputs) - change) < tolerance).all(), number


def test_where_no_ray_passes_the_polynomial_continues_smoothly() -> None:
    """A quarter of the field is hidden by an aperture: the rest is as good as before, the quarter stays in bounds."""
    optics, plane = eye("freeform40")

    def narrowed(surface: PlacedSurface) -> PlacedSurface:
        low, high = surface.aperture.low, surface.aperture.high
        return replace(surface, aperture=ClearAperture(np.append([-5e-3], low[1:]), high))

    hidden = optics.with_surfaces(narrowed)
    whole, compiled = (compile_display(each, np.zeros(12), plane, display_box(optics)) for each in (optics, hidden))
    assert whole.reached > 0.99
    assert 0.5 < compiled.reached < 0.8
    errors = display_errors(compiled, hidden, plane)
    assert 0.5 < np.isfinite(errors).mean() < 0.8
    assert rms(errors) < 1.5 * whole.rms_arcmin
    inputs = random_inputs(whole.polynomial.box)
    assert np.abs(compiled.polynomial(inputs) - whole.polynomial(inputs)).max() < 0.12


def test_a_box_that_no_ray_reaches_is_refused() -> None:
    optics, plane = eye("birdbath28")
    box = display_box(optics)
    elsewhere = Box(box.low + [0.0, 0.0, 0.1, 0.1], box.high + [0.0, 0.0, 0.1, 0.1])
    with pytest.raises(BadInputError, match="check that it is of this headset"):
        compile_display(optics, np.zeros(12), plane, elsewhere)


def test_tangents_are_those_from_the_place_on_the_base_plane() -> None:
    """A viewpoint off the plane sees the pixel along the same ray."""
    optics, plane = eye("birdbath28")
    compiled = compile_display(optics, np.zeros(12), plane, display_box(optics))
    pixel, viewpoint = 0.5 * optics.panel.pixels.size_px + [100.0, 50.0], optics.eye_box.at(np.array([0.5, -0.5, 1.0]))
    view_dir = TracedDisplay(optics, 0.55).view_dir_of_pixel(pixel, viewpoint).value
    tangents = tangents_of_dir(view_dir)
    found = compiled.polynomial(np.append(pixel, plane.carry(viewpoint, tangents)))
    np.testing.assert_allclose(found, tangents, atol=5.0 * GOAL_ARCMIN * ARCMIN)

"""Forward and backward queries of fitted models of the shipped devices are each other's inverse."""

from functools import lru_cache

import numpy as np
import pytest
from fitted_eyes import captures
from present import narrowed, present

from wlr_render.calibration.fit_display import fit_display
from wlr_render.calibration.fit_report import ModelFit
from wlr_render.calibration.fit_see_through import fit_see_through
from wlr_render.geometry.directions import arcmin_between, dir_of_tangents, tangents_of_dir
from wlr_render.geometry.rays import distance_to_point, split
from wlr_render.mappings import Status
from wlr_render.models.fitted_model import FittedDisplay, FittedSeeThrough
from wlr_render.models.see_through_model import SeeThroughModel
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.viewpoints import random_in_eye_box

DEVICES = "northstar", "freeform40", "birdbath28"
DEGREES = {"planar": (5, 3), "volumetric": (2, 2), "static": (5, 3)}
WORST_PX, WORST_ARCMIN = 1e-3, 1e-3

devices = pytest.mark.parametrize("device", DEVICES)
kinds = pytest.mark.parametrize(
    ("device", "kind"),
    [*((device, "planar") for device in DEVICES), ("freeform40", "volumetric"), ("birdbath28", "static")],
)


@lru_cache
def fitted(device: str, kind: str) -> tuple[ModelFit[FittedDisplay], ModelFit[FittedSeeThrough]]:
    made, (display, see_through) = captures(device, kind), DEGREES[kind]
    return fit_display(present(made.display), kind, display), fit_see_through(
        present(made.see_through), kind, see_through
    )


def viewpoints(mapping: FittedDisplay | FittedSeeThrough) -> FloatArray:
    return random_in_eye_box(mapping.eye_box, 30, np.random.default_rng(5))[:, None]


@kinds
def test_pixel_to_direction_to_pixel(device: str, kind: str) -> None:
    display = fitted(device, kind)[0].mapping
    pixel, viewpoint = display.panel.grid(24, 20).reshape(-1, 2), viewpoints(display)
    seen = display.view_dir_of_pixel(pixel, viewpoint)
    back = display.pixel_of_view_dir(seen.value, viewpoint)
    both = seen.ok & back.ok
    assert both.mean() > 0.99
    worst = np.linalg.norm(back.value - pixel, axis=-1)[both].max()
    print(f"{device}, {kind}: {worst:.1e} px")
    assert worst <= WORST_PX
    # From its own answer the solve has nothing to do.
    warm = display.pixel_of_view_dir(seen.value, viewpoint, back.warm_start)
    np.testing.assert_array_equal(warm.value, back.value)


@kinds
def test_direction_to_pixel_to_direction_inside_and_beyond_the_panel(device: str, kind: str) -> None:
    display = fitted(device, kind)[0].mapping
    viewpoint, corners = viewpoints(display), display.panel.size_px * [[0, 0], [0, 1], [1, 0], [1, 1]]
    at_corners = tangents_of_dir(display.view_dir_of_pixel(corners, display.eye_box.centre).value)
    middle, half = at_corners.mean(axis=0), np.ptp(at_corners, axis=0) / 2
    unit = np.random.default_rng(6).uniform(-1.5, 1.5, (400, 2))
    view_dir = dir_of_tangents(middle + unit * half)
    shown = display.pixel_of_view_dir(view_dir, viewpoint)
    again = display.view_dir_of_pixel(shown.value, viewpoint)
    both = shown.ok & again.ok
    assert arcmin_between(again.value, view_dir + 0 * again.value)[both].max() <= WORST_ARCMIN
    assert both[:, (np.abs(unit) < 0.7).all(axis=1)].mean() > 0.9
    assert not shown.ok[:, (np.abs(unit) > 1.45).any(axis=1)].any()
    np.testing.assert_array_equal(np.isnan(shown.value).any(axis=-1), shown.status == Status.NOT_CONVERGED)


@kinds
def test_real_point_to_direction_to_ray(device: str, kind: str) -> None:
    see_through = fitted(device, kind)[1].mapping
    viewpoint, rng = viewpoints(see_through), np.random.default_rng(7)
    tangents = rng.uniform(*see_through_field(see_through), (100, 2))
    depth = 1.0 / rng.uniform(1 / 5.0, 1 / 0.3, (30, 100, 1))
    origin, direction = split(see_through.real_ray_of_view_dir(dir_of_tangents(tangents), viewpoint).value)
    point = origin + depth * direction
    seen = see_through.view_dir_of_real_point(point, viewpoint)
    ray = see_through.real_ray_of_view_dir(seen.value, viewpoint)
    both = seen.ok & ray.ok
    assert both.mean() > 0.9
    assert (distance_to_point(ray.value, point) / depth[..., 0])[both].max() < 1e-9
    assert arcmin_between(seen.value, dir_of_tangents(tangents))[both].max() <= WORST_ARCMIN


@devices
def test_contractions_of_the_shipped_devices_leave_no_doubt(device: str) -> None:
    display, see_through = fitted(device, "planar")
    print(f"{device}: contraction {display.contraction:.3f} (display), {see_through.contraction:.3f} (see-through)")
    assert 0.001 < display.contraction < 0.1
    assert 0.001 < see_through.contraction < 0.1


def see_through_field(see_through: FittedSeeThrough) -> tuple[FloatArray, FloatArray]:
    """Tangents that are inside the fit, nearly."""
    polynomial = narrowed(see_through, SeeThroughModel).deviation
    return 0.9 * polynomial.box.low[-2:], 0.9 * polynomial.box.high[-2:]

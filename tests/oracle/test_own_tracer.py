"""The second tracer against the package's, and against what is known in closed form."""

from typing import Any

import numpy as np
import pytest

from oracle.devices import CHANNEL_UM, NAMES, OwnDevice, own_device
from oracle.effects import Effect
from oracle.own_tracer import refracted, unit
from oracle.world import World
from wlr_render.mappings import Status
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device_file import load_device
from wlr_render.optics.tracer import trace

OPENXR = np.array([1.0, -1.0, -1.0])  # y up, z backwards


def sight(device: OwnDevice, count: int = 2000, seed: int = 1) -> tuple[Any, FloatArray]:
    rng = np.random.default_rng(seed)
    origin = device.eye + rng.uniform(-1.0, 1.0, (count, 3)) * [5.0, 4.0, 3.0]
    tangents = rng.uniform(-1.0, 1.0, (count, 2)) * [0.4, 0.35]
    return origin, unit(np.concatenate([tangents, np.ones((count, 1))], axis=-1))


@pytest.mark.parametrize("wavelength_um", CHANNEL_UM)
@pytest.mark.parametrize("path", ["display", "see_through"])
@pytest.mark.parametrize("name", NAMES)
def test_both_tracers_agree(name: str, path: str, wavelength_um: float) -> None:
    device, eye = own_device(name), load_device(name).eyes["right"]
    origin, direction = sight(device)
    theirs = trace(getattr(eye, path), origin * OPENXR * 1e-3, direction * OPENXR, wavelength_um)
    with np.errstate(all="raise"):
        point, leaving = device.trace(getattr(device, path), origin, direction, wavelength_um)
    good = theirs.status == Status.OK
    assert good.mean() > 0.9
    np.testing.assert_allclose(point[good], theirs.origin[good] * OPENXR * 1e3, rtol=0, atol=1e-9)
    np.testing.assert_allclose(leaving[good], theirs.direction[good] * OPENXR, rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_both_panels_agree(name: str) -> None:
    device, panel = own_device(name), load_device(name).eyes["right"].panel
    pixel = np.random.default_rng(2).uniform(0.0, 1.0, (50, 2)) * device.panel.pixels
    point, normal = panel.point_of_pixel(pixel) * OPENXR * 1e3, np.tile(device.panel.axes[:, 2], (50, 1))
    np.testing.assert_allclose(device.panel.pixel(point - 7.0 * normal, normal), pixel, atol=1e-9)


def test_a_ripples_gradient_is_that_of_its_height() -> None:
    """Trials of the diagnosis show those of the other bumps, which are listed causes."""
    ripple = Effect("combiner_ripple", {"height_mm": 0.02, "period_mm": 9.0})
    surface = ripple.applied(World(own_device("freeform40"))).device.surfaces["inner"]
    point = np.array([[1.0, 2.0, 41.0], [-6.0, 3.0, 38.0]])
    gradient = surface.height(point)[1]
    for axis, step in enumerate(np.eye(3) * 1e-4):
        slope = (surface.height(point + step)[0] - surface.height(point - step)[0]) / 2e-4
        np.testing.assert_allclose(slope, gradient[:, axis], atol=1e-9)


def test_refraction_reports_total_reflection() -> None:
    slanted, normal = np.array([[np.sin(1.4), 0.0, np.cos(1.4)]]), np.array([[0.0, 0.0, -1.0]])
    assert np.isnan(refracted(slanted, normal, 1.5)).all()

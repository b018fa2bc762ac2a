"""The second tracer against the package's, and against what is known in closed form."""

from typing import Any

import numpy as np
import pytest

from oracle.devices import CHANNEL_UM, NAMES, OwnDevice, own_device
from oracle.effects import Effect
from oracle.own_tracer import Spheroid, refracted, turn, unit
from oracle.world import World
from wlr_render.errors import BadInputError
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


def test_a_parallel_surface_is_parallel() -> None:
    outer, inner = Spheroid(124.975, 157.5), Spheroid(124.975, 157.5, -2.5)
    origin, direction = sight(own_device("freeform40"))
    point = origin + inner.start(origin, direction)[:, None] * direction
    height, normal = inner.height(point)
    foot = point - (height - 2.5)[:, None] * normal
    np.testing.assert_allclose(np.sum((foot / [124.975, 124.975, 157.5]) ** 2, axis=-1), 1.0, rtol=1e-12)
    np.testing.assert_allclose(outer.height(foot)[1], normal, atol=1e-12)


@pytest.mark.parametrize("name", ["combiner_dent", "combiner_form", "combiner_ripple"])
def test_a_bumps_gradient_is_that_of_its_height(name: str) -> None:
    sizes = {
        "depth_mm": 0.02,
        "sag_mm": 0.02,
        "x_mm": 2.0,
        "y_mm": -1.0,
        "width_mm": 4.0,
        "height_mm": 0.02,
        "period_mm": 9.0,
    }
    surface = Effect(name, sizes).applied(World(own_device("freeform40"))).device.surfaces["inner"]
    point = np.array([[1.0, 2.0, 41.0], [-6.0, 3.0, 38.0]])
    gradient = surface.height(point)[1]
    for axis, step in enumerate(np.eye(3) * 1e-4):
        slope = (surface.height(point + step)[0] - surface.height(point - step)[0]) / 2e-4
        np.testing.assert_allclose(slope, gradient[:, axis], atol=1e-9)


def test_refraction_obeys_snell_and_reports_total_reflection() -> None:
    angle = np.radians([0.0, 20.0, 80.0])
    into = np.stack([np.sin(angle), np.zeros(3), np.cos(angle)], axis=-1)
    normal = np.tile([0.0, 0.0, -1.0], (3, 1))
    bent = refracted(into, normal, 1.0 / 1.5)
    np.testing.assert_allclose(bent[:, 0], np.sin(angle) / 1.5, atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(bent, axis=-1), 1.0)
    assert np.isnan(refracted(into, normal, 1.5)[2]).all()


def test_turn_is_a_rotation_about_its_vector() -> None:
    vector = np.array([[[0.3, -0.2, 0.5]], [[0.0, 0.0, 0.0]], [[0.0, 0.0, np.pi / 2]]])
    matrix = turn(vector)
    assert matrix.shape == (3, 1, 3, 3)
    np.testing.assert_allclose(
        matrix @ np.swapaxes(matrix, -1, -2), np.broadcast_to(np.eye(3), matrix.shape), atol=1e-15
    )
    np.testing.assert_allclose(matrix[0, 0] @ vector[0, 0], vector[0, 0])
    np.testing.assert_allclose(matrix[2, 0] @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-15)


def test_an_unknown_device_is_named() -> None:
    with pytest.raises(BadInputError, match=r"no device 'hololens'.*northstar"):
        own_device("hololens")

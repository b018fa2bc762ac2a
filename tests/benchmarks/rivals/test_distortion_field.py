"""Neural distortion field: gradient through the sum along the ray, both queries agree."""

import itertools
import time

import numpy as np
import pytest
from scipy.optimize import check_grad

from benchmarks.rivals.distortion_field import RayLayers, distortion_field
from benchmarks.rivals.network_training import ProjectedLoss
from wlr_render.captures.correspondences import DisplayCaptures
from wlr_render.geometry.directions import dir_of_tangents, tangents_of_dir
from wlr_render.mappings import EyeBox, Panel
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import Box

EYE_BOX = EyeBox(np.array([0.03, 0.0, 0.02]), np.array([0.010, 0.008, 0.006]))
PANEL = Panel(1200, 1000)
IMAGE_DIOPTRES = 1.5
PER_TANGENT = 800.0


@pytest.fixture(autouse=True)
def _clock_of_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """A budget of one second is a hundred looks at the clock, on machines of any speed."""
    ticks = itertools.count()
    monkeypatch.setattr(time, "process_time", lambda: 0.01 * next(ticks))


def truth(viewpoint: FloatArray, tangents: FloatArray) -> FloatArray:
    """Pixels (n, 2): a virtual image at `IMAGE_DIOPTRES` with barrel distortion and a swim no image plane has."""
    offset = viewpoint - EYE_BOX.centre
    seen = (tangents + IMAGE_DIOPTRES * offset[:, :2]) / (1.0 - IMAGE_DIOPTRES * offset[:, 2:])
    radius = np.sum(seen**2, axis=1, keepdims=True)
    swim = 0.3 * offset[:, :2] * tangents[:, :1] ** 2
    return np.asarray(0.5 * PANEL.size_px + PER_TANGENT * (seen * (1.0 - 0.15 * radius) + swim))


def rays(places: int, each: int, seed: int, inside: float = 1.0) -> tuple[FloatArray, FloatArray]:
    """Viewpoints (n, 3) in a volume, the same for `each` rays, and view tangents (n, 2)."""
    rng = np.random.default_rng(seed)
    place = EYE_BOX.centre + inside * rng.uniform(-0.5, 0.5, (places, 3)) * EYE_BOX.size
    return np.repeat(place, each, axis=0), inside * rng.uniform(-0.5, 0.5, (places * each, 2))


def captures() -> DisplayCaptures:
    """Exact sightings of `truth`."""
    viewpoint, tangents = rays(40, 80, 1)
    return DisplayCaptures(
        device="toy",
        eye="right",
        eye_box=EYE_BOX,
        panel=PANEL,
        viewpoint=viewpoint,
        view_dir=dir_of_tangents(tangents),
        pixel=truth(viewpoint, tangents),
        capture=np.repeat(np.arange(40), 80),
        sigma_arcmin=np.zeros(len(tangents)),
    )


def test_gradient_through_the_sum_is_that_of_differences() -> None:
    rng = np.random.default_rng(0)
    box = Box(np.array([0.025, -0.004, 0.017, -0.5, -0.5]), np.array([0.035, 0.004, 0.023, 0.5, 0.5]))
    layers = RayLayers((5, 4), box, EYE_BOX.centre, np.array([-1.0, 1.0, 4.0]))
    inputs = rng.uniform(-1, 1, (30, 5))
    loss = ProjectedLoss(layers, inputs, np.ones((30, 1)), np.ones((30, 1)), rng.normal(size=(30, 2)))
    weights = layers.start(rng, np.ones(5))
    weights[-4:] = rng.normal(size=4)
    _, gradient = loss(weights)
    off = check_grad(lambda w: loss(w)[0], lambda w: loss(w)[1], weights, epsilon=1e-6)
    assert off < 1e-4 * np.linalg.norm(gradient)


@pytest.mark.slow
def test_forward_query_inverts_the_backward_one() -> None:
    model = distortion_field(captures(), seconds=1.0, units=(8, 8))
    viewpoint, tangents = rays(20, 5, 3, inside=0.8)
    direction = dir_of_tangents(tangents)
    pixel = model.pixel_of_view_dir(direction, viewpoint).value
    cold = model.view_dir_of_pixel(pixel, viewpoint)
    np.testing.assert_allclose(tangents_of_dir(cold.value), tangents, atol=1e-9)
    warm = model.view_dir_of_pixel(pixel, viewpoint, cold.warm_start)
    np.testing.assert_allclose(warm.value, cold.value, atol=1e-9)

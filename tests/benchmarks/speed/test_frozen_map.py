"""What a frozen map gets wrong, against closed forms: a bare panel half a metre away, which needs no map at all."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.speed.frozen_map import (
    IMAGE_MAPS,
    MESH,
    Scheme,
    frozen_map,
    frozen_map_error_arcmin,
)
from wlr_render.geometry import directions
from wlr_render.jobs.headset import open_eye
from wlr_render.mappings import Eye
from wlr_render.warp.ray_map import middle_axes

PANEL_DEPTH_M = 0.5
RNG = np.random.default_rng(2)
PIXEL = RNG.uniform(1, [1279, 719], (50, 2))
ELSEWHERE = np.array([0.004, -0.003, 0.0025])


@pytest.fixture(scope="module")
def bare_panel() -> Eye:
    return open_eye("no_optics")


@pytest.mark.parametrize("depth_m", [2.0, np.inf])
def test_without_optics_the_pupils_parallax_is_the_whole_error(bare_panel: Eye, depth_m: float) -> None:
    """The eye moves by e: a pixel at place P is seen along P - e, a point on the line from 0 through P along kP - e."""
    shown = frozen_map(bare_panel, MESH, np.zeros(3), np.eye(3))
    place = np.concatenate([(PIXEL / [1280, 720] - 0.5) * [0.320, -0.180], np.full((50, 1), -PANEL_DEPTH_M)], axis=-1)
    real = place - ELSEWHERE * (PANEL_DEPTH_M / depth_m)
    expected = directions.arcmin_between(directions.normalised(place - ELSEWHERE), directions.normalised(real))
    error = frozen_map_error_arcmin(bare_panel, shown, ELSEWHERE, PIXEL, depth_m)
    assert expected.min() > 10
    np.testing.assert_allclose(error, expected, atol=1e-4)


@pytest.mark.parametrize("scheme", [MESH, IMAGE_MAPS], ids=["mesh", "maps"])
@pytest.mark.parametrize("depth_m", [0.5, np.inf])
def test_at_its_own_viewpoint_only_interpolation_is_wrong(
    small_panel_model: Eye, scheme: Scheme, depth_m: float
) -> None:
    """At the map's points there is no error; between them it falls with the square of their distance."""
    eye = small_panel_model
    viewpoint, axes = eye.eye_box.at(np.array([0.4, -0.3, 0.2])), middle_axes(eye)
    pixel = RNG.uniform(0.5, eye.display.panel.size_px - 0.5, (400, 2))
    rms = []
    for points in (9, 17, 33):
        shown = frozen_map(eye, replace(scheme, points=points), viewpoint, axes, depth_m)
        at_points = frozen_map_error_arcmin(eye, shown, viewpoint, shown.warp_grid.panel_pixel(), depth_m)
        assert np.nanmax(at_points) < 1e-5
        error = frozen_map_error_arcmin(eye, shown, viewpoint, pixel, depth_m)
        rms.append(np.sqrt(np.mean(error**2)))
    assert rms[0] / rms[1] == pytest.approx(4, rel=0.1)
    assert rms[1] / rms[2] == pytest.approx(4, rel=0.1)

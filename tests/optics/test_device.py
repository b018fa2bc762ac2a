"""Copies of a device with some of its parts changed."""

from dataclasses import replace

import numpy as np
import pytest

from wlr_render.geometry.directions import normalised
from wlr_render.optics.device_file import load_device
from wlr_render.optics.media import AIR


def test_media_change_in_both_paths_and_air_stays_air() -> None:
    eye = load_device("birdbath28").eyes["right"]
    changed = eye.with_media(lambda medium: medium.shifted(0.02).shifted(-0.005))
    for path, before in ((changed.display, eye.display), (changed.see_through, eye.see_through)):
        for step, old in zip(path.steps, before.steps, strict=True):
            assert step.surface is old.surface
            assert step.interaction is old.interaction
            rise = step.medium.index(0.5) - old.medium.index(0.5)
            assert abs(rise - (0.0 if old.medium is AIR else 0.015)) < 1e-15
            assert step.medium.name == old.medium.name
    assert {step.medium.name for step in changed.display.steps} == {"pmma", "air"}


@pytest.mark.parametrize("curvature", [(0.0, 0.0), (0.8, -0.5), (-6.0, 3.0)])
def test_rays_to_points_of_a_bowed_panel_find_their_pixels(curvature: tuple[float, float]) -> None:
    panel = replace(load_device("northstar").eyes["right"].panel, curvature=np.array(curvature))
    rng = np.random.default_rng(1)
    pixel = rng.uniform(0.0, 1.0, (200, 2)) * panel.pixels.size_px
    point, normal = panel.point_of_pixel(pixel), panel.device_from_panel[:3, 2]
    direction = normalised(normal + rng.uniform(-0.3, 0.3, (200, 3)))
    np.testing.assert_allclose(panel.pixel_of_ray(point - 0.05 * direction, direction), pixel, atol=1e-9)
    assert np.isnan(panel.pixel_of_ray(point + 0.05 * direction, direction)).all()
    height = (point - panel.device_from_panel[:3, 3]) @ normal
    half = 0.5 * panel.size * [1.0, 0.0]
    edge = panel.point_of_pixel(panel.pixels.size_px * [1.0, 0.5]) - panel.device_from_panel[:3, 3]
    assert edge @ normal == pytest.approx(0.5 * curvature[0] * half[0] ** 2, abs=1e-15)
    assert np.ptp(height) > 0.0 or curvature == (0.0, 0.0)

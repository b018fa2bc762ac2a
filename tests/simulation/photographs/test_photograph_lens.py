from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from wlr_render.errors import BadInputError
from wlr_render.geometry import rays
from wlr_render.lenses.lens_camera import LensCamera
from wlr_render.simulation.photographs.camera import SimulatedLens

CAMERA = LensCamera((640, 480), np.array([700.0, 690.0]), np.array([322.0, 236.0]), np.array([-0.1, 0.02, 1e-3, 0, 0]))


@pytest.mark.parametrize("lead", [(), (1,), (3, 1, 2)])
def test_rays_of_a_pixel_meet_in_the_plane_in_focus_where_the_camera_sees_it(lead: tuple[int, ...]) -> None:
    lens = SimulatedLens(CAMERA, pupil_diameter_m=0.003, focus_m=0.7)
    pixel = np.random.default_rng(1).uniform(0, 480, (*lead, 2))
    for pupil_point in [(0.0, 0.0), (0.0015, 0.0), (-0.0004, 0.001)]:
        ray = lens.ray_of_pixel(pixel, np.array(pupil_point))
        assert ray.shape == (*lead, 6)
        np.testing.assert_array_equal(ray[..., :3], np.broadcast_to([*pupil_point, 0.0], (*lead, 3)))
        np.testing.assert_allclose(np.linalg.norm(ray[..., 3:], axis=-1), 1.0, atol=1e-15)
        in_focus = rays.at_z(ray, 0.7)[..., :3]
        np.testing.assert_allclose(CAMERA.pixel_of_point(in_focus), pixel, atol=1e-9)


def test_a_lens_set_to_infinity_sees_by_parallel_rays() -> None:
    lens = SimulatedLens(CAMERA, focus_m=float("inf"))
    pixel = np.array([100.0, 50.0])
    middle, edge = (lens.ray_of_pixel(pixel, np.array([x, 0.0]))[3:] for x in (0.0, 0.001))
    np.testing.assert_array_equal(middle, edge)


@pytest.mark.parametrize("count", [1, 2, 5, 16, 40])
def test_samples_are_centred_and_fill_pixel_and_pupil(count: int) -> None:
    offset, pupil_point = SimulatedLens(CAMERA, pupil_diameter_m=0.004).samples(count)
    assert offset.shape == pupil_point.shape == (count, 2)
    np.testing.assert_allclose(offset.mean(axis=0), 0.0, atol=1e-15)
    np.testing.assert_allclose(pupil_point.mean(axis=0), 0.0, atol=1e-15)
    assert np.linalg.norm(pupil_point, axis=-1).max() <= 0.002
    for axis in offset.T:  # one sample in each of `count` strips of the pixel
        np.testing.assert_array_equal(np.sort(np.floor((axis + 0.5) * count)), np.arange(count))


def test_sixteen_samples_have_the_spread_of_pixel_and_disc() -> None:
    offset, pupil_point = SimulatedLens(CAMERA, pupil_diameter_m=0.004).samples(16)
    np.testing.assert_allclose(offset.var(axis=0), 1 / 12, rtol=0.01)
    np.testing.assert_allclose(pupil_point.var(axis=0), 0.002**2 / 4, rtol=0.1)


@pytest.mark.parametrize("wrong", [{"pupil_diameter_m": -0.001}, {"focus_m": 0.0}, {"focus_m": float("nan")}])
def test_an_impossible_lens_is_refused(wrong: Mapping[str, Any]) -> None:
    with pytest.raises(BadInputError, match="is impossible"):
        SimulatedLens(CAMERA, **wrong)


def test_no_samples_are_refused() -> None:
    with pytest.raises(BadInputError, match="0 samples"):
        SimulatedLens(CAMERA).samples(0)

import dataclasses
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from benchmarks.soak.map_check import arcmin_apart
from wlr_render.geometry import transforms
from wlr_render.numerics.arrays import Float32Array, FloatArray
from wlr_render.warp.ray_map import NEAREST_M, RayMap

AXES = transforms.rotation_about("y", 0.2)


def field(viewpoint: ArrayLike = (0.0, 0.0, 0.0), slope_offset: FloatArray | Float32Array | None = None) -> RayMap:
    rng = np.random.default_rng(4)
    some = rng.uniform(-0.5, 0.5, (4, 3, 5)) * np.array([1.0, 1.0, 0.01, 0.01])[:, None, None]
    given = some if slope_offset is None else slope_offset
    exact = cast(Float32Array, given)  # of doubles: the roundings of a map would hide what is tested
    return RayMap(np.array(viewpoint), AXES, exact, np.zeros((3, 5), np.uint8))


def test_the_same_rays_told_from_two_viewpoints_are_not_apart() -> None:
    one, step = field(), np.array([0.002, -0.003, 0.004])
    origin = np.stack([one.slope_offset[2], one.slope_offset[3], np.zeros((3, 5))]) - (AXES.T @ step)[:, None, None]
    slope = np.stack([one.slope_offset[0], one.slope_offset[1], -np.ones((3, 5))])
    offset = origin + origin[2] * slope
    assert arcmin_apart(one, field(step, np.concatenate([slope[:2], offset[:2]]))) < 1e-6
    assert arcmin_apart(one, field(step, one.slope_offset)) > 10.0


def test_turned_rays_are_apart_by_the_turn_and_shifted_ones_by_the_shift_at_the_nearest_depth() -> None:
    straight = field(slope_offset=np.zeros((4, 3, 5)))
    for component, amount, arcmin in ((0, 1e-3, 3.4377), (3, 1e-3 * NEAREST_M, 3.4377)):
        slope_offset = np.zeros((4, 3, 5))
        slope_offset[component, 1, 2] = amount
        np.testing.assert_allclose(arcmin_apart(field(slope_offset=slope_offset), straight), arcmin, rtol=1e-4)


def test_points_without_a_ray_do_not_count_and_none_at_all_is_told() -> None:
    one = field()
    spoilt = one.slope_offset.copy()
    spoilt[:, 0, 0] = np.nan
    assert arcmin_apart(dataclasses.replace(one, slope_offset=spoilt), one) < 1e-9
    assert np.isnan(arcmin_apart(dataclasses.replace(one, slope_offset=np.full_like(spoilt, np.nan)), one))

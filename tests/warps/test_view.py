import numpy as np
import pytest
from gl_scenes import OFF_CENTRE

from wlr_render.geometry import transforms
from wlr_render.numerics.arrays import FloatArray
from wlr_render.warp.view import View, image_from_ray_map


def pose(rng: np.random.Generator) -> FloatArray:
    return transforms.rigid(transforms.rotations_of_vectors(rng.normal(size=3)), rng.normal(size=3))


@pytest.mark.parametrize("lead", [(), (1,), (3, 1, 2)])
def test_a_point_is_the_same_world_point_by_both_ways(lead: tuple[int, ...]) -> None:
    rng = np.random.default_rng(4)
    view = View(OFF_CENTRE, rng.normal(size=3), pose(rng), pose(rng)[:3, :3])
    viewpoint, axes = rng.normal(size=3), pose(rng)[:3, :3]
    poses = np.array([pose(rng) for _ in range(int(np.prod(lead)))]).reshape(*lead, 4, 4)
    carried = image_from_ray_map(view, viewpoint, axes, poses)
    assert carried.shape == (*lead, 4, 4)
    point_in_field = rng.normal(size=3)
    for place in np.ndindex(lead):
        point_in_device = viewpoint + axes @ point_in_field
        point_in_world = transforms.apply(poses[place], point_in_device)
        seen = transforms.apply(view.world_from_camera, transforms.apply(carried[place], point_in_field))
        np.testing.assert_allclose(seen, point_in_world, atol=1e-12)
